//! Symmetric linear systems, factored by `faer`.
//!
//! ```text
//! cholesky           sparse matrices: the order of elimination, factors in supernodes
//! normal_equations   dense ones of a ridge regression
//! rounding           few levels for the weights of a linear map
//! ```
//!
//! Nothing public is generic, and nothing else in the workspace names `faer`: its generic code is compiled once, here, and not
//! in every crate that solves a system and in the tests of that crate too.

pub mod cholesky;
pub mod normal_equations;
pub mod rounding;
