//! The virtual Kinect as a USB device on a socket: the device side of the usbredir protocol, for QEMU's `usb-redir`.
//!
//! One Unix socket per USB function. The camera's packets, commands and faults are the library's [`VirtualKinect`] and
//! [`Faulty`]; this file adds descriptors and the wire. Packets that carry nothing are not sent: a guest on an emulated
//! processor could not take 8000 a second. The device's clock slips rather than catch up.
//!
//! ```text
//! virtual-kinect --camera SOCKET [--motor SOCKET] [--audio SOCKET] [--model 1414|1473|1517] [--rate FPS]
//!     [--scene pattern|simulated|simulated:NAME] [--lost P] [--repeated P] [--damaged P] [--short P] [--bus-error P]
//!     [--clean-after FRAME] [--unplug-at FRAME] [--unplugged-for SECONDS] [--unpowered] [--no-streams]
//! ```
//! `--unpowered`: the camera never shows, as without 12 V. `--no-streams`: its descriptors have alternate setting 0 alone,
//! without endpoints.
//!
//! Prints one line `injected …` per stream when QEMU has gone.

use std::error::Error;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use mien::sensor::device::{Model, PacketSource, Stream};
use mien::sensor::faults::{Faulty, Rates};
use mien::sensor::virtual_kinect::{VirtualKinect, test_pattern};
use mien::sensor::{Frame, Source};

type Result<T> = std::result::Result<T, Box<dyn Error>>;
/// Fills the next frame; false when there is none.
type Scene = Box<dyn FnMut(&mut Frame) -> bool + Send>;
type Device = Faulty<VirtualKinect<Scene>>;

/// Message types of the protocol.
mod message {
    pub(crate) const HELLO: u32 = 0;
    pub(crate) const DEVICE_CONNECT: u32 = 1;
    pub(crate) const DEVICE_DISCONNECT: u32 = 2;
    pub(crate) const RESET: u32 = 3;
    pub(crate) const INTERFACE_INFO: u32 = 4;
    pub(crate) const EP_INFO: u32 = 5;
    pub(crate) const SET_CONFIGURATION: u32 = 6;
    pub(crate) const GET_CONFIGURATION: u32 = 7;
    pub(crate) const CONFIGURATION_STATUS: u32 = 8;
    pub(crate) const SET_ALT_SETTING: u32 = 9;
    pub(crate) const GET_ALT_SETTING: u32 = 10;
    pub(crate) const ALT_SETTING_STATUS: u32 = 11;
    pub(crate) const START_ISO_STREAM: u32 = 12;
    pub(crate) const STOP_ISO_STREAM: u32 = 13;
    pub(crate) const ISO_STREAM_STATUS: u32 = 14;
    pub(crate) const CANCEL_DATA_PACKET: u32 = 21;
    pub(crate) const CONTROL_PACKET: u32 = 100;
    pub(crate) const BULK_PACKET: u32 = 101;
    pub(crate) const ISO_PACKET: u32 = 102;
}

const STALL: u8 = 4;
const CANCELLED: u8 = 1;
const IO_ERROR: u8 = 3;
/// Device version in connect, packet sizes in ep_info, 64-bit ids, 32-bit bulk lengths.
const CAPABILITIES: u32 = 1 << 1 | 1 << 4 | 1 << 5 | 1 << 6;
const WIDE_IDS: u32 = 1 << 5;

#[derive(Clone, Copy, PartialEq)]
enum Function {
    Camera,
    Motor,
    Audio,
}

/// What enumeration shows of a function.
struct Descriptors {
    function: Function,
    model: Model,
    serial: String,
    /// A camera as it should be, with a setting that has the isochronous endpoints.
    streams: bool,
}

impl Descriptors {
    fn product(&self) -> (u16, u16) {
        match (self.function, self.model) {
            (Function::Camera, Model::Xbox1414) => (0x02ae, Model::FIRST_SERIES_RELEASE),
            (Function::Camera, Model::Xbox1473) => (0x02ae, 0x0114),
            (Function::Camera, Model::Windows1517) => (0x02bf, 0x0205),
            (Function::Motor, _) => (0x02b0, 0x0105),
            (Function::Audio, Model::Windows1517) => (0x02be, 0x0100),
            (Function::Audio, _) => (0x02ad, 0x0100),
        }
    }

