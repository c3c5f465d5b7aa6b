//! The mapping from depth to colour pixels as the Kinect's drivers make it: the device's forward differences in fixed point,
//! stepped with truncating shifts, whose values depend on the order of the steps. The library's [`Camera`] is the smooth
//! form of it.
//!
//! [`Camera`]: mien_stages::camera::Camera

use mien_sensors::kinect::registration::Registration;
use mien_stages::base::capacity::{HEIGHT, PIXELS, WIDTH};

/// Distances are delivered below this, millimetres.
const FARTHEST_MM: u16 = 10_000;
/// Offset which the device's own arithmetic applies, pixels.
const DEVICE_OFFSET: f64 = 0.375;

/// The polynomial of one axis as forward differences in fixed point: third differences, value, and the first and second ones.
struct Axis {
    third: [i64; 4],
    v: i64,
    vc: i64,
    vr: i64,
    vcc: i64,
    vrc: i64,
    vrr: i64,
}

/// The low `bits` of `value`, as a signed number.
fn signed(value: i32, bits: u32) -> i64 {
    i64::from(value << (32 - bits) >> (32 - bits))
}

impl Axis {
    fn new(third: [i32; 4], [v, vc, vr]: [i32; 3], [vcc, vrc, vrr]: [i32; 3]) -> Self {
        Self {
            third: third.map(i64::from),
            v: signed(v, 19) << 9,
            vc: signed(vc, 21) << 8,
            vr: signed(vr, 21) << 8,
            vcc: signed(vcc, 24) << 8,
            vrc: signed(vrc, 24) << 8,
            vrr: signed(vrr, 24) << 8,
        }
    }

    fn both(r: &[i32; 29]) -> [Self; 2] {
        [0, 1].map(|k| {
            Self::new(
                [1, 2, 3, 4].map(|n| r[n + 5 * k]),
                [r[5 + 5 * k], r[17 + k], r[19 + k]],
                [21, 22, 26].map(|n| r[n + 2 * k]),
            )
        })
    }

    /// Steps to the next row. Also before the first: the device counts rows from 1.
    fn step_row(&mut self) {
        let [_, b, c, d] = self.third;
        self.vcc += c;
        self.vc += self.vrc >> 8;
        self.vrc += d;
        self.v += self.vr >> 6;
        self.vr += self.vrr >> 8;
        self.vrr += b;
    }

    /// The displacements of the present row, pixels.
    fn row(&self) -> impl Iterator<Item = f64> {
        let (mut p, mut q, mut s, a) = (self.v, self.vc, self.vcc, self.third[0]);
        (0..WIDTH).map(move |_| {
            let displacement = p as f64 / f64::from(1 << 17);
            p += q >> 6;
            q += s >> 8;
            s += a;
            displacement
        })
    }
}

/// The drivers' mapping in whole numbers.
pub(crate) struct DriversTable {
    /// Rectified column × 256; 1280 × 256 outside.
    pub(crate) x: Vec<u32>,
    /// Row; meaningless outside.
    pub(crate) y: Vec<i32>,
    /// Shift along the row for each millimetre, × 256.
    pub(crate) shift: Vec<i32>,
}

impl DriversTable {
    pub(crate) fn new(registration: &Registration) -> Self {
        let [mut horizontal, mut vertical] = Axis::both(&registration.integers);
        let (mut x, mut y) = (Vec::with_capacity(PIXELS), Vec::with_capacity(PIXELS));
        for row in 0..HEIGHT {
            horizontal.step_row();
            vertical.step_row();
            for (col, (dx, dy)) in horizontal.row().zip(vertical.row()).enumerate() {
                let (mut to_x, to_y) = (col as f64 + dx + 1.0, row as f64 + dy + 1.0);
                if to_x < 0.0 || to_y < 0.0 || to_x >= WIDTH as f64 || to_y >= HEIGHT as f64 {
                    to_x = 2.0 * WIDTH as f64;
                }
                x.push((to_x * 256.0) as u32);
                y.push(to_y as i32);
            }
        }
        let plane = &registration.zero_plane;
        let baseline =
            f64::from(plane.dcmos_rcmos_distance) / (2.0 * f64::from(plane.reference_pixel_size));
        let reference = 10.0 * f64::from(plane.reference_distance);
        let shift = |z_mm: u16| match z_mm {
            0 => 0.0,
            _ => baseline * (1.0 - reference / f64::from(z_mm)) + DEVICE_OFFSET,
        };
        let shift = (0..FARTHEST_MM).map(|z_mm| (shift(z_mm) * 256.0) as i32);
        Self {
            x,
            y,
            shift: shift.collect(),
        }
    }

    /// Colour pixel (column, row) of a depth pixel at `z_mm` whole millimetres; `None` without a distance or outside.
    pub(crate) fn colour_pixel(&self, col: usize, row: usize, z_mm: u16) -> Option<[usize; 2]> {
        let shift = self.shift.get(usize::from(z_mm)).filter(|_| z_mm > 0)?;
        let pixel = row * WIDTH + col;
        let x = (i64::from(self.x[pixel]) + i64::from(*shift)) >> 8;
        let x = usize::try_from(x).ok().filter(|&x| x < WIDTH)?;
        Some([x, usize::try_from(self.y[pixel]).ok()?])
    }
}

/// Distance of a raw depth value in whole millimetres, truncated, at most 10 000: what the drivers deliver. 0 = none.
pub(crate) fn depth_mm(registration: &Registration, raw: u16) -> u16 {
    let plane = &registration.zero_plane;
    let (emitter, reference) = (
        f64::from(plane.dcmos_emitter_distance),
        f64::from(plane.reference_distance),
    );
    let shift = f64::from(registration.const_shift) + DEVICE_OFFSET;
    let m = (f64::from(raw) / 4.0 - shift) * f64::from(plane.reference_pixel_size);
    if raw >= 2047 || m >= emitter {
        return 0;
    }
    let mm = 10.0 * (m * reference / (emitter - m) + reference);
    mm.clamp(0.0, f64::from(FARTHEST_MM)) as u16
}
