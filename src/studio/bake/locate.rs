//! `--landmarks auto`: the 68 vertices of a head that comes without them.
//!
//! Up may be y or z, the face look along any level axis. Every part of the mesh that may be skin is drawn from there, alone but
//! for the eyeballs, and the shipped face model takes short looks: about the eyeballs, or below the top of the part in all
//! sizes. What it makes of them must lie in space as faces do ([`by_shape`]). The best are looked at closely, in boxes
//! around, and each fitted point is cast back to the visible vertex it lies on. What lines an opening (lids, inner lips) goes
//! to the nearest vertex of a rim: visible, with a neighbour that is not. A face that mirrors itself gets points that do. Brows
//! and jaw, which plaster does not show, are where the other points say that people have them.
//!
//! Units: the mesh's; pictures in pixels. Cost: 0.2 to 0.4 s where a face is found at once, 4 s on a core before it is said that
//! there is none. Limits: the model has learned photographs of people, not plaster and not cartoons; a head that
//! leans is not found.
//! One file: from a mesh to its 68 vertices, each step used by the next only.

use image::RgbImage;
use nalgebra::Matrix3;

use super::by_shape;
use super::looks::{Looks, Surfaces};
use super::mesh::{Mesh, Vec3};
use super::render::{Canvas, paint};
use crate::base::capacity::LANDMARKS;
use crate::face_model::FaceModel;
use crate::face_model::scheme::MIRROR;
use crate::landmarks::window::Picture;
use crate::studio::fit::still::{FaceBox, StillFitter};
use crate::studio::inspect::canvas;

/// Side of the picture, pixels.
const PIXELS: u32 = 360;
/// The picture to look at is larger by this.
const ENLARGED: u32 = 3;
/// Height and width of the picture looked at closely, in widths of the head.
const FRAME: f64 = 2.0;
/// Widths of the face box tried there, in widths of the head.
const BOXES: [f64; 4] = [0.72, 0.82, 0.92, 1.02];
/// Heights of the box's middle tried above the middle of the picture, in widths of the head.
const MIDDLES: [f64; 3] = [0.12, 0.04, -0.04];
/// What is usual of the two.
const BOX: f64 = 0.84;
const MIDDLE: f64 = 0.04;
/// Squares about eyeballs: sides, and how far below them, in distances of their centres.
const EYE_SIDES: [f64; 3] = [2.4, 2.05, 1.75];
const EYES_BELOW: [f64; 3] = [0.4, 0.55, 0.7];
/// Squares below the top of a head without: the largest in heights of the mesh, how many, each smaller by a step, and how
/// far below, in sides.
const LARGEST: f64 = 0.95;
const SIZES: usize = 15;
const STEP: f64 = 1.2;
const TOP_BELOW: [f64; 5] = [0.5, 0.7, 0.9, 1.1, 1.3];
/// A picture for short looks, in sides of its largest square.
const AROUND: f64 = 2.8;
/// Parts with a smaller share of the vertices of the largest are not its skin; so many are tried.
const SMALLEST_SKIN: usize = 12;
const SKINS: usize = 3;
/// Least and largest extent of an eyeball, also of half a one; more of them than this are not looked through.
const ROUND: f64 = 0.4;
const MOST_ROUND: usize = 100;
/// Short looks worth a closer one at once, and how many at last.
const PROMISING: f32 = 0.4;
const CLOSELY: usize = 3;
/// Half a gap that is looked over, pixels.
const GAP: f64 = 3.0;
/// Points of eyes, nose and lips that may lie beside the head.
const MISSED: usize = 3;
/// Points so far from where people have them, in inner-eye-corner distances, are hardly a face.
const UNLIKE: f64 = 0.25;
/// A face less certain than this is none.
const LEAST: f32 = 0.2;
/// A point less certain than this wants to be looked at: named by `bake`, low in `place`.
pub const LOW: f32 = 0.4;
/// Sure enough to look in no other direction.
const SURE: f32 = 0.5;
/// A rim vertex further than this from a fitted point is another opening's, in widths of the head.
const RIM: f64 = 0.03;
/// A vertex so far before or behind where people have a point is not it, in inner-eye-corner distances.
const DEEP: f64 = 0.4;
/// Points 0 to 16 are the jaw's, up to 26 the brows'.
const UNMARKED: usize = 27;
/// A point this far from where the others say it is, in inner-eye-corner distances, is hardly believed.
const DOUBTFUL: f64 = 0.1;
/// A part is small up to this share of the skin's extent.
const SMALL: f64 = 0.35;
/// Cosine of the cone that an iris fills on an eyeball seen from its centre.
const IRIS: f64 = 0.87;

