//! Speech and laughter, detected from the mouth's opening: at least [`REVERSALS`] reversals within [`SPEECH_S`], each of at least
//! [`REVERSAL`] and at least a [`SHARE`] of the opening, the last one less than [`QUIET_S`] ago. Weights, seconds of capture time.

use mien_stages::base::time::Timestamp;

/// Reversals of the mouth's opening that count as speech.
const REVERSALS: usize = 3;
/// Smallest reversal, weight.
const REVERSAL: f32 = 0.15;
/// Smallest reversal as a share of the opening.
const SHARE: f32 = 0.2;
/// Time within which the reversals must occur, seconds.
const SPEECH_S: f64 = 1.2;
/// Speech ends this long after the last reversal, seconds.
const QUIET_S: f64 = 0.4;

/// Speech detector of one person.
#[derive(Clone, Copy, Default)]
pub(super) struct Speech {
    /// Extreme of the mouth's opening since the last reversal; `None` before the first frame.
    extreme: Option<f32>,
    /// Whether the mouth opens since then.
    is_opening: bool,
    /// Times of the last reversals, newest first.
    turns: [Option<Timestamp>; REVERSALS],
}

impl Speech {
    /// Takes the mouth's opening; returns whether the person speaks.
    pub(super) fn update(&mut self, opening: f32, at: Timestamp) -> bool {
        let extreme = self.extreme.unwrap_or(opening);
        let direction = if self.is_opening { 1.0 } else { -1.0 };
        let back = direction * (extreme - opening);
        // Noise grows with the opening.
        let least = REVERSAL.max(SHARE * opening.max(extreme));
        if back > least {
            self.is_opening = !self.is_opening;
            self.turns.rotate_right(1);
            self.turns[0] = Some(at);
        }
        let is_between = (0.0..=least).contains(&back);
        self.extreme = Some(if is_between { extreme } else { opening });
        let within =
            |turn: usize, s| self.turns[turn].is_some_and(|turn| at.seconds_since(turn) < s);
        within(REVERSALS - 1, SPEECH_S) && within(0, QUIET_S)
    }
}
