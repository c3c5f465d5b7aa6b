//! The mapping from depth to colour pixels: a cubic polynomial of column and row for each axis, in the device's fixed-point
//! form ([`Axis`]), in continuous form ([`Cubic`]), and as the table drivers make of it ([`RegistrationTable`]).
//!
//! The forward differences are stepped with truncating shifts, so the device's values depend on the order of the steps; that
//! order is kept here to the bit.

use super::optics::{FARTHEST_MM, Optics, boxed};
use super::registration::{Registration, RegistrationIntegers};
use crate::base::capacity::{HEIGHT, PIXELS, WIDTH};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::sensor::camera::Cubic;

/// The registration polynomial of one axis as forward differences in fixed point, the device's own form.
#[derive(Clone, Copy, Debug)]
pub(super) struct Axis {
    /// Third differences: along the row, along the column, and the two mixed ones.
    a: i64,
    b: i64,
    c: i64,
    d: i64,
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
    pub(super) fn both(r: &RegistrationIntegers) -> [Self; 2] {
        let axis = |[a, b, c, d]: [i32; 4], [v, vc, vr, vcc, vrc, vrr]: [i32; 6]| Self {
            a: a.into(),
            b: b.into(),
            c: c.into(),
            d: d.into(),
            v: signed(v, 19) << 9,
            vc: signed(vc, 21) << 8,
            vr: signed(vr, 21) << 8,
            vcc: signed(vcc, 24) << 8,
            vrc: signed(vrc, 24) << 8,
            vrr: signed(vrr, 24) << 8,
        };
        [
            axis(
                [r.ax, r.bx, r.cx, r.dx],
                [
                    r.dx_start,
                    r.dxdx_start,
                    r.dydx_start,
                    r.dxdxdx_start,
                    r.dydxdx_start,
                    r.dydydx_start,
                ],
            ),
            axis(
                [r.ay, r.by, r.cy, r.dy],
                [
                    r.dy_start,
                    r.dxdy_start,
                    r.dydy_start,
                    r.dxdxdy_start,
                    r.dydxdy_start,
                    r.dydydy_start,
                ],
            ),
        ]
    }

    /// Steps to the next row. Must also be called before the first: the device counts rows from 1.
    fn step_row(&mut self) {
        self.vcc += self.c;
        self.vc += self.vrc >> 8;
        self.vrc += self.d;
        self.v += self.vr >> 6;
        self.vr += self.vrr >> 8;
        self.vrr += self.b;
    }

    /// The displacements of the present row, in pixels.
    fn row(&self) -> impl Iterator<Item = f64> {
        let (mut p, mut q, mut s, a) = (self.v, self.vc, self.vcc, self.a);
        (0..WIDTH).map(move |_| {
            let displacement = p as f64 / f64::from(1 << 17);
            p += q >> 6;
            q += s >> 8;
            s += a;
            displacement
        })
    }

    /// The polynomial behind the differences. Sums of differences are binomials: after n steps a constant third
    /// difference has added up to n(n−1)(n−2)/6, a second one to n(n−1)/2. Each truncating shift loses half a unit on
    /// average; taking that half out of the summand leaves a few thousandths of a pixel at the far corner.
    pub(super) fn polynomial(&self) -> Cubic {
        let [a, b, c, d, v, vc, vr, vcc, vrc, vrr] = [
            self.a, self.b, self.c, self.d, self.v, self.vc, self.vr, self.vcc, self.vrc, self.vrr,
        ]
        .map(|state| state as f64);
        let (vc, vr) = (vc - 32.0, vr - 32.0);
        let (vcc, vrc, vrr) = (vcc - 128.0, vrc - 128.0, vrr - 128.0);
        // Each level is kept with more fraction bits than the one it feeds: 2^6 for the first, 2^8 more for the others.
        let (first, second) = (1.0 / 64.0, 1.0 / (64.0 * 256.0));
        let third = second;
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
        add(0, binomial3(b * third));
        // Change per column, a quadratic of n.
        add(1, [vc * first, vrc * second, 0.0, 0.0]);
        add(1, binomial2(d * second));
        // Second difference along the row, linear in n; binomial of the column.
        add(1, [-0.5 * vcc * second, -0.5 * c * second, 0.0, 0.0]);
        add(2, [0.5 * vcc * second, 0.5 * c * second, 0.0, 0.0]);
        for (i, k) in binomial3(a * third).into_iter().enumerate().skip(1) {
            add(i, [k, 0.0, 0.0, 0.0]);
        }
        Cubic(t)
    }
}

/// The drivers' mapping from depth pixels to colour pixels in whole numbers.
pub struct RegistrationTable {
    /// Rectified column × 256; 1280 × 256 = outside.
    pub(super) x: Box<[u32; PIXELS]>,
    /// Row; meaningless outside.
    pub(super) y: Box<[i32; PIXELS]>,
    /// Shift along the row for each millimetre, × 256.
    pub(super) shift: Box<[i32; FARTHEST_MM as usize]>,
}

impl RegistrationTable {
    /// Runs the device's recurrence over all pixels.
    #[must_use]
    pub fn new(registration: &Registration) -> Self {
        let [mut horizontal, mut vertical] = Axis::both(&registration.integers);
        let (mut x, mut y, mut shift) = (boxed(0u32), boxed(0i32), boxed(0i32));
        for row in 0..HEIGHT {
            horizontal.step_row();
            vertical.step_row();
            for (col, (dx, dy)) in horizontal.row().zip(vertical.row()).enumerate() {
                let (mut to_x, to_y) = (col as f64 + dx + 1.0, row as f64 + dy + 1.0);
                if to_x < 0.0 || to_y < 0.0 || to_x >= WIDTH as f64 || to_y >= HEIGHT as f64 {
                    to_x = 2.0 * WIDTH as f64;
                }
                x[row * WIDTH + col] = (to_x * 256.0) as u32;
                y[row * WIDTH + col] = to_y as i32;
            }
        }
        let optics = Optics::new(registration);
        for (z_mm, shift) in shift.iter_mut().enumerate().skip(1) {
            *shift = (optics.colour_shift(z_mm as f64) * 256.0) as i32;
        }
        Self { x, y, shift }
    }

    /// Colour pixel (column, row) of a depth pixel at `z_mm` whole millimetres; `None` without a distance or outside.
    #[must_use]
    pub fn colour_pixel(&self, col: usize, row: usize, z_mm: u16) -> Option<[usize; 2]> {
        if col >= WIDTH || row >= HEIGHT || z_mm == 0 {
            return None;
        }
        let shift = *self.shift.get(usize::from(z_mm))?;
        let pixel = row * WIDTH + col;
        let x = (i64::from(self.x[pixel]) + i64::from(shift)) >> 8;
        let x = usize::try_from(x).ok().filter(|&x| x < WIDTH)?;
        Some([x, usize::try_from(self.y[pixel]).ok()?])
    }
}
