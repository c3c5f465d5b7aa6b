//! The public data sets of `docs/data.md`, below `MIEN_DATA` or else `../shared/data`.
//!
//! A test names the sets that it reads and gets their folders, nothing above them. Where one is missing the test is left
//! out: it passes, and the last lines of `cargo test` count it (`tests/left_out.rs`). Under `MIEN_NEEDS_ALL`, which CI sets
//! where it has the data, it fails instead.

use std::io::Write;
use std::path::{Path, PathBuf};

/// A data set, by the name of its folder.
#[derive(Clone, Copy)]
#[allow(dead_code, reason = "each test program reads some of them")]
pub(crate) enum Set {
    CanonicalFace,
    FaceMocap41,
    FacesFrl189,
    FacesYtfaces68,
    HeadFacecap,
    HeadVitruvian,
    HeadsMakehuman,
    IctFacekit,
    KinectV1Desk,
    KinectV1Film,
    KinectV1Pcl,
    KinectV2Faces,
    NrsfmBench,
    VideoTalkingface,
}

impl Set {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::CanonicalFace => "canonical_face",
            Self::FaceMocap41 => "face_mocap41",
            Self::FacesFrl189 => "faces_frl189",
            Self::FacesYtfaces68 => "faces_ytfaces68",
            Self::HeadFacecap => "head_facecap",
            Self::HeadVitruvian => "head_vitruvian",
            Self::HeadsMakehuman => "heads_makehuman",
            Self::IctFacekit => "ict_facekit",
            Self::KinectV1Desk => "kinect_v1_desk",
            Self::KinectV1Film => "kinect_v1_film",
            Self::KinectV1Pcl => "kinect_v1_pcl",
            Self::KinectV2Faces => "kinect_v2_faces",
            Self::NrsfmBench => "nrsfm_bench",
            Self::VideoTalkingface => "video_talkingface",
        }
    }
}

/// The root of the checkout.
#[allow(dead_code, reason = "some test programs need no file of it")]
pub(crate) fn root() -> PathBuf {
    let mut folders = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors();
    let root = folders.find(|folder| folder.join("Cargo.lock").is_file());
    root.expect("a lock file").to_owned()
}

/// The folder of one set. `None` where it is missing: the test is left out and returns.
pub(crate) fn folder(set: Set) -> Option<PathBuf> {
    let all =
        std::env::var_os("MIEN_DATA").map_or_else(|| root().join("../shared/data"), PathBuf::from);
    let folder = all.join(set.name());
    if !folder.is_dir() {
        leave_out(set.name());
        return None;
    }
    Some(folder.canonicalize().expect("a folder that is there"))
}

/// A temporary folder that links to the named sets alone, for code that takes the folder of all sets.
pub(crate) fn only<const N: usize>(sets: [Set; N]) -> Option<tempfile::TempDir> {
    const { assert!(N > 0, "name the sets that the test reads") };
    let links = tempfile::tempdir().expect("a temporary folder");
    for set in sets {
        let link = links.path().join(set.name());
        std::os::unix::fs::symlink(folder(set)?, link).expect("a link to a data set");
    }
    Some(links)
}

/// Counts the running test as left out because `wanted` is missing here.
///
/// # Panics
/// Under `MIEN_NEEDS_ALL`.
pub(crate) fn leave_out(wanted: &str) {
    let needed = std::env::var_os("MIEN_NEEDS_ALL").is_some();
    assert!(
        !needed,
        "MIEN_NEEDS_ALL is set and {wanted} is missing; docs/data.md says where it is"
    );
    let thread = std::thread::current();
    let line = format!("{wanted}\t{}\n", thread.name().unwrap_or("a test"));
    print!("left out for want of {line}");
    let mut options = std::fs::OpenOptions::new();
    let file = options.create(true).append(true).open(left_out_list());
    file.and_then(|mut file| file.write_all(line.as_bytes()))
        .expect("the list of tests left out can be written");
}

/// The list of tests left out by this run of `cargo test`: a line `wanted<TAB>test` each. It is named by the process
/// number of `cargo`, the parent of every test program, because nothing else lasts from the first program to the last.
pub(crate) fn left_out_list() -> PathBuf {
    let program = std::env::current_exe().expect("a test program has a path");
    let folder = program
        .ancestors()
        .nth(3)
        .expect("target/debug/deps")
        .join("tmp/left-out");
    std::fs::create_dir_all(&folder).expect("the target folder can be written");
    folder.join(std::os::unix::process::parent_id().to_string())
}
