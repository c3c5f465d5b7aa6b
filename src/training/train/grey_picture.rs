//! A grey image of a face to paint on, with its landmarks. Pixels, grey levels.

use mien_simulator::virtual_head::Points;
use mien_stages::base::capacity::LANDMARKS;

/// The grey image, and which landmarks are still visible.
pub(super) struct Picture<'a> {
    pub width: usize,
    pub grey: &'a mut [f32],
    pub points: &'a Points,
    pub visible: &'a mut [bool; LANDMARKS],
}

impl Picture<'_> {
    /// Changes the grey of every pixel, given column and row.
    pub(super) fn each(&mut self, mut change: impl FnMut(f32, f32, &mut f32)) {
        for (k, grey) in self.grey.iter_mut().enumerate() {
            change((k % self.width) as f32, (k / self.width) as f32, grey);
        }
    }

    /// Paints a region: `shade` gives the grey of a pixel, `None` outside.
    pub(super) fn paint(&mut self, mut shade: impl FnMut(f32, f32) -> Option<f32>) {
        self.each(|x, y, grey| *grey = shade(x, y).unwrap_or(*grey));
        for (point, visible) in self.points.iter().zip(self.visible.iter_mut()) {
            *visible &= shade(point[0], point[1]).is_none();
        }
    }
}

/// The mean of some landmarks.
pub(super) fn middle(points: &[[f32; 2]]) -> [f32; 2] {
    let n = points.len() as f32;
    let add = |s: [f32; 2], p: &[f32; 2]| [s[0] + p[0] / n, s[1] + p[1] / n];
    points.iter().fold([0.0; 2], add)
}

/// Whether a point lies in a polygon (crossing number).
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
