//! The head window: the face resampled upright and at a fixed scale from the whole colour image.
//!
//! The head's pose gives the pixel of its origin ([`Camera::colour_pixel`]) and the 2×3 Jacobian of colour pixels there, by central
//! differences. The Jacobian gives the axes of a virtual camera that looks straight at the head. The window is that camera's image, rotated
//! upright; a homography from four points of the plane through the head's origin maps it to the colour image, so a head at the edge of
//! the image looks as in the middle. Units: pixels, metres, radians. Cost: one bilinear look-up per window pixel, at most 34
//! thousand. Degenerate: a rank-deficient Jacobian (head at the camera) gives no placement. Outside the image its border is repeated.

use core::ops::Range;

use nalgebra::{Matrix3, SMatrix, SVector};

use super::view::View;
use crate::base::capacity::{HEIGHT, WIDTH};
use crate::base::geometry::{Point, Rigid, Rotation, Vector};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::vectors::{NO_FRACTION, with_avx2};
use crate::camera::Camera;

/// Side of the window, pixels.
pub const WINDOW: usize = 184;
/// Window pixels per metre: a face 0.145 m wide is 100 px.
pub const PIXELS_PER_METRE: f32 = 690.0;
/// Window pixel of the head's origin: brows to chin fit with an open jaw and 20° of pitch.
pub const ORIGIN: [f32; 2] = [91.5, 66.0];
/// Half the base of the central differences, metres: large against the steps of calibration tables.
const DIFFERENCE: f32 = 0.03;
/// Least side of a region, pixels.
const LEAST_REGION: usize = 32;

/// The used part of a window: rows and columns with even bounds, pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Region {
    /// Pixel rows.
    pub rows: Range<usize>,
    /// Pixel columns.
    pub columns: Range<usize>,
}

impl Region {
    /// The whole window.
    pub const WHOLE: Self = Self {
        rows: 0..WINDOW,
        columns: 0..WINDOW,
    };

    /// Bounding box of points (window pixels) with a margin in pixels; at least 32 pixels wide and high.
    pub fn around(points: &[[f32; 2]], margin: f32) -> Self {
        let along = |axis: usize| {
            let values = points.iter().map(|point| point[axis]);
            let low = values.clone().fold(f32::MAX, f32::min) - margin;
            let high = values.fold(f32::MIN, f32::max) + margin;
            let most = WINDOW - LEAST_REGION;
            let first = (low.max(0.0) as usize / 2 * 2).min(most);
            let end = (high.clamp(0.0, WINDOW as f32) as usize + 2) / 2 * 2;
            first..end.clamp(first + LEAST_REGION, WINDOW)
        };
        Self {
            rows: along(1),
            columns: along(0),
        }
    }
}

/// A grey image.
#[derive(Clone, Copy)]
pub struct LumaImage<'a> {
    /// Grey values, row by row.
    pub luma: &'a [u8],
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl LumaImage<'_> {
    /// Bilinear grey value at a pixel; the border is repeated.
    pub fn bilinear(&self, x: f32, y: f32) -> f32 {
        let x = x.clamp(0.0, (self.width - 1) as f32 - 1e-3);
        let y = y.clamp(0.0, (self.height - 1) as f32 - 1e-3);
        let (column, row) = (x as usize, y as usize);
        let (fx, fy) = (x - column as f32, y - row as f32);
        let at = row * self.width + column;
        let value = |at: usize| f32::from(self.luma[at]);
        let top = value(at) + (value(at + 1) - value(at)) * fx;
        let below = at + self.width;
        let bottom = value(below) + (value(below + 1) - value(below)) * fx;
        top + (bottom - top) * fy
    }
}

/// Position of a window in an image.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    /// Homography from window pixels relative to [`ORIGIN`] to image pixels.
    pub image_from_window: Matrix3<f32>,
    window_from_image: Matrix3<f32>,
    /// Rotation of the window relative to the image or the virtual camera, radians.
    pub roll: f32,
    /// View of the depth pose in the window: upright, at [`PIXELS_PER_METRE`], origin at [`ORIGIN`].
    pub start: View,
}

/// Splits a rotation into `(roll, upright)` with `rotation = Rz(roll) upright`.
fn upright(rotation: &Rotation) -> (f32, Rotation) {
    let down = rotation * Vector::y();
    let roll = (-down.x).atan2(down.y);
    (
        roll,
        Rotation::from_axis_angle(&Vector::z_axis(), -roll) * rotation,
    )
}

