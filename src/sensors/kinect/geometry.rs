//! A Kinect's calibration as a [`Camera`], the form the stages use.
//!
//! Method: the sensor's factory calibration, as used by its drivers. Distance from raw disparity by triangulation against the
//! reference plane; colour pixel from depth pixel by a cubic polynomial of column and row plus a shift along the row that depends
//! on distance (the baseline between the cameras). The device stores the polynomial as forward differences in fixed point, stepped
//! with truncating shifts; truncated to whole pixels, ours equals the drivers' table (`tests/it/maps_depth_to_colour.rs`).

use super::registration::Registration;
use super::unpack::NO_READING;
use mien_stages::base::capacity::{HEIGHT, WIDTH};
use mien_stages::base::prelude::*;
use mien_stages::camera::{Camera, ColourProjection, Cubic, DepthScale, Pinhole};

/// Columns without data at the right edge of the depth picture.
pub const BLANK_COLUMNS: usize = 8;
/// Distance from which raw values are no measurements, millimetres.
const FARTHEST_MM: f64 = 10_000.0;
/// Offset that the device's arithmetic applies to raw values and to the colour shift, pixels.
const DEVICE_OFFSET: f64 = 0.375;

/// Geometry of the nominal calibration: the usual optics and a real unit's registration block.
pub fn nominal() -> Camera {
    Registration::default().camera()
}

impl Registration {
    /// Geometry of both cameras.
    pub fn camera(&self) -> Camera {
        let plane = &self.zero_plane;
        let [emitter, between, reference, pixel] = [
            plane.dcmos_emitter_distance,
            plane.dcmos_rcmos_distance,
            plane.reference_distance,
            plane.reference_pixel_size,
        ]
        .map(f64::from);
        let shift = f64::from(self.const_shift);
        let metres = |raw: u16| {
            let raw = f64::from(raw);
            let m = (raw / 4.0 - shift - DEVICE_OFFSET) * pixel;
            let mm = 10.0 * (m * reference / (emitter - m) + reference);
            // For m ≥ emitter the rays of emitter and pixel do not meet.
            let is_measured = m < emitter && mm > 0.0 && mm < FARTHEST_MM;
            if is_measured { (mm * 1e-3) as f32 } else { 0.0 }
        };
        let far = 4.0 * (emitter / pixel + shift + DEVICE_OFFSET);
        let near = 4.0 * emitter * reference / (100.0 * pixel);
        let baseline = between / (2.0 * pixel);
        let depth = Pinhole {
            focal: [(reference / (2.0 * pixel)) as f32; 2],
            centre: [320.0, 240.0],
        };
        let picture = ColourProjection::Polynomial {
            displacement: Box::new(displacement(&self.integers)),
            shift: [baseline + DEVICE_OFFSET, -baseline * reference / 100.0],
        };
        let size = [WIDTH - BLANK_COLUMNS, HEIGHT];
        let scale = DepthScale::inverse((0..NO_READING).map(metres).collect(), [far, near]);
        Camera::new(scale, depth, size, picture)
    }
}

/// Displacement of column and of row between depth and colour pixel, as polynomials, pixels.
fn displacement(r: &[i32; 29]) -> [Cubic; 2] {
    [0, 1].map(|k| {
        // ak, bk, ck, dk; dk_start, dxdk_start, dydk_start; dxdxdk_start, dydxdk_start, dydydk_start.
        polynomial(
            [1, 2, 3, 4].map(|n| r[n + 5 * k]),
            [r[5 + 5 * k], r[17 + k], r[19 + k]],
            [21, 22, 26].map(|n| r[n + 2 * k]),
        )
    })
}

/// Value of the low `bits` as a signed number, times 2^`shift`.
fn signed(value: i32, bits: u32, shift: u32) -> f64 {
    f64::from(value << (32 - bits) >> (32 - bits)) * f64::from(1 << shift)
}

/// The polynomial of one axis from its forward differences: `third` (row, column and the two mixed ones), the value with the first
/// differences, and `second`. Sums of differences are binomials: after n steps, a constant third difference has added up to
/// n(n−1)(n−2)/6, a second one to n(n−1)/2. A truncating shift loses half a unit on average; subtracting that half leaves an error
/// of a few thousandths of a pixel at the far corner.
fn polynomial(third: [i32; 4], [v, vc, vr]: [i32; 3], second: [i32; 3]) -> Cubic {
    let [a, b, c, d] = third.map(f64::from);
    let v = signed(v, 19, 9);
    let [vc, vr] = [vc, vr].map(|first| signed(first, 21, 8) - 32.0);
    let [vcc, vrc, vrr] = second.map(|second| signed(second, 24, 8) - 128.0);
    // Fraction bits: first differences have 6 more than the value, second and third ones 8 more than the first.
    let (first, second) = (1.0 / 64.0, 1.0 / (64.0 * 256.0));
    let unit = 1.0 / f64::from(1 << 17);
    let binomial2 = |k: f64| [0.0, -0.5 * k, 0.5 * k, 0.0];
    let binomial3 = |k: f64| [0.0, k / 3.0, -0.5 * k, k / 6.0];
    let mut t = [[0.0; 4]; 4]; // t[i][j]: column^i, n^j
    let mut add = |i: usize, j: [f64; 4]| {
        for (to, from) in t[i].iter_mut().zip(j) {
            *to += from * unit;
        }
    };
    add(0, [v, vr * first, 0.0, 0.0]);
    add(0, binomial2(vrr * second));
    add(0, binomial3(b * second));
    // Change per column, a quadratic of n.
    add(1, [vc * first, vrc * second, 0.0, 0.0]);
    add(1, binomial2(d * second));
    // Second difference along the row, linear in n; binomial of the column.
    add(1, [-0.5 * vcc * second, -0.5 * c * second, 0.0, 0.0]);
    add(2, [0.5 * vcc * second, 0.5 * c * second, 0.0, 0.0]);
    for (i, k) in binomial3(a * second).into_iter().enumerate().skip(1) {
        add(i, [k, 0.0, 0.0, 0.0]);
    }
    Cubic(t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::base::geometry::Point;

    #[test]
    fn raw_values_are_the_reference_distances() {
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
            (1050, 8767.0),
        ] {
            let found = 1e3 * camera.depth_m(raw);
            assert!((found - mm).abs() < 0.06, "raw {raw}: {found} mm");
        }
    }

    #[test]
    fn values_without_a_distance_are_zero() {
        let camera = nominal();
        for raw in [1090, 1500, 2046, 2047, 2048, u16::MAX] {
            assert_eq!(camera.depth_m(raw), 0.0, "raw {raw}");
        }
        // Still a ray that meets, but too far to be delivered: the drivers cap it, we have no measurement.
        assert_eq!(camera.depth_m(1080), 0.0);
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
}
