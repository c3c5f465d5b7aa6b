//! `--landmarks auto`: the 68 vertices of a head that comes without them.
//!
//! The head is drawn from in front, the shipped face model is fitted to the picture in boxes around the foremost point, and
//! each fitted point is cast back to the visible vertex it lies on. What lines an opening (lids, inner lips) goes to the
//! nearest vertex of a rim: visible, with a neighbour that is not. A head that mirrors itself gets points that do. Brows and
//! jaw, which plaster does not show, are where the other points say that people have them ([`super::by_shape`]).
//!
//! Frame: y up, the face towards z (or, tried if nothing is found there, −z or ±x). Units: the mesh's; pictures in pixels.
//! Cost: about 60 fits, well below a second. Limits: the model has learned photographs, not plaster: a face without brows
//! and lips in colour is placed to some hundredths of its width, so that the picture wants a look.
//! One file: from a mesh to its 68 vertices, each step used by the next only.

use image::RgbImage;
use nalgebra::Matrix3;

use super::by_shape;
use super::mesh::{Mesh, Vec3};
use super::render::{Canvas, paint};
use crate::base::capacity::LANDMARKS;
use crate::face_model::FaceModel;
use crate::face_model::scheme::MIRROR;
use crate::landmarks::window::Picture;
use crate::studio::fit::{FaceBox, StillFitter};
use crate::studio::inspect::canvas;

/// Side of the picture, pixels.
const PIXELS: u32 = 360;
/// The picture to look at is larger by this.
const ENLARGED: u32 = 3;
/// Height and width of the picture in widths of the head at its foremost point.
const FRAME: f64 = 2.0;
/// Widths of the face box tried, in widths of the head.
const BOXES: [f64; 4] = [0.72, 0.82, 0.92, 1.02];
/// Heights of the box's middle tried above the foremost point, in widths of the head.
const MIDDLES: [f64; 3] = [0.12, 0.04, -0.04];
/// A face less certain than this is none.
const LEAST: f32 = 0.2;
/// Sure enough to look in no other direction.
const SURE: f32 = 0.5;
/// A rim vertex further than this from a fitted point is another opening's, in widths of the head.
const RIM: f64 = 0.03;
/// Points 0 to 16 are the jaw's, up to 26 the brows'.
const UNMARKED: usize = 27;
/// A point this far from where the others say it is, in inner-eye-corner distances, is hardly believed.
const DOUBTFUL: f64 = 0.1;
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
        "expected a face in the picture of the mesh (y up, face towards z), found none with more than {confidence:.2} confidence; give the 68 vertices with --landmarks FILE"
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
    /// The head with the points drawn in.
    pub picture: RgbImage,
}

/// The head from one direction.
struct Seen {
    /// Mesh to (right, up, towards the viewer).
    to_view: Matrix3<f64>,
    /// The foremost point there, where the picture's middle is.
    tip: Vec3,
    canvas: Canvas,
}

/// Finds the landmarks.
///
/// # Errors
/// If no face is to be seen.
pub fn locate(mesh: &Mesh, model: &FaceModel) -> Result<Located, LocateError> {
    let found = guess(mesh, model)?;
    if found.confidence < LEAST {
        return Err(LocateError::NoFace {
            confidence: found.confidence,
        });
    }
    Ok(found)
}

/// The same with however little confidence, for a person to correct.
///
/// # Errors
/// If there is nothing to look at.
pub fn guess(mesh: &Mesh, model: &FaceModel) -> Result<Located, LocateError> {
    let rings = mesh.rings();
    let (component, count) = mesh.components(&rings);
    let mut size = vec![0_usize; count];
    for &c in &component {
        size[c as usize] += 1;
    }
    let largest = (0..count).max_by_key(|&c| size[c]).unwrap_or(0) as u32;
    let skin: Vec<bool> = component.iter().map(|&c| c == largest).collect();
    let mut fitter = StillFitter::new(model);
    let mut best: Option<(Fit, [f32; LANDMARKS], Seen)> = None;
    for quarter in [0, 2, 1, 3] {
        if best.as_ref().is_some_and(|b| b.0.1 > SURE) {
            break;
        }
        let seen = look(
            mesh,
            &component,
            &skin,
            f64::from(quarter) * std::f64::consts::FRAC_PI_2,
        );
        let luma: Vec<u8> = seen
            .canvas
            .image
            .pixels()
            .map(|p| image::Pixel::to_luma(p).0[0])
            .collect();
        let picture = Picture {
            luma: &luma,
            width: PIXELS as usize,
            height: PIXELS as usize,
        };
        let width_px = f64::from(PIXELS) / FRAME;
        let middle = f64::from(PIXELS) / 2.0;
        let mut fits: Vec<Fit> = Vec::with_capacity(BOXES.len() * MIDDLES.len());
        for (share, above) in BOXES.iter().flat_map(|&s| MIDDLES.map(|m| (s, m))) {
            let side = share * width_px;
            let face_box = FaceBox {
                x: (middle - 0.5 * side) as f32,
                y: (middle - above * width_px - 0.5 * side) as f32,
                width: side as f32,
                height: side as f32,
            };
            let face = fitter.fit(&picture, &face_box, 0.0);
            // The nose's tip is the foremost point of a head that faces us.
            let [x, y] = face.points[30].map(|p| f64::from(p) - middle);
            let score = face.confidence - (x.hypot(y) / width_px) as f32;
            fits.push((score, face.confidence, face.points));
        }
        // The first of equals.
        fits.sort_by(|a, b| b.0.total_cmp(&a.0));
        if let Some(&fit) = fits.first()
            && best.as_ref().is_none_or(|b| fit.1 > b.0.1)
        {
            best = Some((fit, agreed(&fits), seen));
        }
    }
    let ((_, confidence, points), mut of_points, seen) =
        best.ok_or(LocateError::NoFace { confidence: 0.0 })?;
    let (mut vertices, symmetric) = cast(mesh, &rings, &skin, &points, &seen);
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
    Ok(Located {
        vertices: vertices.into_iter().map(u64::from).collect(),
        confidence,
        of_points,
        picture,
    })
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
            other.x = 2.0 * seen.tip.x - other.x;
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
}

