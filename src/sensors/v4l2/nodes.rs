//! The cameras of this machine: nodes `/dev/video*` that give images.
//!
//! A camera may have several nodes, of which one gives images. Nodes of the kernel's driver for the Kinect are left out: a Kinect is a
//! sensor of its own.

use std::io;
use std::path::{Path, PathBuf};

use super::capture::Capture;
use super::device::{CameraError, Device};
use super::format::choose;
use super::ioctl::Node;
use crate::sensor::Found;

/// What the kernel knows of nodes, readable by everyone.
const SYSFS: &str = "/sys/class/video4linux";
/// The kernel's driver for the Kinect.
const KINECT_DRIVER: &str = "kinect";

/// Whether a camera is meant by a number, a path (also a link such as `/dev/v4l/by-id/…`), or a part of its name.
pub(super) fn is_meant(wanted: &str, node: &Path, card: &str) -> bool {
    if wanted.bytes().all(|byte| byte.is_ascii_digit()) {
        return node.ends_with(format!("video{wanted}"));
    }
    if wanted.starts_with('/') {
        let linked = || std::fs::canonicalize(wanted).is_ok_and(|path| path == node);
        return node == Path::new(wanted) || linked();
    }
    card.to_lowercase().contains(&wanted.to_lowercase())
}

/// Nodes by number.
fn nodes() -> Vec<PathBuf> {
    let entries = std::fs::read_dir("/dev").into_iter().flatten().flatten();
    let numbers = entries.filter_map(|entry| {
        let name = entry.file_name();
        name.to_str()?.strip_prefix("video")?.parse().ok()
    });
    let mut numbers: Vec<u32> = numbers.collect();
    numbers.sort_unstable();
    let node = |number| PathBuf::from(format!("/dev/video{number}"));
    numbers.into_iter().map(node).collect()
}

/// Name of a camera, and the device or why it cannot be opened; `None` if the node is no camera's.
fn identify<D: Device>(
    node: &Path,
    opened: io::Result<D>,
) -> Option<(String, Result<D, CameraError>)> {
    match opened {
        Ok(device) => {
            let about = device.about().ok()?;
            let is_camera = about.captures && about.driver != KINECT_DRIVER;
            is_camera.then_some((about.card, Ok(device)))
        }
        Err(problem) => {
            let problem = CameraError::at(node, &problem);
            let folder = Path::new(SYSFS).join(node.file_name()?);
            let read = |file| std::fs::read_to_string(folder.join(file)).unwrap_or_default();
            // The first node of a webcam gives images, the others metadata.
            let is_first = matches!(read("index").trim(), "0" | "");
            let driver = std::fs::read_link(folder.join("device/driver"));
            let is_kinect = driver.is_ok_and(|driver| driver.ends_with(KINECT_DRIVER));
            let is_camera = is_first && !is_kinect && !matches!(problem, CameraError::Gone(_));
            is_camera.then(|| (read("name").trim().to_owned(), Err(problem)))
        }
    }
}

/// Every camera among these nodes.
fn listed<D: Device>(nodes: &[PathBuf], open: impl Fn(&Path) -> io::Result<D>) -> Vec<Found> {
    let found = nodes.iter().filter_map(|node| {
        let (name, device) = identify(node, open(node))?;
        let mut line = format!("camera:{} {name}", node.display());
        let tried = device.and_then(|device| {
            line += &format!(", {}", choose(&device, node)?);
            let free = device.check_free();
            free.map_err(|problem| CameraError::at(node, &problem))
        });
        Some(Found {
            line,
            serial: node.display().to_string(),
            name,
            trouble: tried.err().map(|trouble| trouble.to_string()),
        })
    });
    found.collect()
}

/// The camera that is meant, or the first one that starts.
fn started<D: Device>(
    wanted: Option<&str>,
    nodes: &[PathBuf],
    open: impl Fn(&Path) -> io::Result<D>,
) -> Result<Capture<D>, CameraError> {
    let (mut count, mut trouble) = (0, None);
    for node in nodes {
        let Some((card, device)) = identify(node, open(node)) else {
            continue;
        };
        count += 1;
        if wanted.is_some_and(|wanted| !is_meant(wanted, node, &card)) {
            continue;
        }
        match device.and_then(|device| Capture::start(device, node, &card)) {
            Ok(capture) => return Ok(capture),
            Err(problem) => trouble = trouble.or(Some(problem)),
        }
    }
    let none = || match wanted {
        Some(wanted) if count > 0 => CameraError::Other(wanted.to_owned(), count),
        _ => CameraError::Absent,
    };
    Err(trouble.unwrap_or_else(none))
}

