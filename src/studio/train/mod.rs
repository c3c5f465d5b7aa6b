//! Training of the face model, one step per file.
//!
//! `shape` samples a population of 3D faces and takes its principal components; `points` fits them to annotated
//! portraits; `samples` cuts head windows with disturbed starts; `cascade` learns the update matrices by ridge regression
//! (`ridge`) where the previous stage really ends; `confidence` learns what a fitted face looks like; `evaluate` measures
//! people who were not trained on (`fit` does the same for any pictures); `report` makes a page of it. All of it is seeded.

pub mod cascade;
pub mod confidence;
pub mod dataset;
pub mod evaluate;
mod hair;
pub mod paper_aam;
pub mod person;
pub mod points;
pub mod refine;
pub mod render;
pub mod report;
pub mod ridge;
pub mod samples;
pub mod schedule;
pub mod shape;
pub mod standard_head;
mod wear;

pub use schedule::{TrainArgs, TrainError, finish, train, train_paper_into, train_person};
