//! The live line: what a person sees who runs `mien` on a terminal without asking for a CSV.

use core::fmt::Write as _;

use crate::users::TrackingState;

/// Puts the line over the one before.
const OVER: &str = "\r\x1b[K";
/// Longest line in characters: one row of an ordinary terminal, and what puts it there.
const LINE: usize = 100 + OVER.len();
/// Weights below this are not worth a place on the line.
const SHOWN: f32 = 0.15;

/// One readable line: time, state, confidence, turn of the head in degrees, the strongest units.
pub(crate) fn line(
    seconds: f64,
    state: TrackingState,
    confidence: f32,
    yaw_pitch_roll: Option<(f32, f32, f32)>,
    units: &mut dyn Iterator<Item = (&str, f32)>,
) -> heapless::String<LINE> {
    let mut line = heapless::String::new();
    // A full line is cut: that is its policy.
    let _ = write!(
        line,
        "{OVER}{:3}:{:04.1} {:8} {:3.0}%",
        (seconds / 60.0) as u64,
        seconds % 60.0,
        state.name(),
        confidence * 100.0
    );
    if let Some((yaw, pitch, roll)) = yaw_pitch_roll {
        let _ = write!(
            line,
            " turn {:+3.0} {:+3.0} {:+3.0} |",
            yaw.to_degrees(),
            pitch.to_degrees(),
            roll.to_degrees()
        );
    }
    for (name, weight) in units {
        if weight >= SHOWN {
            let mut entry: heapless::String<24> = heapless::String::new();
            let _ = write!(entry, " {name} {weight:.2}");
            if line.push_str(&entry).is_err() {
                break;
            }
        }
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_shows_what_is_active_and_never_overflows() {
        let units = [("AU26", 0.8), ("AU12L", 0.1), ("AU2L", 0.5)];
        let text = line(
            63.25,
            TrackingState::Tracking,
            0.93,
            Some((0.1, 0.0, -0.1)),
            &mut units.into_iter(),
        );
        assert_eq!(
            text.as_str(),
            "\r\x1b[K  1:03.2 tracking  93% turn  +6  +0  -6 | AU26 0.80 AU2L 0.50"
        );
        let many = [("AU43L", 1.0); 40];
        assert!(line(0.0, TrackingState::Absent, 0.0, None, &mut many.into_iter()).len() <= LINE);
    }
}
