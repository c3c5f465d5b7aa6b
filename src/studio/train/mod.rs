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

/// The options of `mien-studio train`, explained.
pub const OPTIONS: &str = "  --images       folders of annotated portraits
  --out          model file to write; a page of errors on held-out people is written beside it
  --data         folder of the data sets: the head that is drawn (ict_facekit) and the photographs it wears
                 (faces_frl189); default MIEN_DATA of the environment, else ../shared/data
  --drawn        drawn faces; default 18000
  --starts       disturbed starts for each portrait and its mirror image; default 4
  --seed         of everything random; default 1
  --tracks       tracks of an actor, to give the paper's model that actor's 3D shape; default: a rendered actor
  --offsets      where to write the mean offset of each landmark
  --refine       retrains only the confidence, and lids and lips from depth, of this model
  --no-paper     leaves out the paper's appearance model
  --paper-of     keeps the paper's appearance model of this model file
  --paper-into   trains the paper's appearance model alone and puts it into this model file, which otherwise stays the same
  --person       a recording of one person who goes through all expressions: a model of that person alone
  --hold-out-dev also holds out the people used for choosing settings, to measure on them
";

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
