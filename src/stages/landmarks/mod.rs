//! Grey image and head pose to 68 landmarks in the head frame, with confidence (paper section 1.2).

pub mod cascade;
pub mod eyes;
pub mod face_search;
pub mod features;
pub mod fit;
mod image_pose;
pub mod paper_aam;
mod points;
pub mod refine;
pub mod relief;
pub mod stage;
pub mod steady;
pub mod view;
pub mod visibility;
pub mod window;

pub use fit::{LandmarkFitter, Scratch, Settings};
pub use points::Landmarks;
pub use stage::{LandmarkError, LandmarkStage, Method, StageSettings};
