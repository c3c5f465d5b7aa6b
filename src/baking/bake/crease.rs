//! The crease between joined lips: in a depth map of the mouth, the line near the inner lip landmarks that lies
//! deeper than the skin above and below it.
//!
//! Units: the mesh's, in the face's frame; inside, pixels. Cost: one rendering. Without a crease the landmarks are
//! used.

use nalgebra::Vector2;

use super::head::Head;
use super::mesh::Vec3;
use super::render::{Canvas, paint};

/// Side of the depth map, pixels.
const PIXELS: u32 = 256;
/// Extent of the depth map, in mouth widths.
const SHOWN: f64 = 1.4;
/// Search range above and below the landmarks, in eye distances.
const BAND: f64 = 0.12;
/// Distance above and below the crease at which the skin must be less deep, in eye distances.
const BESIDE: f64 = 0.06;
/// Width over which the crease is smoothed, in eye distances.
const EVEN: f64 = 0.08;

/// The line between the lips in a picture of the mouth: its row in every column from one corner to the other.
pub(super) struct Crease {
    canvas: Canvas,
    first: f64,
    rows: Vec<f64>,
}

impl Crease {
    /// Finds the crease of a head with vertices at `seen` in the face's frame.
    pub(super) fn traced(head: &Head, seen: &[Vec3]) -> Self {
        let at = |k: usize| seen[head.points[k] as usize];
        let middle = (at(60) + at(64)) / 2.0;
        let tint = |[v, ..]: [u32; 3], _| head.skin[v as usize].then_some([0.0; 3]);
        let shown = SHOWN * head.mouth_width;
        let canvas = paint(&head.mesh, seen, &middle, shown, PIXELS, None, tint);
        let pairs = [[60, 60], [61, 67], [62, 66], [63, 65], [64, 64]];
        let marks = pairs.map(|pair| {
            let [a, b] = pair.map(|k| canvas.screen(&at(k)));
            (a + b) / 2.0
        });
        let pixels = |far: f64| far * head.eye_distance * canvas.scale;
        let landmarks = |x: f64| {
            let k = (1..4).find(|&k| x < marks[k].x).unwrap_or(4);
            let (a, b) = (marks[k - 1], marks[k]);
            a.y + (b.y - a.y) * ((x - a.x) / (b.x - a.x).max(1e-9)).clamp(0.0, 1.0)
        };
        let depth = |x, y| canvas.depth(x, y).unwrap_or(0.0);
        let half = pixels(BAND) as i32;
        // Per column, total depth of its creases and their row; the landmarks' row where there is none.
        let found = |column: usize| {
            let x = marks[0].x + column as f64;
            let one = |beside: i32| {
                let y = landmarks(x) + f64::from(beside);
                let level = (depth(x, y - pixels(BESIDE)) + depth(x, y + pixels(BESIDE))) / 2.0;
                let near = (-(2.0 * f64::from(beside) / f64::from(half)).powi(2)).exp();
                let weight = near * (level - depth(x, y)).clamp(0.0, pixels(BESIDE)).powi(4);
                Vector2::new(weight * f64::from(beside), weight)
            };
            (-half..=half).map(one).sum::<Vector2<f64>>()
        };
        let last = (marks[4].x - marks[0].x).max(1.0) as usize;
        let found: Vec<_> = (0..=last).map(found).collect();
        let row = |column: usize| {
            let around = |k: usize| (-(k.abs_diff(column) as f64 / pixels(EVEN)).powi(2)).exp();
            let sum = (0..=last).map(|k| found[k] * around(k));
            let sum: Vector2<f64> = sum.sum();
            landmarks(marks[0].x + column as f64) + sum.x / (sum.y + 1.0)
        };
        Self {
            rows: (0..=last).map(row).collect(),
            first: marks[0].x,
            canvas,
        }
    }

    /// Height of a point above the crease, which is extended level beyond its ends.
    pub(super) fn above(&self, p: &Vec3) -> f64 {
        let p = self.canvas.screen(p);
        let last = self.rows.len() - 1;
        let column = (p.x - self.first).clamp(0.0, last as f64);
        let before = (column as usize).min(last - 1);
        let [a, b] = [self.rows[before], self.rows[before + 1]];
        (a + (b - a) * (column - before as f64) - p.y) / self.canvas.scale
    }

    /// The vertex nearest to an end of the crease, searched around the landmark `corner`.
    pub(super) fn end(&self, head: &Head, seen: &[Vec3], corner: usize) -> u32 {
        let column = if corner == 60 { 0 } else { self.rows.len() - 1 };
        let (x, y) = (self.first + column as f64, self.rows[column]);
        let far = |v: &u32| {
            let p = self.canvas.screen(&seen[*v as usize]);
            (p.x - x).hypot(p.y - y)
        };
        let (landmark, reach) = (head.points[corner], BAND * head.eye_distance);
        let near = head.rings.disc(&head.mesh.positions, landmark, reach);
        let nearest = near.into_iter().min_by(|a, b| far(a).total_cmp(&far(b)));
        nearest.unwrap_or(landmark)
    }
}
