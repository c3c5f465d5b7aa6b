//! Draws a head and simple shapes for both cameras.
//!
//! Light is ambient plus directional (Lambert 1760), evaluated at vertices and interpolated (Gouraud 1971). Buffers are made once
//! per mesh; drawing allocates nothing. Units: vertices in the sensor frame, metres; corners in pixels.

use super::asset::{HeadAsset, Part};
use super::body::Shape;
use super::raster::{Corner, DepthBuffer, Window, mix, project, sum_normals};
use mien_stages::base::defaults;
use mien_stages::base::geometry::{Point, Rigid, Rotation, Vector};

defaults! {
    /// The light of a scene.
    #[derive(Clone, Copy, Debug)]
    pub struct Light {
        /// Unit vector from the scene towards the light, sensor frame.
        pub towards: Vector = Vector::new(-0.35, -0.55, -0.76),
        /// Share of ambient light, 0…1.
        pub ambient: f32 = 0.62,
        /// Gain of red, green and blue: colour temperature.
        pub tint: [f32; 3] = [1.0; 3],
        /// Brightness of each [`Part`], by its number.
        pub parts: [f32; Part::COUNT] = [1.0; Part::COUNT],
    }
}

impl Light {
    /// Brightness of a surface with this outward unit normal.
    pub(super) fn brightness_on(&self, normal: &Vector) -> f32 {
        self.ambient + (1.0 - self.ambient) * normal.dot(&self.towards).max(0.0)
    }
}

/// A colour picture with its depth buffer.
pub struct Canvas {
    /// Depth of each pixel.
    pub depth: DepthBuffer,
    /// Colours, row by row.
    pub rgb: Vec<[u8; 3]>,
}

impl Canvas {
    /// A black image of this size.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            depth: DepthBuffer::new(width, height),
            rgb: vec![[0; 3]; width * height],
        }
    }

    /// Changes the size and clears the depth; keeps the memory.
    #[cfg(feature = "studio")]
    pub fn resize(&mut self, width: usize, height: usize) {
        self.depth.width = width;
        self.depth.height = height;
        self.depth.inverse.clear();
        self.depth.inverse.resize(width * height, 0.0);
        self.rgb.resize(width * height, [0; 3]);
    }
}

/// Rounds to a grey level; the cast saturates at 0 and 255.
#[inline]
fn grey(value: f32) -> u8 {
    (value + 0.5) as u8
}

fn turned(triangle: [u32; 3], mirrored: bool) -> [usize; 3] {
    let [a, b, c] = triangle.map(|k| k as usize);
    if mirrored { [a, c, b] } else { [a, b, c] }
}

/// Work space for one head.
pub struct HeadPainter {
    /// Deformed vertices, head frame.
    pub deformed: Vec<Point>,
    /// Deformed vertices, sensor frame.
    pub(crate) placed: Vec<Point>,
    normals: Vec<Vector>,
    bright: Vec<f32>,
    corners: Vec<Corner>,
    /// Share by which each vertex follows the torso instead of the head, 0…1.
    neck: Vec<f32>,
    /// Whether the deformed vertices are a mirror image, so that corners must be swapped.
    pub mirrored: bool,
}

/// Heights below the eyes at which the neck begins to follow the torso, and follows it fully, metres.
const NECK_M: [f32; 2] = [0.125, 0.21];

impl HeadPainter {
    /// Work space for this head.
    pub fn new(asset: &HeadAsset) -> Self {
        let n = asset.neutral.len();
        let stays = |p: &Point| ((p.y - NECK_M[0]) / (NECK_M[1] - NECK_M[0])).clamp(0.0, 1.0);
        Self {
            deformed: asset.neutral.clone(),
            placed: asset.neutral.clone(),
            normals: vec![Vector::zeros(); n],
            bright: vec![0.0; n],
            corners: vec![Corner::default(); n],
            neck: asset.neutral.iter().map(stays).collect(),
            mirrored: false,
        }
    }

    /// Moves `deformed` to the sensor frame, above upright shoulders.
    #[cfg(feature = "studio")]
    pub fn place_deformed(&mut self, sensor_from_head: &Rigid) {
        let upright = shoulders_below(sensor_from_head, &Rotation::identity());
        self.place_above(sensor_from_head, &upright);
    }

    /// Moves `deformed` to the sensor frame, above these shoulders.
    pub(crate) fn place_above(&mut self, sensor_from_head: &Rigid, sensor_from_torso: &Rigid) {
        let rotation = sensor_from_head.rotation.to_rotation_matrix();
        let shift = sensor_from_head.translation.vector;
        let upright = sensor_from_torso.rotation.to_rotation_matrix();
        let below = sensor_from_torso.translation.vector;
        for ((placed, p), &stays) in self.placed.iter_mut().zip(&self.deformed).zip(&self.neck) {
            let moved = rotation * p.coords + shift;
            *placed = Point::from(moved + (upright * p.coords + below - moved) * stays);
        }
    }

    /// Lights the placed vertices.
    pub fn light(&mut self, asset: &HeadAsset, light: &Light) {
        let triangles = asset.triangles.iter().map(|t| turned(*t, self.mirrored));
        sum_normals(triangles, &self.placed, &mut self.normals);
        for (bright, normal) in self.bright.iter_mut().zip(&self.normals) {
            let length = normal.norm_squared().sqrt();
            *bright = light.brightness_on(&(normal / length.max(1e-12)));
        }
    }

    /// Draws depth; calls `drawn` for each pixel.
    pub(crate) fn draw_depth(
        &mut self,
        asset: &HeadAsset,
        pixel: impl Fn(&Point) -> [f32; 2],
        buffer: &mut DepthBuffer,
        mut drawn: impl FnMut(usize),
    ) {
        project(&self.placed, pixel, &mut self.corners);
        for &triangle in asset.triangles.iter() {
            let corners = turned(triangle, self.mirrored).map(|k| self.corners[k]);
            buffer.triangle(corners, |pixel, _, _| drawn(pixel));
        }
    }

