//! glTF 2.0 in its binary container: a head with morph targets, written and read again.
//!
//! One vertex buffer serves all materials; a vertex of the mesh is repeated for each texture or normal corner it has, and
//! all copies carry the same displacement bit for bit, so that seams stay closed. Targets are sparse accessors unless
//! `dense` is asked for; those that move nothing have no data at all.
//!
//! Units: metres, y up, z out of the face as the mesh has it. Limits: no textures or images; materials by name only.

use std::collections::HashMap;

use rayon::prelude::*;
use serde_json::{Value, json};

use super::mesh::{Mesh, Vec3};
use super::rig::Shape;

const MAGIC: u32 = 0x4654_6C67;
const JSON_CHUNK: u32 = 0x4E4F_534A;
const BIN_CHUNK: u32 = 0x004E_4942;
const FLOAT: u32 = 5126;
const U16: u32 = 5123;
const U32: u32 = 5125;
const VERTICES: u32 = 34962;
const INDICES: u32 = 34963;
/// A target that moves more than this part of the vertices is smaller written in full.
const DENSE_ABOVE: f64 = 0.85;
/// More rows than this no accessor of a head has.
const MOST: usize = 50_000_000;
/// Normals that turn less than this are left: 0.06 degrees.
const NORMAL_NOTHING: f32 = 1e-3;

/// Why a GLB file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum GlbError {
    /// Not the container.
    #[error("expected a GLB file (binary glTF 2.0), found {found}")]
    Container {
        /// What is wrong.
        found: &'static str,
    },
    /// JSON chunk damaged.
    #[error("the JSON chunk of the GLB file is damaged: {0}")]
    Json(#[from] serde_json::Error),
    /// Something else than expected inside.
    #[error("expected {expected} in the GLB file, found {found}")]
    Content {
        /// What should be there.
        expected: &'static str,
        /// What is there.
        found: String,
    },
}

/// The two chunks of a GLB file.
pub struct Glb {
    /// The description.
    pub json: Value,
    /// The data.
    pub bin: Vec<u8>,
}

impl Glb {
    /// Splits the container.
    ///
    /// # Errors
    /// If it is not a whole GLB file of version 2.
    pub fn parse(bytes: &[u8]) -> Result<Self, GlbError> {
        let refuse = |found| GlbError::Container { found };
        let word = |at: usize| {
            bytes
                .get(at..at + 4)
                .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                .ok_or_else(|| refuse("a file that ends in the middle"))
        };
        if word(0)? != MAGIC {
            return Err(refuse("another kind of file"));
        }
        if word(4)? != 2 {
            return Err(refuse("another version than 2"));
        }
        let chunk = |at: usize, kind: u32| {
            let length = word(at)? as usize;
            if word(at + 4)? != kind {
                return Err(refuse("chunks in another order than JSON, BIN"));
            }
            bytes
                .get(at + 8..at + 8 + length)
                .map(|data| (data, at + 8 + length))
                .ok_or_else(|| refuse("a file that ends in the middle"))
        };
        let (json, end) = chunk(12, JSON_CHUNK)?;
        let json = serde_json::from_slice(json)?;
        let bin = if end < bytes.len() {
            chunk(end, BIN_CHUNK)?.0.to_vec()
        } else {
            Vec::new()
        };
        Ok(Self { json, bin })
    }

    /// The file.
    #[must_use]
    pub fn emit(&self) -> Vec<u8> {
        let mut json = self.json.to_string().into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let padded = self.bin.len().next_multiple_of(4);
        let total = 12 + 8 + json.len() + 8 + padded;
        let mut out = Vec::with_capacity(total);
        for word in [MAGIC, 2, total as u32, json.len() as u32, JSON_CHUNK] {
            out.extend(word.to_le_bytes());
        }
        out.extend(json);
        for word in [padded as u32, BIN_CHUNK] {
            out.extend(word.to_le_bytes());
        }
        out.extend(&self.bin);
        out.resize(total, 0);
        out
    }

    /// Appends data as a buffer view and returns its index; `target` 0 means none.
    pub fn push_view(&mut self, data: &[u8], target: u32) -> usize {
        self.bin.resize(self.bin.len().next_multiple_of(4), 0);
        let mut view = json!({"buffer": 0, "byteOffset": self.bin.len(), "byteLength": data.len()});
        if target != 0 {
            view["target"] = target.into();
        }
        self.bin.extend(data);
        self.json["buffers"] = json!([{"byteLength": self.bin.len()}]);
        push(&mut self.json["bufferViews"], view)
    }

    /// Appends an accessor and returns its index.
    pub fn push_accessor(&mut self, accessor: Value) -> usize {
        push(&mut self.json["accessors"], accessor)
    }

