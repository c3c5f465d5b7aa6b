//! A webcam, or a depth camera like a RealSense D4xx, on a socket: a USB Video Class device for QEMU's `usb-redir`, to which the kernel's
//! `uvcvideo` binds.
//!
//! The depth camera has two functions, one for depth and one for infrared images of the same viewpoint. All streams that are on get an
//! image of every frame. A frame begins when its period is over, all images of the last one are sent, and the host has a transfer pending
//! on every stream.
//!
//! ```text
//! virtual-uvc --camera SOCKET [--depth] [--rate FPS] [--scene pattern|simulated[:NAME]] [--lost P]
//!     [--unplug-at FRAME] [--unplugged-for SECONDS] [--lie short-images|other-size|no-payload]
//! ```
//! `--lost`: share of the payloads that are not sent. `--lie short-images`: images have half of the negotiated bytes. `other-size`: the
//! smaller size is negotiated whatever the host asks for. `no-payload`: a payload size of 0 is negotiated.
//!
//! Prints `frames`, `payloads` and `lost` when QEMU has gone.

mod descriptors;
#[path = "../../common/test_pattern.rs"]
mod test_pattern;
#[path = "../usbredir/mod.rs"]
mod usbredir;

use std::collections::VecDeque;
use std::time::Duration;

use mien_appliance::source::{self, Source};
use mien_sensors::Frame;
use mien_stages::base::capacity::WIDTH;

use descriptors::{DEPTH, Format, INFRARED, PAYLOAD, SIZES, YUYV, endpoint};
use test_pattern::NEAREST_MM;
use usbredir::wire::Wire;
use usbredir::{Next, Options, Result, Setup, UsbDevice, serve};

/// Bytes of a payload's header: length and bit field.
const HEADER: usize = 2;
/// Bits of the header: frame ID (toggles with each image), end of frame, end of header.
const FRAME_ID: u8 = 1;
const END_OF_FRAME: u8 = 2;
const END_OF_HEADER: u8 = 0x80;
/// The request SET_CUR.
const SET: u8 = 1;
/// Control selectors: VS_PROBE_CONTROL negotiates the format, VS_COMMIT_CONTROL starts the stream.
const PROBE: u16 = 1;
const COMMIT: u16 = 2;

/// One function's stream.
struct Stream {
    format: Format,
    /// Number of the frame size in [`SIZES`].
    size: usize,
    is_on: bool,
    /// Transfers that the host waits for, and their lengths.
    transfers: VecDeque<(u64, usize)>,
    image: Vec<u8>,
    /// Bytes of the image that are sent or lost.
    sent: usize,
    frame_id: u8,
}

impl Stream {
    fn new(format: Format) -> Self {
        Self {
            format,
            size: 0,
            is_on: false,
            transfers: VecDeque::new(),
            image: Vec::new(),
            sent: 0,
            frame_id: 0,
        }
    }

    fn stop(&mut self) {
        (self.is_on, self.sent) = (false, 0);
        self.image.clear();
    }
}

struct Camera {
    streams: Vec<Stream>,
    /// The simulated sensor, if it is played, and its frame.
    scene: Option<(Source, Frame)>,
    frames: u64,
    period_ms: u64,
    /// Since the frame began.
    passed_ms: u64,
    lie: Option<String>,
    lost: f64,
    unplug: Option<(u64, Duration)>,
    random: fastrand::Rng,
    /// Payloads sent and lost.
    counts: [u64; 2],
}

impl Camera {
    fn lies(&self, how: &str) -> bool {
        self.lie.as_deref() == Some(how)
    }

    /// The luma and depth of the next frame, for the pixels of each size.
    fn next_frame(&mut self) -> [(Vec<u8>, Vec<u16>); 2] {
        let number = self.frames;
        self.frames += 1;
        let scene = &mut self.scene;
        if let Some((source, frame)) = scene {
            let _ = source.next_frame(frame);
        }
        SIZES.map(|size| {
            let [columns, rows] = size.map(usize::from);
            let (mut luma, mut depth) = (vec![0; columns * rows], vec![0; columns * rows]);
            match scene {
                None => {
                    test_pattern::draw_luma(number, &mut luma);
                    test_pattern::draw_depth(number, NEAREST_MM, &mut depth);
                }
                Some((source, frame)) => {
                    let camera = source.camera();
                    for (at, (luma, depth)) in luma.iter_mut().zip(&mut depth).enumerate() {
                        let (col, row) = (at % columns, at / columns);
                        let z_m = camera.depth_m(frame.depth[row * WIDTH + col]);
                        *depth = (z_m * 1000.0) as u16;
                        // The images have the viewpoint of depth; a pixel without depth is taken to be 2 m away.
                        let z_m = if z_m > 0.0 { z_m } else { 2.0 };
                        let point = camera.point(col as f32, row as f32, z_m);
                        let [col, row] = camera.colour_pixel(&point).map(|at| at.max(0.0) as usize);
                        let (col, row) =
                            (col.min(WIDTH - 1), row.min(frame.luma.len() / WIDTH - 1));
                        *luma = frame.luma[row * WIDTH + col];
                    }
                }
            }
            (luma, depth)
        })
    }

    /// Begins an image of every stream that is on.
    fn begin_frame(&mut self) {
        let images = self.next_frame();
        let is_short = self.lies("short-images");
        for stream in self.streams.iter_mut().filter(|stream| stream.is_on) {
            let (luma, depth) = &images[stream.size];
            stream.image = match stream.format {
                DEPTH => depth.iter().flat_map(|mm| mm.to_le_bytes()).collect(),
                YUYV => luma.iter().flat_map(|&luma| [luma, 128]).collect(),
                _ => luma.clone(),
            };
            if is_short {
                stream.image.truncate(stream.image.len() / 2);
            }
            stream.sent = 0;
            stream.frame_id ^= FRAME_ID;
        }
    }
}

