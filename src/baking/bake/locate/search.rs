//! Where in the pictures of a mesh a face is.
//!
//! The face model takes short looks: about the eyeballs, or below the top of a part in all sizes. What it makes of them must lie in
//! space as faces do ([`by_shape`]). The best are looked at closely, in boxes around.

use nalgebra::Matrix3;

use super::super::by_shape;
use super::super::mesh::{Mesh, Vec3, extent_of};
use super::seen::{Parts, Seen, apart, look};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::face_model::FaceModel;
use mien_workbench::still::StillFitter;

/// Height and width of the picture looked at closely, in widths of the head.
pub(super) const FRAME: f64 = 2.0;
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
/// Short looks worth a closer one at once, and how many at last.
const PROMISING: f32 = 0.4;
const CLOSELY: usize = 3;
/// Half a gap that is looked over, pixels.
const GAP: f64 = 3.0;
/// Points of eyes, nose and lips that may lie beside the head.
const MISSED: usize = 3;
/// Points so far from where people have them, in inner-eye-corner distances, are hardly a face.
const UNLIKE: f64 = 0.25;
/// Sure enough to look in no other direction.
const SURE: f32 = 0.6;
/// A vertex so far before or behind where people have a point is not it, in inner-eye-corner distances.
pub(super) const DEEP: f64 = 0.4;
/// Fits next to the best that say how sure each point is.
const OTHERS: usize = 4;
/// How far they put a point elsewhere on average that is half as sure as the face, in distances of the inner eye corners.
const HALF: f32 = 0.1;

/// The 68 points in a picture, pixels.
pub(super) type Points = [[f32; 2]; LANDMARKS];

/// One fit: how good it is, the model's confidence, the points.
type Fit = (f32, f32, Points);

/// Squares about eyeballs so far apart, and their sides.
fn about_eyes(middle: &Vec3, apart: f64) -> Vec<(Vec3, f64)> {
    let sizes = EYE_SIDES.iter().flat_map(|&s| EYES_BELOW.map(|b| (s, b)));
    let square = |(side, below)| (middle - Vec3::y() * (below * apart), side * apart);
    sizes.map(square).collect()
}

/// A square in a view where a face may be, and what a short look made of it.
struct Glance {
    skin: u32,
    to_view: Matrix3<f64>,
    /// In the view, the mesh's unit.
    middle: Vec3,
    side: f64,
    score: f32,
}

/// A face looked at closely.
pub(super) struct Face {
    pub(super) skin: u32,
    pub(super) confidence: f32,
    pub(super) points: Points,
    pub(super) of_points: [f32; LANDMARKS],
    /// Where people have the points in depth, pixels.
    pub(super) depths: [f64; LANDMARKS],
    pub(super) seen: Seen,
}

/// Looks for the face of a mesh.
pub(super) struct Search<'a> {
    mesh: &'a Mesh,
    pub(super) parts: Parts<'a>,
    model: &'a FaceModel,
    fitter: StillFitter<'a>,
    /// The surest face so far.
    pub(super) best: Option<Face>,
}

impl<'a> Search<'a> {
    pub(super) fn new(mesh: &'a Mesh, parts: Parts<'a>, model: &'a FaceModel) -> Self {
        Self {
            mesh,
            parts,
            model,
            fitter: StillFitter::new(model),
            best: None,
        }
    }

    pub(super) fn is_sure(&self) -> bool {
        self.best.as_ref().is_some_and(|b| b.confidence > SURE)
    }