/// Fits next to the best that say how sure each point is.
const OTHERS: usize = 4;
/// How far they put a point elsewhere on average that is half as sure as the face, in distances of the inner eye corners.
const HALF: f32 = 0.1;

/// One fit: how good it is, the model's confidence, the points.
type Fit = (f32, f32, [[f32; 2]; LANDMARKS]);

/// Why no landmarks were found.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum LocateError {
    /// No direction shows a face.
    #[error(
        "expected a face in a picture of the mesh, found none with more than {confidence:.2} confidence; place the 68 points with mien-studio place"
    )]
    NoFace {
        /// The best there was.
        confidence: f32,
    },
}

/// What was found.
pub struct Located {
    /// The 68 vertices.
    pub vertices: Vec<u64>,
    /// That it is a face, 0 to 1.
    pub confidence: f32,
    /// Of each point, 0 to 1: that of the face, less where fits from other boxes, the nearest vertex or what all other points
    /// say are elsewhere.
    pub of_points: [f32; LANDMARKS],
    /// Axis of the mesh that points up.
    pub up: &'static str,
    /// Axis of the mesh that the face looks along.
    pub facing: &'static str,
    /// The head with the points drawn in.
    pub picture: RgbImage,
}

impl Located {
    /// Whether it is likely enough to be a face.
    #[must_use]
    pub fn is_face(&self) -> bool {
        self.confidence >= LEAST
    }

    /// Points less sure than [`LOW`], the least sure first.
    #[must_use]
    pub fn unsure(&self) -> Vec<usize> {
        let mut unsure: Vec<usize> = (0..LANDMARKS)
            .filter(|&k| self.of_points[k] < LOW)
            .collect();
        unsure.sort_by(|&a, &b| self.of_points[a].total_cmp(&self.of_points[b]));
        unsure
    }
}

/// The head from one direction.
struct Seen {
    /// Mesh to (right, up, towards the viewer).
    to_view: Matrix3<f64>,
    /// The middle of the picture there.
    middle: Vec3,
    /// What mirrors the head lies there, to the right.
    plane: f64,
    /// Pixels per unit.
    scale: f64,
    canvas: Canvas,
}

/// Finds the landmarks.
///
/// # Errors
/// If no face is to be seen.
pub fn locate(mesh: &Mesh, model: &FaceModel) -> Result<Located, LocateError> {
    let found = guess(mesh, &Looks::default(), model)?;
    if !found.is_face() {
        return Err(LocateError::NoFace {
            confidence: found.confidence,
        });
    }
    Ok(found)
}

/// The same with however little confidence, for a person to correct: as if of plaster, then as it is coloured.
///
/// # Errors
/// If there is nothing to look at.
pub(in crate::studio) fn guess(
    mesh: &Mesh,
    looks: &Looks,
    model: &FaceModel,
) -> Result<Located, LocateError> {
    let rings = mesh.rings();
    let mut parts = Parts::new(mesh, &rings);
    let mut best = None;
    search(mesh, &parts, model, &mut best);
    if !is_sure(&best) {
        parts.surfaces = Some(Surfaces::new(mesh, looks)).filter(Surfaces::any);
        if parts.surfaces.is_some() {
            search(mesh, &parts, model, &mut best);
        }
    }
    let face = best.ok_or(LocateError::NoFace { confidence: 0.0 })?;
    Ok(face.located(mesh, &rings, &parts, model))
}

fn is_sure(best: &Option<Face>) -> bool {
    best.as_ref().is_some_and(|b| b.confidence > SURE)
}

/// Looks from all sides until a face is sure.
fn search(mesh: &Mesh, parts: &Parts<'_>, model: &FaceModel, best: &mut Option<Face>) {
    let mut search = Search {
        mesh,
        parts,
        model,
        fitter: StillFitter::new(model),
        by_eyes: parts.balls.is_some(),
    };
    let ways = [true, false]
        .into_iter()
        .filter(|&eyes| !eyes || parts.balls.is_some());
    for by_eyes in ways {
        search.by_eyes = by_eyes;
        let mut glances: Vec<Glance> = Vec::new();
        for to_view in parts.frames(by_eyes) {
            for &skin in &parts.skins {
                let first = glances.len();
                search.glances(skin, &to_view, &mut glances);
                // Looked at closely where it is, before anything else is looked at.
                let promising = |g: &&Glance| g.score > PROMISING;
                if let Some(seen) = glances[first..].iter().max_by(by_score).filter(promising) {
                    better(best, search.closely(seen));
                    if is_sure(best) {
                        return;
                    }
                }
            }
        }
        glances.sort_by(|a, b| b.score.total_cmp(&a.score));
        for seen in glances.iter().take(CLOSELY) {
            better(best, search.closely(seen));
        }
        if is_sure(best) {
            return;
        }
    }
}

