//! `mien-studio units`: priors and readings of the units, learned in advance, as tables for `config/units.toml`.
//!
//! ```text
//! priors    rest and range of every measure, over people
//! readings  how each unit is read from all measures together ◄─ examples ◄─ glance
//!           gaze: where eyes look, from the same examples; smiles: real ones
//! ```

mod examples;
mod gaze;
mod glance;
pub mod priors;
pub mod readings;
mod smiles;
