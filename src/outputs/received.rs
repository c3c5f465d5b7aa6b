//! What the parsers of the outputs' formats read: one user at one frame, and the facts beside it. `mien-studio preview` shows it.

use crate::gesture::SetUpFacts;
use mien_stages::base::capacity::REGIONS;
use mien_stages::base::prelude::*;
use mien_stages::users::TrackingState;

/// One user at one frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sample {
    /// Slot of the person; `None` if the sample reports nobody.
    pub user: Option<usize>,
    /// Number of the frame.
    pub number: u64,
    /// Capture time, seconds.
    pub seconds: f64,
    /// State of the user.
    pub state: TrackingState,
    /// Confidence, 0…1.
    pub confidence: f32,
    /// From the frame's arrival to its output, milliseconds; `None` if unknown.
    pub latency_ms: Option<f32>,
    /// Whether learning is frozen.
    pub frozen: bool,
    /// `sensor_from_head`: position in metres and quaternion x y z w.
    pub pose: Option<[f32; 7]>,
    /// The head in depth pixels: first column and row, one past the last.
    pub head_box: Option<[u16; 4]>,
    /// How far each region of the face can be seen, 0…1; `None` if unknown.
    pub seen: Option<[f32; REGIONS]>,
    /// Weights in schema order.
    pub weights: Vec<f32>,
    /// The 68 points, colour pixels; empty if unknown.
    pub points: Vec<[f32; 2]>,
}

/// Low, rest and high end of a unit's range, and how personal it is (0…1, if known).
pub type UnitRange = ([f32; 3], Option<f32>);

/// What takes in a stream of one of the outputs as its parser reads it.
pub trait Receive {
    /// Names of the units, in the order of the weights from now on.
    fn schema(&self, names: &[String]);
    /// A user's frame.
    fn sample(&self, sample: &Sample);
    /// A user's ranges, in schema order; `None` for those not received.
    fn ranges(&self, slot: usize, ranges: &[Option<UnitRange>]);
    /// State of a gesture, of a person or independent of one; repeated regularly.
    fn gesture(&self, name: &str, slot: Option<usize>, is_on: bool);
    /// Levels and set-up of a gesture; repeated regularly.
    fn set_up(&self, name: &str, facts: &SetUpFacts);
    /// Counts accepted and refused messages, lines or frames.
    fn count(&self, taken: u64, refused: u64);
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use std::cell::{Cell, RefCell};

    /// Keeps all that is received.
    #[derive(Default)]
    pub(crate) struct Recorder {
        pub(crate) units: RefCell<Vec<String>>,
        pub(crate) samples: RefCell<Vec<Sample>>,
        pub(crate) ranges: RefCell<Vec<(usize, Vec<Option<UnitRange>>)>>,
        pub(crate) gestures: RefCell<Vec<(String, Option<usize>, bool)>>,
        pub(crate) set_ups: RefCell<Vec<(String, SetUpFacts)>>,
        /// Accepted and refused messages.
        pub(crate) counts: Cell<[u64; 2]>,
    }

    impl Recorder {
        pub(crate) fn last(&self) -> Sample {
            self.samples.borrow().last().unwrap().clone()
        }

        pub(crate) fn refused(&self) -> u64 {
            self.counts.get()[1]
        }
    }

    impl Receive for Recorder {
        fn schema(&self, names: &[String]) {
            *self.units.borrow_mut() = names.to_vec();
        }

        fn sample(&self, sample: &Sample) {
            self.samples.borrow_mut().push(sample.clone());
        }

        fn ranges(&self, slot: usize, ranges: &[Option<UnitRange>]) {
            self.ranges.borrow_mut().push((slot, ranges.to_vec()));
        }

        fn gesture(&self, name: &str, slot: Option<usize>, is_on: bool) {
            self.gestures
                .borrow_mut()
                .push((name.to_owned(), slot, is_on));
        }

        fn set_up(&self, name: &str, facts: &SetUpFacts) {
            self.set_ups.borrow_mut().push((name.to_owned(), *facts));
        }

        fn count(&self, taken: u64, refused: u64) {
            let [a, b] = self.counts.get();
            self.counts.set([a + taken, b + refused]);
        }
    }
}
