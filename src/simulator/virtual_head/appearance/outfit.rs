//! What is worn, as one mesh.

use super::skull;
use super::stuff::Stuff;
use mien_stages::base::geometry::{Point, Vector};

/// A point of the head frame, not tied to a vertex of the face.
pub(super) const FREE: u32 = u32::MAX;

/// One point of an outfit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Knot {
    /// Vertex of the face that it stands off, or [`FREE`].
    pub(crate) base: u32,
    /// From there, or from the origin of the head frame.
    pub(crate) offset: Vector,
    /// How far it stays with the shoulders, 0…1.
    pub(crate) stays: f32,
    /// RGB 0…255.
    pub(crate) colour: [f32; 3],
    /// Texture coordinates.
    pub(crate) weave: [f32; 2],
    /// Share of the surface that is there, 0…1.
    pub(crate) cover: f32,
}

/// How a surface looks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cloth {
    pub(crate) stuff: Stuff,
    pub(crate) colour: [f32; 3],
    /// How far it stays with the shoulders.
    pub(crate) stays: f32,
    /// Cells of noise over the texture's unit in both directions.
    pub(crate) cells: [f32; 2],
}

impl Cloth {
    pub(crate) const fn new(stuff: Stuff, colour: [f32; 3], stays: f32) -> Self {
        Self {
            stuff,
            colour,
            stays,
            cells: [60.0, 60.0],
        }
    }

    pub(crate) fn knot(&self, p: Point, [u, v]: [f32; 2], cover: f32) -> Knot {
        Knot {
            base: FREE,
            offset: p.coords,
            stays: self.stays,
            colour: self.colour,
            weave: [u * self.cells[0], v * self.cells[1]],
            cover,
        }
    }
}

/// So many places along a way, by the share of it.
pub(super) fn path(steps: usize, at: impl Fn(f32) -> Point) -> Vec<Point> {
    let share = |i| i as f32 / (steps - 1) as f32;
    (0..steps).map(|i| at(share(i))).collect()
}

/// A mesh that is worn, or stands somewhere; corners clockwise seen from outside.
#[derive(Clone, Debug, Default)]
pub(crate) struct Outfit {
    pub(crate) knots: Vec<Knot>,
    pub(crate) triangles: Vec<([u32; 3], Stuff)>,
}

impl Outfit {
    /// Adds a grid of rows and columns; `at(row, column)`: the knot there, `None` if there is nothing. Seen from outside,
    /// columns go right where rows go down.
    pub(crate) fn grid(
        &mut self,
        [rows, columns]: [usize; 2],
        around: bool,
        stuff: Stuff,
        mut at: impl FnMut(usize, usize) -> Knot,
    ) {
        let start = self.knots.len() as u32;
        for row in 0..rows {
            for column in 0..columns {
                self.knots.push(at(row, column));
            }
        }
        let place = |row: usize, column: usize| start + (row * columns + column % columns) as u32;
        for row in 0..rows - 1 {
            for column in 0..columns - usize::from(!around) {
                let (a, b) = (place(row, column), place(row, column + 1));
                let (c, d) = (place(row + 1, column), place(row + 1, column + 1));
                for triangle in [[a, b, c], [b, d, c]] {
                    let drawn = |&k: &u32| self.knots[k as usize].cover > 0.0;
                    if triangle.iter().any(drawn) {
                        self.triangles.push((triangle, stuff));
                    }
                }
            }
        }
    }

    /// Adds an ellipsoid, made of `radii` along the axes.
    pub(crate) fn ball(&mut self, centre: [f32; 3], radii: [f32; 3], cloth: &Cloth) {
        const ROWS: usize = 11;
        const COLUMNS: usize = 18;
        self.grid([ROWS, COLUMNS], true, cloth.stuff, |row, column| {
            let theta = std::f32::consts::PI * row as f32 / (ROWS - 1) as f32;
            let phi = std::f32::consts::TAU * column as f32 / COLUMNS as f32;
            let d = skull::direction(theta, phi);
            let p = [0, 1, 2].map(|k| centre[k] + radii[k] * d[k]).into();
            cloth.knot(p, [phi * radii[0] * 10.0, row as f32 * radii[1] * 3.0], 1.0)
        });
    }

    /// Adds a flat or bent sheet, seen from both sides: `at` of two numbers in 0…1.
    #[cfg(feature = "studio")]
    pub(super) fn sheet(
        &mut self,
        cells: [usize; 2],
        cloth: &Cloth,
        at: impl Fn(f32, f32) -> Point,
    ) {
        let [rows, columns] = cells;
        for back in [false, true] {
            self.grid(cells, false, cloth.stuff, |row, column| {
                let v = row as f32 / (rows - 1) as f32;
                let u = column as f32 / (columns - 1) as f32;
                let u = if back { 1.0 - u } else { u };
                cloth.knot(at(u, v), [u, v], 1.0)
            });
        }
    }

    /// Adds a tube along a path; `outward(i)`: its thick side; `radii(i)`: half width across and along that.
    pub(crate) fn tube(
        &mut self,
        path: &[Point],
        outward: impl Fn(usize) -> Vector,
        radii: impl Fn(usize) -> [f32; 2],
        sides: usize,
        stuff: Stuff,
        mut knot: impl FnMut(usize, Point, f32) -> Knot,
    ) {
        self.grid([path.len(), sides], true, stuff, |i, j| {
            let (before, after) = (i.saturating_sub(1), (i + 1).min(path.len() - 1));
            let tangent = path[after] - path[before];
            let out = outward(i);
            let across = tangent.cross(&out);
            let across = across / across.norm().max(1e-9);
            let turn = j as f32 / sides as f32;
            let (sin, cos) = (std::f32::consts::TAU * turn).sin_cos();
            let [wide, thick] = radii(i);
            let p = path[i] + across * (wide * cos) + out * (thick * sin);
            knot(i, p, turn)
        });
    }
}
