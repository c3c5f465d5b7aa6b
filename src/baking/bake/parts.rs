//! Classifies parts other than the skin: sockets behind lids and lips, eyeballs, teeth, tongue, lashes, and worn
//! things.
//!
//! By position and size alone. Units and frame as in [`super::head`]. Cost: linear, and a few k-d tree queries.

use super::eyeball::Ball;
use super::head::{Follow, Head, LANDMARKS};
use super::mesh::{Nearest, Vec3, connected};
use super::mouth::Teeth;
use super::seam::{Seam, distances};
use mien_stages::base::geometry::smoothstep;

/// Size below which a part of the mouth is a tooth and moves rigidly, in eye distances.
const TOOTH: f64 = 1.2;
/// How much nearer along the surface the lower lip must be than the upper one for the mouth's inside to begin to
/// follow the jaw, and to follow it fully, in eye distances: palate and throat are fixed, the tongue bends.
const LOWER: [f64; 2] = [0.05, 0.25];
/// Smoothing sweeps of the shares of the mouth's inside.
const EVENED: usize = 30;

/// Largest width and height of a part in the mouth, in eye distances.
const MOUTH: f64 = 2.2;
/// Least roundness of an iris seen from in front, and of a ball, possibly halved, from the side.
const ROUND: [f64; 2] = [0.7, 0.4];
/// Largest distance of lashes from the line of their lid, in eye distances.
const ON_LID: f64 = 0.08;
/// Largest distance of parts that lie on the skin, in eye distances.
const HUGS: f64 = 0.15;
/// Height above the brows from which a part is hair or a hat, in eye distances.
const HAIR: f64 = 0.6;
/// Largest distance of a point of a face from its nearest vertex, in lengths of the edge.
const BETWEEN: f64 = 0.6;
/// Distance up to which a part belongs to glasses, in eye distances.
const JOINED: f64 = 0.06;
/// Size below which a part moves rigidly, such as a card of hair or a stud, in eye distances.
const BEAD: f64 = 0.35;
/// Number of vertices coincident with the skin's at which a part is the body that the neck joins.
const BORDER: usize = 8;

/// A connected part, with its bounding box in the face's frame.
#[derive(Clone, Default)]
struct Part {
    vertices: Vec<u32>,
    low: Vec3,
    high: Vec3,
}

impl Part {
    fn size(&self) -> Vec3 {
        self.high - self.low
    }

    fn middle(&self) -> Vec3 {
        (self.low + self.high) / 2.0
    }

    fn follow(&self, of: &mut [Follow], how: impl Fn(u32) -> Follow) {
        for &v in &self.vertices {
            of[v as usize] = how(v);
        }
    }

    /// Whether it lies in front of an eye; `unit` is at least the width of an eye.
    fn is_before(&self, eye: &Vec3, unit: f64) -> bool {
        let d = (self.middle() - eye).abs();
        d.x < 0.6 * unit && d.y < 0.5 * unit && d.z < 0.8 * unit && self.size().max() < 1.6 * unit
    }

    /// The side whose eyeball it is, if any.
    fn is_ball(&self, eyes: &[Vec3; 2], w: f64) -> Option<usize> {
        let size = self.size();
        let round = size.x.min(size.y) > ROUND[0] * size.x.max(size.y)
            && size.z > ROUND[1] * size.max()
            && (0.4 * w..1.3 * w).contains(&size.max());
        (0..2).find(|&side| {
            let d = (self.middle() - eyes[side]).abs();
            round && d.x < 0.4 * w && d.y < 0.4 * w && d.z < 0.8 * w
        })
    }
}

impl Head {
    pub(super) fn find_sockets(&mut self) {
        let n = self.mesh.positions.len();
        let seams = [(1, &self.lips), (2, &self.lids[0]), (2, &self.lids[1])];
        let mut line = vec![false; n];
        for v in seams.iter().flat_map(|(_, seam)| seam.both()) {
            line[v as usize] = true;
        }
        let skin = &self.skin;
        let (label, count) = connected(&self.rings, |v| skin[v] && !line[v]);
        let chin = label[self.points[8] as usize];
        // A piece belongs to the line that it touches.
        let mut owner = vec![0_u8; count];
        for (id, seam) in seams {
            for &o in seam.both().flat_map(|v| self.rings.members(v as usize)) {
                let l = label[o as usize];
                if l != u32::MAX && l != chin {
                    owner[l as usize] = id;
                }
            }
        }
        let owned = |v: usize, id: u8| {
            label[v] != u32::MAX && label[v] != chin && owner[label[v] as usize] == id
        };
        for v in (0..n).filter(|&v| owned(v, 1)) {
            self.socket[v] = 0.0;
        }
        let lids: Vec<u32> = self.lids.iter().flat_map(Seam::both).collect();
        self.from_lids = distances(&self.mesh.positions, &self.rings, &lids, |v| owned(v, 2));
        for v in lids {
            self.from_lids[v as usize] = f32::INFINITY;
        }
        self.share_socket();
    }

