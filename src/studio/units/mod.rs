//! `mien-studio units`: what is learned of units before anybody is seen: priors, readings, glances.

mod glances;
pub mod priors;
pub mod readings;
mod smiles;
