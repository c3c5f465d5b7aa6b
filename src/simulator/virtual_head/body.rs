//! What stands around the head, from simple shapes: shoulders and chest, a hand, furniture, a wall. Enough that a head must be cut
//! from a body and from a background; nothing here is meant to be looked at.

use crate::base::geometry::{Point, Vector};

/// A coloured closed surface, corners of its triangles clockwise seen from outside.
#[derive(Clone, Debug, Default)]
pub(crate) struct Shape {
    pub(crate) vertices: Vec<Point>,
    pub(crate) normals: Vec<Vector>,
    pub(crate) colour: Vec<[f32; 3]>,
    pub(crate) triangles: Vec<[u32; 3]>,
}

impl Shape {
    /// Adds an ellipsoid.
    fn ellipsoid(&mut self, centre: [f32; 3], radii: [f32; 3], colour: [f32; 3]) {
        const RINGS: u32 = 14;
        const SEGMENTS: u32 = 24;
        let start = self.vertices.len() as u32;
        for ring in 0..=RINGS {
            let (sin_r, cos_r) = (std::f32::consts::PI * ring as f32 / RINGS as f32).sin_cos();
            for segment in 0..SEGMENTS {
                let (sin_s, cos_s) =
                    (std::f32::consts::TAU * segment as f32 / SEGMENTS as f32).sin_cos();
                let unit = Vector::new(sin_r * cos_s, cos_r, sin_r * sin_s);
                // Whole tenths of a millimetre, so that the last digit of a sine cannot show in a picture.
                let [x, y, z] =
                    [0, 1, 2].map(|k| ((centre[k] + radii[k] * unit[k]) * 1e4).round() * 1e-4);
                self.vertices.push(Point::new(x, y, z));
                let [u, v, w] = [0, 1, 2].map(|k| unit[k] / radii[k]);
                let normal = Vector::new(u, v, w).normalize();
                self.normals.push(normal.map(|c| (c * 1e3).round() * 1e-3));
                // Stripes give the clothes an edge here and there.
                let shade = if ring % 4 == 0 { 0.8 } else { 1.0 };
                self.colour.push(colour.map(|c| c * shade));
            }
        }
        let at = |ring: u32, segment: u32| start + ring * SEGMENTS + segment % SEGMENTS;
        for ring in 0..RINGS {
            for segment in 0..SEGMENTS {
                let (a, b) = (at(ring, segment), at(ring, segment + 1));
                let (c, d) = (at(ring + 1, segment), at(ring + 1, segment + 1));
                self.triangles.push([a, b, c]);
                self.triangles.push([b, d, c]);
            }
        }
    }

    /// Adds a flat grid facing −z, with a mottled pattern.
    fn panel(
        &mut self,
        centre: [f32; 3],
        half: [f32; 2],
        cells: [u32; 2],
        colour: [f32; 3],
        seed: u64,
    ) {
        let start = self.vertices.len() as u32;
        let [columns, rows] = cells;
        for row in 0..=rows {
            for column in 0..=columns {
                let x = centre[0] + half[0] * (2.0 * column as f32 / columns as f32 - 1.0);
                let y = centre[1] + half[1] * (2.0 * row as f32 / rows as f32 - 1.0);
                self.vertices.push(Point::new(x, y, centre[2]));
                self.normals.push(Vector::new(0.0, 0.0, -1.0));
                let coarse = super::random::uniform(seed, u64::from(row / 5 * 1009 + column / 5));
                let fine = super::random::uniform(seed + 1, u64::from(row * 1009 + column));
                self.colour
                    .push(colour.map(|c| c * (1.0 + 0.12 * coarse + 0.05 * fine)));
            }
        }
        let at = |row: u32, column: u32| start + row * (columns + 1) + column;
        for row in 0..rows {
            for column in 0..columns {
                let (a, b) = (at(row, column), at(row, column + 1));
                let (c, d) = (at(row + 1, column), at(row + 1, column + 1));
                self.triangles.push([a, b, c]);
                self.triangles.push([b, d, c]);
            }
        }
    }

    /// Shoulders, chest and upper arms. Origin and axes as of a head that looks straight ahead above them.
    pub(crate) fn bust(colour: [f32; 3]) -> Self {
        let mut shape = Self::default();
        shape.ellipsoid([0.0, 0.245, 0.10], [0.20, 0.075, 0.085], colour);
        shape.ellipsoid([0.0, 0.46, 0.10], [0.19, 0.27, 0.115], colour);
        for side in [-1.0, 1.0] {
            shape.ellipsoid([side * 0.205, 0.44, 0.11], [0.07, 0.22, 0.08], colour);
        }
        shape
    }

    /// A hand held upright, palm to the sensor, with its forearm. Origin: the middle of the palm.
    pub(crate) fn hand(colour: [f32; 3]) -> Self {
        let mut shape = Self::default();
        shape.ellipsoid([0.0; 3], [0.045, 0.055, 0.016], colour);
        for (x, long) in [
            (-0.034, 0.036),
            (-0.012, 0.042),
            (0.011, 0.04),
            (0.033, 0.03),
        ] {
            shape.ellipsoid([x, -0.05 - long, 0.0], [0.0095, long, 0.009], colour);
        }
        shape.ellipsoid([0.058, -0.01, 0.0], [0.012, 0.034, 0.011], colour);
        shape.ellipsoid([0.0, 0.08, 0.005], [0.03, 0.05, 0.025], colour);
        shape.ellipsoid([0.01, 0.22, 0.02], [0.042, 0.16, 0.04], [80.0, 85.0, 90.0]);
        shape
    }

    /// Things of about a head's size: a globe on a stand, a lamp's shade, the head rest of a chair, a jacket over one.
    fn furniture(&mut self) {
        let stand = [90.0, 90.0, 95.0];
        self.ellipsoid([-0.42, 0.05, 1.3], [0.105; 3], [90.0, 120.0, 160.0]);
        self.ellipsoid([-0.42, 0.31, 1.32], [0.02, 0.16, 0.02], stand);
        self.ellipsoid(
            [0.45, -0.12, 1.5],
            [0.13, 0.10, 0.13],
            [220.0, 210.0, 180.0],
        );
        self.ellipsoid([0.45, 0.33, 1.5], [0.015, 0.36, 0.015], stand);
        self.ellipsoid([0.02, 0.0, 1.05], [0.13, 0.085, 0.035], [60.0, 55.0, 60.0]);
        self.ellipsoid([0.02, 0.2, 1.1], [0.025, 0.14, 0.02], stand);
        self.ellipsoid([0.02, 0.42, 1.05], [0.23, 0.20, 0.10], [75.0, 85.0, 70.0]);
    }

    /// The room: a wall at `wall` metres, and in front of it a chair's back and furniture if there are.
    pub(crate) fn room(wall: f32, chair: bool, furniture: bool, seed: u64) -> Self {
        let mut shape = Self::default();
        shape.panel(
            [0.0, 0.0, wall],
            [wall * 0.9, wall * 0.7],
            [90, 70],
            [150.0, 155.0, 160.0],
            seed,
        );
        if chair {
            shape.panel(
                [0.05, 0.42, 1.15],
                [0.23, 0.30],
                [12, 16],
                [70.0, 60.0, 90.0],
                seed + 9,
            );
        }
        if furniture {
            shape.furniture();
        }
        shape
    }
}
