//! A head drawn from one direction.
//!
//! Units: the mesh's; pictures in pixels.

use nalgebra::Matrix3;

use super::super::mesh::{Mesh, Vec3};
use super::super::render::{Canvas, paint};
use super::parts::Parts;
use crate::base::capacity::LANDMARKS;
use crate::studio::fit::still::FaceBox;
use crate::studio::train::dataset::GreyPicture;

/// Side of the picture, pixels.
pub(super) const PIXELS: u32 = 360;
/// Cosine of the cone that an iris fills on an eyeball seen from its centre.
const IRIS: f64 = 0.87;

/// The head from one direction.
pub(super) struct Seen {
    /// Mesh to (right, up, towards the viewer).
    pub(super) to_view: Matrix3<f64>,
    /// The middle of the picture there.
    pub(super) middle: Vec3,
    /// What mirrors the head lies there, to the right.
    pub(super) plane: f64,
    /// Pixels per unit.
    pub(super) scale: f64,
    pub(super) canvas: Canvas,
}

impl Seen {
    /// Pixels, and depth in pixels towards the viewer.
    pub(super) fn screen(&self, p: &Vec3) -> Vec3 {
        self.canvas.screen(&(self.to_view * p))
    }

    pub(super) fn grey(&self) -> GreyPicture {
        let pixels = self.canvas.image.pixels();
        GreyPicture {
            luma: pixels.map(|p| image::Pixel::to_luma(p).0[0]).collect(),
            width: PIXELS as usize,
            height: PIXELS as usize,
        }
    }

    /// Pixels of a square in the view.
    pub(super) fn square(&self, middle: &Vec3, side: f64) -> FaceBox {
        let (at, side) = (self.canvas.screen(middle), side * self.scale);
        FaceBox {
            x: (at.x - 0.5 * side) as f32,
            y: (at.y - 0.5 * side) as f32,
            width: side as f32,
            height: side as f32,
        }
    }

    /// The square in the view that points fill, its middle and side.
    pub(super) fn unsquare(&self, points: &[[f32; 2]; LANDMARKS]) -> (Vec3, f64) {
        let b = FaceBox::around(points);
        let half = f64::from(PIXELS) / 2.0;
        let [x, y] = [b.x + 0.5 * b.width, b.y + 0.5 * b.height].map(f64::from);
        let off = Vec3::new(x - half, half - y, 0.0) / self.scale;
        let side = f64::from(b.width * b.height).sqrt() / self.scale;
        (self.middle + off, side)
    }
}

/// Draws the head: skin, and eyes with an iris.
pub(super) fn look(
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
        Some(if iris {
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

/// Pixels between two points.
pub(super) fn apart(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}
