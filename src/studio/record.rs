//! `mien-studio record`: a recording from the sensor or the simulator.

use std::fmt::{self, Display};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::recording::Recorder;
use mien_sensors::sensor::Sensor;
use mien_workbench::fault::Fault;
use mien_workbench::progress::Progress;

/// What is recorded.
#[derive(clap::Args)]
pub struct Args {
    /// Folder to write; mien and mien-studio play it with --source FOLDER
    #[arg(long)]
    pub out: PathBuf,
    /// Length in seconds; Ctrl-C ends the recording earlier and keeps it
    #[arg(long, default_value_t = 10.0)]
    pub seconds: f64,
    /// Where frames come from.
    #[arg(
        long,
        default_value = "auto",
        help = "kinect, simulated[:SCENE] or a folder; auto is a Kinect, or the simulator if none is plugged in"
    )]
    pub source: String,
}

/// Frames between checks of the disk.
const DISK_CHECK_EVERY: u64 = 15;

/// Result of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Recorded {
    /// Number of frames.
    pub frames: u64,
    /// Time from the first frame to the last, sensor time in seconds.
    pub seconds: f64,
    /// Size of its files.
    pub bytes: u64,
    /// Whether it was stopped early.
    pub stopped: bool,
}

impl Recorded {
    /// Frames per second.
    pub fn rate_hz(&self) -> f64 {
        if self.seconds > 0.0 {
            self.frames.saturating_sub(1) as f64 / self.seconds
        } else {
            0.0
        }
    }
}

impl Display for Recorded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kept = "; the recording so far is kept and can be played";
        let [before, after] = match self.stopped {
            true => ["stopped: ", kept],
            false => [""; 2],
        };
        let (seconds, hz, mb) = (self.seconds, self.rate_hz(), self.bytes as f64 / 1e6);
        write!(f, "{before}{seconds:.1} s at {hz:.1} Hz, {mb:.1} MB{after}")
    }
}

/// Records `seconds` of a source into a directory, or until `stop`. `started_unix_s` goes into the file names.
///
/// # Errors
/// If the directory cannot be written or the source fails.
pub fn record(
    source: &mut dyn Sensor,
    out: &Path,
    seconds: f64,
    started_unix_s: f64,
    stop: &AtomicBool,
) -> Result<Recorded, Fault> {
    let registration = source.registration().ok_or_else(|| {
        Fault::new("expected frames from a Kinect, found those of another camera; copy its recording instead")
    })?;
    let mut recorder = Recorder::create(out, registration, started_unix_s)?;
    if let Some(axes) = source.acceleration() {
        recorder.write_acceleration(axes)?;
    }
    let mut frame = KinectFrame::default();
    let progress = Progress::new("record", (seconds.max(0.0) * 30.0).ceil() as usize);
    let (mut done, mut first) = (Recorded::default(), None);
    while !stop.load(Ordering::Relaxed)
        && source.next_frame(&mut frame)?
        && (frame.at.as_us() as f64) < seconds * 1e6
    {
        recorder.write(&frame)?;
        let at = frame.at.as_us() as f64 * 1e-6;
        done.frames = recorder.frames();
        done.seconds = at - *first.get_or_insert(at);
        if done.frames % DISK_CHECK_EVERY == 0 {
            done.bytes = size(out);
        }
        progress.step_with(|| {
            let (mb, hz) = (done.bytes as f64 / 1e6, done.rate_hz());
            format!("{mb:.0} MB, {hz:.0} Hz")
        });
    }
    done.stopped = stop.load(Ordering::Relaxed);
    // Flushed here, so that it counts.
    drop(recorder);
    done.bytes = size(out);
    Ok(done)
}

/// Size of the files of a folder, bytes.
fn size(folder: &Path) -> u64 {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let sizes = files.filter_map(|file| Some(file.metadata().ok()?.len()));
    sizes.sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stopped_recording_is_kept_and_reported_as_stopped() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("session");
        let mut source = mien_appliance::source::simulated(None).unwrap();
        let whole = record(&mut *source, &out, 0.2, 1.7e9, &AtomicBool::new(false)).unwrap();
        assert!(whole.frames >= 5 && !whole.stopped, "{whole:?}");
        assert_eq!(whole.bytes, size(&out));
        assert!(whole.bytes > whole.frames * 300_000, "{whole:?}");
        assert!((whole.rate_hz() - 30.0).abs() < 1.0, "{whole:?}");
        let stopped = record(
            &mut *source,
            &folder.path().join("b"),
            9.0,
            1.7e9,
            &AtomicBool::new(true),
        );
        assert_eq!(
            stopped.unwrap(),
            Recorded {
                stopped: true,
                bytes: size(&folder.path().join("b")),
                ..Recorded::default()
            }
        );
    }
}