    /// Shares of the mouth's inside by how much nearer along the surface the lower lip is than the upper one. A tooth
    /// is farther from both by its height, so that it gets the share of its gum, however the rows overlap.
    fn share_socket(&mut self) {
        let (socket, positions) = (&self.socket, &self.mesh.positions);
        let far = |lines: &[&[u32]], corners: f64| {
            let of = |&v: &u32| {
                let t = self.lips.across(&self.mesh, &positions[v as usize]);
                (corners..=1.0 - corners).contains(&t)
            };
            let from: Vec<u32> = lines.concat().into_iter().filter(of).collect();
            distances(positions, &self.rings, &from, |v| !socket[v].is_nan())
        };
        let (upper, lower) = (&self.lips.upper[..], &self.lips.lower[..]);
        // Near the corners both lips are one.
        let (from_upper, from_lower) = (far(&[upper], 0.15), far(&[lower], 0.15));
        let from_lips = far(&[upper, lower], f64::NEG_INFINITY);
        let inside = |v: &usize| !self.socket[*v].is_nan();
        let inside: Vec<usize> = (0..self.socket.len()).filter(inside).collect();
        let nearer = from_upper.iter().zip(&from_lower).map(|(u, l)| u - l);
        let known = nearer.map(|d| if d.is_nan() { 0.0 } else { f64::from(d) });
        let mut nearer: Vec<f64> = known.collect();
        // Smoothed, as paths along edges are ragged and folds between teeth and gums would invert.
        for _ in 0..EVENED {
            let mean = |&v: &usize| {
                let ring = self.rings.members(v).iter().map(|&o| o as usize);
                let ring = ring.filter(|&o| !self.socket[o].is_nan());
                let add = |(sum, count), o: usize| (sum + nearer[o], count + 1.0);
                let (sum, count) = ring.fold((nearer[v], 1.0), add);
                sum / count
            };
            let evened: Vec<f64> = inside.iter().map(mean).collect();
            for (&v, d) in inside.iter().zip(evened) {
                nearer[v] = d;
            }
        }
        let [stays, goes] = LOWER.map(|d| d * self.eye_distance);
        for v in inside {
            self.socket[v] = smoothstep(stays, goes, nearer[v]) as f32;
        }
        self.from_lips = from_lips;
    }

    pub(super) fn find_parts(&mut self, component: &[u32], skin_label: u32) {
        let parts = self.parts(component);
        let eyes = [42..48, 36..42].map(|eye| {
            let sum: Vec3 = eye.map(|k| self.seen(self.point(k))).sum();
            sum / 6.0
        });
        let (mut rest, mut mouth) = (Vec::new(), Vec::new());
        let mut ball_of = vec![None; parts.len()];
        for (c, part) in parts.iter().enumerate() {
            let follow = if c as u32 == skin_label {
                Follow::Skin
            } else if let Some(side) = part.is_ball(&eyes, self.eye_distance) {
                ball_of[c] = Some(side);
                Follow::Eyeball(side)
            } else {
                let inside = self.in_mouth(part);
                if inside { &mut mouth } else { &mut rest }.push(part);
                Follow::Still
            };
            part.follow(&mut self.follow, |_| follow);
        }
        self.find_mouth(&mouth);
        let on = |side: usize, v: usize| ball_of[component[v] as usize] == Some(side);
        let ball = |side: usize| Ball::measured(&self.mesh, &self.axes, |v| on(side, v));
        self.balls = rayon::join(|| ball(0), || ball(1)).into();
        self.attach(&rest, &eyes);
    }

    /// Connected parts, by component number.
    fn parts(&self, component: &[u32]) -> Vec<Part> {
        let count = component.iter().max().map_or(0, |&c| c as usize + 1);
        let mut parts = vec![Part::default(); count];
        for (v, &c) in component.iter().enumerate() {
            let p = self.seen(self.mesh.positions[v]);
            let part = &mut parts[c as usize];
            if part.vertices.is_empty() {
                (part.low, part.high) = (p, p);
            }
            (part.low, part.high) = (part.low.inf(&p), part.high.sup(&p));
            part.vertices.push(v as u32);
        }
        parts
    }

    /// A point in the face's frame.
    fn seen(&self, p: Vec3) -> Vec3 {
        self.axes.transpose() * p
    }