impl UsbDevice for Camera {
    /// A product id for tests (pid.codes).
    fn ids(&self) -> [u16; 3] {
        [0x1209, 0x0010, 0x0100]
    }

    /// Miscellaneous device: interface association descriptors describe its functions.
    fn class(&self) -> [u8; 3] {
        [0xef, 2, 1]
    }

    fn configuration(&self) -> Vec<u8> {
        descriptors::configuration(self.streams.iter().map(|stream| stream.format))
    }

    fn string(&self, index: u8) -> Option<&str> {
        match index {
            1 => Some("mien"),
            2 if self.streams.len() > 1 => Some("Virtual Depth Camera"),
            2 => Some("Virtual Webcam"),
            3 => Some("1"),
            _ => None,
        }
    }

    fn request(&mut self, setup: &Setup, data: &[u8]) -> Option<Vec<u8>> {
        let [interface, selector] = [setup.index & 0xff, setup.value >> 8];
        let is_known = interface % 2 == 1 && matches!(selector, PROBE | COMMIT);
        let (other_size, no_payload) = (self.lies("other-size"), self.lies("no-payload"));
        let streams = &mut self.streams;
        let stream = streams
            .get_mut(usize::from(interface / 2))
            .filter(|_| is_known)?;
        match (setup.kind, setup.request) {
            (0x21, SET) => {
                let wanted = usize::from(*data.get(3)?).clamp(1, SIZES.len()) - 1;
                stream.size = if other_size { 1 } else { wanted };
                stream.is_on |= selector == COMMIT;
                Some(vec![])
            }
            (0xa1, _) => {
                let payload = if no_payload { 0 } else { PAYLOAD };
                Some(descriptors::negotiated(stream.format, stream.size, payload))
            }
            _ => None,
        }
    }

    fn millisecond(&mut self, wire: &mut Wire) -> Next {
        self.passed_ms += 1;
        let mut on = self.streams.iter().filter(|stream| stream.is_on).peekable();
        let is_due = self.passed_ms >= self.period_ms && on.peek().is_some();
        if is_due && on.all(|one| one.sent >= one.image.len() && !one.transfers.is_empty()) {
            self.passed_ms = 0;
            if let Some((_, during)) = self.unplug.take_if(|(at, _)| self.frames >= *at) {
                self.reset();
                return Next::Unplugged(during);
            }
            self.begin_frame();
        }
        for (number, stream) in self.streams.iter_mut().enumerate() {
            while stream.sent < stream.image.len() {
                let Some((id, length)) = stream.transfers.front().copied() else {
                    break;
                };
                let left = &stream.image[stream.sent..];
                let part = &left[..left.len().min(length.min(PAYLOAD) - HEADER)];
                let is_last = part.len() == left.len();
                let bits = stream.frame_id | END_OF_HEADER | if is_last { END_OF_FRAME } else { 0 };
                let is_lost = self.random.f64() < self.lost;
                self.counts[usize::from(is_lost)] += 1;
                stream.sent += part.len();
                if !is_lost {
                    let payload = [&[HEADER as u8, bits], part].concat();
                    wire.bulk(id, endpoint(number), 0, &payload);
                    stream.transfers.pop_front();
                }
            }
        }
        Next::Continues
    }

    fn reset(&mut self) {
        for stream in &mut self.streams {
            stream.stop();
            stream.transfers.clear();
        }
    }

    fn bulk(&mut self, address: u8, id: u64, length: usize) -> bool {
        let number = usize::from(address.wrapping_sub(endpoint(0)));
        let stream = self.streams.get_mut(number).filter(|_| length > HEADER);
        stream
            .map(|stream| stream.transfers.push_back((id, length)))
            .is_some()
    }

    fn cancel(&mut self, id: u64) -> Option<u8> {
        let mut streams = self.streams.iter_mut().enumerate();
        streams.find_map(|(number, stream)| {
            let at = stream.transfers.iter().position(|(one, _)| *one == id)?;
            stream.transfers.remove(at);
            Some(endpoint(number))
        })
    }

    fn clear_halt(&mut self, address: u8) {
        let number = usize::from(address.wrapping_sub(endpoint(0)));
        if let Some(stream) = self.streams.get_mut(number) {
            stream.stop();
        }
    }
}

fn main() -> Result<()> {
    let options = Options::of_process();
    let formats = match options.has("--depth") {
        true => &[DEPTH, INFRARED][..],
        false => &[YUYV],
    };
    let scene = match options.text("--scene").as_deref() {
        None | Some("pattern") => None,
        Some(name) => {
            let scene = name.strip_prefix("simulated:");
            Some((source::simulated(scene)?, Frame::default()))
        }
    };
    let mut camera = Camera {
        streams: formats.iter().map(|format| Stream::new(*format)).collect(),
        scene,
        frames: 0,
        period_ms: (1000.0 / options.number("--rate", 10.0)?) as u64,
        passed_ms: 0,
        lie: options.text("--lie"),
        lost: options.number("--lost", 0.0)?,
        unplug: options.unplug()?,
        random: fastrand::Rng::with_seed(1),
        counts: [0; 2],
    };
    let listener = options.listener("--camera")?;
    let (socket, _) = listener.ok_or("--camera SOCKET is missing")?.accept()?;
    let result = serve(socket, &mut camera);
    let [sent, lost] = camera.counts;
    println!("frames {} payloads {sent} lost {lost}", camera.frames);
    result
}
