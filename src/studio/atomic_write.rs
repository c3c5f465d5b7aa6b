//! Files written whole or not at all.

use std::io;
use std::path::Path;

use crate::studio::fault::Fault;

/// Writes through a neighbour with `.part` behind its name, so that no half file is left and an old one stands until the
/// new one is whole. What a link names is written; what is no file, such as `/dev/stdout`, is written to directly.
///
/// # Errors
/// What the system says; the neighbour is gone then.
pub fn write(path: &Path, bytes: impl AsRef<[u8]>) -> io::Result<()> {
    let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    if path.exists() && !path.is_file() {
        return std::fs::write(path, bytes);
    }
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".part");
    let part = path.with_file_name(name);
    std::fs::write(&part, bytes)
        .and_then(|()| std::fs::rename(&part, &path))
        .inspect_err(|_| {
            // That it cannot be removed adds nothing to the error reported.
            let _ = std::fs::remove_file(&part);
        })
}

/// Writes what a command was asked for.
///
/// # Errors
/// As [`write()`], in a sentence.
pub fn write_out(path: &Path, bytes: impl AsRef<[u8]>) -> Result<(), Fault> {
    let advice = "; give another place with --out";
    write(path, bytes).map_err(Fault::cannot("write", path, advice))
}

#[cfg(test)]
mod tests {
    use super::write;

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
}
