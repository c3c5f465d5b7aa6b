//! Searches renderings of a mesh for a face.
//!
//! The face model is run once on candidate squares around the eyeballs, or at all sizes below the top of a part.
//! Its points must be plausible in 3D ([`by_shape`]). The best candidates are fitted in several boxes.

use nalgebra::Matrix3;

use super::super::by_shape;
use super::super::mesh::{Mesh, Vec3, bounding_box};
use super::seen::{Parts, Seen, distance, draw_head};
use mien_simulator::virtual_head::Points;
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::face_model::FaceModel;
use mien_workbench::dataset::picture;
use mien_workbench::still::StillFitter;

/// Side of the rendering for the full fit, in head widths.
pub(super) const FRAME: f64 = 2.0;
/// Tried widths of the face box, in head widths.
const BOXES: [f64; 4] = [0.72, 0.82, 0.92, 1.02];
/// Tried heights of the box's middle above the image centre, in head widths.
const MIDDLES: [f64; 3] = [0.12, 0.04, -0.04];
/// Usual width of the face box, in head widths.
const BOX: f64 = 0.84;
/// Usual height of the middle of the face box, in head widths.
const MIDDLE: f64 = 0.04;
/// Sides of squares around eyeballs, in distances of their centres.
const EYE_SIDES: [f64; 3] = [2.4, 2.05, 1.75];
/// Offsets of squares around eyeballs below the eyes, in distances of their centres.
const EYES_BELOW: [f64; 3] = [0.4, 0.55, 0.7];
/// Side of the largest square below the top of a head, in heights of the mesh.
const LARGEST_SIDE: f64 = 0.95;
/// Number of sizes of squares below the top of a head.
const SIZES: usize = 15;
/// Ratio of successive sizes of squares below the top of a head.
const STEP: f64 = 1.2;
/// Offsets of the squares' middles below the top of a head, in sides.
const TOP_BELOW: [f64; 5] = [0.5, 0.7, 0.9, 1.1, 1.3];
/// Side of the rendering for candidates, in sides of its largest square.
const RENDERING_SIDE: f64 = 2.8;
/// Score from which a candidate is fitted at once.
const FIT_AT_ONCE: f32 = 0.4;
/// Number of candidates fitted last.
const FITTED_LAST: usize = 3;
/// Half the width of a gap that is searched for depth, pixels.
const GAP: f64 = 3.0;
/// Points of eyes, nose and lips that may fall beside the head.
const MAX_MISSED: usize = 3;
/// Distance of points from the shape model at which a face is implausible, in inner-eye-corner distances.
const UNLIKE: f64 = 0.25;
/// Confidence that ends the search over directions.
const SURE_CONFIDENCE: f32 = 0.6;
/// Depth difference from the shape model that excludes a vertex, in inner-eye-corner distances.
pub(super) const DEEP: f64 = 0.4;
/// Number of next-best fits from which the confidence of points is computed.
const COMPARED_FITS: usize = 4;
/// Mean distance of a point in these fits that halves its confidence, in inner-eye-corner distances.
const HALF: f32 = 0.1;

/// One fit: score, the model's confidence, the points.
type Fit = (f32, f32, Points);

/// Squares around eyeballs at this distance: middle and side.
fn about_eyes(middle: &Vec3, distance: f64) -> Vec<(Vec3, f64)> {
    let sizes = EYE_SIDES.iter().flat_map(|&s| EYES_BELOW.map(|b| (s, b)));
    let square = |(side, below)| (middle - Vec3::y() * (below * distance), side * distance);
    sizes.map(square).collect()
}

/// A square in a view with the result of one run of the face model.
struct Candidate {
    skin: u32,
    to_view: Matrix3<f64>,
    /// In the view, the mesh's unit.
    middle: Vec3,
    side: f64,
    score: f32,
}

