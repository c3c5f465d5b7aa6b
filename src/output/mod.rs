//! Weights on a wire: CSV, OSC, serial. Each takes a [`Report`] per frame and user and knows nothing of the others.
//!
//! On wires (not in CSV) weights are 0…1 and never NaN, and a face that is lost does not freeze: its last weights are held
//! for a moment, then fade to neutral ([`LossPolicy`]). Closing an output (dropping it) sends neutral and absent. Nothing
//! allocates per report, and no output can hold up the pipeline: what a wire cannot take at once is dropped and counted.

pub mod csv;
pub mod osc;
pub mod serial;

use crate::geometry::Rigid;
use crate::landmarks::Landmarks;
use crate::time::Timestamp;
pub use crate::users::TrackingState;

/// Version of the order and meaning of units on the wires; rises when an index changes its meaning.
pub const SCHEMA_VERSION: i32 = 1;

/// All that is known of one user at one frame. Lent to the outputs.
#[derive(Clone, Copy, Debug, Default)]
pub struct Report<'a> {
    /// Number of the frame ([`crate::sensor::Frame::index`]).
    pub frame: u64,
    /// Capture time of the frame.
    pub at: Timestamp,
    /// Slot of the user, below [`crate::capacity::USERS`]; `None` if nobody is there.
    pub user: Option<usize>,
    /// What is known of the user.
    pub state: TrackingState,
    /// 0…1, the whole face.
    pub confidence: f32,
    /// Whether the user's ranges are kept from learning.
    pub frozen: bool,
    /// Pose of the head; `None` when lost or absent.
    pub sensor_from_head: Option<&'a Rigid>,
    /// The 68 points; `None` when lost or absent.
    pub landmarks: Option<&'a Landmarks>,
    /// In the order of the measures' names; empty when lost or absent.
    pub measures: &'a [f32],
    /// In the order of the units' names; empty when lost or absent.
    pub weights: &'a [f32],
}

/// Somewhere reports go.
pub trait Output {
    /// Sends one report.
    ///
    /// # Errors
    /// Only if the output can never work again, as a file on a full disk. A receiver or a port that is not there is a
    /// state of the output, not an error.
    fn send(&mut self, report: &Report) -> Result<(), OutputError>;
}

/// Why an output cannot be made or used.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The CSV cannot be written.
    #[error("cannot write the CSV: {source}; check the path and the space left")]
    Csv {
        /// What the system said.
        source: std::io::Error,
    },
    /// No UDP socket.
    #[error("cannot open a UDP socket to send OSC: {source}; is the network configured?")]
    Socket {
        /// What the system said.
        source: std::io::Error,
    },
    /// No `host:port`.
    #[error("OSC target is {target:?}, expected host:port like 127.0.0.1:9130")]
    Target {
        /// What was given.
        target: String,
    },
    /// An OSC address must start with a slash and hold none of the characters that patterns use.
    #[error(
        "OSC prefix is {prefix:?}, expected printable ASCII like /face, at most 64 characters, without space # * , ? [ ] {{ }}"
    )]
    Prefix {
        /// What was given.
        prefix: String,
    },
    /// The names of the units do not fit one datagram or line.
    #[error(
        "names of {units} units take {bytes} bytes, expected at most {most}; shorten or drop some in the table of units"
    )]
    Names {
        /// How many.
        units: usize,
        /// Bytes they take.
        bytes: usize,
        /// Bytes there are.
        most: usize,
    },
    /// A thread cannot be started.
    #[error(
        "cannot start a thread for an output: {source}; is memory or the number of tasks limited?"
    )]
    Thread {
        /// What the system said.
        source: std::io::Error,
    },
}

/// What a wire shows of a face that is lost: the last weights for a while, then their fading to neutral.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LossPolicy {
    /// How long the last weights are kept, seconds.
    pub hold_s: f32,
    /// How long they then take to fade, seconds.
    pub decay_s: f32,
}

impl Default for LossPolicy {
    fn default() -> Self {
        Self {
            hold_s: 0.2,
            decay_s: 0.4,
        }
    }
}

