//! `mien-studio units`: readings of the units, learned in advance, as tables for `config/units.toml`; `tests` prints the priors
//! of measures.
//!
//! ```text
//! readings  how each unit is read from all measures together ◄─ examples
//!           gaze: where eyes look, from the same examples; smiles: real ones
//! ```

mod examples;
mod gaze;
pub mod readings;
mod smiles;
#[cfg(test)]
mod tests;