/// A face after the full fit.
pub(super) struct Face {
    pub(super) skin: u32,
    pub(super) confidence: f32,
    pub(super) points: Points,
    pub(super) point_confidence: [f32; LANDMARKS],
    /// Depths of the points by the shape model, pixels.
    pub(super) depths: [f64; LANDMARKS],
    pub(super) seen: Seen,
}

/// Search for the face of a mesh.
pub(super) struct Search<'a> {
    mesh: &'a Mesh,
    pub(super) parts: Parts<'a>,
    model: &'a FaceModel,
    fitter: StillFitter<'a>,
    /// The most confident face so far.
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
        let best = self.best.as_ref();
        best.is_some_and(|b| b.confidence > SURE_CONFIDENCE)
    }

    /// Searches all directions, or `only` one, until a face is certain: around the eyes if there are any, then
    /// anywhere.
    pub(super) fn all_around(&mut self, only: Option<&Matrix3<f64>>) {
        for by_eyes in [true, false] {
            if by_eyes && self.parts.balls.is_none() {
                continue;
            }
            let mut candidates: Vec<Candidate> = Vec::new();
            let frames = only.map_or_else(|| self.parts.frames(by_eyes), |only| vec![*only]);
            let skins = self.parts.skins.clone();
            let pairs = frames
                .iter()
                .flat_map(|f| skins.iter().map(move |s| (f, *s)));
            for (to_view, skin) in pairs {
                let some = self.candidates(skin, to_view, by_eyes);
                // The best candidate of a direction is fitted before the next direction.
                let likeliest = some.iter().max_by(|a, b| a.score.total_cmp(&b.score));
                if let Some(candidate) = likeliest.filter(|g| g.score > FIT_AT_ONCE) {
                    self.refine(candidate);
                    if self.is_sure() {
                        return;
                    }
                }
                candidates.extend(some);
            }
            candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
            for candidate in candidates.iter().take(FITTED_LAST) {
                self.refine(candidate);
            }
            if self.is_sure() {
                return;
            }
        }
    }

    /// Candidates in one direction: around the eyes, or below the top of the head at all sizes.
    fn candidates(&mut self, skin: u32, to_view: &Matrix3<f64>, by_eyes: bool) -> Vec<Candidate> {
        let balls = self.parts.balls.as_ref().filter(|_| by_eyes);
        let squares = match balls {
            Some((_, [a, b])) => about_eyes(&(to_view * (a + b) / 2.0), (b - a).norm()),
            None => self.below_top(skin, to_view),
        };
        // Squares of similar size share a rendering.
        let mut drawn: Option<(Seen, f64)> = None;
        let mut found = Vec::with_capacity(squares.len());
        for (middle, side) in squares {
            let fits = |d: &(Seen, f64)| (0.55 * d.1..=1.001 * d.1).contains(&side);
            let (seen, largest) = drawn.take().filter(fits).unwrap_or_else(|| {
                let (mesh, height) = (self.mesh, side * RENDERING_SIDE);
                let seen = draw_head(mesh, &self.parts, skin, to_view, &middle, height);
                (seen, side)
            });
            let grey = seen.grey();
            let face_box = seen.square(&middle, side);
            let face = self.fitter.fit_frontal(&picture(&grey), &face_box);
            let score = face.confidence * self.plausible(&seen, &face.points).0;
            let (middle, side) = seen.unsquare(&face.points);
            found.push(Candidate {
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
        let (low, high) = bounding_box(&of_skin);
        let mut side = LARGEST_SIDE * (high.y - low.y);
        let mut squares = Vec::with_capacity(SIZES * TOP_BELOW.len());
        for _ in 0..SIZES {
            let lowest = high.y - 1.7 * side;
            let (left, right) = bounding_box(of_skin.iter().filter(|p| p.y >= lowest));
            let middle = 0.5 * (left + right);
            for below in TOP_BELOW {
                let middle = Vec3::new(middle.x, high.y - below * side, middle.z);
                squares.push((middle, side));
            }
            side /= STEP;
        }
        squares
    }

    /// Points of a fit in 3D, with the rendering's depth; `NaN` where it shows nothing.
    fn in_space(&self, seen: &Seen, points: &Points) -> [Vec3; LANDMARKS] {
        let deep = 0.5 * DEEP * f64::from(distance(points[39], points[42]));
        points.map(|point| {
            let [x, y] = point.map(f64::from);
            let gap = [-GAP, 0.0, GAP];
            let around = gap.iter().flat_map(|dx| gap.map(|dy| (x + dx, y + dy)));
            let depths = around.filter_map(|(x, y)| seen.canvas.depth(x, y));
            let Some(nearest) = depths.reduce(f64::max) else {
                return Vec3::zeros();
            };
            // Without surfaces behind a gap between lips or lids.
            let here = seen.canvas.depth(x, y).filter(|d| nearest - d < deep);
            Vec3::new(x, -y, here.unwrap_or(nearest))
        })
    }

    /// Plausibility of the points in 3D, 1 if they match the shape model upright and facing the viewer; and its
    /// depths for them, pixels.
    fn plausible(&self, seen: &Seen, points: &Points) -> (f32, [f64; LANDMARKS]) {
        let mut there = self.in_space(seen, points);
        let nothing = |p: &Vec3| *p == Vec3::zeros();
        let missed = there[27..].iter().filter(|p| nothing(p)).count();
        if missed > MAX_MISSED {
            return (0.0, there.map(|p| p.z));
        }
        // Points without depth are ignored.
        let depth = there[30].z;
        for (p, &[x, y]) in there.iter_mut().zip(points).filter(|(p, _)| nothing(p)) {
            *p = Vec3::new(f64::from(x), -f64::from(y), depth);
        }
        let Some(laid) = by_shape::completed(&self.model.shape, &there) else {
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

    /// Fits the face of a candidate in several boxes; kept if it is more confident.
    fn refine(&mut self, candidate: &Candidate) {
        let width = candidate.side / BOX;
        let middle = candidate.middle - Vec3::y() * (MIDDLE * width);
        let (skin, to_view, height) = (candidate.skin, &candidate.to_view, FRAME * width);
        let seen = draw_head(self.mesh, &self.parts, skin, to_view, &middle, height);
        let grey = seen.grey();
        let mut fits: Vec<Fit> = Vec::with_capacity(BOXES.len() * MIDDLES.len());
        for (share, above) in BOXES.iter().flat_map(|&s| MIDDLES.map(|m| (s, m))) {
            let face_box = seen.square(&(middle + Vec3::y() * (above * width)), share * width);
            let face = self.fitter.fit(&picture(&grey), &face_box, 0.0);
            let score = face.confidence * self.plausible(&seen, &face.points).0;
            fits.push((score, face.confidence, face.points));
        }
        // Stable: the first of equals.
        fits.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (confidence, _, points) = fits[0];
        if self.best.as_ref().is_none_or(|b| confidence > b.confidence) {
            let (_, depths) = self.plausible(&seen, &points);
            self.best = Some(Face {
                skin,
                confidence,
                points,
                point_confidence: agreed(&fits),
                depths,
                seen,
            });
        }
    }
}

/// Divisor of a confidence for a distance in eye distances: 2 at `HALF`.
pub(super) fn distance_penalty(off: f32) -> f32 {
    1.0 + (off / HALF).powi(2)
}

/// Confidence of each point of the best fit: the face's, halved where the next-best fits put the point `HALF` eye
/// distances away on average.
fn agreed(fits: &[Fit]) -> [f32; LANDMARKS] {
    let (_, confidence, points) = fits[0];
    let eyes = distance(points[39], points[42]).max(f32::MIN_POSITIVE);
    let others = &fits[1..fits.len().min(1 + COMPARED_FITS)];
    std::array::from_fn(|k| {
        let off = others.iter().map(|fit| distance(fit.2[k], points[k]));
        let off = off.sum::<f32>() / (others.len().max(1) as f32 * eyes);
        confidence / distance_penalty(off)
    })
}
