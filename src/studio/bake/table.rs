//! `--controls`: displacements of single vertices from a table, in place of a recipe.
//!
//! Units: the mesh's. Columns shape, vertex, dx, dy, dz by name, others ignored.

use std::path::Path;

use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion};

use super::error::BakeError;
use super::files::read;
use super::head::Head;
use super::mesh::Vec3;
use super::recipe::Target;
use crate::studio::csv;

/// Shapes of one table.
const SHAPES: usize = 1024;

/// Targets from a table of controls; `vertex` is the head's vertex for each number that the table may have.
pub(super) fn table(
    path: &Path,
    head: &Head,
    vertex: &[u32],
    derive: bool,
) -> Result<Vec<Target>, BakeError> {
    let mut targets = targets(&read(path)?, path, vertex.len(), derive)?;
    for target in &mut targets {
        for control in &mut target.controls {
            control.0 = vertex[control.0 as usize];
        }
        target.jaw = jaw_of(head, &target.controls);
    }
    Ok(targets)
}

/// Targets from the text of the table at `path` for a mesh of so many vertices, without a jaw.
///
/// # Errors
/// At the first line that is no control of this mesh.
pub fn targets(
    text: &str,
    path: &Path,
    vertices: usize,
    derive: bool,
) -> Result<Vec<Target>, BakeError> {
    let refuse = |line, expected, found: &str| BakeError::Controls {
        path: path.into(),
        line,
        expected,
        found: found.chars().take(60).collect(),
    };
    let table = csv::Table::new(text);
    const HEADER: &str = "the columns shape,vertex,dx,dy,dz";
    let at: Option<Vec<usize>> = ["shape", "vertex", "dx", "dy", "dz"]
        .into_iter()
        .map(|name| table.find(name))
        .collect();
    let at = at.ok_or_else(|| refuse(1, HEADER, table.header))?;
    let mut targets: Vec<Target> = Vec::new();
    for row in table.rows() {
        const ROW: &str = "a shape, a vertex of the mesh (from 0) and three finite numbers";
        let refused = || refuse(row.line, ROW, row.text);
        let cell = |c: usize| row.cells.get(at[c]).copied().ok_or_else(refused);
        let name = cell(0)?;
        let vertex: usize = cell(1)?.parse().map_err(|_| refused())?;
        let mut d = Vec3::zeros();
        for c in 0..3 {
            d[c] = cell(2 + c)?.parse().map_err(|_| refused())?;
        }
        if vertex >= vertices || !d.iter().all(|x: &f64| x.is_finite()) || name.is_empty() {
            return Err(refused());
        }
        // Rows of one shape stand together in practice; look from the end.
        let target = match targets.iter().rposition(|t| t.name == name) {
            Some(at) => &mut targets[at],
            None if targets.len() == SHAPES => {
                return Err(refuse(row.line, "at most 1024 shapes in one table", name));
            }
            None => {
                targets.push(Target {
                    name: name.into(),
                    exact: true,
                    derive,
                    ..Target::default()
                });
                targets.last_mut().expect("just pushed")
            }
        };
        target.controls.push((vertex as u32, d));
    }
    Ok(targets)
}

/// The jaw's motion behind a table of controls: a turn about its axis, if chin and lower lip go down and back together.
fn jaw_of(head: &Head, controls: &[(u32, Vec3)]) -> Option<Isometry3<f64>> {
    /// What a sculpted chin takes part in a jaw's motion, see `jawOpen` in the recipe.
    const SHARE: f64 = 0.84;
    let w = head.eye_distance;
    let (left, up) = (
        head.axes.column(0).into_owned(),
        head.axes.column(1).into_owned(),
    );
    let mut turn = 0.0;
    for point in [7, 8, 9] {
        let (_, d) = controls.iter().find(|(v, _)| *v == head.points[point])?;
        let arm = head.point(point) - head.hinge;
        let along = left.cross(&arm);
        if d.dot(&up) > -0.15 * w || d.dot(&along) < 0.8 * d.norm() * along.norm() {
            return None;
        }
        turn += d.dot(&along) / along.norm_squared() / SHARE / 3.0;
    }
    let (_, lip) = controls.iter().find(|(v, _)| *v == head.points[57])?;
    if lip.dot(&up) > -0.15 * w {
        return None;
    }
    let turn = UnitQuaternion::from_axis_angle(&Unit::new_normalize(left), turn);
    Some(Isometry3::from_parts(
        Translation3::from(head.hinge - turn * head.hinge),
        turn,
    ))
}
