//! A head that can be drawn: mesh, photograph, expressions and the 68 points, in the head frame, metres.
//!
//! The texture is a frontal photograph. Each vertex also has a colour of its own for parts not visible in it (sides, back of the
//! head, inside of the mouth). `photo_share` blends both without a seam: 1 in the middle of the face, 0 behind the ears.

use std::sync::Arc;

use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::{Point, Vector};

/// Part of the head that a triangle shows; training renders vary each part's brightness separately.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Part {
    /// Face, head, ears, neck.
    Skin = 0,
    /// Inside of the cheeks and throat.
    MouthSocket = 1,
    /// Gums and tongue.
    Gums = 2,
    /// Teeth.
    Teeth = 3,
    /// Eyeballs.
    Eye = 4,
    /// Behind the lids.
    EyeSocket = 5,
}

impl Part {
    /// All parts, by number.
    pub const ALL: [Self; 6] = [
        Self::Skin,
        Self::MouthSocket,
        Self::Gums,
        Self::Teeth,
        Self::Eye,
        Self::EyeSocket,
    ];
    /// Number of parts.
    pub const COUNT: usize = Self::ALL.len();
}

/// An expression: offsets from the neutral face of the vertices that move.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Expression {
    /// Name, ARKit-like with `_L` and `_R`, for example `eyeBlink_L`.
    pub name: String,
    /// Indices of the vertices that move, ascending.
    pub vertices: Vec<u32>,
    /// Offset of each at weight 1, head frame, metres.
    pub offsets: Vec<Vector>,
}

/// A point of the mesh: a vertex, or a point in a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Site {
    /// Corners of the triangle.
    pub vertices: [u32; 3],
    /// Barycentric coordinates; they add up to 1.
    pub shares: [f32; 3],
}

impl Site {
    /// The site of a vertex.
    pub fn vertex(vertex: u32) -> Self {
        Self {
            vertices: [vertex; 3],
            shares: [1.0, 0.0, 0.0],
        }
    }

    /// Position, given all vertices.
    pub fn position(&self, vertices: &[Point]) -> Point {
        Point::from(self.mix(|v| vertices[v as usize].coords))
    }

    /// Interpolates a quantity of the vertices.
    pub fn mix(&self, of: impl Fn(u32) -> Vector) -> Vector {
        let corners = self.vertices.iter().zip(self.shares);
        let counting = corners.filter(|corner| corner.1 != 0.0);
        counting.fold(Vector::zeros(), |sum, (&v, share)| sum + of(v) * share)
    }
}

/// RGB image, row by row.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Texture {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Red, green, blue of each pixel, 0…255.
    pub rgb: Vec<u8>,
}

impl Texture {
    /// Colour at pixel coordinates (pixel centres are integers), bilinear, clamped to the border. Black if empty.
    #[inline]
    pub fn colour_at(&self, x: f32, y: f32) -> [f32; 3] {
        if self.width < 2 || self.height < 2 {
            return [0.0; 3];
        }
        let x = x.clamp(0.0, self.width as f32 - 1.001);
        let y = y.clamp(0.0, self.height as f32 - 1.001);
        let (col, row) = (x as usize, y as usize);
        let (fx, fy) = (x - col as f32, y - row as f32);
        let start = (row * self.width + col) * 3;
        let upper = &self.rgb[start..start + 6];
        let lower = &self.rgb[start + self.width * 3..start + self.width * 3 + 6];
        let mut colour = [0.0; 3];
        for k in 0..3 {
            let a = f32::from(upper[k]) * (1.0 - fx) + f32::from(upper[k + 3]) * fx;
            let b = f32::from(lower[k]) * (1.0 - fx) + f32::from(lower[k + 3]) * fx;
            colour[k] = a * (1.0 - fy) + b * fy;
        }
        colour
    }

    /// The image at half size: means of four pixels.
    pub fn halved(&self) -> Self {
        let (width, height) = (self.width / 2, self.height / 2);
        let mut rgb = Vec::with_capacity(width * height * 3);
        for row in 0..height {
            for col in 0..width {
                for k in 0..3 {
                    let at = |r: usize, c: usize| {
                        u32::from(self.rgb[((2 * row + r) * self.width + 2 * col + c) * 3 + k])
                    };
                    rgb.push(((at(0, 0) + at(0, 1) + at(1, 0) + at(1, 1) + 2) / 4) as u8);
                }
            }
        }
        Self { width, height, rgb }
    }

