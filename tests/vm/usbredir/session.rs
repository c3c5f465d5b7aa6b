//! A device's side of a usbredir connection: QEMU's requests and the answers to them.

use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use super::wire::{CANCELLED, CAPABILITIES, STALL, WIDE_IDS, Wire, message};
use super::{Next, Result, Setup, UsbDevice};

/// Descriptor types.
const INTERFACE: u8 = 4;
const ENDPOINT: u8 = 5;

struct Session<'a, D> {
    wire: Wire,
    device: &'a mut D,
    configuration: u8,
    alternate: u8,
}

/// Plays `device` on a socket until QEMU has gone or the device has ended. A device that is more
/// than 20 ms late does not catch up the rest.
pub(crate) fn serve(socket: UnixStream, device: &mut impl UsbDevice) -> Result<()> {
    socket.set_read_timeout(Some(Duration::from_millis(1)))?;
    let mut session = Session {
        wire: Wire {
            socket,
            inbox: Vec::new(),
            outbox: Vec::new(),
            wide_ids: false,
        },
        device,
        configuration: 1,
        alternate: 0,
    };
    let mut version = [0; 64];
    version[..14].copy_from_slice(b"virtual device");
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
    let is_present = session.device.is_present();
    if is_present {
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
        if !is_present {
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
        while due <= now && plug_in_at.is_none() {
            due += Duration::from_millis(1);
            match session.device.millisecond(&mut session.wire) {
                Next::Continues => {}
                Next::Unplugged(during) => {
                    session.wire.send(message::DEVICE_DISCONNECT, 0, &[]);
                    plug_in_at = Some(now + during);
                }
                Next::Ended => {
                    session.wire.send(message::DEVICE_DISCONNECT, 0, &[]);
                    session.wire.flush()?;
                    std::thread::sleep(Duration::from_millis(500));
                    return Ok(());
                }
            }
        }
    }
}

impl<D: UsbDevice> Session<'_, D> {
    fn connect(&mut self) {
        self.alternate = 0;
        self.ep_info();
        self.interface_info();
        let mut body = vec![2];
        body.extend(self.device.class());
        for field in self.device.ids() {
            body.extend(field.to_le_bytes());
        }
        self.wire.send(message::DEVICE_CONNECT, 0, &[&body]);
    }

    /// The descriptors of the configuration that belong to the present alternate setting.
    fn descriptors(&self) -> Vec<Vec<u8>> {
        let bytes = self.device.configuration();
        let (mut rest, mut descriptors, mut alternate) = (&bytes[..], Vec::new(), 0);
        while let Some((one, behind)) = rest
            .first()
            .and_then(|n| rest.split_at_checked(*n as usize))
        {
            if one[1] == INTERFACE {
                alternate = one[3];
            }
            if alternate == self.alternate {
                descriptors.push(one.to_vec());
            }
            rest = behind;
        }
        descriptors
    }

    fn ep_info(&mut self) {
        let mut kinds = [255u8; 32];
        let mut intervals = [0u8; 32];
        let mut interfaces = [0u8; 32];
        let mut sizes = [0u16; 32];
        for control in [0, 16] {
            (kinds[control], sizes[control]) = (0, 64);
        }
        let mut interface = 0;
        for one in self.descriptors() {
            match one[1] {
                INTERFACE => interface = one[2],
                ENDPOINT => {
                    let i = usize::from(one[2] & 15) + usize::from(one[2] >> 7) * 16;
                    (kinds[i], intervals[i], interfaces[i]) = (one[3], one[6], interface);
                    sizes[i] = u16::from_le_bytes([one[4], one[5]]);
                }
                _ => {}
            }
        }
        let sizes: Vec<u8> = sizes.iter().flat_map(|size| size.to_le_bytes()).collect();
        let parts: [&[u8]; 4] = [&kinds, &intervals, &interfaces, &sizes];
        self.wire.send(message::EP_INFO, 0, &parts);
    }

    fn interface_info(&mut self) {
        let mut columns = [[0u8; 32]; 4];
        let all = self.descriptors();
        let interfaces = all.iter().filter(|one| one[1] == INTERFACE);
        let count = interfaces.clone().count() as u32;
        for (i, one) in interfaces.enumerate() {
            for (column, field) in columns.iter_mut().zip([one[2], one[5], one[6], one[7]]) {
                column[i] = field;
            }
        }
        let body = [&count.to_le_bytes()[..], columns.as_flattened()];
        self.wire.send(message::INTERFACE_INFO, 0, &body);
    }

    /// Answer to a standard request that reads.
    fn standard(&self, request: u8, value: u16) -> Option<Vec<u8>> {
        match (request, value.to_be_bytes()) {
            (6, [1, _]) => {
                let mut bytes = vec![18, 1, 0x00, 0x02];
                bytes.extend(self.device.class());
                bytes.push(64);
                bytes.extend(self.device.ids().into_iter().flat_map(u16::to_le_bytes));
                bytes.extend([1, 2, 3, 1]);
                Some(bytes)
            }
            (6, [2, _]) => Some(self.device.configuration()),
            (6, [3, 0]) => Some(vec![4, 3, 9, 4]),
            (6, [3, index]) => {
                let text = self.device.string(index)?;
                let mut bytes = vec![2 + 2 * text.len() as u8, 3];
                bytes.extend(text.encode_utf16().flat_map(u16::to_le_bytes));
                Some(bytes)
            }
            (6, [6, _]) => Some(vec![10, 6, 0, 2, 0, 0, 0, 64, 1, 0]),
            (0, _) => Some(vec![1, 0]),
            _ => None,
        }
    }

    fn control(&mut self, id: u64, body: &[u8]) {
        let Some((head, data)) = body.split_first_chunk::<10>() else {
            return;
        };
        let [endpoint, request, kind, _, v0, v1, i0, i1, l0, l1] = *head;
        let [value, index] = [[v0, v1], [i0, i1]].map(u16::from_le_bytes);
        let wanted = usize::from(u16::from_le_bytes([l0, l1]));
        let answer: Option<Vec<u8>> = match kind {
            0x80..=0x82 => self.standard(request, value),
            0x00..=0x02 => {
                if (kind, request) == (2, 1) {
                    self.device.clear_halt(i0);
                }
                Some(vec![])
            }
            _ => {
                let setup = Setup {
                    kind,
                    request,
                    value,
                    index,
                };
                self.device.request(&setup, data)
            }
        };
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
                self.device
                    .isochronous(byte(0), kind == message::START_ISO_STREAM);
                self.wire
                    .send(message::ISO_STREAM_STATUS, id, &[&[0, byte(0)]]);
            }
            message::RESET => self.device.reset(),
            message::CONTROL_PACKET => self.control(id, body),
            message::CANCEL_DATA_PACKET => match self.device.cancel(id) {
                Some(endpoint) => self.wire.bulk(id, endpoint, CANCELLED, &[]),
                None => {
                    let head = [0, 0, 0, CANCELLED, 0, 0, 0, 0, 0, 0];
                    self.wire.send(message::CONTROL_PACKET, id, &[&head]);
                }
            },
            message::BULK_PACKET => {
                let length = u32::from_le_bytes([byte(2), byte(3), byte(8), byte(9)]);
                if !self.device.bulk(byte(0), id, length as usize) {
                    self.wire.bulk(id, byte(0), STALL, &[]);
                }
            }
            _ => {}
        }
    }
}
