//! [`PacketSource`] over libusb: isochronous transfers, which rusb's safe part does not have. The only file with unsafe code.
//!
//! Per stream 16 transfers of 16 packets are in flight (32 ms of the bus). When one lands, its packets are copied into the
//! inbox, a bounded ring, and it is submitted again at once: nothing else happens there. When the inbox is full the oldest
//! transfer in it is overwritten and counted; its packets then show as lost in their stream.
//!
//! Everything runs in the thread that owns [`UsbKinect`]: libusb calls back only from within `handle_events` and synchronous
//! requests, both made here. The type is neither `Send` nor `Sync`, so the compiler holds us to it.
//!
//! Memory: 0.5 MB in flight per stream, 4 MB inbox, allocated at opening. Limitation: a device that does not return its
//! cancelled transfers within two seconds costs their memory (it is left to libusb on purpose).
#![expect(
    unsafe_code,
    reason = "isochronous transfers exist only in libusb's C interface"
)]

use core::cell::RefCell;
use core::ffi::c_int;
use core::time::Duration;
use std::time::Instant;

use rusb::ffi;
use rusb::ffi::constants::{
    LIBUSB_ERROR_NO_DEVICE, LIBUSB_TRANSFER_CANCELLED, LIBUSB_TRANSFER_COMPLETED,
    LIBUSB_TRANSFER_NO_DEVICE,
};
use rusb::{Context, DeviceHandle, UsbContext};

use super::device::{DeviceError, Model, PacketSource, Received, Stream};
use super::packet::LONGEST;
use super::usb_devices::{self, Opened, REQUEST, plain};
use crate::capacity::{LANDED_TRANSFERS, PACKETS, TRANSFERS};

mod inbox;

use inbox::Inbox;

/// Cancelled transfers come back within this.
const DRAIN: Duration = Duration::from_secs(2);

/// Transfers of one stream and the memory they land in.
struct Flight {
    transfers: Vec<*mut ffi::libusb_transfer>,
    /// Kept because libusb writes into it; never read here.
    buffers: Vec<Box<[u8]>>,
}

/// A Kinect on USB, opened and claimed.
pub struct UsbKinect {
    model: Model,
    serial: String,
    flights: [Option<Flight>; 2],
    inbox: Box<RefCell<Inbox>>,
    opened: Instant,
    // Handles before the context: they are closed first.
    camera: DeviceHandle<Context>,
    motor: Option<DeviceHandle<Context>>,
    audio: Option<DeviceHandle<Context>>,
    context: Context,
}

impl UsbKinect {
    /// Opens the Kinect with `serial`, or the first that is free; resets its audio device first if asked to.
    ///
    /// # Errors
    /// None there, or none that may be had; each with the way out.
    pub fn open(serial: Option<&str>, reset_audio: bool) -> Result<Self, DeviceError> {
        let Opened {
            model,
            serial,
            camera,
            motor,
            audio,
            context,
        } = usb_devices::open(serial, reset_audio)?;
        Ok(Self {
            model,
            serial,
            flights: [None, None],
            inbox: Box::new(RefCell::new(Inbox::new())),
            opened: Instant::now(),
            camera,
            motor,
            audio,
            context,
        })
    }

    /// Transfers overwritten because nobody polled in time.
    #[must_use]
    pub fn overruns(&self) -> u64 {
        self.inbox.borrow().overruns
    }

    /// Lets libusb work for at most `time`.
    fn events(&self, time: Duration) -> Result<(), DeviceError> {
        match self.context.handle_events(Some(time)) {
            Ok(()) | Err(rusb::Error::Interrupted) => {}
            Err(problem) => return Err(plain(problem)),
        }
        if self.inbox.borrow().gone {
            return Err(DeviceError::Gone);
        }
        Ok(())
    }