    /// Values of a float accessor as rows of `width`, sparse parts filled in.
    ///
    /// # Errors
    /// If the accessor does not exist, is not of floats or reaches over the data.
    pub fn floats(&self, accessor: usize, width: usize) -> Result<Vec<f32>, GlbError> {
        let content = |found: &str| GlbError::Content {
            expected: "an accessor of floats within the data",
            found: format!("accessor {accessor}: {found}"),
        };
        let a = &self.json["accessors"][accessor];
        if a["componentType"] != FLOAT {
            return Err(content("another component type"));
        }
        let count = a["count"].as_u64().unwrap_or(u64::MAX) as usize;
        if count > MOST {
            return Err(content("no count, or one beyond any head"));
        }
        let view = |k: &Value, offset: &Value, bytes: usize| {
            let v = &self.json["bufferViews"][k.as_u64().unwrap_or(u64::MAX) as usize];
            let from = v["byteOffset"].as_u64().unwrap_or(0) as usize;
            let from = from.saturating_add(offset.as_u64().unwrap_or(0) as usize);
            self.bin
                .get(from..from.saturating_add(bytes))
                .ok_or_else(|| content("data that end too early"))
        };
        let float = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        let mut out = if a["bufferView"].is_null() {
            vec![0.0; count * width]
        } else {
            let stride = self.stride(&a["bufferView"]).max(width * 4);
            let length = count.saturating_sub(1) * stride + width * 4;
            let data = view(
                &a["bufferView"],
                &a["byteOffset"],
                length.min(count * stride),
            )?;
            (0..count * width)
                .map(|k| float(&data[k / width * stride + k % width * 4..]))
                .collect()
        };
        let sparse = &a["sparse"];
        if let Some(n) = sparse["count"].as_u64() {
            let n = (n as usize).min(MOST);
            let small = sparse["indices"]["componentType"] == U16;
            let size = if small { 2 } else { 4 };
            let indices = view(
                &sparse["indices"]["bufferView"],
                &sparse["indices"]["byteOffset"],
                n * size,
            )?;
            let values = view(
                &sparse["values"]["bufferView"],
                &sparse["values"]["byteOffset"],
                n * width * 4,
            )?;
            for k in 0..n {
                let b = &indices[k * size..];
                let at = if small {
                    usize::from(u16::from_le_bytes([b[0], b[1]]))
                } else {
                    u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize
                };
                let row = out
                    .get_mut(at * width..(at + 1) * width)
                    .ok_or_else(|| content("a sparse index beyond the count"))?;
                for (c, value) in row.iter_mut().enumerate() {
                    *value = float(&values[(k * width + c) * 4..]);
                }
            }
        }
        Ok(out)
    }
}

impl Glb {
    /// Bytes from one row of a view to the next; 0 if they follow each other.
    fn stride(&self, view: &Value) -> usize {
        let view = &self.json["bufferViews"][view.as_u64().unwrap_or(u64::MAX) as usize];
        view["byteStride"].as_u64().unwrap_or(0).min(255) as usize
    }

    /// Values of an accessor of whole numbers.
    ///
    /// # Errors
    /// If the accessor does not exist, is of another type or reaches over the data.
    pub fn indices(&self, accessor: usize) -> Result<Vec<u32>, GlbError> {
        let content = |found: &str| GlbError::Content {
            expected: "an accessor of whole numbers within the data",
            found: format!("accessor {accessor}: {found}"),
        };
        let a = &self.json["accessors"][accessor];
        let size = match a["componentType"].as_u64() {
            Some(5121) => 1,
            Some(5123) => 2,
            Some(5125) => 4,
            _ => return Err(content("another component type")),
        };
        let count = a["count"].as_u64().unwrap_or(u64::MAX) as usize;
        let view = &self.json["bufferViews"][a["bufferView"].as_u64().unwrap_or(u64::MAX) as usize];
        let offset = |v: &Value| v["byteOffset"].as_u64().unwrap_or(0) as usize;
        let from = offset(view).saturating_add(offset(a));
        let data = self
            .bin
            .get(from..from.saturating_add(count.saturating_mul(size)))
            .ok_or_else(|| content("data that end too early"))?;
        let number = |b: &[u8]| b.iter().rev().fold(0, |n, &b| n << 8 | u32::from(b));
        Ok(data.chunks_exact(size).map(number).collect())
    }
}

fn push(list: &mut Value, item: Value) -> usize {
    if !list.is_array() {
        *list = json!([]);
    }
    let list = list.as_array_mut().expect("made an array above");
    list.push(item);
    list.len() - 1
}

fn bytes(values: impl IntoIterator<Item = [f32; 3]>) -> Vec<u8> {
    values
        .into_iter()
        .flatten()
        .flat_map(f32::to_le_bytes)
        .collect()
}

