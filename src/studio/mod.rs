//! The workstation: training the face model, pictures, recordings. Exists only with the feature `studio`.

pub mod animate;
pub mod atomic_write;
pub mod bake;
pub mod cli;
pub mod correlation;
pub mod csv;
pub mod evaluate;
pub mod fit;
pub mod frame_time;
pub mod heads;
pub mod inspect;
pub mod nrsfm;
pub mod people_split;
pub mod preview;
pub mod record;
pub mod text_files;
pub mod train;
pub mod units;
