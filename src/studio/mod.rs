//! The workstation: training the face model, pictures, recordings. Exists only with the feature `studio`.

mod acted;
pub mod animate;
pub mod bake;
pub mod bars;
pub mod cli;
pub mod default_head;
pub mod figures;
pub mod fit;
mod glances;
pub mod head_scenes;
pub mod heads;
pub mod ict;
pub mod inspect;
pub mod nrsfm;
pub mod preview;
pub mod priors;
pub mod readings;
pub mod record;
pub mod sessions;
mod smiles;
pub mod split;
pub mod text;
pub mod train;
