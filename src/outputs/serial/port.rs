//! The serial line as an output: an encoder, and the thread that writes to the port.
//!
//! Names such as `/dev/ttyUSB0` may move to another adapter. When a port is first opened, the system's stable name for the device
//! (a link in `/dev/serial/by-id`) is therefore looked up and used from then on.

use std::io::{ErrorKind, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::budget::{self, Plan};
use super::encoder::Encoder;
use super::line::Line;
use super::settings::{Settings, Style};
use crate::limits::{self, BackOff};
use crate::{Output, OutputError, Report, Tally};

/// Interval at which the unit names are repeated.
const HEADER_PERIOD: Duration = Duration::from_secs(budget::HEADER_PERIOD_S as u64);
/// Folder of the system's stable names of serial devices.
pub const STABLE_NAMES: &str = "/dev/serial/by-id";
/// Timeout for connecting to a serial server.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(1);
/// First and longest pause before reopening an absent port.
const PAUSES: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(5)];
/// Timeout of one write, shorter than a frame.
const WRITE_TIMEOUT: Duration = Duration::from_millis(20);
/// A port that accepts nothing for this long is closed and reopened.
const STALL_LIMIT: Duration = Duration::from_secs(2);
/// The same when the program is ending.
const END_STALL_LIMIT: Duration = Duration::from_millis(200);

/// State shared by the pipeline and the thread.
#[derive(Default)]
struct Shared {
    waiting: Mutex<Waiting>,
    /// Wakes the thread.
    changed: Condvar,
    /// Frames written.
    sent: AtomicU64,
    /// Frames replaced by a newer one before the port accepted them, and gestures without room.
    dropped: AtomicU64,
}

#[derive(Default)]
struct Waiting {
    /// The newest unsent frame; empty if there is none.
    line: Line,
    /// Unsent gesture messages.
    switches: Line,
    is_open: bool,
    stop: bool,
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn queue_frame(&self, line: &Line) {
        let mut waiting = self.lock();
        if !waiting.line.bytes().is_empty() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
        waiting.line.clone_from(line);
        drop(waiting);
        self.changed.notify_one();
    }

    /// Queues a gesture message, which frames do not replace; without room it is dropped and counted. Gesture states are repeated
    /// anyway.
    fn queue_switch(&self, write: impl FnOnce(&mut Line) -> std::fmt::Result) {
        if !self.lock().switches.all_or_nothing(write) {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
        self.changed.notify_one();
    }

    /// Waits for `time` or until asked to stop; returns whether to stop.
    fn pause(&self, time: Duration) -> bool {
        let goes_on = |waiting: &mut Waiting| !waiting.stop;
        let waited = self.changed.wait_timeout_while(self.lock(), time, goes_on);
        waited.unwrap_or_else(PoisonError::into_inner).0.stop
    }

    /// Waits at most `time` for messages and moves them to `line`; returns whether to stop after them.
    fn next_line(&self, time: Duration, line: &mut Line) -> bool {
        let idle = |waiting: &mut Waiting| {
            waiting.line.bytes().is_empty() && waiting.switches.bytes().is_empty() && !waiting.stop
        };
        let waited = self.changed.wait_timeout_while(self.lock(), time, idle);
        let mut waiting = waited.unwrap_or_else(PoisonError::into_inner).0;
        line.clone_from(&waiting.switches);
        waiting.switches.clear();
        // If the frame does not fit, it waits for the next call.
        if line.put(waiting.line.bytes()).is_ok() {
            waiting.line.clear();
        }
        waiting.stop
    }
}

/// The thread's state: keeps the port open and writes to it.
struct Feeder {
    settings: Settings,
    header: Line,
    shared: Arc<Shared>,
    /// Whether the last frame was written only in part.
    is_partial: bool,
}

impl Feeder {
    /// Runs until asked to stop.
    fn run(mut self) {
        let mut back_off = BackOff::new(PAUSES);
        // The first failure is not logged: after a reload the former port may still be closing.
        let mut failures = 0_u32;
        loop {
            let path = self.settings.port.clone();
            match open(&self.settings) {
                Ok(mut port) => {
                    tracing::info!("serial port {path} is open");
                    if let Some(name) = stable_name(Path::new(&path), Path::new(STABLE_NAMES)) {
                        tracing::info!(
                            "serial port {path} will be reopened under its stable name {name}"
                        );
                        self.settings.port = name;
                    }
                    self.shared.lock().is_open = true;
                    let opened = Instant::now();
                    let end = self.write_frames(&mut *port);
                    self.shared.lock().is_open = false;
                    let Err(error) = end else { return };
                    let path = &self.settings.port;
                    tracing::warn!("serial port {path} is lost ({error}); it will be reopened");
                    failures = 2;
                    // A port that fails at once after opening keeps its growing pause.
                    if opened.elapsed() > PAUSES[1] {
                        back_off.reset();
                    }
                }
                Err(error) => {
                    failures = failures.saturating_add(1);
                    if failures == 2 {
                        tracing::warn!(
                            "serial port {path} cannot be opened ({error}); retrying every {} s",
                            PAUSES[1].as_secs()
                        );
                    }
                }
            }
            if self.shared.pause(back_off.pause()) {
                return;
            }
        }
    }