/// Draws the head seen along one of four directions: skin, and eyes with an iris.
fn look(mesh: &Mesh, component: &[u32], skin: &[bool], yaw: f64) -> Seen {
    let (sin, cos) = yaw.sin_cos();
    let to_view = Matrix3::new(cos, 0.0, -sin, 0.0, 1.0, 0.0, sin, 0.0, cos);
    let view: Vec<Vec3> = mesh.positions.iter().map(|p| to_view * p).collect();
    let of_skin = || (0..view.len()).filter(|&v| skin[v]).map(|v| view[v]);
    let tip = of_skin()
        .max_by(|a, b| a.z.total_cmp(&b.z))
        .unwrap_or_default();
    let tall = of_skin().map(|p| p.y).fold(f64::NEG_INFINITY, f64::max)
        - of_skin().map(|p| p.y).fold(f64::INFINITY, f64::min);
    let level = || {
        of_skin()
            .filter(|p| (p.y - tip.y).abs() < 0.05 * tall)
            .map(|p| p.x)
    };
    let width = level().fold(f64::NEG_INFINITY, f64::max) - level().fold(f64::INFINITY, f64::min);
    let balls = eyeballs(&view, component, &tip, width);
    let tint = |t: [u32; 3]| {
        let v = t[0] as usize;
        if skin[v] {
            return Some([205.0, 165.0, 140.0]);
        }
        let (_, center) = balls.iter().find(|(c, _)| *c == component[v])?;
        let middle = t.iter().map(|&v| view[v as usize]).sum::<Vec3>() / 3.0 - center;
        Some(if middle.z > IRIS * middle.norm() {
            [60.0, 45.0, 35.0]
        } else {
            [235.0, 238.0, 245.0]
        })
    };
    let canvas = paint(mesh, &view, &tip, width * FRAME, PIXELS, tint);
    Seen {
        to_view,
        tip,
        canvas,
    }
}

/// Parts that look like eyeballs, with their centres: round, above the tip and beside it.
fn eyeballs(view: &[Vec3], component: &[u32], tip: &Vec3, width: f64) -> Vec<(u32, Vec3)> {
    let count = component.iter().max().map_or(0, |&c| c as usize + 1);
    let none = (Vec3::repeat(f64::INFINITY), Vec3::repeat(f64::NEG_INFINITY));
    let mut boxes = vec![none; count];
    for (p, &c) in view.iter().zip(component) {
        let b = &mut boxes[c as usize];
        *b = (b.0.inf(p), b.1.sup(p));
    }
    let eye = |&(c, (low, high)): &(usize, (Vec3, Vec3))| {
        let (size, middle) = (high - low, (low + high) / 2.0 - tip);
        let round = size.min() > 0.6 * size.max() && (0.1..0.32).contains(&(size.max() / width));
        let place = middle.y > 0.0 && (0.08..0.4).contains(&(middle.x.abs() / width));
        (round && place).then_some((c as u32, (low + high) / 2.0))
    };
    let numbered: Vec<(usize, (Vec3, Vec3))> = boxes.into_iter().enumerate().collect();
    numbered.iter().filter_map(eye).collect()
}

/// The vertex under each fitted point, and whether the head mirrors itself.
fn cast(
    mesh: &Mesh,
    rings: &super::mesh::Rings,
    skin: &[bool],
    points: &[[f32; 2]; LANDMARKS],
    seen: &Seen,
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
    // Mirrored points in a mirrored head: the mean of both sides about the plane through the tip.
    let middle = f64::from(PIXELS) / 2.0;
    let symmetric = mirrored(&screen, skin, middle, width_px);
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
        let edge = matches!(k, 36..=47 | 60..=67)
            .then(|| nearest(&lines).filter(|&v| far(v) < RIM * width_px))
            .flatten();
        let vertex = edge.or_else(|| nearest(&|_| true)).unwrap_or(0);
        taken.push(vertex as u32);
    }
    (taken, symmetric)
}

/// Whether nearly all of the skin has a partner on the other side of the middle.
fn mirrored(screen: &[Vec3], skin: &[bool], middle: f64, width_px: f64) -> bool {
    let cell = 0.02 * width_px;
    let key = |x: f64, p: &Vec3| [x, p.y, p.z].map(|c| (c / cell).round() as i64);
    let some = || {
        screen
            .iter()
            .zip(skin)
            .filter(|(_, skin)| **skin)
            .map(|(p, _)| p)
    };
    let there: std::collections::HashSet<[i64; 3]> = some().map(|p| key(p.x - middle, p)).collect();
    let (mut alone, mut all) = (0, 0);
    for p in some() {
        let [x, y, z] = key(middle - p.x, p);
        let near = |d: i64| there.contains(&[x + d, y, z]);
        all += 1;
        alone += usize::from(!(near(0) || near(1) || near(-1)));
    }
    alone * 20 < all
}
