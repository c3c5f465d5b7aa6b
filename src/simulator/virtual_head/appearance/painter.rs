//! Draws an outfit.

use super::material::{Material, grain};
use super::outfit::{Outfit, Vertex};
use crate::virtual_head::draw::{Canvas, Light};
use crate::virtual_head::raster::{Corner, DepthBuffer, Window, mix, project, sum_normals};
use mien_stages::base::geometry::{Point, Rigid, Vector};

/// Work space for one outfit.
pub(crate) struct OutfitPainter {
    outfit: Outfit,
    placed: Vec<Point>,
    normals: Vec<Vector>,
    lit: Vec<[f32; 3]>,
    corners: Vec<Corner>,
}

impl OutfitPainter {
    pub(crate) fn new(outfit: Outfit) -> Self {
        let n = outfit.vertices.len();
        let placed = outfit.vertices.iter().map(|k| k.offset.into());
        Self {
            placed: placed.collect(),
            normals: vec![Vector::zeros(); n],
            lit: vec![[0.0; 3]; n],
            corners: vec![Corner::default(); n],
            outfit,
        }
    }

    /// Moves the outfit to the sensor frame; `face`: deformed vertices of the head, head frame.
    pub(crate) fn place(
        &mut self,
        face: &[Point],
        sensor_from_head: &Rigid,
        sensor_from_torso: &Rigid,
    ) {
        for (placed, vertex) in self.placed.iter_mut().zip(&self.outfit.vertices) {
            let p = match face.get(vertex.base as usize) {
                Some(base) => base + vertex.offset,
                None => Point::from(vertex.offset),
            };
            let moved = sensor_from_head * p;
            *placed = moved + (sensor_from_torso * p - moved) * vertex.torso_share;
        }
    }

    /// Draws depth, and the material of each pixel into `material`.
    pub(crate) fn draw_depth(
        &mut self,
        pixel: impl Fn(&Point) -> [f32; 2],
        buffer: &mut DepthBuffer,
        material: &mut [Material],
    ) {
        project(&self.placed, pixel, &mut self.corners);
        for &(triangle, material_of_triangle) in &self.outfit.triangles {
            let corners = triangle.map(|k| self.corners[k as usize]);
            let vertices = triangle.map(|k| &self.outfit.vertices[k as usize]);
            buffer.triangle_where(corners, |index, u, v| {
                let is_solid =
                    material_of_triangle != Material::Glass && is_covered(vertices, u, v);
                // Glass has no depth, but spoils the measurement behind it.
                if is_solid || material_of_triangle == Material::Glass {
                    material[index] = material_of_triangle;
                }
                is_solid
            });
        }
    }

    /// Draws colour; returns the window drawn to.
    pub(crate) fn draw_colour(
        &mut self,
        light: &Light,
        pixel: impl Fn(&Point) -> [f32; 2],
        canvas: &mut Canvas,
    ) -> Window {
        project(&self.placed, pixel, &mut self.corners);
        self.light(light);
        let mut window = Window::NOTHING;
        let Canvas { depth, rgb } = canvas;
        for &(triangle, material_of_triangle) in &self.outfit.triangles {
            let corners = triangle.map(|k| self.corners[k as usize]);
            let vertices = triangle.map(|k| &self.outfit.vertices[k as usize]);
            let lit = triangle.map(|k| self.lit[k as usize]);
            let [contrast, ..] = material_of_triangle.properties();
            // Stubble and glass are blended with what is behind.
            let thin = matches!(material_of_triangle, Material::Skin | Material::Glass);
            window.include(depth.triangle_where(corners, |index, u, v| {
                let coverage = mix(vertices.map(|vertex| vertex.coverage), u, v);
                let is_solid = coverage >= 0.99 || (!thin && is_covered(vertices, u, v));
                if is_solid || thin {
                    let [x, y] = [0, 1].map(|k| mix(vertices.map(|vertex| vertex.uv[k]), u, v));
                    let fine = grain(x, y);
                    let gain = 1.0 + contrast * fine;
                    let blend = coverage * (1.0 + 0.4 * fine);
                    let share = if is_solid { 1.0 } else { blend };
                    for (k, level) in rgb[index].iter_mut().enumerate() {
                        let behind = f32::from(*level);
                        let own = mix(lit.map(|lit| lit[k]), u, v) * gain;
                        *level = (behind + share * (own - behind) + 0.5) as u8;
                    }
                }
                is_solid
            }));
        }
        window
    }

    /// Lights each vertex.
    fn light(&mut self, light: &Light) {
        let triangles = self.outfit.triangles.iter();
        let triangles = triangles.map(|(corners, _)| corners.map(|k| k as usize));
        sum_normals(triangles, &self.placed, &mut self.normals);
        for &(triangle, material_of_triangle) in &self.outfit.triangles {
            let [_, sheen, ..] = material_of_triangle.properties();
            for k in triangle.map(|k| k as usize) {
                let normal = self.normals[k] / self.normals[k].norm().max(1e-12);
                let shine = normal.dot(&light.towards).max(0.0).powi(6) * sheen;
                let bright = light.brightness_on(&normal) + shine;
                let colour = self.outfit.vertices[k].colour;
                self.lit[k] = [0, 1, 2].map(|ch| colour[ch] * bright * light.tint[ch]);
            }
        }
    }
}

/// Whether the surface is opaque at the shares `u` and `v` of the second and third corner.
fn is_covered(vertices: [&Vertex; 3], u: f32, v: f32) -> bool {
    let coverage = mix(vertices.map(|vertex| vertex.coverage), u, v);
    let uv = |k: usize| mix(vertices.map(|vertex| vertex.uv[k]), u, v);
    coverage >= 0.99 || coverage > 0.5 + 0.5 * grain(uv(0) + 0.37, uv(1))
}
