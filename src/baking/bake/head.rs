//! Analysis of a head before it is deformed: axes and distances, skin, lid and lip lines, the cavities behind them,
//! and how parts other than skin move.
//!
//! Uses only the mesh and the 68 landmarks, no names of materials:
//! * skin: the connected part that carries the chin;
//! * lid and lip lines: shortest paths along edges through the landmarks of the contour, for lids on one edge of the
//!   rim;
//! * sockets: the regions that cutting along those lines separates (none where the mesh is open);
//! * eyeballs: round parts right behind the eyes; lower jaw, upper teeth, tongue: parts inside the mouth,
//!   distinguished by the height of the bite; parts on lids, balls or skin follow them, all others are worn and rigid.
//!
//! Frame: `axes` maps (left, up, out) of the face to mesh coordinates. Units: the mesh's. Cost: linear, plus a few
//! shortest paths. Limits: without eyeballs or teeth in the mesh, none are assumed.

use nalgebra::Matrix3;

use super::eyeball::Ball;
use super::laplacian::Operator;
use super::mesh::{Mesh, Nearest, Rings, Vec3};
pub use super::names::LANDMARKS;
use super::names::mirrored;
use super::seam::{Seam, distances, lines, membranes};
use super::solve::stiffness;
use mien_workbench::fault::Fault;

/// An error: other than 68 landmarks.
pub fn wrong_landmark_count(found: usize) -> Fault {
    Fault::new(format!(
        "expected 68 vertex numbers, one a line, found {found}"
    ))
}

/// An error: a landmark, counted from 0, refers to no vertex.
pub(super) fn no_such_vertex(landmark: usize, vertex: u64, vertices: usize) -> Fault {
    Fault::new(format!(
        "landmark {landmark} is vertex {vertex}, expected one of the mesh's {vertices} (counted from 0)"
    ))
}

/// An error: a landmark, counted from 0, lies on a part that is not connected to the others'.
pub fn not_on_one_part(landmark: usize) -> Fault {
    Fault::new(format!(
        "landmark {landmark} lies on another part of the mesh than the chin; all 68 must be on the skin (weld the mesh if the skin is in pieces)"
    ))
}

/// Inside of the mouth up to this distance from the lip line along the surface deforms freely, in eye distances.
pub(super) const LIP_FREE: f64 = 0.2;
/// Largest distance of a lid's line from a landmark, in eye distances: landmarks may lie on either edge of the rim.
const LID_SLACK: f64 = 0.07;
/// Skin behind lids from this distance from their lines on is fixed, in eye distances: it lines the socket.
const LID_FREE: f64 = 0.12;

/// Height of the jaw's axis above the chin, as share of the ears'.
const HINGE: f64 = 0.55;
/// Height of the jaw's axis above the chin over its distance behind the chin.
const RATIO: f64 = 0.72;

/// Largest ratio of the path along the surface to the straight distance between the inner lip lines for joined lips.
const INNER: f64 = 1.5;
/// Largest ratio of the path along the surface to the straight distance between the outer lips for joined lips.
const OUTER: f64 = 2.0;
/// Distance by which the path between the inner lip lines may exceed its bound, in eye distances.
const TOUCHING: f64 = 0.02;

/// How a vertex moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Follow {
    /// Skin: solved.
    Skin,
    /// Eyeball of a side (0 left, 1 right): turns with gaze only.
    Eyeball(usize),
    /// Inside the mouth: follows the jaw by this share.
    Jaw(f32),
    /// Follows this skin vertex.
    Nearest(u32),
    /// Fixed.
    Still,
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
    /// Faces that span the slit between two lids or lips: they stretch and do not couple the two sides.
    pub membrane: Vec<bool>,
    /// Vertices of the skin.
    pub skin: Vec<bool>,
    /// Columns: the face's left, up, out in mesh coordinates.
    pub axes: Matrix3<f64>,
    /// Inner-eye-corner distance.
    pub eye_distance: f64,
    /// Lid opening, left and right, mean of the two lid landmark pairs.
    pub eye_opening: [f64; 2],
    /// Height of both lids' rims, from where they meet to their edges in front, left and right.
    pub lid_rim: [f64; 2],
    /// Distance of the mouth corners.
    pub mouth_width: f64,
    /// Inner lip line.
    pub lips: Seam,
    /// Lid lines, left and right.
    pub lids: [Seam; 2],
    /// Share of the jaw's motion for every vertex behind the lips, `NaN` elsewhere.
    pub socket: Vec<f32>,
    /// Distance of the mouth's inside from the lip lines along the surface, infinite elsewhere.
    pub from_lips: Vec<f32>,
    /// Distance of the skin behind the lids from their lines along the surface, infinite elsewhere.
    pub from_lids: Vec<f32>,
    /// Eyeballs, left and right.
    pub balls: [Option<Ball>; 2],
    /// How each vertex moves.
    pub follow: Vec<Follow>,
    /// Share of the motion of the tongue's tip.
    pub tongue: Vec<f32>,
    /// Middle of the jaw's axis.
    pub hinge: Vec3,
}

