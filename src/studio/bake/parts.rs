//! What of a head is not the skin of the face: sockets behind lids and lips, eyeballs, teeth, tongue, lashes.
//!
//! Told apart by place and size alone. Units and frame as in [`super::head`]. Cost: linear, and a few k-d tree queries.

use super::eyeball::Ball;
use super::head::{Follow, Head, smooth};
use super::mesh::{Vec3, connected};
use super::mouth::Piece;
use super::nearest::Nearest;
use super::seam::{Seam, distances};

/// A part of the mouth smaller than this is a tooth and moves as a whole, in eye distances.
const TOOTH: f64 = 1.2;
/// The mouth's inside stays where the lower lip is nearer than the upper one by less than the first, and goes with the jaw where
/// it is nearer by the second, in eye distances: palate and throat stay, the tongue bends.
const LOWER: [f64; 2] = [0.05, 0.25];
/// Sweeps over the inside that even this out.
const EVENED: usize = 30;

impl Head {
    pub(super) fn find_sockets(&mut self) {
        let n = self.mesh.positions.len();
        let cut = |lines: &[&Seam]| {
            let mut out = vec![false; n];
            for seam in lines {
                for &v in seam.upper.iter().chain(&seam.lower) {
                    out[v as usize] = true;
                }
            }
            out
        };
        let line = cut(&[&self.lips, &self.lids[0], &self.lids[1]]);
        let skin = &self.skin;
        let (label, count) = connected(&self.rings, n, |v| skin[v] && !line[v]);
        let chin = label[self.points[8] as usize];
        // A piece cut off belongs to the line it touches.
        let mut owner = vec![0_u8; count];
        for (id, seam) in [(1, &self.lips), (2, &self.lids[0]), (2, &self.lids[1])] {
            for &v in seam.upper.iter().chain(&seam.lower) {
                for &o in self.rings.of(v as usize) {
                    let l = label[o as usize];
                    if l != u32::MAX && l != chin {
                        owner[l as usize] = id;
                    }
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

    /// Shares of the mouth's inside, by how much nearer along the surface the lower lip is than the upper one: a tooth is as
    /// much further from either as it is high, and so takes the share of the gum it stands on, however the rows overlap.
    fn share_socket(&mut self) {
        let (socket, positions) = (&self.socket, &self.mesh.positions);
        let far = |lines: &[&Vec<u32>], corners: f64| {
            let of = |&v: &u32| {
                let t = self.lips.across(&self.mesh, &positions[v as usize]);
                (corners..=1.0 - corners).contains(&t)
            };
            let from: Vec<u32> = lines
                .iter()
                .flat_map(|l| l.iter().copied().filter(of))
                .collect();
            distances(positions, &self.rings, &from, |v| !socket[v].is_nan())
        };
        let (upper, lower) = (&self.lips.upper, &self.lips.lower);
        // Near the corners both lips are one.
        let (from_upper, from_lower) = (far(&[upper], 0.15), far(&[lower], 0.15));
        let from_lips = far(&[upper, lower], f64::NEG_INFINITY);
        let inside = |v: &usize| !self.socket[*v].is_nan();
        let inside: Vec<usize> = (0..self.socket.len()).filter(inside).collect();
        let mut nearer: Vec<f64> = from_upper
            .iter()
            .zip(&from_lower)
            .map(|(u, l)| f64::from(u - l))
            .map(|d| if d.is_nan() { 0.0 } else { d })
            .collect();
        // Ways along edges are ragged: folds between teeth and gums would turn over.
        for _ in 0..EVENED {
            let mean = |&v: &usize| {
                let ring = self.rings.of(v).iter().map(|&o| o as usize);
                let (mut sum, mut count) = (nearer[v], 1.0);
                for o in ring.filter(|&o| !self.socket[o].is_nan()) {
                    sum += nearer[o];
                    count += 1.0;
                }
                sum / count
            };
            let evened: Vec<f64> = inside.iter().map(mean).collect();
            for (&v, d) in inside.iter().zip(evened) {
                nearer[v] = d;
            }
        }
        let [stays, goes] = LOWER.map(|d| d * self.eye_distance);
        for v in inside {
            self.socket[v] = smooth(stays, goes, nearer[v]) as f32;
        }
        self.from_lips = from_lips;
    }

    pub(super) fn find_parts(&mut self, component: &[u32], skin_label: u32) {
        let n = self.mesh.positions.len();
        let count = component.iter().max().map_or(0, |&c| c as usize + 1);
        let mut boxes = vec![(Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::NEG_INFINITY)); count];
        let face = self.axes.transpose();
        for v in 0..n {
            let p = face * self.mesh.positions[v];
            let b = &mut boxes[component[v] as usize];
            b.0 = b.0.inf(&p);
            b.1 = b.1.sup(&p);
        }
        let w = self.eye_distance;
        let eye = |side: usize| {
            let ks = if side == 0 { 42..48 } else { 36..42 };
            face * (ks.map(|k| self.point(k)).sum::<Vec3>() / 6.0)
        };
        let eyes = [eye(0), eye(1)];
        let mouth = face * (0.5 * (self.point(60) + self.point(64)));
        let mut kind = vec![Follow::Still; count];
        let mut ball_parts: [Vec<u32>; 2] = [Vec::new(), Vec::new()];
        let mut attached = vec![false; count];
        for c in 0..count {
            let (low, high) = boxes[c];
            let (size, middle) = (high - low, (high + low) / 2.0);
            if c as u32 == skin_label {
                kind[c] = Follow::Skin;
                continue;
            }
            let side = (0..2).find(|&s| {
                let d = middle - eyes[s];
                d.x.abs() < 0.4 * w && d.y.abs() < 0.4 * w && d.z.abs() < 0.8 * w
            });
            let round =
                size.min() > 0.6 * size.max() && size.max() > 0.4 * w && size.max() < 1.3 * w;
            if let Some(side) = side.filter(|_| round) {
                kind[c] = Follow::Eyeball(side);
                ball_parts[side].push(c as u32);
                continue;
            }
            let d = middle - mouth;
            let inside = d.x.abs() < 0.6 * self.mouth_width
                && d.y.abs() < 0.6 * w
                && d.z < 0.3 * w
                && d.z > -2.5 * w;
            if inside {
                // Told apart below, vertex by vertex for parts that cross the bite.
                kind[c] = Follow::Jaw(f32::NAN);
            } else {
                attached[c] = true;
            }
        }
        for v in 0..n {
            self.follow[v] = kind[component[v] as usize];
        }
        self.find_mouth(component, &boxes);
        let on = |side: usize, v: usize| ball_parts[side].contains(&component[v]);
        let ball = |side: usize| Ball::of(&self.mesh, &self.axes, |v| on(side, v));
        self.balls = rayon::join(|| ball(0), || ball(1)).into();
        // Lashes and the like follow the nearest skin around the opening they stand on.
        let candidates: Vec<u32> = (0..n as u32)
            .filter(|&v| self.skin[v as usize])
            .filter(|&v| {
                self.from_lids[v as usize].is_infinite() && self.socket[v as usize].is_nan()
            })
            .collect();
        let nearest = Nearest::new(&self.mesh.positions, &candidates);
        for v in 0..n {
            if attached[component[v] as usize] && !self.rings.of(v).is_empty() {
                let p = self.mesh.positions[v];
                if let Some(s) = nearest.of(&p) {
                    let near = (self.mesh.positions[s as usize] - p).norm() < w;
                    self.follow[v] = if near {
                        Follow::Nearest(s)
                    } else {
                        Follow::Still
                    };
                }
            }
        }
    }

    /// Shares of teeth, gums and tongue; `boxes` are the parts' in the face frame.
    fn find_mouth(&mut self, component: &[u32], boxes: &[(Vec3, Vec3)]) {
        let w = self.eye_distance;
        let mut large: Vec<(u32, Vec<u32>)> = Vec::new();
        let mut teeth: [Vec<u32>; 2] = [Vec::new(), Vec::new()];
        for v in 0..self.follow.len() {
            if !matches!(self.follow[v], Follow::Jaw(_)) {
                continue;
            }
            let (low, high) = boxes[component[v] as usize];
            if (high - low).max() < TOOTH * w {
                let below = self.below_bite(&(self.axes * ((low + high) / 2.0))) > 0.0;
                teeth[usize::from(below)].push(v as u32);
                self.follow[v] = Follow::Jaw(f32::from(u8::from(below)));
                continue;
            }
            match large.iter_mut().find(|(c, _)| *c == component[v]) {
                Some((_, vertices)) => vertices.push(v as u32),
                None => large.push((component[v], vec![v as u32])),
            }
        }
        if large.is_empty() {
            return;
        }
        let normals = self.mesh.vertex_normals(&self.mesh.positions);
        for (_, vertices) in &large {
            let piece = Piece {
                vertices,
                teeth: [0, 1].map(|row: usize| Nearest::new(&self.mesh.positions, &teeth[row])),
                lower: &teeth[1],
                positions: &self.mesh.positions,
                normals: &normals,
                rings: &self.rings,
                operator: &self.operator,
                up: self.axes.column(1).into_owned(),
                out: self.axes.column(2).into_owned(),
                eye_distance: w,
            };
            let soft = 0.08 * w;
            let shares = piece.shares().unwrap_or_else(|| {
                let height = |&v: &u32| self.below_bite(&self.mesh.positions[v as usize]);
                vertices
                    .iter()
                    .map(|v| smooth(-soft, soft, height(v)))
                    .collect()
            });
            let tongue = piece.tongue(&shares);
            for (k, &v) in vertices.iter().enumerate() {
                self.follow[v as usize] = Follow::Jaw(shares[k] as f32);
                self.tongue[v as usize] = tongue[k] as f32;
            }
        }
    }
}
