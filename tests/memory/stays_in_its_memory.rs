//! Promise: what a run takes is taken before the first frame, fits its budgets, and stays the same whoever comes and goes.

use std::process::Stdio;
use std::time::Duration;

use mien_appliance::pipeline::Pipeline;
use mien_appliance::settings::Settings;
use mien_sensors::Frame;
use mien_sensors::kinect::geometry::nominal;
use mien_sensors::kinect::packet::LONGEST;
use mien_sensors::kinect::pairing::Pairing;
use mien_sensors::sensor::Opened;
use mien_sensors::table::SENSORS;
use mien_stages::base::capacity::{PACKETS, PIXELS, TRANSFERS, USERS, WAITING_FRAMES};
use mien_stages::face_model::{FaceModel, FaceTemplate};
use mien_stages::landmarks::Scratch;
use mien_stages::landmarks::face_search::FaceSearch;
use mien_stages::segment::Segmenter;

use crate::common::mien;
use crate::common::whole_run::{everything_on, has_wires, read_port, record};
use crate::{MEMORY, alone};

/// The memory of a run, part by part: all of it is allocated before the first frame and kept. Rows that depend on the face model
/// are bounds for the built-in one. Not in the table: `landmarks.method = "paper"` takes 1.5 MB more per person.
///
/// One frame: depth, luma.
const FRAME: usize = 921_600;
/// Regions, histogram, clouds of six heads.
const SEGMENT: usize = 312_400;
/// Search of faces in a whole picture: the finest level of the pyramid, its cells and their orientations.
const FACE_SEARCH: usize = 1_043_600;
/// Distances by raw value.
const CAMERA: usize = 8_192;
/// Orientation maps, features, of each of two threads: shared by all; the second is untouched until two are followed.
const LANDMARKS: usize = 668_496;
/// Shape modes, scales, biases; the update matrices stay in the binary.
const MODEL: usize = 180_000;
/// The standard head, prepared; four users and one candidate; the clouds of two heads looked for.
const PEOPLE: usize = 700_000 + (USERS + 1) * 259_000 + 2 * 24_200;
/// All stages: 5,846,184.
const STAGES: usize = FRAME + SEGMENT + FACE_SEARCH + CAMERA + 2 * LANDMARKS + MODEL + PEOPLE;
/// Of the live sensor, one picture per stream; a recording or the simulated sensor uses other buffers instead.
const PICTURES: usize = 729_600;
/// Frames in the ring or being unpacked, pictures being paired, pictures being assembled, transfers in flight or landed:
/// 3,901,440.
const SENSOR: usize = (WAITING_FRAMES + 2) * PICTURES + 2 * TRANSFERS * PACKETS * LONGEST;
/// Of a webcam: images in the ring, being read and being shown; distances by raw value, of which none is used.
const WEBCAM: usize = (WAITING_FRAMES + 1) * PIXELS + 40_004;
/// Of a depth camera: the same with depth of two bytes.
const DEPTH_CAMERA: usize = (WAITING_FRAMES + 1) * PIXELS * 3 + 40_004;
/// What the stages may take, and the sensor.
const BUDGET: usize = 8 << 20;
const _: () = assert!(STAGES <= BUDGET && SENSOR <= BUDGET && DEPTH_CAMERA <= BUDGET);

/// Resident set of `mien run`, bytes.
const RESIDENT: u64 = 16 << 20;
/// Threads of `mien run` without and with wires: WebSocket, the page and MQTT have one each.
const THREADS: [u64; 2] = [4, 4 + 3];

fn bytes_of<T>(make: impl FnOnce() -> T) -> (usize, T) {
    let before = MEMORY.bytes_in_use();
    let made = make();
    (MEMORY.bytes_in_use() - before + size_of::<T>(), made)
}

/// A camera that nobody has: what it takes is taken before it is found.
fn absent(name: &str) -> Opened {
    let kind = SENSORS.iter().find(|kind| kind.name == name);
    (kind.expect("a row").open)(Some("no such name"), &Default::default())
}

#[test]
fn every_row_of_the_table_is_what_is_taken() {
    let _alone = alone();
    let mut settings = Settings::default();
    settings.stages.second_core = true;
    let camera = nominal();
    let (model_bytes, model) = bytes_of(FaceModel::shipped);
    let (pipeline, _made) = bytes_of(|| Pipeline::new(&settings.stages, &camera, &model).unwrap());
    let people = pipeline - SEGMENT - FACE_SEARCH - CAMERA - 2 * LANDMARKS;
    let rows = [
        ("frame", bytes_of(Frame::default).0, FRAME),
        (
            "segment",
            bytes_of(|| Segmenter::new(settings.stages.segment)).0,
            SEGMENT,
        ),
        (
            "face search",
            bytes_of(|| FaceSearch::new(FaceTemplate::shipped())).0,
            FACE_SEARCH,
        ),
        ("camera", bytes_of(nominal).0, CAMERA),
        ("landmarks", bytes_of(Scratch::default).0, LANDMARKS),
        ("model", model_bytes, MODEL),
        ("anchor and people", people, PEOPLE),
        ("pairing", bytes_of(Pairing::default).0, PICTURES),
        ("webcam", bytes_of(|| absent("camera")).0, WEBCAM),
        (
            "depth camera",
            bytes_of(|| absent("depth-camera")).0,
            DEPTH_CAMERA,
        ),
    ];
    for (part, taken, row) in rows {
        println!("{part:<20}{taken:>10} of {row:>10}");
        // What a struct is besides its buffers: a few hundred bytes to the stack.
        assert!(taken <= row + 4096, "{part} takes {taken}, not {row}");
        assert!(taken * 10 >= row * 9, "{part} takes only {taken} of {row}");
    }
    println!("stages {}, sensor {}", STAGES, SENSOR);
}

/// The highest value of a line of `/proc/PID/status` until the process ends, for several lines.
fn watched<const N: usize>(mut child: std::process::Child, names: [&str; N]) -> [u64; N] {
    let path = format!("/proc/{}/status", child.id());
    let mut most = [0; N];
    while child.try_wait().unwrap().is_none() {
        let status = std::fs::read_to_string(&path).unwrap_or_default();
        for (most, name) in most.iter_mut().zip(names) {
            let line = status.lines().find_map(|line| line.strip_prefix(name));
            let value = line.and_then(|line| line.split_whitespace().next()?.parse().ok());
            *most = value.unwrap_or(0).max(*most);
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    assert!(child.wait().unwrap().success());
    most
}

#[test]
fn the_resident_set_and_the_threads_of_a_run_stay_in_their_budgets() {
    let _alone = alone();
    for scene in ["four", "swap"] {
        let folder = tempfile::tempdir().unwrap();
        let session = folder.path().join("session");
        record(&session, scene, 150);
        let port = read_port();
        let child = mien("run --fast --csv")
            .arg(folder.path().join("out.csv"))
            .arg("--source")
            .arg(&session)
            .arg("--config")
            .arg(everything_on(folder.path(), &port.name))
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let [kibibytes, threads] = watched(child, ["VmHWM:", "Threads:"]);
        println!("{scene}: {kibibytes} KiB resident at most, {threads} threads");
        assert!(kibibytes > 0 && kibibytes * 1024 <= RESIDENT);
        assert!((1..=THREADS[usize::from(has_wires())]).contains(&threads));
    }
}
