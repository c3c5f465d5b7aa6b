//! The cameras of this machine: the nodes `/dev/video*` that give images.
//!
//! A webcam may have several nodes, of which one gives images. A depth camera has a node for depth and, at the same address on the bus,
//! one for infrared images from the same viewpoint, one for colour, or both. Nodes of the kernel's Kinect driver are left out, because the
//! Kinect is a separate source.

use std::io;
use std::path::{Path, PathBuf};

use super::capture::Capture;
use super::device::Kind;
use super::device::{About, CameraError, Device, FourCc};
use super::format::{Want, choose, formats};
use super::ioctl::Node;
use super::streams::Streams;
use crate::rgbd::calibration::{Calibration, Intrinsics};
use crate::sensor::Found;

/// What the kernel tells about nodes, readable by everyone.
const SYSFS: &str = "/sys/class/video4linux";
/// The kernel's driver for the Kinect.
const KINECT_DRIVER: &str = "kinect";

/// Whether `wanted` selects a camera by a number, a path (also a link such as `/dev/v4l/by-id/…`), or a part of its name.
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

/// All nodes, sorted by number.
fn nodes() -> Vec<PathBuf> {
    let entries = std::fs::read_dir("/dev").into_iter().flatten().flatten();
    let numbers = entries.filter_map(|entry| {
        let name = entry.file_name();
        name.to_str()?.strip_prefix("video")?.parse().ok()
    });
    let mut sorted: Vec<u32> = Vec::new();
    for number in numbers {
        sorted.insert(sorted.partition_point(|other| *other < number), number);
    }
    let node = |number| PathBuf::from(format!("/dev/video{number}"));
    sorted.into_iter().map(node).collect()
}

/// A node that gives images.
struct Candidate<D> {
    node: PathBuf,
    card: String,
    bus: String,
    formats: Vec<FourCc>,
    /// The device, or why it cannot be opened.
    device: Result<D, CameraError>,
}

/// The streams of a camera and the format that each must have; the first one sets the frame rate.
type Camera<D> = Vec<(Candidate<D>, Want)>;

/// The candidate at a node; `None` if the node gives no images or is a Kinect's.
fn identify<D: Device>(node: &Path, opened: io::Result<D>) -> Option<Candidate<D>> {
    let (about, formats, device) = match opened {
        Ok(device) => {
            let about = device.about().ok()?;
            let is_camera = about.captures && about.driver != KINECT_DRIVER;
            (is_camera.then_some(about)?, formats(&device), Ok(device))
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
            let about = || About {
                card: read("name").trim().to_owned(),
                ..About::default()
            };
            (is_camera.then(about)?, Vec::new(), Err(problem))
        }
    };
    Some(Candidate {
        node: node.to_owned(),
        card: about.card,
        bus: about.bus,
        formats,
        device,
    })
}

/// The cameras of a kind among these nodes. The depth and infrared nodes of a depth camera are not webcams; its colour node is one.
fn cameras<D: Device>(
    kind: Kind,
    nodes: &[PathBuf],
    open: impl Fn(&Path) -> io::Result<D>,
    calibration: Option<&Calibration>,
) -> Vec<Camera<D>> {
    let all = nodes.iter().filter_map(|node| identify(node, open(node)));
    let (depths, mut others): (Vec<_>, Vec<_>) =
        all.partition(|one| Want::DEPTH.is_offered(&one.formats));
    if kind == Kind::Webcam {
        others.retain(|one| {
            let is_infrared = Want::INFRARED.is_offered(&one.formats);
            !(is_infrared && depths.iter().any(|depth| depth.bus == one.bus))
        });
        return (others.into_iter().map(|one| vec![(one, Want::LUMA)])).collect();
    }
    let depth_size = calibration.and_then(|of| of.depth.as_ref().map(Intrinsics::size));
    let luma_size = calibration.map(|of| of.colour.size());
    // A calibrated colour camera has another viewpoint than infrared, so it is used instead.
    let wants_infrared = calibration.is_none_or(|of| !of.has_colour);
    let with_luma = |depth: Candidate<D>| {
        let is_partner =
            |one: &Candidate<D>| one.bus == depth.bus && Want::LUMA.is_offered(&one.formats);
        let is_infrared = |one: &Candidate<D>| Want::INFRARED.is_offered(&one.formats);
        let partners = (0..others.len()).filter(|&at| is_partner(&others[at]));
        let best = partners.min_by_key(|&at| is_infrared(&others[at]) != wants_infrared);
        let mut camera = vec![(depth, Want::DEPTH.of_size(depth_size))];
        if let Some(partner) = best.map(|at| others.swap_remove(at)) {
            let is_infrared = wants_infrared && is_infrared(&partner);
            let want = if is_infrared {
                Want::INFRARED
            } else {
                Want::LUMA
            };
            camera.push((partner, want.of_size(luma_size)));
        }
        camera
    };
    depths.into_iter().map(with_luma).collect()
}