    /// Whether a part is teeth, gums or tongue: small, between the lips and behind them, unlike a moustache.
    fn in_mouth(&self, part: &Part) -> bool {
        let w = self.eye_distance;
        let lip = self.seen(self.point(51));
        let d = part.middle() - self.seen(0.5 * (self.point(60) + self.point(64)));
        let size = part.size();
        d.x.abs() < 0.6 * self.mouth_width
            && d.y.abs() < 0.6 * w
            && (-2.5 * w..0.3 * w).contains(&d.z)
            && size.x < MOUTH * w
            && size.y < MOUTH * w
            && part.high.z < lip.z + 0.05 * w
    }

    /// Assigns the other parts to a ball, a lid, the close skin, or none (rigid).
    fn attach(&mut self, rest: &[&Part], eyes: &[Vec3; 2]) {
        let w = self.eye_distance;
        let positions = &self.mesh.positions;
        // Parts do not attach to skin behind lids and lips.
        let all = 0..positions.len() as u32;
        let skin: Vec<u32> = all.filter(|&v| self.outside(v)).collect();
        let chin = self.seen(self.point(8)).y;
        let above = |&&v: &&u32| self.seen(positions[v as usize]).y > chin;
        let jaw: Vec<u32> = skin.iter().filter(above).copied().collect();
        let [skin, jaw] = [skin, jaw].map(|some| Nearest::new(positions, &some));
        let lines = self.lids.each_ref().map(|seam| [&seam.upper, &seam.lower]);
        let lids = lines.map(|lines| lines.map(|line| Nearest::new(positions, line)));
        // In a cartoon the eye may be wider than the distance between the eyes.
        let unit = w.max((self.point(36) - self.point(39)).norm());
        let (mut rigid, mut close) = (Vec::new(), Vec::new());
        let mut follow = std::mem::take(&mut self.follow);
        for &part in rest {
            // The inner corners are half a distance from the middle; nearer to it is the nose.
            let aside = (part.middle() - 0.5 * (eyes[0] + eyes[1])).x.abs() > 0.4 * w;
            let mut sides = (0..2).filter(|_| aside);
            let side = sides.find(|&side| part.is_before(&eyes[side], unit));
            let on_ball = side.filter(|&side| self.is_on_ball(part, side));
            let lid = side.and_then(|side| self.lid(part, &lids[side]));
            if let Some(side) = on_ball {
                part.follow(&mut follow, |_| Follow::Eyeball(side));
            } else if let Some(lines) = lid {
                self.hang(part, lines, f64::INFINITY, &mut follow);
            } else if self.hugs(part, &skin) {
                close.push(part);
            } else {
                rigid.extend(&part.vertices);
            }
        }
        self.join(&mut close, rigid);
        for part in close {
            let (on, most) = match self.covers_chin(part) {
                true => (&jaw, f64::INFINITY),
                false => (&skin, w),
            };
            self.hang(part, std::slice::from_ref(on), most, &mut follow);
        }
        self.follow = follow;
    }

    /// Makes close parts rigid that touch rigid ones, such as temples, arms and pads of glasses. Brows are excepted,
    /// as they may touch a rim.
    fn join(&self, close: &mut Vec<&Part>, mut rigid: Vec<u32>) {
        let marks: Vec<u32> = self.points.iter().take(LANDMARKS).copied().collect();
        let marks = Nearest::new(&self.mesh.positions, &marks);
        let is_brow = |part: &Part| {
            let nearest = marks.closest(&(self.axes * part.middle()));
            self.points[17..27].iter().any(|&k| Some(k) == nearest)
        };
        for _ in 0..2 {
            let near = Nearest::new(&self.mesh.positions, &rigid);
            close.retain(|part| {
                let gap = self.least_gap(part, &near);
                let stays = gap >= JOINED * self.eye_distance || is_brow(part);
                if !stays {
                    rigid.extend(&part.vertices);
                }
                stays
            });
        }
    }

    /// Whether a part is iris, pupil or cornea: round from in front, within the ball's reach; without a ball, a part
    /// that fills the opening.
    fn is_on_ball(&self, part: &Part, side: usize) -> bool {
        let size = part.size();
        let round = size.x.min(size.y) > ROUND[0] * size.x.max(size.y);
        round
            && self.balls[side].as_ref().is_none_or(|ball| {
                let reach = |p: &Vec3| (p - ball.center).norm() / ball.surface(p);
                let farthest = |&v: &u32| reach(&self.mesh.positions[v as usize]);
                part.vertices.iter().map(farthest).fold(0.0, f64::max) < 1.2
                    && size.x < 1.9 * ball.surface(&(ball.center + self.axes.column(2)))
            })
    }

