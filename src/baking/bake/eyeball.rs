//! The eyeball as a collision surface for the lids: a centre and a radius per direction, measured on the mesh's own
//! ball, whose cornea bulges.
//!
//! Units and axes: the mesh's; directions in the face frame (left, up, out). Memory: 37 KB a ball. Limits: only
//! directions up to 115 degrees from straight out; behind, the radius is that of the edge.

use nalgebra::{Matrix3, Rotation3};

use super::mesh::{Mesh, Vec3, bounding_box};

/// Cells along each side of the table; 230 degrees across make a cell 3.4 degrees.
const CELLS: usize = 68;
/// Angle from straight out that the edge of the table stands for, radians.
const REACH: f64 = 2.0;

/// One eyeball.
#[derive(Clone)]
pub struct Ball {
    /// Centre.
    pub center: Vec3,
    axes: Matrix3<f64>,
    /// Largest radius in each direction, azimuthal equidistant around straight out.
    radius: Vec<f64>,
}

impl Ball {
    /// Measures the ball made of the vertices that pass `member`; `None` if there are none.
    pub fn measured(
        mesh: &Mesh,
        axes: &Matrix3<f64>,
        member: impl Fn(usize) -> bool,
    ) -> Option<Self> {
        let own = (0..mesh.positions.len()).filter(|&v| member(v));
        let own: Vec<Vec3> = own.map(|v| axes.transpose() * mesh.positions[v]).collect();
        if own.is_empty() {
            return None;
        }
        let (low, high) = bounding_box(&own);
        // The cornea lengthens the ball to the front: the centre is half a width behind that of the box's sides.
        let half = 0.25 * (high.x - low.x + high.y - low.y);
        let mut center = (low + high) / 2.0;
        center.z = center.z.min(low.z + half);
        let mut ball = Self {
            center: axes * center,
            axes: *axes,
            radius: vec![0.0; CELLS * CELLS],
        };
        let faces = (0..mesh.faces()).filter(|&f| member(mesh.face(f)[0].vertex as usize));
        for t in faces.flat_map(|f| mesh.solid(f)) {
            ball.add(t.map(|c| mesh.positions[c.vertex as usize]));
        }
        ball.fill();
        Some(ball)
    }

    /// The ball rotated by `gaze`, cornea included.
    pub fn turned(&self, gaze: Option<&Rotation3<f64>>) -> Self {
        Self {
            axes: gaze.map_or(self.axes, |gaze| gaze.matrix() * self.axes),
            ..self.clone()
        }
    }

    /// Table coordinates of a direction in the face frame.
    fn cell(direction: &Vec3) -> (f64, f64) {
        let across = direction.x.hypot(direction.y);
        let angle = across.atan2(direction.z).min(REACH);
        let middle = (CELLS - 1) as f64 / 2.0;
        let scale = if across > 0.0 {
            angle / REACH / across
        } else {
            0.0
        };
        let cell = |x: f64| middle * (1.0 + x * scale);
        (cell(direction.x), cell(direction.y))
    }

    fn direction(col: usize, row: usize) -> Vec3 {
        let middle = (CELLS - 1) as f64 / 2.0;
        let (x, y) = (col as f64 / middle - 1.0, row as f64 / middle - 1.0);
        let r = x.hypot(y);
        let angle = r * REACH;
        let s = if r > 0.0 { angle.sin() / r } else { 0.0 };
        Vec3::new(x * s, y * s, angle.cos())
    }

    /// Casts the table's rays that can meet one triangle.
    fn add(&mut self, corners: [Vec3; 3]) {
        let p = corners.map(|p| self.axes.transpose() * (p - self.center));
        let cells = p.map(|p| Self::cell(&p));
        let range = |pick: &dyn Fn(&(f64, f64)) -> f64| {
            let low = cells.iter().map(pick).fold(f64::INFINITY, f64::min);
            let high = cells.iter().map(pick).fold(0.0, f64::max);
            let last = CELLS - 1;
            ((low.floor() as usize).saturating_sub(1))..=((high.ceil() as usize + 1).min(last))
        };
        let normal = (p[1] - p[0]).cross(&(p[2] - p[0]));
        for row in range(&|c| c.1) {
            for col in range(&|c| c.0) {
                let ray = Self::direction(col, row);
                let along = normal.dot(&ray);
                if along.abs() < 1e-300 {
                    continue;
                }
                let distance = normal.dot(&p[0]) / along;
                let hit = ray * distance;
                let inside = (0..3).all(|k| {
                    let side = (p[(k + 1) % 3] - p[k]).cross(&(hit - p[k]));
                    side.dot(&normal) >= -1e-9 * normal.norm_squared()
                });
                if distance > 0.0 && inside {
                    let r = &mut self.radius[row * CELLS + col];
                    *r = r.max(distance);
                }
            }
        }
    }

