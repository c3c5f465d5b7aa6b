//! Simple shapes around the head: shoulders and chest, a hand, furniture, a wall. They test segmentation; realism is in
//! `appearance`.

use mien_stages::base::geometry::{Point, Vector};

/// A coloured mesh; corners clockwise seen from outside.
#[derive(Clone, Debug, Default)]
pub struct Shape {
    pub(crate) vertices: Vec<Point>,
    pub(crate) normals: Vec<Vector>,
    pub(crate) colour: Vec<[f32; 3]>,
    pub(crate) triangles: Vec<[u32; 3]>,
}

impl Shape {
    /// Adds a grid of squares; `at(row, column)`: position, normal and colour of a corner.
    fn grid(
        &mut self,
        [rows, columns]: [u32; 2],
        around: bool,
        at: impl Fn(u32, u32) -> (Point, Vector, [f32; 3]),
    ) {
        let (start, across) = (self.vertices.len() as u32, columns + u32::from(!around));
        let place = |row: u32, column: u32| start + row * across + column % across;
        for row in 0..=rows {
            for column in 0..across {
                let (vertex, normal, colour) = at(row, column);
                self.vertices.push(vertex);
                self.normals.push(normal);
                self.colour.push(colour);
            }
        }
        for row in 0..rows {
            for column in 0..columns {
                let (a, b) = (place(row, column), place(row, column + 1));
                let (c, d) = (place(row + 1, column), place(row + 1, column + 1));
                self.triangles.extend([[a, b, c], [b, d, c]]);
            }
        }
    }

    /// Adds an ellipsoid.
    fn ellipsoid(&mut self, centre: [f32; 3], radii: [f32; 3], colour: [f32; 3]) {
        const RINGS: u32 = 14;
        const SEGMENTS: u32 = 24;
        let turn = |of_one: f32, k: u32, n: u32| (of_one * k as f32 / n as f32).sin_cos();
        self.grid([RINGS, SEGMENTS], true, |ring, segment| {
            let (sin_r, cos_r) = turn(std::f32::consts::PI, ring, RINGS);
            let (sin_s, cos_s) = turn(std::f32::consts::TAU, segment, SEGMENTS);
            let unit = Vector::new(sin_r * cos_s, cos_r, sin_r * sin_s);
            // Rounded to tenths of a millimetre, so that pictures do not depend on the last digit of a platform's sine.
            let place = [0, 1, 2].map(|k| ((centre[k] + radii[k] * unit[k]) * 1e4).round() * 1e-4);
            let normal = Vector::from([0, 1, 2].map(|k| unit[k] / radii[k])).normalize();
            let normal = normal.map(|c| (c * 1e3).round() * 1e-3);
            // Stripes give the clothes some edges.
            let shade = if ring % 4 == 0 { 0.8 } else { 1.0 };
            (place.into(), normal, colour.map(|c| c * shade))
        });
    }

    /// Adds a flat grid facing −z, with a mottled pattern.
    fn panel(
        &mut self,
        centre: [f32; 3],
        half: [f32; 2],
        [columns, rows]: [u32; 2],
        colour: [f32; 3],
        seed: u64,
    ) {
        let along = |half: f32, k: u32, n: u32| half * (2.0 * k as f32 / n as f32 - 1.0);
        self.grid([rows, columns], false, |row, column| {
            let x = centre[0] + along(half[0], column, columns);
            let y = centre[1] + along(half[1], row, rows);
            let coarse = super::random::uniform(seed, u64::from(row / 5 * 1009 + column / 5));
            let fine = super::random::uniform(seed + 1, u64::from(row * 1009 + column));
            (
                Point::new(x, y, centre[2]),
                Vector::new(0.0, 0.0, -1.0),
                colour.map(|c| c * (1.0 + 0.12 * coarse + 0.05 * fine)),
            )
        });
    }

    /// Shoulders, chest and upper arms, in the frame of a head that faces straight ahead.
    pub fn bust(colour: [f32; 3]) -> Self {
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

    /// Adds things of about a head's size: a globe on a stand, a lampshade, a headrest, a jacket over a chair.
    fn furniture(&mut self) {
        let stand = [90.0, 90.0, 95.0];
        self.ellipsoid([-0.42, 0.05, 1.3], [0.105; 3], [90.0, 120.0, 160.0]);
        self.ellipsoid([-0.42, 0.31, 1.32], [0.02, 0.16, 0.02], stand);
        self.ellipsoid([0.45, -0.12, 1.5], [0.13, 0.1, 0.13], [220.0, 210.0, 180.0]);
        self.ellipsoid([0.45, 0.33, 1.5], [0.015, 0.36, 0.015], stand);
        self.ellipsoid([0.02, 0.0, 1.05], [0.13, 0.085, 0.035], [60.0, 55.0, 60.0]);
        self.ellipsoid([0.02, 0.2, 1.1], [0.025, 0.14, 0.02], stand);
        self.ellipsoid([0.02, 0.42, 1.05], [0.23, 0.20, 0.10], [75.0, 85.0, 70.0]);
    }

    /// A wall at `wall` metres, with a chair's back and furniture in front of it if asked for.
    pub(crate) fn room(wall: f32, chair: bool, furniture: bool, seed: u64) -> Self {
        let mut shape = Self::default();
        let (half, paint) = ([wall * 0.9, wall * 0.7], [150.0, 155.0, 160.0]);
        shape.panel([0.0, 0.0, wall], half, [90, 70], paint, seed);
        if chair {
            let (half, cloth) = ([0.23, 0.30], [70.0, 60.0, 90.0]);
            shape.panel([0.05, 0.42, 1.15], half, [12, 16], cloth, seed + 9);
        }
        if furniture {
            shape.furniture();
        }
        shape
    }
}
