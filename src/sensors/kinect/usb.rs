//! [`PacketSource`] over libusb: isochronous transfers, which rusb's safe part does not have. One of seven files with unsafe code.
//!
//! Per stream there are 16 transfers of 16 packets (32 ms of the bus). A completed transfer is queued; `poll` reads its packets in
//! place and resubmits it. Packets that arrive while the caller does not poll for 32 ms, for instance during a long request to the
//! device, are lost and counted.
//!
//! Everything runs in the thread that owns [`UsbKinect`]: libusb calls back only from within `handle_events` and synchronous
//! requests, both made here. The type is neither `Send` nor `Sync`, so the compiler enforces this.
//!
//! Memory: 0.5 MB per stream, allocated when it is started. Limitation: a device that does not return its cancelled
//! transfers within two seconds leaks their memory, because libusb may still write to it.
#![expect(
    unsafe_code,
    reason = "isochronous transfers exist only in libusb's C interface"
)]

use core::cell::RefCell;
use core::ffi::c_int;
use core::time::Duration;
use std::collections::VecDeque;
use std::time::Instant;

use rusb::UsbContext;
use rusb::ffi;
use rusb::ffi::constants::{
    LIBUSB_ERROR_NO_DEVICE, LIBUSB_TRANSFER_CANCELLED, LIBUSB_TRANSFER_COMPLETED,
    LIBUSB_TRANSFER_NO_DEVICE,
};

use super::device::{DeviceError, Model, PacketSource, Received, Request, Stream};
use super::motor;
use super::packet::LONGEST;
use super::usb_devices::{self, Opened, REQUEST, device_error};
use mien_stages::base::capacity::{PACKETS, TRANSFERS};
use mien_stages::base::defaults;

/// Longest wait for cancelled transfers.
const DRAIN: Duration = Duration::from_secs(2);

defaults! {
    /// State written by the callback and read by [`UsbKinect`].
    struct Inbox {
        /// Completed transfers with packets, oldest first; has room for all transfers.
        landed: VecDeque<(Stream, *mut ffi::libusb_transfer)> = VecDeque::with_capacity(2 * TRANSFERS),
        /// Number of transfers held by libusb, by stream.
        submitted: [usize; 2] = [0; 2],
        stopping: [bool; 2] = [false; 2],
        gone: bool = false,
    }
}

/// Transfers of one stream and their buffers.
struct Flight {
    transfers: Vec<*mut ffi::libusb_transfer>,
    /// Written by libusb; read through the transfer.
    buffers: Vec<Box<[u8]>>,
}

/// A Kinect on USB, opened and claimed.
pub struct UsbKinect {
    flights: [Option<Flight>; 2],
    inbox: Box<RefCell<Inbox>>,
    since: Instant,
    opened: Opened,
}

impl UsbKinect {
    /// Opens the Kinect with `serial`, or the first free one, and resets its audio device if `reset_audio`.
    ///
    /// # Errors
    /// If there is none, or it cannot be opened.
    pub fn open(serial: Option<&str>, reset_audio: bool) -> Result<Self, DeviceError> {
        Ok(Self {
            flights: [None, None],
            inbox: Box::default(),
            since: Instant::now(),
            opened: usb_devices::open(serial, reset_audio)?,
        })
    }

    /// Lets libusb process events for at most `time`.
    ///
    /// # Errors
    /// If the device is gone.
    fn handle_events(&self, time: Duration) -> Result<(), DeviceError> {
        match self.opened.context.handle_events(Some(time)) {
            Ok(()) | Err(rusb::Error::Interrupted) => {}
            Err(problem) => return Err(device_error(problem)),
        }
        if self.inbox.borrow().gone {
            return Err(DeviceError::Gone);
        }
        Ok(())
    }

    fn allocate(&self, stream: Stream) -> Result<Flight, DeviceError> {
        // SAFETY: the handle is open, hence so is its device; the function only reads descriptors.
        let found = unsafe {
            ffi::libusb_get_max_iso_packet_size(
                self.opened.camera.device().as_raw(),
                stream.endpoint(),
            )
        };
        let size = usize::try_from(found).unwrap_or(0);
        let size = if size > 0 { size.min(LONGEST) } else { LONGEST };
        let mut flight = Flight {
            transfers: Vec::with_capacity(TRANSFERS),
            buffers: Vec::with_capacity(TRANSFERS),
        };
        for _ in 0..TRANSFERS {
            let mut buffer = vec![0; PACKETS * size].into_boxed_slice();
            // SAFETY: allocates a transfer with room for so many packet descriptors; null is checked.
            let transfer = unsafe { ffi::libusb_alloc_transfer(PACKETS as c_int) };
            if transfer.is_null() {
                free(&mut flight);
                return Err(device_error(rusb::Error::NoMem));
            }
            let user_data: *const RefCell<Inbox> = &raw const *self.inbox;
            // SAFETY: `transfer` is valid and not in flight. `buffer` lives in the flight, at a fixed address, until the
            // transfer is freed. The inbox is boxed and outlives every transfer in flight: see `stop` and `drop`.
            unsafe {
                ffi::libusb_fill_iso_transfer(
                    transfer,
                    self.opened.camera.as_raw(),
                    stream.endpoint(),
                    buffer.as_mut_ptr(),
                    buffer.len() as c_int,
                    PACKETS as c_int,
                    landed,
                    user_data.cast_mut().cast(),
                    0,
                );
                ffi::libusb_set_iso_packet_lengths(transfer, size as u32);
            }
            flight.transfers.push(transfer);
            flight.buffers.push(buffer);
        }
        Ok(flight)
    }

