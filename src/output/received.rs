//! What receivers of our formats produce, whichever output it came from: one user at one frame, and who is notified.
//!
//! Each parser is next to the emitter of its format: [`super::osc::Receiver`], [`super::serial::Receiver`] and
//! [`super::csv::read::Columns`]. Only the workstation receives, so none of this is in the appliance.

/// One user at one frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sample {
    /// Slot; `None` if nobody is there.
    pub user: Option<usize>,
    /// Number of the frame.
    pub number: u64,
    /// Capture time.
    pub seconds: f64,
    /// Code of the state: 0 absent, 1 warming, 2 tracking, 3 held, 4 lost, 5 posed.
    pub state: u8,
    /// 0…1.
    pub confidence: f32,
    /// From the frame's arrival to its being sent, if the source says so.
    pub latency_ms: Option<f32>,
    /// Whether learning is frozen.
    pub frozen: bool,
    /// `sensor_from_head`: position in metres and quaternion x y z w.
    pub pose: Option<[f32; 7]>,
    /// The head in depth pixels: first column and row, one past the last.
    pub head_box: Option<[u16; 4]>,
    /// Weights in schema order.
    pub weights: Vec<f32>,
    /// The 68 points, colour pixels; empty if not known.
    pub points: Vec<[f32; 2]>,
}

/// Low, rest, high of the measure behind a unit, and how far they are this person's (0…1, if the source says so).
pub type UnitRange = ([f32; 3], Option<f32>);

/// Callbacks for what a receiver parsed.
pub trait Listener {
    /// The names of the units, in the order of the weights, when they change.
    fn schema(&self, names: &[String]);
    /// A user at a frame.
    fn sample(&self, sample: &Sample);
    /// A user's ranges, in schema order; `None` where nothing was received.
    fn ranges(&self, slot: usize, ranges: &[Option<UnitRange>]);
    /// A gesture is on or off, of a person or of whoever counts; told again and again.
    fn gesture(&self, name: &str, slot: Option<usize>, is_on: bool);
    /// Counts of messages, lines or frames accepted and refused.
    fn count(&self, taken: u64, refused: u64);
}
