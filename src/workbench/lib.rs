//! What all commands of the workstation share.
//!
//! ```text
//! progress, stopped, streams   how far long work is, what Ctrl-C leaves of it, what is printed; fault: why it failed
//! people_split   the data sets, and who of them is trained on; dataset: annotated images
//! text_files, csv, atomic_write, picture_files   texts, tables and images in, files out
//! still          landmarks of a still image; canvas: landmarks drawn into it
//! correlation, similarity, srgb, strongest, thin_plate   numerics that several of them use
//! ```

/// As the standard library's, which panic where a stream takes no more.
#[macro_export]
macro_rules! print {
    ($($words:tt)*) => { $crate::streams::print(format_args!($($words)*)) };
}
/// As [`print!`], and a new line.
#[macro_export]
macro_rules! println {
    ($($words:tt)*) => { $crate::streams::print(format_args!("{}\n", format_args!($($words)*))) };
}
/// As [`println!`], to standard error.
#[macro_export]
macro_rules! eprintln {
    ($($words:tt)*) => { $crate::streams::print_error(format_args!($($words)*)) };
}

pub mod atomic_write;
pub mod canvas;
pub mod correlation;
pub mod csv;
pub mod dataset;
pub mod fault;
pub mod people_split;
pub mod picture_files;
pub mod progress;
pub mod similarity;
pub mod srgb;
pub mod still;
pub mod stopped;
pub mod streams;
pub mod strongest;
pub mod text_files;
pub mod thin_plate;
