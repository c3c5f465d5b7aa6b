//! Training of the face model, one step per file. All of it is seeded.
//!
//! ```text
//! shape            a population of 3D faces, and its principal components
//! standard_head    the head that depth poses are measured on
//! dataset, points  annotated portraits, and the 3D faces fitted to them
//! render           drawn faces with known truth: acting, worn, and as a camera's photograph;
//!                  hair_and_headwear on a grey_picture, varied by random
//! samples          head windows with disturbed starts
//! cascade          update matrices by ridge regression (ridge), where the stage before really ends
//! refine           lids and lips from depth
//! confidence       what a fitted face looks like
//! paper_aam        the paper's active appearance model, paper_aam_fits: what it reaches; person: the same of one person
//! args             what to train from
//! schedule         all of this in order; paper_section: the paper's model in its model file
//! evaluate         errors of people who were not trained on
//! ```

mod acting;
mod args;
pub mod cascade;
pub mod confidence;
pub mod evaluate;
mod grey_picture;
mod hair_and_headwear;
pub mod paper_aam;
mod paper_aam_fits;
mod paper_section;
pub mod person;
mod photograph;
pub mod points;
mod random;
pub mod refine;
pub mod render;
pub mod ridge;
pub mod samples;
pub mod schedule;
pub mod shape;
pub mod standard_head;
#[cfg(test)]
mod tests;
mod worn;

pub use args::TrainArgs;

use mien_workbench::fault::Fault;

/// Trains what the words ask for: a whole model, or the paper's part of one.
///
/// # Errors
/// If the data cannot be read, is too little, or the result cannot be written.
pub fn run(args: &TrainArgs, say: &mut dyn FnMut(&str)) -> Result<(), Fault> {
    if args.person.is_some() || args.paper_into.is_some() {
        paper_section::replace(args, say)
    } else {
        schedule::train(args, say)
    }
}