fn by_score(a: &&Glance, b: &&Glance) -> std::cmp::Ordering {
    a.score.total_cmp(&b.score)
}

/// Keeps the face that is surer.
fn better(best: &mut Option<Face>, face: Option<Face>) {
    let Some(face) = face else { return };
    if best.as_ref().is_none_or(|b| face.confidence > b.confidence) {
        *best = Some(face);
    }
}

/// What hangs together in a mesh.
struct Parts<'a> {
    /// Part of every vertex.
    of: Vec<u32>,
    /// What may carry the face, the likeliest first.
    skins: Vec<u32>,
    /// Those that are eyeballs, or lie in them, and the centres of the two.
    balls: Option<(Vec<u32>, [Vec3; 2])>,
    /// Whether each is small beside the skin: brows, lashes, eyes that are no balls.
    small: Vec<bool>,
    /// What is known of colours.
    surfaces: Option<Surfaces<'a>>,
}

impl Parts<'_> {
    fn new(mesh: &Mesh, rings: &super::mesh::Rings) -> Self {
        let (of, count) = mesh.components(rings);
        let none = (Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::NEG_INFINITY));
        let (mut boxes, mut size) = (vec![none; count], vec![0_usize; count]);
        for (p, &c) in mesh.positions.iter().zip(&of) {
            let b = &mut boxes[c as usize];
            *b = (b.0.inf(p), b.1.sup(p));
            size[c as usize] += 1;
        }
        let balls = eyeballs(&boxes);
        // Skin goes round both eyes; hair and clothes may have more vertices.
        let holds = |c: u32| {
            let Some((_, centers)) = &balls else {
                return false;
            };
            let (low, high) = boxes[c as usize];
            centers
                .iter()
                .all(|p| p.inf(&high) == *p && p.sup(&low) == *p)
        };
        let mut skins: Vec<u32> = (0..count as u32).collect();
        skins.sort_by_key(|&c| std::cmp::Reverse((holds(c), size[c as usize])));
        let most = skins.iter().map(|&c| size[c as usize]).max().unwrap_or(0);
        skins.retain(|&c| size[c as usize] * SMALLEST_SKIN > most);
        skins.truncate(SKINS);
        let wide = |c: usize| (boxes[c].1 - boxes[c].0).max();
        let skin = skins.first().map_or(0.0, |&c| wide(c as usize));
        Self {
            of,
            small: (0..count).map(|c| wide(c) < SMALL * skin).collect(),
            skins,
            balls,
            surfaces: None,
        }
    }

    /// Views to try: up is y or z; four ways to face, but only those with the eyes level, where there are eyes.
    fn frames(&self, by_eyes: bool) -> Vec<Matrix3<f64>> {
        let across = self
            .balls
            .as_ref()
            .filter(|_| by_eyes)
            .map(|(_, [a, b])| (b - a).normalize());
        let ups = [
            Matrix3::identity(),
            Matrix3::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -1.0, 0.0),
        ];
        let turned = ups.iter().flat_map(|up| {
            [0, 2, 1, 3].map(|quarter| {
                let (sin, cos) = (f64::from(quarter) * std::f64::consts::FRAC_PI_2).sin_cos();
                Matrix3::new(cos, 0.0, -sin, 0.0, 1.0, 0.0, sin, 0.0, cos) * up
            })
        });
        let level = |m: &Matrix3<f64>| across.is_none_or(|a| (m * a).x.abs() > 0.9);
        turned.filter(level).collect()
    }
}

