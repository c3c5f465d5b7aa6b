//! Prior of a person's range.

use serde::Deserialize;

/// FACS unit with its side, such as `AU12L`.
pub type UnitName = heapless::String<8>;

/// Directions in which a measure is an expression.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// One-way: acts as the measure rises.
    Rising,
    /// One-way: acts as the measure falls.
    Falling,
    /// Two-way: one unit each way.
    TwoWay,
    /// No unit: the method cannot detect it.
    Unseen,
}

impl Kind {
    /// Whether there is a unit above rest.
    pub const fn rises(self) -> bool {
        matches!(self, Self::Rising | Self::TwoWay)
    }

    /// Whether there is a unit below rest.
    pub const fn falls(self) -> bool {
        matches!(self, Self::Falling | Self::TwoWay)
    }

    /// Whether there is a unit above and below rest.
    pub const fn sides(self) -> [bool; 2] {
        [self.rises(), self.falls()]
    }
}

/// Prior of a measure's range, in units of the eye distance w.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct Prior {
    /// Directions.
    pub kind: Kind,
    /// Value at rest.
    pub rest: f64,
    /// Standard deviation of rest over people.
    pub rest_sd: f64,
    /// Rest to the full rising expression; 0 if there is none.
    #[serde(default)]
    pub up: f64,
    /// Rest to the full falling expression; 0 if there is none.
    #[serde(default)]
    pub down: f64,
}

impl Prior {
    /// Distances from rest to the full expression, rising and falling.
    pub const fn sides(&self) -> [f64; 2] {
        [self.up, self.down]
    }
}
