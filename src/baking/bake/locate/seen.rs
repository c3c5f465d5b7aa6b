//! Parts of a mesh that may be face skin or eyes, and the head rendered from one direction.
//!
//! Units: the mesh's; pictures in pixels.

use image::GrayImage;
use nalgebra::Matrix3;

use super::super::looks::Surfaces;
use super::super::mesh::{Mesh, Rings, Vec3, bounding_box};
use super::super::render::{Canvas, paint};
use mien_stages::base::capacity::LANDMARKS;
use mien_workbench::still::FaceBox;

/// Side of the picture, pixels.
pub(super) const PIXELS: u32 = 360;
/// Cosine of the half angle of the iris, seen from the eyeball's centre.
const IRIS: f64 = 0.87;
/// Parts with fewer vertices than the largest part's over this are not tried as skin.
const SKIN_DIVISOR: usize = 12;
/// Most parts tried as skin.
const MAX_SKINS: usize = 3;
/// Least ratio of the extents of an eyeball, or of half of one.
const ROUND: f64 = 0.4;
/// Most round parts that are compared in pairs.
const MAX_ROUND_PARTS: usize = 100;
/// Extent of a small part, as share of the skin's.
const SMALL: f64 = 0.35;

/// Connected parts of a mesh.
pub(super) struct Parts<'a> {
    /// Part of each vertex.
    pub(super) of: Vec<u32>,
    /// Parts that may carry the face, the likeliest first.
    pub(super) skins: Vec<u32>,
    /// Parts that are eyeballs or lie inside them, and the centres of the two.
    pub(super) balls: Option<(Vec<u32>, [Vec3; 2])>,
    /// Whether each part is small beside the skin: brows, lashes, flat eyes.
    pub(super) small: Vec<bool>,
    /// Colours, if known.
    pub(super) surfaces: Option<Surfaces<'a>>,
}

