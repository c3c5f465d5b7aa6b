//! Training of the face model, one step per file. All of it is seeded.
//!
//! ```text
//! shape            a population of 3D faces, and its principal components
//! standard_head    the head model for depth poses
//! dataset, points  annotated portraits, and the 3D faces fitted to them
//! render           rendered faces with known truth: acting, worn, and a camera's photograph;
//!                  hair_and_headwear on a grey_picture, varied by random
//! samples          head windows with disturbed starts
//! cascade          update matrices by ridge regression (ridge), on the output of earlier stages
//! refine           lids and lips from depth
//! round            a model of 8 bits a weight, converted
//! confidence       recognition of good fits
//! paper_aam        the paper's active appearance model; paper_aam_fits: its accuracy; person: for one person
//! template         the template of a face for the search in whole images
//! args             the arguments
//! schedule         all of this in order; paper_section: the paper's model in the model file
//! evaluate         errors on people not trained on
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
mod round;
pub mod samples;
pub mod schedule;
pub mod shape;
pub mod standard_head;
mod template;
#[cfg(test)]
mod tests;
mod worn;

pub use args::TrainArgs;

use mien_workbench::fault::Fault;

/// Trains as the arguments ask: a whole model, or its paper section.
///
/// # Errors
/// If the data cannot be read, is too little, or the result cannot be written.
pub fn run(args: &TrainArgs, say: &mut dyn FnMut(&str)) -> Result<(), Fault> {
    if args.template {
        template::learn(args, &args.out, say)
    } else if let Some(path) = &args.round {
        round::convert(args, path, say)
    } else if args.person.is_some() || args.paper_into.is_some() {
        paper_section::replace(args, say)
    } else {
        schedule::train(args, say)
    }
}
