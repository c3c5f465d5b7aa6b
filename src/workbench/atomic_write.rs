//! Atomic file writes, and names that do not overwrite existing files.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crate::fault::Fault;
use mien_stages::base::atomic_write::AtomicFile;
use mien_stages::base::bounded_read;

/// Writes a file atomically ([`mien_stages::base::atomic_write`]), following links; a stream, such as `/dev/stdout`,
/// is written directly.
///
/// # Errors
/// The error of the system.
pub fn write(path: &Path, bytes: impl AsRef<[u8]>) -> io::Result<()> {
    let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    if path.exists() && !path.is_file() {
        let mut stream = std::fs::File::options().write(true).open(path)?;
        return stream.write_all(bytes.as_ref());
    }
    let file = AtomicFile::new(&path, None, true);
    file.write(bytes.as_ref()).map(drop)
}

/// `NAME-2.EXT` for `NAME.EXT` and 2; the name itself for 1.
fn numbered(path: &Path, number: usize) -> PathBuf {
    let (stem, ending) = (path.file_stem(), path.extension());
    let mut name = stem.unwrap_or_default().to_owned();
    if number > 1 {
        name.push(format!("-{number}"));
    }
    if let Some(ending) = ending {
        name.push(".");
        name.push(ending);
    }
    path.with_file_name(name)
}

/// Whether no file exists there, or one with exactly these bytes.
pub fn is_free(path: &Path, bytes: &[u8]) -> bool {
    let holds_them = || bounded_read::read_regular(path, bytes.len()).is_ok_and(|old| old == bytes);
    let about = std::fs::symlink_metadata(path);
    about.map_or(true, |about| about.is_file() && holds_them())
}

/// The first of `path`, `NAME-2.EXT`, `NAME-3.EXT`, … that does not exist.
pub fn unused(path: &Path) -> PathBuf {
    spare(path, |path| std::fs::symlink_metadata(path).is_err())
}

fn spare(path: &Path, fits: impl Fn(&Path) -> bool) -> PathBuf {
    let mut names = (1..).map(|number| numbered(path, number));
    names.find(|path| fits(path)).unwrap_or_default()
}

/// Writes a file beside a result, which the caller did not name as `--out`. An existing file of other contents is
/// kept, and the bytes go to a numbered name instead, unless `force`. Returns the path for the caller to print.
///
/// # Errors
/// As [`write()`], in a sentence.
pub fn write_beside(path: &Path, bytes: &[u8], force: bool) -> Result<PathBuf, Fault> {
    let path = spare(path, |path| force || is_free(path, bytes));
    write(&path, bytes).map_err(Fault::cannot("write", &path, ""))?;
    Ok(path)
}

/// Writes the requested output of a command.
///
/// # Errors
/// As [`write()`], in a sentence.
pub fn write_out(path: &Path, bytes: impl AsRef<[u8]>) -> Result<(), Fault> {
    let advice = "; give another path with --out";
    write(path, bytes).map_err(Fault::cannot("write", path, advice))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_through_its_link_and_nothing_is_left_of_a_failure() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("model");
        write(&file, "old").unwrap();
        write(&file, "new").unwrap();
        assert_eq!(std::fs::read(&file).unwrap(), b"new");
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(&file, &link).unwrap();
        write(&link, "newer").unwrap();
        assert!(link.is_symlink());
        assert_eq!(std::fs::read(&file).unwrap(), b"newer");
        write(std::path::Path::new("/dev/null"), "nothing").unwrap();
        assert!(!std::path::Path::new("/dev/null").is_file());
        let nowhere = folder.path().join("none/model");
        assert!(write(&nowhere, "lost").is_err());
        assert!(write(folder.path(), "no file").is_err());
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 2);
    }

    #[test]
    fn existing_files_beside_a_result_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let beside = |bytes, force| write_beside(&at("h.txt"), bytes, force).unwrap();
        std::fs::write(at("h.txt"), "by hand").unwrap();
        assert_eq!(beside(b"made", false), at("h-2.txt"));
        assert_eq!(beside(b"made", false), at("h-2.txt"), "the same once more");
        assert_eq!(beside(b"other", false), at("h-3.txt"));
        assert_eq!(std::fs::read(at("h.txt")).unwrap(), b"by hand");
        assert_eq!(unused(&at("h.txt")), at("h-4.txt"));
        assert_eq!(beside(b"made", true), at("h.txt"));
        assert_eq!(std::fs::read(at("h.txt")).unwrap(), b"made");
    }
}
