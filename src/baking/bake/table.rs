//! `--controls`: displacements of single vertices from a table, in place of a recipe.
//!
//! Units: the mesh's. Columns shape, vertex, dx, dy, dz by name, others ignored.

use std::path::Path;

use nalgebra::{Isometry3, Unit, UnitQuaternion};

use super::files::read;
use super::head::Head;
use super::mesh::Vec3;
use super::shape::Target;
use mien_workbench::csv;
use mien_workbench::fault::Fault;

/// Most shapes of a table.
const MAX_SHAPES: usize = 1024;

/// Targets from a table of controls; `vertex` maps the table's vertex numbers to the head's.
pub(super) fn table(
    path: &Path,
    head: &Head,
    vertex: &[u32],
    derive: bool,
) -> Result<Vec<Target>, Fault> {
    let mut targets = targets(&read(path)?, path, vertex.len(), derive)?;
    for target in &mut targets {
        for control in &mut target.controls {
            control.0 = vertex[control.0 as usize];
        }
        target.jaw = jaw_of(head, &target.controls);
    }
    Ok(targets)
}

/// Targets from the text of the table at `path` for a mesh of `count` vertices, without a jaw.
///
/// At the first line that is no control of this mesh.
/// At the first line that is no control of this mesh.
pub fn targets(text: &str, path: &Path, count: usize, derive: bool) -> Result<Vec<Target>, Fault> {
    let refuse = |line, expected, found: &str| Fault::at_line(path, line, expected, found);
    let table = csv::Table::new(text);
    const HEADER: &str = "the columns shape,vertex,dx,dy,dz";
    const ROW: &str = "a shape, a vertex of the mesh (from 0) and three finite numbers";
    let columns = ["shape", "vertex", "dx", "dy", "dz"].map(|name| table.find(name));
    let columns: Option<Vec<usize>> = columns.into_iter().collect();
    let columns = columns.ok_or_else(|| refuse(1, HEADER, table.header))?;
    let mut targets: Vec<Target> = Vec::new();
    for row in table.rows() {
        let control = || {
            let cell = |c: usize| row.cells.get(columns[c]).copied();
            let vertex: u32 = cell(1)?.parse().ok()?;
            let number = |c: usize| cell(c)?.parse().ok().filter(|x: &f64| x.is_finite());
            let moved = Vec3::new(number(2)?, number(3)?, number(4)?);
            let name = cell(0).filter(|name| !name.is_empty())?;
            ((vertex as usize) < count).then_some((name, (vertex, moved)))
        };
        let (name, control) = control().ok_or_else(|| refuse(row.line, ROW, row.text))?;
        // Rows of one shape usually are adjacent: search from the end.
        let known = targets.iter().rposition(|t| t.name == name);
        let at = known.unwrap_or(targets.len());
        if at == MAX_SHAPES {
            return Err(refuse(row.line, "at most 1024 shapes in one table", name));
        }
        if known.is_none() {
            targets.push(Target {
                name: name.into(),
                exact: true,
                derive,
                ..Target::default()
            });
        }
        targets[at].controls.push(control);
    }
    Ok(targets)
}

/// The jaw's motion behind a table of controls: a rotation about its axis, if chin and lower lip move down and back
/// together.
fn jaw_of(head: &Head, controls: &[(u32, Vec3)]) -> Option<Isometry3<f64>> {
    /// Share of a sculpted chin in the jaw's motion, see `jawOpen` in the recipe.
    const SHARE: f64 = 0.98;
    let w = head.eye_distance;
    let [left, up] = [0, 1].map(|k| head.axes.column(k).into_owned());
    let of = |point: usize| controls.iter().find(|(v, _)| *v == head.points[point]);
    let mut turn = 0.0;
    for point in [7, 8, 9] {
        let (_, d) = of(point)?;
        let arm = head.point(point) - head.hinge;
        let along = left.cross(&arm);
        if d.dot(&up) > -0.15 * w || d.dot(&along) < 0.8 * d.norm() * along.norm() {
            return None;
        }
        turn += d.dot(&along) / along.norm_squared() / SHARE / 3.0;
    }
    let (_, lip) = of(57)?;
    if lip.dot(&up) > -0.15 * w {
        return None;
    }
    let turn = UnitQuaternion::from_axis_angle(&Unit::new_normalize(left), turn);
    Some(Isometry3::rotation_wrt_point(turn, head.hinge.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_a_shape_belong_together_wherever_they_are() {
        let text = "shape,vertex,dx,dy,dz\na,0,1,2,3\nb,1,0,0,1\na,2,0,1,0\n";
        let targets = targets(text, Path::new("table.csv"), 3, false).expect("a table");
        let found = targets
            .iter()
            .map(|t| (t.name.as_str(), t.controls.as_slice()));
        let a = [(0, Vec3::new(1.0, 2.0, 3.0)), (2, Vec3::y())];
        let b = [(1, Vec3::z())];
        assert!(found.eq([("a", &a[..]), ("b", &b[..])]));
    }
}
