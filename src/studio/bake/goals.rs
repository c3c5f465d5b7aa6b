//! Where the control vertices of one shape go: the landmarks as the recipe says, and the lid lines that it closes.
//!
//! Units: the mesh's.

use crate::base::geometry::smoothstep;
use std::collections::BTreeMap;

use super::contact::LID_MARGIN;
use super::head::Head;
use super::mesh::Vec3;
use super::recipe::Target;

/// All control vertices of a shape with their displacements.
pub(super) fn goals(head: &Head, target: &Target) -> BTreeMap<u32, Vec3> {
    let mut goal: BTreeMap<u32, Vec3> = target.controls.iter().copied().collect();
    let at = |v: u32| head.mesh.positions[v as usize];
    for side in 0..2 {
        let seam = &head.lids[side];
        if let Some((amount, line)) = target.close[side] {
            for path in [&seam.upper, &seam.lower] {
                for &v in &path[1..path.len() - 1] {
                    let p = at(v);
                    let t = seam.across(&head.mesh, &p);
                    let on_line = |line| seam.on_line(&head.mesh, line, t);
                    let (u, l) = (on_line(&seam.upper), on_line(&seam.lower));
                    let meeting = l + (u - l) * line;
                    // Both lines go to the same curve; the depth there is the ball's, given below.
                    *goal.entry(v).or_insert_with(Vec3::zeros) +=
                        (meeting - p) * (amount * near_corner(t));
                }
            }
        }
        let Some(ball) = head.balls[side].as_ref().filter(|_| !target.exact) else {
            continue;
        };
        let turned = ball.turned(target.gaze[side].as_ref());
        for path in [&seam.upper, &seam.lower] {
            for &v in path {
                if let Some(d) = goal.get_mut(&v).filter(|d| d.norm() > 0.0) {
                    let (p, moved) = (at(v), at(v) + *d);
                    let least = match target.close[side] {
                        // Lines that meet go to the same point, so that no lid stands before the other.
                        Some((amount, _)) if amount > 0.99 => 2.0 * LID_MARGIN * head.eye_distance,
                        _ => ball.height(&p).min(LID_MARGIN * head.eye_distance),
                    };
                    if turned.height(&moved) < least {
                        *d = turned.lifted(&moved, least) - p;
                    }
                }
            }
        }
    }
    goal
}

/// 1 along a lid line, falling to 0 at its ends, where the lids are one skin: `t` from 0 to 1 across.
fn near_corner(t: f64) -> f64 {
    smoothstep(0.0, 0.035, t) * smoothstep(1.0, 0.965, t)
}
