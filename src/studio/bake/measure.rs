//! What the report says of a baked shape: leakage, inverted and collapsed triangles, symmetry, lids and lips.

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
    /// RMS difference to the mirrored partner over RMS motion, if there is one and the mesh is symmetric.
    pub asymmetry: Option<f64>,
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
    mirror: Option<Vec<u32>>,
}

impl<'a> Judge<'a> {
    /// Prepares the neutral's figures.
    #[must_use]
    pub fn new(head: &'a Head) -> Self {
        Self {
            mirror: mirror(head),
            head,
            around: Surroundings::new(head),
        }
    }

    /// Figures of shape `k`; shapes meant for another one are judged upon it.
    #[must_use]
    pub fn judge(&self, shapes: &[Shape], k: usize) -> Figures {
        let head = self.head;
        let shape = &shapes[k];
        let w = head.eye_distance;
        let base: Vec<&Shape> = shape.beneath(shapes).collect();
        let moved: Vec<Vec3> = (0..shape.displacement.len())
            .map(|v| {
                let below = base.iter().map(|b| b.displacement[v]);
                head.mesh.positions[v] + below.sum::<Vec3>() + shape.displacement[v]
            })
            .collect();
        let mut out = Figures::default();
        for (v, d) in shape.displacement.iter().enumerate() {
            let length = d.norm() / w;
            out.largest = out.largest.max(length);
            out.moved += usize::from(length > 0.0);
            if !shape.area[v] {
                out.outside = out.outside.max(length);
            }
        }
        let changed: Vec<u32> = (0..moved.len() as u32)
            .filter(|&v| moved[v as usize] != head.mesh.positions[v as usize])
            .collect();
        let mut scratch = self.around.scratch();
        let some = self.around.seeing(&changed, &mut scratch);
        (out.inverted, out.collapsed) = self.around.inverted(&|v| moved[v], &some, &mut scratch);
        out.asymmetry = self.asymmetry(shapes, k);
        for (side, ball) in head.balls.iter().enumerate() {
            let Some(ball) = ball else { continue };
            let turned = ball.turned(gaze(head, side, ball, &moved).as_ref());
            for v in 0..moved.len() {
                let p = head.mesh.positions[v];
                let near = head.skin[v] && (p - ball.center).norm() < 0.75 * w;
                if near && (moved[v] - ball.center).dot(&head.axes.column(2)) > 0.0 {
                    let deeper = (-turned.height(&moved[v])).max(0.0) - (-ball.height(&p)).max(0.0);
                    out.eye_depth = out.eye_depth.max(deeper / w);
                }
            }
            let closes = if side == 0 {
                "eyeBlinkLeft"
            } else {
                "eyeBlinkRight"
            };
            if shape.name == closes {
                out.lid_gap = Some(lid_gap(head, side, |v| moved[v as usize]) / w);
            }
        }
        let before = lip_gaps(head, |v| head.mesh.positions[v as usize]);
        let now = lip_gaps(head, |v| moved[v as usize]);
        for ((.., before), (.., now)) in before.into_iter().zip(now) {
            let crossing = (-now).max(0.0) - (-before).max(0.0);
            out.lips_cross = out.lips_cross.max(crossing / w);
        }
        out
    }

    fn asymmetry(&self, shapes: &[Shape], k: usize) -> Option<f64> {
        let mirror = self.mirror.as_ref()?;
        let name = &shapes[k].name;
        let partner = if name.contains("Left") {
            name.replace("Left", "Right")
        } else if name.contains("Right") {
            name.replace("Right", "Left")
        } else {
            name.clone()
        };
        let other = shapes.iter().find(|s| s.name == partner)?;
        let left = self.head.axes.column(0).into_owned();
        let (mut miss, mut size) = (0.0, 0.0);
        for (v, d) in shapes[k].displacement.iter().enumerate() {
            if mirror[v] == u32::MAX {
                continue;
            }
            let there = other.displacement[mirror[v] as usize];
            let flipped = there - left * (2.0 * there.dot(&left));
            miss += (d - flipped).norm_squared();
            size += d.norm_squared();
        }
        (size > 0.0).then(|| (miss / size).sqrt())
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

/// Mirror partner of every vertex (`u32::MAX` for few without), or `None` for a mesh that is not symmetric.
fn mirror(head: &Head) -> Option<Vec<u32>> {
    let left = head.axes.column(0).into_owned();
    let middle = 0.5 * (head.point(39) + head.point(42));
    let cell = 0.01 * head.eye_distance;
    let key = |p: &Vec3| [0, 1, 2].map(|k| (p[k] / cell).round() as i64);
    let mut grid: std::collections::HashMap<[i64; 3], Vec<u32>> = std::collections::HashMap::new();
    for (v, p) in head.mesh.positions.iter().enumerate() {
        grid.entry(key(p)).or_default().push(v as u32);
    }
    let mut missing = 0;
    let partners: Vec<u32> = head
        .mesh
        .positions
        .iter()
        .map(|p| {
            let flipped = p - left * (2.0 * (p - middle).dot(&left));
            let k = key(&flipped);
            let mut best = (cell, u32::MAX);
            for shift in 0..27_i64 {
                let near = [
                    k[0] + shift % 3 - 1,
                    k[1] + shift / 3 % 3 - 1,
                    k[2] + shift / 9 - 1,
                ];
                for &o in grid.get(&near).into_iter().flatten() {
                    let d = (head.mesh.positions[o as usize] - flipped).norm();
                    if d < best.0 {
                        best = (d, o);
                    }
                }
            }
            missing += usize::from(best.1 == u32::MAX);
            best.1
        })
        .collect();
    (missing * 20 < partners.len()).then_some(partners)
}