/// The description of a camera for `mien devices`.
fn found<D: Device>(kind: Kind, camera: &Camera<D>) -> Found {
    let (first, _) = &camera[0];
    let mut line = format!("{}:{} {}", kind.name(), first.node.display(), first.card);
    let mut trouble = None;
    for (number, (one, want)) in camera.iter().enumerate() {
        let tried = one
            .device
            .as_ref()
            .map_err(Clone::clone)
            .and_then(|device| {
                let choice = choose(device, &one.node, *want)?;
                line += &match number {
                    0 => format!(", {choice}"),
                    _ => format!(" with {choice} of {}", one.node.display()),
                };
                let free = device.check_free();
                free.map_err(|problem| CameraError::at(&one.node, &problem))
            });
        trouble = trouble.or(tried.err());
    }
    Found {
        line,
        serial: first.node.display().to_string(),
        name: first.card.clone(),
        trouble: trouble.map(|trouble| trouble.to_string()),
    }
}

/// Starts the camera that is selected, or else the first one that can be started.
fn start<D: Device>(
    kind: Kind,
    wanted: Option<&str>,
    cameras: Vec<Camera<D>>,
    calibration: Option<&Calibration>,
) -> Result<Streams<D>, CameraError> {
    let (count, mut trouble) = (cameras.len(), None);
    for camera in cameras {
        let (first, _) = &camera[0];
        if wanted.is_some_and(|wanted| !is_meant(wanted, &first.node, &first.card)) {
            continue;
        }
        let mut captures = camera
            .into_iter()
            .map(|(one, want)| Capture::start(one.device?, &one.node, &one.card, want));
        let frames = captures.next().unwrap_or_else(|| Err(kind.absent()));
        let both = frames.and_then(|frames| Ok((frames, captures.next().transpose()?)));
        match both {
            Ok((frames, luma)) => return Ok(Streams::new(frames, luma, calibration)),
            Err(problem) => trouble = trouble.or(Some(problem)),
        }
    }
    let none = || match wanted {
        Some(wanted) if count > 0 => CameraError::Other(wanted.to_owned(), count),
        _ => kind.absent(),
    };
    Err(trouble.unwrap_or_else(none))
}

/// The cameras of this machine.
pub(super) fn list(kind: Kind) -> Vec<Found> {
    let cameras = cameras(kind, &nodes(), Node::open, None);
    cameras.iter().map(|camera| found(kind, camera)).collect()
}

