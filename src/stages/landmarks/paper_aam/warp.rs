//! The piecewise affine warp of the active appearance model: triangles of the base shape, and its pixels.
//!
//! A pixel of the base shape has barycentric weights in its triangle; in an image it is at the same weights of the moved corners
//! (Matthews and Baker 2004, section 2.2). Triangles: Delaunay, incremental (Bowyer 1981, Watson 1981).
//! Window pixels. Computed once; a warp of all pixels then costs six multiplications each. Degenerate: pixels outside every
//! triangle are not used; flat triangles contain none.

use crate::base::capacity::LANDMARKS;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Points of a 2D shape, pixels.
pub type Shape2 = [[f32; 2]; LANDMARKS];
/// Distance between the base shape's pixels, window pixels: about 2900 of them in a face 100 px wide.
pub const STEP: f32 = 1.5;

/// Delaunay triangles of the points.
pub fn triangulate(points: &Shape2) -> Vec<[u8; 3]> {
    let mut all: Vec<[f64; 2]> = points
        .iter()
        .map(|p| [f64::from(p[0]), f64::from(p[1])])
        .collect();
    // A triangle that contains everything; removed at the end.
    all.extend([[-1e5, -1e5], [1e5, -1e5], [0.0, 1e5]]);
    let n = LANDMARKS;
    let mut triangles = vec![[n, n + 1, n + 2]];
    for i in 0..n {
        let (bad, good): (Vec<_>, Vec<_>) = triangles
            .into_iter()
            .partition(|t| in_circle(&all, t, all[i]));
        triangles = good;
        let edges: Vec<[usize; 2]> = bad
            .iter()
            .flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]])
            .collect();
        for edge in &edges {
            // Inner edges of the hole appear twice, in opposite directions.
            if !edges.contains(&[edge[1], edge[0]]) {
                triangles.push([edge[0], edge[1], i]);
            }
        }
    }
    triangles.retain(|t| t.iter().all(|v| *v < n));
    triangles.into_iter().map(|t| t.map(|v| v as u8)).collect()
}

fn twice_area(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn in_circle(points: &[[f64; 2]], t: &[usize; 3], p: [f64; 2]) -> bool {
    let d: [[f64; 2]; 3] = t.map(|v| [points[v][0] - p[0], points[v][1] - p[1]]);
    let lift: [f64; 3] = d.map(|v| v[0] * v[0] + v[1] * v[1]);
    let determinant = d[0][0] * (d[1][1] * lift[2] - d[2][1] * lift[1])
        - d[0][1] * (d[1][0] * lift[2] - d[2][0] * lift[1])
        + lift[0] * (d[1][0] * d[2][1] - d[2][0] * d[1][1]);
    determinant * twice_area(points[t[0]], points[t[1]], points[t[2]]) > 0.0
}

/// One pixel of the base shape.
#[derive(Clone, Copy, Debug)]
pub struct BasePixel {
    /// Landmarks at the corners of its triangle.
    pub corners: [u8; 3],
    /// Weights of the corners; they add to 1.
    pub weights: [f32; 3],
}

/// Pixels of a base shape on a grid of [`STEP`] inside its triangles.
pub fn base_pixels(mean: &Shape2, triangles: &[[u8; 3]]) -> Vec<BasePixel> {
    let low = |axis: usize| mean.iter().map(|p| p[axis]).fold(f32::INFINITY, f32::min);
    let high = |axis: usize| {
        mean.iter()
            .map(|p| p[axis])
            .fold(f32::NEG_INFINITY, f32::max)
    };
    let (x0, y0) = (low(0), low(1));
    let columns = ((high(0) - x0) / STEP).clamp(0.0, 254.0) as usize + 1;
    let rows = ((high(1) - y0) / STEP).clamp(0.0, 254.0) as usize + 1;
    let found = (0..columns * rows).filter_map(|at| {
        let p = [
            x0 + (at % columns) as f32 * STEP,
            y0 + (at / columns) as f32 * STEP,
        ];
        triangles.iter().find_map(|t| {
            let weights = barycentric(t.map(|v| mean[usize::from(v)]), p)?;
            let is_inside = weights.iter().all(|w| *w >= -1e-5);
            is_inside.then_some(BasePixel {
                corners: *t,
                weights,
            })
        })
    });
    found.collect()
}

/// Weights of a point in a triangle; `None` if the triangle is flat.
pub fn barycentric(t: [[f32; 2]; 3], p: [f32; 2]) -> Option<[f32; 3]> {
    let [a, b, c] = t.map(|v| v.map(f64::from));
    let p = p.map(f64::from);
    let area = twice_area(a, b, c);
    if area.abs() < 1e-9 {
        return None;
    }
    let (u, v) = (twice_area(p, b, c) / area, twice_area(a, p, c) / area);
    Some([u as f32, v as f32, (1.0 - u - v) as f32])
}

impl BasePixel {
    /// Position of the pixel in a moved shape.
    pub fn position(&self, shape: &Shape2) -> [f32; 2] {
        let mut p = [0.0; 2];
        for (corner, weight) in self.corners.iter().zip(&self.weights) {
            p[0] += weight * shape[usize::from(*corner)][0];
            p[1] += weight * shape[usize::from(*corner)][1];
        }
        p
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape(seed: u64) -> Shape2 {
        let mut rng = fastrand::Rng::with_seed(seed);
        core::array::from_fn(|_| [40.0 + 100.0 * rng.f32(), 40.0 + 100.0 * rng.f32()])
    }

    #[test]
    fn triangles_are_delaunay_and_cover_the_hull() {
        let points = shape(3);
        let triangles = triangulate(&points);
        let all: Vec<[f64; 2]> = points.iter().map(|p| p.map(f64::from)).collect();
        for t in &triangles {
            let t = t.map(usize::from);
            assert!((0..LANDMARKS).all(|i| t.contains(&i) || !in_circle(&all, &t, all[i])));
        }
        // Euler: n points with h on the hull have 2n - 2 - h triangles; h is between 3 and n.
        assert!(triangles.len() > LANDMARKS && triangles.len() < 2 * LANDMARKS - 4);
    }

    #[test]
    fn the_warp_of_the_mean_is_the_identity_and_affine_maps_are_kept() {
        let mean = shape(4);
        let triangles = triangulate(&mean);
        let pixels = base_pixels(&mean, &triangles);
        assert!(pixels.len() > 1000);
        let map = |p: [f32; 2]| [1.1 * p[0] - 0.2 * p[1] + 3.0, 0.3 * p[0] + 0.9 * p[1] - 5.0];
        let moved = mean.map(map);
        for pixel in &pixels {
            let (p, q) = (pixel.position(&mean), pixel.position(&moved));
            let want = map(p);
            assert!((q[0] - want[0]).abs() < 1e-3 && (q[1] - want[1]).abs() < 1e-3);
        }
    }
}
