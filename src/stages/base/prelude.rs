//! Allocation and floating-point mathematics (`libm`) for builds without the standard library. A file that needs only the
//! mathematics imports it under `#[cfg(not(feature = "std"))]`.

pub use alloc::{borrow::ToOwned, boxed::Box, format, string::String, vec, vec::Vec};
#[cfg(not(feature = "std"))]
pub use num_traits::Float as _;
