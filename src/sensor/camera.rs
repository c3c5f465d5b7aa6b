//! Geometry of both cameras: raw depth to metres, pixels to points, points to colour pixels.
//!
//! Method: the sensor's own factory calibration, as its drivers use it. Raw disparity to distance by triangulation
//! against the reference plane; depth pixel to colour pixel by a cubic polynomial of column and row plus a shift along
//! the row that depends on distance (the baseline between the cameras).
//!
//! * [`Registration`]: the numbers read from the device.
//! * [`Camera`]: used by the stages; continuous, no integer steps.
//! * [`RegistrationTable`]: the driver's fixed-point table, entry for entry; the reference for the continuous form, also used
//!   to overlay colour on depth in pictures.
//!
//! Frames and units: sensor frame in metres ([`crate::base::geometry`]); pixel centres are integers; `_mm` where millimetres.
//! Memory: [`Camera`] 12 kB, [`RegistrationTable`] 1.9 MB, both on the heap, built once. Cost: `colour_pixel` about 40
//! multiplications. Degenerate: a raw value without a distance gives 0; a point at z ≤ 0 projects to nothing useful (the
//! result may be infinite). Limitation: no lens distortion beyond what the device's polynomial holds.

mod mapping;
mod optics;
mod registration;

pub use mapping::RegistrationTable;
pub use registration::{Padding, Registration, RegistrationIntegers, ZeroPlane};

use crate::base::capacity::RAW_DEPTH_VALUES;
use crate::base::geometry::Point;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use mapping::{Axis, Cubic};
use optics::{DEVICE_OFFSET, FARTHEST_MM, Optics, boxed};

/// Column of the optical axis in the depth picture.
const CENTRE_COLUMN: f32 = 320.0;
/// Row of the optical axis in the depth picture.
const CENTRE_ROW: f32 = 240.0;

/// Geometry of both cameras in the form the stages use: continuous and differentiable.
#[derive(Clone, Debug)]
pub struct Camera {
    registration: Registration,
    metres: Box<[f32; RAW_DEPTH_VALUES]>,
    millimetres: Box<[u16; RAW_DEPTH_VALUES]>,
    optics: Optics,
    /// Focal length of the depth camera, pixels.
    focal: f32,
    displacement: [Cubic; 2],
}

impl Camera {
    /// The usual optics and a real unit's registration block.
    #[must_use]
    pub fn nominal() -> Self {
        Self::new(&Registration::default())
    }

    /// From the numbers read from a device.
    #[must_use]
    pub fn new(registration: &Registration) -> Self {
        let optics = Optics::new(registration);
        let mut metres = boxed(0.0f32);
        let mut millimetres = boxed(0u16);
        // The last value means "none" and keeps its zero.
        for raw in 0..RAW_DEPTH_VALUES - 1 {
            let Some(mm) = optics.millimetres(raw as f64) else {
                continue;
            };
            millimetres[raw] = mm.clamp(0.0, FARTHEST_MM) as u16;
            if mm > 0.0 && mm < FARTHEST_MM {
                metres[raw] = (mm * 1e-3) as f32;
            }
        }
        Self {
            registration: registration.clone(),
            metres,
            millimetres,
            optics,
            focal: (optics.reference / (2.0 * optics.pixel)) as f32,
            displacement: Axis::both(&registration.integers).map(|axis| axis.polynomial()),
        }
    }

    /// The numbers this camera was built from.
    #[must_use]
    pub fn registration(&self) -> &Registration {
        &self.registration
    }

    /// Focal length of the depth camera, pixels.
    #[must_use]
    pub fn depth_focal_px(&self) -> f32 {
        self.focal
    }

    /// Distance along z of a raw depth value, metres; 0 = none (no measurement, or 10 m and beyond).
    #[must_use]
    pub fn depth_m(&self, raw: u16) -> f32 {
        self.metres.get(usize::from(raw)).copied().unwrap_or(0.0)
    }

    /// The same in whole millimetres, truncated, at most 10 000: what the drivers deliver. 0 = none.
    #[must_use]
    pub fn depth_mm(&self, raw: u16) -> u16 {
        self.millimetres.get(usize::from(raw)).copied().unwrap_or(0)
    }

    /// The raw value, not rounded, of a distance `z` > 0 in metres: the inverse of [`Self::depth_m`].
    ///
    /// ```
    /// let camera = mien::sensor::camera::Camera::nominal();
    /// assert!((camera.raw_from_m(camera.depth_m(700)) - 700.0).abs() < 0.01);
    /// ```
    #[must_use]
    pub fn raw_from_m(&self, z: f32) -> f32 {
        let o = &self.optics;
        let m = o.emitter * (1.0 - o.reference / (f64::from(z) * 100.0));
        (4.0 * (m / o.pixel + o.shift + DEVICE_OFFSET)) as f32
    }

    /// The point seen by a depth pixel at distance `z` metres, sensor frame.
    #[must_use]
    pub fn point(&self, col: f32, row: f32, z: f32) -> Point {
        let scale = z / self.focal;
        Point::new((col - CENTRE_COLUMN) * scale, (row - CENTRE_ROW) * scale, z)
    }

    /// Depth pixel (column, row) of a point of the sensor frame with z > 0.
    #[must_use]
    pub fn depth_pixel(&self, p: &Point) -> [f32; 2] {
        let scale = self.focal / p.z;
        [p.x * scale + CENTRE_COLUMN, p.y * scale + CENTRE_ROW]
    }

