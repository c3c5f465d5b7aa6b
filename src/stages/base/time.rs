//! Time since the start of a stream. Only the programs and the sources of frames read a clock; stages receive the time, so that
//! a recording or simulation can run faster than real time.

/// Capture time in microseconds.
///
/// ```
/// use mien_stages::base::time::Timestamp;
/// let (a, b) = (Timestamp::from_us(1_000_000), Timestamp::from_us(1_033_333));
/// assert!((b.seconds_since(a) - 0.033333).abs() < 1e-9);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Timestamp(u64);

impl Timestamp {
    /// From whole microseconds.
    pub const fn from_us(us: u64) -> Self {
        Self(us)
    }

    /// Whole microseconds.
    pub const fn as_us(self) -> u64 {
        self.0
    }

    /// Seconds from `earlier` to `self`, negative if `earlier` is later.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        (self.0 as f64 - earlier.0 as f64) * 1e-6
    }
}
