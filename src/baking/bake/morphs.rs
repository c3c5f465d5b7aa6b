//! A head with its shapes as glTF morph targets.
//!
//! One vertex buffer serves all materials; a vertex of the mesh is duplicated for each texture or normal corner, and
//! all duplicates have bit-identical displacements, so that seams stay closed. Targets are sparse accessors unless
//! `dense` is set; empty ones have no data.
//!
//! Units: metres, y up, z out of the face as the mesh has it. Materials have names here; their colours are
//! [`super::looks`].

use std::collections::HashMap;

use rayon::prelude::*;
use serde_json::{Value, json};

use super::glb::{FLOAT, Glb, U16, U32, VERTICES, bound, bytes, push};
use super::mesh::{Corner, Mesh, Vec3};
use super::neck::{self, Neck};
use super::shape::Shape;

/// Share of moving vertices above which a dense target is smaller than a sparse one.
const DENSE_ABOVE: f64 = 0.85;
/// Smallest change of a normal that is written, 0.06 degrees.
const MIN_NORMAL_CHANGE: f32 = 1e-3;
/// Smallest 1 + cosine of two normals between which a rotation is defined.
const LEAST_TURNABLE: f64 = 1e-6;
/// Red, green, blue and opacity of a material without a known colour.
const COLOUR: [f64; 4] = [0.8, 0.72, 0.66, 1.0];
/// Roughness of all materials.
const ROUGHNESS: f64 = 0.6;

/// Appends a target, sparse if that is smaller and `dense` is unset, and returns its accessor.
fn push_target(glb: &mut Glb, values: &[[f32; 3]], dense: bool, with_bounds: bool) -> usize {
    let moved = (0..values.len()).filter(|&v| values[v] != [0.0; 3]);
    let moved: Vec<usize> = moved.collect();
    let mut accessor = json!({"componentType": FLOAT, "count": values.len(), "type": "VEC3"});
    if with_bounds {
        bound(&mut accessor, values);
    }
    if dense || moved.len() as f64 > DENSE_ABOVE * values.len() as f64 {
        accessor["bufferView"] = glb.push_view(&bytes(values), VERTICES).into();
    } else if !moved.is_empty() {
        let small = values.len() <= usize::from(u16::MAX);
        let (kind, size) = if small { (U16, 2) } else { (U32, 4) };
        let number = |v: &usize| v.to_le_bytes().into_iter().take(size);
        let numbers: Vec<u8> = moved.iter().flat_map(number).collect();
        let rows: Vec<[f32; 3]> = moved.iter().map(|&v| values[v]).collect();
        let numbers = glb.push_view(&numbers, 0);
        accessor["sparse"] = json!({
            "count": moved.len(),
            "indices": {"componentType": kind, "bufferView": numbers},
            "values": {"bufferView": glb.push_view(&bytes(&rows), 0)},
        });
    }
    glb.push_accessor(accessor)
}

/// Appends a shape's displacements and changes of normals, if there are any; returns the target.
pub(super) fn push_moves(glb: &mut Glb, [moved, bent]: &[Vec<[f32; 3]>; 2], dense: bool) -> Value {
    let mut target = json!({"POSITION": push_target(glb, moved, dense, true)});
    if !bent.is_empty() {
        target["NORMAL"] = push_target(glb, bent, dense, false).into();
    }
    target
}

/// Change of `normal` when the smooth surface's normal turns from `from` to `to`.
pub(super) fn bent(normal: &Vec3, [from, to]: [&Vec3; 2]) -> [f32; 3] {
    // Rodrigues' formula with sine and cosine as the products give them.
    let (axis, cosine) = (from.cross(to), from.dot(to));
    let once = axis.cross(normal);
    let twice = axis.cross(&once) / (1.0 + cosine).max(LEAST_TURNABLE);
    let d = single(&(once + twice));
    let nothing = d.iter().all(|d| d.abs() < MIN_NORMAL_CHANGE);
    if nothing { [0.0; 3] } else { d }
}

/// The mesh's corners as glTF vertices: one for each combination of texture and normal.
struct Split<'a> {
    mesh: &'a Mesh,
    /// Normals of the mesh's vertices.
    smooth: &'a [Vec3],
    metres: f64,
    /// Vertex of the mesh that each came from.
    source: Vec<usize>,
    uv: Vec<[f32; 2]>,
    normal: Vec<[f32; 3]>,
    /// Corners of triangles, by material.
    triangles: Vec<Vec<u32>>,
}

