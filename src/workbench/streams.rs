//! What commands print, to streams that may be full or closed: work goes on, and the program says so once, at its end.

use std::fmt::Arguments;
use std::io::{self, Write};
use std::sync::OnceLock;

static FAILED: OnceLock<io::Error> = OnceLock::new();

/// Prints to standard output.
pub fn print(words: Arguments<'_>) {
    let mut out = io::stdout().lock();
    if let Err(error) = out.write_fmt(words).and_then(|()| out.flush()) {
        // The first one is told.
        let _ = FAILED.set(error);
    }
}

/// Prints a line to standard error; where that takes none, nobody is told.
pub fn print_error(words: Arguments<'_>) {
    let _ = writeln!(io::stderr(), "{words}");
}

/// Why standard output did not take everything.
pub fn failure() -> Option<&'static io::Error> {
    FAILED.get()
}
