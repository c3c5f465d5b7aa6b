//! Eyes: white, iris and pupil, one picture for both, `eyes.jpg`, seen from in front.

use crate::bake::mesh::Vec3;

/// The picture.
pub(super) const PICTURE: &[u8] = include_bytes!("eyes.jpg");
/// Middle of the left eyeball; of the right one x is negative.
const BALL: Vec3 = Vec3::new(0.031, 0.0035, -0.0135);
/// Offset of the iris's middle from there towards the nose: eyes that look at somebody at arm's length converge.
const INWARD_M: f64 = 0.0007;
/// Distance from the image's middle to its edge.
const REACH_M: f64 = 0.0165;

/// Texture coordinates of a vertex of an eyeball.
pub(super) fn place_in_picture(p: &Vec3) -> [f32; 2] {
    let side = p.x.signum();
    let x = p.x - side * (BALL.x - INWARD_M);
    let mut flat = nalgebra::Vector2::new(x, p.y - BALL.y);
    // The back of the ball is white.
    if p.z < BALL.z {
        flat = flat.try_normalize(1e-9).unwrap_or_default() * REACH_M;
    }
    let at = |d: f64| (0.5 + 0.5 * d / REACH_M).clamp(0.0, 1.0) as f32;
    [at(flat.x), at(-flat.y)]
}