/// The weights of one user as a wire shows them.
struct WireWeights {
    weights: Box<[f32]>,
    seen: Option<Timestamp>,
    /// Share of the weights that is shown now.
    share: f32,
    policy: LossPolicy,
}

impl WireWeights {
    fn new(units: usize, policy: LossPolicy) -> Self {
        Self {
            weights: vec![0.0; units].into_boxed_slice(),
            seen: None,
            share: 0.0,
            policy,
        }
    }

    /// Takes what a report says: weights, or their absence.
    fn observe(&mut self, report: &Report) {
        if report.state.is_present() && !report.weights.is_empty() {
            for (i, weight) in self.weights.iter_mut().enumerate() {
                *weight = unit_range(report.weights.get(i).copied().unwrap_or(0.0));
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

    fn reset(&mut self) {
        (self.seen, self.share) = (None, 0.0);
    }

    /// Whether all is at rest.
    fn is_neutral(&self) -> bool {
        self.share <= 0.0
    }

    /// 0…1, as shown now.
    fn shown(&self) -> impl ExactSizeIterator<Item = f32> + Clone {
        self.weights.iter().map(|weight| weight * self.share)
    }
}

/// Chooses the face of a wire that carries one: the first user seen is followed until lost, then whoever comes next.
struct OneFace {
    weights: WireWeights,
    user: Option<usize>,
    present: bool,
}

impl OneFace {
    fn new(units: usize, policy: LossPolicy) -> Self {
        Self {
            weights: WireWeights::new(units, policy),
            user: None,
            present: false,
        }
    }

    /// The state to show, with the weights as they are then; `None` if the report is of a face that is not on this wire.
    fn follow(&mut self, report: &Report) -> Option<TrackingState> {
        if report.user.is_some() && report.user != self.user {
            if self.present || !report.state.is_present() {
                return None;
            }
            // The next face: nothing of the one before may fade into it.
            self.user = report.user;
            self.weights.reset();
        }
        self.present = report.state.is_present() && report.user.is_some();
        self.weights.observe(report);
        Some(if report.user.is_some() {
            report.state
        } else {
            TrackingState::Absent
        })
    }
}

/// Into 0…1; what is not a number becomes 0.
fn unit_range(value: f32) -> f32 {
    if value.is_nan() {
        0.0
    } else {
        value.clamp(0.0, 1.0)
    }
}

/// Decides when something that is repeated is due again, by capture time.
#[derive(Default)]
struct Every {
    last: Option<Timestamp>,
}

impl Every {
    /// Whether `period_s` have gone by since the last time it was due, or time has gone back (another source).
    fn due(&mut self, now: Timestamp, period_s: f64) -> bool {
        let due = self
            .last
            .is_none_or(|last| now < last || now.seconds_since(last) >= period_s);
        if due {
            self.last = Some(now);
        }
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(ms: u64, state: TrackingState, weights: &[f32]) -> Report<'_> {
        Report {
            at: Timestamp::from_us(1000 * ms),
            state,
            weights,
            ..Report::default()
        }
    }

    #[test]
    fn weights_are_clamped_and_numbers() {
        let mut wire = WireWeights::new(5, LossPolicy::default());
        let weights = [f32::NAN, -0.5, 1.7, f32::INFINITY, 0.25];
        wire.observe(&report(0, TrackingState::Tracking, &weights));
        assert!(wire.shown().eq([0.0, 0.0, 1.0, 1.0, 0.25]));
    }

    #[test]
    fn a_lost_face_is_held_then_fades_to_neutral() {
        let mut wire = WireWeights::new(1, LossPolicy::default());
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

    #[test]
    fn what_is_repeated_is_due_at_once_and_then_in_its_period() {
        let mut every = Every::default();
        let due: Vec<u64> = (0..100)
            .filter(|i| every.due(Timestamp::from_us(i * 33_333), 1.0))
            .collect();
        assert_eq!(due, [0, 31, 62, 93]);
        assert!(
            every.due(Timestamp::from_us(5), 1.0),
            "another source starts from 0"
        );
    }
}
