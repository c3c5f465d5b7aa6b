//! A Kinect's calibration as a [`Camera`], the form the stages use.
//!
//! Method: the sensor's own factory calibration, as its drivers use it. Raw disparity to distance by triangulation
//! against the reference plane; depth pixel to colour pixel by a cubic polynomial of column and row plus a shift along
//! the row that depends on distance (the baseline between the cameras). The driver's fixed-point form is
//! [`super::table::RegistrationTable`]; truncated to whole pixels this is that table.

use super::optics::{DEVICE_OFFSET, FARTHEST_MM, Optics, boxed};
use super::registration::Registration;
use super::table::Axis;
use crate::base::capacity::{HEIGHT, RAW_DEPTH_VALUES, WIDTH};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::sensor::camera::{Camera, Picture, Pinhole};

/// Columns without data at the right side of the depth picture.
pub const BLANK_COLUMNS: usize = 8;

/// The usual optics and a real unit's registration block.
#[must_use]
pub fn nominal() -> Camera {
    Registration::default().camera()
}

impl Registration {
    /// Both cameras, from the numbers read from a device.
    #[must_use]
    pub fn camera(&self) -> Camera {
        let optics = Optics::new(self);
        let mut metres = boxed(0.0f32);
        // The last value means "none" and keeps its zero.
        for raw in 0..RAW_DEPTH_VALUES - 1 {
            if let Some(mm) = optics.millimetres(raw as f64)
                && mm > 0.0
                && mm < FARTHEST_MM
            {
                metres[raw] = (mm * 1e-3) as f32;
            }
        }
        let far = 4.0 * (optics.emitter / optics.pixel + optics.shift + DEVICE_OFFSET);
        let near = 4.0 * optics.emitter * optics.reference / (100.0 * optics.pixel);
        let baseline = optics.baseline / (2.0 * optics.pixel);
        let depth = Pinhole {
            focal: [(optics.reference / (2.0 * optics.pixel)) as f32; 2],
            centre: [320.0, 240.0],
        };
        let picture = Picture::Polynomial {
            displacement: Box::new(Axis::both(&self.integers).map(|axis| axis.polynomial())),
            shift: [
                baseline + DEVICE_OFFSET,
                -baseline * optics.reference / 100.0,
            ],
        };
        let size = [WIDTH - BLANK_COLUMNS, HEIGHT];
        Camera::new(metres, [far, near], depth, size, picture)
    }

    /// Distance of a raw depth value in whole millimetres, truncated, at most 10 000: what the drivers deliver. 0 = none.
    #[must_use]
    pub fn depth_mm(&self, raw: u16) -> u16 {
        let known = usize::from(raw) < RAW_DEPTH_VALUES - 1;
        let mm = known.then(|| Optics::new(self).millimetres(raw.into()));
        mm.flatten()
            .map_or(0, |mm| mm.clamp(0.0, FARTHEST_MM) as u16)
    }
}

#[cfg(test)]
mod tests {
    use super::super::registration::RegistrationIntegers;
    use super::super::table::RegistrationTable;
    use super::*;
    use crate::base::geometry::Point;

    #[test]
    fn raw_values_are_the_reference_distances() {
        let optics = Optics::new(&Registration::default());
        let camera = nominal();
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
            assert_eq!(Registration::default().depth_mm(raw), mm as u16);
            assert!((f64::from(camera.depth_m(raw)) - exact * 1e-3).abs() < 1e-6);
        }
        assert!((optics.millimetres(1050.0).unwrap() - 8767.0).abs() < 0.06);
    }

    #[test]
    fn values_without_a_distance_are_zero() {
        let camera = nominal();
        for raw in [1090, 1500, 2046, 2047, 2048, u16::MAX] {
            assert_eq!(camera.depth_m(raw), 0.0, "raw {raw}");
            assert_eq!(Registration::default().depth_mm(raw), 0, "raw {raw}");
        }
        // Still a ray that meets, but too far to be delivered: the drivers cap it, we have no measurement.
        assert_eq!(
            (Registration::default().depth_mm(1080), camera.depth_m(1080)),
            (10_000, 0.0)
        );
    }

    #[test]
    fn distance_and_raw_value_are_inverse() {
        let camera = nominal();
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
        let camera = nominal();
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
        let (camera, table) = (registration.camera(), RegistrationTable::new(&registration));
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
