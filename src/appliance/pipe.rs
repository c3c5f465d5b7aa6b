//! Non-blocking writes to outputs that may have no reader: standard output and error, the CSV file.
//!
//! A pipe, terminal or socket whose other end is not read fills up, and a plain write would block for ever. So pipes and
//! terminals are reopened in non-blocking mode (the inherited descriptor, which others may share, stays unchanged) and polled
//! for room before every write; sockets are only polled. A pipe takes a line of up to [`WHOLE`] bytes completely or not at
//! all. Nothing allocates after opening.

use std::fs::File;
use std::io::{self, ErrorKind, Write};
use std::os::fd::{AsFd, AsRawFd};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use nix::poll::{PollFd, PollFlags, poll};

/// Bytes that a pipe with any room takes at once (`PIPE_BUF`).
const WHOLE: usize = 4096;
/// Interval at which a waiting call checks whether to stop, in milliseconds.
const LOOK_MS: i32 = 100;

/// An open pipe, terminal, socket or file.
pub(crate) struct Pipe {
    file: File,
    /// Whether it can be truncated.
    regular: bool,
}

impl Pipe {
    /// Creates or empties the file at `path`. If it is a pipe, waits for a reader.
    ///
    /// # Errors
    /// If it cannot be opened, or `stop` ends the wait.
    pub(crate) fn create(path: &Path, stop: &AtomicBool) -> io::Result<Self> {
        let mut mode = File::options();
        let mode = mode.write(true).create(true).truncate(true);
        // A plain open would wait for the reader, whatever the signal.
        let mode = mode.custom_flags(libc::O_NONBLOCK | libc::O_NOCTTY);
        let mut told = false;
        loop {
            match mode.open(path) {
                Err(error)
                    if error.raw_os_error() == Some(libc::ENXIO)
                        && !stop.load(Ordering::Relaxed) =>
                {
                    if !std::mem::replace(&mut told, true) {
                        tracing::info!("{}: waiting for a reader", path.display());
                    }
                    std::thread::sleep(Duration::from_millis(LOOK_MS as u64));
                }
                opened => return opened.and_then(Self::of),
            }
        }
    }

    /// The target of `stream`.
    ///
    /// # Errors
    /// If `stream` is closed.
    pub(crate) fn of(stream: impl AsFd) -> io::Result<Self> {
        let file = File::from(stream.as_fd().try_clone_to_owned()?);
        let kind = file.metadata()?.file_type();
        let again = || {
            let mut mode = File::options();
            let mode = mode
                .write(true)
                .custom_flags(libc::O_NONBLOCK | libc::O_NOCTTY);
            mode.open(format!("/proc/self/fd/{}", file.as_raw_fd()))
                .ok()
        };
        // One that may not be opened is written to as it is.
        let opened = (kind.is_fifo() || kind.is_char_device())
            .then(again)
            .flatten();
        Ok(Self {
            file: opened.unwrap_or(file),
            regular: kind.is_file(),
        })
    }

    /// Whether there is room, or an error to report, within `ms`.
    fn has_room(&self, ms: i32) -> bool {
        let mut asked = [PollFd::new(self.file.as_raw_fd(), PollFlags::POLLOUT)];
        poll(&mut asked, ms).is_ok_and(|ready| ready > 0)
    }

    /// Writes as much as there is room for.
    fn write(&self, bytes: &[u8]) -> io::Result<usize> {
        if !self.has_room(0) {
            return Err(ErrorKind::WouldBlock.into());
        }
        (&self.file).write(&bytes[..bytes.len().min(WHOLE)])
    }

    /// Writes a line of at most [`WHOLE`] bytes if there is room; returns whether there was. Other errors are ignored.
    pub(crate) fn offer(&self, line: &[u8]) -> bool {
        !matches!(self.write(line), Err(error) if error.kind() == ErrorKind::WouldBlock)
    }

    /// As [`Self::offer`], but waits up to a second for room.
    pub(crate) fn insist(&self, line: &[u8]) {
        self.has_room(1000);
        self.offer(line);
    }
}

/// Writes rows to a pipe or file, each complete: an incomplete one is truncated away, or not started.
pub(crate) struct Rows {
    pipe: Pipe,
    /// Ends a wait.
    stop: Arc<AtomicBool>,
    /// Whether a row without room is dropped, because the source does not wait.
    live: bool,
    /// Whether the first row, the header, has been written: it always waits for room.
    begun: bool,
}

impl Rows {
    /// Writes rows to `pipe`, until `stop`.
    pub(crate) fn to(pipe: Pipe, stop: &Arc<AtomicBool>, live: bool) -> Self {
        Self {
            pipe,
            stop: Arc::clone(stop),
            live,
            begun: false,
        }
    }
}

impl Write for Rows {
    /// Takes a row.
    ///
    /// # Errors
    /// `WouldBlock` if it was dropped.
    fn write(&mut self, row: &[u8]) -> io::Result<usize> {
        let mut written = 0;
        while written < row.len() {
            match self.pipe.write(&row[written..]) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(more) => written += more,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    // What has been begun is ended, if ever that is possible.
                    let late = self.live && self.begun && written == 0;
                    if late || self.stop.load(Ordering::Relaxed) {
                        return Err(error);
                    }
                    self.pipe.has_room(LOOK_MS);
                }
                Err(error) => {
                    if self.pipe.regular {
                        let length = self.pipe.file.metadata()?.len();
                        self.pipe.file.set_len(length - written as u64)?;
                    }
                    return Err(error);
                }
            }
        }
        self.begun = true;
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    #[test]
    fn what_finds_no_room_is_left_out_whole() {
        let (mut reader, writer) = std::io::pipe().unwrap();
        let pipe = Pipe::of(writer.as_fd()).unwrap();
        let row = [b'-'; 1000];
        let mut written = 0;
        while pipe.offer(&row) {
            written += row.len();
        }
        let stop = Arc::new(AtomicBool::new(false));
        let mut live = Rows::to(pipe, &stop, true);
        live.begun = true;
        let left_out = live.write(&row).unwrap_err();
        assert_eq!(left_out.kind(), ErrorKind::WouldBlock);
        // Whoever waits ends when told to.
        live.live = false;
        stop.store(true, Ordering::Relaxed);
        assert!(live.write(&row).is_err());
        drop((live, writer));
        let mut all = Vec::new();
        reader.read_to_end(&mut all).unwrap();
        assert_eq!(all.len(), written);
    }

    #[test]
    fn a_reader_that_is_slow_gets_every_row() {
        let (mut reader, writer) = std::io::pipe().unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let mut rows = Rows::to(Pipe::of(writer).unwrap(), &stop, false);
        let read = std::thread::spawn(move || {
            let mut all = Vec::new();
            reader.read_to_end(&mut all).map(|_| all)
        });
        let expected: Vec<u8> = (0..100_u8).flat_map(|row| [row; 6000]).collect();
        for row in expected.chunks(6000) {
            rows.write_all(row).unwrap();
        }
        drop(rows);
        assert!(read.join().unwrap().unwrap() == expected);
    }
}
