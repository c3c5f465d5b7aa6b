//! Reads whole files up to a size limit.

use std::fmt::Display;
use std::fs::File;
use std::io::{Error, ErrorKind, Read, Result};
use std::os::fd::AsRawFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use nix::poll::{PollFd, PollFlags, poll};

/// Size limit for pipes and devices, bytes: their length is unknown.
const STREAM_MOST: usize = 16 << 20;
/// Longest wait for data from a pipe, milliseconds.
const PIPE_TIMEOUT_MS: i32 = 2000;

/// Reads a file, or a pipe until it is closed.
///
/// # Errors
/// If it cannot be read, is longer than `most` bytes, or is a pipe without data for 2 s.
pub fn read(path: &Path, most: usize) -> Result<Vec<u8>> {
    let mut options = File::options();
    // A blocking open would wait for a pipe's writer.
    let options = options
        .read(true)
        .custom_flags(libc::O_NONBLOCK | libc::O_NOCTTY);
    let file = options.open(path)?;
    let kind = file.metadata()?.file_type();
    if kind.is_file() || kind.is_dir() {
        return read_up_to(file, most);
    }
    stream(file, most.min(STREAM_MOST))
}

/// Reads a regular file referenced by another file, if it is in `folder` or below after following links: references elsewhere
/// are refused for security.
///
/// # Errors
/// As [`read_regular`], or if it is outside `folder`.
#[cfg(feature = "studio")]
pub fn read_below(folder: &Path, name: &str, most: usize) -> Result<Vec<u8>> {
    let here = Path::new(".");
    let folder = if folder.as_os_str().is_empty() {
        here
    } else {
        folder
    };
    let path = folder.join(name).canonicalize()?;
    if !path.starts_with(folder.canonicalize()?) {
        let folder = folder.display();
        return Err(Error::other(format!("expected a file inside {folder}")));
    }
    read_regular(&path, most)
}

fn stream(mut file: File, most: usize) -> Result<Vec<u8>> {
    let (mut bytes, mut buffer) = (Vec::new(), [0; 4096]);
    loop {
        let mut polled = [PollFd::new(file.as_raw_fd(), PollFlags::POLLIN)];
        if poll(&mut polled, PIPE_TIMEOUT_MS)? == 0 {
            let seconds = PIPE_TIMEOUT_MS / 1000;
            let text = format!("no data came through this pipe for {seconds} s");
            return Err(Error::new(ErrorKind::TimedOut, text));
        }
        match file.read(&mut buffer) {
            Ok(0) => return Ok(bytes),
            Ok(more) if bytes.len() + more > most => return Err(ErrorKind::FileTooLarge.into()),
            Ok(more) => bytes.extend_from_slice(&buffer[..more]),
            Err(error) => match error.kind() {
                ErrorKind::WouldBlock | ErrorKind::Interrupted => {}
                _ => return Err(error),
            },
        }
    }
}

/// Opens a regular file; refuses pipes, which could block.
///
/// # Errors
/// If it does not exist or is not a regular file.
pub fn open_regular(path: &Path) -> Result<File> {
    if !std::fs::metadata(path)?.is_file() {
        return Err(std::io::Error::other("not a regular file"));
    }
    File::open(path)
}

/// Reads a regular file of at most `most` bytes.
///
/// # Errors
/// As [`read`] and [`open_regular`].
pub fn read_regular(path: &Path, most: usize) -> Result<Vec<u8>> {
    read_up_to(open_regular(path)?, most)
}

/// Reads an open file of at most `most` bytes.
///
/// # Errors
/// As [`read`].
pub(crate) fn read_up_to(file: File, most: usize) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(most as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() > most {
        return Err(ErrorKind::FileTooLarge.into());
    }
    Ok(bytes)
}

/// An operating-system error's message in lower case, without its number.
pub fn reason(error: impl Display) -> String {
    let text = error.to_string();
    let words = text.split_once(" (os error ");
    words.map_or(text.clone(), |(words, _)| words.to_lowercase())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refuses_endless_files_and_idle_pipes() {
        let error = read(Path::new("/dev/zero"), 1 << 20).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::FileTooLarge);
        let absent = read(Path::new("/nowhere/file"), 1).unwrap_err();
        assert_eq!(reason(absent), "no such file or directory");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, [7; 9]).unwrap();
        assert_eq!(read(&path, 9).unwrap(), [7; 9]);
        assert!(read(&path, 8).is_err());
        // A pipe is read to its end; without a writer the read ends early.
        let pipe = folder.path().join("pipe");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.unwrap().success());
        assert!(read_regular(&pipe, 9).is_err());
        let began = std::time::Instant::now();
        let _ = read(&pipe, 9);
        assert!(began.elapsed().as_secs() < 5);
        let other = pipe.clone();
        let writer = std::thread::spawn(move || std::fs::write(other, [1; 9]));
        std::thread::sleep(std::time::Duration::from_millis(100));
        assert_eq!(read(&pipe, 9).unwrap(), [1; 9]);
        writer.join().unwrap().unwrap();
    }

    #[cfg(feature = "studio")]
    #[test]
    fn reads_references_inside_the_folder_only() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("head");
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(root.path().join("secret"), "no").unwrap();
        std::fs::write(folder.join("skin"), "yes").unwrap();
        std::os::unix::fs::symlink(root.path().join("secret"), folder.join("link")).unwrap();
        std::os::unix::fs::symlink("skin", folder.join("near")).unwrap();
        let absolute = root.path().join("secret");
        for name in [
            "../secret",
            "link",
            absolute.to_str().unwrap(),
            "/dev/zero",
            ".",
        ] {
            assert!(read_below(&folder, name, 99).is_err(), "{name}");
        }
        for name in ["skin", "./skin", "../head/skin", "near"] {
            assert_eq!(read_below(&folder, name, 99).unwrap(), b"yes", "{name}");
        }
    }
}
