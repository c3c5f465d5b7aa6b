//! The thread between the pipeline and a serial port.

use std::io::{ErrorKind, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::Settings;
use super::line::Line;
use crate::output::OutputError;

/// How often the names of the units are repeated.
const HEADER_PERIOD: Duration = Duration::from_secs(5);
/// First and longest pause before an absent port is tried again.
const PAUSES: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(5)];
/// How long one write may take: less than a frame.
const WRITE_TIMEOUT: Duration = Duration::from_millis(20);
/// A port that takes nothing for so long is given up and opened again.
const STUCK: Duration = Duration::from_secs(2);
/// The same when the programme is ending.
const STUCK_AT_THE_END: Duration = Duration::from_millis(200);
/// Bits on the line per byte: start, eight, stop.
const BITS_PER_BYTE: u64 = 10;

/// Whether a port is there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PortState {
    /// Not yet, or not any more; it is tried again and again.
    #[default]
    Absent,
    /// Open and written to.
    Open,
}

/// What the pipeline and the thread share.
pub(super) struct Shared {
    waiting: Mutex<Waiting>,
    /// Wakes the thread.
    changed: Condvar,
    dropped: AtomicU64,
}

struct Waiting {
    /// The newest frame that was not sent yet; empty if there is none.
    line: Line,
    state: PortState,
    stop: bool,
}

impl Shared {
    pub(super) fn new() -> Self {
        Self {
            waiting: Mutex::new(Waiting {
                line: Line::new(),
                state: PortState::Absent,
                stop: false,
            }),
            changed: Condvar::new(),
            dropped: AtomicU64::new(0),
        }
    }

    /// Held for a copy of a line at most, by either side.
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn put(&self, line: &Line) {
        let mut waiting = self.lock();
        if !waiting.line.bytes().is_empty() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
        waiting.line.clone_from(line);
        drop(waiting);
        self.changed.notify_one();
    }

    pub(super) fn stop(&self) {
        self.lock().stop = true;
        self.changed.notify_one();
    }

    pub(super) fn state(&self) -> PortState {
        self.lock().state
    }

    pub(super) fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    fn set_state(&self, state: PortState) {
        self.lock().state = state;
    }

    /// Waits at most `time`, or until told to stop; whether it was.
    fn pause(&self, time: Duration) -> bool {
        let waited = self
            .changed
            .wait_timeout_while(self.lock(), time, |waiting| !waiting.stop);
        waited.unwrap_or_else(PoisonError::into_inner).0.stop
    }

    /// Waits at most `time` for a frame and moves it to `line`; whether to stop after it.
    fn take(&self, time: Duration, line: &mut Line) -> bool {
        let idle = |waiting: &mut Waiting| waiting.line.bytes().is_empty() && !waiting.stop;
        let waited = self.changed.wait_timeout_while(self.lock(), time, idle);
        let mut waiting = waited.unwrap_or_else(PoisonError::into_inner).0;
        line.clone_from(&waiting.line);
        waiting.line.clear();
        waiting.stop
    }
}

/// Starts the thread.
pub(super) fn feed(
    settings: &Settings,
    header: Line,
    shared: Arc<Shared>,
) -> Result<JoinHandle<()>, OutputError> {
    let (path, baud) = (settings.port.clone(), settings.baud.max(1));
    let thread = std::thread::Builder::new().name("serial".to_owned());
    thread
        .spawn(move || {
            let mut pause = PAUSES[0];
            let mut told = false;
            loop {
                let port = serialport::new(&path, baud).timeout(WRITE_TIMEOUT).open();
                match port {
                    Ok(mut port) => {
                        tracing::info!("serial port {path} is open");
                        shared.set_state(PortState::Open);
                        let opened = Instant::now();
                        let end = write_frames(port.as_mut(), baud, &header, &shared);
                        shared.set_state(PortState::Absent);
                        let Err(error) = end else { return };
                        tracing::warn!("serial port {path} is lost ({error}), trying to open it again");
                        told = true;
                        // One that opens and fails at once is not tried without a pause.
                        if opened.elapsed() > PAUSES[1] {
                            pause = PAUSES[0];
                        }
                    }
                    Err(error) if !told => {
                        tracing::warn!("serial port {path} cannot be opened ({error}), trying again until it is there");
                        told = true;
                    }
                    Err(_) => {}
                }
                if shared.pause(pause) {
                    return;
                }
                pause = (2 * pause).min(PAUSES[1]);
            }
        })
        .map_err(|source| OutputError::Thread { source })
}

/// Writes frames until told to stop (`Ok`) or the port fails.
fn write_frames(
    port: &mut dyn Write,
    baud: u32,
    header: &Line,
    shared: &Shared,
) -> std::io::Result<()> {
    let mut line = Line::new();
    let mut header_sent: Option<Instant> = None;
    loop {
        if header_sent.is_none_or(|at| at.elapsed() >= HEADER_PERIOD) {
            write_paced(port, baud, header.bytes(), shared)?;
            header_sent = Some(Instant::now());
        }
        let stop = shared.take(HEADER_PERIOD, &mut line);
        write_paced(port, baud, line.bytes(), shared)?;
        if stop {
            return Ok(());
        }
    }
}

/// Writes all bytes and waits for as long as the line needs for them. A part of a sentence is never left behind on purpose:
/// what the port does not take in time is tried again.
fn write_paced(
    port: &mut dyn Write,
    baud: u32,
    mut bytes: &[u8],
    shared: &Shared,
) -> std::io::Result<()> {
    let start = Instant::now();
    let line_time =
        Duration::from_micros(bytes.len() as u64 * BITS_PER_BYTE * 1_000_000 / u64::from(baud));
    let mut progress = start;
    while !bytes.is_empty() {
        match port.write(bytes) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(taken) => {
                bytes = &bytes[taken..];
                progress = Instant::now();
            }
            Err(error)
                if matches!(
                    error.kind(),
                    ErrorKind::TimedOut | ErrorKind::Interrupted | ErrorKind::WouldBlock
                ) =>
            {
                let limit = if shared.lock().stop {
                    STUCK_AT_THE_END
                } else {
                    STUCK
                };
                if progress.elapsed() > limit {
                    return Err(ErrorKind::TimedOut.into());
                }
            }
            Err(error) => return Err(error),
        }
    }
    std::thread::sleep(line_time.saturating_sub(start.elapsed()));
    Ok(())
}
