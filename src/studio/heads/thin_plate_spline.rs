//! Thin-plate spline that carries points of the plane onto given targets and bends as little as possible between.
//!
//! Bookstein, "Principal warps" (IEEE PAMI 1989): f(p) = a + A p + Σ w_i U(|p − p_i|), U(r) = r² ln r². Works in
//! f64; one (n + 3)² solve at construction, n logarithms per point moved. Control points that nearly coincide while their
//! targets differ would fold the plane over itself (closed lips do this): such points become one, at their means.

use nalgebra::{DMatrix, Vector2};

/// A warp of the plane.
pub struct ThinPlate {
    from: Vec<Vector2<f64>>,
    weights: DMatrix<f64>,
}

fn kernel(r2: f64) -> f64 {
    if r2 > 1e-12 { r2 * r2.ln() } else { 0.0 }
}

impl ThinPlate {
    /// The warp that carries each `from` to its `to`; points closer than `distinct` count as one. `None` if the points do
    /// not span a plane.
    #[must_use]
    pub fn new(from: &[[f32; 2]], to: &[[f32; 2]], distinct: f32) -> Option<Self> {
        let (from, to) = merged(from, to, distinct);
        let n = from.len();
        let from: Vec<_> = from[..n]
            .iter()
            .map(|p| Vector2::new(f64::from(p[0]), f64::from(p[1])))
            .collect();
        let mut matrix = DMatrix::zeros(n + 3, n + 3);
        let mut right = DMatrix::zeros(n + 3, 2);
        let mut scale = 0.0;
        for i in 0..n {
            for j in 0..n {
                let value = kernel((from[i] - from[j]).norm_squared());
                matrix[(i, j)] = value;
                scale += value.abs() / (n * n) as f64;
            }
            for (k, value) in [1.0, from[i].x, from[i].y].into_iter().enumerate() {
                matrix[(i, n + k)] = value;
                matrix[(n + k, i)] = value;
            }
            right[(i, 0)] = f64::from(to[i][0]);
            right[(i, 1)] = f64::from(to[i][1]);
        }
        for i in 0..n {
            matrix[(i, i)] -= 1e-6 * scale;
        }
        let weights = matrix.lu().solve(&right)?;
        weights
            .iter()
            .all(|w| w.is_finite())
            .then_some(Self { from, weights })
    }

    /// Where a point goes.
    #[must_use]
    pub fn warp(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let p = Vector2::new(f64::from(x), f64::from(y));
        let n = self.from.len();
        let w = &self.weights;
        let mut q = [0, 1].map(|k| w[(n, k)] + w[(n + 1, k)] * p.x + w[(n + 2, k)] * p.y);
        for (i, from) in self.from.iter().enumerate() {
            let u = kernel((p - from).norm_squared());
            q[0] += w[(i, 0)] * u;
            q[1] += w[(i, 1)] * u;
        }
        q.map(|v| v as f32)
    }
}

/// Joins controls that are closer than `distinct` in `from`.
fn merged(from: &[[f32; 2]], to: &[[f32; 2]], distinct: f32) -> (Vec<[f32; 2]>, Vec<[f32; 2]>) {
    let mut groups: Vec<([f32; 2], [f32; 2], f32)> = Vec::new();
    for (f, t) in from.iter().zip(to) {
        let near = groups
            .iter_mut()
            .find(|(g, _, n)| (g[0] / n - f[0]).hypot(g[1] / n - f[1]) < distinct);
        match near {
            Some((g, h, n)) => {
                for k in 0..2 {
                    g[k] += f[k];
                    h[k] += t[k];
                }
                *n += 1.0;
            }
            None => groups.push((*f, *t, 1.0)),
        }
    }
    groups
        .iter()
        .map(|(f, t, n)| (f.map(|v| v / n), t.map(|v| v / n)))
        .unzip()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn controls_arrive_and_an_affine_map_stays_affine() {
        let from = [
            [0.0, 0.0],
            [100.0, 0.0],
            [0.0, 90.0],
            [110.0, 95.0],
            [50.0, 40.0],
        ];
        let affine = |p: [f32; 2]| [1.1 * p[0] - 0.2 * p[1] + 5.0, 0.1 * p[0] + 0.9 * p[1] - 3.0];
        let warp = ThinPlate::new(&from, &from.map(affine), 1.0).expect("in a plane");
        let (got, expected) = (warp.warp([70.0, 20.0]), affine([70.0, 20.0]));
        assert!((got[0] - expected[0]).abs() < 1e-3 && (got[1] - expected[1]).abs() < 1e-3);
        let mut to = from.map(affine);
        to[4] = [60.0, 30.0];
        let got = ThinPlate::new(&from, &to, 1.0)
            .expect("in a plane")
            .warp(from[4]);
        assert!((got[0] - 60.0).abs() < 0.01 && (got[1] - 30.0).abs() < 0.01);
    }
}