/// Smallest and largest of each coordinate.
fn bounds<'a>(values: impl IntoIterator<Item = &'a [f32; 3]>) -> ([f32; 3], [f32; 3]) {
    let mut out = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for v in values {
        for k in 0..3 {
            out.0[k] = out.0[k].min(v[k]);
            out.1[k] = out.1[k].max(v[k]);
        }
    }
    out
}

/// A target's accessor: nothing, sparse or dense, whichever fits.
pub(super) fn push_target(
    glb: &mut Glb,
    values: &[[f32; 3]],
    dense: bool,
    with_bounds: bool,
) -> usize {
    let moved: Vec<usize> = (0..values.len())
        .filter(|&v| values[v] != [0.0; 3])
        .collect();
    let mut accessor = json!({"componentType": FLOAT, "count": values.len(), "type": "VEC3"});
    if with_bounds {
        let (low, high) = bounds(values);
        accessor["min"] = json!(low);
        accessor["max"] = json!(high);
    }
    if dense || moved.len() as f64 > DENSE_ABOVE * values.len() as f64 {
        accessor["bufferView"] = glb
            .push_view(&bytes(values.iter().copied()), VERTICES)
            .into();
    } else if !moved.is_empty() {
        let small = values.len() <= usize::from(u16::MAX);
        let indices: Vec<u8> = if small {
            moved
                .iter()
                .flat_map(|&v| (v as u16).to_le_bytes())
                .collect()
        } else {
            moved
                .iter()
                .flat_map(|&v| (v as u32).to_le_bytes())
                .collect()
        };
        let indices = glb.push_view(&indices, 0);
        let data = glb.push_view(&bytes(moved.iter().map(|&v| values[v])), 0);
        accessor["sparse"] = json!({
            "count": moved.len(),
            "indices": {"bufferView": indices, "componentType": if small { U16 } else { U32 }},
            "values": {"bufferView": data},
        });
    }
    glb.push_accessor(accessor)
}