    /// The lid lines on which a part in front of an eye stands: one for lashes, both for a part that fills the slit.
    fn lid<'a>(&self, part: &Part, lines: &'a [Nearest; 2]) -> Option<&'a [Nearest]> {
        let stands = |line| self.least_gap(part, line) < ON_LID * self.eye_distance;
        match [0, 1].map(|k: usize| stands(&lines[k])) {
            [true, true] => Some(lines),
            [true, false] => Some(&lines[..1]),
            [false, true] => Some(&lines[1..]),
            [false, false] => None,
        }
    }

    /// Attaches every vertex of a part to the nearest of `on`, a small part as a whole.
    fn hang(&self, part: &Part, on: &[Nearest], most: f64, follow: &mut [Follow]) {
        let least = |a: &(f64, u32), b: &(f64, u32)| a.0.total_cmp(&b.0);
        let nearest = |&v: &u32| on.iter().filter_map(|on| self.gap(on, v)).min_by(least);
        let mut found: Vec<_> = part.vertices.iter().map(nearest).collect();
        if part.size().max() < BEAD * self.eye_distance {
            let root = found.iter().flatten().copied().min_by(least);
            found.fill(root);
        }
        for (&v, found) in part.vertices.iter().zip(found) {
            let near = found.filter(|found| found.0 < most);
            follow[v as usize] = near.map_or(Follow::Still, |(_, s)| Follow::Nearest(s));
        }
    }

    /// The nearest of some vertices and its distance.
    pub(super) fn gap(&self, some: &Nearest, v: u32) -> Option<(f64, u32)> {
        let p = &self.mesh.positions[v as usize];
        let s = some.closest(p)?;
        Some(((self.mesh.positions[s as usize] - p).norm(), s))
    }

    /// Least distance of a part from some vertices.
    fn least_gap(&self, part: &Part, some: &Nearest) -> f64 {
        let gap = |&v: &u32| Some(self.gap(some, v)?.0);
        let gaps = part.vertices.iter().filter_map(gap);
        gaps.fold(f64::INFINITY, f64::min)
    }

    /// Whether a part is a beard.
    fn covers_chin(&self, part: &Part) -> bool {
        let [chin, nose] = [8, 33].map(|k| self.seen(self.point(k)));
        let spans = |axis: usize| part.low[axis] < chin[axis] && chin[axis] < part.high[axis];
        (0..3).all(spans) && part.high.y < nose.y
    }

    /// Whether a part lies on the skin of the face nearly everywhere, like a brow or a scar, with less demanded of a
    /// beard or of a body that a neck joins.
    fn hugs(&self, part: &Part, skin: &Nearest) -> bool {
        let w = self.eye_distance;
        let brow = self.seen(0.5 * (self.point(19) + self.point(24))).y;
        let far = |&v: &u32| {
            let (gap, s) = self.gap(skin, v)?;
            // Between the vertices of a coarse skin no vertex is near.
            let ring = self.rings.members(s as usize).iter();
            let at = |v: u32| self.mesh.positions[v as usize];
            let edge = ring.map(|&o| (at(o) - at(s)).norm()).fold(0.0, f64::max);
            Some((gap - BETWEEN * edge).max(0.0))
        };
        let far: Vec<f64> = part.vertices.iter().filter_map(far).collect();
        let within = |most: f64| far.iter().filter(|&&far| far < most * w).count();
        let near = within(HUGS) as f64 / far.len() as f64;
        let is_body = part.middle().y < self.seen(self.point(8)).y && within(1e-3) > BORDER;
        let least = if self.covers_chin(part) { 0.4 } else { 0.9 };
        part.high.y < brow + HAIR * w && (near > least || is_body)
    }

    /// Assigns shares of the jaw's motion to teeth, gums and tongue.
    fn find_mouth(&mut self, parts: &[&Part]) {
        let w = self.eye_distance;
        let mut large: Vec<&Part> = Vec::new();
        let mut teeth: [Vec<u32>; 2] = [Vec::new(), Vec::new()];
        for part in parts {
            if part.size().max() < TOOTH * w {
                let below = self.below_bite(&(self.axes * part.middle())) > 0.0;
                teeth[usize::from(below)].extend(&part.vertices);
                let share = f32::from(u8::from(below));
                part.follow(&mut self.follow, |_| Follow::Jaw(share));
            } else {
                large.push(part);
            }
        }
        if large.is_empty() {
            return;
        }
        let normals = self.mesh.vertex_normals(&self.mesh.positions);
        let nearest = teeth.each_ref();
        let teeth = Teeth {
            nearest: nearest.map(|row| Nearest::new(&self.mesh.positions, row)),
            lower: teeth[1].clone(),
        };
        for part in large {
            let (piece, wide) = (&part.vertices[..], part.size().x);
            let shares = self.jaw_shares(piece, &teeth);
            let shares = shares.unwrap_or_else(|| self.shares_by_place(piece, wide));
            let tongue = self.tongue_shares(piece, &teeth, &shares, &normals);
            for (k, &v) in piece.iter().enumerate() {
                self.follow[v as usize] = Follow::Jaw(shares[k] as f32);
                self.tongue[v as usize] = tongue[k] as f32;
            }
        }
    }
}
