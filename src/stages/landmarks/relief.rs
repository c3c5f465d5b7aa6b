//! Surface height at points of the face, measured by depth; a frontal image hardly shows it.
//!
//! Every depth pixel within a small window around the point is transformed to the head frame; the surface is the mean of those
//! that agree with their median. A patch of some dozens of pixels beats the sensor's depth
//! steps (2 mm at 0.8 m) by a factor of ten. Units: metres, head frame. No memory. Cost: one look-up and one rotation
//! per pixel, about a microsecond per point. Degenerate: too few pixels, or none near the point, give `None`.

use crate::base::capacity::{HEIGHT, PIXELS, WIDTH};
use crate::base::frames::SensorFromFace;
use crate::base::geometry::{Point, Vector};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::camera::Camera;

/// Half the width of a window, metres.
const REACH_M: f32 = 0.004;
/// Largest half width of a window, pixels.
const MOST_PX: f32 = 6.0;
/// Largest distance of a surface along z from the point, metres.
const NEAR_M: f32 = 0.025;
/// Largest deviation from the median, metres: beyond are steps and edges.
const AGREE_M: f32 = 0.006;
/// Least number of pixels.
const LEAST: usize = 8;

/// Height −z (towards the camera) of the surface at `place`, both in the face's frame, metres; `None` with too few pixels.
#[inline(never)]
pub fn height(
    depth: &[u16; PIXELS],
    camera: &Camera,
    sensor_from_face: &SensorFromFace,
    place: &Point,
) -> Option<f32> {
    let seen = sensor_from_face * place;
    if seen.z < 0.2 {
        return None;
    }
    let [col, row] = camera.depth_pixel(&seen);
    let reach = (camera.depth_focal_px() * REACH_M / seen.z).clamp(1.0, MOST_PX);
    let span = |centre: f32, most: usize| {
        let from = (centre - reach).ceil().max(0.0) as usize;
        let to = ((centre + reach).floor() + 1.0).clamp(0.0, most as f32) as usize;
        from..to.max(from)
    };
    let origin = sensor_from_face * Point::origin();
    let towards = sensor_from_face.rotation * -Vector::z();
    let mut heights = heapless::Vec::<f32, 169>::new();
    for y in span(row, HEIGHT) {
        for x in span(col, WIDTH) {
            let z = camera.depth_m(depth[y * WIDTH + x]);
            if (z - seen.z).abs() < NEAR_M {
                let point = camera.point(x as f32, y as f32, z);
                let _ = heights.push((point - origin).dot(&towards));
            }
        }
    }
    if heights.len() < LEAST {
        return None;
    }
    let middle = heights.len() / 2;
    let (_, &mut median, _) = heights.select_nth_unstable_by(middle, f32::total_cmp);
    let (mut sum, mut count) = (0.0, 0.0);
    for &h in heights.iter().filter(|&&h| (h - median).abs() < AGREE_M) {
        sum += h;
        count += 1.0;
    }
    Some(sum / count)
}

/// Least distance of an object before the face, metres.
const BEFORE_M: f32 = 0.02;

/// Whether an object is before `place` (face's frame, metres).
pub fn is_hidden(
    depth: &[u16; PIXELS],
    camera: &Camera,
    sensor_from_face: &SensorFromFace,
    place: &Point,
) -> bool {
    let seen = sensor_from_face * place;
    if seen.z < 0.2 {
        return false;
    }
    let [col, row] = camera.depth_pixel(&seen).map(f32::round);
    let inside = (0.0..WIDTH as f32).contains(&col) && (0.0..HEIGHT as f32).contains(&row);
    if !inside {
        return false;
    }
    let z = camera.depth_m(depth[row as usize * WIDTH + col as usize]);
    // 0: no measurement.
    z > 0.2 && z < seen.z - BEFORE_M
}

/// A depth image of the plane z = 0.8 m + slope · x, in the camera's whole steps.
#[cfg(test)]
pub(crate) fn plane(camera: &Camera, slope: f32) -> Box<[u16; PIXELS]> {
    let mut depth = vec![crate::frame::NO_DEPTH; PIXELS].into_boxed_slice();
    for (i, raw) in depth.iter_mut().enumerate() {
        let ray = camera.point((i % WIDTH) as f32, (i / WIDTH) as f32, 1.0);
        let z = 0.8 / (1.0 - slope * ray.x);
        *raw = camera.raw_from_m(z).round() as u16;
    }
    depth.try_into().expect("PIXELS long")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::Rigid;
    use crate::frame::NO_DEPTH;

    #[test]
    fn the_height_of_a_plane_is_measured() {
        let camera = Camera::default();
        let depth = plane(&camera, 0.2);
        let pose = SensorFromFace::assume_frames(Rigid::translation(0.01, -0.02, 0.83));
        for place in [[0.0, 0.0], [0.03, 0.02], [-0.04, 0.05]] {
            let truth = -(0.8 + 0.2 * (place[0] + 0.01) - 0.83);
            let guess = Point::new(place[0], place[1], -truth + 0.008);
            let found = height(&depth, &camera, &pose, &guess).expect("depth is there");
            // The sensor's steps are 2 mm here.
            assert!((found - truth).abs() < 0.0012, "{found} for {truth}");
        }
    }

    #[test]
    fn distant_surfaces_are_ignored() {
        let camera = Camera::default();
        let depth = plane(&camera, 0.0);
        let pose = SensorFromFace::assume_frames(Rigid::translation(0.0, 0.0, 0.8));
        assert!(height(&depth, &camera, &pose, &Point::new(0.0, 0.0, 0.05)).is_none());
        assert!(height(&depth, &camera, &pose, &Point::new(3.0, 0.0, 0.0)).is_none());
        let nothing: Box<[u16; PIXELS]> = vec![NO_DEPTH; PIXELS].try_into().expect("long");
        assert!(height(&nothing, &camera, &pose, &Point::origin()).is_none());
    }

    #[test]
    fn an_object_two_centimetres_before_a_point_hides_it() {
        let camera = Camera::default();
        let depth = plane(&camera, 0.0);
        let pose = SensorFromFace::assume_frames(Rigid::translation(0.0, 0.0, 0.8));
        for (z, hidden) in [(0.03, true), (0.01, false), (0.0, false), (-0.03, false)] {
            let place = Point::new(0.01, 0.02, z);
            assert_eq!(is_hidden(&depth, &camera, &pose, &place), hidden, "{z}");
        }
        // A hand before what is to the right of the middle only.
        let mut beside = plane(&camera, 0.0);
        for row in beside.chunks_exact_mut(WIDTH) {
            row[WIDTH / 2 + 5..].fill(camera.raw_from_m(0.7).round() as u16);
        }
        for (x, hidden) in [(-0.03, false), (0.03, true)] {
            let place = Point::new(x, 0.02, 0.0);
            assert_eq!(is_hidden(&beside, &camera, &pose, &place), hidden, "{x}");
        }
        let nothing: Box<[u16; PIXELS]> = vec![NO_DEPTH; PIXELS].try_into().expect("long");
        let place = Point::new(0.0, 0.0, 0.03);
        assert!(!is_hidden(&nothing, &camera, &pose, &place));
    }
}
