//! Weights as outputs show them: clamped, and held or faded after a loss. Chooses the face of single-person outputs.

use super::report::{Report, unit_range};
use super::view::{Channel, LossPolicy, View};
use mien_stages::base::prelude::*;
use mien_stages::base::time::Timestamp;
use mien_stages::users::TrackingState;

/// The weights of one user as an output shows them.
#[derive(Default)]
pub(super) struct WireWeights {
    channels: Box<[Channel]>,
    weights: Box<[f32]>,
    seen: Option<Timestamp>,
    /// Current fade factor, 0…1.
    share: f32,
    policy: LossPolicy,
    /// Weights that were NaN and were shown as 0.
    pub(super) not_numbers: u64,
}

impl WireWeights {
    pub(super) fn new(channels: Box<[Channel]>, policy: LossPolicy) -> Self {
        Self {
            weights: vec![0.0; channels.len()].into_boxed_slice(),
            channels,
            policy,
            ..Self::default()
        }
    }

    /// Takes the weights of a report; without weights, continues the hold or fade.
    pub(super) fn observe(&mut self, report: &Report) {
        if report.state.has_face() && !report.weights.is_empty() {
            for (shown, channel) in self.weights.iter_mut().zip(&self.channels) {
                let weight = report.weights.get(channel.source).copied().unwrap_or(0.0);
                self.not_numbers += u64::from(!weight.is_finite());
                *shown = unit_range(weight * channel.gain);
            }
            self.seen = Some(report.at);
        }
        let LossPolicy { hold_s, decay_s } = self.policy;
        self.share = self.seen.map_or(0.0, |seen| {
            let since = report.at.seconds_since(seen) as f32 - hold_s;
            if since <= 0.0 {
                1.0
            } else {
                unit_range(1.0 - since / decay_s)
            }
        });
    }

    pub(super) fn reset(&mut self) {
        (self.seen, self.share) = (None, 0.0);
    }

    /// Whether the fade is complete.
    pub(super) fn is_neutral(&self) -> bool {
        self.share <= 0.0
    }

    /// Current weights, 0…1, fade applied.
    pub(super) fn shown(&self) -> impl ExactSizeIterator<Item = f32> + Clone {
        self.weights.iter().map(|weight| weight * self.share)
    }
}

/// The face of a single-person output: the first eligible user until lost, then the next. A user is eligible unless the report
/// sets `other_is_shown`.
#[derive(Default)]
pub(super) struct OneFace {
    pub(super) weights: WireWeights,
    pub(super) view: View,
    user: Option<usize>,
    present: bool,
    /// Whether single-person outputs show another user.
    other_is_shown: bool,
}

impl OneFace {
    pub(super) fn new(units: &[&str], view: &View) -> Self {
        Self::with_channels(view.channels(units), view)
    }

    pub(super) fn with_channels(channels: Box<[Channel]>, view: &View) -> Self {
        Self {
            weights: WireWeights::new(channels, view.loss),
            view: view.clone(),
            ..Self::default()
        }
    }

    /// Updates the weights and returns the state to show; `None` if the report is of a user that this output does not show.
    pub(super) fn follow(&mut self, report: &Report) -> Option<TrackingState> {
        if report.user.is_some() && report.user != self.user {
            let shown_next = !report.other_is_shown && report.state.is_present();
            if !shown_next || (self.present && !self.other_is_shown) {
                return None;
            }
            // A new face: the previous one must not fade into it.
            self.user = report.user;
            self.weights.reset();
        }
        self.other_is_shown = report.other_is_shown;
        self.present = report.state.is_present() && report.user.is_some();
        self.weights.observe(report);
        let state = report.user.map(|_| report.state);
        Some(state.unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::UnitView;

    fn report(ms: u64, state: TrackingState, weights: &[f32]) -> Report<'_> {
        Report {
            at: Timestamp::from_us(1000 * ms),
            state,
            weights,
            ..Report::default()
        }
    }

    fn wire(units: &[&str], view: &View) -> WireWeights {
        WireWeights::new(view.channels(units), LossPolicy::default())
    }

    #[test]
    fn weights_are_clamped_and_numbers() {
        let mut wire = wire(&["a", "b", "c", "d", "e"], &View::default());
        let weights = [f32::NAN, -0.5, 1.7, f32::INFINITY, 0.25];
        wire.observe(&report(0, TrackingState::Tracking, &weights));
        assert!(wire.shown().eq([0.0, 0.0, 1.0, 0.0, 0.25]));
        assert_eq!(wire.not_numbers, 2);
    }

    #[test]
    fn gains_apply_before_the_limit() {
        let view = View {
            units: vec![UnitView {
                unit: "AU26".into(),
                name: "jaw".into(),
                gain: 2.0,
            }],
            ..View::default()
        };
        let mut wire = wire(&["AU25", "AU26"], &view);
        wire.observe(&report(0, TrackingState::Tracking, &[0.4, 0.4]));
        assert!(wire.shown().eq([0.4, 0.8]));
        wire.observe(&report(0, TrackingState::Tracking, &[0.4, 0.7]));
        assert!(wire.shown().eq([0.4, 1.0]));
    }

    #[test]
    fn a_lost_face_is_held_then_fades_to_neutral() {
        let mut wire = wire(&["AU26"], &View::default());
        wire.observe(&report(1000, TrackingState::Tracking, &[0.8]));
        for (ms, expected) in [
            (1033, 0.8),
            (1200, 0.8),
            (1400, 0.4),
            (1500, 0.2),
            (1600, 0.0),
            (9000, 0.0),
        ] {
            wire.observe(&report(ms, TrackingState::Lost, &[]));
            let shown = wire.shown().next().unwrap();
            assert!(
                (shown - expected).abs() < 1e-4,
                "{shown} after {} ms",
                ms - 1000
            );
        }
        assert!(wire.is_neutral());
        wire.observe(&report(9033, TrackingState::Tracking, &[0.5]));
        assert!(wire.shown().eq([0.5]));
    }
}
