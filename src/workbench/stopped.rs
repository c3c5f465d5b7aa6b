//! Reaction to Ctrl-C: one sentence on standard error, then the usual end by the signal.

use std::fs::metadata;
use std::io::{IsTerminal, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::SystemTime;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;
use signal_hook::iterator::Signals;
use signal_hook::low_level::emulate_default_handler;

/// Inode and modification time of a file.
type Version = Option<(u64, SystemTime)>;

fn version(path: &Path) -> Version {
    let file = metadata(path).ok()?;
    Some((file.ino(), file.modified().ok()?))
}

/// A sentence on a file that had this version when the work began.
fn kept(path: &Path, before: Version) -> String {
    let what = match before {
        _ if version(path) != before => "was written, but the remaining steps were not run",
        Some(_) => "was not changed",
        None => "was not written",
    };
    format!("{} {what}", path.display())
}

/// From now on Ctrl-C and SIGTERM print the state of the result and end the program. `result` is the file, which is
/// written atomically; `None` means standard output.
pub fn report_what_is_kept(result: Option<PathBuf>) {
    // Without the handler a signal ends the program silently.
    let _ = listen(result);
}

fn listen(result: Option<PathBuf>) -> std::io::Result<()> {
    let result = result.map(|path| (version(&path), path));
    let mut signals = Signals::new([SIGINT, SIGTERM])?;
    let wait = move || {
        let Some(signal) = signals.forever().next() else {
            return;
        };
        let mut stderr = std::io::stderr();
        // A progress bar may be in the line.
        let begin = if stderr.is_terminal() { "\n" } else { "" };
        let kept = result.map(|(before, path)| kept(&path, before));
        let kept = kept.unwrap_or_else(|| "nothing was written".into());
        let line = format!("{begin}mien-studio: stopped; {kept}\n");
        let _ = stderr.write_all(line.as_bytes());
        let _ = emulate_default_handler(signal);
    };
    let thread = std::thread::Builder::new().name("stopped".into());
    thread.spawn(wait).map(drop)
}

/// A flag that the first Ctrl-C or SIGTERM sets; the second ends the program at once.
pub fn flag_on_signals() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        // Without the handlers a signal ends the program at once.
        let _ = flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop));
        let _ = flag::register(signal, Arc::clone(&stop));
    }
    stop
}

#[cfg(test)]
mod tests {
    use super::{kept, version};
    use crate::atomic_write;

    #[test]
    fn a_result_is_reported_as_written_if_it_changed_since_the_start() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("face.model");
        let none = version(&path);
        assert!(kept(&path, none).ends_with("face.model was not written"));
        atomic_write::write(&path, "first").unwrap();
        assert!(kept(&path, none).contains("face.model was written, but"));
        let first = version(&path);
        assert!(kept(&path, first).ends_with("face.model was not changed"));
        atomic_write::write(&path, "other").unwrap();
        assert!(kept(&path, first).contains("face.model was written, but"));
    }
}
