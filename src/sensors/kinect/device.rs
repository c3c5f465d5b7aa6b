//! The interface below the driver: a Kinect's USB functions.
//!
//! [`PacketSource`] has three implementations: the real device, the virtual one, and, in tests, a wrapper that injects faults. They
//! share all code above it: commands, calibration, packets, pictures.

use core::time::Duration;
use mien_stages::base::prelude::*;

/// One of the two isochronous streams.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stream {
    /// Bayer pictures of the colour camera, endpoint 0x81.
    Colour = 0,
    /// Packed 11-bit pictures of the depth camera, endpoint 0x82.
    Depth = 1,
}

impl Stream {
    /// Both streams, in index order.
    pub const BOTH: [Self; 2] = [Self::Colour, Self::Depth];

    /// Index into tables by stream.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Address of the isochronous endpoint.
    pub const fn endpoint(self) -> u8 {
        match self {
            Self::Colour => 0x81,
            Self::Depth => 0x82,
        }
    }
}

/// The sensors with this protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// Kinect for Xbox 360, first series, with a motor device of its own.
    Xbox1414,
    /// Kinect for Xbox 360, second series: motor and LED behind the audio device.
    Xbox1473,
    /// Kinect for Windows, with near mode.
    Windows1517,
}

impl Model {
    /// USB vendor id of all parts of all models.
    pub const VENDOR: u16 = 0x045e;
    /// `bcdDevice` of the first series.
    pub const FIRST_SERIES_RELEASE: u16 = 0x010b;

    /// The model with this product id and `bcdDevice` of its camera; `None` if it is not a Kinect v1 camera.
    pub const fn from_camera(product: u16, release: u16) -> Option<Self> {
        match (product, release) {
            (0x02bf, _) => Some(Self::Windows1517),
            (0x02ae, Self::FIRST_SERIES_RELEASE) => Some(Self::Xbox1414),
            (0x02ae, _) => Some(Self::Xbox1473),
            _ => None,
        }
    }

    /// Alternate setting of interface 0 that has the isochronous endpoints.
    pub const fn alternate_setting(self) -> u8 {
        match self {
            Self::Windows1517 => 1,
            _ => 0,
        }
    }

    /// Bytes of the fixed parameters block.
    pub const fn fixed_parameters_len(self) -> usize {
        match self {
            Self::Xbox1414 => 322,
            _ => 334,
        }
    }
}

impl core::fmt::Display for Model {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Xbox1414 => "Kinect for Xbox 360 (1414)",
            Self::Xbox1473 => "Kinect for Xbox 360 (1473)",
            Self::Windows1517 => "Kinect for Windows (1517)",
        })
    }
}

/// Bytes received on one endpoint in one microframe.
#[derive(Clone, Copy, Debug)]
pub struct Received<'a> {
    /// Stream of the endpoint.
    pub stream: Stream,
    /// Whether the bus reported no error; otherwise the bytes are unreliable.
    pub intact: bool,
    /// Header and payload; empty if the camera sent nothing.
    pub bytes: &'a [u8],
}

