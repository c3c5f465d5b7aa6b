//! What the ICT head says about each measure before anyone has been seen: rest over random identities, and how far each
//! expression at full weight moves it. `config/units.toml` holds the rounded numbers.
//!
//! Identities are drawn as neutral + Σ c_n mode_n, c_n ~ N(0, 1). Units: the inner-eye-corner distance w, of the neutral.
//! Limitation: the head has no pucker, stretch, jaw sideways or jaw forward, no wide eyes; those ranges are set by hand.

use nalgebra::Vector3;

use crate::capacity::{LANDMARKS, MEASURES};
use crate::expression::measures::{self, Measure};
use crate::geometry::Point;
use crate::studio::ict::IctHead;

/// Mean and standard deviation over people.
#[derive(Clone, Copy, Debug, Default)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
}

/// Mean and deviation of an iterator.
fn spread(values: impl Iterator<Item = f64> + Clone) -> Spread {
    let n = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / n;
    let sd = (values.map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt();
    Spread { mean, sd }
}

/// Rest of every measure, and its change by every expression (in the head's order), over random people.
pub struct Priors {
    /// Rest by measure.
    pub rest: [Spread; MEASURES],
    /// Change at full weight by expression, then by measure.
    pub change: Vec<[Spread; MEASURES]>,
}

/// Draws `people` identities from a seed.
#[must_use]
pub fn priors(head: &IctHead, people: usize, seed: u64) -> Priors {
    let mut random = fastrand::Rng::with_seed(seed);
    // Box-Muller.
    let mut normal = move || {
        (-2.0 * (1.0 - random.f32()).ln()).sqrt() * (std::f32::consts::TAU * random.f32()).cos()
    };
    let (mut rest, mut changes) = (Vec::new(), Vec::new());
    for _ in 0..people {
        let coefficients: Vec<f32> = head.identities.iter().map(|_| normal()).collect();
        let point = |l: usize, extra: Vector3<f32>| {
            let v = head.landmarks[l];
            let identity = head.identities.iter().zip(&coefficients);
            head.neutral[v] + identity.fold(extra, |sum, (mode, &c)| sum + mode.offsets[v] * c)
        };
        let neutral: [Point; LANDMARKS] = std::array::from_fn(|l| point(l, Vector3::zeros()));
        let raw = measures::raw(&neutral);
        let w = raw[Measure::EyeDistance as usize];
        let scaled = measures::scaled(&raw, w);
        let change: Vec<[f32; MEASURES]> = head
            .expressions
            .iter()
            .map(|expression| {
                let face: [Point; LANDMARKS] =
                    std::array::from_fn(|l| neutral[l] + expression.offsets[head.landmarks[l]]);
                let moved = measures::scaled(&measures::raw(&face), w);
                std::array::from_fn(|m| moved[m] - scaled[m])
            })
            .collect();
        rest.push(scaled);
        changes.push(change);
    }
    Priors {
        rest: std::array::from_fn(|m| spread(rest.iter().map(|r| f64::from(r[m])))),
        change: (0..head.expressions.len())
            .map(|e| std::array::from_fn(|m| spread(changes.iter().map(|c| f64::from(c[e][m])))))
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::PathBuf;

    #[test]
    fn prints_the_priors() {
        let data = std::env::var_os("MIEN_DATA").map_or_else(
            || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
            PathBuf::from,
        );
        let folder = data.join("ict_facekit");
        if !folder.exists() {
            println!("skipped: no ICT head at {}", folder.display());
            return;
        }
        let head = IctHead::read(&folder).unwrap();
        let priors = priors(&head, 400, 1);
        for measure in Measure::ALL {
            let m = measure as usize;
            println!(
                "{}: rest {:.3} ± {:.3}",
                measure.name(),
                priors.rest[m].mean,
                priors.rest[m].sd
            );
            for (expression, change) in head.expressions.iter().zip(&priors.change) {
                if change[m].mean.abs() > 0.02 {
                    println!(
                        "    {:20} {:+.3} ± {:.3}",
                        expression.name, change[m].mean, change[m].sd
                    );
                }
            }
        }
        let gap = priors.change[head.expression("jawOpen").unwrap()][Measure::LipGap as usize].mean;
        assert!(gap > 0.3, "opening the jaw opens the lips, by {gap} w");
    }
}
