//! Filled triangles with a depth buffer, the drawing primitive of the simulated cameras.
//!
//! Pineda, "A parallel algorithm for polygon rasterization" (1988): a pixel is inside where three edge functions have the same sign.
//! Depth is the inverse distance 1/z, which is linear in the image, so perspective is exact; colours are interpolated linearly,
//! which makes no visible difference in triangles of a few pixels. Pixel centres are integers. Cost: about 30 operations per
//! triangle, then row by row. A triangle seen edge-on, outside of the image or behind the camera draws nothing.

use mien_stages::base::geometry::{Point, Vector};

/// A projected corner.
#[derive(Clone, Copy, Debug, Default)]
pub struct Corner {
    /// Column, pixels.
    pub x: f32,
    /// Row, pixels.
    pub y: f32,
    /// 1/z, 1/metres; 0 = behind the camera.
    pub inverse: f32,
}

impl Corner {
    /// A corner at a pixel.
    pub fn new([x, y]: [f32; 2], inverse: f32) -> Self {
        Self { x, y, inverse }
    }
}

/// Projects points of the sensor frame (metres) with `pixel`.
pub(crate) fn project(
    placed: &[Point],
    pixel: impl Fn(&Point) -> [f32; 2],
    corners: &mut [Corner],
) {
    for (corner, p) in corners.iter_mut().zip(placed) {
        let inverse = if p.z > 0.05 { 1.0 / p.z } else { 0.0 };
        *corner = Corner::new(pixel(p), inverse);
    }
}

/// Interpolates between three corners; `u` and `v` are the shares of the second and third.
#[inline]
pub(crate) fn mix([a, b, c]: [f32; 3], u: f32, v: f32) -> f32 {
    a + u * (b - a) + v * (c - a)
}

/// Sums the outward normals (weighted by area) of the triangles around each vertex. Corners are clockwise in an image with y down
/// and z away from the camera.
pub fn sum_normals(
    triangles: impl Iterator<Item = [usize; 3]>,
    vertices: &[Point],
    normals: &mut [Vector],
) {
    normals.fill(Vector::zeros());
    for corners in triangles {
        let [p, q, r] = corners.map(|k| vertices[k]);
        let normal = (r - p).cross(&(q - p));
        for k in corners {
            normals[k] += normal;
        }
    }
}

/// Part of an image that was drawn to: column and row of its first pixel, and one past the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window(pub(crate) [usize; 2], pub(crate) [usize; 2]);

impl Window {
    pub(crate) const NOTHING: Self = Self([usize::MAX; 2], [0; 2]);
    pub(crate) const ALL: Self = Self([0; 2], [usize::MAX; 2]);

    pub(crate) fn include(&mut self, other: Self) {
        for k in 0..2 {
            self.0[k] = self.0[k].min(other.0[k]);
            self.1[k] = self.1[k].max(other.1[k]);
        }
    }
}

/// Inverse distance of the nearest surface so far, per pixel.
pub struct DepthBuffer {
    /// Pixels in a row.
    pub width: usize,
    pub(crate) height: usize,
    /// 1/z of each pixel, row by row, 1/metres; 0 = empty.
    pub inverse: Vec<f32>,
}

