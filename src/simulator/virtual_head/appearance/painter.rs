//! How an outfit is drawn.

use super::outfit::{Knot, Outfit};
use super::stuff::{Stuff, grain};
use crate::base::geometry::{Point, Rigid, Vector};
use crate::simulator::virtual_head::draw::{Canvas, Light};
use crate::simulator::virtual_head::raster::{Corner, DepthBuffer, Window, project};

/// Work space for one outfit.
pub(crate) struct OutfitPainter {
    placed: Vec<Point>,
    normals: Vec<Vector>,
    lit: Vec<[f32; 3]>,
    corners: Vec<Corner>,
}

impl OutfitPainter {
    pub(crate) fn new(outfit: &Outfit) -> Self {
        let n = outfit.knots.len();
        Self {
            placed: outfit.knots.iter().map(|k| Point::from(k.offset)).collect(),
            normals: vec![Vector::zeros(); n],
            lit: vec![[0.0; 3]; n],
            corners: vec![Corner::default(); n],
        }
    }

    /// Puts it on; `face`: the deformed vertices of the head, head frame.
    pub(crate) fn place(
        &mut self,
        outfit: &Outfit,
        face: &[Point],
        sensor_from_head: &Rigid,
        sensor_from_torso: &Rigid,
    ) {
        for (placed, knot) in self.placed.iter_mut().zip(&outfit.knots) {
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
        outfit: &Outfit,
        pixel: impl Fn(&Point) -> [f32; 2],
        buffer: &mut DepthBuffer,
        stuff: &mut [Stuff],
    ) {
        project(&self.placed, pixel, &mut self.corners);
        for &(triangle, made) in &outfit.triangles {
            let [a, b, c] = triangle.map(|k| k as usize);
            let corners = [self.corners[a], self.corners[b], self.corners[c]];
            let [p, q, r] = [a, b, c].map(|k| &outfit.knots[k]);
            buffer.triangle_where(corners, |index, u, v| {
                let kept = made != Stuff::Glass && cut(p, q, r, u, v);
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
        outfit: &Outfit,
        light: &Light,
        pixel: impl Fn(&Point) -> [f32; 2],
        canvas: &mut Canvas,
    ) -> Window {
        project(&self.placed, pixel, &mut self.corners);
        self.light(outfit, light);
        let mut window = Window::NOTHING;
        let Canvas { depth, rgb } = canvas;
        for &(triangle, made) in &outfit.triangles {
            let [a, b, c] = triangle.map(|k| k as usize);
            let corners = [self.corners[a], self.corners[b], self.corners[c]];
            let [p, q, r] = [a, b, c].map(|k| &outfit.knots[k]);
            let (la, lb, lc) = (self.lit[a], self.lit[b], self.lit[c]);
            let contrast = made.contrast();
            // Stubble on the skin, the glint on glass: one looks through.
            let thin = matches!(made, Stuff::Skin | Stuff::Glass);
            window.include(depth.triangle_where(corners, |index, u, v| {
                let mix = |a: f32, b: f32, c: f32| a + u * (b - a) + v * (c - a);
                let cover = mix(p.cover, q.cover, r.cover);
                let kept = cover >= 0.99 || (!thin && cut(p, q, r, u, v));
                if kept || thin {
                    let fine = grain(
                        mix(p.weave[0], q.weave[0], r.weave[0]),
                        mix(p.weave[1], q.weave[1], r.weave[1]),
                    );
                    let gain = 1.0 + contrast * fine;
                    let share = if kept {
                        1.0
                    } else {
                        cover * (1.0 + 0.4 * fine)
                    };
                    for (k, level) in rgb[index].iter_mut().enumerate() {
                        let behind = f32::from(*level);
                        let own = mix(la[k], lb[k], lc[k]) * gain;
                        *level = (behind + share * (own - behind) + 0.5) as u8;
                    }
                }
                kept
            }));
        }
        window
    }

    /// Light at each knot.
    fn light(&mut self, outfit: &Outfit, light: &Light) {
        self.normals.fill(Vector::zeros());
        for &(triangle, _) in &outfit.triangles {
            let [a, b, c] = triangle.map(|k| k as usize);
            let p = self.placed[a];
            let normal = (self.placed[c] - p).cross(&(self.placed[b] - p));
            for k in [a, b, c] {
                self.normals[k] += normal;
            }
        }
        for &(triangle, made) in &outfit.triangles {
            for k in triangle.map(|k| k as usize) {
                let normal = self.normals[k] / self.normals[k].norm().max(1e-12);
                let shine = normal.dot(&light.towards).max(0.0).powi(6) * made.sheen();
                let bright = light.on(&normal) + shine;
                let colour = outfit.knots[k].colour;
                self.lit[k] = [0, 1, 2].map(|ch| colour[ch] * bright * light.tint[ch]);
            }
        }
    }
}

/// Whether the surface is there at these shares of its second and third corner.
fn cut(a: &Knot, b: &Knot, c: &Knot, u: f32, v: f32) -> bool {
    let mix = |a: f32, b: f32, c: f32| a + u * (b - a) + v * (c - a);
    let cover = mix(a.cover, b.cover, c.cover);
    cover >= 0.99
        || cover
            > 0.5
                + 0.5
                    * grain(
                        mix(a.weave[0], b.weave[0], c.weave[0]) + 0.37,
                        mix(a.weave[1], b.weave[1], c.weave[1]),
                    )
}
