//! Maps the learned face onto a head: which learned place corresponds to which vertex.
//!
//! A thin-plate warp takes the head's 68 landmarks onto those of the learned face (the face's frame, unit one eye
//! distance). Every skin vertex then averages the learned places nearest by position and normal. Away from all places
//! the learned part fades out. If the landmarks do not match the learned ones after a linear map, [`Canonical::new`]
//! is `None` and the solve stands alone.
//!
//! Units: eye distances; displacements in and out in the mesh's. Cost: a few k-d tree queries a vertex.

use mien_stages::base::geometry::smoothstep;
use std::num::NonZeroUsize;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{DMatrix, Matrix3};
use rayon::prelude::*;

use super::head::{Head, LANDMARKS};
use super::mesh::Vec3;
use super::prior::{Prior, SkinPoint};
use mien_workbench::thin_plate::ThinPlate;

/// Largest RMS distance of the landmarks from the learned ones after a linear map, eye distances.
const MAX_LANDMARK_RMS: f64 = 0.25;
/// Smoothing of the warp: landmarks that coincide on one face may be separate on the other.
const WARP_SMOOTHING: f64 = 0.02;
/// Learned places that a vertex averages.
const NEIGHBOURS: usize = 6;
/// Distances from the nearest place up to which the learned part counts fully and from which it counts nothing, eye
/// distances.
const FADE_RANGE: [f64; 2] = [0.2, 0.5];

/// The learned face on one head.
pub(super) struct Canonical<'a> {
    prior: &'a Prior,
    /// Vertex of the head at each place.
    at: Vec<u32>,
    /// Per vertex, places and their weights, which sum to 1 near the face and to less away from it.
    weights: Vec<[(u32, f32); NEIGHBOURS]>,
}

/// The warp between two sets of landmarks; `None` if no linear map brings them together.
fn warp(from: &[Vec3], to: &[Vec3]) -> Option<ThinPlate<3>> {
    let n = from.len();
    let line = |p: &Vec3| [1.0, p.x, p.y, p.z];
    let affine = DMatrix::from_fn(n, 4, |r, c| line(&from[r])[c]);
    let goal = DMatrix::from_fn(n, 3, |r, c| to[r][c]);
    let fitted = affine.clone().svd(true, true).solve(&goal, 1e-9).ok()?;
    let miss = ((&affine * &fitted - &goal).norm_squared() / n as f64).sqrt();
    let linear = Matrix3::from_fn(|r, c| fitted[(c + 1, r)]);
    let alike = miss <= MAX_LANDMARK_RMS && linear.determinant() > 0.1;
    alike.then(|| ThinPlate::new(from, to, WARP_SMOOTHING))?
}

/// Positions of a head in the face's frame.
pub(super) fn in_frame(head: &Head, p: &Vec3) -> Vec3 {
    let origin = 0.5 * (head.point(39) + head.point(42));
    head.axes.tr_mul(&(p - origin)) / head.eye_distance
}

/// Positions and normals of the vertices that pass, in the face's frame.
pub(super) fn places(head: &Head, chosen: impl Fn(usize) -> bool) -> Vec<(u32, SkinPoint)> {
    let normals = head.mesh.vertex_normals(&head.mesh.positions);
    let some = (0..head.mesh.positions.len()).filter(|&v| chosen(v));
    some.map(|v| {
        let place = SkinPoint {
            at: in_frame(head, &head.mesh.positions[v]),
            normal: head.axes.tr_mul(&normals[v]),
        };
        (v as u32, place)
    })
    .collect()
}