/// The pair of round parts of one size that lie level beside each other, and what else is round and in them.
fn eyeballs(boxes: &[(Vec3, Vec3)]) -> Option<(Vec<u32>, [Vec3; 2])> {
    let middle = |c: usize| (boxes[c].0 + boxes[c].1) / 2.0;
    let wide = |c: usize| (boxes[c].1 - boxes[c].0).max();
    let round = |&c: &usize| {
        let size = boxes[c].1 - boxes[c].0;
        size.max() > 0.0
            && size.min() > ROUND * size.max()
            && size.sum() - size.min() > 1.7 * size.max()
    };
    let round: Vec<usize> = (0..boxes.len()).filter(round).collect();
    let whole = boxes
        .iter()
        .fold(Vec3::zeros(), |most, b| most.sup(&(b.1 - b.0)))
        .max();
    let mut best: Option<(f64, usize, usize)> = None;
    for (k, &a) in round.iter().enumerate().take(MOST_ROUND) {
        for &b in round[k + 1..].iter().take(MOST_ROUND) {
            let (size, apart) = (0.5 * (wide(a) + wide(b)), middle(b) - middle(a));
            let along = apart.amax();
            let off = (apart.norm_squared() - along * along).max(0.0).sqrt();
            let alike = (wide(a) - wide(b)).abs() < 0.15 * size && off < 0.3 * size;
            let is_pair = alike && (1.4..4.5).contains(&(along / size)) && size < 0.3 * whole;
            // Of several in each other the largest.
            if is_pair && best.is_none_or(|(most, ..)| size > most) {
                best = Some((size, a, b));
            }
        }
    }
    let (size, a, b) = best?;
    let centers = [middle(a), middle(b)];
    let within = |&&c: &&usize| {
        centers.iter().any(|p| (middle(c) - p).norm() < 0.3 * size) && wide(c) < 1.2 * size
    };
    let all = round.iter().filter(within).map(|&c| c as u32).collect();
    Some((all, centers))
}

/// A square in a view where a face may be, and what a short look made of it.
#[derive(Clone, Copy)]
struct Glance {
    skin: u32,
    to_view: Matrix3<f64>,
    /// In the view, the mesh's unit.
    middle: Vec3,
    side: f64,
    score: f32,
}

/// A face looked at closely.
struct Face {
    skin: u32,
    confidence: f32,
    points: [[f32; 2]; LANDMARKS],
    of_points: [f32; LANDMARKS],
    /// Where people have the points in depth, pixels.
    depths: [f64; LANDMARKS],
    seen: Seen,
}

/// What is needed to look somewhere.
struct Search<'a> {
    mesh: &'a Mesh,
    parts: &'a Parts<'a>,
    model: &'a FaceModel,
    fitter: StillFitter<'a>,
    /// Where eyeballs are, not anywhere.
    by_eyes: bool,
}