/// A request to one of a Kinect's USB devices, with the bytes to send or the buffer to fill.
pub enum Request<'a> {
    /// Writes one command to the camera.
    Command(&'a [u8]),
    /// Reads the reply to the last command.
    Reply(&'a mut [u8]),
    /// Vendor request and its value to the motor device (first series only).
    Motor(u8, u16),
    /// Reads the motor device's state (first series only).
    MotorState(&'a mut [u8]),
    /// Bulk message to the audio device (later models, if its firmware runs).
    Audio(&'a [u8]),
    /// Reads the audio device's bulk answer.
    AudioAnswer(&'a mut [u8]),
}

/// Why a Kinect cannot be reached; each message contains the remedy.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DeviceError {
    /// No part of a Kinect is on any bus.
    #[error(
        "no Kinect on USB (expected a camera 045e:02ae or 045e:02bf); plug in the Kinect and its power supply"
    )]
    Absent,
    /// Hub or motor is on USB, but not the camera.
    #[error(
        "a Kinect's hub or motor is on USB but its camera is not, because it has no 12 V; plug in its power supply"
    )]
    NoPower,
    /// No camera has this serial number; number of cameras found.
    #[error("no Kinect with serial {0} among the {1} on USB; `mien devices` lists the serials")]
    OtherSerial(String, usize),
    /// No permission for the device node of this bus and address.
    #[error(
        "no permission to open the Kinect at /dev/bus/usb/{0:03}/{1:03}; install systemd/mien.rules as /etc/udev/rules.d/60-mien.rules and plug it in again"
    )]
    Access(u8, u8),
    /// Another program, or a driver that cannot be detached, holds the interface: bus, address.
    #[error(
        "the Kinect at bus {0} address {1} is in use; stop the other program that reads it, or unload its driver with `rmmod gspca_kinect`"
    )]
    Busy(u8, u8),
    /// The kernel has not configured the device: bus, address.
    #[error(
        "the Kinect at bus {0} address {1} is on USB but not configured, usually because of insufficient power; use a port on the computer itself and check the 12 V supply"
    )]
    NotConfigured(u8, u8),
    /// The connection is too slow for the streams: its speed.
    #[error(
        "the Kinect is connected at {0}, expected 480 Mbit/s; plug it into a USB 2.0 or 3.0 port on the computer itself, with a good cable"
    )]
    Slow(&'static str),
    /// An isochronous endpoint is missing: model, endpoint, alternate setting in use.
    #[error(
        "the {0} has no isochronous endpoint 0x{1:02x} in alternate setting {2}; unplug it, wait a second and plug it in again"
    )]
    NoEndpoint(Model, u8, u8),
    /// Programs have no access to USB on this system.
    #[error(
        "no USB devices visible to programs (/dev/bus/usb is missing); load the kernel's USB driver or, in a container, pass /dev/bus/usb through"
    )]
    NoUsb,
    /// The host controller has no isochronous bandwidth for this stream.
    #[error(
        "the USB controller has no room for the {0:?} stream; give the Kinect its own controller (not behind a hub, no other camera or sound card)"
    )]
    Bandwidth(Stream),
    /// The device is gone.
    #[error("the Kinect was unplugged or lost power; plug it in again")]
    Gone,
    /// The device stalled a request.
    #[error("the Kinect refused a request (stall); unplug it and plug it in again")]
    Stall,
    /// A transfer exceeded its time limit.
    #[error("the Kinect did not answer a USB request in time; unplug it and plug it in again")]
    TimedOut,
    /// There is no motor device, or it was not found.
    #[error("motor, LED and tilt of this Kinect are not available; pictures are not affected")]
    NoMotor,
    /// Another error of libusb.
    #[error("USB: {0} (libusb); unplug the Kinect and plug it in again")]
    Other(String),
}

/// The USB functions of one Kinect, opened and claimed. Every wait is bounded.
pub trait PacketSource {
    /// Model of the sensor.
    fn model(&self) -> Model;

    /// Serial number, as printed by `mien devices`.
    fn serial(&self) -> &str;

    /// Makes a request; returns the number of bytes read, 0 for a reply that is not ready.
    ///
    /// # Errors
    /// If this Kinect has no such device or the transfer failed.
    fn request(&mut self, request: Request<'_>) -> Result<usize, DeviceError>;

    /// Submits the transfers of a stream; called before the camera starts it, so that its first picture is complete.
    ///
    /// # Errors
    /// If the host refuses the transfers.
    fn start(&mut self, stream: Stream) -> Result<(), DeviceError>;

    /// Cancels a stream's transfers and waits for their return.
    fn stop(&mut self, stream: Stream);

    /// Passes everything received since the last call to `sink`, oldest first per stream; waits at most `wait` if there is nothing.
    ///
    /// # Errors
    /// If the device is gone.
    fn poll(
        &mut self,
        wait: Duration,
        sink: &mut dyn FnMut(Received<'_>),
    ) -> Result<(), DeviceError>;

    /// Time since a fixed moment, by the device's clock; a virtual device may run faster than real time.
    fn clock(&self) -> Duration;

    /// Waits for `time` on the device's clock.
    fn sleep(&mut self, time: Duration);
}
