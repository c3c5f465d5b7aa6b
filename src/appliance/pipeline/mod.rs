//! The stages in order, for every person.

mod follower;
mod people;
mod rebuild;
mod settings;
mod stage;
mod stages;
#[cfg(test)]
pub(crate) mod tests;

pub use people::PipelineError;
#[cfg(feature = "studio")]
pub use people::{FIRST_LOOK, FIRST_LOOK_APART, SECOND_LOOK, SECOND_LOOK_APART};
pub use settings::Settings;
pub use stage::Stage;
pub use stages::Pipeline;