impl Search<'_> {
    /// Short looks at one direction: about the eyes if there are any, else below the top of the head, in all sizes.
    fn glances(&mut self, skin: u32, to_view: &Matrix3<f64>, found: &mut Vec<Glance>) {
        let view: Vec<Vec3> = self.mesh.positions.iter().map(|p| to_view * p).collect();
        let mut squares: Vec<(Vec3, f64)> = Vec::new();
        if let Some((_, [a, b])) = self.parts.balls.as_ref().filter(|_| self.by_eyes) {
            let (middle, apart) = (to_view * (a + b) / 2.0, (b - a).norm());
            for (side, below) in EYE_SIDES.iter().flat_map(|&s| EYES_BELOW.map(|b| (s, b))) {
                squares.push((middle - Vec3::y() * (below * apart), side * apart));
            }
        } else {
            let of_skin = || {
                (0..view.len())
                    .filter(|&v| self.parts.of[v] == skin)
                    .map(|v| view[v])
            };
            let reach = |low: f64| {
                let near = of_skin().filter(|p| p.y >= low);
                near.fold(
                    (Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::NEG_INFINITY)),
                    |(a, b), p| (a.inf(&p), b.sup(&p)),
                )
            };
            let (low, high) = reach(f64::NEG_INFINITY);
            let mut side = LARGEST * (high.y - low.y);
            for _ in 0..SIZES {
                let (left, right) = reach(high.y - 1.7 * side);
                for below in TOP_BELOW {
                    let middle = Vec3::new(
                        0.5 * (left.x + right.x),
                        high.y - below * side,
                        0.5 * (left.z + right.z),
                    );
                    squares.push((middle, side));
                }
                side /= STEP;
            }
        }
        // One picture for squares of about a size.
        let mut drawn: Option<(Seen, f64)> = None;
        for (middle, side) in squares {
            if drawn
                .as_ref()
                .is_none_or(|(_, largest)| !(0.55 * largest..=1.001 * largest).contains(&side))
            {
                drawn = Some((
                    look(self.mesh, self.parts, skin, to_view, &middle, side * AROUND),
                    side,
                ));
            }
            let Some((seen, _)) = &drawn else { continue };
            let luma = seen.luma();
            let face_box = seen.square(&middle, side);
            let face = self.fitter.glance(&picture(&luma), &face_box);
            let score = face.confidence * self.plausible(seen, &face.points).0;
            let (middle, side) = seen.unsquare(&face.points);
            found.push(Glance {
                skin,
                to_view: *to_view,
                middle,
                side,
                score,
            });
        }
    }

    /// How much the points are like a face in space, 1 if they lie as people have them, upright and towards the viewer; and
    /// the depths that people have there, pixels.
    fn plausible(&self, seen: &Seen, points: &[[f32; 2]; LANDMARKS]) -> (f32, [f64; LANDMARKS]) {
        let mut there = [Vec3::zeros(); LANDMARKS];
        let deep = 0.5 * DEEP * f64::from(apart(points[39], points[42]));
        for (there, &[x, y]) in there.iter_mut().zip(points) {
            let (x, y) = (f64::from(x), f64::from(y));
            let around = [-GAP, 0.0, GAP];
            let around = around
                .iter()
                .flat_map(|dx| around.map(|dy| (x + dx, y + dy)));
            let nearest = around
                .filter_map(|(x, y)| seen.canvas.depth(x, y))
                .reduce(f64::max);
            let Some(nearest) = nearest else { continue };
            // Not what lies behind a gap between lips or lids.
            let here = seen.canvas.depth(x, y).filter(|d| nearest - d < deep);
            let depth = here.unwrap_or(nearest);
            *there = Vec3::new(x, -y, depth);
        }
        let hit = there[27..].iter().filter(|p| **p != Vec3::zeros()).count();
        if hit < LANDMARKS - 27 - MISSED {
            return (0.0, there.map(|p| p.z));
        }
        // Where the picture shows nothing, nothing is known.
        let depth = there[30].z;
        for (p, &[x, y]) in there
            .iter_mut()
            .zip(points)
            .filter(|(p, _)| **p == Vec3::zeros())
        {
            *p = Vec3::new(f64::from(x), -f64::from(y), depth);
        }
        let Some(laid) = by_shape::laid(&self.model.shape, &there) else {
            return (0.0, there.map(|p| p.z));
        };
        let eyes = (laid.points[39] - laid.points[42]).norm();
        let off: f64 = (27..LANDMARKS)
            .map(|k| (laid.points[k] - there[k]).norm_squared())
            .sum();
        let off = (off / (LANDMARKS - 27) as f64).sqrt() / (UNLIKE * eyes);
        let (across, up) = (
            laid.points[45] - laid.points[36],
            laid.points[27] - laid.points[57],
        );
        let out = across.cross(&up).normalize();
        let facing = ((out.z - 0.5) / 0.4).clamp(0.0, 1.0)
            * ((up.normalize().y - 0.5) / 0.4).clamp(0.0, 1.0);
        let like = (-0.5 * off * off).exp() * facing;
        (like as f32, laid.points.map(|p| p.z))
    }

    /// The full fit in boxes about a face that was glanced at.
    fn closely(&mut self, glance: &Glance) -> Option<Face> {
        let width = glance.side / BOX;
        let middle = glance.middle - Vec3::y() * (MIDDLE * width);
        let seen = look(
            self.mesh,
            self.parts,
            glance.skin,
            &glance.to_view,
            &middle,
            FRAME * width,
        );
        let luma = seen.luma();
        let mut fits: Vec<Fit> = Vec::with_capacity(BOXES.len() * MIDDLES.len());
        for (share, above) in BOXES.iter().flat_map(|&s| MIDDLES.map(|m| (s, m))) {
            let face_box = seen.square(&(middle + Vec3::y() * (above * width)), share * width);
            let face = self.fitter.fit(&picture(&luma), &face_box, 0.0);
            let score = face.confidence * self.plausible(&seen, &face.points).0;
            fits.push((score, face.confidence, face.points));
        }
        // The first of equals.
        fits.sort_by(|a, b| b.0.total_cmp(&a.0));
        let &(confidence, _, points) = fits.first()?;
        let of_points = agreed(&fits);
        let (_, depths) = self.plausible(&seen, &points);
        Some(Face {
            skin: glance.skin,
            confidence,
            points,
            of_points,
            depths,
            seen,
        })
    }
}

