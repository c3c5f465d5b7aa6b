//! Saves the levels of gestures that were changed while running in a text file beside that of the saved people, a line per gesture.
//! Levels of a gesture whose configuration has changed since are not loaded. The file is written when a level changes, at most once
//! a second, and only with a live sensor.

use std::path::Path;
use std::time::{Duration, Instant};

use mien_outputs::gesture::{ENABLED, Gestures};
use mien_stages::base::atomic_write::AtomicFile;
use mien_stages::base::bounded_read::{read_regular, reason};

/// Longest text, bytes: enough for 16 gestures with expressions of 512 bytes.
const TEXT: usize = 16 << 10;

/// Least time between two writes.
const PERIOD: Duration = Duration::from_secs(1);

/// The file of saved levels.
pub(crate) struct LevelsFile {
    file: AtomicFile,
    text: String,
    written: Option<Instant>,
}

impl LevelsFile {
    /// A file beside `people`, the file of saved people; nothing is read or written yet.
    pub(crate) fn new(people: &Path) -> Self {
        Self {
            file: AtomicFile::new(&people.with_extension("gestures"), Some(0o600), true),
            text: String::with_capacity(TEXT),
            written: None,
        }
    }

    /// Sets the gestures to the saved levels. Without a file they stay as configured; other problems are logged.
    pub(crate) fn load(&self, gestures: &mut Gestures) {
        if !ENABLED {
            return;
        }
        let path = self.file.path();
        match read_regular(path, TEXT) {
            Ok(bytes) => {
                let unreadable = gestures.read_levels(&String::from_utf8_lossy(&bytes));
                if unreadable > 0 {
                    tracing::warn!(
                        "{}: expected four numbers and a gesture on each line, found {unreadable} other lines; \
                         these gestures keep the levels of the configuration: set them up again",
                        path.display()
                    );
                }
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            Err(error) => tracing::warn!(
                "{}: cannot read the levels of gestures ({}); those of the configuration are used; set the gestures up again",
                path.display(),
                reason(error)
            ),
        }
    }

    /// Whether the last write was at least a second ago.
    pub(crate) fn is_due(&self) -> bool {
        self.written.is_none_or(|at| at.elapsed() >= PERIOD)
    }

    /// Writes the levels if one was changed; a failure is logged.
    pub(crate) fn save(&mut self, gestures: &mut Gestures) {
        if !ENABLED || !gestures.take_change() {
            return;
        }
        self.written = Some(Instant::now());
        self.text.clear();
        // Writing to a string does not fail.
        let _ = gestures.write_levels(&mut self.text);
        if let Err(error) = self.file.write(self.text.as_bytes()) {
            tracing::warn!(
                "{}: cannot save the levels of gestures ({}), so they last until the restart; set state.path to a file in another folder",
                self.file.path().display(),
                reason(error)
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_outputs::Command;
    use mien_outputs::gesture::Gesture;

    #[test]
    fn levels_survive_a_restart_until_the_configuration_of_their_gesture_changes() {
        let folder = tempfile::tempdir().unwrap();
        let people = folder.path().join("people.ranges");
        let all = ["smile", "brows"].map(Gesture::named);
        let mut gestures = Gestures::new(&all, &["AU26"]);
        let mut file = LevelsFile::new(&people);
        file.load(&mut gestures);
        file.save(&mut gestures);
        assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none());
        gestures.execute(Command::Level(0, 26));
        gestures.execute(Command::Hold(1, 40));
        file.save(&mut gestures);

        let restarted = |all: &[Gesture]| {
            let mut gestures = Gestures::new(all, &["AU26"]);
            LevelsFile::new(&people).load(&mut gestures);
            [0, 1].map(|index| gestures.levels(index))
        };
        let [smile, brows] = restarted(&all);
        assert_eq!((smile.on, smile.off, smile.hold_s), (0.26, 0.16, 0.5));
        assert_eq!((brows.on, brows.off, brows.hold_s), (1.3, 0.9, 0.4));
        let mut changed = all.clone();
        changed[0].on = 0.3;
        let [smile, brows] = restarted(&changed);
        assert_eq!((smile.on, brows.hold_s), (0.3, 0.4));

        gestures.execute(Command::Undo(0));
        file.save(&mut gestures);
        assert_eq!(restarted(&all)[0], all[0].levels());
        std::fs::write(folder.path().join("people.gestures"), "nonsense\n\u{0}").unwrap();
        assert_eq!(restarted(&all)[1], all[1].levels());
    }
}
