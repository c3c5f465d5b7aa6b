//! Other shapes for people's heads: displacements of the ICT mesh that `tests/people` derives for heads of every age.
//!
//! An expression changes with the shape as its surroundings do: each offset is transformed by the gradient of the deformation
//! (Sumner and Popović 2004, per vertex instead of per triangle), and blinks are scaled so that lids still meet.

use std::path::Path;

use nalgebra::Matrix3;

use super::ict::{Delta, head_axes, part, read_deltas};
use super::{HeadAsset, PersonHead, plain_head, set_upright};
use crate::heads::ict::IctHead;
use mien_simulator::virtual_head::Expression;
use mien_stages::base::geometry::{Point, Vector};
use mien_workbench::fault::Fault;

/// Pairs of upper and lower lid landmarks by eye, with the eye's blink.
const LIDS: [(&str, [[usize; 2]; 2]); 2] = [
    ("eyeBlink_R", [[37, 41], [38, 40]]),
    ("eyeBlink_L", [[43, 47], [44, 46]]),
];

/// Reads the shapes of a folder, by name ascending.
///
/// # Errors
/// If the folder cannot be read or a file does not fit the ICT mesh.
pub fn read_shapes(folder: &Path) -> Result<Vec<Delta>, Fault> {
    let read = read_deltas(folder, part::VERTICES, head_axes)?.into_iter();
    let shapes: Vec<Delta> = read
        .map(|(name, offsets)| Delta { name, offsets })
        .collect();
    match shapes.is_empty() {
        true => Err(Fault::within(folder)(
            "expected shapes written by tests/people/run, found none",
        )),
        false => Ok(shapes),
    }
}

/// Gives each `every`th head one of the shapes, in turn; `data` is the folder of the data sets.
///
/// # Errors
/// If there are shapes and the mesh cannot be read.
pub fn reshape(
    heads: &mut [PersonHead],
    shapes: &[Delta],
    every: usize,
    data: &Path,
) -> Result<(), Fault> {
    if shapes.is_empty() {
        return Ok(());
    }
    let plain = plain_head(&IctHead::read(&data.join("ict_facekit"))?);
    let some = heads.iter_mut().step_by(every);
    for (head, shape) in some.zip(shapes.iter().cycle()) {
        head.asset = reshaped(&head.asset, shape);
        set_upright(&mut head.asset, &plain);
    }
    Ok(())
}

/// The head with the displacements added to its neutral face, and its expressions changed accordingly.
fn reshaped(asset: &HeadAsset, shape: &Delta) -> HeadAsset {
    let mut other = asset.clone();
    for (p, offset) in other.neutral.iter_mut().zip(&shape.offsets) {
        *p += offset;
    }
    let gradients = gradients(&asset.neutral, &other.neutral, &asset.triangles);
    let carried = asset.expressions.iter().map(|expression| {
        let offsets = expression.vertices.iter().zip(&expression.offsets);
        Expression {
            offsets: offsets
                .map(|(&v, offset)| gradients[v as usize] * offset)
                .collect(),
            ..expression.clone()
        }
    });
    let mut expressions: Vec<Expression> = carried.collect();
    other.expressions = expressions.clone().into();
    for (name, pairs) in LIDS {
        let Some(blink) = other.expression(name) else {
            continue;
        };
        let gap = |head: &HeadAsset, weight: f32| -> f32 {
            let points = head.acting(Some(blink), weight);
            pairs
                .iter()
                .map(|&[a, b]| (points[a] - points[b]).norm())
                .sum()
        };
        let closes = gap(&other, 0.0) - gap(&other, 1.0);
        let factor = (gap(&other, 0.0) - gap(asset, 1.0)) / closes.max(1e-4);
        expressions[blink]
            .offsets
            .iter_mut()
            .for_each(|offset| *offset *= factor.clamp(0.5, 2.0));
    }
    other.expressions = expressions.into();
    other
}

/// Gradient of a deformation at each vertex, from its edges and its normal.
fn gradients(from: &[Point], to: &[Point], triangles: &[[u32; 3]]) -> Vec<Matrix3<f32>> {
    let mut sums = vec![[Matrix3::zeros(); 2]; from.len()];
    let mut normals = vec![[Vector::zeros(); 2]; from.len()];
    for triangle in triangles {
        let corners = triangle.map(|v| v as usize);
        let edge = |places: &[Point], a: usize, b: usize| places[b] - places[a];
        for k in 0..3 {
            let [a, b, c] = [0, 1, 2].map(|n| corners[(k + n) % 3]);
            let [old, new] = [edge(from, a, b), edge(to, a, b)];
            for v in [a, b] {
                sums[v][0] += new * old.transpose();
                sums[v][1] += old * old.transpose();
            }
            for (normal, places) in normals[a].iter_mut().zip([from, to]) {
                *normal += edge(places, a, b).cross(&edge(places, a, c));
            }
        }
    }
    let one = |([across, own], [old, new]): ([Matrix3<f32>; 2], [Vector; 2])| {
        // Along the normal, skin grows as it does on average along the surface.
        let length = own.trace().sqrt();
        let growth = across.norm() / own.norm();
        let [old, new] = [old.try_normalize(0.0), new.try_normalize(0.0)]
            .map(|n| n.unwrap_or_default() * length);
        let (across, own) = (
            across + new * old.transpose() * growth,
            own + old * old.transpose(),
        );
        own.try_inverse()
            .map_or(Matrix3::identity(), |inverse| across * inverse)
    };
    sums.into_iter().zip(normals).map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::base::geometry::rotation_from_yaw_pitch_roll;

    /// A bent sheet of 5 × 5 vertices.
    fn sheet() -> (Vec<Point>, Vec<[u32; 3]>) {
        let points = (0..25).map(|k| {
            let [x, y] = [k % 5, k / 5].map(|n| 0.01 * n as f32);
            Point::new(x, y, 3.0 * x * x - 2.0 * x * y)
        });
        let squares = (0..4).flat_map(|row| (0..4).map(move |col| 5 * row + col));
        let triangles = squares.flat_map(|v| [[v, v + 1, v + 5], [v + 1, v + 6, v + 5]]);
        (points.collect(), triangles.collect())
    }

    #[test]
    fn the_gradient_of_a_planted_motion_is_its_rotation_and_scale() {
        let (points, triangles) = sheet();
        let rotation = rotation_from_yaw_pitch_roll(0.5, -0.3, 0.2);
        let moved: Vec<Point> = points
            .iter()
            .map(|p| rotation * (p * 1.4) + Vector::y())
            .collect();
        let expected = rotation.to_rotation_matrix().into_inner() * 1.4;
        for gradient in gradients(&points, &moved, &triangles) {
            assert!((gradient - expected).norm() < 1e-3, "{gradient}");
        }
    }

    #[test]
    fn offsets_stretch_with_the_skin_around_them() {
        let (points, triangles) = sheet();
        let moved: Vec<Point> = points
            .iter()
            .map(|p| Point::new(2.0 * p.x, p.y, p.z))
            .collect();
        let flat: Vec<Point> = points.iter().map(|p| Point::new(p.x, p.y, 0.0)).collect();
        let wide: Vec<Point> = moved.iter().map(|p| Point::new(p.x, p.y, 0.0)).collect();
        let offset = gradients(&flat, &wide, &triangles)[12] * Vector::new(0.001, 0.001, 0.0);
        assert!(
            (offset - Vector::new(0.002, 0.001, 0.0)).norm() < 1e-5,
            "{offset}"
        );
    }
}
