//! Motion of the mouth's inside: the share of the jaw's motion of gums, teeth and tongue, and which vertices are
//! tongue.
//!
//! * Teeth are small parts and move rigidly, with the jaw if they lie below the bite.
//! * Gums and tongue often are one piece, whose tongue rises above the bite, so that a height cannot divide it. Its
//!   share is a harmonic field, 0 at the upper teeth and 1 at the lower ones; the transition lies at the back of the
//!   throat.
//! * Tongue is the region inside the arch of the lower teeth that faces outwards (gums there face inwards), and
//!   vertices near it along the surface.
//! * Where teeth and gums of both rows are one piece, the field runs between its highest and lowest vertices; a tooth
//!   has the share of the gum below it, however the rows overlap.
//!
//! Frame and units: the mesh's; `axes` as in [`super::head`]. Cost: one small factor per piece, and teeth times
//! vertices of it. Limits: without separate lower teeth there is no tongue that can be put out.

use super::head::Head;
use super::laplacian::Operator;
use super::mesh::{Nearest, Vec3};
use super::seam::distances;
use super::sparse::Factor;
use mien_stages::base::geometry::smoothstep;

/// Distance up to which gum moves as the nearest tooth does, in eye distances.
const AT_TOOTH: f64 = 0.04;
/// Harmonic share below which a vertex is fixed.
const FIXED: f64 = 0.45;
/// Harmonic share above which a vertex follows the jaw fully.
const FOLLOWS: f64 = 0.80;
/// A piece that touches no teeth has both rows if it is at least this wide, in mouth widths, and extends at least
/// this share of its height to either side of the bite.
const BOTH: [f64; 2] = [0.9, 0.35];
/// Outer share of the height of a piece with both rows that is gum.
const GUM: f64 = 0.6;
/// Least distance of the tongue's sides inside the teeth, in eye distances.
const INSIDE: f64 = 0.054;
/// Least cosine between the normals of the tongue's sides and the outward direction.
const OUTWARDS: f64 = 0.5;
/// Distances along the surface from the sides up to which all is tongue and from which none is, in eye distances.
const TONGUE: [f64; 2] = [0.38, 0.55];
/// Share of the tongue's length from the back that is fixed.
const ROOT: f64 = 0.35;

/// Shares of `some` vertices: harmonic between those given in `value` (`NaN`: unknown); 0 where no given value is
/// connected.
fn harmonic(operator: &Operator, some: &[u32], mut value: Vec<f64>) -> Vec<f64> {
    let mut is_free = vec![false; value.len()];
    for &v in some {
        is_free[v as usize] = value[v as usize].is_nan();
    }
    let free = operator.unknowns(|v| is_free[v]);
    for v in value.iter_mut().filter(|v| v.is_nan()) {
        *v = 0.0;
    }
    if let Ok(factor) = Factor::new(&operator.positive, &free, |_| 0.0) {
        let mut solved = factor.pulled(|v| [value[v]]);
        factor.solve(&mut solved);
        for (&v, &[share]) in free.rows.iter().zip(&solved) {
            value[v as usize] = share;
        }
    }
    let share = |&v: &u32| smoothstep(FIXED, FOLLOWS, value[v as usize]);
    some.iter().map(share).collect()
}

/// The upper and lower teeth.
pub(super) struct Teeth {
    pub(super) nearest: [Nearest; 2],
    /// Vertices of the lower teeth.
    pub(super) lower: Vec<u32>,
}

impl Head {
    /// Share of the jaw's motion for each vertex of a large piece of the mouth's inside; `None` if it does not touch
    /// both rows of teeth.
    pub(super) fn jaw_shares(&self, piece: &[u32], teeth: &Teeth) -> Option<Vec<f64>> {
        let touch = AT_TOOTH * self.eye_distance;
        let mut value = vec![f64::NAN; self.mesh.positions.len()];
        let mut touched = [false; 2];
        for &v in piece {
            let gap = |row| self.gap(row, v).map_or(f64::INFINITY, |gap| gap.0);
            let [upper, lower] = teeth.nearest.each_ref().map(gap);
            if upper.min(lower) < touch {
                let row = usize::from(lower < upper);
                value[v as usize] = row as f64;
                touched[row] = true;
            }
        }
        if touched != [true; 2] {
            return None;
        }
        Some(harmonic(&self.operator, piece, value))
    }

