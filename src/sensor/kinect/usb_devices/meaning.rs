//! Translates libusb's errors.

use crate::sensor::kinect::device::DeviceError;

/// What a failure to open or claim means.
pub(super) fn opening(problem: rusb::Error, bus: u8, address: u8) -> DeviceError {
    match problem {
        rusb::Error::Access => DeviceError::Access { bus, address },
        rusb::Error::Busy => DeviceError::Busy { bus, address },
        rusb::Error::NotFound => DeviceError::NotConfigured { bus, address },
        other => plain(other),
    }
}

/// What a failed transfer means.
pub(in crate::sensor) fn plain(problem: rusb::Error) -> DeviceError {
    match problem {
        rusb::Error::NoDevice => DeviceError::Gone,
        rusb::Error::Pipe => DeviceError::Stall,
        rusb::Error::Timeout => DeviceError::TimedOut,
        other => DeviceError::Other { code: code(other) },
    }
}

/// libusb's number of an error.
fn code(problem: rusb::Error) -> i32 {
    match problem {
        rusb::Error::Io => -1,
        rusb::Error::InvalidParam => -2,
        rusb::Error::Access => -3,
        rusb::Error::NoDevice => -4,
        rusb::Error::NotFound => -5,
        rusb::Error::Busy => -6,
        rusb::Error::Timeout => -7,
        rusb::Error::Overflow => -8,
        rusb::Error::Pipe => -9,
        rusb::Error::Interrupted => -10,
        rusb::Error::NoMem => -11,
        rusb::Error::NotSupported => -12,
        _ => -99,
    }
}