/// Homography that maps four points to four others; `None` if three of them are collinear.
fn homography(from: &[[f32; 2]; 4], to: &[[f32; 2]; 4]) -> Option<Matrix3<f32>> {
    let mut rows = SMatrix::<f64, 8, 8>::zeros();
    let mut right = SVector::<f64, 8>::zeros();
    for k in 0..4 {
        let [x, y] = from[k].map(f64::from);
        for axis in 0..2 {
            let u = f64::from(to[k][axis]);
            let row = 2 * k + axis;
            for (column, value) in [(3 * axis, x), (3 * axis + 1, y), (3 * axis + 2, 1.0)] {
                rows[(row, column)] = value;
            }
            rows[(row, 6)] = -x * u;
            rows[(row, 7)] = -y * u;
            right[row] = u;
        }
    }
    let h = rows.lu().solve(&right)?;
    Some(Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0).cast())
}

fn mapped(map: &Matrix3<f32>, x: f32, y: f32) -> [f32; 2] {
    let p = map * Vector::new(x, y, 1.0);
    [p.x / p.z, p.y / p.z]
}

/// Integer and fractional part of `x`, 0 to a few thousand.
#[inline(always)]
fn split(x: f32) -> (u32, f32) {
    let rounded = (x - 0.5) + NO_FRACTION;
    (
        rounded.to_bits() - NO_FRACTION.to_bits(),
        x - (rounded - NO_FRACTION),
    )
}

impl Placement {
    /// Placement from the depth pose (metres); `None` if the head is at the camera or its projection is not finite.
    pub fn from_pose(camera: &Camera, sensor_from_head: &Rigid) -> Option<Self> {
        let origin = sensor_from_head * Point::origin();
        let slope = |axis: Vector| {
            let [x1, y1] = camera.colour_pixel(&(origin + axis * DIFFERENCE));
            let [x0, y0] = camera.colour_pixel(&(origin - axis * DIFFERENCE));
            [
                (x1 - x0) / (2.0 * DIFFERENCE),
                (y1 - y0) / (2.0 * DIFFERENCE),
            ]
        };
        let (dx, dy, dz) = (slope(Vector::x()), slope(Vector::y()), slope(Vector::z()));
        let across = Vector::new(dx[0], dy[0], dz[0]);
        let ray = across
            .cross(&Vector::new(dx[1], dy[1], dz[1]))
            .try_normalize(1e-3)?;
        let right = across.try_normalize(1e-3)?;
        let down = ray.cross(&right);
        let axes = Matrix3::from_rows(&[right.transpose(), down.transpose(), ray.transpose()]);
        let view_from_sensor =
            Rotation::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(axes));
        let (roll, rotation) = upright(&(view_from_sensor * sensor_from_head.rotation));
        let (sin, cos) = roll.sin_cos();
        let corners = [[-60.0, -50.0], [60.0, -50.0], [60.0, 80.0], [-60.0, 80.0]];
        let seen = corners.map(|[x, y]: [f32; 2]| {
            let along = right * (x * cos - y * sin) + down * (x * sin + y * cos);
            camera.colour_pixel(&(origin + along / PIXELS_PER_METRE))
        });
        if seen.iter().flatten().any(|v| !v.is_finite()) {
            return None;
        }
        let map = homography(&corners, &seen)?;
        let inverse_distance = 1.0 / origin.coords.norm().max(0.1);
        Self::new(map, roll, rotation, inverse_distance)
    }

    fn new(
        image_from_window: Matrix3<f32>,
        roll: f32,
        rotation: Rotation,
        inverse_distance: f32,
    ) -> Option<Self> {
        Some(Self {
            image_from_window,
            window_from_image: image_from_window.try_inverse()?,
            roll,
            start: View {
                log_scale: PIXELS_PER_METRE.ln(),
                rotation,
                shift: ORIGIN,
                inverse_distance,
            },
        })
    }

    /// Placement in the image of a camera that looks straight at the head, from the head's view in image pixels.
    pub fn from_view(view: &View) -> Self {
        let (roll, rotation) = upright(&view.rotation);
        let (sin, cos) = roll.sin_cos();
        let scale = view.log_scale.exp().max(1e-3) / PIXELS_PER_METRE;
        let [x, y] = view.shift;
        let across = Vector::new(scale * cos, scale * sin, 0.0);
        let down = Vector::new(-scale * sin, scale * cos, 0.0);
        let map = Matrix3::from_columns(&[across, down, Vector::new(x, y, 1.0)]);
        let placement = Self::new(map, roll, rotation, view.inverse_distance);
        placement.expect("a turn and a scale above 0 have an inverse")
    }

    /// Window pixel to image pixel.
    pub fn image_pixel(&self, window: [f32; 2]) -> [f32; 2] {
        mapped(
            &self.image_from_window,
            window[0] - ORIGIN[0],
            window[1] - ORIGIN[1],
        )
    }

    /// Image pixel to window pixel.
    pub fn window_pixel(&self, image: [f32; 2]) -> [f32; 2] {
        let [x, y] = mapped(&self.window_from_image, image[0], image[1]);
        [x + ORIGIN[0], y + ORIGIN[1]]
    }

    /// Resamples a region of the window ([`WINDOW`]² grey values, row by row); the image's border is repeated.
    pub fn resample(&self, image: &LumaImage, region: &Region, window: &mut [f32]) {
        let mut sampler = RowSampler::new(self, *image);
        with_avx2(
            #[inline(always)]
            || {
                for row in region.rows.clone() {
                    let line = &mut window.as_chunks_mut::<WINDOW>().0[row];
                    sampler.sample(row, &region.columns, line);
                }
            },
        );
    }
}

