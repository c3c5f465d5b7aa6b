//! The workstation: training the face model, baking heads, figures, pictures, recordings. Exists only with the feature
//! `studio`.
//!
//! ```text
//! cli            the command line: words to the commands below
//! record         a recording from the sensor or the simulator
//! inspect        any of our files as a page or a sheet of pictures
//! preview        a page that shows live what is received
//! train          the face model; units: what is known of units before anybody is seen
//! fit            landmarks of still pictures
//! evaluate       figures against truth
//! bake           a head and 68 points become blendshapes; animate: a run moves them and turns the head
//! place          a page to put the 68 points on a head
//! heads          heads to draw, with the photographs of people
//! nrsfm          3D shapes from 2D tracks
//!
//! progress, stopped, streams   how far long work is, what Ctrl-C leaves of it, what is printed; fault: why it failed
//! people_split   the data sets, and who of them is trained on
//! text_files, csv, atomic_write   texts and tables in, files out
//! chart, picture_files   curves and words in pictures, and their files
//! correlation, frame_time, srgb, strongest, thin_plate   what several of them reckon with
//! ```

/// As the standard library's, which panic where a stream takes no more.
macro_rules! print {
    ($($words:tt)*) => { $crate::studio::streams::print(format_args!($($words)*)) };
}
macro_rules! println {
    ($($words:tt)*) => { $crate::studio::streams::print(format_args!("{}\n", format_args!($($words)*))) };
}
macro_rules! eprintln {
    ($($words:tt)*) => { $crate::studio::streams::print_error(format_args!($($words)*)) };
}

pub mod animate;
pub mod atomic_write;
pub mod bake;
pub mod chart;
pub mod cli;
pub mod completions;
pub mod correlation;
pub mod csv;
pub mod evaluate;
pub mod fault;
pub mod fit;
pub mod frame_time;
pub mod heads;
pub mod inspect;
pub mod nrsfm;
pub mod people_split;
pub mod picture_files;
pub mod place;
pub mod preview;
pub mod progress;
pub mod record;
pub mod srgb;
pub mod stopped;
pub mod streams;
pub mod strongest;
pub mod text_files;
pub mod thin_plate;
pub mod train;
pub mod units;

#[cfg(test)]
#[path = "../../tests/common/data.rs"]
pub(crate) mod data;
#[cfg(test)]
#[path = "../../tests/common/golden.rs"]
pub(crate) mod golden;
