//! Training of the face model, one step per file. All of it is seeded.
//!
//! ```text
//! shape            a population of 3D faces, and its principal components
//! standard_head    the head that depth poses are measured on
//! dataset, points  annotated portraits, and the 3D faces fitted to them
//! render           drawn faces with known truth; what they wear and hold:
//!                  hair_and_headwear, beards_glasses_hands on a grey_picture, varied by random
//! samples          head windows with disturbed starts
//! cascade          update matrices by ridge regression (ridge), where the stage before really ends
//! refine           lids and lips from depth
//! confidence       what a fitted face looks like
//! paper_aam        the paper's active appearance model; person: the same of one person, from seen_face to seen_face
//! schedule         all of this in order
//! evaluate         people who were not trained on; report makes a page of it
//! error            why training cannot be done
//! ```

mod beards_glasses_hands;
pub mod cascade;
pub mod confidence;
pub mod dataset;
pub mod error;
pub mod evaluate;
mod grey_picture;
mod hair_and_headwear;
pub mod paper_aam;
pub mod person;
pub mod points;
mod random;
pub mod refine;
pub mod render;
pub mod report;
pub mod ridge;
pub mod samples;
pub mod schedule;
mod seen_face;
pub mod shape;
pub mod standard_head;

pub use error::TrainError;
pub use schedule::{TrainArgs, finish, train, train_paper_into, train_person};