    /// The image at full, half and quarter size, to avoid aliasing when it is drawn smaller.
    pub fn levels(self) -> Vec<Self> {
        let half = self.halved();
        let quarter = half.halved();
        vec![self, half, quarter]
    }
}

/// One person's head; data common to all people is shared in memory.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct HeadAsset {
    /// Vertices of the person's neutral face.
    pub neutral: Vec<Point>,
    /// Corners of the triangles, clockwise seen from outside.
    pub triangles: Arc<[[u32; 3]]>,
    /// Part of each triangle.
    pub parts: Arc<[Part]>,
    /// Position of each vertex in the photograph, pixels (pixel centres are integers).
    pub photo: Arc<[[f32; 2]]>,
    /// Share of the photograph in each vertex's colour, 0…1; the rest is its own colour.
    pub photo_share: Arc<[f32]>,
    /// Own colour of each vertex, RGB 0…255.
    pub colour: Arc<[[f32; 3]]>,
    /// The photograph, by [`Texture::levels`]; empty if there is none.
    pub texture: Arc<[Texture]>,
    /// Expressions, by name ascending.
    pub expressions: Arc<[Expression]>,
    /// The 68 points.
    pub landmarks: Arc<[Site]>,
}

impl HeadAsset {
    /// Index of an expression.
    pub fn expression(&self, name: &str) -> Option<usize> {
        self.expressions.iter().position(|e| e.name == name)
    }

    /// The head stretched along its axes, as a substitute for another person's.
    pub fn stretched(&self, factors: [f32; 3]) -> Self {
        let factors = Vector::from(factors);
        let mut other = self.clone();
        for p in &mut other.neutral {
            p.coords.component_mul_assign(&factors);
        }
        other
    }

    /// Moves the origin of the head frame to the middle between the inner eye corners (landmarks 39 and 42).
    pub fn centre(&mut self) {
        if let [Some(right), Some(left)] = [39, 42].map(|k| self.landmarks.get(k)) {
            let [right, left] = [right, left].map(|site| site.position(&self.neutral));
            let origin = nalgebra::center(&right, &left).coords;
            self.neutral.iter_mut().for_each(|p| *p -= origin);
        }
    }

    /// The 68 points with one expression at a weight, head frame, metres.
    #[cfg(feature = "studio")]
    pub fn acting(&self, expression: Option<usize>, weight: f32) -> [Point; LANDMARKS] {
        let of = |k: usize| if Some(k) == expression { weight } else { 0.0 };
        let weights: Vec<f32> = (0..self.expressions.len()).map(of).collect();
        let mut vertices = self.neutral.clone();
        self.express(&weights, &mut vertices);
        self.landmarks_on(&vertices)
    }

    /// Adds the expressions with these weights to the vertices `out`.
    pub fn express(&self, weights: &[f32], out: &mut [Point]) {
        for (expression, &weight) in self.expressions.iter().zip(weights) {
            if weight != 0.0 {
                for (&v, offset) in expression.vertices.iter().zip(&expression.offsets) {
                    out[v as usize] += offset * weight;
                }
            }
        }
    }

    /// The 68 points of a deformed mesh.
    pub fn landmarks_on(&self, vertices: &[Point]) -> [Point; LANDMARKS] {
        let on = |k: usize| Some(self.landmarks.get(k)?.position(vertices));
        std::array::from_fn(|k| on(k).unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_texture_is_linear_between_pixels_and_ends_at_its_border() {
        let texture = Texture {
            width: 2,
            height: 2,
            rgb: vec![0, 0, 0, 100, 0, 0, 0, 50, 0, 100, 50, 200],
        };
        let close = |a: [f32; 3], b: [f32; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 0.6);
        assert!(close(texture.colour_at(0.5, 0.0), [50.0, 0.0, 0.0]));
        assert!(close(texture.colour_at(0.5, 0.5), [50.0, 25.0, 50.0]));
        assert!(close(texture.colour_at(9.0, 9.0), [100.0, 50.0, 200.0]));
    }
}
