//! What the baker must know of a head before it deforms it: its axes and distances, which part is skin, which vertices
//! line lids and lips, what lies behind them, and how the parts that are not skin move.
//!
//! Found from the mesh and the 68 landmarks alone, without names of materials:
//! * skin: the connected part that carries the chin;
//! * lid and lip lines: shortest paths along edges through the landmarks of the contour;
//! * sockets: what the skin falls into when those lines are cut out (absent where the mesh is open);
//! * eyeballs: round parts right behind the eyes; jaw, upper teeth, tongue: parts inside the mouth, told apart by the
//!   height of the bite; everything else follows the skin nearest to it (lashes, tear line, brows of their own).
//!
//! Frame: `axes` maps (left, up, out) of the face to mesh coordinates. Units: the mesh's own.
//! Cost: linear, plus a few shortest paths. Limits: a head without eyeballs or teeth simply has none.

use std::collections::BinaryHeap;

use nalgebra::Matrix3;

use super::eyeball::Ball;
use super::laplacian::Operator;
use super::mesh::{Mesh, Rings, Vec3, connected};
use super::mouth::Piece;
use super::names::{LANDMARKS, NAMES};
use super::nearest::Nearest;
use super::solve::stiffness;

/// Why a head cannot be baked.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum HeadError {
    /// Wrong number of landmarks.
    #[error("expected 68 vertex numbers, one a line, found {found}")]
    Count {
        /// How many there are.
        found: usize,
    },
    /// A landmark names no vertex.
    #[error(
        "landmark {landmark} is vertex {vertex}, expected one of the mesh's {vertices} (counted from 0)"
    )]
    Range {
        /// Which of the 68, from 0.
        landmark: usize,
        /// What the file says.
        vertex: u64,
        /// Size of the mesh.
        vertices: usize,
    },
    /// Landmarks do not describe a face.
    #[error(
        "the inner eye corners (landmarks 39 and 42), the chin and the nose tip must be apart and not in a line; found them within {spread}: is the landmark file for this mesh?"
    )]
    Flat {
        /// Extent found, mesh units.
        spread: f64,
    },
    /// Landmarks lie on separate parts.
    #[error(
        "landmark {landmark} lies on another part of the mesh than the chin; all 68 must be on the skin (weld the mesh if the skin is in pieces)"
    )]
    Apart {
        /// Which of the 68, from 0.
        landmark: usize,
    },
}

/// How a part of the mesh that is not skin moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Follow {
    /// Skin: solved.
    Skin,
    /// Eyeball of a side (0 left, 1 right): turns with gaze only.
    Eyeball(usize),
    /// Inside the mouth, with this share of the jaw's motion.
    Jaw(f32),
    /// Moves with the skin vertex given.
    Nearest(u32),
    /// Stays.
    Still,
}

/// Upper and lower line of a lid pair or of the lips, both from the subject's right end to the left end, ends included.
pub struct Seam {
    /// Upper line, vertex numbers.
    pub upper: Vec<u32>,
    /// Lower line.
    pub lower: Vec<u32>,
}

/// The analysed head.
pub struct Head {
    /// The mesh.
    pub mesh: Mesh,
    /// Vertex of each control point: the 68, then the derived ones.
    pub points: Vec<u32>,
    /// Edge neighbours.
    pub rings: Rings,
    /// Laplacian operators.
    pub operator: Operator,
    /// Faces that only fill the slit between two lids or lips: they stretch, and tie nothing together.
    pub film: Vec<bool>,
    /// Vertices of the skin.
    pub skin: Vec<bool>,
    /// Columns: the face's left, up, out in mesh coordinates.
    pub axes: Matrix3<f64>,
    /// Inner-eye-corner distance.
    pub eye_distance: f64,
    /// Lid opening, left and right, mean of the two lid landmark pairs.
    pub eye_opening: [f64; 2],
    /// Distance of the mouth corners.
    pub mouth_width: f64,
    /// Inner lip line.
    pub lips: Seam,
    /// Lid lines, left and right.
    pub lids: [Seam; 2],
    /// Share of the jaw's motion for every vertex behind the lips, `NaN` elsewhere.
    pub socket: Vec<f32>,
    /// Skin behind the lids of either eye.
    pub behind_lids: Vec<bool>,
    /// Eyeballs, left and right.
    pub balls: [Option<Ball>; 2],
    /// How each vertex moves.
    pub follow: Vec<Follow>,
    /// Share of the motion of the tongue's tip.
    pub tongue: Vec<f32>,
    /// Middle of the jaw's axis.
    pub hinge: Vec3,
}

/// A part of the mouth smaller than this is a tooth and moves as a whole, in eye distances.
const TOOTH: f64 = 1.2;

