//! Measures depth at the sites of the face model's refinement ([`crate::face_model::refinement`]).

use super::relief;
use crate::base::capacity::{LANDMARKS, PIXELS};
use crate::base::frames::SensorFromFace;
use crate::base::geometry::{Point, Vector};
use crate::camera::Camera;
use crate::face_model::refinement::{Inputs, MAX_INPUTS, SITES, sites};

/// Inputs of the refinement. `shape`: fitted coefficients, one per mode; `turn`: the head's rotation vector relative to the line
/// of sight; `head`: fitted points at the model's size, metres; `size`: factor to the face's own size.
pub fn inputs(
    shape: &[f32],
    turn: &Vector,
    head: &[Point; LANDMARKS],
    size: f32,
    depth: &[u16; PIXELS],
    camera: &Camera,
    sensor_from_face: &SensorFromFace,
) -> Inputs {
    let mut inputs = Inputs::new();
    let [x, y, z] = [turn.x, turn.y, turn.z];
    let seen = surface_offsets(head, size, depth, camera, sensor_from_face);
    let all = shape
        .iter()
        .copied()
        .chain([x, y, z, x * x, y * y, x * y])
        .chain(seen);
    // Capacity for the most modes.
    inputs.extend(all.take(MAX_INPUTS));
    inputs
}

/// Distance of the measured surface before the fit at each site, metres at the model's size; NaN without depth.
pub fn surface_offsets(
    head: &[Point; LANDMARKS],
    size: f32,
    depth: &[u16; PIXELS],
    camera: &Camera,
    sensor_from_face: &SensorFromFace,
) -> heapless::Vec<f32, SITES> {
    let offsets = sites(head).map(|site| {
        relief::height(depth, camera, sensor_from_face, &(site * size))
            .map_or(f32::NAN, |height| height / size + site.z)
    });
    offsets.collect()
}