impl DepthBuffer {
    /// An empty buffer of this size.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            inverse: vec![0.0; width * height],
        }
    }

    /// Draws a triangle, corners clockwise in the image; calls `paint(pixel, shares of b and c)` where it is the nearest so far.
    /// Returns the window drawn to.
    #[inline]
    pub fn triangle(
        &mut self,
        corners: [Corner; 3],
        mut paint: impl FnMut(usize, f32, f32),
    ) -> Window {
        self.triangle_where(corners, |pixel, b, c| {
            paint(pixel, b, c);
            true
        })
    }

    /// As [`DepthBuffer::triangle`], for a surface with gaps: `paint` returns whether the pixel is opaque.
    #[inline]
    pub fn triangle_where(
        &mut self,
        [a, b, c]: [Corner; 3],
        mut paint: impl FnMut(usize, f32, f32) -> bool,
    ) -> Window {
        let area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
        // Not `area <= 0`, so that NaN is rejected too.
        if !(area > 1e-6 && a.inverse > 0.0 && b.inverse > 0.0 && c.inverse > 0.0) {
            return Window::NOTHING;
        }
        let (x_min, x_max) = (a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x));
        let (y_min, y_max) = (a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y));
        if x_max < 0.0
            || y_max < 0.0
            || x_min > (self.width - 1) as f32
            || y_min > (self.height - 1) as f32
        {
            return Window::NOTHING;
        }
        let left = first_from(x_min);
        let top = first_from(y_min);
        let right = (x_max as usize).min(self.width - 1) + 1;
        let bottom = (y_max as usize).min(self.height - 1) + 1;
        if left >= right || top >= bottom {
            return Window::NOTHING;
        }
        let scale = 1.0 / area;
        // Gradients of the shares of b and c over the image.
        let (b_dx, b_dy) = ((c.y - a.y) * scale, -(c.x - a.x) * scale);
        let (c_dx, c_dy) = (-(b.y - a.y) * scale, (b.x - a.x) * scale);
        let (inverse_b, inverse_c) = (b.inverse - a.inverse, c.inverse - a.inverse);
        for row in top..bottom {
            let dy = row as f32 - a.y;
            let (b_row, c_row) = (dy * b_dy, dy * c_dy);
            let start = row * self.width + left;
            let line = &mut self.inverse[start..start + right - left];
            for (k, nearest) in line.iter_mut().enumerate() {
                let dx = (left + k) as f32 - a.x;
                let share_b = dx * b_dx + b_row;
                let share_c = dx * c_dx + c_row;
                // A slight overlap closes cracks between neighbours.
                if share_b < -1e-4 || share_c < -1e-4 || share_b + share_c > 1.0001 {
                    continue;
                }
                let inverse = a.inverse + share_b * inverse_b + share_c * inverse_c;
                if inverse > *nearest && paint(start + k, share_b, share_c) {
                    *nearest = inverse;
                }
            }
        }
        Window([left, top], [right, bottom])
    }
}

/// Ceiling of `x`, at least 0; faster than `ceil` on processors without such an instruction.
fn first_from(x: f32) -> usize {
    let whole = x as usize;
    whole + usize::from(x > whole as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner(x: f32, y: f32, z: f32) -> Corner {
        Corner {
            x,
            y,
            inverse: 1.0 / z,
        }
    }

    #[test]
    fn two_triangles_fill_a_square_without_a_crack_and_the_nearer_wins() {
        let mut buffer = DepthBuffer::new(20, 20);
        let (p, q) = (corner(2.3, 2.7, 1.0), corner(15.2, 3.1, 1.0));
        let (r, s) = (corner(14.9, 16.4, 1.0), corner(2.8, 15.5, 1.0));
        let mut painted = 0;
        buffer.triangle([p, q, r], |_, _, _| painted += 1);
        buffer.triangle([p, r, s], |_, _, _| painted += 1);
        for row in 4..15 {
            for col in 4..14 {
                assert!((buffer.inverse[row * 20 + col] - 1.0).abs() < 1e-6);
            }
        }
        let mut behind = 0;
        let far = [p, q, r].map(|c| Corner { inverse: 0.5, ..c });
        buffer.triangle(far, |_, _, _| behind += 1);
        assert!(painted > 100);
        assert_eq!(behind, 0);
    }

    #[test]
    fn what_cannot_be_drawn_draws_nothing() {
        let mut buffer = DepthBuffer::new(20, 20);
        let (p, q, r) = (
            corner(1.0, 1.0, 1.0),
            corner(9.0, 1.0, 1.0),
            corner(9.0, 9.0, 1.0),
        );
        for triangle in [
            [p, r, q],
            [p, q, Corner { x: f32::NAN, ..r }],
            [p, q, Corner { inverse: 0.0, ..r }],
            [p, q, q],
        ] {
            assert_eq!(
                buffer.triangle(triangle, |_, _, _| panic!("painted")),
                Window::NOTHING
            );
        }
    }
}
