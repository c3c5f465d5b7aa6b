//! Pictures of a head for the report: orthographic, z-buffered, smooth shading from one lamp above the camera.
//!
//! Units: the mesh's; the view is given in the face frame (left, up, out). Cost: about 10 ms a picture of 320 pixels.
//! Limits: no texture; for judging form only.

use image::{Rgb, RgbImage};
use nalgebra::Matrix3;

use super::head::{Follow, Head};
use super::mesh::{Mesh, Vec3};

/// Where to look from and at what.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Turn about the vertical, radians; positive shows the subject's left cheek.
    pub yaw: f64,
    /// Middle of the picture in the face frame.
    pub middle: Vec3,
    /// Height of the picture, mesh units.
    pub height: f64,
}

impl View {
    /// The whole face from in front.
    #[must_use]
    pub fn face(head: &Head) -> Self {
        let face = head.axes.transpose();
        let (brow, chin) = (face * head.point(24), face * head.point(8));
        let root = face * head.point(27);
        let tall = brow.y - chin.y;
        Self {
            yaw: 0.0,
            middle: Vec3::new(root.x, chin.y + 0.52 * tall, root.z),
            height: 1.5 * tall,
        }
    }
}

/// Draws the head with its vertices moved by `d` (or neutral if empty) as a square picture.
#[must_use]
pub fn draw(head: &Head, d: &[Vec3], view: &View, pixels: u32) -> RgbImage {
    let n = head.mesh.positions.len();
    let positions: Vec<Vec3> = if d.len() == n {
        head.mesh
            .positions
            .iter()
            .zip(d)
            .map(|(p, d)| p + d)
            .collect()
    } else {
        head.mesh.positions.clone()
    };
    let (sin, cos) = view.yaw.sin_cos();
    let turn = Matrix3::new(cos, 0.0, -sin, 0.0, 1.0, 0.0, sin, 0.0, cos);
    let to_view = turn * head.axes.transpose();
    let seen: Vec<Vec3> = positions.iter().map(|p| to_view * p).collect();
    let tint = |[a, ..]: [u32; 3]| {
        let v = a as usize;
        match head.follow[v] {
            Follow::Skin if !head.socket[v].is_nan() => Some([150.0, 70.0, 66.0]),
            Follow::Skin => Some([214.0, 168.0, 142.0]),
            Follow::Eyeball(_) => Some([235.0, 238.0, 245.0]),
            Follow::Jaw(_) if head.tongue[v] > 0.0 => Some([205.0, 112.0, 108.0]),
            Follow::Jaw(_) => Some([225.0, 205.0, 185.0]),
            Follow::Nearest(_) | Follow::Still => None,
        }
    };
    let middle = turn * view.middle;
    paint(&head.mesh, &seen, &middle, view.height, pixels, tint).image
}

/// A picture with the depth of what it shows.
pub(super) struct Canvas {
    pub(super) image: RgbImage,
    depth: Vec<f64>,
    middle: Vec3,
    /// Pixels per unit of the mesh.
    scale: f64,
}

impl Canvas {
    /// Pixel of a point given as (right, up, towards the viewer), and its depth in pixels.
    pub(super) fn screen(&self, p: &Vec3) -> Vec3 {
        let half = f64::from(self.image.width()) / 2.0;
        let q = (p - self.middle) * self.scale;
        Vec3::new(half + q.x, half - q.y, q.z)
    }

    /// Whether nothing stands before a point (pixels, depth).
    pub(super) fn shows(&self, p: &Vec3) -> bool {
        /// A surface seen at a slant changes its depth within a pixel.
        const SLANT: f64 = 2.5;
        let (x, y) = (p.x.round(), p.y.round());
        let side = f64::from(self.image.width());
        let inside = x >= 0.0 && y >= 0.0 && x < side && y < side;
        inside && p.z > self.depth[(y * side + x) as usize] - SLANT
    }
}

/// Draws triangles of a mesh whose vertices are given as (right, up, towards the viewer); `tint` of a triangle is its
/// colour, or nothing to leave it out.
pub(super) fn paint(
    mesh: &Mesh,
    seen: &[Vec3],
    middle: &Vec3,
    height: f64,
    pixels: u32,
    tint: impl Fn([u32; 3]) -> Option<[f64; 3]>,
) -> Canvas {
    let normals = mesh.vertex_normals(seen);
    let lamp = Vec3::new(0.25, 0.45, 0.86);
    let mut canvas = Canvas {
        image: RgbImage::from_pixel(pixels, pixels, Rgb([38, 40, 44])),
        depth: vec![f64::NEG_INFINITY; (pixels * pixels) as usize],
        middle: *middle,
        scale: f64::from(pixels) / height,
    };
    let screen: Vec<Vec3> = seen.iter().map(|p| canvas.screen(p)).collect();
    for triangle in mesh.triangles() {
        let Some(tint) = tint(triangle) else { continue };
        let corner = triangle.map(|v| v as usize);
        let p = corner.map(|v| screen[v]);
        let twice = (p[1] - p[0]).xy().perp(&(p[2] - p[0]).xy());
        if twice.abs() < 1e-12 {
            continue;
        }
        let span = |pick: &dyn Fn(&Vec3) -> f64| {
            let low = p
                .iter()
                .map(pick)
                .fold(f64::INFINITY, f64::min)
                .ceil()
                .max(0.0);
            let high = p.iter().map(pick).fold(f64::NEG_INFINITY, f64::max).floor();
            (low as i64, (high.min(f64::from(pixels) - 1.0)) as i64)
        };
        let (left, right) = span(&|p| p.x);
        let (top, bottom) = span(&|p| p.y);
        for y in top..=bottom {
            for x in left..=right {
                let q = Vec3::new(x as f64, y as f64, 0.0);
                let share = |i: usize, j: usize| (p[i] - q).xy().perp(&(p[j] - q).xy()) / twice;
                let weights = [share(1, 2), share(2, 0), share(0, 1)];
                if weights.iter().any(|&w| w < 0.0) {
                    continue;
                }
                let z: f64 = (0..3).map(|k| weights[k] * p[k].z).sum();
                let at = (y * i64::from(pixels) + x) as usize;
                if z <= canvas.depth[at] {
                    continue;
                }
                canvas.depth[at] = z;
                let normal: Vec3 = (0..3).map(|k| normals[corner[k]] * weights[k]).sum();
                let facing = normal.normalize();
                let light = 0.22 + 0.78 * facing.dot(&lamp).max(0.0);
                // Seen from behind: dark, so that holes and turned faces show.
                let light = if facing.z < 0.0 { 0.10 } else { light };
                canvas.image.put_pixel(
                    x as u32,
                    y as u32,
                    Rgb(tint.map(|t: f64| (t * light).min(255.0) as u8)),
                );
            }
        }
    }
    canvas
}

/// Places pictures of equal size in rows.
#[must_use]
pub fn sheet(pictures: &[RgbImage], columns: u32) -> RgbImage {
    let (w, h) = pictures.first().map_or((1, 1), |p| p.dimensions());
    let rows = (pictures.len() as u32).div_ceil(columns).max(1);
    let mut out = RgbImage::new(w * columns, h * rows);
    for (k, picture) in pictures.iter().enumerate() {
        let (col, row) = (k as u32 % columns, k as u32 / columns);
        image::imageops::replace(&mut out, picture, i64::from(col * w), i64::from(row * h));
    }
    out
}
