//! Cholesky factors of sparse symmetric matrices, column by column in supernodes.
//!
//! Memory: 12 bytes per stored entry. Cost of a factor: about n^1.5 for meshes.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::amd;
use faer::sparse::linalg::cholesky::supernodal::SymbolicSupernodalCholesky;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Par, Side};

/// Where a square matrix has entries.
#[derive(Clone, Copy)]
pub struct Pattern<'a> {
    /// Where the entries of each column begin, and where the last column ends.
    pub starts: &'a [u32],
    /// The row of each entry.
    pub rows: &'a [u32],
}

impl<'a> Pattern<'a> {
    fn faer(self) -> SymbolicSparseColMatRef<'a, u32> {
        let n = self.starts.len() - 1;
        SymbolicSparseColMatRef::new_unsorted_checked(n, n, self.starts, None, self.rows)
    }
}

/// The rows of a symmetric matrix in an order of elimination that leaves few entries in a factor (AMD).
///
/// # Panics
/// If memory is exhausted.
pub fn elimination(pattern: Pattern) -> Vec<u32> {
    let n = pattern.starts.len() - 1;
    let (mut order, mut place) = (vec![0_u32; n], vec![0_u32; n]);
    let room = amd::order_maybe_unsorted_scratch::<u32>(n, pattern.rows.len());
    let stack = &mut MemBuffer::new(room);
    amd::order_maybe_unsorted(
        &mut order,
        &mut place,
        pattern.faer(),
        amd::Control::default(),
        MemStack::new(stack),
    )
    .expect("memory, and fewer entries than an index can count");
    order
}

/// A Cholesky factor in supernodes.
pub struct Cholesky {
    symbolic: SymbolicCholesky<u32>,
    values: Vec<f64>,
}

/// A supernode: adjacent columns with the same rows below the diagonal.
pub struct Block<'a> {
    /// The first column, and first row of the diagonal block.
    pub from: usize,
    /// Number of columns.
    pub width: usize,
    /// Rows below the diagonal block.
    pub rows: &'a [u32],
    /// Values, column by column, and those of the blocks behind.
    pub values: &'a [f64],
}

impl Cholesky {
    /// Factors a matrix in the order that it has, given the pattern of its upper half, that of its lower one, and the values
    /// of the lower one; `None` if it is not positive definite.
    pub fn new(upper: Pattern, lower: Pattern, values: &[f64]) -> Option<Self> {
        // faer analyses the upper half of a matrix that it does not reorder, and factors the lower one.
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..Default::default()
        };
        let order = SymmetricOrdering::Identity;
        let symbolic =
            factorize_symbolic_cholesky(upper.faer(), Side::Upper, order, params).ok()?;
        let matrix = SparseColMatRef::new(lower.faer(), values);
        let mut values = vec![0.0; symbolic.len_val()];
        let room = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        symbolic
            .factorize_numeric_llt(
                &mut values,
                matrix,
                Side::Lower,
                Default::default(),
                Par::Seq,
                MemStack::new(&mut MemBuffer::new(room)),
                Default::default(),
            )
            .ok()?;
        Some(Self { symbolic, values })
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.symbolic.nrows()
    }

    fn supernodes(&self) -> Option<&SymbolicSupernodalCholesky<u32>> {
        match self.symbolic.raw() {
            SymbolicCholeskyRaw::Supernodal(blocks) => Some(blocks),
            // Without unknowns; otherwise supernodes were forced.
            SymbolicCholeskyRaw::Simplicial(_) => None,
        }
    }

    /// Number of supernodes.
    pub fn blocks(&self) -> usize {
        self.supernodes().map_or(0, |blocks| blocks.n_supernodes())
    }

    /// A supernode.
    ///
    /// # Panics
    /// If there are not so many.
    pub fn block(&self, s: usize) -> Block<'_> {
        let blocks = self.supernodes().expect("a supernode of this number");
        let from = blocks.supernode_begin()[s] as usize;
        Block {
            from,
            width: blocks.supernode_end()[s] as usize - from,
            rows: blocks.supernode(s).pattern(),
            values: &self.values[blocks.col_ptr_for_val()[s] as usize..],
        }
    }
}