    /// Fills cells without a hit with the mean of their neighbours, outwards from the known ones.
    fn fill(&mut self) {
        for _ in 0..CELLS {
            let before = self.radius.clone();
            for cell in (0..CELLS * CELLS).filter(|&cell| before[cell] <= 0.0) {
                let (row, col) = (cell / CELLS, cell % CELLS);
                let beside = [
                    (row > 0).then(|| cell - CELLS),
                    (row + 1 < CELLS).then_some(cell + CELLS),
                    (col > 0).then(|| cell - 1),
                    (col + 1 < CELLS).then_some(cell + 1),
                ];
                let known = beside.into_iter().flatten().map(|o| before[o]);
                let known: Vec<f64> = known.filter(|&r| r > 0.0).collect();
                if !known.is_empty() {
                    self.radius[cell] = known.iter().sum::<f64>() / known.len() as f64;
                }
            }
        }
    }

    /// Height of a point above the ball's surface along its ray from the centre; negative inside.
    pub fn height(&self, p: &Vec3) -> f64 {
        (p - self.center).norm() - self.surface(p)
    }

    /// Radius of the ball in the direction of `p`, bilinearly interpolated.
    pub fn surface(&self, p: &Vec3) -> f64 {
        let (x, y) = Self::cell(&(self.axes.transpose() * (p - self.center)));
        let (col, row) = ((x as usize).min(CELLS - 2), (y as usize).min(CELLS - 2));
        let (fx, fy) = (x - col as f64, y - row as f64);
        let r = |c: usize, r: usize| self.radius[r * CELLS + c];
        (r(col, row) * (1.0 - fx) + r(col + 1, row) * fx) * (1.0 - fy)
            + (r(col, row + 1) * (1.0 - fx) + r(col + 1, row + 1) * fx) * fy
    }

    /// The point moved along its ray to `height` above the surface.
    pub fn lifted(&self, p: &Vec3, height: f64) -> Vec3 {
        let ray = p - self.center;
        self.center + ray * ((self.surface(p) + height) / ray.norm())
    }
}

#[cfg(test)]
mod tests {
    use super::super::mesh::Corner;
    use super::*;

    #[test]
    fn a_sphere_has_its_radius_everywhere_in_front() {
        let mut mesh = Mesh {
            materials: vec!["eye".into()],
            ..Mesh::default()
        };
        let (rows, cols, center) = (25_u32, 48_u32, Vec3::new(3.0, -1.0, 8.0));
        for i in 0..rows {
            for j in 0..cols {
                let (a, b) = (
                    std::f64::consts::PI * f64::from(i) / f64::from(rows - 1),
                    std::f64::consts::TAU * f64::from(j) / f64::from(cols),
                );
                mesh.positions
                    .push(center + Vec3::new(a.sin() * b.cos(), a.cos(), a.sin() * b.sin()) * 1.5);
            }
        }
        for i in 0..rows - 1 {
            for j in 0..cols {
                let v = |i: u32, j: u32| Corner::bare(i * cols + j % cols);
                mesh.push_face(&[v(i, j), v(i, j + 1), v(i + 1, j + 1), v(i + 1, j)], 0);
            }
        }
        let ball = Ball::measured(&mesh, &Matrix3::identity(), |_| true).unwrap();
        assert!((ball.center - center).norm() < 1e-2);
        for k in 0..200 {
            let t = f64::from(k);
            let p = center
                + Vec3::new(
                    (t * 0.7).sin(),
                    (t * 1.3).cos(),
                    0.4 + (t * 0.31).sin().abs(),
                );
            let exact = (p - center).norm() - 1.5;
            // Facets of the test sphere lie up to 1 % inside.
            assert!((ball.height(&p) - exact).abs() < 0.02, "{k}");
            assert!(ball.height(&ball.lifted(&p, 0.05)) - 0.05 < 1e-9);
        }
    }
}
