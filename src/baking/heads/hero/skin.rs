//! The image of skin, brows and lips, `skin.jpg`, wrapped around the vertical axis of the head.
//!
//! Its coordinates are angle about the axis and height. Behind the ears there is no image; its edges are plain skin,
//! so that there is no seam.

use crate::bake::mesh::Vec3;
use mien_stages::base::geometry::smoothstep;

/// Colour of plain skin, sRGB.
pub(super) const COLOUR: [f32; 3] = [0.885, 0.700, 0.605];
/// The picture.
pub(super) const PICTURE: &[u8] = include_bytes!("skin.jpg");
/// Depth of the axis.
const AXIS_Z_M: f64 = -0.085;
/// Angle from the middle to an edge of the picture, radians.
const REACH: f64 = 1.75;
/// Height of the lower and upper edge.
const HEIGHT_M: [f64; 2] = [-0.13, 0.10];

fn angle(p: &Vec3) -> f64 {
    p.x.atan2(p.z - AXIS_Z_M)
}

/// Whether the image covers a point.
pub(super) fn reaches(p: &Vec3) -> bool {
    angle(p).abs() < REACH * 0.98
}

/// Texture coordinates, 0…1 from the top left. Points outside get ones slightly inside the edges: OBJ cannot disable
/// repetition, and below the lower edge the hair of the upper one would show.
pub(super) fn place_in_picture(p: &Vec3) -> [f32; 2] {
    let u = 0.5 + 0.5 * angle(p) / REACH;
    let v = (HEIGHT_M[1] - p.y) / (HEIGHT_M[1] - HEIGHT_M[0]);
    [u, v].map(|t| t.clamp(0.01, 0.99) as f32)
}

/// Whether faces at a point get the shirt's colour, so that no skin shows at its lower edge.
pub(super) fn is_under_shirt(p: &Vec3) -> bool {
    // The collar is lower in front than behind.
    let collar = -0.134 - 0.020 * smoothstep(-0.160, -0.050, p.z);
    collar - p.y > 0.012
}
