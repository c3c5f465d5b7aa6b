//! Where the ten points of the tool's own are on cheeks and forehead, beside the 68 landmarks.

use nalgebra::Matrix3;

use super::mesh::{Mesh, Vec3};
use super::names::{LANDMARKS, NAMES, mirrored};

/// Vertices of the ten derived control points, in the order of [`NAMES`] after the landmarks.
pub(super) fn derived_points(
    mesh: &Mesh,
    skin: &[bool],
    normals: &[Vec3],
    axes: &Matrix3<f64>,
    points: &[u32],
    w: f64,
) -> Vec<u32> {
    let at = |k: usize| mesh.positions[points[k] as usize];
    let up = axes.column(1).into_owned();
    let out = axes.column(2).into_owned();
    // Aims by combining landmarks of the left side; the right side uses the mirror partners.
    let aims = |m: &dyn Fn(usize) -> usize| {
        let p = |k: usize| at(m(k));
        [
            0.5 * (p(47) + p(35)),
            (p(46) + p(54) + p(14)) / 3.0,
            0.5 * (p(54) + p(11)),
            p(24) + up * (0.5 * w),
            p(23) + up * (1.1 * w),
        ]
    };
    let left = aims(&|k| k);
    let right = aims(&mirrored);
    debug_assert_eq!(left.len() + right.len() + LANDMARKS, NAMES.len());
    left.into_iter()
        .chain(right)
        .map(|aim| {
            // Seen from in front: distance across counts fully, distance in depth little, as the skin may bulge.
            let cost = |v: usize| {
                let d = mesh.positions[v] - aim;
                let depth = d.dot(&out);
                d.norm_squared() - 0.9 * depth * depth
            };
            (0..mesh.positions.len())
                .filter(|&v| skin[v] && normals[v].dot(&out) > 0.1 && !points.contains(&(v as u32)))
                .min_by(|&a, &b| cost(a).total_cmp(&cost(b)))
                .map_or(points[30], |v| v as u32)
        })
        .collect()
}
