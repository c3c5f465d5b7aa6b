//! The mesh of an outfit and its building blocks.

use super::material::Material;
use super::skull;
use mien_stages::base::geometry::{Point, Vector};

/// [`Vertex::base`] of a vertex that is not attached to the face.
pub(super) const FREE: u32 = u32::MAX;

/// A vertex of an outfit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Vertex {
    /// Vertex of the face to which it is attached, or [`FREE`].
    pub(crate) base: u32,
    /// Offset from that vertex, or position in the head frame, metres.
    pub(crate) offset: Vector,
    /// Share by which it follows the torso instead of the head, 0…1.
    pub(crate) torso_share: f32,
    /// Colour, RGB 0…255.
    pub(crate) colour: [f32; 3],
    /// Texture coordinates, cells of noise.
    pub(crate) uv: [f32; 2],
    /// Share of the surface that is opaque, 0…1.
    pub(crate) coverage: f32,
}

/// Properties of a surface, from which vertices are made.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface {
    pub(crate) material: Material,
    pub(crate) colour: [f32; 3],
    /// As [`Vertex::torso_share`].
    pub(crate) torso_share: f32,
    /// Cells of noise per unit of u and of v.
    pub(crate) cells: [f32; 2],
}

impl Surface {
    pub(crate) const fn new(material: Material, colour: [f32; 3], torso_share: f32) -> Self {
        Self {
            material,
            colour,
            torso_share,
            cells: [60.0, 60.0],
        }
    }

    pub(crate) fn vertex(&self, p: Point, [u, v]: [f32; 2], coverage: f32) -> Vertex {
        Vertex {
            base: FREE,
            offset: p.coords,
            torso_share: self.torso_share,
            colour: self.colour,
            uv: [u * self.cells[0], v * self.cells[1]],
            coverage,
        }
    }
}

/// `steps` points of the curve `at`, whose parameter runs from 0 to 1.
pub(super) fn path(steps: usize, at: impl Fn(f32) -> Point) -> Vec<Point> {
    let share = |i| i as f32 / (steps - 1) as f32;
    (0..steps).map(|i| at(share(i))).collect()
}

/// A mesh of clothes, hair or furniture; corners clockwise seen from outside.
#[derive(Clone, Debug, Default)]
pub(crate) struct Outfit {
    pub(crate) vertices: Vec<Vertex>,
    pub(crate) triangles: Vec<([u32; 3], Material)>,
}

impl Outfit {
    /// Adds a grid of vertices `at(row, column)`, closed across the columns if `around`. Seen from outside, columns go right where rows
    /// go down.
    pub(crate) fn grid(
        &mut self,
        [rows, columns]: [usize; 2],
        around: bool,
        material: Material,
        mut at: impl FnMut(usize, usize) -> Vertex,
    ) {
        let start = self.vertices.len() as u32;
        for row in 0..rows {
            for column in 0..columns {
                self.vertices.push(at(row, column));
            }
        }
        let place = |row: usize, column: usize| start + (row * columns + column % columns) as u32;
        for row in 0..rows - 1 {
            for column in 0..columns - usize::from(!around) {
                let (a, b) = (place(row, column), place(row, column + 1));
                let (c, d) = (place(row + 1, column), place(row + 1, column + 1));
                for triangle in [[a, b, c], [b, d, c]] {
                    let drawn = |&k: &u32| self.vertices[k as usize].coverage > 0.0;
                    if triangle.iter().any(drawn) {
                        self.triangles.push((triangle, material));
                    }
                }
            }
        }
    }

    /// Adds an ellipsoid with `radii` along the axes.
    pub(crate) fn ball(&mut self, centre: [f32; 3], radii: [f32; 3], surface: &Surface) {
        const ROWS: usize = 11;
        const COLUMNS: usize = 18;
        self.grid([ROWS, COLUMNS], true, surface.material, |row, column| {
            let theta = std::f32::consts::PI * row as f32 / (ROWS - 1) as f32;
            let phi = std::f32::consts::TAU * column as f32 / COLUMNS as f32;
            let d = skull::direction(theta, phi);
            let p = [0, 1, 2].map(|k| centre[k] + radii[k] * d[k]).into();
            surface.vertex(p, [phi * radii[0] * 10.0, row as f32 * radii[1] * 3.0], 1.0)
        });
    }

    /// Adds a two-sided sheet `at(u, v)`, u and v in 0…1.
    #[cfg(feature = "studio")]
    pub(super) fn sheet(
        &mut self,
        cells: [usize; 2],
        surface: &Surface,
        at: impl Fn(f32, f32) -> Point,
    ) {
        let [rows, columns] = cells;
        for back in [false, true] {
            self.grid(cells, false, surface.material, |row, column| {
                let v = row as f32 / (rows - 1) as f32;
                let u = column as f32 / (columns - 1) as f32;
                let u = if back { 1.0 - u } else { u };
                surface.vertex(at(u, v), [u, v], 1.0)
            });
        }
    }

    /// Adds a tube along a path. `section(i)`: unit vector of its thickness, half width and half thickness, metres;
    /// `vertex(i, position, share of a turn)`.
    pub(crate) fn tube(
        &mut self,
        path: &[Point],
        sides: usize,
        material: Material,
        section: impl Fn(usize) -> (Vector, [f32; 2]),
        mut vertex: impl FnMut(usize, Point, f32) -> Vertex,
    ) {
        self.grid([path.len(), sides], true, material, |i, j| {
            let (before, after) = (i.saturating_sub(1), (i + 1).min(path.len() - 1));
            let tangent = path[after] - path[before];
            let (out, [wide, thick]) = section(i);
            let across = tangent.cross(&out);
            let across = across / across.norm().max(1e-9);
            let turn = j as f32 / sides as f32;
            let (sin, cos) = (std::f32::consts::TAU * turn).sin_cos();
            let p = path[i] + across * (wide * cos) + out * (thick * sin);
            vertex(i, p, turn)
        });
    }
}