/// Landmark numbers as vertices of a mesh.
fn vertices(mesh: &Mesh, landmarks: &[u64]) -> Result<Vec<u32>, Fault> {
    let vertices = mesh.positions.len();
    if landmarks.len() != LANDMARKS {
        return Err(wrong_landmark_count(landmarks.len()));
    }
    let vertex = |(landmark, &v): (usize, &u64)| match v < vertices as u64 {
        true => Ok(v as u32),
        false => Err(no_such_vertex(landmark, v, vertices)),
    };
    landmarks.iter().enumerate().map(vertex).collect()
}

/// The face's axes (columns left, up, out) and its inner-eye-corner distance, from the landmarks' positions.
fn frame(at: impl Fn(usize) -> Vec3) -> Result<(Matrix3<f64>, f64), Fault> {
    let left = at(42) - at(39);
    let brow_to_chin = (at(39) + at(42)) / 2.0 - at(8);
    let eye_distance = left.norm();
    let spread = eye_distance.min(brow_to_chin.norm());
    let left = left.normalize();
    let up = brow_to_chin - left * brow_to_chin.dot(&left);
    if !(spread > 0.0 && up.norm() > 0.1 * eye_distance) {
        return Err(Fault::new(format!(
            "the inner eye corners (landmarks 39 and 42), the chin and the nose tip must be apart and not in a line; found them within {spread}: is the landmark file for this mesh?"
        )));
    }
    // "Up" is the mean of the brow-chin line and the nose. It snaps to a close axis of the mesh, as artists model
    // upright heads, so that symmetric recipes stay symmetric.
    let mut up = up.normalize();
    let axis = up.iamax();
    if up[axis].abs() > 0.8 {
        let upright = Vec3::ith(axis, up[axis].signum());
        up = (upright - left * left.dot(&upright)).normalize();
    }
    let axes = Matrix3::from_columns(&[left, up, left.cross(&up)]);
    Ok((axes, eye_distance))
}

/// Middle of the jaw's axis, from the landmarks' positions; `axes` as in [`Head`]. In four rigs made by hand the
/// pivot of the lower teeth lies at .36 to .62 of the height from chin to ear, and that height over its distance
/// behind the chin is .69 to .82.
fn hinge(at: impl Fn(usize) -> Vec3, axes: &Matrix3<f64>) -> Vec3 {
    let (up, out) = (axes.column(1), axes.column(2));
    let ears = (at(0) + at(16)) / 2.0;
    let from_chin = ears - at(8);
    let height = HINGE * from_chin.dot(&up);
    let beside_chin = ears - up * from_chin.dot(&up) - out * from_chin.dot(&out);
    beside_chin + up * height - out * (height / RATIO)
}

/// Seams of lips, left lids and right lids, moving each lid landmark onto its line, at most by `slack`; `out` points
/// out of the face.
fn seams(mesh: &Mesh, rings: &Rings, points: &mut [u32], out: Vec3, slack: f64) -> [Seam; 3] {
    let mut seam = |upper: &[usize], lower: &[usize], slack: f64| {
        let vertices = |ks: &[usize]| ks.iter().map(|&k| points[k]).collect::<Vec<u32>>();
        let (on, below) = (vertices(upper), vertices(lower));
        let front = (slack > 0.0).then_some(out);
        let (seam, through) = lines(mesh, rings, [&on, &below], slack, front);
        for (&k, v) in upper.iter().chain(lower).zip(through.concat()) {
            points[k] = v;
        }
        seam
    };
    [
        seam(&[60, 61, 62, 63, 64], &[60, 67, 66, 65, 64], 0.0),
        seam(&[42, 43, 44, 45], &[42, 47, 46, 45], slack),
        seam(&[36, 37, 38, 39], &[36, 41, 40, 39], slack),
    ]
}

