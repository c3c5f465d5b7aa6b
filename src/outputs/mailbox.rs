//! Outputs with their own thread (web, MQTT): the mailbox shared by pipeline and thread, and the thread's wake-up socket. The
//! pipeline stores the newest report of each user, with the weights as the output presents them, and wakes the thread. Neither
//! side holds the lock for longer than a copy.

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
use crate::gesture::{SetUp, SetUpFacts};
use mien_stages::base::capacity::{GESTURES, REGIONS, UNITS, USERS};
use mien_stages::face_model::scheme::VISIBLE_REGIONS;

/// An output whose sending is done by its own thread: stores reports for it.
pub struct ThreadedOutput {
    name: &'static str,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    users: [(bool, WireWeights); USERS],
    view: View,
}

impl ThreadedOutput {
    /// Starts `work` on a thread called `name`, the section of the configuration.
    ///
    /// # Errors
    /// If the wake-up socket or the thread cannot be created.
    pub(super) fn start(
        name: &'static str,
        units: &[&str],
        view: &View,
        work: impl FnOnce(Arc<Shared>, Waker) + Send + 'static,
    ) -> Result<Self, OutputError> {
        let (shared, waker) = Shared::new().map_err(OutputError::Socket)?;
        let shared = Arc::new(shared);
        let for_thread = Arc::clone(&shared);
        let thread = limits::start_thread(name, move || work(for_thread, waker))?;
        let nobody = |_| (false, WireWeights::new(view.channels(units), view.loss));
        Ok(Self {
            name,
            shared,
            thread: Some(thread),
            users: std::array::from_fn(nobody),
            view: view.clone(),
        })
    }
}

impl Output for ThreadedOutput {
    /// Stores the report and wakes the thread.
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        let mut mailbox = self.shared.mailbox();
        if let Some(slot) = report.user.filter(|&slot| slot < USERS) {
            let (known, weights) = &mut self.users[slot];
            *known = true;
            weights.observe(report);
            let snapshot = &mut mailbox.users[slot];
            fill(snapshot, report, report.state, weights);
            snapshot.pose = self.view.pose_numbers(report);
            snapshot.seen = self.view.seen(report);
            if report.state.is_present() {
                snapshot.confidence = unit_range(report.confidence);
            }
            snapshot.frozen = report.frozen;
        } else {
            for ((known, weights), snapshot) in self.users.iter_mut().zip(&mut mailbox.users) {
                if *known {
                    weights.observe(report);
                    // Sent once more after the fade is complete, then no more.
                    *known = !weights.is_neutral();
                    fill(snapshot, report, TrackingState::Absent, weights);
                }
            }
            let nobody = &mut mailbox.nobody;
            (nobody.frame, nobody.at_us, nobody.fresh) = (report.frame, report.at.as_us(), true);
        }
        drop(mailbox);
        self.shared.wake();
        Ok(())
    }

    fn set_up(&mut self, set_up: &SetUp<'_>) {
        let mut mailbox = self.shared.mailbox();
        if let Some(place) = mailbox.set_ups.get_mut(set_up.facts.index) {
            *place = Some(set_up.facts);
        }
    }

    fn next_command(&mut self) -> Option<Command> {
        self.shared.mailbox().commands.pop_front()
    }

    fn tally(&self) -> Tally {
        let weights = self.users.iter().map(|(_, weights)| weights);
        Tally {
            not_numbers: weights.map(|weights| weights.not_numbers).sum(),
            ..self.shared.tally(self.name)
        }
    }
}

fn fill(snapshot: &mut Snapshot, report: &Report, state: TrackingState, weights: &WireWeights) {
    snapshot.frame = report.frame;
    snapshot.at_us = report.at.as_us();
    snapshot.count = snapshot.count.wrapping_add(1);
    (snapshot.latency_us, snapshot.gestures) = (report.latency_us, report.gestures);
    snapshot.state = state;
    (snapshot.pose, snapshot.seen, snapshot.confidence) = (None, None, 0.0);
    snapshot.weights.clear();
    snapshot.weights.extend(weights.shown().take(UNITS));
    snapshot.fresh = true;
}

impl Drop for ThreadedOutput {
    /// Sends neutral and absent; receivers have half a second to accept it.
    fn drop(&mut self) {
        let mut mailbox = self.shared.mailbox();
        for ((_, weights), snapshot) in self.users.iter_mut().zip(&mut mailbox.users) {
            if snapshot.count > 0 {
                weights.reset();
                let at = mien_stages::base::time::Timestamp::from_us(snapshot.at_us);
                let report = Report {
                    frame: snapshot.frame,
                    at,
                    ..Report::default()
                };
                fill(snapshot, &report, TrackingState::Absent, weights);
            }
        }
        drop(mailbox);
        self.shared.stop.store(true, Ordering::Relaxed);
        self.shared.wake();
        limits::join_or_abandon(&mut self.thread);
    }
}

/// Formats a weight for JSON: clamped to 0…1, four decimals.
pub(super) struct Weight(pub(super) f32);

impl std::fmt::Display for Weight {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // Integer formatting: float formatting would take most of a message's time.
        let parts = (unit_range(self.0) * 10_000.0).round() as u32;
        write!(f, "{}.{:04}", parts / 10_000, parts % 10_000)
    }
}

/// Capacity of the queue of commands for the pipeline.
const COMMANDS: usize = 16;