/// Smooth step from 0 at `a` to 1 at `b`.
pub(super) fn smooth(a: f64, b: f64, x: f64) -> f64 {
    let t = ((x - a) / (b - a)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

impl Head {
    /// Analyses a neutral mesh with its 68 landmark vertices.
    ///
    /// # Errors
    /// If the landmarks do not fit the mesh or do not describe a face.
    pub fn new(mesh: Mesh, landmarks: &[u64]) -> Result<Self, HeadError> {
        if landmarks.len() != LANDMARKS {
            return Err(HeadError::Count {
                found: landmarks.len(),
            });
        }
        let n = mesh.positions.len();
        if let Some(landmark) = landmarks.iter().position(|&v| v >= n as u64) {
            return Err(HeadError::Range {
                landmark,
                vertex: landmarks[landmark],
                vertices: n,
            });
        }
        let mut points: Vec<u32> = landmarks.iter().map(|&v| v as u32).collect();
        let at = |k: usize| mesh.positions[points[k] as usize];
        let mean = |ks: &[usize]| ks.iter().map(|&k| at(k)).sum::<Vec3>() / ks.len() as f64;
        let left = at(42) - at(39);
        let brow_to_chin = mean(&[39, 42]) - at(8);
        let eye_distance = left.norm();
        let spread = eye_distance.min(brow_to_chin.norm());
        let left = left.normalize();
        let up = brow_to_chin - left * brow_to_chin.dot(&left);
        if !(spread > 0.0 && up.norm() > 0.1 * eye_distance) {
            return Err(HeadError::Flat { spread });
        }
        // The face leans: "up" is the direction in which both the brow-chin line and the nose agree. Keep the mesh's own
        // vertical where it is close (artists model upright heads), so that symmetric recipes stay upright.
        let up = up.normalize();
        let up = if up.y > 0.8 {
            (Vec3::y() - left * left.y).normalize()
        } else {
            up
        };
        let out = left.cross(&up);
        let axes = Matrix3::from_columns(&[left, up, out]);

        let rings = mesh.rings();
        let (component, _) = mesh.components(&rings);
        let skin_label = component[points[8] as usize];
        let skin: Vec<bool> = component.iter().map(|&c| c == skin_label).collect();
        if let Some(landmark) = points.iter().position(|&v| !skin[v as usize]) {
            return Err(HeadError::Apart { landmark });
        }
        let line = |ks: &[usize]| {
            let mut path = vec![points[ks[0]]];
            for pair in ks.windows(2) {
                path.extend(shortest(&mesh, &rings, points[pair[0]], points[pair[1]]).skip(1));
            }
            path
        };
        let lips = Seam {
            upper: line(&[60, 61, 62, 63, 64]),
            lower: line(&[60, 67, 66, 65, 64]),
        };
        let lids = [
            Seam {
                upper: line(&[42, 43, 44, 45]),
                lower: line(&[42, 47, 46, 45]),
            },
            Seam {
                upper: line(&[36, 37, 38, 39]),
                lower: line(&[36, 41, 40, 39]),
            },
        ];
        let film = films(&mesh, &[&lips, &lids[0], &lids[1]]);
        let eye_opening = [
            0.5 * ((at(43) - at(47)).norm() + (at(44) - at(46)).norm()),
            0.5 * ((at(38) - at(40)).norm() + (at(37) - at(41)).norm()),
        ];
        let mouth_width = (at(48) - at(54)).norm();
        // Fitted to the teeth of a sculpted open jaw: below and behind the ear end of the jaw line, where the axis of a
        // jaw that also slides forwards as it opens comes to lie.
        let hinge = mean(&[0, 16]) - up * (0.70 * eye_distance) - out * (0.35 * eye_distance);
        let operator = {
            let node: Vec<u32> = (0..n as u32).collect();
            // Landmarks of lids and lips.
            let soft: Vec<Vec3> = (36..LANDMARKS).map(at).collect();
            let stiff = |v: usize| {
                let p = mesh.positions[v];
                let nearest = soft
                    .iter()
                    .map(|q| (q - p).norm_squared())
                    .fold(f64::INFINITY, f64::min);
                stiffness(nearest.sqrt() / eye_distance)
            };
            Operator::new(&mesh, &node, n, |f| film[f], stiff)
        };
        let normals = mesh.vertex_normals(&mesh.positions);
        points.extend(derived_points(
            &mesh,
            &skin,
            &normals,
            &axes,
            &points,
            eye_distance,
        ));

        let mut head = Self {
            socket: vec![f32::NAN; n],
            behind_lids: vec![false; n],
            follow: vec![Follow::Still; n],
            tongue: vec![0.0; n],
            balls: [None, None],
            mesh,
            film,
            points,
            rings,
            operator,
            skin,
            axes,
            eye_distance,
            eye_opening,
            mouth_width,
            lips,
            lids,
            hinge,
        };
        head.find_sockets();
        head.find_parts(&component, skin_label);
        Ok(head)
    }

    /// Position of a control point.
    #[must_use]
    pub fn point(&self, k: usize) -> Vec3 {
        self.mesh.positions[self.points[k] as usize]
    }

    /// Height of a point below the bite line, towards the chin; the line runs from between the lips to the hinge.
    fn below_bite(&self, p: &Vec3) -> f64 {
        let lips = 0.5 * (self.point(62) + self.point(66));
        let up = self.axes.column(1).into_owned();
        let out = self.axes.column(2).into_owned();
        // Teeth meet almost level: 4.5 degrees up towards the back.
        let depth = (lips - p).dot(&out);
        (lips - p).dot(&up) + 0.08 * depth
    }

    fn find_sockets(&mut self) {
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
        let soft = 0.06 * self.eye_distance;
        for v in 0..n {
            if label[v] == u32::MAX || label[v] == chin {
                continue;
            }
            match owner[label[v] as usize] {
                1 => {
                    let below = self.below_bite(&self.mesh.positions[v]);
                    self.socket[v] = smooth(-soft, soft, below) as f32;
                }
                2 => self.behind_lids[v] = true,
                _ => {}
            }
        }
    }

    fn find_parts(&mut self, component: &[u32], skin_label: u32) {
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
        for side in 0..2 {
            self.balls[side] = Ball::of(&self.mesh, &self.axes, |v| {
                ball_parts[side].contains(&component[v])
            });
        }
        // Lashes and the like follow the nearest skin around the opening they stand on.
        let candidates: Vec<u32> = (0..n as u32)
            .filter(|&v| self.skin[v as usize])
            .filter(|&v| !self.behind_lids[v as usize] && self.socket[v as usize].is_nan())
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
}

impl Head {
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

/// Faces whose corners all lie on the two lines of one seam, on both of them.
fn films(mesh: &Mesh, seams: &[&Seam]) -> Vec<bool> {
    let mut film = vec![false; mesh.faces()];
    for seam in seams {
        let mut on = vec![(false, false); mesh.positions.len()];
        for &v in &seam.upper {
            on[v as usize].0 = true;
        }
        for &v in &seam.lower {
            on[v as usize].1 = true;
        }
        for (f, film) in film.iter_mut().enumerate() {
            let corner = || mesh.face(f).iter().map(|c| on[c.vertex as usize]);
            *film |= corner().all(|(upper, lower)| upper || lower)
                && corner().any(|(_, lower)| !lower)
                && corner().any(|(upper, _)| !upper);
        }
    }
    film
}

/// Vertices of the shortest way along edges from `a` to `b`; empty after `a` if there is none.
fn shortest(mesh: &Mesh, rings: &Rings, a: u32, b: u32) -> impl Iterator<Item = u32> + use<> {
    #[derive(PartialEq)]
    struct Step(f64, u32);
    impl Eq for Step {}
    impl Ord for Step {
        fn cmp(&self, other: &Self) -> std::cmp::Ordering {
            other.0.total_cmp(&self.0).then(other.1.cmp(&self.1))
        }
    }
    impl PartialOrd for Step {
        fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
            Some(self.cmp(other))
        }
    }
    let mut best = std::collections::HashMap::from([(a, (0.0, a))]);
    let mut heap = BinaryHeap::from([Step(0.0, a)]);
    while let Some(Step(length, v)) = heap.pop() {
        if v == b {
            break;
        }
        if length > best[&v].0 {
            continue;
        }
        for &o in rings.of(v as usize) {
            let edge = mesh.positions[v as usize] - mesh.positions[o as usize];
            let total = length + edge.norm();
            if best.get(&o).is_none_or(|&(known, _)| total < known) {
                best.insert(o, (total, v));
                heap.push(Step(total, o));
            }
        }
    }
    let mut path = Vec::new();
    if best.contains_key(&b) {
        let mut v = b;
        while v != a {
            path.push(v);
            v = best[&v].1;
        }
    }
    path.push(a);
    path.reverse();
    path.into_iter()
}

/// Vertices of the ten derived control points, in the order of [`NAMES`] after the landmarks.
fn derived_points(
    mesh: &Mesh,
    skin: &[bool],
    normals: &[Vec3],
    axes: &Matrix3<f64>,
    points: &[u32],
    w: f64,
) -> Vec<u32> {
    let at = |k: usize| mesh.positions[points[k] as usize];
    let up = axes.column(1).into_owned();
    let out = axes.column(2).into_owned();
    // Aims by combining landmarks of the left side; the right side uses the mirror partners.
    let aims = |m: &dyn Fn(usize) -> usize| {
        let p = |k: usize| at(m(k));
        [
            0.5 * (p(47) + p(35)),
            (p(46) + p(54) + p(14)) / 3.0,
            0.5 * (p(54) + p(11)),
            p(24) + up * (0.5 * w),
            p(23) + up * (1.1 * w),
        ]
    };
    let left = aims(&|k| k);
    let right = aims(&super::names::mirrored);
    debug_assert_eq!(left.len() + right.len() + LANDMARKS, NAMES.len());
    left.into_iter()
        .chain(right)
        .map(|aim| {
            // Seen from in front: distance across counts fully, distance in depth little, as the skin may bulge.
            let cost = |v: usize| {
                let d = mesh.positions[v] - aim;
                let depth = d.dot(&out);
                d.norm_squared() - 0.9 * depth * depth
            };
            (0..mesh.positions.len())
                .filter(|&v| skin[v] && normals[v].dot(&out) > 0.1 && !points.contains(&(v as u32)))
                .min_by(|&a, &b| cost(a).total_cmp(&cost(b)))
                .map_or(points[30], |v| v as u32)
        })
        .collect()
}
