//! The virtual Kinect as a USB device on a socket: the device side of the usbredir protocol, for QEMU's `usb-redir`.
//!
//! One Unix socket per USB function. The camera's packets and commands are the library's [`VirtualKinect`], its faults
//! [`Faulty`]; here are descriptors and the wire. Packets that carry nothing are not sent: a guest on an emulated
//! processor could not take 8000 a second. The device's clock slips rather than catch up.
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

mod descriptors;
#[path = "../../common/faults.rs"]
mod faults;
mod session;
#[path = "../../common/test_pattern.rs"]
mod test_pattern;
mod wire;

use std::error::Error;
use std::os::unix::net::{UnixListener, UnixStream};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use mien_appliance::source;
use mien_sensors::kinect::device::{Model, PacketSource, Stream};
use mien_sensors::kinect::frame::KinectFrame;
use mien_simulator::virtual_kinect::VirtualKinect;

use descriptors::{Descriptors, Function};
use faults::{Faulty, Rates};
use session::Session;
use wire::{CAPABILITIES, WIDE_IDS, Wire, message};

type Result<T> = std::result::Result<T, Box<dyn Error>>;
/// Fills the next frame; false when there is none.
type Scene = Box<dyn FnMut(&mut KinectFrame) -> bool + Send>;
type Device = Faulty<VirtualKinect<Scene>>;
/// When the camera is pulled out and for how long.
#[derive(Clone, Copy)]
struct Unplug {
    at: u64,
    during: Duration,
}

fn serve(
    socket: UnixStream,
    descriptors: &Descriptors,
    device: &Mutex<Device>,
    unplug: &mut Option<Unplug>,
    clean_after: u64,
    powered: bool,
) -> Result<()> {
    socket.set_read_timeout(Some(Duration::from_millis(1)))?;
    let mut session = Session {
        wire: Wire {
            socket,
            inbox: Vec::new(),
            outbox: Vec::new(),
            wide_ids: false,
        },
        descriptors,
        device,
        configuration: 1,
        alternate: 0,
        iso_id: 0,
    };
    let mut version = [0; 64];
    version[..14].copy_from_slice(b"virtual kinect");
    session
        .wire
        .send(message::HELLO, 0, &[&version, &CAPABILITIES.to_le_bytes()]);
    session.wire.flush()?;
    let theirs = loop {
        if !session.wire.fill()? {
            return Ok(());
        }
        if let Some((message::HELLO, _, body)) = session.wire.next() {
            break body.get(64..68).map_or(0, |caps| {
                u32::from_le_bytes([caps[0], caps[1], caps[2], caps[3]])
            });
        }
    };
    session.wire.wide_ids = theirs & WIDE_IDS != 0;
    let mut due = Instant::now();
    let mut plug_in_at: Option<Instant> = None;
    if powered {
        session.connect();
    }
    loop {
        session.wire.flush()?;
        if !session.wire.fill()? {
            return Ok(());
        }
        while let Some((kind, id, body)) = session.wire.next() {
            session.handle(kind, id, &body);
        }
        if descriptors.function != Function::Camera || !powered {
            continue;
        }
        let now = Instant::now();
        if let Some(at) = plug_in_at {
            if now >= at {
                plug_in_at = None;
                session.connect();
            }
            continue;
        }
        // Late by more than this, the clock slips.
        due = due.max(now - Duration::from_millis(20));
        while due <= now {
            due += Duration::from_millis(1);
            if !session.millisecond() {
                session.wire.send(message::DEVICE_DISCONNECT, 0, &[]);
                session.wire.flush()?;
                std::thread::sleep(Duration::from_millis(500));
                return Ok(());
            }
        }
        let mut device = device.lock().expect("no holder panics");
        let frames = device.inner.player.frames;
        if frames >= clean_after {
            device.faults.rates = Rates::default();
        }
        if let Some(plan) = unplug.take_if(|plan| frames >= plan.at) {
            Stream::BOTH
                .into_iter()
                .for_each(|stream| device.stop(stream));
            session.wire.send(message::DEVICE_DISCONNECT, 0, &[]);
            plug_in_at = Some(now + plan.during);
            eprintln!("unplugged at frame {frames}");
        }
    }
}

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
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let option = |name: &str| {
        let at = arguments.iter().position(|argument| argument == name)?;
        arguments.get(at + 1).cloned()
    };
    let has = |name: &str| arguments.iter().any(|argument| argument == name);
    let number = |name: &str, default: f64| -> Result<f64> {
        Ok(option(name).map_or(Ok(default), |text| text.parse())?)
    };
    let model = match option("--model").as_deref() {
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
    let mut unplug = option("--unplug-at")
        .map(|at| -> Result<Unplug> {
            Ok(Unplug {
                at: at.parse()?,
                during: Duration::from_secs_f64(number("--unplugged-for", 2.0)?),
            })
        })
        .transpose()?;
    let scene = scene(option("--scene").as_deref().unwrap_or("pattern"))?;
    let mut kinect = VirtualKinect::new(model, "V1414", scene);
    kinect.player.period = period;
    let device = Arc::new(Mutex::new(Faulty::new(kinect, rates, 1)));

    for (name, function) in [("--motor", Function::Motor), ("--audio", Function::Audio)] {
        let Some(path) = option(name) else { continue };
        let listener = UnixListener::bind(path)?;
        let device = Arc::clone(&device);
        std::thread::spawn(move || {
            let descriptors = Descriptors {
                function,
                model,
                serial: "A22595W00862214A".into(),
                streams: false,
            };
            while let Ok((socket, _)) = listener.accept() {
                if let Err(e) = serve(socket, &descriptors, &device, &mut None, u64::MAX, true) {
                    eprintln!("{e}");
                }
            }
        });
    }
    let path = option("--camera").ok_or("--camera SOCKET is missing")?;
    let (socket, _) = UnixListener::bind(path)?.accept()?;
    let descriptors = Descriptors {
        function: Function::Camera,
        model,
        serial: option("--serial").unwrap_or_else(|| "A00366A08793039A".into()),
        streams: !has("--no-streams"),
    };
    let powered = !has("--unpowered");
    let result = serve(
        socket,
        &descriptors,
        &device,
        &mut unplug,
        clean_after,
        powered,
    );
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