impl Parts<'_> {
    pub(super) fn new(mesh: &Mesh, rings: &Rings) -> Self {
        let (of, count) = mesh.components(rings);
        let (mut boxes, mut size) = (vec![bounding_box([]); count], vec![0_usize; count]);
        for (p, &c) in mesh.positions.iter().zip(&of) {
            let b = &mut boxes[c as usize];
            *b = (b.0.inf(p), b.1.sup(p));
            size[c as usize] += 1;
        }
        let balls = eyeballs(&boxes);
        // Skin surrounds both eyes; hair and clothes may have more vertices.
        let holds = |c: u32| {
            let (low, high) = boxes[c as usize];
            let within = |p: &Vec3| p.inf(&high) == *p && p.sup(&low) == *p;
            let both = |(_, centers): &(Vec<u32>, [Vec3; 2])| centers.iter().all(within);
            balls.as_ref().is_some_and(both)
        };
        let mut skins: Vec<u32> = (0..count as u32).collect();
        skins.sort_by_key(|&c| std::cmp::Reverse((holds(c), size[c as usize])));
        let most = skins.iter().map(|&c| size[c as usize]).max().unwrap_or(0);
        skins.retain(|&c| size[c as usize] * SKIN_DIVISOR > most);
        skins.truncate(MAX_SKINS);
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

    /// Views to try: up is y or z; four ways to face, and with eyes only those in which they are level.
    pub(super) fn frames(&self, by_eyes: bool) -> Vec<Matrix3<f64>> {
        let balls = self.balls.as_ref().filter(|_| by_eyes);
        let across = balls.map(|(_, [a, b])| (b - a).normalize());
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

/// The pair of round parts of one size level beside each other, and the round parts inside them.
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
    let whole = (0..boxes.len()).map(wide).fold(0.0, f64::max);
    let mut best: Option<(f64, usize, usize)> = None;
    for (k, &a) in round.iter().enumerate().take(MAX_ROUND_PARTS) {
        for &b in round[k + 1..].iter().take(MAX_ROUND_PARTS) {
            let (size, apart) = (0.5 * (wide(a) + wide(b)), middle(b) - middle(a));
            let along = apart.amax();
            let off = (apart.norm_squared() - along * along).max(0.0).sqrt();
            let alike = (wide(a) - wide(b)).abs() < 0.15 * size && off < 0.3 * size;
            let is_pair = alike && (1.4..4.5).contains(&(along / size)) && size < 0.3 * whole;
            // Of nested ones the largest.
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

/// The head rendered from one direction.
pub(super) struct Seen {
    /// Mesh to (right, up, towards the viewer).
    pub(super) to_view: Matrix3<f64>,
    pub(super) canvas: Canvas,
}

impl Seen {
    /// Pixel of a point, and depth in pixels towards the viewer.
    pub(super) fn screen(&self, p: &Vec3) -> Vec3 {
        self.canvas.screen(&(self.to_view * p))
    }

    pub(super) fn grey(&self) -> GrayImage {
        image::imageops::grayscale(&self.canvas.image)
    }

    /// Pixels of a square given in the view.
    pub(super) fn square(&self, middle: &Vec3, side: f64) -> FaceBox {
        let (at, side) = (self.canvas.screen(middle), side * self.canvas.scale);
        let [x, y] = [at.x, at.y].map(|c| (c - 0.5 * side) as f32);
        FaceBox::new(x, y, side as f32, side as f32)
    }

    /// The bounding square of points, in the view: middle and side.
    pub(super) fn unsquare(&self, points: &[[f32; 2]; LANDMARKS]) -> (Vec3, f64) {
        let b = FaceBox::around(points);
        let half = f64::from(PIXELS) / 2.0;
        let [x, y] = [b.x + 0.5 * b.width, b.y + 0.5 * b.height].map(f64::from);
        let Canvas { scale, middle, .. } = self.canvas;
        let off = Vec3::new(x - half, half - y, 0.0) / scale;
        let side = f64::from(b.width * b.height).sqrt() / scale;
        (middle + off, side)
    }
}

/// Renders the head: skin, and eyes with an iris.
pub(super) fn draw_head(
    mesh: &Mesh,
    parts: &Parts<'_>,
    skin: u32,
    to_view: &Matrix3<f64>,
    middle: &Vec3,
    height: f64,
) -> Seen {
    let view: Vec<Vec3> = mesh.positions.iter().map(|p| to_view * p).collect();
    let balls = parts.balls.as_ref();
    let balls = balls.map(|(all, centers)| (all, centers.map(|c| to_view * c)));
    let tint = |t: [u32; 3]| {
        let part = parts.of[t[0] as usize];
        if part == skin {
            return Some([205.0, 165.0, 140.0]);
        }
        let (all, centers) = balls.as_ref()?;
        if !all.contains(&part) {
            return None;
        }
        let at = t.iter().map(|&v| view[v as usize]).sum::<Vec3>() / 3.0;
        let [a, b] = centers.map(|c| at - c);
        let off = if a.norm() < b.norm() { a } else { b };
        let iris = off.z > IRIS * off.norm();
        let white = [235.0, 238.0, 245.0];
        Some(if iris { [60.0, 45.0, 35.0] } else { white })
    };
    let draw = |surfaces, tint: &dyn Fn([u32; 3], bool) -> _| {
        paint(mesh, &view, middle, height, PIXELS, surfaces, tint)
    };
    let mut canvas = draw(None, &|t, _| tint(t));
    if let Some(surfaces) = &parts.surfaces {
        // Depth stays the skin's, onto which points are cast.
        let small = |t: [u32; 3]| parts.small[parts.of[t[0] as usize] as usize];
        let tint = |t, known| tint(t).or((known && small(t)).then_some([0.0; 3]));
        canvas.image = draw(Some(surfaces), &tint).image;
    }
    Seen {
        to_view: *to_view,
        canvas,
    }
}

/// Distance of two points, pixels.
pub(super) fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}
