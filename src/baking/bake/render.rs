//! Orthographic, z-buffered renderings of a head for the report, smoothly shaded by one lamp above the camera.
//!
//! Units: the mesh's; the view is given in the face frame (left, up, out). Cost: about 10 ms for 320 pixels. Known
//! colours and images are used ([`super::looks`]); only then are parts other than the face shown.

use image::{Rgb, RgbImage};
use nalgebra::Matrix3;

use super::head::{Follow, Head};
use super::looks::{Looks, Surfaces};
use super::mesh::{Mesh, Vec3};
use mien_simulator::virtual_head::raster::{self, DepthBuffer};

/// A head for rendering: its file's mesh, and the head's vertex for each of its own.
pub struct Outside<'a> {
    mesh: &'a Mesh,
    vertex: &'a [u32],
    surfaces: Surfaces<'a>,
}

impl<'a> Outside<'a> {
    /// From a mesh as its file has it.
    pub fn new(mesh: &'a Mesh, vertex: &'a [u32], looks: &Looks) -> Self {
        Self {
            mesh,
            vertex,
            surfaces: Surfaces::new(mesh, looks),
        }
    }

    /// Renders the face with the head's vertices displaced by `d` (neutral if empty), `pixels` square; a positive
    /// `yaw`, radians, shows the subject's left cheek.
    pub fn draw(&self, head: &Head, d: &[Vec3], yaw: f64, pixels: u32) -> RgbImage {
        let (sin, cos) = yaw.sin_cos();
        let turn = Matrix3::new(cos, 0.0, -sin, 0.0, 1.0, 0.0, sin, 0.0, cos);
        let to_face = head.axes.transpose();
        let to_view = turn * to_face;
        let of = |v: usize| self.vertex[v] as usize;
        let moved = |v: usize| d.get(of(v)).copied().unwrap_or_default();
        let places = self.mesh.positions.iter().enumerate();
        let seen: Vec<Vec3> = places.map(|(v, p)| to_view * (p + moved(v))).collect();
        let tint = |[a, ..]: [u32; 3], known: bool| {
            let v = of(a as usize);
            match head.follow[v] {
                Follow::Skin if !head.socket[v].is_nan() => Some([150.0, 70.0, 66.0]),
                Follow::Skin => Some([214.0, 168.0, 142.0]),
                Follow::Eyeball(_) => Some([235.0, 238.0, 245.0]),
                Follow::Jaw(_) if head.tongue[v] > 0.0 => Some([205.0, 112.0, 108.0]),
                Follow::Jaw(_) => Some([225.0, 205.0, 185.0]),
                Follow::Nearest(_) | Follow::Still => known.then_some([90.0, 90.0, 96.0]),
            }
        };
        let [brow, chin, root] = [24, 8, 27].map(|k| to_face * head.point(k));
        let tall = brow.y - chin.y;
        let middle = turn * Vec3::new(root.x, chin.y + 0.52 * tall, root.z);
        let (mesh, surfaces) = (self.mesh, Some(&self.surfaces));
        paint(mesh, &seen, &middle, 1.5 * tall, pixels, surfaces, tint).image
    }
}

/// An image with its depth.
pub struct Canvas {
    /// The image.
    pub image: RgbImage,
    depth: DepthBuffer,
    pub(super) middle: Vec3,
    /// Pixels per unit of the mesh.
    pub(super) scale: f64,
}

/// The rasteriser needs a positive depth that is linear in the image and grows towards the viewer, as a camera's
/// inverse distance is; an orthographic view uses the depth in pixels from a plane this far behind.
const BEHIND: f64 = 1e4;

impl Canvas {
    /// Pixel of a point given as (right, up, towards the viewer), and its depth in pixels.
    pub(super) fn screen(&self, p: &Vec3) -> Vec3 {
        let half = f64::from(self.image.width()) / 2.0;
        let q = (p - self.middle) * self.scale;
        Vec3::new(half + q.x, half - q.y, q.z)
    }

