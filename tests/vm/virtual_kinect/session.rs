//! One function's side of a usbredir connection: what QEMU asks and what it is answered.

use std::sync::Mutex;
use std::time::Duration;

use mien_sensors::kinect::device::{Model, PacketSource, Request, Stream};
use mien_sensors::kinect::motor;

use crate::Device;
use crate::descriptors::{Descriptors, Function};
use crate::wire::{CANCELLED, IO_ERROR, STALL, Wire, message};

pub(crate) struct Session<'a> {
    pub(crate) wire: Wire,
    pub(crate) descriptors: &'a Descriptors,
    pub(crate) device: &'a Mutex<Device>,
    pub(crate) configuration: u8,
    pub(crate) alternate: u8,
    pub(crate) iso_id: u64,
}

impl Session<'_> {
    pub(crate) fn connect(&mut self) {
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

    pub(crate) fn ep_info(&mut self) {
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

    pub(crate) fn interface_info(&mut self) {
        let mut classes = [0u8; 32];
        classes[0] = 255;
        self.wire.send(
            message::INTERFACE_INFO,
            0,
            &[&1u32.to_le_bytes(), &[0; 32], &classes, &classes, &classes],
        );
    }

    pub(crate) fn control(&mut self, id: u64, body: &[u8]) {
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
            (0x40, Function::Camera) => device.request(Request::Command(data)).ok().map(|_| vec![]),
            (0xc0, Function::Camera) => {
                let mut reply = [0; 512];
                let n = device.request(Request::Reply(&mut reply));
                n.ok().map(|n| reply[..n].to_vec())
            }
            (0x40, Function::Motor) => {
                let moved = device.request(Request::Motor(request, value));
                moved.ok().map(|_| vec![])
            }
            (0xc0, Function::Motor) if request == motor::STATE => {
                let mut state = [0; motor::STATE_BYTES];
                let n = device.request(Request::MotorState(&mut state));
                n.ok().map(|n| state[..n].to_vec())
            }
            // "Ready?", which is all else that its clients ask.
            (0xc0, Function::Motor) => (request == 0x10).then(|| vec![0x22]),
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

    pub(crate) fn handle(&mut self, kind: u32, id: u64, body: &[u8]) {
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
    pub(crate) fn millisecond(&mut self) -> bool {
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