impl Head {
    /// Analyses a neutral mesh with its 68 landmark vertices.
    ///
    /// # Errors
    /// If the landmarks do not fit the mesh or do not describe a face.
    pub fn new(mesh: Mesh, landmarks: &[u64]) -> Result<Self, Fault> {
        let mut points = vertices(&mesh, landmarks)?;
        let n = mesh.positions.len();
        let (axes, eye_distance) = frame(|k| mesh.positions[points[k] as usize])?;
        let out = axes.column(2).into_owned();
        let rings = mesh.rings();
        let (component, _) = mesh.components(&rings);
        let skin_label = component[points[8] as usize];
        let skin: Vec<bool> = component.iter().map(|&c| c == skin_label).collect();
        if let Some(landmark) = points.iter().position(|&v| !skin[v as usize]) {
            return Err(not_on_one_part(landmark));
        }
        let given = points.clone();
        let [lips, left, right] = seams(&mesh, &rings, &mut points, out, LID_SLACK * eye_distance);
        let membrane = membranes(&mesh, &[&lips, &left, &right]);
        let at = |k: usize| mesh.positions[points[k] as usize];
        let apart = |[a, b]: [usize; 2]| (at(a) - at(b)).norm();
        let lid_pairs = [[[43, 47], [44, 46]], [[38, 40], [37, 41]]];
        let eye_opening = lid_pairs.map(|[a, b]| 0.5 * (apart(a) + apart(b)));
        let mouth_width = apart([48, 54]);
        let moved = |k: usize| (mesh.positions[given[k] as usize] - at(k)).dot(&axes.column(1));
        let rim = |[a, b]: [usize; 2]| 0.5 * (moved(a) - moved(b));
        let lid_rim = lid_pairs.map(|[a, b]| (rim(a) + rim(b)).max(0.0));
        let hinge = hinge(at, &axes);
        // Landmarks of lids and lips, where the skin is thin.
        let soft: Vec<Vec3> = (36..LANDMARKS).map(at).collect();
        let stiff = |v: usize| {
            let far = soft.iter().map(|q| (q - mesh.positions[v]).norm_squared());
            stiffness(far.fold(f64::INFINITY, f64::min).sqrt() / eye_distance)
        };
        let operator = Operator::new(&mesh, |f| membrane[f], stiff);
        let mut head = Self {
            socket: vec![f32::NAN; n],
            from_lips: vec![f32::INFINITY; n],
            from_lids: vec![f32::INFINITY; n],
            follow: vec![Follow::Still; n],
            tongue: vec![0.0; n],
            balls: [None, None],
            mesh,
            membrane,
            points,
            rings,
            operator,
            skin,
            axes,
            eye_distance,
            eye_opening,
            lid_rim,
            mouth_width,
            lips,
            lids: [left, right],
            hinge,
        };
        head.points.extend(head.derived_points());
        head.find_sockets();
        head.find_parts(&component, skin_label);
        Ok(head)
    }

    /// Vertices of the ten derived control points, in the order of [`super::names::NAMES`] after the landmarks.
    fn derived_points(&self) -> Vec<u32> {
        let Self { mesh, points, .. } = self;
        let normals = mesh.vertex_normals(&mesh.positions);
        let (up, out) = (self.axes.column(1), self.axes.column(2));
        // Combinations of landmarks of the left side; the right side uses the mirror partners.
        let aims = |m: fn(usize) -> usize| {
            let p = |k: usize| self.point(m(k));
            [
                0.5 * (p(47) + p(35)),
                (p(46) + p(54) + p(14)) / 3.0,
                0.5 * (p(54) + p(11)),
                p(24) + up * (0.5 * self.eye_distance),
                p(23) + up * (1.1 * self.eye_distance),
            ]
        };
        let front = |v: &usize| self.skin[*v] && normals[*v].dot(&out) > 0.1;
        let front = (0..normals.len()).filter(front);
        let free: Vec<usize> = front.filter(|&v| !points.contains(&(v as u32))).collect();
        let nearest = |aim: Vec3| {
            // Lateral distance counts fully, depth little, as the skin may bulge.
            let cost = |v: usize| {
                let d = mesh.positions[v] - aim;
                let depth = d.dot(&out);
                d.norm_squared() - 0.9 * depth * depth
            };
            let nearest = free.iter().min_by(|&&a, &&b| cost(a).total_cmp(&cost(b)));
            nearest.map_or(points[30], |&v| v as u32)
        };
        let both = [aims(|k| k), aims(mirrored)];
        both.into_iter().flatten().map(nearest).collect()
    }