    /// Submits a transfer that libusb does not hold; returns libusb's result code.
    fn submit(&self, stream: Stream, transfer: *mut ffi::libusb_transfer) -> c_int {
        // SAFETY: filled in `allocate` and not freed, since it is of a flight; not in flight.
        let result = unsafe { ffi::libusb_submit_transfer(transfer) };
        if result == 0 {
            self.inbox.borrow_mut().submitted[stream.index()] += 1;
        }
        result
    }

    fn cancel(&self, stream: Stream) -> bool {
        let i = stream.index();
        {
            let mut inbox = self.inbox.borrow_mut();
            inbox.stopping[i] = true;
            inbox.landed.retain(|(landed, _)| *landed != stream);
        }
        if let Some(flight) = &self.flights[i] {
            for &transfer in &flight.transfers {
                // SAFETY: the transfer is allocated; cancelling one that is not in flight is an error code, no more.
                unsafe { ffi::libusb_cancel_transfer(transfer) };
            }
        }
        let deadline = Instant::now() + DRAIN;
        while self.inbox.borrow().submitted[i] > 0 && Instant::now() < deadline {
            // Even if the device is gone, its transfers are returned.
            let _ = self.handle_events(Duration::from_millis(10));
        }
        self.inbox.borrow().submitted[i] == 0
    }
}

/// Frees transfers, none of which may be in flight.
fn free(flight: &mut Flight) {
    for transfer in flight.transfers.drain(..) {
        // SAFETY: allocated by `libusb_alloc_transfer`, not in flight, and forgotten by the drain.
        unsafe { ffi::libusb_free_transfer(transfer) };
    }
    flight.buffers.clear();
}

/// Packet descriptors and bytes of a completed transfer.
///
/// # Safety
/// The transfer was filled in [`UsbKinect::allocate`], is not in flight, and stays so as long as the slices are used.
unsafe fn packets<'a>(
    transfer: *const ffi::libusb_transfer,
) -> (&'a [ffi::libusb_iso_packet_descriptor], &'a [u8]) {
    // SAFETY: the caller's promise: so many packet descriptors were allocated behind the fixed part, and buffer and length
    // are those of the boxed buffer.
    unsafe {
        let landed = &*transfer;
        let descriptors = (&raw const (*transfer).iso_packet_desc).cast();
        (
            core::slice::from_raw_parts(descriptors, PACKETS),
            core::slice::from_raw_parts(landed.buffer, landed.length as usize),
        )
    }
}

/// Callback of a completed transfer: queues it if it has packets, else resubmits it.
extern "system" fn landed(transfer: *mut ffi::libusb_transfer) {
    // SAFETY: libusb hands back a transfer filled in `allocate`, which nobody else touches while the callback runs.
    let (user_data, endpoint, status) = unsafe {
        let landed = &*transfer;
        (landed.user_data, landed.endpoint, landed.status)
    };
    // SAFETY: `user_data` is the boxed inbox, alive while any transfer is in flight, and reached only from this thread.
    let inbox = unsafe { &*user_data.cast::<RefCell<Inbox>>() };
    // No borrow is held while libusb runs; if one were, the transfer is lost instead of the process.
    let Ok(mut inbox) = inbox.try_borrow_mut() else {
        return;
    };
    let stream = if endpoint == Stream::Colour.endpoint() {
        Stream::Colour
    } else {
        Stream::Depth
    };
    let i = stream.index();
    let mut news = false;
    match status {
        LIBUSB_TRANSFER_COMPLETED => {
            // SAFETY: it is not in flight while the callback runs.
            let (packets, _) = unsafe { packets(transfer) };
            news = packets
                .iter()
                .any(|packet| packet.status != 0 || packet.actual_length > 0);
        }
        LIBUSB_TRANSFER_NO_DEVICE => inbox.gone = true,
        LIBUSB_TRANSFER_CANCELLED => inbox.gone |= !inbox.stopping[i],
        // Any other status is a transient bus fault, visible as a gap in the sequence.
        _ => {}
    }
    if news || inbox.stopping[i] || inbox.gone {
        inbox.submitted[i] -= 1;
        if !inbox.stopping[i] && news {
            inbox.landed.push_back((stream, transfer));
        }
        return;
    }
    // SAFETY: the transfer has just come back, so it is not in flight; all its memory is as `allocate` left it.
    let result = unsafe { ffi::libusb_submit_transfer(transfer) };
    if result != 0 {
        inbox.submitted[i] -= 1;
        inbox.gone |= result == LIBUSB_ERROR_NO_DEVICE;
    }
}

