//! Saves remembered people to disk and loads them after a restart.
//!
//! One text file; its last line has the CRC-32 of everything before it. Per person: the slot, the time last seen (seconds since
//! 1970), the recognition features ([`Likeness`]) and the learned ranges ([`Learned`]); no image, and nothing from which a face
//! could be reconstructed:
//! ```text
//! mien-people 2
//! person 0 1763720000 0.012 0.00041 - -0.00112 …
//! mien-ranges 2 0.0372
//! lip_gap 0.0213 0.0213 0.7961
//! …
//! checksum 1a2b3c4d
//! ```
//! Written by rename, at most once a minute and at the end, and only with a live sensor, because replaying a recording must not
//! change its next replay. A damaged file is moved aside, logged, and deleted a day after it was written. Memory:
//! fixed after [`People::new`]. Ages are by the wall clock, across restarts. Degenerate: a person last seen in the future,
//! because the clock was set back, counts as seen now; people gone too long are dropped by
//! [`Memory::forget_older`](super::memory::Memory::forget_older).

use std::fmt::Write as _;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use super::likeness::Likeness;
use super::memory::Gone;
use crate::base::atomic_write::AtomicFile;
use crate::base::bounded_read::{self, reason};
use crate::base::capacity::{FEATURES, LEARNT_MEASURES, REMEMBERED, UNITS, USERS};
use crate::base::checksum::crc32;
use crate::base::time::Timestamp;
use crate::expression::saved::Learned;

const HEADER: &str = "mien-people 2";
/// Interval between writes.
const PERIOD: Duration = Duration::from_secs(60);
/// Time for which a damaged file is kept after it was written.
const DAMAGED_KEPT: Duration = Duration::from_secs(86_400);
/// Largest text of one person, bytes: a line of up to 40 for each range, and the likeness.
const PERSON: usize = (LEARNT_MEASURES + FEATURES + UNITS) * 40 + 1024;
/// Longest file written, bytes.
const TEXT: usize = (REMEMBERED + USERS) * PERSON;

/// Longest file accepted, bytes.
const MOST: usize = 4 * TEXT;

fn seconds(at: SystemTime) -> u64 {
    let since = at.duration_since(SystemTime::UNIX_EPOCH);
    since.unwrap_or_default().as_secs()
}

/// Writes people to `text`; `now`: time of the last frame, and wall-clock time.
///
/// # Errors
/// If the writer fails.
pub fn write(
    people: impl Iterator<Item = Gone>,
    now: (Timestamp, SystemTime),
    text: &mut String,
) -> std::fmt::Result {
    text.clear();
    writeln!(text, "{HEADER}")?;
    for one in people {
        let last_seen = seconds(now.1).saturating_sub(one.away_s(now.0) as u64);
        write!(text, "person {} {last_seen}", one.slot)?;
        one.likeness.write(text)?;
        writeln!(text)?;
        one.learned.write(text)?;
    }
    let checksum = crc32(text.as_bytes());
    writeln!(text, "checksum {checksum:08x}")
}

/// Reads the text of [`write()`]; `now`: wall-clock time.
///
/// # Errors
/// A description of the damage.
pub fn read(text: &str, now: SystemTime) -> Result<Vec<Gone>, String> {
    let body = text.strip_prefix(HEADER);
    let body = body.ok_or_else(|| format!("expected a first line {HEADER:?}"))?;
    let end = text.trim_end().rfind('\n').map_or(0, |at| at + 1);
    let checksum = text[end..].trim_end().strip_prefix("checksum ");
    let checksum = checksum.and_then(|hex| u32::from_str_radix(hex, 16).ok());
    if checksum != Some(crc32(&text.as_bytes()[..end])) {
        return Err("the checksum in the last line does not match the text".into());
    }
    let mut people = Vec::new();
    let blocks = body[..end - HEADER.len()].split("\nperson ").skip(1);
    // Longest gone first: beyond the capacity the first are dropped.
    for (number, block) in blocks.enumerate() {
        let number = number + 1;
        let person =
            || format!("person {number}: expected \"person slot seconds\" and the likeness");
        let (line, ranges) = block.split_once('\n').ok_or_else(person)?;
        let mut words = line.split_ascii_whitespace();
        let slot = words.next().and_then(|word| word.parse().ok());
        let last_seen: Option<u64> = words.next().and_then(|word| word.parse().ok());
        let likeness = Likeness::read(words).ok_or_else(person)?;
        let gone = Gone {
            slot: slot.filter(|&slot| slot < USERS).ok_or_else(person)?,
            likeness,
            learned: Learned::read(ranges)
                .map_err(|problem| format!("person {number}: {problem}"))?,
            last_seen: Timestamp::default(),
            before_s: seconds(now).saturating_sub(last_seen.ok_or_else(person)?) as f64,
        };
        if people.len() == REMEMBERED {
            people.remove(0);
        }
        people.push(gone);
    }
    Ok(people)
}

/// The file of remembered people.
pub struct People {
    file: AtomicFile,
    /// Path for a damaged file.
    aside: PathBuf,
    /// Time of the last write.
    written: Instant,
    text: String,
    /// Whether a failure to write was logged.
    warned: bool,
}

impl People {
    /// A file at `path`; nothing is read or written yet.
    pub fn new(path: &Path) -> Self {
        let mut aside = path.as_os_str().to_owned();
        aside.push(".damaged");
        Self {
            file: AtomicFile::new(path, Some(0o600), true),
            aside: aside.into(),
            written: Instant::now(),
            text: String::with_capacity(TEXT),
            warned: false,
        }
    }