/// Builds the file: the neutral mesh scaled by `metres` per unit, and the shapes as morph targets.
#[must_use]
pub fn build(mesh: &Mesh, shapes: &[Shape], metres: f64, dense: bool) -> Glb {
    let mut glb = Glb {
        json: json!({
            "asset": {"version": "2.0", "generator": concat!("mien-studio ", env!("CARGO_PKG_VERSION"))},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0, "name": "head"}],
        }),
        bin: Vec::new(),
    };
    // Corners that differ in texture or normal become vertices of their own.
    let mut known: HashMap<(u32, u32, u32), u32> = HashMap::new();
    let (mut source, mut uv, mut normal) = (Vec::new(), Vec::new(), Vec::new());
    let smooth = mesh.vertex_normals(&mesh.positions);
    let mut triangles: Vec<Vec<u32>> = vec![Vec::new(); mesh.materials.len()];
    for f in 0..mesh.faces() {
        let face = mesh.face(f);
        for t in mesh.split(f) {
            let t = t.map(|k| face[k]);
            if t[0].vertex == t[1].vertex
                || t[1].vertex == t[2].vertex
                || t[0].vertex == t[2].vertex
            {
                continue;
            }
            for corner in t {
                let key = (
                    corner.vertex,
                    corner.uv.unwrap_or(u32::MAX),
                    corner.normal.unwrap_or(u32::MAX),
                );
                let at = *known.entry(key).or_insert_with(|| {
                    source.push(corner.vertex as usize);
                    // OBJ counts v from the bottom, glTF from the top.
                    uv.push(corner.uv.map_or([0.0, 0.0], |k| {
                        let [u, v] = mesh.uv[k as usize];
                        [u, 1.0 - v]
                    }));
                    let n = corner.normal.map_or(smooth[corner.vertex as usize], |k| {
                        let n = mesh.normals[k as usize];
                        let n = Vec3::new(f64::from(n[0]), f64::from(n[1]), f64::from(n[2]));
                        if n.norm() > 0.0 {
                            n.normalize()
                        } else {
                            Vec3::z()
                        }
                    });
                    normal.push(unit(&n));
                    source.len() as u32 - 1
                });
                triangles[mesh.face_material[f] as usize].push(at);
            }
        }
    }
    let scaled = |p: &Vec3| {
        [
            (p.x * metres) as f32,
            (p.y * metres) as f32,
            (p.z * metres) as f32,
        ]
    };
    let positions: Vec<[f32; 3]> = source.iter().map(|&v| scaled(&mesh.positions[v])).collect();
    let count = positions.len();
    let (low, high) = bounds(&positions);
    let view = glb.push_view(&bytes(positions), VERTICES);
    let position = glb.push_accessor(json!({
        "bufferView": view, "componentType": FLOAT, "count": count, "type": "VEC3", "min": low, "max": high,
    }));
    let view = glb.push_view(&bytes(normal.iter().copied()), VERTICES);
    let normals = glb.push_accessor(
        json!({"bufferView": view, "componentType": FLOAT, "count": count, "type": "VEC3"}),
    );
    let mut attributes = json!({"POSITION": position, "NORMAL": normals});
    if !mesh.uv.is_empty() {
        let data: Vec<u8> = uv
            .iter()
            .flatten()
            .flat_map(|v: &f32| v.to_le_bytes())
            .collect();
        let view = glb.push_view(&data, VERTICES);
        attributes["TEXCOORD_0"] = glb
            .push_accessor(
                json!({"bufferView": view, "componentType": FLOAT, "count": count, "type": "VEC2"}),
            )
            .into();
    }
    let rows: Vec<[Vec<[f32; 3]>; 2]> = shapes
        .par_iter()
        .map(|shape| {
            let moved = source
                .iter()
                .map(|&v| scaled(&shape.displacement[v]))
                .collect();
            let deformed: Vec<Vec3> = mesh
                .positions
                .iter()
                .zip(&shape.displacement)
                .map(|(p, d)| p + d)
                .collect();
            let turned = mesh.vertex_normals(&deformed);
            let bent = source
                .iter()
                .map(|&v| {
                    let d = turned[v] - smooth[v];
                    let d = [d.x as f32, d.y as f32, d.z as f32];
                    if d.iter().all(|d| d.abs() < NORMAL_NOTHING) {
                        [0.0; 3]
                    } else {
                        d
                    }
                })
                .collect();
            [moved, bent]
        })
        .collect();
    let mut targets = Vec::new();
    for [moved, bent] in &rows {
        let position = push_target(&mut glb, moved, dense, true);
        let normal = push_target(&mut glb, bent, dense, false);
        targets.push(json!({"POSITION": position, "NORMAL": normal}));
    }
    let names: Vec<&str> = shapes.iter().map(|s| s.name.as_str()).collect();
    let mut primitives = Vec::new();
    for (k, name) in mesh.materials.iter().enumerate() {
        if triangles[k].is_empty() {
            continue;
        }
        let data: Vec<u8> = triangles[k].iter().flat_map(|v| v.to_le_bytes()).collect();
        let view = glb.push_view(&data, INDICES);
        let indices = glb.push_accessor(json!({
            "bufferView": view, "componentType": U32, "count": triangles[k].len(), "type": "SCALAR",
        }));
        let material = push(
            &mut glb.json["materials"],
            json!({"name": name, "pbrMetallicRoughness": {"baseColorFactor": [0.8, 0.72, 0.66, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.6}}),
        );
        let mut primitive =
            json!({"attributes": attributes, "indices": indices, "material": material});
        if !targets.is_empty() {
            primitive["targets"] = json!(targets);
            primitive["extras"] = json!({"targetNames": names});
        }
        primitives.push(primitive);
    }
    let mut head = json!({"name": "head", "primitives": primitives});
    if !targets.is_empty() {
        head["weights"] = json!(vec![0.0; shapes.len()]);
        let units: Vec<Option<&str>> = shapes.iter().map(|s| s.unit.as_deref()).collect();
        let upon: Vec<Option<&str>> = shapes.iter().map(|s| s.upon.as_deref()).collect();
        head["extras"] = json!({
            "targetNames": names,
            "mien": {"version": env!("CARGO_PKG_VERSION"), "units": units, "upon": upon},
        });
    }
    glb.json["meshes"] = json!([head]);
    glb
}

/// A unit vector as floats whose length is 1 within float accuracy.
fn unit(n: &Vec3) -> [f32; 3] {
    [n.x as f32, n.y as f32, n.z as f32]
}

#[cfg(test)]
mod tests {
    use super::super::mesh::tests::sheet;
    use super::*;

    fn shapes(n: usize) -> Vec<Shape> {
        let shape = |name: &str, moved: Vec<Vec3>| Shape {
            name: name.into(),
            unit: Some("AU26".into()),
            upon: None,
            area: vec![true; n],
            displacement: moved,
            unknowns: 0,
            milliseconds: 0.0,
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
            let file = build(&mesh, &shapes, 0.01, dense).emit();
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
        let file = build(&sheet(4, 0.1), &shapes(16), 0.01, false).emit();
        for cut in [0, 3, 11, 19, 40, file.len() - 5] {
            assert!(Glb::parse(&file[..cut]).is_err(), "{cut}");
        }
        assert!(Glb::parse(b"v 0 0 0\nv 1 0 0\n").is_err());
    }
}