    /// Writes frames until asked to stop (`Ok`) or the port fails.
    fn write_frames(&mut self, port: &mut dyn Write) -> std::io::Result<()> {
        if self.is_partial {
            // Ends the partial frame at the receiver.
            let cobs = self.settings.style == Style::Cobs;
            self.write_paced(port, if cobs { &[0] } else { b"\r\n" })?;
        }
        let (header, mut line) = (self.header.clone(), Line::default());
        let mut header_sent: Option<Instant> = None;
        loop {
            if header_sent.is_none_or(|at| at.elapsed() >= HEADER_PERIOD) {
                self.write_paced(port, header.bytes())?;
                header_sent = Some(Instant::now());
            }
            let stop = self.shared.next_line(HEADER_PERIOD, &mut line);
            if !line.bytes().is_empty() {
                self.write_paced(port, line.bytes())?;
                self.shared.sent.fetch_add(1, Ordering::Relaxed);
            }
            if stop {
                return Ok(());
            }
        }
    }

    /// Writes all bytes and waits for the time they take on the line. Retries after a write timeout, so that no partial frame
    /// remains.
    ///
    /// # Errors
    /// If the port fails or accepts nothing for [`STALL_LIMIT`].
    fn write_paced(&mut self, port: &mut dyn Write, mut bytes: &[u8]) -> std::io::Result<()> {
        let start = Instant::now();
        let line_s = bytes.len() as f32 / budget::bytes_per_second(self.settings.baud);
        let mut progress = start;
        while !bytes.is_empty() {
            match port.write(bytes) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(taken) => {
                    bytes = &bytes[taken..];
                    self.is_partial = !bytes.is_empty();
                    progress = Instant::now();
                }
                Err(error) => match error.kind() {
                    ErrorKind::TimedOut | ErrorKind::Interrupted | ErrorKind::WouldBlock => {
                        let stops = self.shared.lock().stop;
                        let limit = if stops { END_STALL_LIMIT } else { STALL_LIMIT };
                        if progress.elapsed() > limit {
                            return Err(ErrorKind::TimedOut.into());
                        }
                    }
                    _ => return Err(error),
                },
            }
        }
        std::thread::sleep(Duration::from_secs_f32(line_s).saturating_sub(start.elapsed()));
        Ok(())
    }
}

/// Opens a device or connects to a serial server.
fn open(settings: &Settings) -> std::io::Result<Box<dyn Write>> {
    if let Some(server) = settings.port.strip_prefix("tcp:") {
        let address = server.to_socket_addrs()?.next();
        let address = address.ok_or(ErrorKind::AddrNotAvailable)?;
        let stream = TcpStream::connect_timeout(&address, CONNECT_TIMEOUT)?;
        stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
        stream.set_nodelay(true)?;
        return Ok(Box::new(stream));
    }
    let port = serialport::new(&settings.port, settings.baud).timeout(WRITE_TIMEOUT);
    // The system raises DTR when a port is first opened; the setting changes that only on request.
    let port = match settings.dtr {
        true => port.dtr_on_open(true),
        false => port.preserve_dtr_on_open(),
    };
    Ok(Box::new(port.open_native()?))
}

/// The link in the folder `names` to the device `path`; `None` if there is none or `path` is in the folder itself.
pub fn stable_name(path: &Path, names: &Path) -> Option<String> {
    if path.starts_with(names) {
        return None;
    }
    let device = path.canonicalize().ok()?;
    let links = std::fs::read_dir(names).ok()?;
    let links = links.filter_map(|link| Some(link.ok()?.path()));
    let leads_there = |link: &PathBuf| link.canonicalize().is_ok_and(|end| end == device);
    links.filter(leads_there).min()?.to_str().map(str::to_owned)
}

