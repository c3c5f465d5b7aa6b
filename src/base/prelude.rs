//! What the standard library brings into every file and `core` lacks: memory from an allocator, the mathematics of floats
//! (`libm`). Only for builds without it, in files that use any of it.

pub(crate) use alloc::{borrow::ToOwned, boxed::Box, format, string::String, vec, vec::Vec};
pub(crate) use num_traits::Float as _;