impl<'a> Split<'a> {
    /// Splits a mesh; `smooth` are vertex normals for corners without one.
    fn new(mesh: &'a Mesh, smooth: &'a [Vec3], metres: f64) -> Self {
        let mut known: HashMap<Corner, u32> = HashMap::new();
        let (mut source, mut uv, mut normal) = (Vec::new(), Vec::new(), Vec::new());
        let mut triangles: Vec<Vec<u32>> = vec![Vec::new(); mesh.materials.len()];
        for f in 0..mesh.faces() {
            for corner in mesh.solid(f).flatten() {
                let at = *known.entry(corner).or_insert_with(|| {
                    source.push(corner.vertex as usize);
                    // OBJ counts v from the bottom, glTF from the top.
                    let place = corner.uv.map(|k| mesh.uv[k as usize]);
                    uv.push(place.map_or([0.0, 0.0], |[u, v]| [u, 1.0 - v]));
                    normal.push(single(&mesh.normal(&corner, smooth)));
                    source.len() as u32 - 1
                });
                triangles[mesh.face_material[f] as usize].push(at);
            }
        }
        Self {
            mesh,
            smooth,
            metres,
            source,
            uv,
            normal,
            triangles,
        }
    }

    /// One row for each glTF vertex, from its mesh vertex.
    fn rows(&self, of: impl Fn(usize) -> [f32; 3]) -> Vec<[f32; 3]> {
        self.source.iter().map(|&v| of(v)).collect()
    }

    /// Writes the neutral vertices; returns the attributes of every primitive.
    fn attributes(&self, glb: &mut Glb) -> Value {
        let mesh = self.mesh;
        let positions = self.rows(|v| single(&(mesh.positions[v] * self.metres)));
        let mut attributes = json!({
            "POSITION": glb.push_rows_with_bounds(&positions, VERTICES),
            "NORMAL": glb.push_rows(&self.normal, VERTICES),
        });
        if !mesh.tints.is_empty() {
            let tints = self.rows(|v| mesh.tints[v]);
            attributes["COLOR_0"] = glb.push_rows(&tints, VERTICES).into();
        }
        if !mesh.uv.is_empty() {
            attributes["TEXCOORD_0"] = glb.push_rows(&self.uv, VERTICES).into();
        }
        attributes
    }

    /// Displacements of a shape, and changes of normals.
    fn target(&self, shape: &Shape) -> [Vec<[f32; 3]>; 2] {
        let moved = self.rows(|v| single(&(shape.displacement[v] * self.metres)));
        let now = self.mesh.vertex_normals(&shape.moved(&self.mesh.positions));
        let corners = self.source.iter().zip(&self.normal);
        let bent = corners.map(|(&v, normal)| {
            let normal = Vec3::from(normal.map(f64::from));
            bent(&normal, [&self.smooth[v], &now[v]])
        });
        [moved, bent.collect()]
    }

    /// Writes a primitive and its material for every material in use.
    fn primitives(
        &self,
        glb: &mut Glb,
        attributes: &Value,
        targets: &[Value],
        names: &[&str],
    ) -> Vec<Value> {
        let mut primitives = Vec::new();
        let materials = self.mesh.materials.iter().zip(self.mesh.sheets());
        for (triangles, (name, thin)) in self.triangles.iter().zip(materials) {
            if triangles.is_empty() {
                continue;
            }
            let indices = glb.push_corners(triangles);
            let mut material = json!({"name": name, "pbrMetallicRoughness": {"baseColorFactor": COLOUR, "metallicFactor": 0.0, "roughnessFactor": ROUGHNESS}});
            if thin {
                material["doubleSided"] = true.into();
            }
            let material = push(&mut glb.json["materials"], material);
            let mut primitive =
                json!({"attributes": attributes, "indices": indices, "material": material});
            if !targets.is_empty() {
                primitive["targets"] = json!(targets);
                primitive["extras"] = json!({"targetNames": names});
            }
            primitives.push(primitive);
        }
        primitives
    }
}