impl Face {
    /// The vertices, and how sure each is.
    fn located(
        self,
        mesh: &Mesh,
        rings: &super::mesh::Rings,
        parts: &Parts<'_>,
        model: &FaceModel,
    ) -> Located {
        let Self {
            confidence,
            points,
            mut of_points,
            depths,
            mut seen,
            ..
        } = self;
        let skin: Vec<bool> = parts.of.iter().map(|&c| c == self.skin).collect();
        let (mut vertices, symmetric) = cast(mesh, rings, &skin, &points, &depths, &mut seen);
        // A vertex that is not where the point was seen is as unsure.
        let eyes = apart(points[39], points[42]).max(f32::MIN_POSITIVE);
        for ((sure, point), &v) in of_points.iter_mut().zip(&points).zip(&vertices) {
            let at = seen.screen(&mesh.positions[v as usize]);
            *sure /= halved(apart(*point, [at.x as f32, at.y as f32]) / eyes);
        }
        // What the picture says of brows and jaw is left.
        of_points[..UNMARKED].fill(confidence);
        let shares = by_the_rest(mesh, &skin, model, &seen, symmetric, &mut vertices);
        for (sure, share) in of_points.iter_mut().zip(shares) {
            *sure *= share as f32;
        }
        let picture = with_points(mesh, &seen, &vertices);
        Located {
            vertices: vertices.into_iter().map(u64::from).collect(),
            confidence,
            of_points,
            up: axis(&seen.to_view, 1),
            facing: axis(&seen.to_view, 2),
            picture,
        }
    }
}

/// A row of a view as an axis of the mesh.
fn axis(to_view: &Matrix3<f64>, row: usize) -> &'static str {
    let along = to_view.row(row);
    let k = along.iamax_full().1;
    let names = [["-x", "+x"], ["-y", "+y"], ["-z", "+z"]];
    names[k][usize::from(along[k] > 0.0)]
}

fn picture(luma: &[u8]) -> Picture<'_> {
    Picture {
        luma,
        width: PIXELS as usize,
        height: PIXELS as usize,
    }
}

/// The head enlarged, with the points drawn in.
fn with_points(mesh: &Mesh, seen: &Seen, vertices: &[u32]) -> RgbImage {
    let side = PIXELS * ENLARGED;
    let filter = image::imageops::FilterType::Triangle;
    let mut picture = image::imageops::resize(&seen.canvas.image, side, side, filter);
    for (k, &v) in vertices.iter().enumerate() {
        let p = seen.screen(&mesh.positions[v as usize]);
        let [x, y] = [p.x, p.y].map(|c| ((c + 0.5) * f64::from(ENLARGED)) as f32);
        // Inner lips and lids in another colour than what lies beside them.
        let lines = matches!(k, 36..=47 | 60..=67);
        let colour = if lines { [250, 220, 40] } else { [30, 220, 70] };
        canvas::square(&mut picture, x, y, 2, colour);
    }
    picture
}

