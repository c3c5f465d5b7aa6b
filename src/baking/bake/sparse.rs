//! Symmetric sparse matrices by rows, and Cholesky factors of their principal submatrices in supernodes
//! (`mien_linear::cholesky`). The whole matrix is ordered once (AMD); in that order a submatrix never fills in more than the whole
//! does.
//!
//! Solving is implemented here, a few right-hand sides side by side: faer's own is made for many at once and takes
//! five times as long for three. Four columns of the factor are processed at once, as memory access for the
//! right-hand sides takes longer than the products.
//!
//! Memory: 12 bytes per stored entry. Cost of a factor: about n^1.5 for meshes.

use mien_linear::cholesky::{Block, Cholesky, Pattern, elimination};

use super::mesh::Vec3;
use mien_stages::base::vectors::with_avx2;
use mien_workbench::fault::Fault;

/// Marks a row that is given, not unknown.
const GIVEN: u32 = u32::MAX;

/// A square matrix by rows; columns of a row ascend.
#[derive(Clone, Debug, Default)]
pub struct Rows {
    starts: Vec<u32>,
    columns: Vec<u32>,
    values: Vec<f64>,
}

/// Sums adjacent triplets (row, column, value) of equal position.
pub(super) fn summed(triplets: &[(u32, u32, f64)]) -> impl Iterator<Item = (u32, u32, f64)> {
    let places = triplets.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1));
    places.map(|same| (same[0].0, same[0].1, same.iter().map(|t| t.2).sum()))
}

impl Rows {
    /// A matrix to which rows are appended.
    fn begun() -> Self {
        Self {
            starts: vec![0],
            ..Self::default()
        }
    }

    /// Sums triplets (row, column, value) into a matrix of `n` rows.
    pub fn from_triplets(n: usize, mut triplets: Vec<(u32, u32, f64)>) -> Self {
        triplets.sort_by_key(|&(r, c, _)| u64::from(r) << 32 | u64::from(c));
        let mut out = Self {
            starts: vec![0; n + 1],
            ..Self::default()
        };
        for (r, c, value) in summed(&triplets) {
            out.starts[r as usize + 1] += 1;
            out.columns.push(c);
            out.values.push(value);
        }
        for r in 0..n {
            out.starts[r + 1] += out.starts[r];
        }
        out
    }

    /// Number of rows.
    fn count(&self) -> usize {
        self.starts.len() - 1
    }

    /// Column and value of every entry of a row.
    pub fn row(&self, r: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.starts[r] as usize..self.starts[r + 1] as usize;
        let columns = self.columns[range.clone()].iter();
        let entries = columns.zip(&self.values[range]);
        entries.map(|(&c, &v)| (c as usize, v))
    }

    /// One row times a field of vectors.
    pub fn row_times(&self, r: usize, field: &[Vec3]) -> Vec3 {
        self.row(r)
            .fold(Vec3::zeros(), |sum, (c, v)| sum + field[c] * v)
    }

    /// A Laplacian with entries off the diagonal of at most `-least`, and the diagonal that makes rows sum to 0.
    pub(super) fn positive(&self, least: f64) -> Self {
        let mut out = self.clone();
        for (r, ends) in self.starts.windows(2).enumerate() {
            let range = ends[0] as usize..ends[1] as usize;
            let (mut sum, mut diagonal) = (0.0, None);
            for k in range {
                if self.columns[k] as usize == r {
                    diagonal = Some(k);
                } else {
                    out.values[k] = self.values[k].min(-least);
                    sum -= out.values[k];
                }
            }
            if let Some(k) = diagonal {
                out.values[k] = sum;
            }
        }
        out
    }

    /// The rows of a symmetric matrix in an order of elimination that leaves few entries in a factor (AMD).
    ///
    /// # Panics
    /// If memory is exhausted.
    pub fn elimination(&self) -> Vec<u32> {
        elimination(self.pattern())
    }

    /// `Lᵀ W L` for a symmetric matrix `L` and a diagonal `W`.
    pub fn squared(&self, weight: &[f64]) -> Self {
        let (n, mut out) = (self.count(), Self::begun());
        let (mut sum, mut seen) = (vec![0.0_f64; n], vec![false; n]);
        let mut touched: Vec<u32> = Vec::new();
        for r in 0..n {
            for (m, a) in self.row(r) {
                let a = a * weight[m];
                for (c, b) in self.row(m) {
                    if !std::mem::replace(&mut seen[c], true) {
                        touched.push(c as u32);
                    }
                    sum[c] += a * b;
                }
            }
            touched.sort_unstable();
            for c in touched.drain(..) {
                out.columns.push(c);
                out.values.push(std::mem::take(&mut sum[c as usize]));
                seen[c as usize] = false;
            }
            out.starts.push(out.columns.len() as u32);
        }
        out
    }