/// Pixels in a vector. Rows are computed in whole vectors.
const BLOCK: usize = 8;

/// Resamples a window row by row. Positions, loads and weights have their own loops over a row: only the loads are not vectorised.
pub struct RowSampler<'a> {
    map: Matrix3<f32>,
    image: LumaImage<'a>,
    /// Index of the upper left pixel of each square of four.
    at: [u32; WINDOW],
    /// Its upper and lower pixels, two of a byte each.
    pairs: [[u16; WINDOW]; 2],
    /// Shares of the right and of the lower pixels.
    shares: [[f32; WINDOW]; 2],
}

impl<'a> RowSampler<'a> {
    /// For a window of an image.
    pub fn new(placement: &Placement, image: LumaImage<'a>) -> Self {
        Self {
            map: placement.image_from_window,
            image,
            at: [0; WINDOW],
            pairs: [[0; WINDOW]; 2],
            shares: [[0.0; WINDOW]; 2],
        }
    }

    /// Fills `columns` of a row, and up to seven pixels on either side; the image's border is repeated.
    #[inline(always)]
    pub fn sample(&mut self, row: usize, columns: &Range<usize>, line: &mut [f32; WINDOW]) {
        let (map, luma) = (self.map, self.image.luma);
        let width = self.image.width as u32 as usize;
        let most = [self.image.width, self.image.height].map(|size| (size - 1) as f32 - 1e-2);
        // Of equal length: one bounds check for all four values of a square.
        let (upper, lower) = (&luma[..luma.len() - width], &luma[width..]);
        let down = row as f32 - ORIGIN[1];
        // Homogeneous coordinates of the row's first pixel, linear along the row.
        let first = map.column(0) * -ORIGIN[0] + map.column(1) * down + map.column(2);
        let blocks = columns.start / BLOCK..columns.end.div_ceil(BLOCK).min(WINDOW / BLOCK);
        let whole = blocks.start * BLOCK..blocks.end * BLOCK;
        let [shares_x, shares_y] = &mut self.shares;
        let [pairs_above, pairs_below] = &mut self.pairs;
        let places = self.at[whole.clone()].iter_mut();
        let shares_x = &mut shares_x[whole.clone()];
        let shares_y = &mut shares_y[whole.clone()];
        // The column as i32: its conversion to f32 vectorises, that of usize does not.
        for (column, ((at, fx), fy)) in
            (whole.start as i32..).zip(places.zip(&mut *shares_x).zip(&mut *shares_y))
        {
            let along = column as f32;
            let inverse = 1.0 / (first.z + map.m31 * along);
            let x = ((first.x + map.m11 * along) * inverse)
                .max(0.0)
                .min(most[0]);
            let y = ((first.y + map.m21 * along) * inverse)
                .max(0.0)
                .min(most[1]);
            let ((left, part), (top, rest)) = (split(x), split(y));
            (*fx, *fy) = (part, rest);
            *at = top * width as u32 + left;
        }
        let places = self.at.as_chunks::<BLOCK>().0[blocks.clone()].iter();
        let above = &mut pairs_above.as_chunks_mut::<BLOCK>().0[blocks.clone()];
        let below = &mut pairs_below.as_chunks_mut::<BLOCK>().0[blocks];
        for ((places, above), below) in places.zip(above).zip(below) {
            for k in 0..BLOCK {
                let at = places[k] as usize;
                let pair = |line: &[u8]| {
                    let next = line[at + 1];
                    u16::from_le_bytes([line[at], next])
                };
                (above[k], below[k]) = (pair(upper), pair(lower));
            }
        }
        let pairs = pairs_above[whole.clone()]
            .iter()
            .zip(&pairs_below[whole.clone()]);
        let shares = shares_x.iter().zip(&*shares_y);
        for ((value, (above, below)), (fx, fy)) in line[whole].iter_mut().zip(pairs).zip(shares) {
            let [[a, b], [c, d]] =
                [above, below].map(|pair| [f32::from(pair & 0xff), f32::from(pair >> 8)]);
            let top = a + (b - a) * fx;
            let bottom = c + (d - c) * fx;
            *value = top + (bottom - top) * fy;
        }
    }
}

