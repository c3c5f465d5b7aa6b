//! Non-rigid structure from motion: 3D shapes and cameras from 2D point tracks (paper section 1.2, equation 3).
//!
//! ```text
//! tracks          2D tracks and 3D shapes, as CSV
//! cameras         initial cameras, by factorisation
//! em              shapes, modes and cameras by EM with a low-rank Gaussian prior; solve: numerics of one step
//! reconstruction  tracks ─► cameras ─► short EM from each ─► the likeliest, to convergence ─► shapes
//! align           rigid alignment of shapes, and the error of the literature
//! shape_model     base shape and shape bases: shapes of several sequences, and PCA
//! run             the command `mien-studio nrsfm`
//! ```

pub(crate) mod align;
mod cameras;
mod em;
mod reconstruction;
mod run;
mod shape_model;
mod solve;
mod tracks;

pub use align::{rigid_mean_shape, shape_error};
pub use reconstruction::{Reconstruction, Settings, nrsfm};
pub use run::{Args, run};
pub use shape_model::{ShapeBases, shape_model_from_sequences};
pub use tracks::{Shapes, Tracks};

#[cfg(test)]
mod tests;
