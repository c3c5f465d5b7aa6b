//! Where skin meets eyeballs, where lips meet and where the mouth's inside meets the skin before it: what went too far in a
//! solved shape, and how far back is right.
//!
//! Units: displacements and positions in the mesh's. Memory: a few thousand vertices around the eyes and the lip lines.
//! Limits: only the front half of a ball counts; behind its widest part the socket's skin is out of sight.

use super::head::Head;
use super::mesh::{Nearest, Vec3};
use super::recipe::Target;

/// Height that moving lid skin keeps above the eyeball, in eye distances: a lid's edge is not thinner.
pub(super) const LID_MARGIN: f64 = 0.012;
/// Skin further than this from the ball's centre cannot sink into it, in eye distances.
const BALL_REACH: f64 = 0.75;
/// Skin that sank by less than this is left, in eye distances: 4 micrometres.
const SUNK: f64 = 1e-4;
/// Lips that cross by less than this are left, in eye distances: 0.05 mm.
const TOUCH: f64 = 0.0015;
/// The mouth's inside can come through skin no further before it than this, and stays this far behind it, in eye distances.
const EDGE: f64 = 0.1;
const BEFORE: f64 = 0.2;
const BEHIND: f64 = 0.015;

/// What can touch what on one head, measured on the neutral.
pub(super) struct Contacts<'a> {
    pub(super) head: &'a Head,
    /// Skin near an eyeball: its side, the vertex and the height above the ball it must keep.
    beside: Vec<(usize, u32, f64)>,
    /// Height of the upper above the lower inner lip line.
    lips: Vec<f64>,
    /// The mouth's inside: vertex, the nearest of the skin before it, and how far behind that it must stay.
    inside: Vec<(u32, u32, f64)>,
    /// Corners of the skin's faces: vertex, the one after and the one before it in the face; ascending.
    corners: Vec<[u32; 3]>,
}

impl<'a> Contacts<'a> {
    /// Of one head.
    pub(super) fn new(head: &'a Head) -> Self {
        let w = head.eye_distance;
        let mut beside = Vec::new();
        for (side, ball) in head.balls.iter().enumerate() {
            let Some(ball) = ball else { continue };
            let positions = head.mesh.positions.iter().enumerate();
            let near = positions
                .filter(|&(v, p)| head.skin[v] && (p - ball.center).norm() <= BALL_REACH * w);
            let height = |p| ball.height(p).min(LID_MARGIN * w);
            beside.extend(near.map(|(v, p)| (side, v as u32, height(p))));
        }
        let mut corners = Vec::new();
        for f in (0..head.mesh.faces()).filter(|&f| !head.film[f]) {
            let face = head.mesh.face(f);
            let of = |k: usize| face[k % face.len()].vertex;
            let all = (0..face.len()).map(|k| [of(k), of(k + 1), of(k + face.len() - 1)]);
            corners.extend(all.filter(|c| head.outside(c[0])));
        }
        corners.sort_unstable();
        let gaps = head.lip_gaps(|v| head.mesh.positions[v as usize]);
        let mut out = Self {
            head,
            beside,
            lips: gaps.into_iter().map(|(.., gap)| gap).collect(),
            inside: Vec::new(),
            corners,
        };
        out.inside = out.behind_skin();
        out
    }

    /// The mouth's inside where skin is close before it.
    fn behind_skin(&self) -> Vec<(u32, u32, f64)> {
        let (head, w) = (self.head, self.head.eye_distance);
        let at = |v: u32| head.mesh.positions[v as usize];
        let skin = (0..head.skin.len() as u32).filter(|&v| head.skin[v as usize]);
        let (outside, inside): (Vec<u32>, Vec<u32>) = skin.partition(|&v| head.outside(v));
        let nearest = Nearest::new(&head.mesh.positions, &outside);
        let close = inside.into_iter().filter_map(|v| {
            let before = nearest.of(&at(v))?;
            let apart = at(before) - at(v);
            let behind = apart.dot(&self.normal(before, &at));
            let from_line = head.from_lips[v as usize].min(2.0 * head.from_lids[v as usize]);
            let close = apart.norm() < BEFORE * w && f64::from(from_line) > EDGE * w;
            (close && behind > 0.0).then(|| (v, before, behind.min(BEHIND * w)))
        });
        close.collect()
    }