/// The cameras of this machine.
pub(super) fn list() -> Vec<Found> {
    listed(&nodes(), Node::open)
}

/// Starts the camera that is meant, or the first usable one of this machine.
pub(super) fn open(wanted: Option<&str>) -> Result<Capture<Node>, CameraError> {
    started(wanted, &nodes(), Node::open)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v4l2::scripted::Script;

    /// Two nodes of a webcam, a Kinect, one that is forbidden, one in use, and one that is free.
    fn open(node: &Path) -> io::Result<Script> {
        let mut script = Script::honest();
        match node.to_str().unwrap_or_default() {
            "/dev/video900" => script.formats = vec![(*b"MJPG", vec![])],
            "/dev/video901" => script.about.captures = false,
            "/dev/video902" => script.about.driver = "kinect".into(),
            "/dev/video903" => return Err(io::Error::from_raw_os_error(libc::EACCES)),
            "/dev/video904" => {
                (script.taken_by, script.refuses) = (Some(libc::EBUSY), Some(libc::EBUSY));
            }
            "/dev/video905" => script.about.card = "Integrated Camera".into(),
            _ => return Err(io::Error::from_raw_os_error(libc::ENOENT)),
        }
        Ok(script)
    }

    fn nodes(numbers: core::ops::Range<u32>) -> Vec<PathBuf> {
        numbers
            .map(|number| format!("/dev/video{number}").into())
            .collect()
    }

    fn node_started(wanted: Option<&str>, nodes: &[PathBuf]) -> Result<PathBuf, CameraError> {
        started(wanted, nodes, open).map(|capture| capture.node().to_owned())
    }

    #[test]
    fn the_first_usable_camera_is_taken_else_the_first_reason_told() {
        let usable = Ok(PathBuf::from("/dev/video905"));
        assert_eq!(node_started(None, &nodes(900..907)), usable);
        for wanted in ["905", "/dev/video905", "integrated", "Camera"] {
            assert_eq!(
                node_started(Some(wanted), &nodes(900..907)),
                usable,
                "{wanted}"
            );
        }
        let node = |number: u32| PathBuf::from(format!("/dev/video{number}"));
        let first = node_started(None, &nodes(900..905));
        assert!(matches!(first, Err(CameraError::Format(at, ..)) if at == node(900)));
        let error = |wanted, range| node_started(wanted, &nodes(range)).unwrap_err();
        assert_eq!(error(Some("903"), 900..907), CameraError::Access(node(903)));
        assert_eq!(error(Some("904"), 900..907), CameraError::Busy(node(904)));
        assert_eq!(
            error(Some("90"), 900..907),
            CameraError::Other("90".into(), 4)
        );
        assert_eq!(error(None, 901..903), CameraError::Absent);
        assert_eq!(error(Some("c525"), 901..903), CameraError::Absent);
    }

    #[test]
    fn cameras_are_listed_with_their_trouble_and_other_nodes_are_not() {
        let listed = listed(&nodes(900..907), open);
        let rows: Vec<[&str; 2]> = listed
            .iter()
            .map(|found| [&*found.line, found.trouble.as_deref().unwrap_or_default()])
            .collect();
        let nodes = listed.iter().map(|found| found.serial.clone());
        let expected = [900, 903, 904, 905].map(|number| format!("/dev/video{number}"));
        assert!(nodes.eq(expected), "{rows:?}");
        assert!(rows[0][1].contains("gives only MJPG"), "{rows:?}");
        assert!(rows[1][1].contains("group video"), "{rows:?}");
        assert!(rows[2][1].contains("is in use"), "{rows:?}");
        let usable = "camera:/dev/video905 Integrated Camera, YUYV 640 x 480";
        assert_eq!(rows[3], [usable, ""]);
    }

    #[test]
    fn a_link_to_the_node_means_it() {
        let folder = std::env::temp_dir();
        let link = folder.join(format!("mien-camera-{}", std::process::id()));
        std::os::unix::fs::symlink("/dev/null", &link).unwrap();
        let wanted = link.to_str().unwrap();
        assert!(is_meant(wanted, Path::new("/dev/null"), ""));
        assert!(!is_meant(wanted, Path::new("/dev/zero"), ""));
        std::fs::remove_file(&link).unwrap();
    }
}
