//! Reads whole files, up to the largest size a file of their kind can have.

use std::fs::File;
use std::io::{ErrorKind, Read, Result};
use std::path::Path;

/// The bytes of a file.
///
/// # Errors
/// If it cannot be read, or has more than `most` bytes.
pub(crate) fn read(path: &Path, most: usize) -> Result<Vec<u8>> {
    all(File::open(path)?, most)
}

/// The file at `path`, if it is one: what a pipe would give is not waited for.
///
/// # Errors
/// If it is not there, or no regular file.
pub(crate) fn open_regular(path: &Path) -> Result<File> {
    if !std::fs::metadata(path)?.is_file() {
        return Err(std::io::Error::other("not a regular file"));
    }
    File::open(path)
}

/// The bytes of a regular file.
///
/// # Errors
/// As [`read`] and [`open_regular`].
pub(crate) fn regular(path: &Path, most: usize) -> Result<Vec<u8>> {
    all(open_regular(path)?, most)
}

/// The bytes of an open file.
///
/// # Errors
/// As [`read`].
pub(crate) fn all(file: File, most: usize) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(most as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() > most {
        return Err(ErrorKind::FileTooLarge.into());
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_without_an_end_is_refused() {
        let error = read(Path::new("/dev/zero"), 1 << 20).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::FileTooLarge);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, [7; 9]).unwrap();
        assert_eq!(read(&path, 9).unwrap(), [7; 9]);
        assert!(read(&path, 8).is_err());
    }
}