    fn device(&self) -> Vec<u8> {
        let (product, release) = self.product();
        let class = if self.function == Function::Audio {
            255
        } else {
            0
        };
        let mut bytes = vec![18, 1, 0x00, 0x02, class, 0, 0, 64];
        bytes.extend(Model::VENDOR.to_le_bytes());
        bytes.extend(product.to_le_bytes());
        bytes.extend(release.to_le_bytes());
        bytes.extend([1, 2, 3, 1]);
        bytes
    }

    /// Endpoints of an alternate setting: address, attributes, packet size.
    fn endpoints(&self, alternate: u8) -> Vec<(u8, u8, u16)> {
        match self.function {
            Function::Camera if self.streams && alternate == self.model.alternate_setting() => {
                vec![(0x81, 1, 0x0bc0), (0x82, 1, 0x0bc0)]
            }
            Function::Audio => vec![(0x81, 2, 512), (0x01, 2, 512)],
            _ => vec![],
        }
    }

    fn configuration(&self) -> Vec<u8> {
        let last = match self.function {
            Function::Camera if self.streams => self.model.alternate_setting(),
            _ => 0,
        };
        let mut body = Vec::new();
        for alternate in 0..=last {
            let endpoints = self.endpoints(alternate);
            body.extend([9, 4, 0, alternate, endpoints.len() as u8, 255, 255, 255, 0]);
            for (address, attributes, size) in endpoints {
                let [low, high] = size.to_le_bytes();
                body.extend([7, 5, address, attributes, low, high, 1]);
            }
        }
        let [low, high] = (9 + body.len() as u16).to_le_bytes();
        let mut bytes = vec![9, 2, low, high, 1, 1, 0, 0xc0, 8];
        bytes.extend(body);
        bytes
    }

    fn string(&self, index: u8) -> Option<Vec<u8>> {
        let text = match (index, self.function) {
            (0, _) => return Some(vec![4, 3, 9, 4]),
            (1, _) => "Microsoft",
            (2, Function::Camera) => "Xbox NUI Camera",
            (2, Function::Motor) => "Xbox NUI Motor",
            (2, Function::Audio) => "Xbox NUI Audio",
            // The later models' cameras hide their serial.
            (3, Function::Camera) if self.model != Model::Xbox1414 => "0000000000000000",
            (3, _) => &self.serial,
            _ => return None,
        };
        let mut bytes = vec![2 + 2 * text.len() as u8, 3];
        bytes.extend(text.encode_utf16().flat_map(u16::to_le_bytes));
        Some(bytes)
    }

    /// Answer to a standard request that reads.
    fn answer(&self, request: u8, value: u16) -> Option<Vec<u8>> {
        match (request, value >> 8) {
            (6, 1) => Some(self.device()),
            (6, 2) => Some(self.configuration()),
            (6, 3) => self.string(value as u8),
            (6, 6) => Some(vec![10, 6, 0, 2, 0, 0, 0, 64, 1, 0]),
            (0, _) => Some(vec![1, 0]),
            _ => None,
        }
    }
}

/// One connection to QEMU.
struct Wire {
    socket: UnixStream,
    inbox: Vec<u8>,
    outbox: Vec<u8>,
    wide_ids: bool,
}

impl Wire {
    fn send(&mut self, kind: u32, id: u64, parts: &[&[u8]]) {
        let length: usize = parts.iter().map(|part| part.len()).sum();
        self.outbox.extend(kind.to_le_bytes());
        self.outbox.extend((length as u32).to_le_bytes());
        if self.wide_ids {
            self.outbox.extend(id.to_le_bytes());
        } else {
            self.outbox.extend((id as u32).to_le_bytes());
        }
        for part in parts {
            self.outbox.extend_from_slice(part);
        }
    }

    fn flush(&mut self) -> Result<()> {
        if !self.outbox.is_empty() {
            self.socket.write_all(&self.outbox)?;
            self.outbox.clear();
        }
        Ok(())
    }

