//! Text of levels that were changed while running: a line for each gesture, with its four numbers, the configured ones, the name and the
//! expression. Levels are restored only if these are the same as before.

use super::teaching::Levels;
use super::{Gestures, Watched};
use core::fmt::Write as _;
use mien_stages::base::prelude::*;

impl Watched {
    /// Writes the configured levels, the name and the expression: saved levels are valid only while these are the same.
    fn write_identity(&self, text: &mut String) -> core::fmt::Result {
        write!(
            text,
            "configured {} {} =",
            self.configured, self.gesture.name
        )?;
        // An expression may have several lines.
        let mut words = self.gesture.of.split_whitespace();
        words.try_for_each(|word| write!(text, " {word}"))
    }
}

impl Gestures {
    /// Writes the levels that differ from the configured ones, a line each.
    ///
    /// # Errors
    /// If the writer fails.
    pub fn write_levels(&self, text: &mut String) -> core::fmt::Result {
        for watched in &self.all {
            let now = watched.gesture.levels();
            if now != watched.configured {
                write!(text, "{now} ")?;
                watched.write_identity(text)?;
                writeln!(text)?;
            }
        }
        Ok(())
    }

    /// Restores the levels that [`Self::write_levels`] wrote, except those of gestures whose configuration has changed since.
    /// Returns the number of unreadable lines.
    pub fn read_levels(&mut self, text: &str) -> usize {
        let mut own = String::new();
        let mut unreadable = 0;
        for line in text.lines() {
            let mut words = line.splitn(5, ' ');
            let mut number = || words.next()?.parse().ok().filter(|n: &f32| n.is_finite());
            let numbers = [(); 4].map(|()| number());
            let ([Some(on), Some(off), Some(hold_s), Some(rise_s)], Some(identity)) =
                (numbers, words.next())
            else {
                unreadable += 1;
                continue;
            };
            for watched in &mut self.all {
                own.clear();
                // Writing to a string does not fail.
                let _ = watched.write_identity(&mut own);
                if own == identity && (0.0..on).contains(&off) && hold_s.min(rise_s) >= 0.0 {
                    watched.set(Levels {
                        on,
                        off,
                        hold_s,
                        rise_s,
                    });
                }
            }
        }
        unreadable
    }
}
