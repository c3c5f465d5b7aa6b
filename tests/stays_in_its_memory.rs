//! Promise: what a run takes is taken before the first frame, fits its budgets, and stays the same whoever comes and goes.
//! By itself in its program, one test at a time: the allocator counts what any thread asks for.

use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use mien::budget;
use mien::cli::{CsvTarget, Run};
use mien::face_model::FaceModel;
use mien::landmarks::Scratch;
use mien::memory::Counting;
use mien::pipeline::Pipeline;
use mien::segment::Segmenter;
use mien::sensor::camera::{Camera, Registration};
use mien::sensor::pairing::{Pairing, RawPair};
use mien::sensor::recording::Recorder;
use mien::sensor::{Frame, Source};
use mien::settings::Settings;
use serialport::{SerialPort, TTYPort};

#[global_allocator]
static MEMORY: Counting = Counting::new();
static ALONE: Mutex<()> = Mutex::new(());

/// Resident set of `mien run`, bytes.
const RESIDENT: u64 = 16 << 20;
/// Threads of `mien run`.
const THREADS: u64 = 4;

fn bytes_of<T>(make: impl FnOnce() -> T) -> (usize, T) {
    let before = MEMORY.bytes_in_use();
    let made = make();
    (MEMORY.bytes_in_use() - before + size_of::<T>(), made)
}

#[test]
fn every_row_of_the_table_is_what_is_taken() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let settings = Settings::default();
    let registration = Registration::default();
    let (model_bytes, model) = bytes_of(FaceModel::shipped);
    let (pipeline, _made) = bytes_of(|| Pipeline::new(&settings, &registration, &model).unwrap());
    let people = pipeline - budget::SEGMENT - budget::CAMERA - budget::LANDMARKS;
    let rows = [
        ("frame", bytes_of(Frame::default).0, budget::FRAME),
        (
            "segment",
            bytes_of(|| Segmenter::new(settings.segment)).0,
            budget::SEGMENT,
        ),
        (
            "camera",
            bytes_of(|| Camera::new(&registration)).0,
            budget::CAMERA,
        ),
        ("landmarks", bytes_of(Scratch::default).0, budget::LANDMARKS),
        ("model", model_bytes, budget::MODEL),
        (
            "anchor and people",
            people,
            budget::ANCHOR + 5 * budget::PERSON,
        ),
        (
            "pairing",
            bytes_of(Pairing::default).0,
            budget::PICTURES - RawPair::BYTES,
        ),
    ];
    for (part, taken, row) in rows {
        println!("{part:<20}{taken:>10} of {row:>10}");
        // What a struct is besides its buffers: a few hundred bytes to the stack.
        assert!(taken <= row + 4096, "{part} takes {taken}, not {row}");
        assert!(taken * 10 >= row * 9, "{part} takes only {taken} of {row}");
    }
    println!("stages {}, sensor {}", budget::STAGES, budget::SENSOR);
}

/// Some seconds of people who come and go, as a recording.
fn record(folder: &Path, scene: &str, frames: u64) {
    let mut source = Source::simulated(Some(scene)).unwrap();
    let mut recorder = Recorder::create(folder, source.registration(), 1.0e9).unwrap();
    let mut frame = Frame::default();
    for _ in 0..frames {
        assert!(source.next_frame(&mut frame).unwrap());
        recorder.write(&frame).unwrap();
    }
}

/// A serial port whose other end is read, for as long as the test programme runs.
fn read_port() -> String {
    let (mut reader, port) = TTYPort::pair().unwrap();
    let name = port.name().unwrap();
    std::thread::spawn(move || {
        let _open = port;
        let mut bytes = [0; 4096];
        loop {
            // Nothing to read is no reason to stop.
            let _ = reader.read(&mut bytes);
        }
    });
    name
}

/// Every output there is, into this folder and to nobody.
fn everything_on(folder: &Path, serial: &str) -> std::path::PathBuf {
    let config = folder.join("mien.toml");
    let text = format!(
        "[osc]\ntarget = \"127.0.0.1:9\"\nranges = true\ncommands = true\nlisten = \"127.0.0.1:0\"\n\
         [vmc]\nenabled = true\ntarget = \"127.0.0.1:9\"\n\
         [vrchat]\nenabled = true\ntarget = \"127.0.0.1:9\"\n\
         [faceosc]\nenabled = true\ntarget = \"127.0.0.1:9\"\n\
         [serial]\nport = {serial:?}\nbaud = 921600\npose = true\n\
         [status]\npath = {:?}\n",
        folder.join("status.json")
    );
    std::fs::write(&config, text).unwrap();
    config
}

#[test]
fn four_people_and_every_output_ask_for_nothing_once_all_is_running() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("session");
    record(&session, "four", 240);
    let port = read_port();
    let csv = folder.path().join("out.csv");
    let run = Run {
        config: Some(everything_on(folder.path(), &port)),
        source: Some(session.to_str().unwrap().to_owned()),
        csv: Some(CsvTarget::File(csv.clone())),
        fast: true,
        ..Run::default()
    };
    // Length of the table and requests so far, in memory taken beforehand.
    let mut samples: Vec<(u64, u64)> = Vec::with_capacity(1 << 16);
    let thread = std::thread::spawn(move || mien::service::run(&run));
    while !thread.is_finished() && samples.len() < samples.capacity() {
        let length = std::fs::metadata(&csv).map_or(0, |file| file.len());
        samples.push((length, MEMORY.requests()));
        std::thread::sleep(Duration::from_millis(1));
    }
    thread.join().unwrap().unwrap();
    let whole = std::fs::metadata(&csv).unwrap().len();
    let at = |share: f64| {
        let part = (whole as f64 * share) as u64;
        samples.iter().find(|(length, _)| *length >= part).unwrap()
    };
    // The first frames are still alone with one person; what ends a run may ask again.
    let (start, end) = (at(0.05), at(0.95));
    println!("{} samples, from {start:?} to {end:?}", samples.len());
    assert!(end.0 > start.0);
    assert_eq!(start.1, end.1, "requests between 5 % and 95 % of the table");
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
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    for scene in ["four", "swap"] {
        let folder = tempfile::tempdir().unwrap();
        let session = folder.path().join("session");
        record(&session, scene, 150);
        let port = read_port();
        let child = Command::new(env!("CARGO_BIN_EXE_mien"))
            .args(["run", "--fast", "--csv"])
            .arg(folder.path().join("out.csv"))
            .arg("--source")
            .arg(&session)
            .arg("--config")
            .arg(everything_on(folder.path(), &port))
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let [kibibytes, threads] = watched(child, ["VmHWM:", "Threads:"]);
        println!("{scene}: {kibibytes} KiB resident at most, {threads} threads");
        assert!(kibibytes > 0 && kibibytes * 1024 <= RESIDENT);
        assert!((1..=THREADS).contains(&threads));
    }
}
