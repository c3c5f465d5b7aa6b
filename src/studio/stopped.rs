//! What Ctrl-C leaves of long work: one sentence on standard error, then the end that the signal always brings.

use std::fs::metadata;
use std::io::{IsTerminal, Write};
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::SystemTime;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;
use signal_hook::iterator::Signals;
use signal_hook::low_level::emulate_default_handler;

/// Where a command's result goes.
pub enum Goes {
    /// To standard output, when all is done.
    Printed,
    /// Into this file, whole or not at all.
    File(PathBuf),
}

/// A file's number and its last change: another after it was replaced.
type Version = Option<(u64, SystemTime)>;

impl Goes {
    fn version(&self) -> Version {
        let Self::File(path) = self else { return None };
        let file = metadata(path).ok()?;
        Some((file.ino(), file.modified().ok()?))
    }

    /// What is kept of it now, if it was of this version when the work began.
    fn kept(&self, before: Version) -> String {
        let Self::File(path) = self else {
            return "nothing was written".into();
        };
        let path = path.display();
        match before {
            _ if self.version() != before => {
                format!("{path} was written, but the remaining steps were not run")
            }
            Some(_) => format!("{path} was not changed"),
            None => format!("{path} was not written"),
        }
    }
}

/// From now on Ctrl-C and SIGTERM say what is kept of the result before they end the program.
pub fn tell(result: Goes) {
    // Without it a signal ends the program as well, only in silence.
    let _ = listen(result);
}

fn listen(result: Goes) -> std::io::Result<()> {
    let before = result.version();
    let mut signals = Signals::new([SIGINT, SIGTERM])?;
    let wait = move || {
        let Some(signal) = signals.forever().next() else {
            return;
        };
        let mut stderr = std::io::stderr();
        // A bar may stand in the line.
        let begin = if stderr.is_terminal() { "\n" } else { "" };
        let line = format!("{begin}mien-studio: stopped; {}\n", result.kept(before));
        let _ = stderr.write_all(line.as_bytes());
        let _ = emulate_default_handler(signal);
    };
    std::thread::Builder::new()
        .name("stopped".into())
        .spawn(wait)?;
    Ok(())
}

/// What the first Ctrl-C sets; the second ends the program at once.
pub fn flag_on_signals() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        // Without them a signal ends the program at once, as it does elsewhere.
        let _ = flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop));
        let _ = flag::register(signal, Arc::clone(&stop));
    }
    stop
}

#[cfg(test)]
mod tests {
    use super::Goes;
    use crate::studio::atomic_write;

    #[test]
    fn what_is_kept_is_what_changed_since_the_work_began() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("face.model");
        let result = Goes::File(path.clone());
        let none = result.version();
        assert!(result.kept(none).ends_with("face.model was not written"));
        atomic_write::write(&path, "first").unwrap();
        assert!(result.kept(none).contains("face.model was written, but"));
        let first = result.version();
        assert!(result.kept(first).ends_with("face.model was not changed"));
        atomic_write::write(&path, "other").unwrap();
        assert!(result.kept(first).contains("face.model was written, but"));
    }
}