    /// Whether the lips are one skin or a membrane spans them, so that an opening mouth would stretch. They are if
    /// the path along the surface from the upper to the lower lip is about as short as the straight one, for inner
    /// and outer lips.
    pub fn lips_are_joined(&self) -> bool {
        let (positions, lips) = (&self.mesh.positions, &self.lips);
        let middle = 0.5 * (self.point(60) + self.point(64));
        let near = |v: usize| (positions[v] - middle).norm() < self.mouth_width;
        let from = |some: &[u32]| distances(positions, &self.rings, some, near);
        let outer = from(&self.points[51..52])[self.points[57] as usize];
        let around = OUTER * (self.point(51) - self.point(57)).norm();
        let inner = from(&lips.upper);
        let upper = Nearest::new(positions, &lips.upper);
        let spans = |v: &&u32| {
            let gap = self.gap(&upper, **v).map_or(0.0, |gap| gap.0);
            let most = INNER * gap + TOUCHING * self.eye_distance;
            f64::from(inner[**v as usize]) <= most
        };
        let along =
            |v: &&u32| (0.2..0.8).contains(&lips.across(&self.mesh, &positions[**v as usize]));
        let line = || lips.lower.iter().filter(along);
        let spanned = line().filter(spans).count();
        f64::from(outer) < around && 2 * spanned > line().count()
    }

    /// Whether a vertex lies so deep in the mouth that it moves with the jaw alone, such as gums, teeth, tongue and
    /// throat connected to the skin. The rest of the inside deforms freely, so that lips can roll.
    pub fn deep(&self, v: usize) -> bool {
        let far = f64::from(self.from_lips[v]);
        far.is_finite() && far >= LIP_FREE * self.eye_distance
    }

    /// Whether a vertex is skin of an eye socket, which is fixed: far behind the lids, and beside the ball or behind
    /// its middle.
    pub fn lines_socket(&self, v: usize) -> bool {
        let far = f64::from(self.from_lids[v]);
        let out = self.axes.column(2);
        let behind = |ball: &Ball| (self.mesh.positions[v] - ball.center).dot(&out) < 0.0;
        far.is_finite()
            && far >= LID_FREE * self.eye_distance
            && self.balls.iter().flatten().all(behind)
    }

    /// Whether a vertex is visible skin, not behind lids or lips.
    pub(super) fn outside(&self, v: u32) -> bool {
        let v = v as usize;
        self.skin[v] && self.from_lids[v].is_infinite() && self.socket[v].is_nan()
    }

    /// Positions of vertices displaced by `base` and `d`.
    pub(super) fn moved<'a>(
        &'a self,
        d: &'a [Vec3],
        base: Option<&'a [Vec3]>,
    ) -> impl Fn(u32) -> Vec3 + 'a {
        move |v| {
            let v = v as usize;
            self.mesh.positions[v] + d[v] + base.map_or(Vec3::zeros(), |b| b[v])
        }
    }

    /// Position of a control point.
    pub fn point(&self, k: usize) -> Vec3 {
        self.mesh.positions[self.points[k] as usize]
    }

    /// Largest distance of the upper lid line from the lower one, mesh units; `p` gives positions. Not symmetric: the
    /// lower line continues around the lacrimal caruncle, which no lid covers.
    pub(super) fn lid_gap(&self, side: usize, p: impl Fn(u32) -> Vec3) -> f64 {
        let seam = &self.lids[side];
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

    /// For every vertex of the upper inner lip line: itself, the vertex of the lower line nearest below or above it,
    /// and its height above the lower line there. Vertices beyond the corners are left out.
    pub(super) fn lip_gaps(&self, p: impl Fn(u32) -> Vec3) -> Vec<(u32, u32, f64)> {
        let (left, up) = (self.axes.column(0), self.axes.column(1));
        let flat = |v: u32| (p(v).dot(&left), p(v).dot(&up));
        let Seam { upper, lower } = &self.lips;
        let gap = |&v: &u32| {
            let (x, y) = flat(v);
            let met = lower.windows(2).find_map(|s| {
                let ((ax, ay), (bx, by)) = (flat(s[0]), flat(s[1]));
                let t = (x - ax) / (bx - ax);
                let spans = bx != ax && (x - ax) * (x - bx) <= 0.0;
                spans.then(|| (s[usize::from(t > 0.5)], y - (ay + (by - ay) * t)))
            });
            let (other, gap) = met.unwrap_or((lower[0], f64::INFINITY));
            (v, other, gap)
        };
        upper[1..upper.len() - 1].iter().map(gap).collect()
    }

    /// Height of a point below the bite line, towards the chin; the line runs from between the lips to the hinge.
    pub(super) fn below_bite(&self, p: &Vec3) -> f64 {
        let lips = 0.5 * (self.point(62) + self.point(66));
        let up = self.axes.column(1).into_owned();
        let out = self.axes.column(2).into_owned();
        // Occlusal planes rise 4.5 degrees towards the back.
        let depth = (lips - p).dot(&out);
        (lips - p).dot(&up) + 0.08 * depth
    }
}
