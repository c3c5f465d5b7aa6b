//! Webcams and depth cameras as kinds of sensors.

use core::time::Duration;
use std::path::Path;
use std::sync::Once;

use super::device::{CameraError, Kind};
use super::live::LiveCamera;
use super::nodes::{self, is_meant};
use crate::reduction::ASSUMED_VIEW_DEG;
use crate::rgbd::calibration::{CALIBRATION_MAX, Calibration};
use crate::sensor::{Found, Missing, Opened, SensorError, SensorKind};
use mien_stages::base::bounded_read::{read_regular, reason};

/// Longest wait for the first attempt to open a camera.
const FIRST_ATTEMPT: Duration = Duration::from_secs(10);

/// The table entry of webcams.
pub(crate) const WEBCAM: SensorKind = SensorKind {
    name: Kind::Webcam.name(),
    title: "camera",
    open: |wanted, _| open(Kind::Webcam, wanted, ""),
    list: || found(Kind::Webcam, nodes::list(Kind::Webcam)),
    missing,
};

/// The table entry of depth cameras.
pub(crate) const DEPTH_CAMERA: SensorKind = SensorKind {
    name: Kind::Depth.name(),
    title: "depth camera",
    open: |wanted, settings| open(Kind::Depth, wanted, &settings.calibration),
    list: || found(Kind::Depth, nodes::list(Kind::Depth)),
    missing,
};

/// Opens a camera; `calibration`: path of the file, empty for none.
fn open(kind: Kind, wanted: Option<&str>, calibration: &str) -> Opened {
    let (wanted, calibration) = (wanted.map(str::to_owned), calibration.to_owned());
    let open = move || {
        let calibration = read(Path::new(&calibration))?;
        let streams = nodes::open(kind, wanted.as_deref(), calibration.as_ref())?;
        if kind == Kind::Depth && calibration.is_none() {
            warn_of_assumed_lens();
        }
        Ok(streams)
    };
    let mut live = LiveCamera::new(kind == Kind::Depth, open);
    let problem = live.wait_for_first_attempt(FIRST_ATTEMPT);
    (Box::new(live), problem.map(SensorError::new))
}

/// Warns only once, not each time that the camera is plugged in.
fn warn_of_assumed_lens() {
    static WARNED: Once = Once::new();
    WARNED.call_once(|| {
        tracing::warn!("the depth camera has no calibration, so a field of view of {ASSUMED_VIEW_DEG} degrees and millimetres are assumed; write its numbers to a camera.json (docs/recordings.md) and its path to sensor.calibration for right distances");
    });
}

/// The calibration in a file; none for an empty path.
fn read(path: &Path) -> Result<Option<Calibration>, CameraError> {
    if path.as_os_str().is_empty() {
        return Ok(None);
    }
    let fails = |why| CameraError::Calibration(path.to_owned(), why);
    let bytes = read_regular(path, CALIBRATION_MAX).map_err(|problem| {
        fails(format!(
            "cannot be read ({}); correct sensor.calibration",
            reason(problem)
        ))
    })?;
    let calibration = Calibration::parse(&String::from_utf8_lossy(&bytes)).map_err(fails)?;
    match calibration.depth {
        Some(_) => Ok(Some(calibration)),
        None => Err(fails(
            "expected `depth`, found only `colour`; add the numbers of the depth camera".into(),
        )),
    }
}

fn found(kind: Kind, listed: Vec<Found>) -> Result<Vec<Found>, Missing> {
    match listed.is_empty() {
        true => Err(Missing {
            is_absent: true,
            text: kind.absent().to_string(),
        }),
        false => Ok(listed),
    }
}

/// The message that none of the cameras found is the one wanted; `None` if one is.
fn missing(wanted: &str, found: &[Found]) -> Option<String> {
    let meant = |found: &Found| is_meant(wanted, Path::new(&found.serial), &found.name);
    let other = || CameraError::Other(wanted.to_owned(), found.len()).to_string();
    (!found.iter().any(meant)).then(other)
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
        let Ok(found) = found(Kind::Webcam, vec![listed]) else {
            panic!("one camera");
        };
        for wanted in ["2", "/dev/video2", "webcam"] {
            assert_eq!(missing(wanted, &found), None, "{wanted}");
        }
        assert_eq!(
            missing("3", &found).as_deref(),
            Some("no camera 3 among the 1 found; `mien devices` lists them")
        );
    }

    #[test]
    fn without_a_camera_the_remedy_is_named() {
        for (kind, remedy) in [(Kind::Webcam, "modprobe uvcvideo"), (Kind::Depth, "Z16")] {
            let missing = found(kind, vec![]).err().expect("no camera");
            assert!(
                missing.is_absent && missing.text.contains(remedy),
                "{}",
                missing.text
            );
        }
    }

    #[test]
    fn a_calibration_is_read_again_until_it_can_be_used() {
        let folder = std::env::temp_dir();
        let path = folder.join(format!("mien-calibration-{}.json", std::process::id()));
        let problem = |path: &Path| read(path).err().expect("unusable").to_string();
        let missing = problem(&path);
        assert!(missing.contains("cannot be read") && missing.contains("sensor.calibration"));
        let view = r#"{"width": 848, "height": 480, "fx": 424, "fy": 424, "cx": 423, "cy": 239}"#;
        std::fs::write(&path, format!(r#"{{"colour": {view}}}"#)).unwrap();
        assert!(problem(&path).contains("expected `depth`"));
        std::fs::write(&path, format!(r#"{{"depth": {view}}}"#)).unwrap();
        let calibration = read(&path).unwrap().expect("one");
        assert!(!calibration.has_colour && calibration.colour.size() == [848, 480]);
        std::fs::remove_file(&path).unwrap();
        assert!(read(Path::new("")).unwrap().is_none());
    }

    /// This holds on any machine, whatever is plugged in.
    #[test]
    fn a_camera_that_does_not_exist_is_waited_for() {
        for kind in [Kind::Webcam, Kind::Depth] {
            let (mut sensor, problem) = open(kind, Some("no such name"), "");
            let problem = problem.expect("no camera").to_string();
            assert!(problem.starts_with("no "), "{problem}");
            assert!(sensor.next_frame(&mut crate::Frame::default()).is_err());
        }
    }
}