    /// The same matrix permuted to `order`, so that rows of a submatrix are adjacent.
    pub fn arranged(&self, order: &[u32]) -> Self {
        let mut out = Self::begun();
        for &r in order {
            let range = self.starts[r as usize] as usize..self.starts[r as usize + 1] as usize;
            out.columns.extend_from_slice(&self.columns[range.clone()]);
            out.values.extend_from_slice(&self.values[range]);
            out.starts.push(out.columns.len() as u32);
        }
        out
    }

    /// Splits an arranged symmetric matrix, with `diagonal` added to the unknowns': the pattern of their upper half,
    /// their lower half, and the entries that couple them to given rows, by position and column.
    fn unknown_part(
        &self,
        unknowns: &Unknowns,
        diagonal: impl Fn(usize) -> f64,
    ) -> (Self, Self, Vec<(u32, u32, f64)>) {
        let (mut upper, mut lower, mut given) = (Self::begun(), Self::begun(), Vec::new());
        for (k, &position) in unknowns.positions.iter().enumerate() {
            for (c, value) in self.row(position as usize) {
                let Some(at) = unknowns.place(c) else {
                    given.push((k as u32, c as u32, value));
                    continue;
                };
                if at <= k {
                    upper.columns.push(at as u32);
                }
                if at >= k {
                    lower.columns.push(at as u32);
                    let value = if at == k { value + diagonal(k) } else { value };
                    lower.values.push(value);
                }
            }
            upper.starts.push(upper.columns.len() as u32);
            lower.starts.push(lower.columns.len() as u32);
        }
        (upper, lower, given)
    }

    /// Where its entries are: by symmetry a row equals a column.
    fn pattern(&self) -> Pattern<'_> {
        Pattern {
            starts: &self.starts,
            rows: &self.columns,
        }
    }
}

/// The unknown rows of a system, in the order of elimination.
pub struct Unknowns {
    /// Their rows.
    pub rows: Vec<u32>,
    /// Position of each row among the unknowns.
    positions: Vec<u32>,
    place: Vec<u32>,
}

impl Unknowns {
    /// The rows that pass; `order` lists all rows of the system.
    pub fn new(order: &[u32], passes: impl Fn(usize) -> bool) -> Self {
        let passing = order.iter().zip(0..).filter(|(r, _)| passes(**r as usize));
        let (rows, positions): (Vec<u32>, Vec<u32>) = passing.unzip();
        let mut place = vec![GIVEN; order.len()];
        for (&r, k) in rows.iter().zip(0..) {
            place[r as usize] = k;
        }
        Self {
            rows,
            positions,
            place,
        }
    }

    /// The position of a row among the unknowns; `None` if it is given.
    pub fn place(&self, row: usize) -> Option<usize> {
        Some(self.place[row] as usize).filter(|_| self.place[row] != GIVEN)
    }
}

/// An error: a matrix of this many unknowns is singular.
fn singular(unknowns: usize) -> Fault {
    Fault::new(format!(
        "expected a positive definite system, found a singular one of {unknowns} unknowns; \
         does every part of the mesh that moves have a control point or a fixed neighbour?"
    ))
}

/// Cholesky factor of the unknowns' part of a symmetric matrix.
pub struct Factor {
    matrix: Cholesky,
    /// Entries between unknowns and given rows: position, row, value.
    given: Vec<(u32, u32, f64)>,
}

impl Factor {
    /// Factors the unknowns' part of a matrix, with `diagonal` added by position; the matrix is
    /// [arranged](Rows::arranged) in the unknowns' order. That of [`Rows::elimination`] keeps fill-in low.
    ///
    /// # Errors
    /// If that part is not positive definite.
    pub fn new(
        matrix: &Rows,
        unknowns: &Unknowns,
        diagonal: impl Fn(usize) -> f64,
    ) -> Result<Self, Fault> {
        let (upper, lower, given) = matrix.unknown_part(unknowns, diagonal);
        let matrix = Cholesky::new(upper.pattern(), lower.pattern(), &lower.values);
        Ok(Self {
            matrix: matrix.ok_or_else(|| singular(unknowns.rows.len()))?,
            given,
        })
    }