    /// Draws colour; returns the window drawn to. [`HeadPainter::light`] must be called before.
    pub fn draw_colour(
        &mut self,
        asset: &HeadAsset,
        light: &Light,
        pixel: impl Fn(&Point) -> [f32; 2],
        canvas: &mut Canvas,
    ) -> Window {
        project(&self.placed, pixel, &mut self.corners);
        let level = self.level(asset);
        let texture = asset.texture.get(level);
        let shrink = 1.0 / (1 << level) as f32;
        let shift = (shrink - 1.0) * 0.5;
        let mut window = Window::NOTHING;
        let Canvas { depth, rgb } = canvas;
        for (&triangle, &part) in asset.triangles.iter().zip(asset.parts.iter()) {
            let vertices = turned(triangle, self.mirrored);
            let corners = vertices.map(|k| self.corners[k]);
            let gain = light.tint.map(|tint| tint * light.parts[part as usize]);
            let colours = vertices.map(|k| asset.colour[k]);
            let shares = vertices.map(|k| asset.photo_share[k]);
            let lights = vertices.map(|k| self.bright[k]);
            let places = vertices.map(|k| asset.photo[k]);
            let photograph = texture.filter(|_| shares.iter().any(|&share| share > 0.0));
            window.include(depth.triangle(corners, |index, u, v| {
                let bright = mix(lights, u, v);
                let mut colour = [0, 1, 2].map(|k| mix(colours.map(|c| c[k]), u, v));
                if let Some(texture) = photograph {
                    let share = mix(shares, u, v);
                    let [x, y] = [0, 1].map(|k| mix(places.map(|p| p[k]), u, v) * shrink + shift);
                    let photo = texture.colour_at(x, y);
                    for k in 0..3 {
                        colour[k] += share * (photo[k] - colour[k]);
                    }
                }
                rgb[index] = [0, 1, 2].map(|k| grey(colour[k] * bright * gain[k]));
            }));
        }
        window
    }

    /// Level of the photograph that matches the drawn size, by the distance of the outer eye corners.
    fn level(&self, asset: &HeadAsset) -> usize {
        let [Some(right), Some(left)] = [36, 45].map(|k| asset.landmarks.get(k)) else {
            return 0;
        };
        let vertices = [right, left].map(|site| site.vertices[0] as usize);
        let [p, q] = vertices.map(|v| asset.photo[v]);
        let [a, b] = vertices.map(|v| self.corners[v]);
        let there = (p[0] - q[0]).hypot(p[1] - q[1]);
        let here = (a.x - b.x).hypot(a.y - b.y).max(1.0);
        match there / here {
            r if r > 3.0 => 2,
            r if r > 1.5 => 1,
            _ => 0,
        }
    }
}

/// Top of the neck, about which the head turns, head frame, metres.
const PIVOT: Vector = Vector::new(0.0, 0.08, 0.09);

/// Pose of the shoulders (sensor from torso): below a head that turns about the top of its neck, and upright in the world, which
/// the sensor sees rotated by `tilt`.
pub fn shoulders_below(sensor_from_head: &Rigid, tilt: &Rotation) -> Rigid {
    let neck = sensor_from_head.translation.vector + sensor_from_head.rotation * PIVOT;
    Rigid::from_parts((neck - tilt * PIVOT).into(), *tilt)
}

/// Work space for one simple shape.
pub struct ShapePainter {
    shape: Shape,
    placed: Vec<Point>,
    corners: Vec<Corner>,
}

impl ShapePainter {
    /// Work space for this shape.
    pub fn new(shape: Shape) -> Self {
        Self {
            placed: shape.vertices.clone(),
            corners: vec![Corner::default(); shape.vertices.len()],
            shape,
        }
    }

    /// Moves the shape into the sensor frame.
    pub fn place(&mut self, sensor_from_shape: &Rigid) {
        for (placed, p) in self.placed.iter_mut().zip(&self.shape.vertices) {
            *placed = sensor_from_shape * p;
        }
    }

    pub(crate) fn draw_depth(
        &mut self,
        pixel: impl Fn(&Point) -> [f32; 2],
        buffer: &mut DepthBuffer,
    ) {
        project(&self.placed, pixel, &mut self.corners);
        for triangle in &self.shape.triangles {
            let corners = triangle.map(|k| self.corners[k as usize]);
            buffer.triangle(corners, |_, _, _| {});
        }
    }

    /// Draws colour; returns the window drawn to. The shape must not be rotated, because its normals are not.
    pub fn draw_colour(
        &mut self,
        light: &Light,
        pixel: impl Fn(&Point) -> [f32; 2],
        canvas: &mut Canvas,
    ) -> Window {
        project(&self.placed, pixel, &mut self.corners);
        let shape = &self.shape;
        let mut window = Window::NOTHING;
        let Canvas { depth, rgb } = canvas;
        for triangle in &shape.triangles {
            let [a, b, c] = triangle.map(|k| k as usize);
            let lit = [a, b, c].map(|k| {
                let bright = light.brightness_on(&shape.normals[k]);
                [0, 1, 2].map(|ch| shape.colour[k][ch] * bright * light.tint[ch])
            });
            let corners = [a, b, c].map(|k| self.corners[k]);
            window.include(depth.triangle(corners, |index, u, v| {
                rgb[index] = [0, 1, 2].map(|ch| grey(mix(lit.map(|c| c[ch]), u, v)));
            }));
        }
        window
    }
}
