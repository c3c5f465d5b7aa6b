//! Non-blocking writes to outputs that may have no reader: standard output and error, the CSV file.
//!
//! A pipe, terminal or socket without a reader fills up, and a plain write would block for ever. So pipes and
//! terminals are reopened in non-blocking mode (the inherited descriptor, which others may share, stays unchanged) and polled
//! for room before every write; sockets are only polled. A pipe takes a line of up to [`ATOMIC_BYTES`] bytes completely or not at
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
const ATOMIC_BYTES: usize = 4096;
/// Flags of a file whose writes never wait.
const NEVER_BLOCK: i32 = libc::O_NONBLOCK | libc::O_NOCTTY;
/// Interval at which a waiting call checks whether to stop, in milliseconds.
const POLL_MS: i32 = 100;

/// An open pipe, terminal, socket or file.
pub(crate) struct Pipe {
    file: File,
    /// Whether it is a regular file, which can be truncated.
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
        // A blocking open would wait for a reader regardless of signals.
        let mode = mode.custom_flags(NEVER_BLOCK);
        let mut is_logged = false;
        loop {
            match mode.open(path) {
                Err(error)
                    if error.raw_os_error() == Some(libc::ENXIO)
                        && !stop.load(Ordering::Relaxed) =>
                {
                    if !std::mem::replace(&mut is_logged, true) {
                        tracing::info!("{}: waiting for a reader", path.display());
                    }
                    std::thread::sleep(Duration::from_millis(POLL_MS as u64));
                }
                opened => return opened.and_then(Self::from_stream),
            }
        }
    }

    /// Opens the target of `stream`.
    ///
    /// # Errors
    /// If `stream` is closed.
    pub(crate) fn from_stream(stream: impl AsFd) -> io::Result<Self> {
        let file = File::from(stream.as_fd().try_clone_to_owned()?);
        let kind = file.metadata()?.file_type();
        let reopen = || {
            let (mut mode, path) = (
                File::options(),
                format!("/proc/self/fd/{}", file.as_raw_fd()),
            );
            mode.write(true).custom_flags(NEVER_BLOCK).open(path).ok()
        };
        let may_block = kind.is_fifo() || kind.is_char_device();
        Ok(Self {
            // If reopening fails, the inherited mode remains.
            file: may_block.then(reopen).flatten().unwrap_or(file),
            regular: kind.is_file(),
        })
    }

    /// Whether there is room, or an error to report, within `ms` milliseconds.
    fn has_room(&self, ms: i32) -> bool {
        let mut asked = [PollFd::new(self.file.as_raw_fd(), PollFlags::POLLOUT)];
        poll(&mut asked, ms).is_ok_and(|ready| ready > 0)
    }

    /// Writes up to [`ATOMIC_BYTES`] bytes; returns how many.
    ///
    /// # Errors
    /// `WouldBlock` without room, or as the write.
    fn write(&self, bytes: &[u8]) -> io::Result<usize> {
        if !self.has_room(0) {
            return Err(ErrorKind::WouldBlock.into());
        }
        (&self.file).write(&bytes[..bytes.len().min(ATOMIC_BYTES)])
    }

    /// Writes a line of at most [`ATOMIC_BYTES`] bytes if there is room; returns whether there was. Other errors are ignored.
    pub(crate) fn try_write(&self, line: &[u8]) -> bool {
        !matches!(self.write(line), Err(error) if error.kind() == ErrorKind::WouldBlock)
    }

    /// As [`Self::try_write`], but waits up to a second for room.
    pub(crate) fn write_with_timeout(&self, line: &[u8]) {
        self.has_room(1000);
        self.try_write(line);
    }
}

/// Writes complete rows to a pipe or file: an incomplete one is truncated from a file.
pub(crate) struct Rows {
    pipe: Pipe,
    /// Ends a wait.
    stop: Arc<AtomicBool>,
    /// Whether rows without room are dropped, as a live source does not wait.
    live: bool,
    /// Whether the header, the first row, was written; it always waits for room.
    header_written: bool,
}

impl Rows {
    /// Rows for `pipe`; `stop` ends a wait for room.
    pub(crate) fn new(pipe: Pipe, stop: &Arc<AtomicBool>, live: bool) -> Self {
        Self {
            pipe,
            stop: Arc::clone(stop),
            live,
            header_written: false,
        }
    }
}

impl Write for Rows {
    /// Writes a whole row.
    ///
    /// # Errors
    /// `WouldBlock` if the row was dropped or the wait stopped.
    fn write(&mut self, row: &[u8]) -> io::Result<usize> {
        let mut written = 0;
        while written < row.len() {
            match self.pipe.write(&row[written..]) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(more) => written += more,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    // A row that was started is completed.
                    let late = self.live && self.header_written && written == 0;
                    if late || self.stop.load(Ordering::Relaxed) {
                        return Err(error);
                    }
                    self.pipe.has_room(POLL_MS);
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
        self.header_written = true;
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
    fn a_row_without_room_is_dropped_whole() {
        let (mut reader, writer) = std::io::pipe().unwrap();
        let pipe = Pipe::from_stream(writer.as_fd()).unwrap();
        let row = [b'-'; 1000];
        let mut written = 0;
        while pipe.try_write(&row) {
            written += row.len();
        }
        let stop = Arc::new(AtomicBool::new(false));
        let mut live = Rows::new(pipe, &stop, true);
        live.header_written = true;
        let left_out = live.write(&row).unwrap_err();
        assert_eq!(left_out.kind(), ErrorKind::WouldBlock);
        // `stop` ends a wait.
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
        let mut rows = Rows::new(Pipe::from_stream(writer).unwrap(), &stop, false);
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
