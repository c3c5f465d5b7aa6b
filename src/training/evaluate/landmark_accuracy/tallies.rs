//! Errors under each condition, and calibration of confidence.

use std::collections::BTreeMap;
use std::fmt::{self, Display};

use crate::evaluate::sessions::{Spread, median};
use crate::train::evaluate::{differences, mean_percent};
use mien_simulator::virtual_head::Truth;
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::landmarks::Landmarks;

/// Name, figure and bound.
pub(super) type Row = (&'static str, String, &'static str);

/// Conditions whose values are averaged over frames; errors in percent of the outer-eye distance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Condition {
    /// Undisturbed image.
    Tracked,
    /// Undisturbed image: the constant offset per person and point.
    Offset,
    /// Undisturbed image: the error less that offset.
    Rest,
    /// From a cold start.
    Cold,
    /// Poses beyond the common angles.
    Beyond,
    /// Uncovered points while others are covered.
    Covered,
    /// Frames until a reappeared face is found with an error below 5 %.
    Recovered,
    /// A quarter of the light.
    Dim,
    /// Under a circling lamp.
    Lamp,
    /// Without the lamp, in the frames of `Lamp`.
    SameAsLamp,
    /// Root mean square motion of the points of a motionless face, by person.
    Jitter,
    /// Duration of a fit, milliseconds.
    Time,
}

/// Conditions that are counted as a share.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Share {
    /// Covered points that are flagged as hidden.
    Flagged,
    /// Visible points that are not flagged.
    Unflagged,
    /// Frames with a hidden face that are lost.
    Unseen,
    /// Good faces below the least confidence.
    Lost,
    /// Faces with an error beyond 10 % above the least confidence.
    Kept,
}

/// All measurements, over all people.
#[derive(Default)]
pub(super) struct Seen {
    pub(super) people: usize,
    /// Confidence from which a face counts.
    pub(super) least: f32,
    pub(super) faces: Calibration,
    pub(super) points: Calibration,
    pub(super) errors: BTreeMap<Condition, Vec<f64>>,
    /// Counts of yes, and of all.
    pub(super) shares: BTreeMap<Share, [usize; 2]>,
}

impl Seen {
    pub(super) fn add(&mut self, condition: Condition, error: f64) {
        self.errors.entry(condition).or_default().push(error);
    }

    pub(super) fn count(&mut self, share: Share, yes: bool) {
        let [good, all] = self.shares.entry(share).or_default();
        *good += usize::from(yes);
        *all += 1;
    }

    /// Records a fit's confidences and its error, which it returns.
    pub(super) fn record_fit(
        &mut self,
        fit: &Landmarks,
        truth: &Truth,
        covered: &[bool; LANDMARKS],
    ) -> f64 {
        let d = differences(&fit.pixels, &truth.landmarks_px);
        let error = f64::from(mean_percent(&d));
        self.faces.0.push((fit.confidence, error <= 5.0));
        for i in 0..LANDMARKS {
            let good = mean_percent(&d[i..=i]) <= 5.0 && !covered[i];
            self.points.0.push((fit.point_confidence[i], good));
        }
        if error <= 5.0 {
            self.count(Share::Lost, fit.confidence < self.least);
        } else if error > 10.0 {
            self.count(Share::Kept, fit.confidence >= self.least);
        }
        error
    }

    pub(super) fn merge(&mut self, other: Self) {
        self.people += other.people;
        self.faces.0.extend(other.faces.0);
        self.points.0.extend(other.points.0);
        for (condition, errors) in other.errors {
            self.errors.entry(condition).or_default().extend(errors);
        }
        for (share, [good, all]) in other.shares {
            let sum = self.shares.entry(share).or_default();
            *sum = [sum[0] + good, sum[1] + all];
        }
    }

    pub(super) fn errors(&self, condition: Condition) -> &[f64] {
        self.errors.get(&condition).map_or(&[], Vec::as_slice)
    }

    pub(super) fn spread(&self, condition: Condition) -> Spread {
        Spread::from_values(self.errors(condition).to_vec())
    }

    pub(super) fn median(&self, condition: Condition) -> f64 {
        median(self.errors(condition))
    }

    pub(super) fn percent(&self, share: Share) -> f64 {
        let [good, all] = self.shares.get(&share).copied().unwrap_or_default();
        100.0 * good as f64 / all.max(1) as f64
    }
}

/// Confidence of each face or point, and whether it was good; shown as the share of good ones by confidence, in five
/// bins.
#[derive(Default)]
pub(super) struct Calibration(Vec<(f32, bool)>);

impl Display for Calibration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let lines = (0..5).filter_map(|bin| {
            let near = |(sure, _): &&(f32, bool)| ((sure * 5.0) as usize).min(4) == bin;
            let some: Vec<_> = self.0.iter().filter(near).collect();
            let n = some.len() as f64;
            let said = some.iter().map(|one| f64::from(one.0)).sum::<f64>() / n;
            let was = some.iter().filter(|one| one.1).count() as f64 / n;
            (n > 0.0).then(|| format!("{said:.2} → {was:.2} ({n})"))
        });
        f.write_str(&lines.collect::<Vec<_>>().join("; "))
    }
}
