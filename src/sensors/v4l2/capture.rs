//! A [`Device`] that streams: chooses and checks its format, and takes its images one by one.

use core::time::Duration;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::device::{CameraError, Device, Filled};
use super::format::{Choice, Layout, Want, choose};

/// Requested frame rate, frames per second.
const RATE: u32 = 30;
/// Frame rate below which quick expressions are missed, frames per second.
const SLOW: f32 = 20.0;

/// A streaming camera.
pub(super) struct Capture<D> {
    device: D,
    node: PathBuf,
    layout: Layout,
    period: Duration,
}

/// Result of waiting for an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Taken {
    /// No image came.
    Nothing,
    /// A damaged image came and was skipped.
    Damaged,
    /// A whole image came, with its time on the monotonic clock if the driver reports it.
    Whole(Option<Duration>),
}

impl<D: Device> Capture<D> {
    /// Starts the device of this node and name.
    pub(super) fn start(
        mut device: D,
        node: &Path,
        card: &str,
        want: Want,
    ) -> Result<Self, CameraError> {
        let at = |problem| CameraError::at(node, &problem);
        let asked = choose(&device, node, want)?;
        let size = asked.size.map(|pixels| pixels as u32);
        let answer = device.set_format(asked.format.code, size).map_err(at)?;
        let lies = |how| CameraError::Lies(node.to_owned(), how);
        let layout = Layout::new(want, asked, answer).map_err(lies)?;
        // Not every driver supports frame rates.
        let rate = device
            .set_rate(RATE)
            .ok()
            .filter(|rate| rate.is_finite() && *rate > 0.0);
        if device.start().map_err(at)? < layout.bytes {
            return Err(lies("shares less memory than an image takes"));
        }
        let named = rate.map_or(String::new(), |rate| format!(", {rate:.0} frames a second"));
        let (node, choice) = (node.to_owned(), layout.choice);
        tracing::info!(
            "streaming from the camera {} ({card}): {choice}{named}",
            node.display()
        );
        if rate.is_some_and(|rate| rate < SLOW) {
            tracing::warn!(
                "the camera gives less than {SLOW} frames a second: quick expressions are missed"
            );
        }
        Ok(Self {
            device,
            node,
            layout,
            period: Duration::from_secs_f32(1.0 / rate.unwrap_or(RATE as f32).max(1.0)),
        })
    }

    /// Its format and size.
    pub(super) fn choice(&self) -> Choice {
        self.layout.choice
    }

    /// Time from one image to the next; assumed if the driver does not report it.
    pub(super) fn period(&self) -> Duration {
        self.period
    }

    /// Its node.
    pub(super) fn node(&self) -> &Path {
        &self.node
    }

    /// Waits at most `wait` for an image, and calls `read` with its bytes and time if it is whole.
    pub(super) fn take(
        &self,
        wait: Duration,
        read: impl FnOnce(&Layout, &[u8], Option<Duration>),
    ) -> Result<Taken, CameraError> {
        let at = |problem| CameraError::at(&self.node, &problem);
        if !self.device.wait(wait).map_err(at)? {
            return Ok(Taken::Nothing);
        }
        let Filled {
            index,
            used,
            is_damaged,
            taken,
        } = match self.device.take() {
            Err(problem) if problem.kind() == ErrorKind::WouldBlock => return Ok(Taken::Nothing),
            filled => filled.map_err(at)?,
        };
        let bytes = self.device.bytes(index);
        // An image that is too short has lost packets, so its rows are displaced; one that claims to be longer than its buffer is
        // invalid.
        let whole = bytes
            .get(..used)
            .filter(|bytes| bytes.len() >= self.layout.bytes);
        let found = match whole.filter(|_| !is_damaged) {
            Some(bytes) => {
                read(&self.layout, bytes, taken);
                Taken::Whole(taken)
            }
            None => Taken::Damaged,
        };
        self.device.queue(index).map_err(at)?;
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v4l2::scripted::{Script, whole};

    const NODE: &str = "/dev/video0";

    fn start(script: &Script) -> Result<Capture<Script>, CameraError> {
        Capture::start(script.clone(), Path::new(NODE), "card", Want::LUMA)
    }

    #[test]
    fn damaged_images_are_skipped_and_every_buffer_is_given_back() {
        let script = Script::honest();
        let capture = start(&script).unwrap();
        let short = Filled {
            used: 640 * 480 * 2 - 1,
            ..whole(1, 0)
        };
        let long = Filled {
            used: usize::MAX,
            ..whole(2, 0)
        };
        let said = Filled {
            is_damaged: true,
            ..whole(3, 0)
        };
        let no_buffer = whole(7, 0);
        script.then([short, long, said, no_buffer, whole(0, 5)].map(Ok));
        let mut luma = crate::Frame::default().luma;
        let mut take = || {
            capture
                .take(Duration::ZERO, |layout, bytes, _| {
                    layout.luma(bytes, &mut luma)
                })
                .unwrap()
        };
        assert_eq!([(); 4].map(|()| take()), [Taken::Damaged; 4]);
        assert_eq!(take(), Taken::Whole(Some(Duration::from_micros(5))));
        assert_eq!(take(), Taken::Nothing);
        assert_eq!(luma[637..643], [125, 126, 127, 0, 1, 2]);
        assert_eq!(*script.queued.lock().unwrap(), [1, 2, 3, 7, 0]);
    }

    #[test]
    fn each_reason_not_to_start_is_a_sentence() {
        let refusing = |number| Script {
            refuses: Some(number),
            ..Script::honest()
        };
        let scant = Script {
            missing: 1,
            ..Script::honest()
        };
        for (script, expected) in [
            (
                refusing(libc::EBUSY),
                "the camera /dev/video0 is in use; stop the other program that reads it",
            ),
            (
                refusing(libc::EPERM),
                "no permission to open the camera /dev/video0; add the user to the group video and log in again",
            ),
            (
                refusing(libc::ENODEV),
                "the camera /dev/video0 was unplugged; plug it in again",
            ),
            (
                refusing(libc::ENOMEM),
                "the camera /dev/video0 fails (cannot allocate memory); unplug it and plug it in again",
            ),
            (
                scant,
                "the driver of the camera /dev/video0 shares less memory than an image takes; update the kernel or use another camera",
            ),
        ] {
            let problem = start(&script).err().expect("no start");
            assert_eq!(problem.to_string(), expected);
        }
    }

    #[test]
    fn an_unplugged_camera_is_told_from_one_that_fails() {
        let script = Script::honest();
        let capture = start(&script).unwrap();
        script.then([Err(libc::ENODEV), Err(libc::EIO)]);
        let mut luma = crate::Frame::default().luma;
        let mut take = || {
            capture
                .take(Duration::ZERO, |layout, bytes, _| {
                    layout.luma(bytes, &mut luma)
                })
                .unwrap_err()
        };
        assert_eq!(take(), CameraError::Gone(NODE.into()));
        assert!(matches!(take(), CameraError::Failed(..)));
    }
}