impl<'a> Canonical<'a> {
    /// Fits the face to a head; `None` if its landmarks do not match.
    pub(super) fn new(head: &Head, prior: &'a Prior) -> Option<Self> {
        let from = (0..LANDMARKS).map(|k| in_frame(head, &head.point(k)));
        let from: Vec<Vec3> = from.collect();
        let warp = warp(&from, &prior.comparison.landmarks)?;
        let mut skin = places(head, |v| head.skin[v]);
        skin.par_iter_mut()
            .for_each(|(_, p)| p.at = warp.warp(&p.at));
        let learned = &prior.comparison.places;
        let tree = |points: Vec<[f64; 6]>| ImmutableKdTree::new_from_slice(&points).ok();
        let on_skin = tree(skin.iter().map(|p| p.1.point()).collect())?;
        let nearest = |q: &SkinPoint| {
            let point = q.point();
            let nearest = on_skin.query(&point);
            let nearest = nearest.nearest_one::<SquaredEuclidean<f64>>().execute();
            skin[nearest.item as usize].0
        };
        let at = learned.par_iter().map(nearest).collect();
        let places = tree(learned.iter().map(SkinPoint::point).collect())?;
        let mut weights = vec![[(0, 0.0); NEIGHBOURS]; head.mesh.positions.len()];
        let found: Vec<_> = skin.par_iter().map(|(_, p)| around(p, &places)).collect();
        for ((v, _), found) in skin.iter().zip(found) {
            weights[*v as usize] = found;
        }
        Some(Self { prior, at, weights })
    }

    /// Displacement of the skin in addition to `solved`, per vertex, mesh units, given the landmarks' displacements.
    pub(super) fn residual(&self, head: &Head, controls: &[Vec3], solved: &[Vec3]) -> Vec<Vec3> {
        let w = head.eye_distance;
        let inward = |d: &Vec3| head.axes.tr_mul(d) / w;
        let controls = controls.iter().map(inward).collect();
        let skin = self.at.iter().map(|&v| inward(&solved[v as usize]));
        let residual = self.prior.residual(controls, skin.collect());
        let turned: Vec<Vec3> = residual.iter().map(|d| head.axes * d * w).collect();
        let of = |weights: &[(u32, f32); NEIGHBOURS]| {
            let parts = weights.iter().filter(|t| t.1 > 0.0);
            parts.fold(Vec3::zeros(), |sum, &(q, share)| {
                sum + turned[q as usize] * f64::from(share)
            })
        };
        self.weights.iter().map(of).collect()
    }
}

/// The places nearest to a point and their weights.
fn around(p: &SkinPoint, places: &ImmutableKdTree<f64, 6>) -> [(u32, f32); NEIGHBOURS] {
    // One more than is used: its weight is 0, so that weights change continuously as another place comes nearer.
    const ONE_MORE: NonZeroUsize = NonZeroUsize::new(NEIGHBOURS + 1).expect("more than none");
    let point = p.point();
    let found = places.query(&point);
    let found = found.nearest_n::<SquaredEuclidean<f64>>(ONE_MORE);
    let mut nearest = [(f64::INFINITY, 0_u32); NEIGHBOURS + 1];
    for (nearest, found) in nearest.iter_mut().zip(found.execute()) {
        *nearest = (found.distance.sqrt(), found.item);
    }
    let last = nearest[NEIGHBOURS].0;
    let mut taken = [(0, 0.0); NEIGHBOURS];
    if !last.is_finite() || last <= 0.0 {
        return taken;
    }
    let trust = 1.0 - smoothstep(FADE_RANGE[0], FADE_RANGE[1], nearest[0].0);
    let share = |far: f64| (1.0 - far / last).powi(2) / (far + 0.02 * last);
    let sum: f64 = nearest[..NEIGHBOURS].iter().map(|n| share(n.0)).sum();
    for (taken, (far, q)) in taken.iter_mut().zip(nearest) {
        *taken = (q, (trust * share(far) / sum.max(1e-300)) as f32);
    }
    taken
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_warp_meets_its_landmarks_and_refuses_another_kind_of_face() {
        let to = &Prior::shipped().comparison.landmarks;
        let other: Vec<Vec3> = to
            .iter()
            .map(|p| {
                Vec3::new(
                    p.x * 1.2,
                    p.y * 0.9 + 0.05 * (2.0 * p.x).sin(),
                    p.z * 1.1 - 0.3,
                )
            })
            .collect();
        let found = warp(&other, to).unwrap();
        for (from, to) in other.iter().zip(to) {
            assert!((found.warp(from) - to).norm() < 0.02);
        }
        let mut shuffled = to.clone();
        shuffled.reverse();
        assert!(warp(&shuffled, to).is_none());
        let inside_out: Vec<Vec3> = to.iter().map(|p| Vec3::new(-p.x, p.y, p.z)).collect();
        assert!(warp(&inside_out, to).is_none());
    }
}
