//! The virtual Kinect's functions as USB devices: what enumeration shows of them, and the camera's packets and commands.

use std::sync::Mutex;
use std::time::Duration;

use mien_sensors::kinect::device::{Model, PacketSource, Request, Stream};
use mien_sensors::kinect::motor;

use crate::Device;
use crate::faults::Rates;
use crate::usbredir::wire::{IO_ERROR, Wire, message};
use crate::usbredir::{Next, Setup, UsbDevice};

#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Kind {
    Camera,
    Motor,
    Audio,
}

/// One function: a device of its own on the bus.
pub(crate) struct Function<'a> {
    pub(crate) kind: Kind,
    pub(crate) model: Model,
    pub(crate) serial: String,
    /// A camera as it should be, with a setting that has the isochronous endpoints.
    pub(crate) streams: bool,
    pub(crate) powered: bool,
    pub(crate) device: &'a Mutex<Device>,
    /// Frame from which there are no more faults.
    pub(crate) clean_after: u64,
    /// When the camera is pulled out and for how long.
    pub(crate) unplug: Option<(u64, Duration)>,
    pub(crate) iso_id: u64,
}

impl Function<'_> {
    /// Endpoints of an alternate setting: address, attributes, packet size.
    fn endpoints(&self, alternate: u8) -> Vec<(u8, u8, u16)> {
        match self.kind {
            Kind::Camera if self.streams && alternate == self.model.alternate_setting() => {
                vec![(0x81, 1, 0x0bc0), (0x82, 1, 0x0bc0)]
            }
            Kind::Audio => vec![(0x81, 2, 512), (0x01, 2, 512)],
            _ => vec![],
        }
    }
}

impl UsbDevice for Function<'_> {
    fn ids(&self) -> [u16; 3] {
        let (product, release) = match (self.kind, self.model) {
            (Kind::Camera, Model::Xbox1414) => (0x02ae, Model::FIRST_SERIES_RELEASE),
            (Kind::Camera, Model::Xbox1473) => (0x02ae, 0x0114),
            (Kind::Camera, Model::Windows1517) => (0x02bf, 0x0205),
            (Kind::Motor, _) => (0x02b0, 0x0105),
            (Kind::Audio, Model::Windows1517) => (0x02be, 0x0100),
            (Kind::Audio, _) => (0x02ad, 0x0100),
        };
        [Model::VENDOR, product, release]
    }

    fn class(&self) -> [u8; 3] {
        let class = if self.kind == Kind::Audio { 255 } else { 0 };
        [class, 0, 0]
    }

    fn configuration(&self) -> Vec<u8> {
        let last = match self.kind {
            Kind::Camera if self.streams => self.model.alternate_setting(),
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

    fn string(&self, index: u8) -> Option<&str> {
        Some(match (index, self.kind) {
            (1, _) => "Microsoft",
            (2, Kind::Camera) => "Xbox NUI Camera",
            (2, Kind::Motor) => "Xbox NUI Motor",
            (2, Kind::Audio) => "Xbox NUI Audio",
            // The later models' cameras hide their serial.
            (3, Kind::Camera) if self.model != Model::Xbox1414 => "0000000000000000",
            (3, _) => &self.serial,
            _ => return None,
        })
    }

    fn request(&mut self, setup: &Setup, data: &[u8]) -> Option<Vec<u8>> {
        let mut device = self.device.lock().expect("no holder panics");
        match (setup.kind, self.kind) {
            (0x40, Kind::Camera) => device.request(Request::Command(data)).ok().map(|_| vec![]),
            (0xc0, Kind::Camera) => {
                let mut reply = [0; 512];
                let n = device.request(Request::Reply(&mut reply));
                n.ok().map(|n| reply[..n].to_vec())
            }
            (0x40, Kind::Motor) => {
                let moved = device.request(Request::Motor(setup.request, setup.value));
                moved.ok().map(|_| vec![])
            }
            (0xc0, Kind::Motor) if setup.request == motor::STATE => {
                let mut state = [0; motor::STATE_BYTES];
                let n = device.request(Request::MotorState(&mut state));
                n.ok().map(|n| state[..n].to_vec())
            }
            // "Ready?", which is all else that its clients ask.
            (0xc0, Kind::Motor) => (setup.request == 0x10).then(|| vec![0x22]),
            _ => None,
        }
    }

    fn millisecond(&mut self, wire: &mut Wire) -> Next {
        if self.kind != Kind::Camera {
            return Next::Continues;
        }
        let iso_id = &mut self.iso_id;
        let mut device = self.device.lock().expect("no holder panics");
        let polled = device.poll(Duration::from_millis(1), &mut |received| {
            let [l0, l1] = (received.bytes.len() as u16).to_le_bytes();
            let status = if received.intact { 0 } else { IO_ERROR };
            let head = [received.stream.endpoint(), status, l0, l1];
            wire.send(message::ISO_PACKET, *iso_id, &[&head, received.bytes]);
            *iso_id += 1;
        });
        if polled.is_err() {
            return Next::Ended;
        }
        let frames = device.inner.player.frames;
        if frames >= self.clean_after {
            device.faults.rates = Rates::default();
        }
        drop(device);
        let Some((_, during)) = self.unplug.take_if(|(at, _)| frames >= *at) else {
            return Next::Continues;
        };
        self.reset();
        eprintln!("unplugged at frame {frames}");
        Next::Unplugged(during)
    }

    fn is_present(&self) -> bool {
        self.powered
    }

    fn reset(&mut self) {
        // A reset of the audio device, which some clients do, must not touch the camera.
        if self.kind == Kind::Camera {
            let mut device = self.device.lock().expect("no holder panics");
            Stream::BOTH
                .into_iter()
                .for_each(|stream| device.stop(stream));
        }
    }

    fn isochronous(&mut self, endpoint: u8, on: bool) {
        let stream = if endpoint == 0x81 {
            Stream::Colour
        } else {
            Stream::Depth
        };
        let mut device = self.device.lock().expect("no holder panics");
        if on {
            let _ = device.start(stream);
        } else {
            device.stop(stream);
        }
    }
}
