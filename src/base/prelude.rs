//! What the standard library's prelude provides and `core` lacks: allocation and floating-point mathematics (`libm`). Only
//! for builds without the standard library, in files that need it.

pub(crate) use alloc::{borrow::ToOwned, boxed::Box, format, string::String, vec, vec::Vec};
pub(crate) use num_traits::Float as _;