/// The sensor's whole grey image.
pub fn sensor_image(luma: &[u8; crate::base::capacity::PIXELS]) -> LumaImage<'_> {
    LumaImage {
        luma,
        width: WIDTH,
        height: HEIGHT,
    }
}

impl Placement {
    /// Converts a view from image to window pixels.
    pub fn window_view(&self, image: &View) -> View {
        self.transformed(image, -1.0, self.window_pixel(image.shift))
    }

    /// Converts a view from window to image pixels.
    pub fn image_view(&self, window: &View) -> View {
        self.transformed(window, 1.0, self.image_pixel(window.shift))
    }

    fn transformed(&self, view: &View, way: f32, shift: [f32; 2]) -> View {
        let map = &self.image_from_window;
        View {
            log_scale: view.log_scale + way * map[(0, 0)].hypot(map[(1, 0)]).ln(),
            rotation: Rotation::from_axis_angle(&Vector::z_axis(), way * self.roll) * view.rotation,
            shift,
            ..*view
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::rotation_from_yaw_pitch_roll;

    #[test]
    fn the_window_shows_the_points_where_the_camera_does() {
        let camera = Camera::default();
        for (x, y, z, yaw, roll) in [
            (0.0, 0.0, 0.8, 0.0, 0.0),
            (0.2, -0.1, 0.9, 0.3, 0.4),
            (-0.25, 0.15, 1.2, -0.3, -0.3),
        ] {
            let pose = Rigid::from_parts(
                nalgebra::Translation3::new(x, y, z),
                rotation_from_yaw_pitch_roll(yaw, 0.1, roll),
            );
            let placement = Placement::from_pose(&camera, &pose).expect("in view");
            for point in [
                Point::new(0.045, 0.0, 0.01),
                Point::new(-0.045, 0.0, 0.01),
                Point::new(0.0, 0.1, 0.0),
                Point::new(0.0, 0.04, -0.03),
            ] {
                let seen = camera.colour_pixel(&(pose * point));
                let said = placement.image_pixel(placement.start.project(&point));
                let off = (seen[0] - said[0]).hypot(seen[1] - said[1]);
                assert!(off < 0.35, "{seen:?} {said:?} at {x} {y} {z}");
            }
        }
    }

    #[test]
    fn every_window_pixel_is_interpolated_from_its_four_neighbours() {
        let mut random = fastrand::Rng::with_seed(4);
        let luma: Vec<u8> = (0..WIDTH * HEIGHT).map(|_| random.u8(..)).collect();
        let image = LumaImage {
            luma: &luma,
            width: WIDTH,
            height: HEIGHT,
        };
        let head = Rigid::from_parts(
            Vector::new(0.02, -0.03, 0.8).into(),
            rotation_from_yaw_pitch_roll(0.3, 0.1, 0.2),
        );
        let placement = Placement::from_pose(&Camera::default(), &head).expect("in the image");
        let mut window = vec![0.0; WINDOW * WINDOW];
        placement.resample(&image, &Region::WHOLE, &mut window);
        for (k, value) in window.iter().enumerate().step_by(7) {
            let [x, y] = placement.image_pixel([(k % WINDOW) as f32, (k / WINDOW) as f32]);
            let expected = image.bilinear(x, y);
            // A thousandth of a pixel in an image of noise.
            assert!((value - expected).abs() < 1.0, "{k}: {value} {expected}");
        }
    }

    #[test]
    fn split_parts_add_up() {
        for x in [0.0, 0.25, 0.5, 0.999, 1.0, 1.5, 638.99, 639.0] {
            let (whole, rest) = split(x);
            assert_eq!(whole as f32 + rest, x);
            assert!((0.0..=1.0).contains(&rest), "{x}: {whole} {rest}");
        }
    }

    #[test]
    fn the_window_is_upright() {
        let pose = Rigid::from_parts(
            nalgebra::Translation3::new(0.1, 0.0, 0.8),
            rotation_from_yaw_pitch_roll(0.2, 0.1, 0.5),
        );
        let placement = Placement::from_pose(&Camera::default(), &pose).expect("in view");
        let down = placement.start.rotation * Vector::y();
        assert!(down.x.abs() < 1e-5 && down.y > 0.9);
    }
}
