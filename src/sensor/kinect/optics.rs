//! The optics of both cameras: raw values to distances, distances to the shift between the pictures.

use super::registration::Registration;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Distances are delivered below this, millimetres; what lies farther is no measurement.
pub(super) const FARTHEST_MM: f64 = 10_000.0;

/// Offset, in pixels, which the device's own arithmetic applies to raw values and to the colour shift.
pub(super) const DEVICE_OFFSET: f64 = 0.375;

/// The optics of [`super::registration::ZeroPlane`], widened once.
#[derive(Clone, Copy, Debug)]
pub(super) struct Optics {
    pub(super) emitter: f64,
    pub(super) baseline: f64,
    pub(super) reference: f64,
    pub(super) pixel: f64,
    pub(super) shift: f64,
}

impl Optics {
    pub(super) fn new(registration: &Registration) -> Self {
        let plane = &registration.zero_plane;
        Self {
            emitter: plane.dcmos_emitter_distance.into(),
            baseline: plane.dcmos_rcmos_distance.into(),
            reference: plane.reference_distance.into(),
            pixel: plane.reference_pixel_size.into(),
            shift: registration.const_shift.into(),
        }
    }

    /// Distance in millimetres, `None` from where the emitter's ray no longer meets the pixel's.
    pub(super) fn millimetres(&self, raw: f64) -> Option<f64> {
        let m = (raw / 4.0 - self.shift - DEVICE_OFFSET) * self.pixel;
        (m < self.emitter)
            .then(|| 10.0 * (m * self.reference / (self.emitter - m) + self.reference))
    }

    /// Columns from rectified to true colour position, for a distance in millimetres.
    pub(super) fn colour_shift(&self, z_mm: f64) -> f64 {
        self.baseline / (2.0 * self.pixel) * (1.0 - 10.0 * self.reference / z_mm) + DEVICE_OFFSET
    }
}

/// An array on the heap that never passes over the stack.
pub(super) fn boxed<T: Copy, const N: usize>(value: T) -> Box<[T; N]> {
    match vec![value; N].into_boxed_slice().try_into() {
        Ok(array) => array,
        Err(_) => unreachable!("the vector was made N long"),
    }
}
