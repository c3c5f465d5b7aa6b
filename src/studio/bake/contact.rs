//! Where skin meets eyeballs and where lips meet: what went too far in a solved shape, and how far back is right.
//!
//! Units: displacements and positions in the mesh's. Memory: a few thousand vertices around the eyes and the lip lines.
//! Limits: only the front half of a ball counts; behind its widest part the socket's skin is out of sight.

use super::head::Head;
use super::measure::lip_gaps;
use super::mesh::Vec3;
use super::recipe::Target;

/// Height that moving lid skin keeps above the eyeball, in eye distances: a lid's edge is not thinner.
pub(super) const LID_MARGIN: f64 = 0.012;
/// Skin further than this from the ball's centre cannot sink into it, in eye distances.
const BALL_REACH: f64 = 0.75;
/// Skin that sank by less than this is left, in eye distances: 4 micrometres.
const SUNK: f64 = 1e-4;
/// Lips that cross by less than this are left, in eye distances: 0.05 mm.
const TOUCH: f64 = 0.0015;

/// What can touch what on one head, measured on the neutral.
pub(super) struct Contacts<'a> {
    head: &'a Head,
    /// Skin near each eyeball: vertex and the height above the ball it must keep.
    beside: [Vec<(u32, f64)>; 2],
    /// Height of the upper above the lower inner lip line.
    lips: Vec<f64>,
}

impl<'a> Contacts<'a> {
    /// Of one head.
    pub(super) fn new(head: &'a Head) -> Self {
        let w = head.eye_distance;
        let beside = [0, 1].map(|side: usize| {
            let Some(ball) = &head.balls[side] else {
                return Vec::new();
            };
            let positions = head.mesh.positions.iter().enumerate();
            positions
                .filter(|&(v, p)| head.skin[v] && (p - ball.center).norm() <= BALL_REACH * w)
                .map(|(v, p)| (v as u32, ball.height(p).min(LID_MARGIN * w)))
                .collect()
        });
        let gaps = lip_gaps(head, |v| head.mesh.positions[v as usize]);
        Self {
            head,
            beside,
            lips: gaps.into_iter().map(|(.., gap)| gap).collect(),
        }
    }

    /// Skin vertices that sank into an eyeball, turned as the shape turns it, deeper than before (or than the margin), with the
    /// displacement that cures it.
    pub(super) fn sunk(&self, d: &[Vec3], target: &Target) -> Vec<(u32, Vec3)> {
        let head = self.head;
        let out = head.axes.column(2);
        let mut found = Vec::new();
        for (side, beside) in self.beside.iter().enumerate() {
            let Some(ball) = &head.balls[side] else {
                continue;
            };
            let ball = ball.turned(target.gaze[side].as_ref());
            for &(v, least) in beside {
                let moved = d[v as usize];
                if moved == Vec3::zeros() {
                    continue;
                }
                let p = head.mesh.positions[v as usize];
                let there = p + moved;
                if (there - ball.center).dot(&out) >= 0.0
                    && ball.height(&there) < least - SUNK * head.eye_distance
                {
                    found.push((v, ball.lifted(&there, least) - p));
                }
            }
        }
        found
    }

    /// Vertices of the inner lip lines that passed the other lip further than in the neutral, each half of the way back.
    pub(super) fn crossed(&self, d: &[Vec3], base: Option<&[Vec3]>) -> Vec<(u32, Vec3)> {
        let head = self.head;
        let up = head.axes.column(1).into_owned();
        let now = lip_gaps(head, |v| {
            let v = v as usize;
            head.mesh.positions[v] + d[v] + base.map_or(Vec3::zeros(), |b| b[v])
        });
        let mut found = Vec::new();
        for (&before, (upper, lower, now)) in self.lips.iter().zip(now) {
            let excess = before.min(0.0) - now;
            let moves = d[upper as usize] != Vec3::zeros() || d[lower as usize] != Vec3::zeros();
            if moves && excess > TOUCH * head.eye_distance {
                found.push((upper, d[upper as usize] + up * (excess / 2.0)));
                found.push((lower, d[lower as usize] - up * (excess / 2.0)));
            }
        }
        found
    }
}
