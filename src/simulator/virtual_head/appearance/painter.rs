//! How an outfit is drawn.

use super::outfit::{Knot, Outfit};
use super::stuff::{Stuff, grain};
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
        let n = outfit.knots.len();
        Self {
            placed: outfit.knots.iter().map(|k| Point::from(k.offset)).collect(),
            normals: vec![Vector::zeros(); n],
            lit: vec![[0.0; 3]; n],
            corners: vec![Corner::default(); n],
            outfit,
        }
    }

    /// Puts it on; `face`: the deformed vertices of the head, head frame.
    pub(crate) fn place(
        &mut self,
        face: &[Point],
        sensor_from_head: &Rigid,
        sensor_from_torso: &Rigid,
    ) {
        for (placed, knot) in self.placed.iter_mut().zip(&self.outfit.knots) {
            let p = match face.get(knot.base as usize) {
                Some(vertex) => vertex + knot.offset,
                None => Point::from(knot.offset),
            };
            let moved = sensor_from_head * p;
            *placed = moved + (sensor_from_torso * p - moved) * knot.stays;
        }
    }

    /// Draws depth, and what is there into `stuff`, one per pixel.
    pub(crate) fn draw_depth(
        &mut self,
        pixel: impl Fn(&Point) -> [f32; 2],
        buffer: &mut DepthBuffer,
        stuff: &mut [Stuff],
    ) {
        project(&self.placed, pixel, &mut self.corners);
        for &(triangle, made) in &self.outfit.triangles {
            let corners = triangle.map(|k| self.corners[k as usize]);
            let knots = triangle.map(|k| &self.outfit.knots[k as usize]);
            buffer.triangle_where(corners, |index, u, v| {
                let kept = made != Stuff::Glass && is_there(knots, u, v);
                // Glass lets what is behind be measured, badly.
                if kept || made == Stuff::Glass {
                    stuff[index] = made;
                }
                kept
            });
        }
    }

    /// Draws colour.
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
        for &(triangle, made) in &self.outfit.triangles {
            let corners = triangle.map(|k| self.corners[k as usize]);
            let knots = triangle.map(|k| &self.outfit.knots[k as usize]);
            let lit = triangle.map(|k| self.lit[k as usize]);
            let [contrast, ..] = made.answers();
            // Stubble on the skin, the glint on glass: one looks through.
            let thin = matches!(made, Stuff::Skin | Stuff::Glass);
            window.include(depth.triangle_where(corners, |index, u, v| {
                let cover = mix(knots.map(|knot| knot.cover), u, v);
                let kept = cover >= 0.99 || (!thin && is_there(knots, u, v));
                if kept || thin {
                    let [x, y] = [0, 1].map(|k| mix(knots.map(|knot| knot.weave[k]), u, v));
                    let fine = grain(x, y);
                    let gain = 1.0 + contrast * fine;
                    let part = cover * (1.0 + 0.4 * fine);
                    let share = if kept { 1.0 } else { part };
                    for (k, level) in rgb[index].iter_mut().enumerate() {
                        let behind = f32::from(*level);
                        let own = mix(lit.map(|lit| lit[k]), u, v) * gain;
                        *level = (behind + share * (own - behind) + 0.5) as u8;
                    }
                }
                kept
            }));
        }
        window
    }

    /// Light at each knot.
    fn light(&mut self, light: &Light) {
        let triangles = self.outfit.triangles.iter();
        let triangles = triangles.map(|(corners, _)| corners.map(|k| k as usize));
        sum_normals(triangles, &self.placed, &mut self.normals);
        for &(triangle, made) in &self.outfit.triangles {
            let [_, sheen, ..] = made.answers();
            for k in triangle.map(|k| k as usize) {
                let normal = self.normals[k] / self.normals[k].norm().max(1e-12);
                let shine = normal.dot(&light.towards).max(0.0).powi(6) * sheen;
                let bright = light.brightness_on(&normal) + shine;
                let colour = self.outfit.knots[k].colour;
                self.lit[k] = [0, 1, 2].map(|ch| colour[ch] * bright * light.tint[ch]);
            }
        }
    }
}

/// Whether the surface is there at these shares of its second and third corner.
fn is_there(knots: [&Knot; 3], u: f32, v: f32) -> bool {
    let cover = mix(knots.map(|knot| knot.cover), u, v);
    let weave = |k: usize| mix(knots.map(|knot| knot.weave[k]), u, v);
    cover >= 0.99 || cover > 0.5 + 0.5 * grain(weave(0) + 0.37, weave(1))
}
