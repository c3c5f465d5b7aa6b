//! A camera for tests that answers as scripted, including what no correct driver would answer.

use core::time::Duration;
use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex};

use super::device::{About, Answer, Device, Filled, FourCc, Sizes};
use mien_stages::base::capacity::CAMERA_BUFFERS;

/// The script of a device; the same each time that it is opened.
#[derive(Clone)]
pub(super) struct Script {
    pub(super) about: About,
    pub(super) formats: Vec<(FourCc, Vec<Sizes>)>,
    /// The answer to any format that is set; `None` for a correct answer.
    pub(super) answer: Option<Answer>,
    /// Error number of `check_free`, and that of `start`.
    pub(super) taken_by: Option<i32>,
    pub(super) refuses: Option<i32>,
    /// Content of every buffer.
    pub(super) content: Vec<u8>,
    /// Number of bytes by which a buffer claims to be smaller than its content.
    pub(super) missing: usize,
    /// Filled buffers or error numbers, in order; no image comes after the last.
    pub(super) coming: Arc<Mutex<VecDeque<Result<Filled, i32>>>>,
    /// Buffers that were given back.
    pub(super) queued: Arc<Mutex<Vec<usize>>>,
}

/// One size.
pub(super) fn size(columns: u32, rows: u32) -> Sizes {
    Sizes::one([columns, rows])
}

/// A whole image of 640 × 480 in YUYV, taken at a time in microseconds.
pub(super) fn whole(index: usize, us: u64) -> Filled {
    Filled {
        index,
        used: 640 * 480 * 2,
        is_damaged: false,
        taken: Some(Duration::from_micros(us)),
    }
}

impl Script {
    /// A node of a depth camera with one format at 640 × 480.
    pub(super) fn of(code: &FourCc, content: Vec<u8>) -> Self {
        let mut script = Self::honest();
        script.about.card = "Depth Camera 435".into();
        script.formats = vec![(*code, vec![size(640, 480)])];
        script.content = content;
        script
    }

    /// A camera of 640 × 480 in YUYV, whose images have luma 0, 1, 2… from the left.
    pub(super) fn honest() -> Self {
        let row = (0..640).flat_map(|col| [(col % 256) as u8, 128]);
        let row: Vec<u8> = row.collect();
        Self {
            about: About {
                driver: "uvcvideo".into(),
                card: "HD Webcam C525".into(),
                bus: "usb-0000:00:14.0-1".into(),
                captures: true,
            },
            formats: vec![
                (*b"MJPG", vec![size(640, 480)]),
                (*b"YUYV", vec![size(640, 480)]),
            ],
            answer: None,
            taken_by: None,
            refuses: None,
            content: row.repeat(480),
            missing: 0,
            coming: Arc::default(),
            queued: Arc::default(),
        }
    }

    /// Appends filled buffers or error numbers.
    pub(super) fn then(&self, coming: impl IntoIterator<Item = Result<Filled, i32>>) {
        self.coming.lock().unwrap().extend(coming);
    }
}

fn refused(number: Option<i32>) -> io::Result<()> {
    number.map_or(Ok(()), |number| Err(io::Error::from_raw_os_error(number)))
}

fn listed<T: Copy>(list: &[T], index: u32) -> io::Result<T> {
    let found = list.get(index as usize).copied();
    found.ok_or_else(|| io::Error::from_raw_os_error(libc::EINVAL))
}

impl Device for Script {
    fn about(&self) -> io::Result<About> {
        Ok(self.about.clone())
    }

    fn format(&self, index: u32) -> io::Result<FourCc> {
        let codes: Vec<FourCc> = self.formats.iter().map(|format| format.0).collect();
        listed(&codes, index)
    }

    fn sizes(&self, code: FourCc, index: u32) -> io::Result<Sizes> {
        let format = self.formats.iter().find(|format| format.0 == code);
        listed(format.map_or(&[], |format| &format.1[..]), index)
    }

    fn check_free(&self) -> io::Result<()> {
        refused(self.taken_by)
    }

    fn set_format(&self, code: FourCc, size: [u32; 2]) -> io::Result<Answer> {
        let honest = Answer {
            code,
            size,
            stride: 0,
            whole: true,
        };
        Ok(self.answer.unwrap_or(honest))
    }

    fn set_rate(&self, per_s: u32) -> io::Result<f32> {
        Ok(per_s as f32)
    }

    fn start(&mut self) -> io::Result<usize> {
        refused(self.refuses)?;
        Ok(self.content.len() - self.missing)
    }

    fn wait(&self, wait: Duration) -> io::Result<bool> {
        let is_empty = self.coming.lock().unwrap().is_empty();
        if is_empty {
            std::thread::sleep(wait.min(Duration::from_millis(1)));
        }
        Ok(!is_empty)
    }

    fn take(&self) -> io::Result<Filled> {
        let next = self.coming.lock().unwrap().pop_front();
        next.unwrap_or(Err(libc::EAGAIN))
            .map_err(io::Error::from_raw_os_error)
    }

    fn bytes(&self, index: usize) -> &[u8] {
        if index < CAMERA_BUFFERS {
            &self.content
        } else {
            &[]
        }
    }

    fn queue(&self, index: usize) -> io::Result<()> {
        self.queued.lock().unwrap().push(index);
        Ok(())
    }
}
