//! Symmetric sparse matrices by rows, and their Cholesky factors through `faer` (supernodal, AMD ordering).
//!
//! Memory: 12 bytes per stored entry. Cost of a factor: about n^1.5 for meshes.

use faer::prelude::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Mat, Side};

use super::mesh::Vec3;

/// A square matrix by rows; columns of a row ascend.
#[derive(Clone, Debug)]
pub struct Rows {
    starts: Vec<usize>,
    columns: Vec<u32>,
    values: Vec<f64>,
}

impl Rows {
    /// Sums triplets (row, column, value) into a matrix of `n` rows.
    #[must_use]
    pub fn from_triplets(n: usize, triplets: &[(u32, u32, f64)]) -> Self {
        let mut fill = vec![0_usize; n + 1];
        for &(r, _, _) in triplets {
            fill[r as usize + 1] += 1;
        }
        for r in 0..n {
            fill[r + 1] += fill[r];
        }
        let begin = fill.clone();
        let mut sorted = vec![(0_u32, 0.0); triplets.len()];
        for &(r, c, v) in triplets {
            sorted[fill[r as usize]] = (c, v);
            fill[r as usize] += 1;
        }
        let mut out = Self {
            starts: vec![0],
            columns: Vec::with_capacity(triplets.len()),
            values: Vec::with_capacity(triplets.len()),
        };
        for r in 0..n {
            let row = &mut sorted[begin[r]..begin[r + 1]];
            row.sort_by_key(|&(c, _)| c);
            let first = out.columns.len();
            for &(c, v) in row.iter() {
                if out.columns.len() > first && out.columns.last() == Some(&c) {
                    *out.values.last_mut().expect("a value per column") += v;
                } else {
                    out.columns.push(c);
                    out.values.push(v);
                }
            }
            out.starts.push(out.columns.len());
        }
        out
    }

    /// Number of rows.
    #[must_use]
    pub fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// No rows at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Column and value of every entry of a row.
    pub fn row(&self, r: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.starts[r]..self.starts[r + 1];
        self.columns[range.clone()]
            .iter()
            .zip(&self.values[range])
            .map(|(&c, &v)| (c as usize, v))
    }

    /// One row times a field of vectors.
    #[must_use]
    pub fn row_times(&self, r: usize, field: &[Vec3]) -> Vec3 {
        self.row(r)
            .fold(Vec3::zeros(), |sum, (c, v)| sum + field[c] * v)
    }

    /// `Lᵀ W L` for a symmetric matrix `L` and a diagonal `W`.
    #[must_use]
    pub fn squared(&self, weight: &[f64]) -> Self {
        let n = self.len();
        let mut out = Self {
            starts: Vec::with_capacity(n + 1),
            columns: Vec::with_capacity(self.columns.len() * 3),
            values: Vec::with_capacity(self.columns.len() * 3),
        };
        out.starts.push(0);
        let mut sum = vec![0.0_f64; n];
        let mut seen = vec![false; n];
        let mut touched: Vec<u32> = Vec::new();
        for r in 0..n {
            for (m, a) in self.row(r) {
                let a = a * weight[m];
                for (c, b) in self.row(m) {
                    if !seen[c] {
                        seen[c] = true;
                        touched.push(c as u32);
                    }
                    sum[c] += a * b;
                }
            }
            touched.sort_unstable();
            for &c in &touched {
                out.columns.push(c);
                out.values.push(sum[c as usize]);
                sum[c as usize] = 0.0;
                seen[c as usize] = false;
            }
            touched.clear();
            out.starts.push(out.columns.len());
        }
        out
    }
}

/// A matrix could not be factored: it is singular in the named number of unknowns.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error(
    "expected a positive definite system, found a singular one of {unknowns} unknowns; \
     does every part of the mesh that moves have a control point or a fixed neighbour?"
)]
pub struct Singular {
    /// Size of the system.
    pub unknowns: usize,
}

/// Cholesky factor of the part of a symmetric matrix that belongs to chosen rows and columns.
pub struct Factor(Llt<u32, f64>, usize);

