//! A run with everything on: a recording of people, a serial port that is read, a configuration with every output.
#![allow(unreachable_pub, reason = "each test program is a crate of its own")]

use std::io::Read;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use mien_appliance::source;
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::recording::Recorder;
use serialport::{SerialPort, TTYPort};

/// Some seconds of people who come and go, as a recording.
pub fn record(folder: &Path, scene: &str, frames: u64) {
    let mut source = source::simulated(Some(scene)).unwrap();
    let mut recorder =
        Recorder::create(folder, source.registration().expect("a Kinect"), 1.0e9).unwrap();
    let mut frame = KinectFrame::default();
    for _ in 0..frames {
        assert!(source.next_frame(&mut frame).unwrap());
        recorder.write(&frame).unwrap();
    }
}

/// A serial port whose other end is read until this is dropped.
pub struct ReadPort {
    pub name: String,
    done: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Drop for ReadPort {
    fn drop(&mut self) {
        self.done.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(std::thread::JoinHandle::join);
    }
}

/// A new serial port that is read.
pub fn read_port() -> ReadPort {
    let (mut reader, port) = TTYPort::pair().unwrap();
    let name = port.name().unwrap();
    let done = Arc::new(AtomicBool::new(false));
    let told = done.clone();
    let thread = std::thread::spawn(move || {
        let _open = port;
        let mut bytes = [0; 4096];
        while !told.load(Ordering::Relaxed) {
            // Nothing to read is no reason to stop.
            let _ = reader.read(&mut bytes);
        }
    });
    ReadPort {
        name,
        done,
        thread: Some(thread),
    }
}

/// Whether `mien` has the wires: not if a lean one takes its place.
pub fn has_wires() -> bool {
    cfg!(feature = "wires") && std::env::var_os("MIEN_LEAN").is_none()
}

/// What is a feature of the build, to nobody.
const WIRES: &str = "[live_link]\nenabled = true\ntarget = \"127.0.0.1:9\"\n\
    [websocket]\nenabled = true\nlisten = \"127.0.0.1:0\"\n\
    [page]\nenabled = true\nlisten = \"127.0.0.1:0\"\n\
    [mqtt]\nenabled = true\nbroker = \"127.0.0.1:9\"\n";

/// Gestures of everybody that go on and off all the time, and press keys of a file.
fn gestures(folder: &Path) -> String {
    let keys = folder.join("keys");
    std::fs::write(&keys, []).unwrap();
    let of = |name, person, press| {
        format!(
            "[[gesture]]\nname = \"{name}\"\nof = \"AU26 + AU12L - AU43L\"\non = 0.1\noff = 0.09\nhold_s = 0\n\
             pause_s = 0\nperson = \"{person}\"\nspeaking = true\nkey = \"space\"\npress = \"{press}\"\n"
        )
    };
    format!("[keys]\ndevice = {keys:?}\n") + &of("one", "each", "hold") + &of("two", "any", "tap")
}

/// Every output there is, into this folder and to nobody.
pub fn everything_on(folder: &Path, serial: &str) -> std::path::PathBuf {
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
    let more = if has_wires() {
        WIRES.to_owned() + &gestures(folder)
    } else {
        String::new()
    };
    std::fs::write(&config, text + &more).unwrap();
    config
}
