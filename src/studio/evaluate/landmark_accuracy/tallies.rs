//! What is counted under a condition: errors, and how often what is believed is right.

use std::fmt::{self, Display, Write as _};

/// Faces or points by what they said of themselves.
#[derive(Clone, Copy, Debug, Default)]
struct Told {
    count: usize,
    confidence: f64,
    good: usize,
}

/// How often what is believed is within 5 %, by confidence in fifths.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Calibration([Told; 5]);

impl Calibration {
    pub(super) fn add(&mut self, confidence: f32, good: bool) {
        let bin = &mut self.0[((confidence * 5.0) as usize).min(4)];
        bin.count += 1;
        bin.confidence += f64::from(confidence);
        bin.good += usize::from(good);
    }

    pub(super) fn merge(&mut self, other: &Self) {
        for (a, b) in self.0.iter_mut().zip(&other.0) {
            a.count += b.count;
            a.confidence += b.confidence;
            a.good += b.good;
        }
    }
}

impl Display for Calibration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut line = String::new();
        for told in self.0.iter().filter(|told| told.count > 0) {
            let n = told.count as f64;
            let (said, was) = (told.confidence / n, told.good as f64 / n);
            let _ = write!(line, "{said:.2} → {was:.2} ({}); ", told.count);
        }
        f.write_str(line.trim_end_matches("; "))
    }
}

/// Errors (per cent) under one condition.
pub(super) type Errors = Vec<f64>;
