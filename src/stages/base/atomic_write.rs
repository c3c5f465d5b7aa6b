//! Writes files whole or not at all: the one writer of the status, the saved people and everything the workstation makes.
//!
//! The bytes go into a new file beside the target (created exclusively, so no link is followed and no other file is opened),
//! which then takes the target's name. Only regular files and links are replaced; of a link the link itself, not its target.
//! Nothing allocates after [`AtomicFile::at`] while paths are shorter than 384 bytes.

use std::fs::{self, File, Metadata, Permissions};
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// A file that is replaced as a whole, each time it is written.
pub struct AtomicFile {
    path: PathBuf,
    /// The name it is written under.
    new: PathBuf,
    /// Permissions; `None` keeps those that it has, or leaves a new file to the process's mask.
    mode: Option<u32>,
    /// Whether it must survive a power cut that follows at once.
    durable: bool,
}

impl AtomicFile {
    /// At a path; nothing is written yet. The temporary name carries the process's number, so that two programs never share it.
    pub fn at(path: &Path, mode: Option<u32>, durable: bool) -> Self {
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

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the file.
    ///
    /// # Errors
    /// What the system says, or that something stands there that is no regular file; the old file is unchanged then.
    pub fn write(&self, bytes: &[u8]) -> io::Result<Metadata> {
        let old = match fs::symlink_metadata(&self.path) {
            Ok(old) if old.is_file() => Some(old.permissions().mode() & 0o7777),
            Ok(old) if !old.is_symlink() => return Err(io::Error::other("not a regular file")),
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
            _ => None,
        };
        let mode = self.mode.or(old);
        // Left by a killed process that had the same number.
        let _ = fs::remove_file(&self.new);
        let mut options = File::options();
        let options = options
            .write(true)
            .create_new(true)
            .mode(mode.unwrap_or(0o666));
        let file = options.open(&self.new)?;
        let written = self.fill(file, mode, bytes).inspect_err(|_| {
            // That it cannot be removed adds nothing to the error reported.
            let _ = fs::remove_file(&self.new);
        })?;
        let folder = self.path.parent().filter(|_| self.durable);
        if let Some(folder) = folder {
            let here = folder.as_os_str().is_empty();
            // Some file systems cannot sync a folder; the file is written all the same.
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
    fn a_file_is_replaced_whole_and_nothing_else_is_touched() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let mode = |name: &str| fs::metadata(at(name)).unwrap().permissions().mode() & 0o777;
        let file = AtomicFile::at(&at("a"), None, true);
        file.write(b"one").unwrap();
        fs::set_permissions(at("a"), Permissions::from_mode(0o640)).unwrap();
        // A link where the new file is to be written: neither followed nor an obstacle.
        fs::write(at("other"), "untouched").unwrap();
        symlink(at("other"), &file.new).unwrap();
        file.write(b"two").unwrap();
        assert_eq!(
            (fs::read(at("a")).unwrap(), mode("a")),
            (b"two".to_vec(), 0o640)
        );
        AtomicFile::at(&at("private"), Some(0o600), false)
            .write(b"")
            .unwrap();
        assert_eq!(mode("private"), 0o600);
        // A link at the name itself is replaced, its target is not.
        symlink(at("other"), at("link")).unwrap();
        AtomicFile::at(&at("link"), None, false)
            .write(b"three")
            .unwrap();
        assert!(!at("link").is_symlink());
        assert_eq!(fs::read(at("other")).unwrap(), b"untouched");
        assert!(
            AtomicFile::at(Path::new("/dev/null"), None, false)
                .write(b"")
                .is_err()
        );
        assert!(
            AtomicFile::at(folder.path(), None, false)
                .write(b"")
                .is_err()
        );
        assert!(
            AtomicFile::at(&at("none/a"), None, false)
                .write(b"")
                .is_err()
        );
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 4);
    }
}
