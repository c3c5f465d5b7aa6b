//! The files of a recording.

/// Name of the file that lists a recording's pictures.
pub(super) const INDEX_NAME: &str = "INDEX.txt";

/// Name of the file with the sensor's calibration.
pub(super) const DEVICE_NAME: &str = "device.json";
