//! The grey picture of a face that things are painted over, and the landmarks they are placed by. Pixels, grey levels.

use crate::base::capacity::LANDMARKS;

/// The landmarks in the picture, pixels.
pub(super) type Points = [[f32; 2]; LANDMARKS];

/// The grey picture, and which landmarks are still seen.
pub(super) struct Picture<'a> {
    pub width: usize,
    pub height: usize,
    pub grey: &'a mut [f32],
    pub visible: &'a mut [bool; LANDMARKS],
}

impl Picture<'_> {
    /// Paints a region: `shade` gives a place's grey, none outside.
    pub(super) fn paint(&mut self, points: &Points, shade: impl Fn(f32, f32) -> Option<f32>) {
        for row in 0..self.height {
            for column in 0..self.width {
                if let Some(grey) = shade(column as f32, row as f32) {
                    self.grey[row * self.width + column] = grey;
                }
            }
        }
        for (point, visible) in points.iter().zip(self.visible.iter_mut()) {
            *visible &= shade(point[0], point[1]).is_none();
        }
    }
}

/// The middle of some landmarks.
pub(super) fn middle(points: &[[f32; 2]]) -> [f32; 2] {
    let n = points.len() as f32;
    let add = |s: [f32; 2], p: &[f32; 2]| [s[0] + p[0] / n, s[1] + p[1] / n];
    points.iter().fold([0.0; 2], add)
}

/// Whether a place lies in a polygon (crossing number).
pub(super) fn inside(polygon: &[[f32; 2]], x: f32, y: f32) -> bool {
    let mut within = false;
    for (k, a) in polygon.iter().enumerate() {
        let b = polygon[(k + 1) % polygon.len()];
        if (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) {
            within = !within;
        }
    }
    within
}
