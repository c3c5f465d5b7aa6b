//! Atomic file replacement, for the status, the saved people and all files of the workstation.
//!
//! The bytes go into a new file beside the target (created exclusively, so no link is followed and no existing file opened),
//! which is then renamed to the target. Only regular files and links are replaced; a link itself, not its target.
//! Nothing allocates after [`AtomicFile::new`] while paths are shorter than 384 bytes.

use std::fs::{self, File, Metadata, Permissions};
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// A file that each write replaces atomically.
pub struct AtomicFile {
    path: PathBuf,
    /// Temporary name beside `path`.
    new: PathBuf,
    /// Permissions; `None` keeps the old file's, or applies the process's umask to a new file.
    mode: Option<u32>,
    /// Whether each write is synced to disk, against a power cut.
    durable: bool,
}

impl AtomicFile {
    /// A file at `path`; nothing is written yet. The temporary name contains the process id, so two programs never share it.
    pub fn new(path: &Path, mode: Option<u32>, durable: bool) -> Self {
        let mut name = std::ffi::OsString::from(".");
        name.push(path.file_name().unwrap_or_default());
        name.push(format!(".{}.new", std::process::id()));
        Self {
            path: path.to_owned(),
            new: path.with_file_name(name),
            mode,
            durable,
        }
    }

    /// Target path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Replaces the file with `bytes`; returns its metadata.
    ///
    /// # Errors
    /// An I/O error, or a path that is neither a regular file nor a link; the old file is then unchanged.
    pub fn write(&self, bytes: &[u8]) -> io::Result<Metadata> {
        let old = match fs::symlink_metadata(&self.path) {
            Ok(old) if old.is_file() => Some(old.permissions().mode() & 0o7777),
            Ok(old) if !old.is_symlink() => return Err(io::Error::other("not a regular file")),
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
            _ => None,
        };
        let mode = self.mode.or(old);
        // Leftover of a killed process with the same id.
        let _ = fs::remove_file(&self.new);
        let mut options = File::options();
        let options = options
            .write(true)
            .create_new(true)
            .mode(mode.unwrap_or(0o666));
        let file = options.open(&self.new)?;
        let written = self.fill(file, mode, bytes).inspect_err(|_| {
            // The first error is the one to report.
            let _ = fs::remove_file(&self.new);
        })?;
        let folder = self.path.parent().filter(|_| self.durable);
        if let Some(folder) = folder {
            let here = folder.as_os_str().is_empty();
            // Some file systems cannot sync a folder; the file is written anyway.
            let _ = File::open(if here { Path::new(".") } else { folder })
                .and_then(|folder| folder.sync_all());
        }
        Ok(written)
    }

    fn fill(&self, mut file: File, mode: Option<u32>, bytes: &[u8]) -> io::Result<Metadata> {
        if let Some(mode) = mode {
            file.set_permissions(Permissions::from_mode(mode))?;
        }
        file.write_all(bytes)?;
        if self.durable {
            file.sync_all()?;
        }
        let written = file.metadata()?;
        fs::rename(&self.new, &self.path)?;
        Ok(written)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn replaces_a_file_atomically_and_touches_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let mode = |name: &str| fs::metadata(path(name)).unwrap().permissions().mode() & 0o777;
        let file = AtomicFile::new(&path("a"), None, true);
        file.write(b"one").unwrap();
        fs::set_permissions(path("a"), Permissions::from_mode(0o640)).unwrap();
        // A link where the new file is to be written: neither followed nor an obstacle.
        fs::write(path("other"), "untouched").unwrap();
        symlink(path("other"), &file.new).unwrap();
        file.write(b"two").unwrap();
        assert_eq!(
            (fs::read(path("a")).unwrap(), mode("a")),
            (b"two".to_vec(), 0o640)
        );
        AtomicFile::new(&path("private"), Some(0o600), false)
            .write(b"")
            .unwrap();
        assert_eq!(mode("private"), 0o600);
        // A link at the name itself is replaced, its target is not.
        symlink(path("other"), path("link")).unwrap();
        AtomicFile::new(&path("link"), None, false)
            .write(b"three")
            .unwrap();
        assert!(!path("link").is_symlink());
        assert_eq!(fs::read(path("other")).unwrap(), b"untouched");
        assert!(
            AtomicFile::new(Path::new("/dev/null"), None, false)
                .write(b"")
                .is_err()
        );
        assert!(
            AtomicFile::new(folder.path(), None, false)
                .write(b"")
                .is_err()
        );
        assert!(
            AtomicFile::new(&path("none/a"), None, false)
                .write(b"")
                .is_err()
        );
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 4);
    }
}
