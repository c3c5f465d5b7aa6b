//! Translates libusb's errors.

use crate::sensor::kinect::device::DeviceError;

/// What a failure to open or claim means.
pub(super) fn opening(problem: rusb::Error, bus: u8, address: u8) -> DeviceError {
    match problem {
        rusb::Error::Access => DeviceError::Access(bus, address),
        rusb::Error::Busy => DeviceError::Busy(bus, address),
        rusb::Error::NotFound => DeviceError::NotConfigured(bus, address),
        other => plain(other),
    }
}

/// What a failed transfer means.
pub(in crate::sensor) fn plain(problem: rusb::Error) -> DeviceError {
    match problem {
        rusb::Error::NoDevice => DeviceError::Gone,
        rusb::Error::Pipe => DeviceError::Stall,
        rusb::Error::Timeout => DeviceError::TimedOut,
        other => DeviceError::Other(other.to_string()),
    }
}
