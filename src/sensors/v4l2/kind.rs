//! Webcams as a kind of sensor.

use core::time::Duration;
use std::path::Path;

use super::device::CameraError;
use super::live::LiveCamera;
use super::nodes::{self, is_meant};
use crate::kinect::driver::Settings;
use crate::sensor::{Found, Missing, Opened, SensorError, SensorKind};

/// Longest wait for the first attempt to open a camera.
const FIRST_ATTEMPT: Duration = Duration::from_secs(10);

/// The row of webcams.
pub(crate) const KIND: SensorKind = SensorKind {
    name: "camera",
    title: "camera",
    open,
    list: || found(nodes::list()),
    missing: |wanted, found| {
        let meant = |found: &Found| is_meant(wanted, Path::new(&found.serial), &found.name);
        let other = || CameraError::Other(wanted.to_owned(), found.len()).to_string();
        (!found.iter().any(meant)).then(other)
    },
};

fn open(wanted: Option<&str>, _: Settings) -> Opened {
    let wanted = wanted.map(str::to_owned);
    let mut live = LiveCamera::new(move || nodes::open(wanted.as_deref()));
    let problem = live.wait_for_first_attempt(FIRST_ATTEMPT);
    (Box::new(live), problem.map(SensorError::new))
}

fn found(listed: Vec<Found>) -> Result<Vec<Found>, Missing> {
    match listed.is_empty() {
        true => Err(Missing {
            is_absent: true,
            text: CameraError::Absent.to_string(),
        }),
        false => Ok(listed),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_may_be_named_by_node_number_or_name() {
        let listed = Found {
            line: String::new(),
            serial: "/dev/video2".into(),
            name: "HD Webcam C525".into(),
            trouble: None,
        };
        let Ok(found) = found(vec![listed]) else {
            panic!("one camera");
        };
        for wanted in ["2", "/dev/video2", "webcam"] {
            assert_eq!((KIND.missing)(wanted, &found), None, "{wanted}");
        }
        assert_eq!(
            (KIND.missing)("3", &found).as_deref(),
            Some("no camera 3 among the 1 found; `mien devices` lists them")
        );
    }

    #[test]
    fn without_a_camera_the_remedy_is_named() {
        let missing = found(vec![]).err().expect("no camera");
        assert!(missing.is_absent && missing.text.contains("modprobe uvcvideo"));
    }

    /// Holds on any machine: whatever is or is not plugged in.
    #[test]
    fn a_camera_that_does_not_exist_is_waited_for() {
        let (mut sensor, problem) = open(Some("no such name"), Settings::default());
        let problem = problem.expect("no camera").to_string();
        assert!(problem.starts_with("no camera"), "{problem}");
        assert!(sensor.next_frame(&mut crate::Frame::default()).is_err());
    }
}