    /// The rasteriser's depth at a pixel, 0 where nothing is drawn; `None` outside the image.
    fn inverse(&self, x: f64, y: f64) -> Option<f64> {
        let side = f64::from(self.image.width());
        let (x, y) = (x.round(), y.round());
        let inside = x >= 0.0 && y >= 0.0 && x < side && y < side;
        inside.then(|| f64::from(self.depth.inverse[(y * side + x) as usize]))
    }

    /// Depth at a pixel, in pixels towards the viewer; `None` where nothing is drawn.
    pub(super) fn depth(&self, x: f64, y: f64) -> Option<f64> {
        self.inverse(x, y).filter(|&d| d > 0.0).map(|d| d - BEHIND)
    }

    /// Whether nothing covers a point (pixels, depth).
    pub(super) fn shows(&self, p: &Vec3) -> bool {
        /// Depth range within a pixel of a slanted surface.
        const SLANT: f64 = 2.5;
        self.inverse(p.x, p.y)
            .is_some_and(|d| p.z + BEHIND > d - SLANT)
    }
}

/// Renders triangles with vertices given as (right, up, towards the viewer). `tint` gets a triangle and whether it has a
/// colour of its own; it returns the colour of those without, or `None` to skip the triangle.
pub fn paint(
    mesh: &Mesh,
    seen: &[Vec3],
    middle: &Vec3,
    height: f64,
    pixels: u32,
    surfaces: Option<&Surfaces<'_>>,
    tint: impl Fn([u32; 3], bool) -> Option<[f64; 3]>,
) -> Canvas {
    let normals = mesh.vertex_normals(seen);
    let lamp = Vec3::new(0.25, 0.45, 0.86);
    let side = pixels as usize;
    let mut canvas = Canvas {
        image: RgbImage::from_pixel(pixels, pixels, Rgb([38, 40, 44])),
        depth: DepthBuffer::new(side, side),
        middle: *middle,
        scale: f64::from(pixels) / height,
    };
    let corner = |p: Vec3| raster::Corner::new([p.x as f32, p.y as f32], (p.z + BEHIND) as f32);
    let screen = seen.iter().map(|p| corner(canvas.screen(p)));
    let screen: Vec<raster::Corner> = screen.collect();
    let cut = |f: usize| mesh.solid(f).map(move |t| (mesh.face_material[f], t));
    for (material, mut corner) in (0..mesh.faces()).flat_map(cut) {
        let known = surfaces.filter(|surfaces| surfaces.know(material));
        let Some(tint) = tint(corner.map(|c| c.vertex), known.is_some()) else {
            continue;
        };
        let at = |k: usize| screen[corner[k].vertex as usize];
        let along = |k: usize| [at(k).x - at(0).x, at(k).y - at(0).y];
        let ([bx, by], [cx, cy]) = (along(1), along(2));
        // Two-sided; the rasteriser wants one orientation.
        if bx * cy < by * cx {
            corner.swap(1, 2);
        }
        let corners = corner.map(|c| screen[c.vertex as usize]);
        let normal = corner.map(|c| normals[c.vertex as usize]);
        let image = &mut canvas.image;
        canvas.depth.triangle_where(corners, |pixel, b, c| {
            let (b, c) = (f64::from(b), f64::from(c));
            let shares = [1.0 - b - c, b, c];
            let seen = known.map_or(Some(tint), |s| s.at(material, corner, shares));
            let Some(tint) = seen else { return false };
            let facing = (normal[0] * (1.0 - b - c) + normal[1] * b + normal[2] * c).normalize();
            let light = 0.22 + 0.78 * facing.dot(&lamp).max(0.0);
            // Back faces are dark, so that holes and inverted faces show.
            let light = if facing.z < 0.0 { 0.10 } else { light };
            let shade = Rgb(tint.map(|t: f64| (t * light).min(255.0) as u8));
            image.put_pixel((pixel % side) as u32, (pixel / side) as u32, shade);
            true
        });
    }
    canvas
}