/// Pixels between two points.
fn apart(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// What a confidence is divided by for so many eye distances: 2 at `HALF`.
fn halved(off: f32) -> f32 {
    1.0 + (off / HALF).powi(2)
}

/// Confidence of each point of the best of these fits: that of the face, halved where the next best ones put it `HALF` eye
/// distances away on average.
fn agreed(fits: &[Fit]) -> [f32; LANDMARKS] {
    let Some((_, confidence, points)) = fits.first() else {
        return [0.0; LANDMARKS];
    };
    let eyes = apart(points[39], points[42]).max(f32::MIN_POSITIVE);
    let others = &fits[1..fits.len().min(1 + OTHERS)];
    std::array::from_fn(|k| {
        let off = others
            .iter()
            .map(|fit| apart(fit.2[k], points[k]))
            .sum::<f32>();
        let off = off / (others.len().max(1) as f32 * eyes);
        confidence / halved(off)
    })
}

/// Puts brows and jaw where the other points say that they are. Share of the confidence of each point.
fn by_the_rest(
    mesh: &Mesh,
    skin: &[bool],
    model: &FaceModel,
    seen: &Seen,
    symmetric: bool,
    vertices: &mut [u32],
) -> [f64; LANDMARKS] {
    let view: Vec<Vec3> = mesh.positions.iter().map(|p| seen.to_view * p).collect();
    let found: [Vec3; LANDMARKS] = std::array::from_fn(|k| view[vertices[k] as usize]);
    let Some(laid) = by_shape::laid(&model.shape, &found) else {
        return [0.0; LANDMARKS];
    };
    let eyes = (found[39] - found[42]).norm();
    // None stands in the way of another.
    vertices[..UNMARKED].fill(u32::MAX);
    std::array::from_fn(|k| {
        let mut there = laid.points[k];
        if symmetric {
            let mut other = laid.points[MIRROR[k]];
            other.x = 2.0 * seen.plane - other.x;
            there = (there + other) / 2.0;
        }
        if k < UNMARKED {
            let far = |v: u32| (view[v as usize] - there).norm_squared();
            let free =
                (0..view.len() as u32).filter(|&v| skin[v as usize] && !vertices.contains(&v));
            let nearest = free.min_by(|&a, &b| far(a).total_cmp(&far(b)));
            vertices[k] = nearest.unwrap_or(0);
        }
        let miss = (view[vertices[k] as usize] - there).norm() / (DOUBTFUL * eyes);
        (-0.5 * miss * miss).exp()
    })
}

impl Seen {
    /// Pixels, and depth in pixels towards the viewer.
    fn screen(&self, p: &Vec3) -> Vec3 {
        self.canvas.screen(&(self.to_view * p))
    }

    fn luma(&self) -> Vec<u8> {
        let pixels = self.canvas.image.pixels();
        pixels.map(|p| image::Pixel::to_luma(p).0[0]).collect()
    }

    /// Pixels of a square in the view.
    fn square(&self, middle: &Vec3, side: f64) -> FaceBox {
        let (at, side) = (self.canvas.screen(middle), side * self.scale);
        FaceBox {
            x: (at.x - 0.5 * side) as f32,
            y: (at.y - 0.5 * side) as f32,
            width: side as f32,
            height: side as f32,
        }
    }

    /// The square in the view that points fill, its middle and side.
    fn unsquare(&self, points: &[[f32; 2]; LANDMARKS]) -> (Vec3, f64) {
        let b = FaceBox::around(points);
        let half = f64::from(PIXELS) / 2.0;
        let [x, y] = [b.x + 0.5 * b.width, b.y + 0.5 * b.height].map(f64::from);
        let off = Vec3::new(x - half, half - y, 0.0) / self.scale;
        (
            self.middle + off,
            f64::from(b.width * b.height).sqrt() / self.scale,
        )
    }
}

/// Draws the head: skin, and eyes with an iris.
fn look(
    mesh: &Mesh,
    parts: &Parts<'_>,
    skin: u32,
    to_view: &Matrix3<f64>,
    middle: &Vec3,
    height: f64,
) -> Seen {
    let view: Vec<Vec3> = mesh.positions.iter().map(|p| to_view * p).collect();
    let centers = parts
        .balls
        .as_ref()
        .map(|(all, centers)| (all, centers.map(|c| to_view * c)));
    let tint = |t: [u32; 3]| {
        let part = parts.of[t[0] as usize];
        if part == skin {
            return Some([205.0, 165.0, 140.0]);
        }
        let (all, centers) = centers.as_ref()?;
        if !all.contains(&part) {
            return None;
        }
        let at = t.iter().map(|&v| view[v as usize]).sum::<Vec3>() / 3.0;
        let [a, b] = centers.map(|c| at - c);
        let off = if a.norm() < b.norm() { a } else { b };
        Some(if off.z > IRIS * off.norm() {
            [60.0, 45.0, 35.0]
        } else {
            [235.0, 238.0, 245.0]
        })
    };
    let draw = |surfaces, tint: &dyn Fn([u32; 3], bool) -> _| {
        paint(mesh, &view, middle, height, PIXELS, surfaces, tint)
    };
    let mut canvas = draw(None, &|t, _| tint(t));
    if let Some(surfaces) = &parts.surfaces {
        // Depth stays that of the skin, which points are cast on.
        let small = |t: [u32; 3]| parts.small[parts.of[t[0] as usize] as usize];
        let tint = |t, known| tint(t).or((known && small(t)).then_some([0.0; 3]));
        canvas.image = draw(Some(surfaces), &tint).image;
    }
    Seen {
        to_view: *to_view,
        middle: *middle,
        plane: middle.x,
        scale: f64::from(PIXELS) / height,
        canvas,
    }
}

/// The vertex under each fitted point, and whether the head mirrors itself.
fn cast(
    mesh: &Mesh,
    rings: &super::mesh::Rings,
    skin: &[bool],
    points: &[[f32; 2]; LANDMARKS],
    depths: &[f64; LANDMARKS],
    seen: &mut Seen,
) -> (Vec<u32>, bool) {
    let n = mesh.positions.len();
    let width_px = f64::from(PIXELS) / FRAME;
    let screen: Vec<Vec3> = mesh.positions.iter().map(|p| seen.screen(p)).collect();
    let normals = mesh.vertex_normals(&mesh.positions);
    let towards = seen.to_view.transpose() * Vec3::z();
    let visible: Vec<bool> = (0..n)
        .map(|v| skin[v] && normals[v].dot(&towards) > 0.0 && seen.canvas.shows(&screen[v]))
        .collect();
    let border = mesh.border();
    let rim: Vec<bool> = (0..n)
        .map(|v| visible[v] && (border[v] || rings.of(v).iter().any(|&o| !visible[o as usize])))
        .collect();
    // Mirrored points in a mirrored head: the mean of both sides.
    let (middle, symmetric) = plane(&screen, skin, points, width_px);
    seen.plane = seen.middle.x + (middle - f64::from(PIXELS) / 2.0) / seen.scale;
    let aim = |k: usize| {
        let p = points[k].map(f64::from);
        let q = points[MIRROR[k]].map(f64::from);
        if symmetric {
            [0.5 * (p[0] + 2.0 * middle - q[0]), 0.5 * (p[1] + q[1])]
        } else {
            p
        }
    };
    let up = |v: usize| (seen.to_view * normals[v]).y;
    let deep = DEEP * f64::from(apart(points[39], points[42]));
    let mut taken: Vec<u32> = Vec::with_capacity(LANDMARKS);
    for k in 0..LANDMARKS {
        let [x, y] = aim(k);
        let far = |v: usize| (screen[v].x - x).hypot(screen[v].y - y);
        let nearest = |fits: &dyn Fn(usize) -> bool| {
            (0..n)
                .filter(|&v| visible[v] && fits(v) && !taken.contains(&(v as u32)))
                .min_by(|&a, &b| far(a).total_cmp(&far(b)))
        };
        // An upper edge looks down, a lower one up; corners look anywhere.
        let lines = |v: usize| match k {
            37 | 38 | 43 | 44 | 61..=63 => rim[v] && up(v) < 0.1,
            40 | 41 | 46 | 47 | 65..=67 => rim[v] && up(v) > -0.1,
            _ => rim[v],
        };
        // What is seen through an opening lies too deep.
        let level = |v: usize| (screen[v].z - depths[k]).abs() < deep;
        let edge = matches!(k, 36..=47 | 60..=67)
            .then(|| nearest(&|v| lines(v) && level(v)).filter(|&v| far(v) < RIM * width_px))
            .flatten();
        let vertex = edge
            .or_else(|| nearest(&level))
            .or_else(|| nearest(&|_| true));
        let vertex = vertex.unwrap_or(0);
        taken.push(vertex as u32);
    }
    (taken, symmetric)
}

/// Where the plane is that mirrors the face, in pixels from the left, and whether nearly all of the face has a partner there.
fn plane(
    screen: &[Vec3],
    skin: &[bool],
    points: &[[f32; 2]; LANDMARKS],
    width_px: f64,
) -> (f64, bool) {
    let mean = points.iter().map(|p| f64::from(p[0])).sum::<f64>() / LANDMARKS as f64;
    let [top, chin] = [27, 8].map(|k| f64::from(points[k][1]));
    // Shoulders and hair need not mirror.
    let tall = (chin - top).abs();
    let near = |p: &&Vec3| p.y > top - 0.5 * tall && p.y < chin && (p.x - mean).abs() < width_px;
    let all: Vec<&Vec3> = screen
        .iter()
        .zip(skin)
        .filter(|s| *s.1)
        .map(|s| s.0)
        .filter(near)
        .collect();
    let [low, high] =
        [f64::min, f64::max].map(|f| all.iter().map(|p| p.x).reduce(f).unwrap_or(mean));
    let tip = all
        .iter()
        .max_by(|a, b| a.z.total_cmp(&b.z))
        .map_or(mean, |p| p.x);
    let alone = [tip, 0.5 * (low + high), mean].map(|at| (alone(&all, at, 0.02 * width_px), at));
    let (alone, at) = alone
        .into_iter()
        .reduce(|a, b| if b.0 < a.0 { b } else { a })
        .unwrap_or((1.0, mean));
    let symmetric = alone < 0.05;
    (if symmetric { at } else { mean }, symmetric)
}

/// Share of places that have no partner on the other side.
fn alone(all: &[&Vec3], middle: f64, cell: f64) -> f64 {
    let key = |x: f64, p: &Vec3| [x, p.y, p.z].map(|c| (c / cell).round() as i64);
    let there: std::collections::HashSet<[i64; 3]> =
        all.iter().map(|p| key(p.x - middle, p)).collect();
    let alone = all.iter().filter(|p| {
        let [x, y, z] = key(middle - p.x, p);
        !(-1..=1).any(|d| there.contains(&[x + d, y, z]))
    });
    alone.count() as f64 / all.len().max(1) as f64
}
