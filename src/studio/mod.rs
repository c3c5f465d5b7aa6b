//! The workstation: training the face model, baking heads, figures, pictures, recordings. Exists only with the feature
//! `studio`.
//!
//! ```text
//! cli            the command line: words to the commands below
//! record         a recording from the sensor or the simulator
//! inspect        any of our files as a page or a sheet of pictures
//! preview        a page that shows live what is received
//! train          the face model; units: what is known of units before anybody is seen
//! fit            landmarks of still pictures; fitted_picture: one of them with its points
//! evaluate       figures against truth
//! bake           a head and 68 points become blendshapes; animate: a run moves them, head_turn: their bone
//! place          a page to put the 68 points on a head
//! heads          heads to draw, with the photographs of people
//! nrsfm          3D shapes from 2D tracks
//!
//! progress, stopped   how far long work is, and what Ctrl-C leaves of it
//! people_split   who is trained on and who is not
//! text_files, csv, atomic_write   texts and tables in, files out
//! chart          curves and words in pictures
//! correlation, frame_time, srgb   what several of them reckon with
//! ```

pub mod animate;
pub mod atomic_write;
pub mod bake;
pub mod chart;
pub mod cli;
pub mod correlation;
pub mod csv;
pub mod evaluate;
pub mod fit;
pub mod fitted_picture;
pub mod frame_time;
pub mod head_turn;
pub mod heads;
pub mod inspect;
pub mod nrsfm;
pub mod people_split;
pub mod place;
pub mod preview;
pub mod progress;
pub mod record;
pub mod srgb;
pub mod stopped;
pub mod text_files;
pub mod train;
pub mod units;

#[cfg(test)]
#[path = "../../tests/common/data.rs"]
pub(crate) mod data;