/// An output to a serial line, one face at a time.
pub struct Serial {
    encoder: Encoder,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Serial {
    /// Starts the thread. `units` are the names in the order of the weights.
    ///
    /// # Errors
    /// If an unknown unit is requested, the names do not fit a line, or no thread can be started; not if the port is absent.
    pub fn new(settings: &Settings, units: &[&str]) -> Result<Self, OutputError> {
        let (encoder, plan) = Encoder::with_plan(settings, units)?;
        log_limits(settings, units, &plan);
        let shared = Arc::<Shared>::default();
        let feeder = Feeder {
            settings: settings.clone(),
            header: encoder.header(),
            shared: Arc::clone(&shared),
            is_partial: false,
        };
        Ok(Self {
            encoder,
            shared,
            thread: Some(limits::start_thread("serial", move || feeder.run())?),
        })
    }
}

/// Logs omitted units and a reduced rate.
fn log_limits(settings: &Settings, units: &[&str], plan: &Plan) {
    let Settings { port, baud, .. } = settings;
    let name = |&unit: &usize| settings.view.name(units[unit]);
    let left_out: Vec<&str> = plan.left_out.iter().map(name).collect();
    if !left_out.is_empty() {
        let (kept, omitted) = (plan.units.len(), left_out.join(" "));
        let all = kept + left_out.len();
        tracing::warn!(
            "serial port {port} carries {kept} of {all} units at {baud} bit/s, omitting {omitted}"
        );
    }
    if plan.rate_hz < budget::FRAMES_HZ {
        tracing::warn!(
            "serial port {port} carries {:.1} frames per second of up to {} bytes at {baud} bit/s, each time the newest; the sensor delivers {}",
            plan.rate_hz,
            plan.frame_bytes,
            budget::FRAMES_HZ
        );
    }
}

impl Output for Serial {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        if let Some(line) = self.encoder.encode(report) {
            self.shared.queue_frame(line);
        }
        Ok(())
    }

    fn switch(&mut self, switch: &crate::gesture::Switch<'_>) {
        if crate::gesture::ENABLED {
            let (shared, encoder) = (&self.shared, &self.encoder);
            shared.queue_switch(|line| encoder.switch(switch, line));
        }
    }

    fn tally(&self) -> Tally {
        let load = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Tally {
            sent: load(&self.shared.sent),
            dropped: load(&self.shared.dropped),
            connected: self.shared.lock().is_open,
            not_numbers: self.encoder.face.weights.not_numbers,
            ..Tally::empty("serial")
        }
    }
}

impl Drop for Serial {
    /// Sends neutral and absent; the port has half a second to accept it.
    fn drop(&mut self) {
        self.shared.queue_frame(self.encoder.neutral());
        self.shared.lock().stop = true;
        self.shared.changed.notify_one();
        limits::join_or_abandon(&mut self.thread);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Takes so many bytes, then is gone.
    struct Failing(Vec<u8>, usize);

    impl Write for Failing {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            let taken = bytes.len().min(self.1 - self.0.len());
            self.0.extend_from_slice(&bytes[..taken]);
            match taken {
                0 => Err(ErrorKind::BrokenPipe.into()),
                _ => Ok(taken),
            }
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn what_was_cut_off_is_ended_before_anything_else_is_sent() {
        let mut header = Line::default();
        header.put(b"$AUH*00\r\n").unwrap();
        let mut feeder = Feeder {
            settings: Settings {
                baud: 4_000_000,
                ..Settings::default()
            },
            header,
            shared: Arc::default(),
            is_partial: false,
        };
        for (takes, expected) in [
            (4, &b"$AUH"[..]),
            (1, b"\r"),
            (11, b"\r\n$AUH*00\r\n"),
            (9, b"$AUH*00\r\n"),
        ] {
            let mut port = Failing(Vec::new(), takes);
            let mut frame = Line::default();
            frame.put(b"$AU").unwrap();
            feeder.shared.queue_frame(&frame);
            assert!(feeder.write_frames(&mut port).is_err());
            assert_eq!(port.0, expected);
        }
    }

    #[test]
    fn a_device_is_found_under_its_stable_name() {
        let folder = tempfile::tempdir().unwrap();
        let (names, device) = (folder.path().join("by-id"), folder.path().join("ttyUSB0"));
        std::fs::create_dir(&names).unwrap();
        std::fs::write(&device, "").unwrap();
        std::fs::write(folder.path().join("ttyUSB1"), "").unwrap();
        assert_eq!(stable_name(&device, &names), None);
        for (link, to) in [
            ("usb-B", "ttyUSB1"),
            ("usb-A", "ttyUSB0"),
            ("usb-C", "ttyUSB0"),
        ] {
            std::os::unix::fs::symlink(folder.path().join(to), names.join(link)).unwrap();
        }
        let stable = names.join("usb-A").to_str().unwrap().to_owned();
        assert_eq!(stable_name(&device, &names), Some(stable.clone()));
        assert_eq!(stable_name(Path::new(&stable), &names), None);
    }
}
