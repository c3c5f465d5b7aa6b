//! Random expressions: brows, eyes, jaw and mouth, several at once, with unequal sides.

use fastrand::Rng;

use super::random::normal;
use mien_simulator::virtual_head::HeadAsset;

/// Weights of a random expression.
pub(super) fn expression(asset: &HeadAsset, rng: &mut Rng) -> Vec<f32> {
    let mut act = Act {
        asset,
        weights: vec![0.0; asset.expressions.len()],
    };
    if rng.f32() < 0.2 {
        if rng.f32() < 0.3 {
            act.both("jawOpen", 0.06 * rng.f32(), rng);
            act.both("mouthSmile", 0.1 * rng.f32(), rng);
        }
        return act.weights;
    }
    act.brows(rng);
    act.eyes(rng);
    act.jaw(rng);
    for _ in 0..1 + rng.usize(..2) {
        act.mouth(rng);
    }
    act.weights
}

/// An expression being composed.
struct Act<'a> {
    asset: &'a HeadAsset,
    weights: Vec<f32>,
}

impl Act<'_> {
    /// Raises a weight to at least this value.
    fn set(&mut self, name: &str, weight: f32) {
        if let Some(k) = self.asset.expression(name) {
            self.weights[k] = f32::max(self.weights[k], weight.clamp(0.0, 1.15));
        }
    }

    /// Sets both sides, slightly unequal, occasionally only one.
    fn both(&mut self, stem: &str, weight: f32, rng: &mut Rng) {
        let uneven = 0.12 * normal(rng);
        let (mut left, mut right) = (weight * (1.0 + uneven), weight * (1.0 - uneven));
        // Winks: a lid closes alone more often than other parts act on one side, and the other hardly moves.
        match rng.u8(..if stem == "eyeBlink" { 5 } else { 20 }) {
            0 => left = 0.0,
            1 => right = 0.0,
            _ => {}
        }
        self.set(&format!("{stem}_L"), left);
        self.set(&format!("{stem}_R"), right);
        // Expressions without sides.
        self.set(stem, weight);
    }

    /// Sets one of two at random.
    fn one(&mut self, [a, b]: [&str; 2], weight: f32, rng: &mut Rng) {
        self.both(if rng.bool() { a } else { b }, weight, rng);
    }

    fn brows(&mut self, rng: &mut Rng) {
        match rng.u8(..10) {
            0 | 1 => {
                self.both("browInnerUp", rng.f32(), rng);
                self.both("browOuterUp", 1.2 * rng.f32(), rng);
            }
            2 => self.both("browInnerUp", 0.5 + 0.6 * rng.f32(), rng),
            3 => self.both("browOuterUp", 0.5 + 0.6 * rng.f32(), rng),
            4 => self.both("browDown", 0.6 + 0.5 * rng.f32(), rng),
            5 => self.both("browDown", rng.f32(), rng),
            _ => {}
        }
    }

    fn eyes(&mut self, rng: &mut Rng) {
        match rng.u8(..20) {
            0..=3 => self.both("eyeBlink", 0.95 + 0.05 * rng.f32(), rng),
            4..=5 => self.both("eyeBlink", rng.f32(), rng),
            6..=9 => self.both("eyeWide", rng.f32() * 1.1, rng),
            10..=12 => self.both("eyeSquint", rng.f32(), rng),
            13 => self.both("eyeLookDown", rng.f32(), rng),
            14 => self.both("eyeLookUp", rng.f32(), rng),
            _ => {}
        }
        // To a side, both eyes together.
        if rng.f32() < 0.3 {
            let aside = rng.f32();
            let mut ways = ["In", "Out"];
            if rng.bool() {
                ways.reverse();
            }
            let [left, right] = ways;
            self.both(&format!("eyeLook{left}_L"), aside, rng);
            self.both(&format!("eyeLook{right}_R"), aside, rng);
        }
    }

    fn jaw(&mut self, rng: &mut Rng) {
        let jaw = match rng.u8(..10) {
            0 | 1 => 0.6 + 0.5 * rng.f32(),
            2..=4 => 0.6 * rng.f32(),
            5 | 6 => 0.25 * rng.f32(),
            _ => 0.0,
        };
        self.both("jawOpen", jaw, rng);
        if jaw > 0.1 && rng.f32() < 0.15 {
            self.both("mouthClose", jaw * rng.f32(), rng);
        }
    }

    /// One action of mouth, cheeks, nose and jaw.
    fn mouth(&mut self, rng: &mut Rng) {
        let weight = rng.f32().sqrt();
        match rng.u8(..24) {
            0..=2 => {
                self.both("mouthSmile", weight, rng);
                self.both("cheekRaiser", 0.6 * weight * rng.f32(), rng);
            }
            3 => self.both("mouthFunnel", weight, rng),
            4 => self.both("mouthPucker", weight, rng),
            5 | 6 => self.both("mouthStretch", weight, rng),
            7 => self.both("mouthUpperUp", weight, rng),
            8 => self.both("mouthLowerDown", weight, rng),
            9 => {
                self.both("mouthShrugLower", weight, rng);
                self.both("mouthShrugUpper", rng.f32() * weight, rng);
            }
            10 => self.both("cheekPuff", weight, rng),
            11 => self.both("noseSneer", weight, rng),
            12 => self.one(["jawLeft", "jawRight"], weight, rng),
            13 => self.both("jawForward", weight, rng),
            14 | 15 => {
                self.both("mouthFrown", weight, rng);
                self.both("mouthShrugLower", rng.f32() * weight, rng);
            }
            16 => self.both("mouthDimple", weight, rng),
            17 => self.both("mouthPress", weight, rng),
            18 => {
                self.both("mouthRollLower", weight, rng);
                self.both("mouthRollUpper", weight, rng);
            }
            19 => self.one(["mouthRollLower", "mouthRollUpper"], weight, rng),
            20 => self.one(["mouthLeft", "mouthRight"], weight, rng),
            21 => self.both("cheekSquint", weight, rng),
            _ => {}
        }
    }
}
