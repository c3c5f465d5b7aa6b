//! Measures depth at the sites of the face model's refinement ([`crate::face_model::refinement`]).

use super::relief;
use crate::base::capacity::{LANDMARKS, PIXELS};
use crate::base::frames::SensorFromFace;
use crate::base::geometry::{Point, Vector};
use crate::camera::Camera;
use crate::face_model::refinement::{Inputs, MAX_INPUTS, SITES, sites};

/// Inputs of the refinement. `shape`: fitted coefficients, one per mode; `turn`: the head's rotation vector relative to the line
/// of sight; `head`: fitted points at the model's size, metres; `size`: factor to the face's own size; `depth`: if there is any.
pub fn inputs(
    shape: &[f32],
    turn: &Vector,
    head: &[Point; LANDMARKS],
    size: f32,
    depth: Option<&[u16; PIXELS]>,
    camera: &Camera,
    sensor_from_face: &SensorFromFace,
) -> Inputs {
    let mut inputs = Inputs::new();
    let [x, y, z] = [turn.x, turn.y, turn.z];
    let seen = surface_offsets(head, size, depth, camera, sensor_from_face);
    let all = shape
        .iter()
        .copied()
        .chain([x, y, z, x * x, y * y, x * y])
        .chain(seen);
    // Capacity for the most modes.
    inputs.extend(all.take(MAX_INPUTS));
    inputs
}

/// Distance of the measured surface before the fit at each site, metres at the model's size; NaN without depth.
pub fn surface_offsets(
    head: &[Point; LANDMARKS],
    size: f32,
    depth: Option<&[u16; PIXELS]>,
    camera: &Camera,
    sensor_from_face: &SensorFromFace,
) -> heapless::Vec<f32, SITES> {
    let offsets = sites(head).map(|site| {
        depth
            .and_then(|depth| relief::height(depth, camera, sensor_from_face, &(site * size)))
            .map_or(f32::NAN, |height| height / size + site.z)
    });
    offsets.collect()
}

#[cfg(test)]
mod tests {
    use super::relief::plane;
    use super::*;
    use crate::base::geometry::Rigid;

    #[test]
    fn a_surface_before_a_larger_face_is_nearer_by_as_much_at_the_models_size() {
        let camera = Camera::default();
        let (size, slope) = (1.25, 0.2);
        let depth = plane(&camera, slope);
        // The face's origin is a centimetre behind the surface, which falls back to its right.
        let pose = SensorFromFace::assume_frames(Rigid::translation(0.0, 0.0, 0.81));
        let head: [Point; LANDMARKS] =
            core::array::from_fn(|i| Point::new(0.001 * i as f32, 0.03, 0.004));
        let turn = Vector::new(0.2, -0.3, 0.1);
        let inputs = inputs(
            &[1.5, -2.5],
            &turn,
            &head,
            size,
            Some(&depth),
            &camera,
            &pose,
        );
        assert_eq!(inputs[..2], [1.5, -2.5]);
        for (found, expected) in inputs[2..8].iter().zip([0.2, -0.3, 0.1, 0.04, 0.09, -0.06]) {
            assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        }
        assert_eq!(inputs.len(), 8 + SITES);
        // The sensor's steps are 2 mm here.
        for (by, site) in inputs[8..].iter().zip(sites(&head)) {
            let nearer = (0.01 - slope * site.x * size) / size + site.z;
            assert!((by - nearer).abs() < 0.0012, "{by} {nearer} at {site}");
        }
        // Beside the plane nothing is measured.
        let away = SensorFromFace::assume_frames(Rigid::translation(3.0, 0.0, 0.81));
        let none = surface_offsets(&head, size, Some(&depth), &camera, &away);
        assert!(none.iter().all(|by| by.is_nan()));
    }
}
