//! Output of commands to streams that may be full or closed: work continues, and the program reports it once, at its
//! end.

use std::fmt::Arguments;
use std::io::{self, Write};
use std::sync::OnceLock;

static FAILED: OnceLock<io::Error> = OnceLock::new();

/// Prints to standard output.
pub fn print(words: Arguments<'_>) {
    let mut out = io::stdout().lock();
    if let Err(error) = out.write_fmt(words).and_then(|()| out.flush()) {
        // The first error is reported.
        let _ = FAILED.set(error);
    }
}

/// Prints a line to standard error, ignoring errors.
pub fn print_error(words: Arguments<'_>) {
    let _ = writeln!(io::stderr(), "{words}");
}

/// The first error of standard output.
pub fn failure() -> Option<&'static io::Error> {
    FAILED.get()
}
