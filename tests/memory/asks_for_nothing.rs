//! Promise: four people and every output ask for no memory once all is running. A program without the usual harness: the
//! allocator counts what any thread asks for, and a harness has a thread of its own.

use std::time::Duration;

use mien_appliance::cli::Run;
use mien_appliance::memory::Counting;
use mien_sensors::kinect::device::DeviceError;
use mien_sensors::kinect::live::LiveKinect;
use mien_sensors::kinect::usb::UsbKinect;
use mien_sensors::sensor::Sensor;

#[path = "../common/whole_run.rs"]
mod whole_run;

use whole_run::{everything_on, read_port, record};

#[global_allocator]
static MEMORY: Counting = Counting::new();

#[expect(clippy::print_stdout, reason = "in the place of a harness")]
fn main() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("session");
    record(&session, "four", 240);
    let port = read_port();
    let csv = folder.path().join("out.csv");
    let run = Run {
        config: Some(everything_on(folder.path(), &port.name)),
        source: Some(session.to_str().unwrap().to_owned()),
        csv: Some(csv.clone()),
        fast: true,
        ..Run::default()
    };
    // Length of the table and requests so far, in memory taken beforehand.
    let mut samples: Vec<(u64, u64)> = Vec::with_capacity(1 << 16);
    let thread = std::thread::spawn(move || mien_appliance::run::run(&run));
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
    println!(
        "four_people_and_every_output_ask_for_nothing: {} samples, bytes of the table and requests from {start:?} to {end:?}",
        samples.len()
    );
    assert!(end.0 > start.0);
    assert_eq!(start.1, end.1, "requests between 5 % and 95 % of the table");
    a_kinects_state_asks_for_nothing();
}

/// The state is asked in every frame. The sensor's own thread may ask for memory in between, hence the least of several.
fn a_kinects_state_asks_for_nothing() {
    let open = || Err::<UsbKinect, _>(DeviceError::OtherSerial("A00366A08793039A".into(), 1));
    let mut live = LiveKinect::with_source(open, Default::default());
    assert!(
        live.wait_for_first_attempt(Duration::from_secs(10))
            .waiting_for
            .is_some()
    );
    let requests = (0..10).map(|_| {
        let before = MEMORY.requests();
        for _ in 0..100 {
            std::hint::black_box(live.state());
        }
        MEMORY.requests() - before
    });
    assert_eq!(requests.min(), Some(0), "requests of a hundred states");
}