    fn allocate(&self, stream: Stream) -> Result<Flight, DeviceError> {
        // SAFETY: the handle is open, hence so is its device; the function only reads descriptors.
        let found = unsafe {
            ffi::libusb_get_max_iso_packet_size(self.camera.device().as_raw(), stream.endpoint())
        };
        let size = usize::try_from(found)
            .ok()
            .filter(|&size| size > 0)
            .unwrap_or(LONGEST)
            .min(LONGEST);
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
                return Err(DeviceError::Other { code: -11 });
            }
            let user_data: *const RefCell<Inbox> = &raw const *self.inbox;
            // SAFETY: `transfer` is valid and not in flight. `buffer` lives in the flight, at a fixed address, until the
            // transfer is freed. The inbox is boxed and outlives every transfer in flight: see `stop` and `drop`.
            unsafe {
                ffi::libusb_fill_iso_transfer(
                    transfer,
                    self.camera.as_raw(),
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

    fn cancel(&self, stream: Stream) -> bool {
        let i = stream.index();
        self.inbox.borrow_mut().stopping[i] = true;
        if let Some(flight) = &self.flights[i] {
            for &transfer in &flight.transfers {
                // SAFETY: the transfer is allocated; cancelling one that is not in flight is an error code, no more.
                unsafe { ffi::libusb_cancel_transfer(transfer) };
            }
        }
        let deadline = Instant::now() + DRAIN;
        while self.inbox.borrow().flying[i] > 0 && Instant::now() < deadline {
            // The device may be gone; its transfers come back all the same.
            let _ = self.events(Duration::from_millis(10));
        }
        self.inbox.borrow().flying[i] == 0
    }
}

/// Frees transfers none of which is in flight.
fn free(flight: &mut Flight) {
    for transfer in flight.transfers.drain(..) {
        // SAFETY: allocated by `libusb_alloc_transfer`, not in flight, and forgotten by the drain.
        unsafe { ffi::libusb_free_transfer(transfer) };
    }
    flight.buffers.clear();
}

/// A transfer has landed: copy and submit again.
extern "system" fn landed(transfer: *mut ffi::libusb_transfer) {
    // SAFETY: libusb hands back a transfer filled in `allocate`, which nobody else touches while the callback runs.
    let (user_data, endpoint, status, buffer, length) = unsafe {
        let landed = &*transfer;
        (
            landed.user_data,
            landed.endpoint,
            landed.status,
            landed.buffer,
            landed.length,
        )
    };
    // SAFETY: `user_data` is the boxed inbox, alive while any transfer is in flight, and reached only from this thread.
    let inbox = unsafe { &*user_data.cast::<RefCell<Inbox>>() };
    // Nobody holds a borrow while libusb works; should it ever be otherwise, the transfer is given up, not the process.
    let Ok(mut inbox) = inbox.try_borrow_mut() else {
        return;
    };
    let stream = if endpoint == Stream::Colour.endpoint() {
        Stream::Colour
    } else {
        Stream::Depth
    };
    let i = stream.index();
    match status {
        LIBUSB_TRANSFER_COMPLETED => {
            // SAFETY: the transfer was allocated with so many packet descriptors behind its fixed part.
            let packets: &[ffi::libusb_iso_packet_descriptor] = unsafe {
                core::slice::from_raw_parts(
                    (&raw const (*transfer).iso_packet_desc).cast(),
                    PACKETS,
                )
            };
            // SAFETY: `buffer` and `length` are those of the boxed buffer given in `allocate`.
            let bytes = unsafe { core::slice::from_raw_parts(buffer, length as usize) };
            if packets
                .iter()
                .any(|packet| packet.status != 0 || packet.actual_length > 0)
            {
                let slot = inbox.next();
                slot.stream = stream;
                let mut start = 0;
                for (k, packet) in packets.iter().enumerate() {
                    let length = (packet.actual_length as usize).min(LONGEST);
                    let from = bytes.get(start..start + length);
                    start += packet.length as usize;
                    slot.lengths[k] = match from {
                        Some(from) if packet.status == 0 => {
                            slot.bytes[k * LONGEST..][..length].copy_from_slice(from);
                            Some(length as u16)
                        }
                        _ => None,
                    };
                }
            }
        }
        LIBUSB_TRANSFER_NO_DEVICE => inbox.gone = true,
        LIBUSB_TRANSFER_CANCELLED => inbox.gone |= !inbox.stopping[i],
        // Anything else is a passing fault of the bus: the gap in the sequence tells.
        _ => {}
    }
    if inbox.stopping[i] || inbox.gone {
        inbox.flying[i] -= 1;
        return;
    }
    // SAFETY: the transfer has just come back, so it is not in flight; all its memory is as `allocate` left it.
    let result = unsafe { ffi::libusb_submit_transfer(transfer) };
    if result != 0 {
        inbox.flying[i] -= 1;
        inbox.gone |= result == LIBUSB_ERROR_NO_DEVICE;
    }
}

impl PacketSource for UsbKinect {
    fn model(&self) -> Model {
        self.model
    }

    fn serial(&self) -> &str {
        &self.serial
    }

    fn send(&mut self, command: &[u8]) -> Result<(), DeviceError> {
        self.camera
            .write_control(0x40, 0, 0, 0, command, REQUEST)
            .map(|_| ())
            .map_err(plain)
    }

    fn receive(&mut self, reply: &mut [u8]) -> Result<usize, DeviceError> {
        self.camera
            .read_control(0xc0, 0, 0, 0, reply, REQUEST)
            .map_err(plain)
    }

    fn start(&mut self, stream: Stream) -> Result<(), DeviceError> {
        let i = stream.index();
        if self.flights[i].is_some() {
            return Ok(());
        }
        let flight = self.allocate(stream)?;
        self.inbox.borrow_mut().stopping[i] = false;
        let mut failure = None;
        for &transfer in &flight.transfers {
            // SAFETY: filled in `allocate`, not in flight.
            let result = unsafe { ffi::libusb_submit_transfer(transfer) };
            if result != 0 {
                failure = Some(result);
                break;
            }
            self.inbox.borrow_mut().flying[i] += 1;
        }
        self.flights[i] = Some(flight);
        match failure {
            None => Ok(()),
            Some(LIBUSB_ERROR_NO_DEVICE) => Err(DeviceError::Gone),
            Some(_) => {
                self.stop(stream);
                Err(DeviceError::Bandwidth { stream })
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
            // libusb still holds some and may write to them: their memory must stay.
            core::mem::forget(flight);
        }
    }

    fn poll(
        &mut self,
        wait: Duration,
        sink: &mut dyn FnMut(Received<'_>),
    ) -> Result<(), DeviceError> {
        let wait = if self.inbox.borrow().filled > 0 {
            Duration::ZERO
        } else {
            wait
        };
        let alive = self.events(wait);
        let mut inbox = self.inbox.borrow_mut();
        while inbox.filled > 0 {
            let landed = &inbox.ring[inbox.oldest];
            for (length, bytes) in landed.lengths.iter().zip(landed.bytes.chunks(LONGEST)) {
                sink(Received {
                    stream: landed.stream,
                    intact: length.is_some(),
                    bytes: &bytes[..usize::from(length.unwrap_or(0))],
                });
            }
            inbox.oldest = (inbox.oldest + 1) % LANDED_TRANSFERS;
            inbox.filled -= 1;
        }
        alive
    }

    fn clock(&self) -> Duration {
        self.opened.elapsed()
    }

    fn sleep(&mut self, time: Duration) {
        // Transfers that land meanwhile are submitted again at once.
        let until = Instant::now() + time;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return;
            }
            if self.inbox.borrow().flying == [0; 2] || self.events(left).is_err() {
                std::thread::sleep(until.saturating_duration_since(Instant::now()));
                return;
            }
        }
    }

    fn motor_write(&mut self, request: u8, value: u16) -> Result<(), DeviceError> {
        let motor = self.motor.as_ref().ok_or(DeviceError::NoMotor)?;
        motor
            .write_control(0x40, request, value, 0, &[], REQUEST)
            .map(|_| ())
            .map_err(plain)
    }

    fn motor_read(&mut self, request: u8, reply: &mut [u8]) -> Result<usize, DeviceError> {
        let motor = self.motor.as_ref().ok_or(DeviceError::NoMotor)?;
        motor
            .read_control(0xc0, request, 0, 0, reply, REQUEST)
            .map_err(plain)
    }

    fn audio_write(&mut self, message: &[u8]) -> Result<(), DeviceError> {
        let audio = self.audio.as_ref().ok_or(DeviceError::NoMotor)?;
        audio
            .write_bulk(0x01, message, REQUEST)
            .map(|_| ())
            .map_err(plain)
    }

    fn audio_read(&mut self, reply: &mut [u8]) -> Result<usize, DeviceError> {
        let audio = self.audio.as_ref().ok_or(DeviceError::NoMotor)?;
        audio.read_bulk(0x81, reply, REQUEST).map_err(plain)
    }
}

impl Drop for UsbKinect {
    fn drop(&mut self) {
        for stream in Stream::BOTH {
            self.stop(stream);
        }
        if self.inbox.borrow().flying != [0; 2] {
            // See `stop`: a late callback would still write here.
            let inbox = core::mem::replace(&mut self.inbox, Box::new(RefCell::new(Inbox::new())));
            core::mem::forget(inbox);
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
                    | DeviceError::OtherSerial { .. }
            ),
            "{problem}"
        );
    }
}
