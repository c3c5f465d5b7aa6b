//! What the report says of a baked shape: leakage, inverted and collapsed triangles, lids and lips.

use nalgebra::{Matrix3, Rotation3};

use super::eyeball::Ball;
use super::head::{Follow, Head};
use super::mesh::Vec3;
use super::shape::Shape;
use super::surroundings::Surroundings;

/// Figures of one shape. Lengths in eye distances.
#[derive(Clone, Debug, Default)]
pub struct Figures {
    /// Largest displacement.
    pub largest: f64,
    /// Largest displacement of a vertex outside the area of influence.
    pub outside: f64,
    /// Vertices that move.
    pub moved: usize,
    /// Inverted triangles of the skin, local test.
    pub inverted: usize,
    /// Triangles of the skin whose area fell below a fiftieth of what it was.
    pub collapsed: usize,
    /// How much deeper than in the neutral a skin vertex lies in an eyeball.
    pub eye_depth: f64,
    /// Widest gap left between the lid lines of an eye that the shape closes.
    pub lid_gap: Option<f64>,
    /// Deepest crossing of the inner lip lines, beyond what the neutral has.
    pub lips_cross: f64,
}

/// Prepared for one head.
pub struct Judge<'a> {
    head: &'a Head,
    around: Surroundings,
}

impl<'a> Judge<'a> {
    /// Prepares the neutral's figures.
    pub fn new(head: &'a Head) -> Self {
        Self {
            head,
            around: Surroundings::new(head),
        }
    }

    /// Figures of shape `k`; shapes meant for another one are judged upon it.
    pub fn judge(&self, shapes: &[Shape], k: usize) -> Figures {
        let (head, shape, w) = (self.head, &shapes[k], self.head.eye_distance);
        let neutral = &head.mesh.positions;
        let base: Vec<&Shape> = shape.beneath(shapes).collect();
        let moved = neutral.iter().zip(&shape.displacement).enumerate();
        let moved: Vec<Vec3> = moved
            .map(|(v, (p, d))| p + base.iter().map(|b| b.displacement[v]).sum::<Vec3>() + d)
            .collect();
        let mut out = Figures::default();
        for (d, inside) in shape.displacement.iter().zip(&shape.area) {
            let length = d.norm() / w;
            out.largest = out.largest.max(length);
            out.moved += usize::from(length > 0.0);
            if !inside {
                out.outside = out.outside.max(length);
            }
        }
        let all = 0..moved.len() as u32;
        let changed = all.filter(|&v| moved[v as usize] != neutral[v as usize]);
        let changed: Vec<u32> = changed.collect();
        let mut scratch = self.around.scratch();
        let some = self.around.seeing(&changed, &mut scratch);
        (out.inverted, out.collapsed) = self.around.inverted(&|v| moved[v], &some, &mut scratch);
        for (side, closes) in ["eyeBlinkLeft", "eyeBlinkRight"].into_iter().enumerate() {
            if head.balls[side].is_some() {
                out.eye_depth = out.eye_depth.max(self.eye_depth(side, &moved) / w);
                if shape.name == closes {
                    out.lid_gap = Some(head.lid_gap(side, |v| moved[v as usize]) / w);
                }
            }
        }
        let before = head.lip_gaps(|v| neutral[v as usize]);
        let now = head.lip_gaps(|v| moved[v as usize]);
        for ((.., before), (.., now)) in before.into_iter().zip(now) {
            let crossing = (-now).max(0.0) - (-before).max(0.0);
            out.lips_cross = out.lips_cross.max(crossing / w);
        }
        out
    }

    /// How much deeper skin lies in an eyeball where vertices are at `moved`.
    fn eye_depth(&self, side: usize, moved: &[Vec3]) -> f64 {
        let head = self.head;
        let Some(ball) = &head.balls[side] else {
            return 0.0;
        };
        let turned = ball.turned(gaze(head, side, ball, moved).as_ref());
        let reach = 0.75 * head.eye_distance;
        let places = head.mesh.positions.iter().zip(moved).zip(&head.skin);
        let near = places.filter(|((p, now), skin)| {
            let before = (*now - ball.center).dot(&head.axes.column(2)) > 0.0;
            **skin && before && (*p - ball.center).norm() < reach
        });
        near.map(|((p, now), _)| (-turned.height(now)).max(0.0) - (-ball.height(p)).max(0.0))
            .fold(0.0, f64::max)
    }
}

/// How an eyeball is turned where vertices are at `moved`.
fn gaze(head: &Head, side: usize, ball: &Ball, moved: &[Vec3]) -> Option<Rotation3<f64>> {
    let mut sum = Matrix3::zeros();
    let mut turns = false;
    for (v, p) in head.mesh.positions.iter().enumerate() {
        if head.follow[v] == Follow::Eyeball(side) {
            turns |= moved[v] != *p;
            sum += (moved[v] - ball.center) * (p - ball.center).transpose();
        }
    }
    turns.then(|| Rotation3::from_matrix(&sum))
}
