//! Measures depth at the places required by the face model ([`crate::face_model::refinement`]).

use super::relief;
use crate::base::capacity::{LANDMARKS, PIXELS};
use crate::base::frames::SensorFromFace;
use crate::base::geometry::{Point, Vector};
use crate::camera::Camera;
use crate::face_model::refinement::{Inputs, MAX_INPUTS, PLACES, places};

/// Gathers the inputs: `shape` the fitted coefficients (as many as modes), `turn` the head's rotation vector relative to the
/// line of sight, `head` the fitted points at the model's size, `size` the factor to the face's own size.
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
    let seen = nearer(head, size, depth, camera, sensor_from_face);
    let all = shape
        .iter()
        .copied()
        .chain([x, y, z, x * x, y * y, x * y])
        .chain(seen);
    // Capacity is that of the most modes.
    inputs.extend(all.take(MAX_INPUTS));
    inputs
}

/// How much nearer the surface is than each of the places on a face, at the model's size; NaN where depth shows nothing.
pub fn nearer(
    head: &[Point; LANDMARKS],
    size: f32,
    depth: &[u16; PIXELS],
    camera: &Camera,
    sensor_from_face: &SensorFromFace,
) -> heapless::Vec<f32, PLACES> {
    let nearer = places(head).map(|place| {
        relief::height(depth, camera, sensor_from_face, &(place * size))
            .map_or(f32::NAN, |height| height / size + place.z)
    });
    nearer.collect()
}
