//! Thin-plate spline: maps points to given targets with the least bending.
//!
//! Bookstein, "Principal warps" (IEEE PAMI 1989): f(p) = a + A p + Σ w_i U(|p − p_i|), with U(r) = r² ln r² in the plane and
//! U(r) = −r in space. One (n + D + 1)² solve at construction, n kernels per point moved.

use nalgebra::{DMatrix, SVector};

/// A warp of the plane (D = 2) or of space (D = 3).
pub struct ThinPlate<const D: usize> {
    from: Vec<SVector<f64, D>>,
    /// Rows of every w, then of a, then of A, transposed.
    weights: DMatrix<f64>,
}

/// U as a function of the squared distance.
fn kernel<const D: usize>(r2: f64) -> f64 {
    match D {
        2 if r2 > 1e-12 => r2 * r2.ln(),
        2 => 0.0,
        _ => -r2.sqrt(),
    }
}

impl<const D: usize> ThinPlate<D> {
    /// The warp from `from` to `to`, with smoothing `gives`: a share of the mean kernel in the plane, a length in
    /// space. `None` if the points do not span the plane or space.
    pub fn new(from: &[SVector<f64, D>], to: &[SVector<f64, D>], gives: f64) -> Option<Self> {
        let n = from.len();
        let bends = DMatrix::from_fn(n, n, |r, c| kernel::<D>((from[r] - from[c]).norm_squared()));
        let gives = match D {
            2 => -gives * bends.abs().mean(),
            _ => gives,
        };
        let mut system = DMatrix::zeros(n + D + 1, n + D + 1);
        let mut given = DMatrix::zeros(n + D + 1, D);
        system.view_mut((0, 0), (n, n)).copy_from(&bends);
        for r in 0..n {
            system[(r, r)] += gives;
            for c in 0..=D {
                let x = if c == 0 { 1.0 } else { from[r][c - 1] };
                system[(r, n + c)] = x;
                system[(n + c, r)] = x;
            }
            given.row_mut(r).tr_copy_from(&to[r]);
        }
        let weights = system.lu().solve(&given)?;
        let finite = weights.iter().all(|w| w.is_finite());
        finite.then(|| Self {
            from: from.to_vec(),
            weights,
        })
    }

    /// The warped point.
    pub fn warp(&self, p: &SVector<f64, D>) -> SVector<f64, D> {
        let n = self.from.len();
        let row = |r: usize| SVector::<f64, D>::from_fn(|k, _| self.weights[(r, k)]);
        let linear = (1..D).fold(row(n + 1) * p[0], |sum, k| sum + row(n + 1 + k) * p[k]);
        let bends = self.from.iter().enumerate();
        bends.fold(linear + row(n), |sum, (i, from)| {
            sum + row(i) * kernel::<D>((p - from).norm_squared())
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;

    #[test]
    fn controls_arrive_and_an_affine_map_stays_affine() {
        let from = [
            [0.0, 0.0],
            [100.0, 0.0],
            [0.0, 90.0],
            [110.0, 95.0],
            [50.0, 40.0],
        ]
        .map(Vector2::from);
        let affine = |p: Vector2<f64>| {
            Vector2::new(1.1 * p.x - 0.2 * p.y + 5.0, 0.1 * p.x + 0.9 * p.y - 3.0)
        };
        let warp = ThinPlate::new(&from, &from.map(affine), 1e-6).expect("in a plane");
        let p = Vector2::new(70.0, 20.0);
        assert!((warp.warp(&p) - affine(p)).norm() < 1e-3);
        let mut to = from.map(affine);
        to[4] = Vector2::new(60.0, 30.0);
        let warp = ThinPlate::new(&from, &to, 1e-6).expect("in a plane");
        assert!((warp.warp(&from[4]) - to[4]).norm() < 0.01);
    }
}
