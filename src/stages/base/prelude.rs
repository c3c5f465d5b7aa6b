//! What the standard library's prelude provides and `core` lacks: allocation, and floating-point mathematics (`libm`). A file
//! that needs only the mathematics imports it only for builds without the standard library, which has them by itself.

pub use alloc::{borrow::ToOwned, boxed::Box, format, string::String, vec, vec::Vec};
#[cfg(not(feature = "std"))]
pub(crate) use num_traits::Float as _;
