//! The table of sensors that can be plugged in: a row each. Another sensor is its file beside this one and a row here.

use crate::kinect::kind::KIND;
use crate::sensor::SensorKind;

/// Every kind, the preferred one first.
pub const SENSORS: &[SensorKind] = &[KIND];
