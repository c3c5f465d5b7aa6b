//! The face model: 3D shape modes, the fitting cascade and the standard head, in one file read at start-up.
//!
//! **Shape.** `X = mean + Σ b_i σ_i m_i`: 68 points in the head frame of [`crate::base::geometry`], metres, rigid motion and size
//! removed on the [`scheme::STABLE`] points; modes `m_i` orthonormal over all 204 coordinates, `σ_i` their standard
//! deviation in the training population, `b_i` therefore about N(0, 1). The population holds every face with its mirror
//! image, so each mode is even or odd under left-right mirroring. Principal component analysis of 3D shape as in the combined
//! 2D+3D active appearance models (Xiao, Baker, Matthews, Kanade 2004).
//!
//! **Cascade.** Update matrices of the stages of [`crate::landmarks`]: two bits a weight, in units of one scale for each row and patch.
//!
//! Memory: 0.1 MB per stage. The built-in model's update matrices are used in place; everything else is allocated while
//! reading. Limits: see [`mod@file`].

pub mod error;
pub mod file;
pub mod model;
pub(crate) mod reader;
pub mod refinement;
pub mod scheme;
pub mod sizes;
mod template;

pub use error::ModelError;
pub use file::SHIPPED;
pub use model::*;
pub use reader::Short;
pub use sizes::*;
pub use template::FaceTemplate;
