//! The stages in order, for every person, and their memory budget.

pub mod budget;
#[cfg(feature = "std")]
mod follower;
#[cfg(feature = "std")]
mod people;
#[cfg(feature = "std")]
mod settings;
#[cfg(feature = "std")]
mod stage;
#[cfg(feature = "std")]
mod stages;
#[cfg(all(test, feature = "std"))]
pub(crate) mod tests;

#[cfg(feature = "std")]
pub use people::PipelineError;
#[cfg(feature = "studio")]
pub(crate) use people::{FIRST_LOOK, FIRST_LOOK_APART, SECOND_LOOK, SECOND_LOOK_APART};
#[cfg(feature = "std")]
pub use settings::Settings;
#[cfg(feature = "std")]
pub use stage::Stage;
#[cfg(feature = "std")]
pub use stages::Pipeline;
