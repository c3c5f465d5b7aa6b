//! The public data sets: `MIEN_DATA`, or else `../shared/data`. Where something is missing a test says so and passes; under
//! `MIEN_NEEDS_ALL`, which CI sets, it fails.

use std::path::{Path, PathBuf};

/// Says in one line that a test cannot be run here.
///
/// # Panics
/// Under `MIEN_NEEDS_ALL`.
pub(crate) fn skip(reason: &str) {
    let needed = std::env::var_os("MIEN_NEEDS_ALL").is_some();
    assert!(!needed, "MIEN_NEEDS_ALL is set, and there is {reason}");
    println!("skipped: {reason}");
}

/// The folder of all data sets, if it has these.
pub(crate) fn data(sets: &[&str]) -> Option<PathBuf> {
    let path = std::env::var_os("MIEN_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    if let Some(set) = sets.iter().find(|set| !path.join(set).is_dir()) {
        skip(&format!("no {}; set MIEN_DATA", path.join(set).display()));
        return None;
    }
    Some(path)
}