    /// Loads the people; nobody if there is no file or it is damaged, in which case it is moved aside.
    pub fn load(&self) -> Vec<Gone> {
        let path = self.file.path().display();
        let bytes = match bounded_read::read_regular(self.file.path(), MOST) {
            Ok(bytes) => bytes,
            // Longer than any file written here: damaged, moved aside below.
            Err(error) if error.kind() == ErrorKind::FileTooLarge => Vec::new(),
            Err(error) if error.kind() == ErrorKind::NotFound => {
                return Vec::new();
            }
            Err(error) => {
                let why = reason(error);
                tracing::warn!("{path}: cannot read saved people ({why}); nobody is remembered");
                return Vec::new();
            }
        };
        let text = String::from_utf8_lossy(&bytes);
        read(&text, SystemTime::now()).unwrap_or_else(|problem| {
            // If it cannot be renamed, the next write replaces it.
            let _ = std::fs::rename(self.file.path(), &self.aside);
            tracing::warn!(
                "{path}: {problem}; the file was moved to {}, and nobody is remembered",
                self.aside.display()
            );
            Vec::new()
        })
    }

    /// Whether a minute has passed since it was written.
    pub fn is_due(&self) -> bool {
        self.written.elapsed() >= PERIOD
    }

    /// Writes the file; a failure is logged once. `at`: time of the last frame.
    pub fn save(&mut self, people: impl Iterator<Item = Gone>, at: Timestamp) {
        self.written = Instant::now();
        let damaged = std::fs::symlink_metadata(&self.aside).and_then(|about| about.modified());
        // A time in the future counts as old.
        let is_recent = |at: SystemTime| at.elapsed().is_ok_and(|age| age < DAMAGED_KEPT);
        if damaged.is_ok_and(|at| !is_recent(at)) {
            let _ = std::fs::remove_file(&self.aside);
        }
        // Writing to a string cannot fail.
        let _ = write(people, (at, SystemTime::now()), &mut self.text);
        let written = self.file.write(self.text.as_bytes());
        if let Err(error) = &written
            && !self.warned
        {
            tracing::info!(
                "{}: cannot save people ({}); set state.path to another file, or state.persist = false",
                self.file.path().display(),
                reason(error)
            );
        }
        self.warned = written.is_err();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn oversized_files_are_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("people.ranges");
        // A pipe without a writer.
        let made = std::process::Command::new("mkfifo").arg(&path).status();
        assert!(made.unwrap().success());
        assert!(People::new(&path).load().is_empty());
        std::fs::remove_file(&path).unwrap();

        let mut text = String::new();
        write(
            std::iter::empty(),
            (Timestamp::default(), SystemTime::now()),
            &mut text,
        )
        .unwrap();
        std::fs::write(&path, text + &"\n".repeat(1 << 20)).unwrap();
        assert!(People::new(&path).load().is_empty());
        let damaged = folder.path().join("people.ranges.damaged");
        let mut people = People::new(&path);
        people.save(std::iter::empty(), Timestamp::default());
        assert!(damaged.exists());
        let yesterday = SystemTime::now() - DAMAGED_KEPT - Duration::from_secs(9);
        let file = std::fs::File::options().write(true).open(&damaged);
        file.unwrap().set_modified(yesterday).unwrap();
        people.save(std::iter::empty(), Timestamp::default());
        assert!(!damaged.exists());
    }

    #[test]
    fn written_people_are_read_and_damage_is_reported() {
        let words = core::iter::once("0.125").chain(core::iter::repeat("-"));
        let all = (0..512).map(|count| Likeness::read(words.clone().take(count)));
        let likeness = all
            .flatten()
            .next()
            .expect("a head that nothing is known of but its size");
        let one = |slot: usize, before_s: f64| Gone {
            slot,
            likeness: likeness.clone(),
            learned: Learned {
                eye_distance_m: 0.03 + 0.001 * slot as f32,
                ranges: Default::default(),
                features: heapless::Vec::new(),
                readings: heapless::Vec::new(),
            },
            last_seen: Timestamp::from_us(4_000_000),
            before_s,
        };
        let people = [one(2, 0.0), one(0, 90.0)];
        let (at, clock) = (
            Timestamp::from_us(14_000_000),
            SystemTime::UNIX_EPOCH + Duration::from_secs(5000),
        );
        let mut text = String::new();
        write(people.iter().cloned(), (at, clock), &mut text).unwrap();
        let found = read(&text, clock + Duration::from_secs(20)).unwrap();
        let said: Vec<_> = found
            .iter()
            .map(|gone| (gone.slot, gone.before_s, gone.learned.eye_distance_m))
            .collect();
        // Gone for ten seconds then, or a hundred, and for twenty since.
        assert_eq!(said, [(2, 30.0, 0.032), (0, 120.0, 0.03)]);
        let sealed = |mut text: String| {
            let end = text.trim_end().rfind('\n').map_or(0, |at| at + 1);
            text.truncate(end);
            let sum = crc32(text.as_bytes());
            text + &format!("checksum {sum:08x}\n")
        };
        for (slot, is_one) in [(USERS - 1, true), (USERS, false)] {
            let moved = text.replacen("person 2 ", &format!("person {slot} "), 1);
            assert_eq!(read(&sealed(moved), clock).is_ok(), is_one, "{slot}");
        }
        for (number, broken) in [(1, "lip_gap x"), (2, "lip_gap x")] {
            let at = text
                .match_indices("lip_gap")
                .nth(number - 1)
                .expect("one each")
                .0;
            let mut damaged = text.clone();
            damaged.replace_range(at..at + broken.len(), broken);
            match read(&sealed(damaged), clock) {
                Err(told) => assert!(told.starts_with(&format!("person {number}: ")), "{told}"),
                other => panic!("{:?}", other.map(|people| people.len())),
            }
        }
    }
}
