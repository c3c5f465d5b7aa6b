//! Outputs with their own thread (web, MQTT): what the pipeline and the thread share, and its wake-up socket. The pipeline
//! stores the newest report of each user, with the weights as that output presents them, and wakes the thread; neither waits
//! for longer than a copy takes.

use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::{AsRawFd, RawFd};
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use super::{
    Command, Output, OutputError, Report, Tally, TrackingState, View, WireWeights, limits,
    unit_range,
};
use mien_stages::base::capacity::{UNITS, USERS};

/// Where reports are stored for an output's thread.
pub struct Front {
    name: &'static str,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    users: [(bool, WireWeights); USERS],
    view: View,
}

impl Front {
    /// Starts `work` on a thread called `name`, the section of the configuration.
    pub(super) fn start(
        name: &'static str,
        units: &[&str],
        view: &View,
        work: impl FnOnce(Arc<Shared>, Bell) + Send + 'static,
    ) -> Result<Self, OutputError> {
        let (shared, bell) = Shared::new().map_err(OutputError::Socket)?;
        let shared = Arc::new(shared);
        let its = Arc::clone(&shared);
        let thread = limits::start_thread(name, move || work(its, bell))?;
        Ok(Self {
            name,
            shared,
            thread: Some(thread),
            users: std::array::from_fn(|_| {
                (false, WireWeights::new(view.channels(units), view.loss))
            }),
            view: view.clone(),
        })
    }
}

impl Output for Front {
    /// Stores the report and wakes the thread.
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        let mut board = self.shared.board();
        if let Some(slot) = report.user.filter(|&slot| slot < USERS) {
            let (known, weights) = &mut self.users[slot];
            *known = true;
            weights.observe(report);
            let shot = &mut board.users[slot];
            fill(shot, report, report.state, weights);
            shot.pose = self.view.pose_numbers(report);
            if report.state.is_present() {
                shot.confidence = unit_range(report.confidence);
            }
            shot.frozen = report.frozen;
        } else {
            for ((known, weights), shot) in self.users.iter_mut().zip(&mut board.users) {
                if *known {
                    weights.observe(report);
                    // Told once more when all is at rest, then no more.
                    *known = !weights.is_neutral();
                    fill(shot, report, TrackingState::Absent, weights);
                }
            }
            let nobody = &mut board.nobody;
            (nobody.frame, nobody.at_us, nobody.fresh) = (report.frame, report.at.as_us(), true);
        }
        drop(board);
        self.shared.ring();
        Ok(())
    }

    fn next_command(&mut self) -> Option<Command> {
        self.shared.board().commands.pop_front()
    }

    fn tally(&self) -> Tally {
        let weights = self.users.iter().map(|(_, weights)| weights);
        Tally {
            not_numbers: weights.map(|weights| weights.not_numbers).sum(),
            ..self.shared.tally(self.name)
        }
    }
}

fn fill(shot: &mut Shot, report: &Report, state: TrackingState, weights: &WireWeights) {
    shot.frame = report.frame;
    shot.at_us = report.at.as_us();
    shot.count = shot.count.wrapping_add(1);
    (shot.latency_us, shot.gestures) = (report.latency_us, report.gestures);
    shot.state = state;
    (shot.pose, shot.confidence) = (None, 0.0);
    shot.weights.clear();
    shot.weights.extend(weights.shown().take(UNITS));
    shot.fresh = true;
}

impl Drop for Front {
    /// Sends neutral and absent, as far as receivers accept it within half a second.
    fn drop(&mut self) {
        let mut board = self.shared.board();
        for ((_, weights), shot) in self.users.iter_mut().zip(&mut board.users) {
            if shot.count > 0 {
                weights.reset();
                let at = mien_stages::base::time::Timestamp::from_us(shot.at_us);
                let report = Report {
                    frame: shot.frame,
                    at,
                    ..Report::default()
                };
                fill(shot, &report, TrackingState::Absent, weights);
            }
        }
        drop(board);
        self.shared.stop.store(true, Ordering::Relaxed);
        self.shared.ring();
        limits::wait_for(&mut self.thread);
    }
}

/// A weight in JSON: four decimals.
pub(super) struct Weight(pub(super) f32);

impl std::fmt::Display for Weight {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // By hand: a float's own way takes most of the time of a message.
        let parts = (unit_range(self.0) * 10_000.0).round() as u32;
        write!(f, "{}.{:04}", parts / 10_000, parts % 10_000)
    }
}

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

/// What is told of every user, as members of a JSON object.
impl std::fmt::Display for Shot {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "\"state\":\"{}\",\"confidence\":{},\"frozen\":{},\"latency_us\":{}",
            self.state.name(),
            Weight(self.confidence),
            self.frozen,
            self.latency_us
        )
    }
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
    pub(super) fn new() -> io::Result<(Self, Bell)> {
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
            ..Tally::empty(name)
        }
    }
}

/// Adds one.
pub(super) fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

/// Writes what is queued as far as a stream accepts it; how much that was.
pub(super) fn write_queued(stream: &mut impl Write, queued: &mut Vec<u8>) -> io::Result<usize> {
    let mut written = 0;
    while written < queued.len() {
        match stream.write(&queued[written..]) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(more) => written += more,
            Err(error) if error.kind() == ErrorKind::WouldBlock => break,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    queued.drain(..written);
    Ok(written)
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
