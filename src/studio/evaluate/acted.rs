//! Ground truth of each unit's weight while a rendered head acts: the expressions that make up the unit, by name.
//!
//! AU25 parts the lips for any reason, so its truth is the true lip gap relative to that of a fully open jaw. For the others it is
//! the weight of an expression, or the mean of several.

use crate::expression::measures::{self, Measure};
use crate::simulator::virtual_head::{HeadAsset, Truth};

/// Units and the expressions they stand for.
pub(crate) const UNITS: [(&str, &[&str]); 40] = [
    ("AU25", &[]),
    ("AU20", &["mouthStretch_L", "mouthStretch_R"]),
    ("AU18", &["mouthPucker"]),
    ("AU30L", &["jawLeft"]),
    ("AU30R", &["jawRight"]),
    ("AU29", &["jawForward"]),
    ("AU22", &["mouthFunnel"]),
    ("AU28", &["mouthRollLower", "mouthRollUpper"]),
    ("AU2L", &["browOuterUp_L"]),
    ("AU4L", &["browDown_L"]),
    ("AU2R", &["browOuterUp_R"]),
    ("AU4R", &["browDown_R"]),
    ("AU5L", &["eyeWide_L"]),
    ("AU43L", &["eyeBlink_L"]),
    ("AU5R", &["eyeWide_R"]),
    ("AU43R", &["eyeBlink_R"]),
    ("AU9L", &["noseSneer_L"]),
    ("AU9R", &["noseSneer_R"]),
    ("AU26", &["jawOpen"]),
    ("AU17", &["mouthShrugLower"]),
    ("AU12L", &["mouthSmile_L"]),
    ("AU12R", &["mouthSmile_R"]),
    ("AU1L", &["browInnerUp_L"]),
    ("AU1R", &["browInnerUp_R"]),
    ("AU10L", &["mouthUpperUp_L"]),
    ("AU10R", &["mouthUpperUp_R"]),
    ("AU34L", &["cheekPuff_L"]),
    ("AU34R", &["cheekPuff_R"]),
    ("AU6L", &["cheekSquint_L"]),
    ("AU6R", &["cheekSquint_R"]),
    ("AU7L", &["eyeSquint_L"]),
    ("AU7R", &["eyeSquint_R"]),
    ("AU14L", &["mouthDimple_L"]),
    ("AU14R", &["mouthDimple_R"]),
    ("AU15L", &["mouthFrown_L"]),
    ("AU15R", &["mouthFrown_R"]),
    ("AU16L", &["mouthLowerDown_L"]),
    ("AU16R", &["mouthLowerDown_R"]),
    ("AU24L", &["mouthPress_L"]),
    ("AU24R", &["mouthPress_R"]),
];

/// Reads the truth of a head.
pub(crate) struct Acted {
    /// By unit, the expressions' positions.
    units: Vec<(&'static str, Vec<usize>)>,
    /// Lip gap at rest and with the jaw open, metres.
    gap: [f32; 2],
}

impl Acted {
    /// Of this head; units whose expressions it lacks are left out.
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

    /// Truth of a unit in a frame; none of units this head cannot act.
    pub(crate) fn of(&self, unit: &str, shown: &Truth) -> Option<f64> {
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
