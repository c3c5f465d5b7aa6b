//! The streams of a camera: images, or depth maps and the images taken at the same time.
//!
//! A depth map is paired with an image whose driver timestamp differs by at most half a period of the faster stream. Images wait in the
//! driver's buffers until depth has caught up; the first one that is too late for a depth map is held for the next. A depth map waits at
//! most that half period for its image, and then becomes a frame without an image.

use core::time::Duration;
use std::sync::Arc;
use std::time::Instant;

use super::capture::{Capture, Taken};
use super::device::{CameraError, Device};
use crate::NO_DEPTH;
use crate::camera::Camera;
use crate::rgbd::calibration::Calibration;
use mien_stages::base::capacity::{CAMERA_BUFFERS, PIXELS};

/// Largest plausible lead of an image over depth; an image further ahead has another clock and is dropped.
const PLAUSIBLE: Duration = Duration::from_secs(1);

/// What follows from the size of a camera's images.
pub(super) struct Geometry {
    pub(super) camera: Camera,
    pub(super) luma_size: [usize; 2],
    pub(super) reduced: [usize; 2],
}

impl Geometry {
    pub(super) fn new(calibration: &Calibration) -> Self {
        let luma = calibration.colour.reduction();
        let depth = calibration.depth.as_ref();
        Self {
            camera: calibration.camera(),
            luma_size: luma.frame_size(),
            reduced: [
                depth.map_or(1, |depth| depth.reduction().factor),
                luma.factor,
            ],
        }
    }
}

/// The content of one frame.
pub(super) struct Image {
    pub(super) luma: Box<[u8; PIXELS]>,
    /// Time of the luma that has not been paired with a depth map yet.
    pub(super) held: Option<Duration>,
    /// Whether luma belongs to this depth map; always true without depth.
    pub(super) has_luma: bool,
    pub(super) depth: Option<Box<[u16; PIXELS]>>,
    /// Number of whole images before it.
    pub(super) number: u64,
    /// Its time on the driver's clock.
    pub(super) taken: Option<Duration>,
    /// When it was complete in this machine's memory.
    pub(super) arrived: Instant,
    pub(super) geometry: Option<Arc<Geometry>>,
}

impl Image {
    pub(super) fn new(has_depth: bool) -> Self {
        let depth = || vec![NO_DEPTH; PIXELS].try_into().expect("PIXELS long");
        Self {
            luma: vec![0; PIXELS].try_into().expect("PIXELS long"),
            held: None,
            has_luma: true,
            depth: has_depth.then(depth),
            number: 0,
            taken: None,
            arrived: Instant::now(),
            geometry: None,
        }
    }
}

/// The streams of a camera.
pub(super) struct Streams<D> {
    /// The stream that sets the frames: depth, or luma without depth.
    pub(super) frames: Capture<D>,
    /// Luma beside depth.
    luma: Option<Capture<D>>,
    pub(super) geometry: Arc<Geometry>,
    started: Instant,
}

impl<D: Device> Streams<D> {
    /// Streams luma alone, or depth and luma. Without a calibration a typical lens is assumed, the same for both.
    pub(super) fn new(
        frames: Capture<D>,
        luma: Option<Capture<D>>,
        calibration: Option<&Calibration>,
    ) -> Self {
        let (first, second) = (frames.choice(), luma.as_ref().unwrap_or(&frames).choice());
        let assumed = Calibration::assumed(first.is_depth().then_some(first.size), second.size);
        Self {
            frames,
            luma,
            geometry: Arc::new(Geometry::new(calibration.unwrap_or(&assumed))),
            started: Instant::now(),
        }
    }

    /// Waits at most `wait` for an image or a depth map; a depth map then waits for its luma.
    pub(super) fn take(&self, wait: Duration, into: &mut Image) -> Result<Taken, CameraError> {
        let Some(mut depth) = into.depth.take() else {
            let luma = &mut into.luma;
            return (self.frames).take(wait, |layout, bytes, _| layout.luma(bytes, luma));
        };
        let (camera, mut paired) = (&self.geometry.camera, Ok(false));
        // The buffers of a depth map and of its luma go back to the driver together. If the driver had a free buffer for one stream only
        // when the next images arrive, an overloaded computer would get images of different times, and seldom a pair.
        let taken = (self.frames).take(wait, |layout, bytes, at| {
            layout.depth(bytes, camera, &mut depth);
            paired = self.pair(at, into);
        });
        into.depth = Some(depth);
        into.has_luma = paired?;
        taken
    }