    /// Colour pixel (column, row) of a point of the sensor frame with z > 0. Smooth; truncated to whole pixels it is the
    /// drivers' table.
    #[must_use]
    pub fn colour_pixel(&self, p: &Point) -> [f32; 2] {
        let [col, row] = self.depth_pixel(p).map(f64::from);
        let [dx, dy] = [0, 1].map(|axis| self.displacement[axis].at(col, row));
        let shift = self.optics.colour_shift(f64::from(p.z) * 1e3);
        [(col + dx + 1.0 + shift) as f32, (row + dy + 1.0) as f32]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::capacity::{HEIGHT, WIDTH};

    #[test]
    fn raw_values_are_the_reference_distances() {
        let optics = Optics::new(&Registration::default());
        let camera = Camera::nominal();
        for (raw, mm) in [
            (300, 437.66),
            (400, 501.14),
            (500, 586.16),
            (600, 705.93),
            (700, 887.22),
            (800, 1193.78),
            (900, 1824.05),
            (1000, 3864.19),
        ] {
            let exact = optics.millimetres(f64::from(raw)).unwrap();
            assert!((exact - mm).abs() < 0.006, "raw {raw}: {exact} mm");
            assert_eq!(camera.depth_mm(raw), mm as u16);
            assert!((f64::from(camera.depth_m(raw)) - exact * 1e-3).abs() < 1e-6);
        }
        assert!((optics.millimetres(1050.0).unwrap() - 8767.0).abs() < 0.06);
    }

    #[test]
    fn values_without_a_distance_are_zero() {
        let camera = Camera::nominal();
        for raw in [1090, 1500, 2046, 2047, 2048, u16::MAX] {
            assert_eq!(camera.depth_m(raw), 0.0, "raw {raw}");
            assert_eq!(camera.depth_mm(raw), 0, "raw {raw}");
        }
        // Still a ray that meets, but too far to be delivered: the drivers cap it, we have no measurement.
        assert_eq!((camera.depth_mm(1080), camera.depth_m(1080)), (10_000, 0.0));
    }

    #[test]
    fn distance_and_raw_value_are_inverse() {
        let camera = Camera::nominal();
        for raw in 300..1050u16 {
            let back = camera.raw_from_m(camera.depth_m(raw));
            assert!(
                (back - f32::from(raw)).abs() < 2e-3,
                "{raw} came back as {back}"
            );
        }
    }

    #[test]
    fn a_pixel_is_the_reference_point_and_back() {
        let camera = Camera::nominal();
        let p = camera.point(100.0, 50.0, 1.0);
        assert!((p - Point::new(-0.382_066_7, -0.329_966_7, 1.0)).norm() < 1e-6);
        let [col, row] = camera.depth_pixel(&p);
        assert!((col - 100.0).abs() < 1e-3 && (row - 50.0).abs() < 1e-3);
        assert!((camera.depth_focal_px() - 575.8).abs() < 0.05);
    }

    #[test]
    fn every_entry_of_the_table_is_the_drivers() {
        let table = RegistrationTable::new(&Registration::default());
        for (col, row, x, y) in [
            (0, 0, 6422, 26),
            (639, 0, 160_281, 25),
            (0, 479, 6788, 475),
            (639, 479, 159_662, 476),
            (320, 240, 83_099, 253),
            (100, 50, 30_987, 76),
            (500, 400, 125_591, 400),
        ] {
            let pixel = row * WIDTH + col;
            assert_eq!(
                (table.x[pixel], table.y[pixel]),
                (x, y),
                "pixel ({col}, {row})"
            );
        }
        let hash = table
            .x
            .iter()
            .zip(table.y.iter())
            .flat_map(|(&x, &y)| [u64::from(x), u64::from(y as u32)])
            .fold(1_469_598_103_934_665_603u64, |h, word| {
                (h ^ word).wrapping_mul(1_099_511_628_211)
            });
        assert_eq!(hash, 0x27b9_268f_4482_7983);
        for (z_mm, shift) in [
            (500, -4031),
            (600, -2852),
            (800, -1378),
            (1000, -493),
            (1200, 96),
            (2000, 1275),
            (4000, 2159),
        ] {
            assert_eq!(table.shift[z_mm], shift, "shift at {z_mm} mm");
        }
    }

    #[test]
    fn the_smooth_form_is_the_table_within_truncation() {
        let registration = Registration::default();
        let (camera, table) = (
            Camera::new(&registration),
            RegistrationTable::new(&registration),
        );
        let mut worst = [0.0f64; 2];
        for row in (0..HEIGHT).step_by(3) {
            for col in (0..WIDTH).step_by(3) {
                let pixel = row * WIDTH + col;
                for z_mm in [500u16, 800, 1700, 4000] {
                    if table.x[pixel] == 1280 * 256 {
                        continue;
                    }
                    let p = camera.point(col as f32, row as f32, f32::from(z_mm) * 1e-3);
                    let [x, y] = camera.colour_pixel(&p).map(f64::from);
                    let table_x =
                        f64::from(table.x[pixel] as i32 + table.shift[usize::from(z_mm)]) / 256.0;
                    worst[0] = worst[0].max((x - table_x).abs());
                    // The table's rows are truncated: half a pixel lower on average, never more than one.
                    worst[1] = worst[1].max((y - 0.5 - f64::from(table.y[pixel])).abs());
                }
            }
        }
        println!("worst column and row difference, px: {worst:?}");
        assert!(worst[0] < 0.02, "columns differ by {} px", worst[0]);
        assert!(worst[1] < 0.52, "rows differ by {} px", worst[1]);
    }

    #[test]
    fn integers_are_found_by_their_names() {
        let mut integers = RegistrationIntegers::zero();
        for (i, name) in RegistrationIntegers::NAMES.iter().enumerate() {
            *integers.by_name(name).unwrap() = i as i32;
        }
        assert_eq!(integers.to_array(), core::array::from_fn(|i| i as i32));
        assert!(integers.by_name("nonsense").is_none());
    }
}