    /// Reads for at most a millisecond. False when QEMU has gone.
    fn fill(&mut self) -> Result<bool> {
        let mut buffer = [0; 4096];
        match self.socket.read(&mut buffer) {
            Ok(0) => Ok(false),
            Ok(n) => {
                self.inbox.extend_from_slice(&buffer[..n]);
                Ok(true)
            }
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => Ok(true),
            Err(e) if e.kind() == ErrorKind::ConnectionReset => Ok(false),
            Err(e) => Err(e.into()),
        }
    }

    /// The next whole message: type, id, body.
    fn next(&mut self) -> Option<(u32, u64, Vec<u8>)> {
        let word = |at: usize| Some(u32::from_le_bytes(*self.inbox.get(at..)?.first_chunk()?));
        let (kind, length) = (word(0)?, word(4)? as usize);
        let wide = self.wide_ids && kind != message::HELLO;
        let header = if wide { 16 } else { 12 };
        if self.inbox.len() < header + length {
            return None;
        }
        let id = u64::from(word(8)?) | if wide { u64::from(word(12)?) << 32 } else { 0 };
        let body = self.inbox[header..header + length].to_vec();
        self.inbox.drain(..header + length);
        Some((kind, id, body))
    }
}

struct Session<'a> {
    wire: Wire,
    descriptors: &'a Descriptors,
    device: &'a Mutex<Device>,
    configuration: u8,
    alternate: u8,
    iso_id: u64,
}