    /// Right-hand sides due to the given rows' values in `field`.
    pub fn pulled<const K: usize>(&self, field: impl Fn(usize) -> [f64; K]) -> Vec<[f64; K]> {
        let mut out = vec![[0.0; K]; self.matrix.unknowns()];
        for &(k, row, value) in &self.given {
            subtract(&mut out[k as usize], value, &field(row as usize));
        }
        out
    }

    /// Solves for `K` right-hand sides in place; a row of `x` has one value of each.
    pub fn solve<const K: usize>(&self, x: &mut [[f64; K]]) {
        with_avx2(
            #[inline(always)]
            || self.substitute(x),
        );
    }

    /// Forward and backward substitution.
    #[inline(always)]
    fn substitute<const K: usize>(&self, y: &mut [[f64; K]]) {
        let mut below: Vec<[f64; K]> = Vec::new();
        for s in 0..self.matrix.blocks() {
            Columns(self.matrix.block(s)).forwards(y, &mut below);
        }
        for s in (0..self.matrix.blocks()).rev() {
            Columns(self.matrix.block(s)).back(y, &mut below);
        }
    }
}

/// The columns of a supernode, to substitute with.
struct Columns<'a>(Block<'a>);

impl Columns<'_> {
    /// Rows of a column in the diagonal block, and below it.
    #[inline(always)]
    fn column(&self, j: usize) -> (&[f64], &[f64]) {
        let height = self.0.width + self.0.rows.len();
        self.0.values[j * height..(j + 1) * height].split_at(self.0.width)
    }

    /// The rows below the diagonal block of four columns, side by side.
    #[inline(always)]
    fn four(&self, j: usize) -> impl Iterator<Item = [f64; 4]> {
        let [a, b, c, d] = [0, 1, 2, 3].map(|k| self.column(j + k).1);
        let columns = a.iter().zip(b).zip(c).zip(d);
        columns.map(|(((a, b), c), d)| [*a, *b, *c, *d])
    }

    /// Forward substitution of its columns, subtracting them from the rows below; `below` is scratch space for those.
    #[inline(always)]
    fn forwards<const K: usize>(&self, y: &mut [[f64; K]], below: &mut Vec<[f64; K]>) {
        below.clear();
        below.resize(self.0.rows.len(), [0.0; K]);
        let own = &mut y[self.0.from..self.0.from + self.0.width];
        for j in 0..self.0.width {
            let (top, _) = self.column(j);
            let solved = own[j].map(|v| v / top[j]);
            own[j] = solved;
            for (l, y) in top[j + 1..].iter().zip(&mut own[j + 1..]) {
                subtract(y, *l, &solved);
            }
        }
        let (fours, rest) = own.as_chunks::<4>();
        for (four, j) in fours.iter().zip((0..).step_by(4)) {
            for (sum, [a, b, c, d]) in below.iter_mut().zip(self.four(j)) {
                for k in 0..K {
                    sum[k] += a * four[0][k] + b * four[1][k] + c * four[2][k] + d * four[3][k];
                }
            }
        }
        for (one, j) in rest.iter().zip(4 * fours.len()..) {
            for (sum, l) in below.iter_mut().zip(self.column(j).1) {
                for k in 0..K {
                    sum[k] += l * one[k];
                }
            }
        }
        for (&r, b) in self.0.rows.iter().zip(&*below) {
            subtract(&mut y[r as usize], 1.0, b);
        }
    }

    /// Backward substitution of its columns, subtracting the rows below; `below` is scratch space for those.
    #[inline(always)]
    fn back<const K: usize>(&self, y: &mut [[f64; K]], below: &mut Vec<[f64; K]>) {
        below.clear();
        below.extend(self.0.rows.iter().map(|&r| y[r as usize]));
        let own = &mut y[self.0.from..self.0.from + self.0.width];
        let (fours, rest) = own.as_chunks_mut::<4>();
        let count = fours.len();
        for (four, j) in fours.iter_mut().zip((0..).step_by(4)) {
            let mut sums = *four;
            for (y, l) in below.iter().zip(self.four(j)) {
                for (sum, l) in sums.iter_mut().zip(l) {
                    subtract(sum, l, y);
                }
            }
            *four = sums;
        }
        for (one, j) in rest.iter_mut().zip(4 * count..) {
            for (l, y) in self.column(j).1.iter().zip(&*below) {
                subtract(one, *l, y);
            }
        }
        for j in (0..self.0.width).rev() {
            let (top, _) = self.column(j);
            let mut solved = own[j];
            for (l, y) in top[j + 1..].iter().zip(&own[j + 1..]) {
                subtract(&mut solved, *l, y);
            }
            own[j] = solved.map(|v| v / top[j]);
        }
    }
}

