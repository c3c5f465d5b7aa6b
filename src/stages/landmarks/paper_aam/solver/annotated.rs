//! The model laid on annotated points, to see what it can show at best.

use nalgebra::{DMatrix, DVector};

use super::{AamFit, Expected, Shape2, Solver};
use crate::landmarks::view::View;

impl Solver {
    /// Fits view and shape to annotated points (window pixels): the model's best approximation.
    pub fn fit_points(&self, points: &Shape2, fit: &mut AamFit, depth: &View) {
        let expected = Expected::from(*depth);
        for _ in 0..20 {
            let motions = self.motions(fit);
            let size = self.slopes.nrows();
            let mut normal = DMatrix::<f32>::zeros(size, size);
            let mut right = DVector::<f32>::zeros(size);
            for (axis, motions) in motions.iter().enumerate() {
                for (i, row) in motions.chunks_exact(size).enumerate() {
                    let row = DVector::from_column_slice(row);
                    let wrong = points[i][axis] - fit.shape[i][axis];
                    normal.ger(4.0, &row, &row, 1.0);
                    right.axpy(4.0 * wrong, &row, 1.0);
                }
            }
            if !self
                .move_by(normal, right, fit, &expected)
                .is_some_and(|moved| moved > 0.01)
            {
                break;
            }
        }
    }
}