/// Starts the camera that is selected, or else the first usable one of this machine.
pub(super) fn open(
    kind: Kind,
    wanted: Option<&str>,
    calibration: Option<&Calibration>,
) -> Result<Streams<Node>, CameraError> {
    let cameras = cameras(kind, &nodes(), Node::open, calibration);
    start(kind, wanted, cameras, calibration)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v4l2::device::Sizes;
    use crate::v4l2::scripted::Script;

    /// Two nodes of a webcam, a Kinect, a node without permission, one in use, and one that is free.
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
        let cameras = cameras(Kind::Webcam, nodes, open, None);
        let streams = start(Kind::Webcam, wanted, cameras, None)?;
        Ok(streams.frames.node().to_owned())
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
        let cameras = cameras(Kind::Webcam, &nodes(900..907), open, None);
        let listed = cameras.iter().map(|camera| found(Kind::Webcam, camera));
        let listed: Vec<Found> = listed.collect();
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

    /// Three nodes of a depth camera, one of them for metadata, its colour camera, and a webcam elsewhere.
    fn open_depth(node: &Path) -> io::Result<Script> {
        let mut script = Script::honest();
        script.about.bus = "usb-0000:00:14.0-2".into();
        script.about.card = "RealSense 435".into();
        let both = [[640, 480], [1280, 720]].map(Sizes::one);
        let frame = &both[..1];
        let formats: &[(&FourCc, &[Sizes])] = match node.to_str().unwrap_or_default() {
            "/dev/video910" => &[(b"Z16 ", frame)],
            "/dev/video911" => {
                script.about.captures = false;
                &[]
            }
            "/dev/video912" => &[(b"GREY", frame), (b"UYVY", frame), (b"Y8I ", frame)],
            "/dev/video913" => &[(b"YUYV", &both)],
            _ => {
                script.about.bus = "usb-0000:00:14.0-7".into();
                script.about.card = "Webcam".into();
                &[(b"GREY", frame)]
            }
        };
        script.formats = formats
            .iter()
            .map(|(code, size)| (**code, size.to_vec()))
            .collect();
        Ok(script)
    }

    fn lines(kind: Kind, range: core::ops::Range<u32>, calibration: Option<&str>) -> Vec<String> {
        let calibration = calibration.map(|text| Calibration::parse(text).unwrap());
        let cameras = cameras(kind, &nodes(range), open_depth, calibration.as_ref());
        let lines = cameras.iter().map(|camera| found(kind, camera));
        lines
            .map(|found| found.line + &found.trouble.unwrap_or_default())
            .collect()
    }

    #[test]
    fn a_depth_camera_is_depth_with_the_infrared_images_of_the_same_device() {
        let infrared = "depth-camera:/dev/video910 RealSense 435, Z16 640 x 480 with GREY 640 x 480 of /dev/video912";
        assert_eq!(lines(Kind::Depth, 910..915, None), [infrared]);
        // Without infrared, depth is paired with the colour of the same device, never of another.
        let nodes = |numbers: &[u32]| -> Vec<PathBuf> {
            let node = |number| format!("/dev/video{number}").into();
            numbers.iter().map(node).collect()
        };
        for (numbers, partner) in [
            (&[914, 913, 910][..], Some("/dev/video913")),
            (&[914, 910], None),
        ] {
            let cameras = cameras(Kind::Depth, &nodes(numbers), open_depth, None);
            let partners = cameras[0][1..].iter().map(|(one, _)| one.node.to_str());
            assert!(partners.eq(partner.map(Some)), "{numbers:?}");
        }
        let view = r#"{"width": 640, "height": 480, "fx": 380, "fy": 380, "cx": 320, "cy": 240}"#;
        let depth = format!(r#"{{"depth": {view}}}"#);
        assert_eq!(lines(Kind::Depth, 910..915, Some(&depth)), [infrared]);
        let wide = view.replace("640", "1280").replace("480", "720");
        let both = format!(r#"{{"depth": {view}, "colour": {wide}}}"#);
        assert_eq!(
            lines(Kind::Depth, 910..915, Some(&both)),
            [
                "depth-camera:/dev/video910 RealSense 435, Z16 640 x 480 with YUYV 1280 x 720 reduced by 2 to 640 x 360 of /dev/video913"
            ]
        );
    }

    #[test]
    fn no_part_of_a_depth_camera_but_its_colour_is_a_webcam() {
        assert_eq!(
            lines(Kind::Webcam, 910..915, None),
            [
                "camera:/dev/video913 RealSense 435, YUYV 640 x 480",
                "camera:/dev/video914 Webcam, GREY 640 x 480"
            ]
        );
        assert!(lines(Kind::Depth, 911..915, None).is_empty());
    }

    #[test]
    fn a_depth_camera_starts_with_both_nodes_or_not_at_all() {
        let started = |wanted, taken: Option<u32>| {
            let open = |node: &Path| {
                let mut script = open_depth(node)?;
                let is_taken = taken.is_some_and(|taken| node.ends_with(format!("video{taken}")));
                script.refuses = is_taken.then_some(libc::EBUSY);
                Ok(script)
            };
            let cameras = cameras(Kind::Depth, &nodes(910..915), open, None);
            start(Kind::Depth, wanted, cameras, None).map(|streams| streams.frames.choice())
        };
        for wanted in [None, Some("910"), Some("realsense")] {
            assert!(started(wanted, None).unwrap().is_depth());
        }
        for taken in [910, 912] {
            let busy = CameraError::Busy(format!("/dev/video{taken}").into());
            assert_eq!(started(None, Some(taken)).unwrap_err(), busy);
        }
        let other = CameraError::Other("912".into(), 1);
        assert_eq!(started(Some("912"), None).unwrap_err(), other);
        let none = start::<Script>(Kind::Depth, Some("910"), Vec::new(), None);
        assert_eq!(none.err(), Some(CameraError::NoDepth));
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