    /// On the line of lips or lids or beside it: what is nearest to it may be seen between them.
    fn at_line(&self, v: u32) -> bool {
        let seams = || [&self.head.lips].into_iter().chain(&self.head.lids);
        let on = |v: &u32| seams().any(|seam| seam.both().any(|o| o == *v));
        on(&v) || self.head.rings.of(v as usize).iter().any(on)
    }

    /// Normal of the skin at a vertex, by the ring around it.
    fn normal(&self, v: u32, at: &impl Fn(u32) -> Vec3) -> Vec3 {
        let first = self.corners.partition_point(|c| c[0] < v);
        let corners = self.corners[first..].iter().take_while(|c| c[0] == v);
        let sum: Vec3 = corners
            .map(|&[_, a, b]| (at(a) - at(v)).cross(&(at(b) - at(v))))
            .sum();
        sum.try_normalize(0.0).unwrap_or_default()
    }

    /// Vertices of the mouth's inside that came through the skin, moved back behind it: nobody sees them there.
    pub(super) fn pierced(&self, d: &[Vec3], base: Option<&[Vec3]>) -> Vec<(u32, Vec3)> {
        let head = self.head;
        let moved = head.moved(d, base);
        let at = |v: u32| moved(v as usize);
        let mut found = Vec::new();
        for &(v, before, behind) in &self.inside {
            if d[v as usize] == Vec3::zeros() && d[before as usize] == Vec3::zeros() {
                continue;
            }
            let (p, mut skin) = (at(v), before);
            // The skin has slid along: what is nearest now is a few edges away.
            let far = |o: u32| (at(o) - p).norm_squared();
            loop {
                let ring = head.rings.of(skin as usize).iter();
                let ring = ring.filter(|&&o| self.head.outside(o));
                match ring.min_by(|&&a, &&b| far(a).total_cmp(&far(b))) {
                    Some(&nearer) if far(nearer) < far(skin) => skin = nearer,
                    _ => break,
                }
            }
            let normal = self.normal(skin, &at);
            let depth = (at(skin) - p).dot(&normal);
            let near = far(skin).sqrt() < 0.5 * BEFORE * head.eye_distance;
            if depth < 0.0 && near && !self.at_line(skin) {
                found.push((v, d[v as usize] - normal * (behind - depth)));
            }
        }
        found
    }

    /// Skin vertices that sank into an eyeball, turned as the shape turns it, deeper than before (or than the margin), with the
    /// displacement that cures it.
    pub(super) fn sunk(&self, d: &[Vec3], target: &Target) -> Vec<(u32, Vec3)> {
        let head = self.head;
        let out = head.axes.column(2);
        let balls = [0, 1].map(|side: usize| {
            let ball = head.balls[side].as_ref()?;
            Some(ball.turned(target.gaze[side].as_ref()))
        });
        let sunk = self.beside.iter().filter_map(|&(side, v, least)| {
            let (ball, moved) = (balls[side].as_ref()?, d[v as usize]);
            let p = head.mesh.positions[v as usize];
            let there = p + moved;
            let sank = moved != Vec3::zeros()
                && (there - ball.center).dot(&out) >= 0.0
                && ball.height(&there) < least - SUNK * head.eye_distance;
            sank.then(|| (v, ball.lifted(&there, least) - p))
        });
        sunk.collect()
    }

    /// Vertices of the inner lip lines that passed the other lip further than in the neutral, each half of the way back.
    pub(super) fn crossed(&self, d: &[Vec3], base: Option<&[Vec3]>) -> Vec<(u32, Vec3)> {
        let head = self.head;
        let up = head.axes.column(1).into_owned();
        let moved = head.moved(d, base);
        let now = head.lip_gaps(|v| moved(v as usize));
        let both = self.lips.iter().zip(now);
        let crossed = both.filter_map(|(&before, (upper, lower, now))| {
            let excess = before.min(0.0) - now;
            let back = up * (excess / 2.0);
            let [above, below] = [upper, lower].map(|v| d[v as usize]);
            let moves = above != Vec3::zeros() || below != Vec3::zeros();
            let crosses = moves && excess > TOUCH * head.eye_distance;
            crosses.then(|| [(upper, above + back), (lower, below - back)])
        });
        crossed.flatten().collect()
    }
}
