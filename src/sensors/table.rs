//! The table of sensors that can be plugged in: a row each. Another sensor is its file beside this one and a row here.

use crate::kinect;
use crate::sensor::SensorKind;
use crate::v4l2;

/// Every kind, the preferred one first.
pub const SENSORS: &[SensorKind] = &[
    kinect::kind::KIND,
    v4l2::kind::DEPTH_CAMERA,
    v4l2::kind::WEBCAM,
];
