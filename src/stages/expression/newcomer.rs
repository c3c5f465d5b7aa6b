//! Detects a change of person: an expression moves a few measures, another face moves most of them.
//!
//! The criterion is the share of measures whose median over the last ten seconds differs from the learned rest by more than
//! half a standard deviation over people: natural behaviour stays below 0.11, a held smile below 0.22, another person has 0.39
//! to 0.94 (simulated, 14 people). More than half for ten seconds means another person; after the face was lost for over two
//! seconds, when a change is likely, a third within two and a half seconds is enough.
//! No learner recovers from a change of person within a minute, so a detected change triggers a reset.
//!
//! Memory: 32 values per measure. Cost: a copy three times a second. Degenerate: poor samples (ω < 0.6) are ignored, and so are
//! measures whose rest is not known yet.
//! Limitation: a person with the same proportions goes unnoticed, which does no harm.

use crate::base::capacity::LEARNT_MEASURES;
use crate::base::defaults;

const SLOTS: usize = 32;
/// Seconds between two samples: [`SLOTS`] cover ten seconds.
const EVERY_S: f64 = 10.0 / SLOTS as f64;
/// Samples needed after a loss: two and a half seconds.
const SLOTS_AFTER_LOSS: usize = 8;
/// Share of deviating measures that means another person.
const SHARE: f64 = 0.5;
/// Share of deviating measures that means another person after a loss.
const SHARE_AFTER_LOSS: f64 = 1.0 / 3.0;
/// Samples for which the rule after a loss applies.
const SUSPICIOUS_SLOTS: usize = 16;
/// Least weight ω of a sample: below, pose dominates the measures.
const LEAST_WEIGHT: f64 = 0.6;

defaults! {
    /// Detector of a change of person.
    #[derive(Clone, Debug)]
    pub struct Newcomer {
        history: [[f32; LEARNT_MEASURES]; SLOTS] = [[0.0; LEARNT_MEASURES]; SLOTS],
        filled: usize = 0,
        next: usize = 0,
        waited_s: f64 = 0.0,
        suspicious: usize = 0,
    }
}

impl Newcomer {
    /// Marks a loss of the face: a change is then decided sooner and at a lower share.
    pub fn after_loss(&mut self) {
        *self = Self {
            suspicious: SUSPICIOUS_SLOTS,
            ..Self::default()
        };
    }

    /// Adds a frame's measures with weight ω; true if the person changed. `rest`: learnt rest of a measure, `None` while unknown; `sd`:
    /// its standard deviation over people.
    pub fn observe(
        &mut self,
        values: &[f64; LEARNT_MEASURES],
        omega: f64,
        dt: f64,
        rest: impl Fn(usize) -> Option<f64>,
        sd: impl Fn(usize) -> f64,
    ) -> bool {
        self.waited_s += dt;
        if omega < LEAST_WEIGHT || self.waited_s < EVERY_S {
            return false;
        }
        self.waited_s = 0.0;
        self.history[self.next] = values.map(|v| v as f32);
        self.next = (self.next + 1) % SLOTS;
        self.filled = (self.filled + 1).min(SLOTS);
        self.suspicious = self.suspicious.saturating_sub(1);
        let (needed, most) = if self.suspicious > 0 {
            (SLOTS_AFTER_LOSS, SHARE_AFTER_LOSS)
        } else {
            (SLOTS, SHARE)
        };
        if self.filled < needed {
            return false;
        }
        let (mut known, mut off) = (0, 0);
        for measure in 0..LEARNT_MEASURES {
            let Some(rest) = rest(measure) else { continue };
            known += 1;
            let median = f64::from(self.median(measure));
            off += usize::from((median - rest).abs() > 0.5 * sd(measure));
        }
        2 * known > LEARNT_MEASURES && off as f64 > most * known as f64
    }

    fn median(&self, measure: usize) -> f32 {
        let mut values = [0.0; SLOTS];
        for (value, row) in values.iter_mut().zip(&self.history[..self.filled]) {
            *value = row[measure];
        }
        let values = &mut values[..self.filled];
        crate::base::sorting::sort(values);
        values[self.filled / 2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 1.0 / 30.0;

    /// Seconds until somebody else is seen, with the first `off` measures one deviation off rest.
    fn seconds_to_notice(newcomer: &mut Newcomer, off: usize) -> Option<f64> {
        let values = core::array::from_fn(|m| if m < off { 1.1 } else { 1.0 });
        (1..900)
            .find(|_| newcomer.observe(&values, 0.95, DT, |_| Some(1.0), |_| 0.1))
            .map(|frame| f64::from(frame) * DT)
    }

    #[test]
    fn a_held_surprise_is_no_newcomer_but_another_face_is() {
        let half = LEARNT_MEASURES / 2;
        assert_eq!(seconds_to_notice(&mut Newcomer::default(), half), None);
        let seconds = seconds_to_notice(&mut Newcomer::default(), half + 1).unwrap();
        assert!((9.0..12.0).contains(&seconds), "{seconds}");
    }

    #[test]
    fn after_a_loss_a_change_is_detected_sooner() {
        let mut newcomer = Newcomer::default();
        newcomer.after_loss();
        let seconds = seconds_to_notice(&mut newcomer, LEARNT_MEASURES / 3 + 1).unwrap();
        assert!((2.0..3.5).contains(&seconds), "{seconds}");
        newcomer.after_loss();
        assert_eq!(seconds_to_notice(&mut newcomer, LEARNT_MEASURES / 3), None);
    }

    #[test]
    fn unknown_rests_and_poor_samples_are_ignored() {
        let mut newcomer = Newcomer::default();
        let values = [2.0; LEARNT_MEASURES];
        for _ in 0..900 {
            assert!(!newcomer.observe(&values, 0.95, DT, |m| (m < 3).then_some(1.0), |_| 0.1));
            assert!(!Newcomer::default().observe(&values, 0.5, DT, |_| Some(1.0), |_| 0.1));
        }
    }

    #[test]
    fn more_than_half_of_the_rests_must_be_known() {
        let values = [2.0; LEARNT_MEASURES];
        for (known, noticed) in [
            (LEARNT_MEASURES / 2, false),
            (LEARNT_MEASURES / 2 + 1, true),
        ] {
            let mut newcomer = Newcomer::default();
            let rest = |m: usize| (m < known).then_some(1.0);
            let found = (0..900).any(|_| newcomer.observe(&values, 0.95, DT, rest, |_| 0.1));
            assert_eq!(found, noticed, "{known}");
        }
    }
}
