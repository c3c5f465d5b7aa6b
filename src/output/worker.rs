//! What an output's own thread shares with the pipeline, and its wake-up socket. The pipeline stores the newest
//! report of each user and wakes the thread; neither waits for longer than a copy takes.

use std::io::{Read, Write};
use std::os::fd::{AsRawFd, RawFd};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::{Command, Tally, TrackingState};
use crate::base::capacity::{UNITS, USERS};

/// Commands waiting for the pipeline.
const COMMANDS: usize = 16;

/// A report as the output shows it.
#[derive(Clone, Debug, Default)]
pub(super) struct Shot {
    pub(super) frame: u64,
    pub(super) at_us: u64,
    /// Reports of this user so far.
    pub(super) count: u32,
    pub(super) state: TrackingState,
    pub(super) confidence: f32,
    pub(super) frozen: bool,
    pub(super) latency_us: u32,
    /// Gestures that are on, a bit each.
    pub(super) gestures: u32,
    /// Position in metres, rotation as x, y, z, w.
    pub(super) pose: Option<[f32; 7]>,
    pub(super) weights: heapless::Vec<f32, UNITS>,
    /// Whether it has not been read yet.
    pub(super) fresh: bool,
}

/// The newest report of each user, and of nobody.
#[derive(Clone, Debug, Default)]
pub(super) struct Board {
    pub(super) users: [Shot; USERS],
    pub(super) nobody: Shot,
    pub(super) commands: heapless::Deque<Command, COMMANDS>,
}

/// Shared by the pipeline and the thread.
pub(super) struct Shared {
    board: Mutex<Board>,
    bell: UnixStream,
    pub(super) stop: AtomicBool,
    pub(super) sent: AtomicU64,
    pub(super) dropped: AtomicU64,
    /// Input that was malformed or found no room.
    pub(super) refused: AtomicU64,
    taken: AtomicU64,
    pub(super) connected: AtomicBool,
}

impl Shared {
    /// With the thread's end of the wake-up socket.
    pub(super) fn new() -> std::io::Result<(Self, Bell)> {
        let (bell, heard) = UnixStream::pair()?;
        bell.set_nonblocking(true)?;
        heard.set_nonblocking(true)?;
        let shared = Self {
            board: Mutex::default(),
            bell,
            stop: AtomicBool::new(false),
            sent: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            refused: AtomicU64::new(0),
            taken: AtomicU64::new(0),
            connected: AtomicBool::new(false),
        };
        Ok((shared, Bell(heard)))
    }

    pub(super) fn board(&self) -> MutexGuard<'_, Board> {
        self.board.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn ring(&self) {
        // A full one has been rung enough.
        let _ = (&self.bell).write(&[1]);
    }

    /// Copies the reports and marks them as read.
    pub(super) fn take(&self, into: &mut Board) {
        let mut board = self.board();
        let board = &mut *board;
        let theirs = board.users.iter_mut().chain([&mut board.nobody]);
        for (shot, own) in theirs.zip(into.users.iter_mut().chain([&mut into.nobody])) {
            // What the thread has not looked at stays fresh.
            let fresh = own.fresh || std::mem::take(&mut shot.fresh);
            own.clone_from(shot);
            own.fresh = fresh;
        }
    }

    /// Passes a command to the pipeline; false if there is no room, and it is refused.
    pub(super) fn ask(&self, command: Command) -> bool {
        let took = self.board().commands.push_back(command).is_ok();
        count(if took { &self.taken } else { &self.refused });
        took
    }

    /// The counters so far.
    pub(super) fn tally(&self, name: &'static str) -> Tally {
        let of = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Tally {
            sent: of(&self.sent),
            dropped: of(&self.dropped),
            connected: self.connected.load(Ordering::Relaxed),
            commands: [of(&self.taken), of(&self.refused)],
            ..Tally::of(name)
        }
    }
}

/// Adds one.
pub(super) fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

/// The thread's end of the wake-up socket.
pub(super) struct Bell(UnixStream);

impl Bell {
    /// The descriptor to poll.
    pub(super) fn fd(&self) -> RawFd {
        self.0.as_raw_fd()
    }

    /// Clears all wake-ups so far.
    pub(super) fn answer(&mut self) {
        let mut rings = [0; 64];
        while matches!(self.0.read(&mut rings), Ok(64)) {}
    }
}