    /// Looks from all sides, or `only` from one, until a face is sure: about the eyes if there are any, then anywhere.
    pub(super) fn all_around(&mut self, only: Option<&Matrix3<f64>>) {
        for by_eyes in [true, false] {
            if by_eyes && self.parts.balls.is_none() {
                continue;
            }
            let mut glances: Vec<Glance> = Vec::new();
            let frames = only.map_or_else(|| self.parts.frames(by_eyes), |only| vec![*only]);
            let skins = self.parts.skins.clone();
            for (to_view, skin) in frames
                .iter()
                .flat_map(|f| skins.iter().map(move |s| (f, *s)))
            {
                let some = self.glances(skin, to_view, by_eyes);
                // Looked at closely where it is, before anything else is looked at.
                let likeliest = some.iter().max_by(|a, b| a.score.total_cmp(&b.score));
                if let Some(glance) = likeliest.filter(|g| g.score > PROMISING) {
                    self.closely(glance);
                    if self.is_sure() {
                        return;
                    }
                }
                glances.extend(some);
            }
            glances.sort_by(|a, b| b.score.total_cmp(&a.score));
            for glance in glances.iter().take(CLOSELY) {
                self.closely(glance);
            }
            if self.is_sure() {
                return;
            }
        }
    }

    /// Short looks at one direction: about the eyes, or below the top of the head, in all sizes.
    fn glances(&mut self, skin: u32, to_view: &Matrix3<f64>, by_eyes: bool) -> Vec<Glance> {
        let balls = self.parts.balls.as_ref().filter(|_| by_eyes);
        let squares = match balls {
            Some((_, [a, b])) => about_eyes(&(to_view * (a + b) / 2.0), (b - a).norm()),
            None => self.below_top(skin, to_view),
        };
        // One picture for squares of about a size.
        let mut drawn: Option<(Seen, f64)> = None;
        let mut found = Vec::with_capacity(squares.len());
        for (middle, side) in squares {
            let fits = |d: &(Seen, f64)| (0.55 * d.1..=1.001 * d.1).contains(&side);
            let (seen, largest) = drawn.take().filter(fits).unwrap_or_else(|| {
                let (parts, height) = (&self.parts, side * AROUND);
                (look(self.mesh, parts, skin, to_view, &middle, height), side)
            });
            let grey = seen.grey();
            let face_box = seen.square(&middle, side);
            let face = self
                .fitter
                .glance(&mien_workbench::dataset::picture(&grey), &face_box);
            let score = face.confidence * self.plausible(&seen, &face.points).0;
            let (middle, side) = seen.unsquare(&face.points);
            found.push(Glance {
                skin,
                to_view: *to_view,
                middle,
                side,
                score,
            });
            drawn = Some((seen, largest));
        }
        found
    }

    /// Squares below the top of a head.
    fn below_top(&self, skin: u32, to_view: &Matrix3<f64>) -> Vec<(Vec3, f64)> {
        let of_skin = self.mesh.positions.iter().zip(&self.parts.of);
        let of_skin = of_skin.filter(|(_, part)| **part == skin);
        let of_skin: Vec<Vec3> = of_skin.map(|(p, _)| to_view * p).collect();
        let (low, high) = extent_of(&of_skin);
        let mut side = LARGEST * (high.y - low.y);
        let mut squares = Vec::with_capacity(SIZES * TOP_BELOW.len());
        for _ in 0..SIZES {
            let lowest = high.y - 1.7 * side;
            let (left, right) = extent_of(of_skin.iter().filter(|p| p.y >= lowest));
            let middle = 0.5 * (left + right);
            for below in TOP_BELOW {
                let middle = Vec3::new(middle.x, high.y - below * side, middle.z);
                squares.push((middle, side));
            }
            side /= STEP;
        }
        squares
    }

    /// Where the picture has the points in space, and the depth there; nothing where it shows none.
    fn in_space(&self, seen: &Seen, points: &Points) -> [Vec3; LANDMARKS] {
        let deep = 0.5 * DEEP * f64::from(apart(points[39], points[42]));
        points.map(|point| {
            let [x, y] = point.map(f64::from);
            let gap = [-GAP, 0.0, GAP];
            let around = gap.iter().flat_map(|dx| gap.map(|dy| (x + dx, y + dy)));
            let depths = around.filter_map(|(x, y)| seen.canvas.depth(x, y));
            let Some(nearest) = depths.reduce(f64::max) else {
                return Vec3::zeros();
            };
            // Not what lies behind a gap between lips or lids.
            let here = seen.canvas.depth(x, y).filter(|d| nearest - d < deep);
            Vec3::new(x, -y, here.unwrap_or(nearest))
        })
    }

