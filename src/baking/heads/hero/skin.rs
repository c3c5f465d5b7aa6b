//! The picture of the skin, brows and lips, `skin.jpg`: wrapped around the upright axis of the head.
//!
//! A place of the picture is an angle about the axis and a height. What lies behind the ears has no picture; its edges
//! are plain skin, so that there is no seam.

use crate::bake::mesh::Vec3;
use mien_stages::base::geometry::smoothstep;

/// Colour of plain skin, sRGB.
pub(super) const COLOUR: [f32; 3] = [0.885, 0.700, 0.605];
/// The picture.
pub(super) const PICTURE: &[u8] = include_bytes!("skin.jpg");
/// The axis.
const AXIS_Z_M: f64 = -0.085;
/// Angle from the middle to an edge of the picture, radians.
const REACH: f64 = 1.75;
/// Height of the lower and upper edge.
const HEIGHT_M: [f64; 2] = [-0.13, 0.10];

fn angle(p: &Vec3) -> f64 {
    p.x.atan2(p.z - AXIS_Z_M)
}

/// Whether the picture has this place.
pub(super) fn reaches(p: &Vec3) -> bool {
    angle(p).abs() < REACH * 0.98
}

/// Place in the picture, 0…1 from the top left. What lies beyond is a little inside its edges: OBJ cannot say that a
/// picture does not repeat, and beneath its lower edge the hair of its upper one would show.
pub(super) fn place_in_picture(p: &Vec3) -> [f32; 2] {
    let u = 0.5 + 0.5 * angle(p) / REACH;
    let v = (HEIGHT_M[1] - p.y) / (HEIGHT_M[1] - HEIGHT_M[0]);
    [u, v].map(|t| t.clamp(0.01, 0.99) as f32)
}

/// Whether a place lies so far under the shirt that its faces are given the shirt's colour: at the shirt's lower edge no skin shows.
pub(super) fn is_under_shirt(p: &Vec3) -> bool {
    // The collar is lower in front than behind.
    let collar = -0.134 - 0.020 * smoothstep(-0.160, -0.050, p.z);
    collar - p.y > 0.012
}
