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
    #[must_use]
    pub fn new(head: &'a Head) -> Self {
        Self {
            head,
            around: Surroundings::new(head),
        }
    }

    /// Figures of shape `k`; shapes meant for another one are judged upon it.
    #[must_use]
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
                    out.lid_gap = Some(lid_gap(head, side, |v| moved[v as usize]) / w);
                }
            }
        }
        let before = lip_gaps(head, |v| neutral[v as usize]);
        let now = lip_gaps(head, |v| moved[v as usize]);
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

/// Largest distance of a vertex of the upper lid line from the lower one, mesh units; `p` is where vertices are. Not the other way
/// round: the lower line goes on about the lacrimal caruncle, which no lid covers.
pub(super) fn lid_gap(head: &Head, side: usize, p: impl Fn(u32) -> Vec3) -> f64 {
    let seam = &head.lids[side];
    let far = |&v: &u32| {
        let spans = seam.lower.windows(2).map(|s| {
            let (a, line) = (p(s[0]), p(s[1]) - p(s[0]));
            let along = (p(v) - a).dot(&line) / line.norm_squared().max(1e-300);
            (a + line * along.clamp(0.0, 1.0) - p(v)).norm()
        });
        spans.fold(f64::INFINITY, f64::min)
    };
    seam.upper.iter().map(far).fold(0.0, f64::max)
}

/// For every vertex of the upper inner lip line: itself, the vertex of the lower line nearest below or above it, and its
/// height above the lower line there. Beyond the corners there is nothing to cross.
pub(super) fn lip_gaps(head: &Head, p: impl Fn(u32) -> Vec3) -> Vec<(u32, u32, f64)> {
    let (left, up) = (head.axes.column(0), head.axes.column(1));
    let flat = |v: u32| (p(v).dot(&left), p(v).dot(&up));
    let lower = &head.lips.lower;
    let upper = &head.lips.upper;
    upper[1..upper.len() - 1]
        .iter()
        .map(|&v| {
            let (x, y) = flat(v);
            let met = lower.windows(2).find_map(|s| {
                let ((ax, ay), (bx, by)) = (flat(s[0]), flat(s[1]));
                if bx == ax || (x - ax) * (x - bx) > 0.0 {
                    return None;
                }
                let t = (x - ax) / (bx - ax);
                Some((s[usize::from(t > 0.5)], y - (ay + (by - ay) * t)))
            });
            let (other, gap) = met.unwrap_or((lower[0], f64::INFINITY));
            (v, other, gap)
        })
        .collect()
}