    /// Takes the luma that belongs to a depth map from the driver; returns whether there is one.
    fn pair(&self, at: Option<Duration>, into: &mut Image) -> Result<bool, CameraError> {
        let Some(capture) = &self.luma else {
            return Ok(false);
        };
        // Without timestamps of the driver, pairs are formed by time of arrival.
        let stamp = |at: Option<Duration>| at.unwrap_or_else(|| self.started.elapsed());
        let at = stamp(at);
        let half = self.frames.period().min(capture.period()) / 2;
        let until = Instant::now() + half;
        // At most as many images as the driver holds, so that the loop ends.
        for _ in 0..=CAMERA_BUFFERS {
            if let Some(held) = into.held {
                if held.abs_diff(at) <= half {
                    into.held = None;
                    return Ok(true);
                }
                if held > at && held - at < PLAUSIBLE {
                    return Ok(false);
                }
            }
            let (wait, luma) = (
                until.saturating_duration_since(Instant::now()),
                &mut into.luma,
            );
            match capture.take(wait, |layout, bytes, _| layout.luma(bytes, luma))? {
                Taken::Whole(at) => into.held = Some(stamp(at)),
                Taken::Damaged => {}
                Taken::Nothing => return Ok(false),
            }
        }
        Ok(false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v4l2::device::Filled;
    use crate::v4l2::format::Want;
    use crate::v4l2::scripted::{Script, whole};
    use std::path::Path;

    const COLUMNS: usize = 640;
    const WAIT: Duration = Duration::ZERO;

    fn depth_script() -> Script {
        // No depth at column 0, then 1000, 1001, … mm in every row.
        let row = (0..COLUMNS as u16).map(|col| if col == 0 { 0 } else { 999 + col });
        let row: Vec<u8> = row.flat_map(u16::to_le_bytes).collect();
        Script::of(b"Z16 ", row.repeat(480))
    }

    /// Infrared images, all of them of one value.
    fn luma_script() -> Script {
        Script::of(b"GREY", vec![50; COLUMNS * 480 * 2])
    }

    fn start(script: &Script, want: Want) -> Capture<Script> {
        Capture::start(script.clone(), Path::new("/dev/video0"), "card", want).unwrap()
    }

    struct Bench {
        depth: Script,
        luma: Script,
        streams: Streams<Script>,
        image: Image,
    }

    impl Bench {
        fn new() -> Self {
            let (depth, luma) = (depth_script(), luma_script());
            let captures = (start(&depth, Want::DEPTH), start(&luma, Want::INFRARED));
            Self {
                depth,
                luma,
                streams: Streams::new(captures.0, Some(captures.1), None),
                image: Image::new(true),
            }
        }

        /// For depth and luma taken at these times (ms), whether each depth map has luma.
        fn paired(&mut self, depth_ms: &[u64], luma_ms: &[u64]) -> Vec<bool> {
            let filled = |ms: &u64| Ok(whole(0, ms * 1000));
            self.depth.then(depth_ms.iter().map(filled));
            self.luma.then(luma_ms.iter().map(filled));
            let take = |ms: &u64| {
                let taken = self.streams.take(WAIT, &mut self.image).unwrap();
                assert_eq!(taken, Taken::Whole(Some(Duration::from_millis(*ms))));
                self.image.has_luma
            };
            depth_ms.iter().map(take).collect()
        }
    }

    #[test]
    fn depth_goes_with_the_image_of_its_time_at_most_half_a_period_away() {
        // Together; 16 ms before and after; 17 ms is too much.
        let mut bench = Bench::new();
        assert_eq!(bench.paired(&[1000, 1033], &[1000, 1033]), [true; 2]);
        assert_eq!(bench.paired(&[2000, 2033], &[1984, 2049]), [true; 2]);
        assert_eq!(bench.paired(&[3000], &[2983]), [false]);
        assert_eq!(bench.paired(&[4000], &[4017]), [false]);
    }

    #[test]
    fn images_lost_before_between_and_after_cost_only_their_own_depth() {
        let mut bench = Bench::new();
        // After a delay of the thread the whole queue is there: older images are skipped, and the one after a gap is held.
        let depth = [1000, 1033, 1066, 1100];
        let luma = [900, 933, 966, 1000, 1066, 1100];
        assert_eq!(bench.paired(&depth, &luma), [true, false, true, true]);
        assert!(bench.luma.coming.lock().unwrap().is_empty());
        // A depth map is lost: its image is skipped.
        assert_eq!(bench.paired(&[2066], &[2000, 2033, 2066]), [true]);
        // No images at all.
        assert_eq!(bench.paired(&[3000, 3033], &[]), [false; 2]);
    }

    #[test]
    fn a_stamp_of_another_clock_does_not_block_those_that_follow() {
        let mut bench = Bench::new();
        assert_eq!(bench.paired(&[1000], &[900_000]), [false]);
        assert_eq!(bench.paired(&[1033], &[1033]), [true]);
        // A driver that always has an old image is not read forever.
        let old = [5; 100];
        assert_eq!(bench.paired(&[2000], &old), [false]);
        let left = bench.luma.coming.lock().unwrap().len();
        assert_eq!(left, 100 - CAMERA_BUFFERS - 1);
    }

    #[test]
    fn a_driver_without_stamps_is_paired_by_arrival() {
        let mut bench = Bench::new();
        let unstamped = Filled {
            taken: None,
            ..whole(0, 0)
        };
        bench.depth.then([Ok(unstamped)]);
        bench.luma.then([Ok(unstamped)]);
        let taken = bench.streams.take(WAIT, &mut bench.image).unwrap();
        assert!(taken == Taken::Whole(None) && bench.image.has_luma);
    }

    #[test]
    fn damaged_images_are_skipped_and_a_node_that_goes_away_is_the_end() {
        let mut bench = Bench::new();
        let damaged = Filled {
            is_damaged: true,
            ..whole(0, 1_000_000)
        };
        bench.luma.then([Ok(damaged), Ok(whole(1, 1_000_000))]);
        assert_eq!(bench.paired(&[1000], &[]), [true]);
        assert_eq!(*bench.luma.queued.lock().unwrap(), [0, 1]);
        bench.luma.then([Err(libc::ENODEV)]);
        bench.depth.then([Ok(whole(0, 1_033_000))]);
        let problem = bench.streams.take(WAIT, &mut bench.image).unwrap_err();
        assert_eq!(problem, CameraError::Gone("/dev/video0".into()));
    }

    #[test]
    fn depth_is_given_back_to_the_driver_with_its_luma() {
        let (depth, mut luma) = (depth_script(), luma_script());
        luma.queued = Arc::clone(&depth.queued);
        depth.then([Ok(whole(0, 1_000_000))]);
        luma.then([Ok(whole(1, 1_000_000))]);
        let captures = (start(&depth, Want::DEPTH), start(&luma, Want::INFRARED));
        let streams = Streams::new(captures.0, Some(captures.1), None);
        streams.take(WAIT, &mut Image::new(true)).unwrap();
        assert_eq!(*depth.queued.lock().unwrap(), [1, 0]);
    }

    #[test]
    fn depth_is_in_millimetres_and_0_is_none() {
        let mut bench = Bench::new();
        bench.paired(&[1000], &[1000]);
        let depth = bench.image.depth.as_ref().unwrap();
        assert_eq!(depth[..3], [NO_DEPTH, 1000, 1001]);
        assert_eq!(depth[PIXELS - 1], 999 + 639);
        assert!(bench.image.luma.iter().all(|&luma| luma == 50));
        assert!((bench.streams.geometry.camera.depth_m(1500) - 1.5).abs() < 1e-6);
    }

    #[test]
    fn depth_alone_and_a_calibration_of_another_size_and_unit() {
        let view = r#"{"width": 848, "height": 480, "fx": 424, "fy": 424, "cx": 423.5, "cy": 239.5, "metres_per_unit": 0.0001}"#;
        let calibration = Calibration::parse(&format!(r#"{{"depth": {view}}}"#)).unwrap();
        let raw: Vec<u8> = (0..848 * 480_u32)
            .flat_map(|at| ((at % 848) as u16 * 10).to_le_bytes())
            .collect();
        let mut script = Script::of(b"Z16 ", raw);
        let want = Want::DEPTH.of_size(Some([848, 480]));
        let refused = Capture::start(script.clone(), Path::new("/dev/video0"), "card", want);
        let refused = refused.err().expect("another size").to_string();
        assert_eq!(
            refused,
            "the camera /dev/video0 does not give 848 x 480 pixels, the size in its calibration; write the numbers of a size that it gives"
        );
        script.formats[0].1 = [[640, 480], [848, 480]]
            .map(crate::v4l2::device::Sizes::one)
            .into();
        let streams = Streams::new(start(&script, want), None, Some(&calibration));
        let geometry = &streams.geometry;
        assert_eq!((geometry.luma_size, geometry.reduced), ([424, 240], [2; 2]));
        assert_eq!(geometry.camera.depth_size(), [424, 240]);
        script.then([Ok(Filled {
            used: 848 * 480 * 2,
            ..whole(0, 0)
        })]);
        let mut image = Image::new(true);
        streams.take(WAIT, &mut image).unwrap();
        assert!(!image.has_luma);
        // The second of two columns is taken; 0.3 m is the nearest distance.
        let depth = image.depth.as_ref().unwrap();
        assert_eq!(depth[148..152], [NO_DEPTH, NO_DEPTH, 3010, 3030]);
        assert_eq!(depth[423], 8470);
        assert_eq!(depth[424], NO_DEPTH);
        assert!((geometry.camera.depth_m(3010) - 0.301).abs() < 1e-6);
    }
}
