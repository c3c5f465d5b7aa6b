//! Errors of the workstation's commands: one sentence for the user.
//!
//! No caller distinguishes kinds of errors, so they are put into words where they occur.

use std::error::Error;
use std::fmt::{self, Display};
use std::path::Path;

use mien_stages::base::bounded_read::reason;

/// Exit code for wrong command-line arguments.
pub const USAGE: u8 = 64;

/// Why a command failed.
#[derive(Debug)]
pub struct Fault {
    /// The sentence.
    text: String,
    /// Exit code of the program.
    pub code: u8,
}

impl Fault {
    /// An error with this sentence.
    pub fn new(text: impl Into<String>) -> Self {
        Self::with_code(text, 1)
    }

    /// An error with its own exit code.
    pub fn with_code(text: impl Into<String>, code: u8) -> Self {
        let text = text.into();
        Self { text, code }
    }

    /// Wraps a system error about a file; `advice` follows it.
    pub fn cannot<E: Display>(what: &str, path: &Path, advice: &str) -> impl Fn(E) -> Self {
        let about =
            |set| format!("; docs/data.md says what the data set {set} is and how to get it");
        let set = data_set_name(path).filter(|_| !path.exists());
        let published = set.map(about).unwrap_or_default();
        let path = path.display().to_string();
        move |error| {
            let why = reason(error);
            Self::new(format!("cannot {what} {path}: {why}{advice}{published}"))
        }
    }

    /// Wraps an error about the contents of a file.
    pub fn within<E: Display>(path: &(impl AsRef<Path> + ?Sized)) -> impl Fn(E) -> Self {
        move |error| Self::new(format!("{}: {error}", path.as_ref().display()))
    }

    /// An error in a line of a file, counted from 1; the beginning of `found` is shown.
    pub fn at_line(path: &Path, line: usize, expected: &str, found: &str) -> Self {
        let found: String = found.chars().take(60).collect();
        let text = format!("line {line}: expected {expected}, found {found:?}");
        Self::within(path)(text)
    }
}

/// The published data set (`docs/data.md`) that a path belongs to, by the name of a folder in it.
fn data_set_name(path: &Path) -> Option<&'static str> {
    const SETS: &str = "faces_frl189 faces_ytfaces68 ict_facekit kinect_v1_desk kinect_v1_film \
        kinect_v1_pcl kinect_v2_faces nrsfm_bench video_talkingface";
    let mut sets = SETS.split(' ');
    sets.find(|set| path.iter().any(|folder| folder == *set))
}

impl Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl<E: Error> From<E> for Fault {
    fn from(error: E) -> Self {
        Self::new(error.to_string())
    }
}