    /// Share of the jaw's motion for each vertex of a large piece that touches no teeth, `wide` in mesh units: a
    /// field if it has both rows, else one value, as for a single row or the tongue.
    pub(super) fn shares_by_place(&self, piece: &[u32], wide: f64) -> Vec<f64> {
        let height = |&v: &u32| self.below_bite(&self.mesh.positions[v as usize]);
        let heights: Vec<f64> = piece.iter().map(height).collect();
        let below = heights.iter().copied().fold(0.0, f64::max);
        let above = -heights.iter().copied().fold(0.0, f64::min);
        let [least_wide, least] = BOTH;
        let is_both =
            wide > least_wide * self.mouth_width && above.min(below) > least * (above + below);
        if !is_both {
            return vec![f64::from(u8::from(above < 2.0 * below)); piece.len()];
        }
        let mut value = vec![f64::NAN; self.mesh.positions.len()];
        for (&v, height) in piece.iter().zip(heights) {
            if height > GUM * below {
                value[v as usize] = 1.0;
            } else if -height > GUM * above {
                value[v as usize] = 0.0;
            }
        }
        harmonic(&self.operator, piece, value)
    }

    /// Share of the tip's motion of each vertex: 0 at the root and off the tongue, 1 at the tip. `normals` are the
    /// mesh's.
    pub(super) fn tongue_shares(
        &self,
        piece: &[u32],
        teeth: &Teeth,
        shares: &[f64],
        normals: &[Vec3],
    ) -> Vec<f64> {
        let mut taken = vec![0.0; piece.len()];
        let lower = &teeth.lower;
        if lower.is_empty() {
            return taken;
        }
        let (w, positions) = (self.eye_distance, &self.mesh.positions);
        let (up, out) = (self.axes.column(1), self.axes.column(2));
        let flat = |d: Vec3| {
            let d = d - up * d.dot(&up);
            d.try_normalize(0.0).unwrap_or(d)
        };
        let arch = lower.iter().map(|&v| positions[v as usize]).sum::<Vec3>() / lower.len() as f64;
        let mut local = vec![u32::MAX; positions.len()];
        for (k, &v) in piece.iter().enumerate() {
            local[v as usize] = k as u32;
        }
        let at_side = |v: u32| {
            let (k, p) = (local[v as usize] as usize, positions[v as usize]);
            let tooth = positions[teeth.nearest[1].closest(&p)? as usize];
            let is_side = shares[k] > 0.9
                && normals[v as usize].dot(&flat(p - arch)) > OUTWARDS
                && (p - tooth).dot(&flat(tooth - arch)) < -INSIDE * w;
            is_side.then_some(v)
        };
        let sides: Vec<u32> = piece.iter().filter_map(|&v| at_side(v)).collect();
        let [near, last] = TONGUE.map(|d| d * w);
        let far = distances(positions, &self.rings, &sides, |v| {
            local[v] != u32::MAX && shares[local[v] as usize] >= 0.5
        });
        let is_near = |&v: &u32| 1.0 - smoothstep(near, last, f64::from(far[v as usize]).min(last));
        let member: Vec<f64> = piece.iter().map(is_near).collect();
        let depth = |k: usize| positions[piece[k] as usize].dot(&out);
        let inside = || (0..member.len()).filter(|&k| member[k] > 0.5).map(depth);
        let front = inside().fold(f64::NEG_INFINITY, f64::max);
        let back = inside().fold(f64::INFINITY, f64::min);
        if front > back {
            for (k, share) in taken.iter_mut().enumerate() {
                *share = member[k] * smoothstep(back + ROOT * (front - back), front, depth(k));
            }
        }
        taken
    }
}