/// The newest report of one user as the output presents it.
#[derive(Clone, Debug, Default)]
pub(super) struct Snapshot {
    pub(super) frame: u64,
    pub(super) at_us: u64,
    /// Reports of this user so far.
    pub(super) count: u32,
    pub(super) state: TrackingState,
    pub(super) confidence: f32,
    pub(super) frozen: bool,
    pub(super) latency_us: u32,
    /// Gestures that are on, one bit each.
    pub(super) gestures: u32,
    /// Position in metres and quaternion x, y, z, w, sensor frame.
    pub(super) pose: Option<[f32; 7]>,
    /// How far each region of the face can be seen, 0…1.
    pub(super) seen: Option<[f32; REGIONS]>,
    pub(super) weights: heapless::Vec<f32, UNITS>,
    /// Whether the thread has not read it yet.
    pub(super) fresh: bool,
}

/// The members that every JSON object about a user has in common.
impl std::fmt::Display for Snapshot {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (state, sure, frozen) = (self.state.name(), Weight(self.confidence), self.frozen);
        write!(
            f,
            "\"state\":\"{state}\",\"confidence\":{sure},\"frozen\":{frozen}"
        )?;
        write!(f, ",\"latency_us\":{}", self.latency_us)?;
        for (k, share) in self.seen.iter().flatten().enumerate() {
            let start = if k > 0 { "," } else { ",\"seen\":{" };
            write!(f, "{start}\"{}\":{}", VISIBLE_REGIONS[k].0, Weight(*share))?;
        }
        f.write_str(if self.seen.is_some() { "}" } else { "" })
    }
}

/// The newest report of each user and of a frame with nobody; commands for the pipeline.
#[derive(Clone, Debug, Default)]
pub(super) struct Mailbox {
    pub(super) users: [Snapshot; USERS],
    pub(super) nobody: Snapshot,
    /// Facts of each gesture that the thread has not read yet.
    pub(super) set_ups: [Option<SetUpFacts>; GESTURES],
    pub(super) commands: heapless::Deque<Command, COMMANDS>,
}

/// State shared by the pipeline and the thread.
pub(super) struct Shared {
    mailbox: Mutex<Mailbox>,
    waker: UnixStream,
    pub(super) stop: AtomicBool,
    pub(super) sent: AtomicU64,
    pub(super) dropped: AtomicU64,
    /// Input refused as malformed or for lack of room.
    pub(super) refused: AtomicU64,
    accepted: AtomicU64,
    pub(super) connected: AtomicBool,
}

impl Shared {
    /// The shared state and the thread's end of the wake-up socket.
    ///
    /// # Errors
    /// If the socket pair cannot be created.
    pub(super) fn new() -> io::Result<(Self, Waker)> {
        let (waker, receiver) = UnixStream::pair()?;
        waker.set_nonblocking(true)?;
        receiver.set_nonblocking(true)?;
        let shared = Self {
            mailbox: Mutex::default(),
            waker,
            stop: AtomicBool::new(false),
            sent: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            refused: AtomicU64::new(0),
            accepted: AtomicU64::new(0),
            connected: AtomicBool::new(false),
        };
        Ok((shared, Waker(receiver)))
    }

    pub(super) fn mailbox(&self) -> MutexGuard<'_, Mailbox> {
        self.mailbox.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn wake(&self) {
        // If the socket is full, wake-ups are already pending.
        let _ = (&self.waker).write(&[1]);
    }

    /// Copies the reports into the thread's own mailbox and marks them as read.
    pub(super) fn fetch(&self, into: &mut Mailbox) {
        let mut mailbox = self.mailbox();
        let mailbox = &mut *mailbox;
        let theirs = mailbox.users.iter_mut().chain([&mut mailbox.nobody]);
        for (snapshot, own) in theirs.zip(into.users.iter_mut().chain([&mut into.nobody])) {
            // A report that the thread has not used yet stays fresh.
            let fresh = own.fresh || std::mem::take(&mut snapshot.fresh);
            own.clone_from(snapshot);
            own.fresh = fresh;
        }
        for (facts, own) in mailbox.set_ups.iter_mut().zip(&mut into.set_ups) {
            *own = facts.take().or(*own);
        }
    }

    /// Queues a command for the pipeline; `false` if there is no room and it is refused.
    pub(super) fn queue_command(&self, command: Command) -> bool {
        let is_queued = self.mailbox().commands.push_back(command).is_ok();
        let (accepted, refused) = (&self.accepted, &self.refused);
        count(if is_queued { accepted } else { refused });
        is_queued
    }

    /// The counters so far.
    pub(super) fn tally(&self, name: &'static str) -> Tally {
        let load = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Tally {
            sent: load(&self.sent),
            dropped: load(&self.dropped),
            connected: self.connected.load(Ordering::Relaxed),
            commands: [load(&self.accepted), load(&self.refused)],
            ..Tally::empty(name)
        }
    }
}

/// Adds one to a counter.
pub(super) fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

/// Writes queued bytes as far as the stream accepts them; returns their number.
///
/// # Errors
/// If the stream is closed or fails.
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
pub(super) struct Waker(UnixStream);

impl Waker {
    /// The descriptor to poll.
    pub(super) fn fd(&self) -> RawFd {
        self.0.as_raw_fd()
    }

    /// Discards the pending wake-ups.
    pub(super) fn clear(&mut self) {
        let mut bytes = [0; 64];
        while matches!(self.0.read(&mut bytes), Ok(64)) {}
    }
}