    /// How much the points are like a face in space, 1 if they lie as people have them, upright and towards the viewer; and
    /// the depths that people have there, pixels.
    fn plausible(&self, seen: &Seen, points: &Points) -> (f32, [f64; LANDMARKS]) {
        let mut there = self.in_space(seen, points);
        let nothing = |p: &Vec3| *p == Vec3::zeros();
        let missed = there[27..].iter().filter(|p| nothing(p)).count();
        if missed > MISSED {
            return (0.0, there.map(|p| p.z));
        }
        // Where the picture shows nothing, nothing is known.
        let depth = there[30].z;
        for (p, &[x, y]) in there.iter_mut().zip(points).filter(|(p, _)| nothing(p)) {
            *p = Vec3::new(f64::from(x), -f64::from(y), depth);
        }
        let Some(laid) = by_shape::laid(&self.model.shape, &there) else {
            return (0.0, there.map(|p| p.z));
        };
        let eyes = (laid[39] - laid[42]).norm();
        let off = (27..LANDMARKS).map(|k| (laid[k] - there[k]).norm_squared());
        let off = (off.sum::<f64>() / (LANDMARKS - 27) as f64).sqrt() / (UNLIKE * eyes);
        let (across, up) = (laid[45] - laid[36], laid[27] - laid[57]);
        let out = across.cross(&up).normalize();
        let facing = ((out.z - 0.5) / 0.4).clamp(0.0, 1.0)
            * ((up.normalize().y - 0.5) / 0.4).clamp(0.0, 1.0);
        let like = (-0.5 * off * off).exp() * facing;
        (like as f32, laid.map(|p| p.z))
    }

    /// The full fit in boxes about a face that was glanced at; kept if it is surer.
    fn closely(&mut self, glance: &Glance) {
        let width = glance.side / BOX;
        let middle = glance.middle - Vec3::y() * (MIDDLE * width);
        let (skin, to_view, height) = (glance.skin, &glance.to_view, FRAME * width);
        let seen = look(self.mesh, &self.parts, skin, to_view, &middle, height);
        let grey = seen.grey();
        let mut fits: Vec<Fit> = Vec::with_capacity(BOXES.len() * MIDDLES.len());
        for (share, above) in BOXES.iter().flat_map(|&s| MIDDLES.map(|m| (s, m))) {
            let face_box = seen.square(&(middle + Vec3::y() * (above * width)), share * width);
            let face = self
                .fitter
                .fit(&mien_workbench::dataset::picture(&grey), &face_box, 0.0);
            let score = face.confidence * self.plausible(&seen, &face.points).0;
            fits.push((score, face.confidence, face.points));
        }
        // The first of equals.
        fits.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (confidence, _, points) = fits[0];
        if self.best.as_ref().is_none_or(|b| confidence > b.confidence) {
            let (_, depths) = self.plausible(&seen, &points);
            self.best = Some(Face {
                skin,
                confidence,
                points,
                of_points: agreed(&fits),
                depths,
                seen,
            });
        }
    }
}

/// What a confidence is divided by for so many eye distances: 2 at `HALF`.
pub(super) fn halved(off: f32) -> f32 {
    1.0 + (off / HALF).powi(2)
}

/// Confidence of each point of the best of these fits: that of the face, halved where the next best ones put it `HALF` eye
/// distances away on average.
fn agreed(fits: &[Fit]) -> [f32; LANDMARKS] {
    let (_, confidence, points) = fits[0];
    let eyes = apart(points[39], points[42]).max(f32::MIN_POSITIVE);
    let others = &fits[1..fits.len().min(1 + OTHERS)];
    std::array::from_fn(|k| {
        let off = others.iter().map(|fit| apart(fit.2[k], points[k]));
        let off = off.sum::<f32>() / (others.len().max(1) as f32 * eyes);
        confidence / halved(off)
    })
}
