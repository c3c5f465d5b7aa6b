//! Capacity of a line: frames per second and number of units.
//!
//! A byte takes ten bits on the line, and some capacity is reserved because the clocks at both ends differ. From the
//! remaining bytes per second the repeated names are subtracted; the longest possible frame then determines the frame rate.
//! If that is below the minimum rate, units are omitted, least important first, until the rate is reached or one unit is left.
//! Binary frames are likewise limited to an AVR's receive buffer.

use mien_stages::base::prelude::*;

/// Share of the line's capacity that is used.
const USABLE: f32 = 0.95;
/// Bits on the line per byte: start, eight, stop.
const BITS_PER_BYTE: f32 = 10.0;
/// Frame rate of the sensor.
pub(super) const FRAMES_HZ: f32 = 30.0;
/// Interval at which the unit names are repeated, seconds.
pub(super) const HEADER_PERIOD_S: f32 = 5.0;
/// Size of an AVR's receive buffer, bytes.
pub(super) const AVR_BUFFER: usize = 63;

/// Units by importance on a slow line: speech and mood first. The others follow in the order of the unit table.
const PRIORITY: [&str; 21] = [
    "AU26", "AU25", "AU43L", "AU43R", "AU12L", "AU12R", "AU2L", "AU2R", "AU20", "AU18", "AU4L",
    "AU4R", "AU30L", "AU30R", "AU9L", "AU9R", "AU22", "AU28", "AU29", "AU5L", "AU5R",
];

/// Bytes per second that may be written at `baud`.
pub(super) fn bytes_per_second(baud: u32) -> f32 {
    baud.max(1) as f32 / BITS_PER_BYTE * USABLE
}

/// Units and rate chosen for a line.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plan {
    /// Indices of the units sent, in the order on the wire.
    pub(super) units: Vec<usize>,
    /// Indices of the omitted units, the least important first.
    pub(super) left_out: Vec<usize>,
    /// Frames per second that the line carries, at most the sensor's.
    pub(super) rate_hz: f32,
    /// Length of the longest frame, bytes.
    pub(super) frame_bytes: usize,
}

/// Chooses units for a line of `baud`. `wanted`: indices of the units to choose from; `rank`: their importance, 0 = highest;
/// `bytes`: length of the longest frame and of the header for a choice of units; `longest`: limit on the frame's length, bytes.
pub(super) fn plan(
    baud: u32,
    min_rate_hz: f32,
    longest: usize,
    mut wanted: Vec<usize>,
    rank: impl Fn(usize) -> usize,
    bytes: impl Fn(&[usize]) -> (usize, usize),
) -> Plan {
    let mut left_out = Vec::new();
    loop {
        let (frame, header) = bytes(&wanted);
        let left = bytes_per_second(baud) - header as f32 / HEADER_PERIOD_S;
        let rate_hz = (left / frame as f32).clamp(0.0, FRAMES_HZ);
        let enough = rate_hz >= min_rate_hz && frame <= longest;
        let least = (0..wanted.len()).max_by_key(|&at| (rank(wanted[at]), at));
        let Some(least) = least.filter(|_| !enough && wanted.len() > 1) else {
            return Plan {
                units: wanted,
                left_out,
                rate_hz,
                frame_bytes: frame,
            };
        };
        left_out.push(wanted.remove(least));
    }
}

/// Rank of a unit in the default order of importance, 0 = highest.
pub(super) fn rank(unit: &str) -> usize {
    let position = PRIORITY.iter().position(|name| *name == unit);
    position.unwrap_or(PRIORITY.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of 10 bytes and 5 for each unit, names of 8 bytes each.
    fn bytes(units: &[usize]) -> (usize, usize) {
        (10 + 5 * units.len(), 8 * units.len())
    }

    #[test]
    fn a_fast_line_carries_all_at_the_full_rate() {
        let plan = plan(115_200, 10.0, usize::MAX, (0..19).collect(), |i| i, bytes);
        assert_eq!(plan.units.len(), 19);
        assert_eq!((plan.rate_hz, plan.frame_bytes), (30.0, 105));
    }

    #[test]
    fn a_slow_line_carries_fewer_frames_then_fewer_units() {
        // 912 bytes a second less 30.4 of names: 8.4 frames of 105.
        let slow = |min| plan(9600, min, usize::MAX, (0..19).collect(), |i| i, bytes);
        assert_eq!(slow(5.0).units.len(), 19);
        assert!((slow(5.0).rate_hz - 8.396).abs() < 1e-3);
        let ten = slow(10.0);
        assert_eq!(ten.units, (0..15).collect::<Vec<_>>());
        assert!(ten.rate_hz >= 10.0);
        let never = plan(300, 30.0, usize::MAX, vec![3, 1, 2], |i| i, bytes);
        assert_eq!(never.units, [1], "the most important one is left");
    }

    #[test]
    fn what_is_dropped_is_the_least_important_and_the_order_stays() {
        let names = ["AU5L", "AU26", "AU9L", "AU25"];
        let by_rank = |i: usize| rank(names[i]);
        let plan = plan(115_200, 1.0, 20, (0..4).collect(), by_rank, bytes);
        assert_eq!(plan.units, [1, 3]);
    }
}