impl Session<'_> {
    fn connect(&mut self) {
        self.alternate = 0;
        self.ep_info();
        self.interface_info();
        let (product, release) = self.descriptors.product();
        let mut body = vec![2, self.descriptors.device()[4], 0, 0];
        for field in [Model::VENDOR, product, release] {
            body.extend(field.to_le_bytes());
        }
        self.wire.send(message::DEVICE_CONNECT, 0, &[&body]);
    }

    fn ep_info(&mut self) {
        let mut kinds = [255u8; 32];
        let mut intervals = [0u8; 32];
        let mut sizes = [0u16; 32];
        for control in [0, 16] {
            (kinds[control], sizes[control]) = (0, 64);
        }
        for (address, attributes, size) in self.descriptors.endpoints(self.alternate) {
            let i = usize::from(address & 15) + usize::from(address >> 7) * 16;
            (kinds[i], intervals[i], sizes[i]) = (attributes, 1, size);
        }
        let sizes: Vec<u8> = sizes.iter().flat_map(|size| size.to_le_bytes()).collect();
        self.wire
            .send(message::EP_INFO, 0, &[&kinds, &intervals, &[0; 32], &sizes]);
    }

    fn interface_info(&mut self) {
        let mut classes = [0u8; 32];
        classes[0] = 255;
        self.wire.send(
            message::INTERFACE_INFO,
            0,
            &[&1u32.to_le_bytes(), &[0; 32], &classes, &classes, &classes],
        );
    }

    fn control(&mut self, id: u64, body: &[u8]) {
        let Some((head, data)) = body.split_first_chunk::<10>() else {
            return;
        };
        let [endpoint, request, kind, _, v0, v1, i0, i1, l0, l1] = *head;
        let value = u16::from_le_bytes([v0, v1]);
        let wanted = usize::from(u16::from_le_bytes([l0, l1]));
        let mut device = self.device.lock().expect("no holder panics");
        let answer: Option<Vec<u8>> = match (kind, self.descriptors.function) {
            (0x80..=0x82, _) => self.descriptors.answer(request, value),
            (0x00..=0x02, _) => Some(vec![]),
            (0x40, Function::Camera) => device.send(data).ok().map(|()| vec![]),
            (0xc0, Function::Camera) => {
                let mut reply = [0; 512];
                device.receive(&mut reply).ok().map(|n| reply[..n].to_vec())
            }
            (0x40, Function::Motor) => device.motor_write(request, value).ok().map(|()| vec![]),
            (0xc0, Function::Motor) => {
                let mut reply = [0; 64];
                device
                    .motor_read(request, &mut reply)
                    .ok()
                    .map(|n| reply[..n].to_vec())
            }
            _ => None,
        };
        drop(device);
        let (status, mut answer) = match answer {
            Some(answer) => (0, answer),
            None => (STALL, vec![]),
        };
        answer.truncate(wanted);
        let length = if kind & 0x80 != 0 {
            answer.len()
        } else {
            data.len()
        };
        let [l0, l1] = (length as u16).to_le_bytes();
        let head = [endpoint, request, kind, status, v0, v1, i0, i1, l0, l1];
        self.wire
            .send(message::CONTROL_PACKET, id, &[&head, &answer]);
    }

    fn handle(&mut self, kind: u32, id: u64, body: &[u8]) {
        let byte = |i: usize| body.get(i).copied().unwrap_or(0);
        let stream_of = |endpoint| {
            if endpoint == 0x81 {
                Stream::Colour
            } else {
                Stream::Depth
            }
        };
        match kind {
            message::SET_CONFIGURATION => {
                self.configuration = byte(0);
                self.ep_info();
                self.interface_info();
                self.wire.send(
                    message::CONFIGURATION_STATUS,
                    id,
                    &[&[0, self.configuration]],
                );
            }
            message::GET_CONFIGURATION => {
                self.wire.send(
                    message::CONFIGURATION_STATUS,
                    id,
                    &[&[0, self.configuration]],
                );
            }
            message::SET_ALT_SETTING => {
                self.alternate = byte(1);
                self.ep_info();
                self.wire.send(
                    message::ALT_SETTING_STATUS,
                    id,
                    &[&[0, byte(0), self.alternate]],
                );
            }
            message::GET_ALT_SETTING => {
                self.wire.send(
                    message::ALT_SETTING_STATUS,
                    id,
                    &[&[0, byte(0), self.alternate]],
                );
            }
            message::START_ISO_STREAM | message::STOP_ISO_STREAM => {
                let mut device = self.device.lock().expect("no holder panics");
                if kind == message::START_ISO_STREAM {
                    let _ = device.start(stream_of(byte(0)));
                } else {
                    device.stop(stream_of(byte(0)));
                }
                drop(device);
                self.wire
                    .send(message::ISO_STREAM_STATUS, id, &[&[0, byte(0)]]);
            }
            // A reset of the audio device, which some clients do, must not touch the camera.
            message::RESET if self.descriptors.function == Function::Camera => {
                let mut device = self.device.lock().expect("no holder panics");
                Stream::BOTH
                    .into_iter()
                    .for_each(|stream| device.stop(stream));
            }
            message::CONTROL_PACKET => self.control(id, body),
            message::CANCEL_DATA_PACKET => {
                let head = [0, 0, 0, CANCELLED, 0, 0, 0, 0, 0, 0];
                self.wire.send(message::CONTROL_PACKET, id, &[&head]);
            }
            message::BULK_PACKET => {
                let mut head = body[..body.len().min(10)].to_vec();
                head[1] = STALL;
                self.wire.send(message::BULK_PACKET, id, &[&head]);
            }
            _ => {}
        }
    }

    /// Sends what the camera says in the next millisecond.
    fn millisecond(&mut self) -> bool {
        let Self {
            wire,
            iso_id,
            device,
            ..
        } = self;
        let mut device = device.lock().expect("no holder panics");
        device
            .poll(Duration::from_millis(1), &mut |received| {
                let [l0, l1] = (received.bytes.len() as u16).to_le_bytes();
                let status = if received.intact { 0 } else { IO_ERROR };
                let head = [received.stream.endpoint(), status, l0, l1];
                wire.send(message::ISO_PACKET, *iso_id, &[&head, received.bytes]);
                *iso_id += 1;
            })
            .is_ok()
    }
}

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
        let frames = device.inner().player().frames();
        if frames >= clean_after {
            device.set_rates(Rates::default());
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
    let mut source = Source::simulated(name.strip_prefix("simulated:"))?;
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
    let kinect = VirtualKinect::new(model, "V1414", scene).with_period(period);
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
        serial: "A00366A08793039A".into(),
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
    let camera = device.inner().camera();
    println!(
        "frames {} light {}",
        device.inner().player().frames(),
        camera.light()
    );
    for stream in Stream::BOTH {
        let done = device.injected()[stream.index()];
        println!(
            "injected {stream:?}: lost {} repeated {} damaged {} short {} bus errors {}",
            done.lost, done.repeated, done.damaged, done.short, done.bus_errors
        );
    }
    result
}
