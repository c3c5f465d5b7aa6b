//! Code shared by all commands of the workstation.
//!
//! ```text
//! progress, stopped, streams   progress of long work, interruption, output; fault: errors
//! people_split   the data sets and their split by person; dataset: annotated images
//! text_files, csv, atomic_write, picture_files   texts, tables and images in, files out
//! still          landmarks of a still image; canvas: drawing them
//! correlation, similarity, srgb, strongest, thin_plate   shared numerics
//! ```

/// As the standard library's, which panics on a full or closed stream.
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