impl Factor {
    /// Factors `matrix` restricted to `chosen` (ascending), plus `diagonal` (one per chosen row, or empty).
    /// `place` maps a row to its place in `chosen` or `u32::MAX`.
    ///
    /// # Errors
    /// If the restricted matrix is not positive definite.
    pub fn of(
        matrix: &Rows,
        chosen: &[u32],
        place: &[u32],
        diagonal: &[f64],
    ) -> Result<Self, Singular> {
        let n = chosen.len();
        let singular = Singular { unknowns: n };
        let mut starts = Vec::with_capacity(n + 1);
        let (mut rows, mut values) = (Vec::new(), Vec::new());
        starts.push(0_u32);
        for (k, &v) in chosen.iter().enumerate() {
            for (c, value) in matrix.row(v as usize) {
                let at = place[c];
                // Only the lower half, by columns; symmetry lets a row stand for a column.
                if at != u32::MAX && at as usize >= k {
                    rows.push(at);
                    let more = if at as usize == k && !diagonal.is_empty() {
                        diagonal[k]
                    } else {
                        0.0
                    };
                    values.push(value + more);
                }
            }
            starts.push(rows.len() as u32);
        }
        let symbolic = SymbolicSparseColMatRef::new_checked(n, n, &starts, None, &rows);
        let order =
            SymbolicLlt::try_new(symbolic, Side::Lower).map_err(|_| singular_copy(&singular))?;
        let matrix = SparseColMatRef::new(symbolic, &values);
        Llt::try_new_with_symbolic(order, matrix, Side::Lower)
            .map(|llt| Self(llt, n))
            .map_err(|_| singular)
    }

    /// Solves for three right-hand sides given as vectors.
    #[must_use]
    pub fn solve(&self, rhs: &[Vec3]) -> Vec<Vec3> {
        let mut x = Mat::<f64>::from_fn(self.1, 3, |r, c| rhs[r][c]);
        self.0.solve_in_place(x.as_mut());
        (0..self.1)
            .map(|r| Vec3::new(x[(r, 0)], x[(r, 1)], x[(r, 2)]))
            .collect()
    }

    /// Solves for `columns` right-hand sides; entry (r, c) of each is `rhs(r, c)`. Result by columns.
    #[must_use]
    pub fn solve_columns(
        &self,
        columns: usize,
        rhs: impl Fn(usize, usize) -> f64,
    ) -> Vec<Vec<f64>> {
        let mut x = Mat::<f64>::from_fn(self.1, columns, rhs);
        self.0.solve_in_place(x.as_mut());
        (0..columns)
            .map(|c| (0..self.1).map(|r| x[(r, c)]).collect())
            .collect()
    }
}

fn singular_copy(s: &Singular) -> Singular {
    Singular {
        unknowns: s.unknowns,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(n: u32) -> Rows {
        let mut triplets = Vec::new();
        for k in 0..n - 1 {
            triplets.extend([
                (k, k, 1.0),
                (k + 1, k + 1, 1.0),
                (k, k + 1, -1.0),
                (k + 1, k, -1.0),
            ]);
        }
        Rows::from_triplets(n as usize, &triplets)
    }

    #[test]
    fn squaring_equals_multiplying_twice() {
        let l = path(7);
        let square = l.squared(&[1.0; 7]);
        let x: Vec<Vec3> = (0..7)
            .map(|k| Vec3::new(k as f64, (k * k) as f64, 1.0))
            .collect();
        let once: Vec<Vec3> = (0..7).map(|r| l.row_times(r, &x)).collect();
        for r in 0..7 {
            let twice = l.row_times(r, &once);
            assert!((twice - square.row_times(r, &x)).norm() < 1e-12);
        }
    }

    #[test]
    fn a_held_chain_solves_to_a_straight_line_and_a_free_one_is_refused() {
        let l = path(6);
        let chosen = [1, 2, 3, 4];
        let place = [u32::MAX, 0, 1, 2, 3, u32::MAX];
        let factor = Factor::of(&l, &chosen, &place, &[]).unwrap();
        // Ends held at 0 and 5: the last unknown feels the pull of 5.
        let x = factor.solve_columns(1, |r, _| if r == 3 { 5.0 } else { 0.0 });
        for (k, value) in x[0].iter().enumerate() {
            assert!((value - (k + 1) as f64).abs() < 1e-12);
        }
        let all: Vec<u32> = (0..6).collect();
        assert!(Factor::of(&l, &all, &all, &[]).is_err());
    }
}
