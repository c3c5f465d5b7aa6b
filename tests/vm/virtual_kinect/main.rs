//! The virtual Kinect as a USB device on a socket, for QEMU's `usb-redir`.
//!
//! One Unix socket per USB function. The camera's packets and commands are the library's [`VirtualKinect`], its faults
//! [`Faulty`]. The descriptors are in [`function`], the protocol is in [`usbredir`]. Packets that carry nothing are not sent: a guest on an emulated
//! processor could not take 8000 a second. A device that is more than 20 ms late does not catch up the rest.
//!
//! ```text
//! virtual-kinect --camera SOCKET [--motor SOCKET] [--audio SOCKET] [--model 1414|1473|1517] [--rate FPS]
//!     [--scene pattern|simulated|simulated:NAME] [--lost P] [--repeated P] [--damaged P] [--short P] [--bus-error P]
//!     [--clean-after FRAME] [--unplug-at FRAME] [--unplugged-for SECONDS] [--unpowered] [--no-streams]
//!     [--serial SERIAL]
//! ```
//! `--unpowered`: the camera never shows, as without 12 V. `--no-streams`: its descriptors have alternate setting 0 alone,
//! without endpoints.
//!
//! Prints one line `injected …` per stream when QEMU has gone.

#[path = "../../common/faults.rs"]
mod faults;
mod function;
#[path = "../../common/test_pattern.rs"]
mod test_pattern;
#[path = "../usbredir/mod.rs"]
mod usbredir;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use mien_appliance::source;
use mien_sensors::kinect::device::{Model, Stream};
use mien_sensors::kinect::frame::KinectFrame;
use mien_simulator::virtual_kinect::VirtualKinect;

use faults::{Faulty, Rates};
use function::{Function, Kind};
use usbredir::{Options, Result, serve};

/// Fills the next frame; false when there is none.
type Scene = Box<dyn FnMut(&mut KinectFrame) -> bool + Send>;
type Device = Faulty<VirtualKinect<Scene>>;

/// The scene to play. A source that ends unplugs the camera.
fn scene(name: &str) -> Result<Scene> {
    if name == "pattern" {
        let mut number = 0;
        return Ok(Box::new(move |frame| {
            test_pattern::draw(number, frame);
            number += 1;
            true
        }));
    }
    let mut source = source::simulated(name.strip_prefix("simulated:"))?;
    Ok(Box::new(move |frame| {
        matches!(source.next_frame(frame), Ok(true))
    }))
}

fn main() -> Result<()> {
    let options = Options::of_process();
    let number = |name: &str, default: f64| options.number(name, default);
    let model = match options.text("--model").as_deref() {
        None | Some("1414") => Model::Xbox1414,
        Some("1473") => Model::Xbox1473,
        Some("1517") => Model::Windows1517,
        Some(other) => {
            return Err(format!("--model is {other}, expected 1414, 1473 or 1517").into());
        }
    };
    let rates = Rates {
        lost: number("--lost", 0.0)?,
        longest_run: number("--longest-run", 1.0)? as u8,
        repeated: number("--repeated", 0.0)?,
        damaged: number("--damaged", 0.0)?,
        short: number("--short", 0.0)?,
        bus_error: number("--bus-error", 0.0)?,
        stall: 0.0,
    };
    let period = Duration::from_secs_f64(1.0 / number("--rate", 10.0)?);
    let clean_after = number("--clean-after", f64::MAX)? as u64;
    let scene = scene(options.text("--scene").as_deref().unwrap_or("pattern"))?;
    let mut kinect = VirtualKinect::new(model, "V1414", scene);
    kinect.player.period = period;
    let device = Arc::new(Mutex::new(Faulty::new(kinect, rates, 1)));

    for (name, kind) in [("--motor", Kind::Motor), ("--audio", Kind::Audio)] {
        let Some(listener) = options.listener(name)? else {
            continue;
        };
        let device = Arc::clone(&device);
        std::thread::spawn(move || {
            let mut function = Function {
                kind,
                model,
                serial: "A22595W00862214A".into(),
                streams: false,
                powered: true,
                device: &device,
                clean_after: u64::MAX,
                unplug: None,
                iso_id: 0,
            };
            while let Ok((socket, _)) = listener.accept() {
                if let Err(e) = serve(socket, &mut function) {
                    eprintln!("{e}");
                }
            }
        });
    }
    let listener = options.listener("--camera")?;
    let (socket, _) = listener.ok_or("--camera SOCKET is missing")?.accept()?;
    let serial = options.text("--serial");
    let mut camera = Function {
        kind: Kind::Camera,
        model,
        serial: serial.unwrap_or_else(|| "A00366A08793039A".into()),
        streams: !options.has("--no-streams"),
        powered: !options.has("--unpowered"),
        device: &device,
        clean_after,
        unplug: options.unplug()?,
        iso_id: 0,
    };
    let result = serve(socket, &mut camera);
    let device = device.lock().expect("no holder panics");
    let camera = &device.inner.camera;
    println!(
        "frames {} light {}",
        device.inner.player.frames, camera.light
    );
    for stream in Stream::BOTH {
        let done = device.faults.injected[stream.index()];
        println!(
            "injected {stream:?}: lost {} repeated {} damaged {} short {} bus errors {}",
            done.lost, done.repeated, done.damaged, done.short, done.bus_errors
        );
    }
    result
}
