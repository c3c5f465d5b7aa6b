//! A shirt with a round collar: the skin of shoulders and lower neck again, a little further out, with a rim.

use super::layer::Layer;
use super::look;
use crate::base::geometry::smoothstep;
use crate::simulator::virtual_head::Part;
use crate::studio::bake::mesh::{Mesh, Vec3};

/// How far from the skin.
const OFF_M: f64 = 0.0035;
const SHADE: [f32; 3] = [1.0; 3];

/// How far below the collar a place is.
fn below(p: &Vec3) -> f64 {
    // Lower in front than behind.
    -0.134 - 0.020 * smoothstep(-0.160, -0.050, p.z) - p.y
}

/// Whether a place is well under the shirt: skin there has its colour, for the edge below.
pub(super) fn covers(p: &Vec3) -> bool {
    below(p) > 0.012
}

pub(super) fn sew(dress: &mut Layer, face: &Mesh, normals: &[Vec3], kind: &[Part]) {
    let n = face.positions.len();
    let mut number = vec![u32::MAX; n];
    let worn = |v: usize| kind[v] == Part::Skin && below(&face.positions[v]) > 0.0;
    for f in 0..face.faces() {
        let corners: Vec<usize> = face.face(f).iter().map(|c| c.vertex as usize).collect();
        if !corners.iter().any(|&v| worn(v)) || corners.iter().any(|&v| kind[v] != Part::Skin) {
            continue;
        }
        for &v in &corners {
            if number[v] == u32::MAX {
                number[v] = dress.vertex(edge(&face.positions[v], &normals[v]), SHADE);
            }
        }
        let list: Vec<u32> = corners.iter().map(|&v| number[v]).collect();
        dress.face(&list, look::SHIRT);
    }
}

/// A vertex of the shirt over one of the skin: those above the collar come down to it, and in to the skin.
fn edge(p: &Vec3, normal: &Vec3) -> Vec3 {
    let over = (-below(p)).max(0.0);
    let off = if over > 0.0 { 0.0 } else { OFF_M };
    Vec3::new(p.x, p.y - over, p.z) + normal * off
}
