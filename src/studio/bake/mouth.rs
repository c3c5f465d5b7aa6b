//! What lies in the mouth: which share of the jaw's motion gums, teeth and tongue take, and which part of them is tongue.
//!
//! * Teeth are small parts and move as a whole, with the jaw if they lie below the bite.
//! * Gums and tongue often come as one piece, whose tongue rises above the bite: a height would cut it in two. So the
//!   share is a harmonic field on the piece, 0 at the upper teeth and 1 at the lower ones; it changes at the back of the
//!   throat, where upper and lower half hang together.
//! * Tongue is what lies inside the arch of the lower teeth and faces outwards (gums there face inwards), and what is
//!   near it along the surface.
//!
//! Frame and units: the mesh's; `axes` as in [`super::head`]. Cost: one small factor per piece and teeth times vertices of it.
//! Limits: a piece that touches no teeth follows the jaw by the height of its vertices; a mouth without lower teeth has
//! no tongue.

use super::head::smooth;
use super::laplacian::Operator;
use super::mesh::{Rings, Vec3};
use super::nearest::Nearest;
use super::seam::distances;
use super::sparse::Factor;

/// Gum nearer to a tooth than this moves as the tooth does, in eye distances.
const AT_TOOTH: f64 = 0.04;
/// The harmonic share below which a vertex stays, and above which it goes with the jaw all the way.
const STAYS: f64 = 0.45;
const GOES: f64 = 0.80;
/// The tongue's sides lie at least this far inside the teeth and face outwards with this cosine, in eye distances.
const INSIDE: f64 = 0.054;
const OUTWARDS: f64 = 0.5;
/// Along the surface from those sides: tongue up to the first, not beyond the second, in eye distances.
const TONGUE: [f64; 2] = [0.38, 0.55];
/// The tongue's root: this part of its length from the back stays.
const ROOT: f64 = 0.35;

/// Fills in what is `NaN` among `some` vertices by the harmonic field between what is given there and around them; 0 where
/// nothing reaches.
fn harmonic(operator: &Operator, some: &[u32], value: &mut [f64]) {
    let mut place = vec![u32::MAX; value.len()];
    for &v in some {
        if value[v as usize].is_nan() && operator.area[v as usize] > 0.0 {
            place[v as usize] = 0;
        }
    }
    let eliminated = operator.elimination.iter().copied();
    let free: Vec<u32> = eliminated.filter(|&v| place[v as usize] == 0).collect();
    for (k, &v) in free.iter().enumerate() {
        place[v as usize] = k as u32;
    }
    for v in value.iter_mut().filter(|v| v.is_nan()) {
        *v = 0.0;
    }
    let Ok(factor) = Factor::of(&operator.positive, &free, &place, &[]) else {
        return;
    };
    let pulled = |&v: &u32| {
        let row = operator.positive.row(v as usize);
        let given = row.filter(|&(c, _)| place[c] == u32::MAX);
        [given.fold(0.0, |sum, (c, weight)| sum - weight * value[c])]
    };
    let mut solved: Vec<[f64; 1]> = free.iter().map(pulled).collect();
    factor.solve(&mut solved);
    for (&v, &[share]) in free.iter().zip(&solved) {
        value[v as usize] = share;
    }
}

/// One large piece of the mouth's inside and the teeth around it.
pub(super) struct Piece<'a> {
    /// Vertices of the piece, ascending.
    pub(super) vertices: &'a [u32],
    /// The upper and the lower teeth.
    pub(super) teeth: [Nearest; 2],
    /// Vertices of the lower teeth.
    pub(super) lower: &'a [u32],
    /// All positions and unit normals of the mesh.
    pub(super) positions: &'a [Vec3],
    /// See `positions`.
    pub(super) normals: &'a [Vec3],
    /// Edge neighbours.
    pub(super) rings: &'a Rings,
    /// The mesh's operators.
    pub(super) operator: &'a Operator,
    /// Upwards and outwards.
    pub(super) up: Vec3,
    /// See `up`.
    pub(super) out: Vec3,
    /// Inner-eye-corner distance.
    pub(super) eye_distance: f64,
}

impl Piece<'_> {
    /// Share of the jaw's motion for each of the piece's vertices; `None` if it does not touch both rows of teeth.
    pub(super) fn shares(&self) -> Option<Vec<f64>> {
        let touch = AT_TOOTH * self.eye_distance;
        let mut value = vec![f64::NAN; self.positions.len()];
        let mut touched = [false; 2];
        for &v in self.vertices {
            let p = &self.positions[v as usize];
            let far = |row: usize| {
                let tooth = self.teeth[row].of(p);
                tooth.map_or(f64::INFINITY, |t| (self.positions[t as usize] - p).norm())
            };
            let (upper, lower) = (far(0), far(1));
            if upper.min(lower) < touch {
                let row = usize::from(lower < upper);
                value[v as usize] = row as f64;
                touched[row] = true;
            }
        }
        if touched != [true; 2] {
            return None;
        }
        harmonic(self.operator, self.vertices, &mut value);
        let share = |&v: &u32| smooth(STAYS, GOES, value[v as usize]);
        Some(self.vertices.iter().map(share).collect())
    }

    /// How much of its tip's motion each vertex takes: 0 at the root and off the tongue, 1 at the tip.
    pub(super) fn tongue(&self, shares: &[f64]) -> Vec<f64> {
        let mut none = vec![0.0; self.vertices.len()];
        let lower = self.lower;
        if lower.is_empty() {
            return none;
        }
        let flat = |d: Vec3| {
            let d = d - self.up * d.dot(&self.up);
            let length = d.norm();
            if length > 0.0 { d / length } else { d }
        };
        let arch = lower
            .iter()
            .map(|&v| self.positions[v as usize])
            .sum::<Vec3>()
            / lower.len() as f64;
        let mut local = vec![u32::MAX; self.positions.len()];
        for (k, &v) in self.vertices.iter().enumerate() {
            local[v as usize] = k as u32;
        }
        let sides: Vec<u32> = self
            .vertices
            .iter()
            .copied()
            .filter(|&v| {
                let (k, v) = (local[v as usize], v as usize);
                let p = self.positions[v];
                let Some(tooth) = self.teeth[1].of(&p) else {
                    return false;
                };
                let tooth = self.positions[tooth as usize];
                shares[k as usize] > 0.9
                    && self.normals[v].dot(&flat(p - arch)) > OUTWARDS
                    && (p - tooth).dot(&flat(tooth - arch)) < -INSIDE * self.eye_distance
            })
            .collect();
        let last = TONGUE[1] * self.eye_distance;
        let far = distances(self.positions, self.rings, &sides, |v| {
            local[v] != u32::MAX && shares[local[v] as usize] >= 0.5
        });
        let along = self.vertices.iter().map(|&v| f64::from(far[v as usize]));
        let member: Vec<f64> = along
            .map(|d| 1.0 - smooth(TONGUE[0] * self.eye_distance, last, d.min(last)))
            .collect();
        let depth = |k: usize| self.positions[self.vertices[k] as usize].dot(&self.out);
        let inside = || (0..member.len()).filter(|&k| member[k] > 0.5).map(depth);
        let (front, back) = (
            inside().fold(f64::NEG_INFINITY, f64::max),
            inside().fold(f64::INFINITY, f64::min),
        );
        if front > back {
            for (k, share) in none.iter_mut().enumerate() {
                *share = member[k] * smooth(back + ROOT * (front - back), front, depth(k));
            }
        }
        none
    }
}