/// Builds the file: the neutral mesh scaled by `metres` per unit, and the shapes as morph targets.
pub fn build(mesh: &Mesh, shapes: &[Shape], metres: f64, dense: bool, neck: Option<&Neck>) -> Glb {
    let mut glb = Glb {
        json: json!({
            "asset": {"version": "2.0", "generator": concat!("mien-studio ", env!("CARGO_PKG_VERSION"))},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0, "name": "head"}],
        }),
        bin: Vec::new(),
    };
    let smooth = mesh.vertex_normals(&mesh.positions);
    let split = Split::new(mesh, &smooth, metres);
    let mut attributes = split.attributes(&mut glb);
    if let Some(neck) = neck {
        let shares = split.source.iter().map(|&v| neck.shares[v]);
        [attributes["JOINTS_0"], attributes["WEIGHTS_0"]] =
            neck::weighed(&mut glb, shares).map(Value::from);
    }
    let moved = shapes.par_iter().map(|shape| split.target(shape));
    let moved: Vec<[Vec<[f32; 3]>; 2]> = moved.collect();
    let targets = moved.iter().map(|rows| push_moves(&mut glb, rows, dense));
    let targets: Vec<Value> = targets.collect();
    let names: Vec<&str> = shapes.iter().map(|s| s.name.as_str()).collect();
    let primitives = split.primitives(&mut glb, &attributes, &targets, &names);
    let mut head = json!({"name": "head", "primitives": primitives});
    if !targets.is_empty() {
        head["weights"] = json!(vec![0.0; shapes.len()]);
        head["extras"] = json!({"targetNames": names, "mien": baked(&Value::Null, &names, shapes)});
    }
    glb.json["meshes"] = json!([head]);
    if let Some(neck) = neck {
        neck::joined(&mut glb, &neck.places.map(|p| p * metres));
    }
    glb
}

/// Metadata of the targets `names`: those of `shapes`, and of earlier bakes in `before`.
pub(super) fn baked(before: &Value, names: &[impl AsRef<str>], shapes: &[Shape]) -> Value {
    let named = |k: usize| shapes.iter().find(|s| s.name == names[k].as_ref());
    let each = |key: &str, now: fn(&Shape) -> Value| -> Vec<Value> {
        let all = (0..names.len()).map(|k| named(k).map_or(before[key][k].clone(), now));
        all.collect()
    };
    json!({
        "version": env!("CARGO_PKG_VERSION"), "baked": each("baked", |_| true.into()),
        "units": each("units", |s| s.unit.clone().into()), "upon": each("upon", |s| s.upon.clone().into()),
    })
}

/// A vector in single precision.
pub(crate) fn single(v: &Vec3) -> [f32; 3] {
    [v.x as f32, v.y as f32, v.z as f32]
}

#[cfg(test)]
mod tests {
    use super::super::glb::Glb;
    use super::super::mesh::tests::sheet;
    use super::*;

    fn shapes(n: usize) -> Vec<Shape> {
        let shape = |name: &str, moved: Vec<Vec3>| Shape {
            name: name.into(),
            unit: Some("AU26".into()),
            area: vec![true; n],
            displacement: moved,
            ..Shape::default()
        };
        let mut some = vec![Vec3::zeros(); n];
        some[3] = Vec3::new(0.25, -0.5, 1.0);
        vec![
            shape("some", some),
            shape("none", vec![Vec3::zeros(); n]),
            shape("all", vec![Vec3::y(); n]),
        ]
    }

    #[test]
    fn sparse_and_dense_read_back_the_same() {
        let mut mesh = sheet(6, 0.1);
        // A texture seam: one corner of one face has its own texture point.
        mesh.uv = vec![[0.0, 0.0], [0.5, 0.25]];
        for (k, corner) in mesh.corners.iter_mut().enumerate() {
            corner.uv = Some(u32::from(k == 9));
        }
        let shapes = shapes(mesh.positions.len());
        let mut results = Vec::new();
        for dense in [false, true] {
            let file = build(&mesh, &shapes, 0.01, dense, None).emit();
            let glb = Glb::parse(&file).unwrap();
            let head = &glb.json["meshes"][0];
            assert_eq!(
                head["extras"]["targetNames"],
                json!(["some", "none", "all"])
            );
            let targets = head["primitives"][0]["targets"].as_array().unwrap();
            let read: Vec<Vec<f32>> = targets
                .iter()
                .map(|t| {
                    glb.floats(t["POSITION"].as_u64().unwrap() as usize, 3)
                        .unwrap()
                })
                .collect();
            assert_eq!(read[0].len(), 37 * 3);
            // Vertex 3 stands at the seam: both copies move alike.
            let rows: Vec<&[f32]> = read[0].chunks(3).filter(|v| *v != [0.0; 3]).collect();
            assert!(rows.len() == 2 && rows[0] == rows[1]);
            assert!(read[1].iter().all(|v| *v == 0.0));
            results.push(read);
        }
        assert_eq!(results[0], results[1]);
    }

    #[test]
    fn damaged_files_are_refused_in_one_sentence() {
        let file = build(&sheet(4, 0.1), &shapes(16), 0.01, false, None).emit();
        for cut in [0, 3, 11, 19, 40, file.len() - 5] {
            assert!(Glb::parse(&file[..cut]).is_err(), "{cut}");
        }
        assert!(Glb::parse(b"v 0 0 0\nv 1 0 0\n").is_err());
    }
}