impl PacketSource for UsbKinect {
    fn model(&self) -> Model {
        self.opened.model
    }

    fn serial(&self) -> &str {
        &self.opened.serial
    }

    fn request(&mut self, request: Request<'_>) -> Result<usize, DeviceError> {
        let (camera, none) = (&self.opened.camera, DeviceError::NoMotor);
        let (motor, audio) = (&self.opened.motor, &self.opened.audio);
        let sent = match request {
            Request::Command(bytes) => camera.write_control(0x40, 0, 0, 0, bytes, REQUEST),
            Request::Reply(bytes) => camera.read_control(0xc0, 0, 0, 0, bytes, REQUEST),
            Request::Motor(request, value) => {
                let motor = motor.as_ref().ok_or(none)?;
                motor.write_control(0x40, request, value, 0, &[], REQUEST)
            }
            Request::MotorState(bytes) => {
                let motor = motor.as_ref().ok_or(none)?;
                motor.read_control(0xc0, motor::STATE, 0, 0, bytes, REQUEST)
            }
            Request::Audio(message) => {
                let audio = audio.as_ref().ok_or(none)?;
                audio.write_bulk(0x01, message, REQUEST)
            }
            Request::AudioAnswer(bytes) => {
                let audio = audio.as_ref().ok_or(none)?;
                audio.read_bulk(0x81, bytes, REQUEST)
            }
        };
        sent.map_err(device_error)
    }

    fn start(&mut self, stream: Stream) -> Result<(), DeviceError> {
        let i = stream.index();
        if self.flights[i].is_some() {
            return Ok(());
        }
        let flight = self.allocate(stream)?;
        self.inbox.borrow_mut().stopping[i] = false;
        let results = flight.transfers.iter();
        let mut results = results.map(|&transfer| self.submit(stream, transfer));
        let failure = results.find(|&result| result != 0);
        self.flights[i] = Some(flight);
        match failure {
            None => Ok(()),
            Some(LIBUSB_ERROR_NO_DEVICE) => Err(DeviceError::Gone),
            Some(_) => {
                self.stop(stream);
                Err(DeviceError::Bandwidth(stream))
            }
        }
    }

    fn stop(&mut self, stream: Stream) {
        let all_back = self.cancel(stream);
        let Some(mut flight) = self.flights[stream.index()].take() else {
            return;
        };
        if all_back {
            free(&mut flight);
        } else {
            // libusb still holds some and may write to them, so their memory is leaked.
            core::mem::forget(flight);
        }
    }

    fn poll(
        &mut self,
        wait: Duration,
        sink: &mut dyn FnMut(Received<'_>),
    ) -> Result<(), DeviceError> {
        let wait = if self.inbox.borrow().landed.is_empty() {
            wait
        } else {
            Duration::ZERO
        };
        let mut alive = self.handle_events(wait);
        loop {
            let next = self.inbox.borrow_mut().landed.pop_front();
            let Some((stream, transfer)) = next else {
                return alive;
            };
            // SAFETY: queued transfers are of a flight that has not been stopped, so they are not freed; none is in flight
            // before it is submitted below.
            let (packets, bytes) = unsafe { packets(transfer) };
            let mut start = 0;
            for packet in packets {
                let length = (packet.actual_length as usize).min(LONGEST);
                let received = bytes.get(start..start + length);
                start += packet.length as usize;
                let received = received.filter(|_| packet.status == 0);
                sink(Received {
                    stream,
                    intact: received.is_some(),
                    bytes: received.unwrap_or(&[]),
                });
            }
            if alive.is_ok() && self.submit(stream, transfer) == LIBUSB_ERROR_NO_DEVICE {
                alive = Err(DeviceError::Gone);
            }
        }
    }

    fn clock(&self) -> Duration {
        self.since.elapsed()
    }

    fn sleep(&mut self, time: Duration) {
        let until = Instant::now() + time;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            if self.inbox.borrow().submitted == [0; 2] || self.handle_events(left).is_err() {
                std::thread::sleep(until.saturating_duration_since(Instant::now()));
                return;
            }
        }
    }
}

impl Drop for UsbKinect {
    fn drop(&mut self) {
        for stream in Stream::BOTH {
            self.stop(stream);
        }
        if self.inbox.borrow().submitted != [0; 2] {
            // See `stop`: a late callback would still write here.
            core::mem::forget(core::mem::take(&mut self.inbox));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Holds on any machine: whatever is or is not plugged in, the answer is a device or one of the sentences.
    #[test]
    fn a_kinect_that_does_not_exist_is_an_error_with_a_remedy() {
        let problem = UsbKinect::open(Some("no such serial"), false)
            .err()
            .unwrap();
        assert!(
            matches!(
                problem,
                DeviceError::Absent
                    | DeviceError::NoUsb
                    | DeviceError::NoPower
                    | DeviceError::OtherSerial(..)
            ),
            "{problem}"
        );
    }
}
