//! Leading eigenvectors.

use nalgebra::{DMatrix, SymmetricEigen};

/// The `most` largest eigenvalues of a symmetric matrix, descending, and their vectors by column.
pub fn strongest(symmetric: DMatrix<f64>, most: usize) -> (Vec<f64>, DMatrix<f64>) {
    let eigen = SymmetricEigen::new(symmetric);
    let mut order: Vec<usize> = (0..eigen.eigenvalues.len()).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    order.truncate(most);
    let values = order.iter().map(|&k| eigen.eigenvalues[k]);
    (values.collect(), eigen.eigenvectors.select_columns(&order))
}