#[inline(always)]
fn subtract<const K: usize>(from: &mut [f64; K], l: f64, what: &[f64; K]) {
    for k in 0..K {
        from[k] -= l * what[k];
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
        Rows::from_triplets(n as usize, triplets)
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
        let all = [0, 1, 2, 3, 4, 5];
        let inner = Unknowns::new(&all, |v| (1..5).contains(&v));
        let factor = Factor::new(&l, &inner, |_| 0.0).unwrap();
        // Ends held at 0 and 5, and at 1: the last unknown feels the pull of 5.
        let mut x = factor.pulled(|v| [v as f64, 1.0]);
        assert_eq!(x, [[0.0, 1.0], [0.0, 0.0], [0.0, 0.0], [5.0, 1.0]]);
        factor.solve(&mut x);
        for (k, value) in x.iter().enumerate() {
            assert!((value[0] - (k + 1) as f64).abs() < 1e-12);
            assert!((value[1] - 1.0).abs() < 1e-12);
        }
        assert!(Factor::new(&l, &Unknowns::new(&all, |_| true), |_| 0.0).is_err());
    }

    #[test]
    fn solving_a_grid_gives_back_what_was_multiplied() {
        // Large enough for supernodes of several columns.
        const SIDE: u32 = 30;
        let mut triplets = Vec::new();
        let mut join = |a: u32, b: u32| {
            triplets.extend([(a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)]);
        };
        for v in 0..SIDE * SIDE {
            if v % SIDE + 1 < SIDE {
                join(v, v + 1);
            }
            if v + SIDE < SIDE * SIDE {
                join(v, v + SIDE);
            }
        }
        let n = (SIDE * SIDE) as usize;
        let square = Rows::from_triplets(n, triplets).squared(&vec![1.0; n]);
        let mut random = fastrand::Rng::with_seed(3);
        let truth: Vec<Vec3> = (0..n).map(|_| Vec3::from_fn(|_, _| random.f64())).collect();
        let eliminated = square.elimination();
        let by_number: Vec<u32> = (0..SIDE * SIDE).collect();
        for order in [&by_number, &eliminated] {
            let all = Unknowns::new(order, |_| true);
            assert!((0..n).all(|v| all.place(v).is_some()));
            let factor = Factor::new(&square.arranged(order), &all, |_| 0.1).unwrap();
            let mut x: Vec<[f64; 3]> = order
                .iter()
                .map(|&r| (square.row_times(r as usize, &truth) + truth[r as usize] * 0.1).into())
                .collect();
            factor.solve(&mut x);
            for (x, &v) in x.iter().zip(order) {
                assert!((Vec3::from(*x) - truth[v as usize]).norm() < 1e-9);
            }
        }
        // A part of the order serves a part of the matrix: half of the grid, the other half given as 0.
        let left = Unknowns::new(&eliminated, |v| v as u32 % SIDE < SIDE / 2);
        let arranged = square.arranged(&eliminated);
        let factor = Factor::new(&arranged, &left, |_| 0.0).unwrap();
        let mut half = truth.clone();
        for v in (0..n).filter(|&v| left.place(v).is_none()) {
            half[v] = Vec3::zeros();
        }
        let times = |&v: &u32| square.row_times(v as usize, &half).into();
        let mut x: Vec<[f64; 3]> = left.rows.iter().map(times).collect();
        factor.solve(&mut x);
        for (x, &v) in x.iter().zip(&left.rows) {
            assert!((Vec3::from(*x) - half[v as usize]).norm() < 1e-9);
        }
    }

    #[test]
    fn a_system_without_unknowns_is_solved() {
        let nothing = Rows::from_triplets(3, Vec::new());
        let none = Unknowns::new(&[0, 1, 2], |_| false);
        let factor = Factor::new(&nothing, &none, |_| 0.0).unwrap();
        factor.solve::<3>(&mut []);
    }
}
