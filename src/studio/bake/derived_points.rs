//! Where the ten points of the tool's own are on cheeks and forehead, beside the 68 landmarks.

use nalgebra::Matrix3;

use super::mesh::{Mesh, Vec3};
use super::names::mirrored;

/// Vertices of the ten derived control points, in the order of [`super::names::NAMES`] after the landmarks.
pub(super) fn derived_points(
    mesh: &Mesh,
    skin: &[bool],
    axes: &Matrix3<f64>,
    points: &[u32],
    w: f64,
) -> Vec<u32> {
    let normals = mesh.vertex_normals(&mesh.positions);
    let (up, out) = (axes.column(1), axes.column(2));
    // Aims by combining landmarks of the left side; the right side uses the mirror partners.
    let aims = |m: fn(usize) -> usize| {
        let p = |k: usize| mesh.positions[points[m(k)] as usize];
        [
            0.5 * (p(47) + p(35)),
            (p(46) + p(54) + p(14)) / 3.0,
            0.5 * (p(54) + p(11)),
            p(24) + up * (0.5 * w),
            p(23) + up * (1.1 * w),
        ]
    };
    let nearest = |aim: Vec3| {
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
    };
    let both = [aims(|k| k), aims(mirrored)];
    both.into_iter().flatten().map(nearest).collect()
}
