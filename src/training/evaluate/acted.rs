//! Ground truth of each unit's weight while a rendered head acts: the expressions that make up the unit, by name.
//!
//! AU25 parts the lips for any reason, so its truth is the true lip gap relative to that of a fully open jaw. For the others it is
//! the weight of an expression, or the mean of several.

use std::sync::LazyLock;

use mien_simulator::virtual_head::{HeadAsset, Truth};
use mien_stages::expression::measures::{self, Measure};

/// Number of acted units.
pub(crate) const UNIT_COUNT: usize = 40;

/// The acted units, each with the expressions whose mean is its weight (a line of `acted.txt`); none for AU25.
pub(crate) static UNITS: LazyLock<[(&str, Vec<&str>); UNIT_COUNT]> = LazyLock::new(|| {
    let lines = include_str!("acted.txt").lines().map(|line| {
        let mut words = line.split(' ');
        (words.next().unwrap_or_default(), words.collect())
    });
    let lines: Vec<_> = lines.collect();
    lines.try_into().expect("acted.txt has UNIT_COUNT lines")
});

/// Reads the true weights of a head's units.
pub(crate) struct Acted {
    /// Indices of the expressions, by unit.
    units: Vec<(&'static str, Vec<usize>)>,
    /// Lip gap at rest and with the jaw open, metres.
    gap: [f32; 2],
}

impl Acted {
    /// For one head; units whose expressions it lacks are left out.
    pub(crate) fn new(asset: &HeadAsset) -> Self {
        let gap = [0.0, 1.0].map(|jaw| {
            let points = asset.acting(asset.expression("jawOpen"), jaw);
            measures::raw(&points)[Measure::LipGap as usize]
        });
        let units = UNITS.iter().filter_map(|(unit, names)| {
            let found: Vec<usize> = names.iter().filter_map(|n| asset.expression(n)).collect();
            (found.len() == names.len()).then_some((*unit, found))
        });
        Self {
            units: units.collect(),
            gap,
        }
    }

    /// True weight of a unit in a frame; `None` for units that the head cannot act.
    pub(crate) fn true_weight(&self, unit: &str, shown: &Truth) -> Option<f64> {
        let (_, expressions) = self.units.iter().find(|(name, _)| *name == unit)?;
        if expressions.is_empty() {
            let gap = measures::raw(&shown.landmarks_head)[Measure::LipGap as usize];
            let [shut, open] = self.gap;
            return Some(f64::from((gap - shut) / (open - shut)).max(0.0));
        }
        let weight = |&k: &usize| f64::from(shown.activations.get(k).copied().unwrap_or(0.0));
        Some(expressions.iter().map(weight).sum::<f64>() / expressions.len() as f64)
    }
}
