//! The stages in order, for every person.

mod follower;
mod image_only;
mod people;
mod rebuild;
mod recognition;
mod settings;
mod stage;
mod stages;
#[cfg(test)]
pub(crate) mod tests;

pub use people::PipelineError;
pub use recognition::{REID_EARLY_DISTANCE, REID_FULL_DISTANCE, REID_FULL_FRAMES, REID_MIN_FRAMES};
pub use settings::Settings;
pub use stage::Stage;
pub use stages::Pipeline;
