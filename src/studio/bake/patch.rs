//! Heads that come as binary glTF (also VRM): their skin is read for baking, and the shapes are added to the file as it is.
//!
//! All triangles of all meshes are taken together; copies of a vertex at a seam are one for the solver and move alike, so
//! that seams stay closed ([`super::weld`]). Landmarks count the vertices of the POSITION accessors in the order of their first use. Everything
//! in the file stays: materials, textures, skeletons, animations, targets under other names; a target of the same name is
//! replaced.
//!
//! Vertices are where nodes put them ([`super::scene`]), shapes are written as their meshes store them.
//!
//! Units: the file's own (metres by the standard). Limits: no compressed or quantised positions; targets carry positions only.

use std::collections::HashMap;

use nalgebra::{Matrix3, Matrix4, Point3};
use serde_json::{Value, json};

use super::glb::{FLOAT, Glb, list, unexpected};
use super::looks::material_names;
use super::mesh::{Corner, Mesh, Vec3};
use super::morphs::{push_target, single};
use super::scene::placed;
use super::shape::Shape;
use super::vrm::{Bound, add_expressions, add_expressions_to, beginning};
use super::weld::{faces, sewn};
use crate::studio::fault::Fault;

/// What a row or a corner takes while it is read: place, its number, its edges.
const ROW_BYTES: usize = 64;
/// Parts of a file: each gets the names of all shapes.
const PRIMITIVES: usize = 4096;
/// Targets that a mesh may have already.
const TARGETS: usize = 1024;

/// A head read from a file, and where its vertices came from.
pub struct Foreign {
    pub(in crate::studio) glb: Glb,
    sources: Vec<Rows>,
}

/// The rows of a position accessor.
pub(in crate::studio) struct Rows {
    accessor: usize,
    /// The first of them among all.
    first: usize,
    /// For each the vertex of the mesh.
    vertices: Vec<u32>,
    /// From ways in the scene to ways in the file, where a node turns or scales.
    back: Option<Matrix3<f64>>,
}

/// Rows of all position accessors one after the other, and triangles between them.
#[derive(Default)]
struct Gathered {
    places: Vec<[f32; 3]>,
    /// Of each row; empty if no mesh has any.
    uv: Vec<[f32; 2]>,
    tints: Vec<[f32; 3]>,
    sources: Vec<Rows>,
    triangles: Vec<[u32; 3]>,
    /// Of each triangle the source and the material.
    parts: Vec<u32>,
    materials: Vec<Option<u64>>,
}

impl Gathered {
    fn of(glb: &Glb) -> Result<Self, Fault> {
        let mut all = Self::default();
        // What may refer to the same data again and again.
        let mut left = glb.budget() / ROW_BYTES;
        let mut take = |rows: usize| {
            left = left.checked_sub(rows).ok_or_else(|| {
                let expected = "vertices and triangles that the size of the file accounts for";
                unexpected(expected, "the same data used over and over")
            })?;
            Ok::<_, Fault>(())
        };
        let placed = placed(glb);
        let meshes = list(&glb.json["meshes"]).iter().zip(&placed);
        let primitives = meshes.flat_map(|(mesh, placed)| {
            let primitives = list(&mesh["primitives"]).iter();
            primitives.map(move |primitive| (primitive, placed.as_ref()))
        });
        for (primitive, placed) in primitives {
            let Some(accessor) = position(primitive) else {
                continue;
            };
            // Also of lines and points, which get targets that move nothing.
            let count = glb.count(accessor)?;
            if primitive["mode"].as_u64().unwrap_or(4) != 4 {
                continue;
            }
            let known = all.sources.iter().position(|s| s.accessor == accessor);
            let at = match known {
                Some(at) => at,
                None => {
                    take(count)?;
                    all.add(glb, &primitive["attributes"], accessor, placed)?;
                    all.sources.len() - 1
                }
            };
            let first = all.sources[at].first as u32;
            let order: Vec<u32> = match primitive["indices"].as_u64() {
                Some(indices) => glb.indices(indices as usize)?,
                None => (0..count as u32).collect(),
            };
            take(order.len())?;
            if order.iter().any(|&k| k as usize >= count) {
                let found = format!("one beyond the {count} of accessor {accessor}");
                return Err(unexpected("indices of vertices that exist", found));
            }
            for t in order.as_chunks::<3>().0 {
                all.triangles.push(t.map(|k| first + k));
                all.parts.push(at as u32);
                all.materials.push(primitive["material"].as_u64());
            }
        }
        Ok(all)
    }

    /// Adds the rows of an accessor, where `placed` puts them.
    fn add(
        &mut self,
        glb: &Glb,
        attributes: &Value,
        accessor: usize,
        placed: Option<&Matrix4<f64>>,
    ) -> Result<(), Fault> {
        let first = self.places.len();
        let rows = glb.floats(accessor, 3)?;
        let place = |&stored: &[f32; 3]| {
            let moved = |m: &Matrix4<f64>| m.transform_point(&Point3::from(stored).cast()).coords;
            placed.map_or(stored, |placed| single(&moved(placed)))
        };
        self.places.extend(rows.as_chunks().0.iter().map(place));
        let count = self.places.len() - first;
        self.sources.push(Rows {
            accessor,
            first,
            vertices: vec![0; count],
            back: placed.and_then(|m| m.fixed_view::<3, 3>(0, 0).try_inverse()),
        });
        // What is damaged there costs colours only.
        let of_corners = |name: &str, width: usize| {
            let listed = glb.listed("accessors", &attributes[name]);
            let width = width + usize::from(listed["type"] == "VEC4");
            let accessor = attributes[name].as_u64()? as usize;
            let rows = glb.floats(accessor, width).ok()?;
            let fits = listed["count"] == count && rows.iter().all(|x| x.is_finite());
            fits.then_some((rows, width))
        };
        if let Some((rows, width)) = of_corners("TEXCOORD_0", 2) {
            self.uv.resize(first, [0.0; 2]);
            // From the top in glTF.
            let rows = rows.chunks_exact(width).map(|r| [r[0], 1.0 - r[1]]);
            self.uv.extend(rows);
        }
        if let Some((rows, width)) = of_corners("COLOR_0", 3) {
            self.tints.resize(first, [1.0; 3]);
            let rows = rows.chunks_exact(width).map(|r| [r[0], r[1], r[2]]);
            self.tints.extend(rows);
        }
        Ok(())
    }

    /// One mesh, with the names of the file's materials; the sources get to know their vertices.
    fn mesh(&mut self, names: &[String]) -> Mesh {
        let same = sewn(&self.places, &self.triangles, &self.parts);
        let mut mesh = Mesh::default();
        // A vertex takes its number where it comes first.
        let mut vertex: Vec<u32> = Vec::with_capacity(self.places.len());
        for (row, p) in self.places.iter().enumerate() {
            let first = same[row] as usize;
            vertex.push(if first == row {
                mesh.positions.push(Vec3::from(p.map(f64::from)));
                if !self.tints.is_empty() {
                    let tint = self.tints.get(row).copied();
                    mesh.tints.push(tint.unwrap_or([1.0; 3]));
                }
                mesh.positions.len() as u32 - 1
            } else {
                vertex[first]
            });
        }
        for rows in &mut self.sources {
            let all = rows.first..rows.first + rows.vertices.len();
            rows.vertices.copy_from_slice(&vertex[all]);
        }
        let has_uv = !self.uv.is_empty();
        if has_uv {
            self.uv.resize(self.places.len(), [0.0; 2]);
        }
        mesh.uv = std::mem::take(&mut self.uv);
        let welded = |t: &[u32; 3]| t.map(|row| vertex[row as usize]);
        let welded: Vec<[u32; 3]> = self.triangles.iter().map(welded).collect();
        let mut number: HashMap<Option<u64>, u32> = HashMap::new();
        let mut at = 0;
        for face in faces(&mesh.positions, &welded) {
            // Of one triangle or two that follow each other.
            let rows = self.triangles[at..at + face.len() - 2].as_flattened();
            let named = self.materials[at];
            let material = *number.entry(named).or_insert_with(|| {
                let name = named.and_then(|m| names.get(m as usize)).cloned();
                mesh.materials.push(name.unwrap_or_else(|| "skin".into()));
                mesh.materials.len() as u32 - 1
            });
            at += face.len() - 2;
            let row = |v: u32| rows.iter().copied().find(|&row| vertex[row as usize] == v);
            let corners = face.iter().map(|&vertex| Corner {
                uv: row(vertex).filter(|_| has_uv),
                ..Corner::bare(vertex)
            });
            mesh.push_face(&corners.collect::<Vec<_>>(), material);
        }
        mesh
    }
}

impl Rows {
    /// Vertices of the mesh, and how far `moves` of the accessor's rows move them.
    pub(in crate::studio) fn placed(&self, moves: &[f32]) -> impl Iterator<Item = (usize, Vec3)> {
        let turn = self.back.and_then(|back| back.try_inverse());
        let rows = self.vertices.iter().zip(moves.chunks_exact(3));
        rows.map(move |(&vertex, row)| {
            let way = Vec3::new(row[0].into(), row[1].into(), row[2].into());
            (vertex as usize, turn.map_or(way, |turn| turn * way))
        })
    }
}

impl Foreign {
    /// Reads the meshes of a file as one.
    ///
    /// # Errors
    /// If it has no triangles, or data that are compressed, external or damaged.
    pub fn read(glb: Glb) -> Result<(Mesh, Self), Fault> {
        is_plain(&glb.json)?;
        can_be_added_to(&glb.json)?;
        let mut gathered = Gathered::of(&glb)?;
        let mesh = gathered.mesh(&material_names(&glb.json));
        let finite = |p: &Vec3| p.iter().all(|x| x.is_finite());
        if mesh.faces() == 0 || !mesh.positions.iter().all(finite) {
            let found = format!("{} faces", mesh.faces());
            return Err(unexpected("triangles with finite positions", found));
        }
        let sources = gathered.sources;
        Ok((mesh, Self { glb, sources }))
    }

    /// The vertex of the mesh for each number that a landmark file may have.
    fn numbered(&self) -> Vec<u64> {
        let all = self.sources.iter().flat_map(|s| &s.vertices);
        all.map(|&v| u64::from(v)).collect()
    }

    /// Vertices of the mesh by the numbers that a landmark file uses; unknown ones stay beyond the end.
    pub fn landmarks(&self, numbers: &[u64]) -> Vec<u64> {
        let all = self.numbered();
        let vertex = |&k: &u64| all.get(k as usize).copied();
        let beyond = |k: &u64| (*k).max(u64::from(u32::MAX));
        let known = |k| vertex(k).unwrap_or_else(|| beyond(k));
        numbers.iter().map(known).collect()
    }

    /// The other way round: the first number that a landmark file has for each vertex of the mesh.
    pub fn rows(&self, vertices: &[u64]) -> Vec<u64> {
        let all = self.numbered();
        let row = |v: &u64| all.iter().position(|o| o == v);
        let known = |v: &u64| row(v).map_or(*v, |row| row as u64);
        vertices.iter().map(known).collect()
    }

    /// The file with the shapes added to every mesh that they move.
    pub fn patched(mut self, shapes: &[Shape], dense: bool) -> Glb {
        let mut written: HashMap<(usize, usize), usize> = HashMap::new();
        let mut bound: Vec<Bound> = Vec::new();
        let added: Vec<&str> = shapes.iter().map(|s| s.name.as_str()).collect();
        for m in 0..list(&self.glb.json["meshes"]).len() {
            let mut mesh = self.glb.json["meshes"][m].take();
            if self.is_moved(&mesh, shapes) {
                let mut names = names(&mesh);
                let places = places(&mut names, shapes);
                for primitive in mesh["primitives"].as_array_mut().into_iter().flatten() {
                    let mut targets = list(&primitive["targets"]).to_vec();
                    targets.resize(names.len(), Value::Null);
                    let accessor = position(primitive).unwrap_or(usize::MAX);
                    for (k, (shape, &at)) in shapes.iter().zip(&places).enumerate() {
                        let index = *written
                            .entry((accessor, k))
                            .or_insert_with(|| self.push(accessor, shape, dense));
                        targets[at] = json!({"POSITION": index});
                    }
                    primitive["targets"] = json!(targets);
                    set_extra(&mut primitive["extras"], "targetNames", json!(names));
                }
                describe(&mut mesh, &names, shapes);
                for node in self.glb.json["nodes"].as_array_mut().into_iter().flatten() {
                    if node["mesh"] == json!(m) && node.get("weights").is_some() {
                        node["weights"] = lengthened(&node["weights"], names.len());
                    }
                }
                bound.push((m, places));
            }
            self.glb.json["meshes"][m] = mesh;
        }
        add_expressions(&mut self.glb.json, &added, &bound);
        self.glb
    }

    /// The rows of a position accessor, if it was read.
    pub(in crate::studio) fn rows_of(&self, accessor: usize) -> Option<&Rows> {
        self.sources.iter().find(|s| s.accessor == accessor)
    }

    fn is_moved(&self, mesh: &Value, shapes: &[Shape]) -> bool {
        let positions = list(&mesh["primitives"]).iter().filter_map(position);
        let mut sources = positions.filter_map(|accessor| self.rows_of(accessor));
        sources.any(|source| {
            let moved = |v: usize| shapes.iter().any(|s| s.displacement[v] != Vec3::zeros());
            source.vertices.iter().any(|&v| moved(v as usize))
        })
    }

    /// Writes how a shape moves the rows of an accessor.
    fn push(&mut self, accessor: usize, shape: &Shape, dense: bool) -> usize {
        let rows: Vec<[f32; 3]> = match self.rows_of(accessor) {
            Some(Rows { vertices, back, .. }) => {
                let moved = vertices.iter().map(|&v| shape.displacement[v as usize]);
                let stored = moved.map(|d| back.map_or(d, |back| back * d));
                stored.map(|d| single(&d)).collect()
            }
            // Lines and points: they have targets too, which move nothing.
            None => vec![[0.0; 3]; self.glb.count(accessor).unwrap_or(1).max(1)],
        };
        push_target(&mut self.glb, &rows, dense, true)
    }
}

/// The accessor of a primitive's positions.
pub(in crate::studio) fn position(primitive: &Value) -> Option<usize> {
    let accessor = primitive["attributes"]["POSITION"].as_u64();
    accessor.map(|accessor| accessor as usize)
}

/// The number of each shape's target, that of its namesake or a new one.
fn places(names: &mut Vec<String>, shapes: &[Shape]) -> Vec<usize> {
    let place = |Shape { name, .. }: &Shape| {
        let namesake = names.iter().position(|n| n == name);
        namesake.unwrap_or_else(|| {
            names.push(name.clone());
            names.len() - 1
        })
    };
    shapes.iter().map(place).collect()
}

/// Says of a mesh what its targets are called and what drives them.
fn describe(mesh: &mut Value, names: &[String], shapes: &[Shape]) {
    mesh["weights"] = lengthened(&mesh["weights"], names.len());
    set_extra(&mut mesh["extras"], "targetNames", json!(names));
    let named = |name: &String| shapes.iter().find(|s| s.name == *name);
    let units: Vec<Option<&str>> = names.iter().map(|n| named(n)?.unit.as_deref()).collect();
    let upon: Vec<Option<&str>> = names.iter().map(|n| named(n)?.upon.as_deref()).collect();
    let ours = json!({"version": env!("CARGO_PKG_VERSION"), "units": units, "upon": upon});
    set_extra(&mut mesh["extras"], "mien", ours);
}

/// Extensions by which positions are not what they seem.
const PACKED: [&str; 3] = [
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_draco_mesh_compression",
];

/// Whether positions are stored as they are, not packed: by the name of the extension if not.
fn is_plain(json: &Value) -> Result<(), Fault> {
    let is_float = |accessor: usize| json["accessors"][accessor]["componentType"] == FLOAT;
    let used = list(&json["extensionsUsed"]).iter();
    let mut used = used.filter_map(Value::as_str);
    let packed = used.find(|&name| match name {
        // Often of normals and texture coordinates only.
        "KHR_mesh_quantization" => !primitives(json).filter_map(position).all(is_float),
        _ => PACKED.contains(&name),
    });
    packed.map_or(Ok(()), |name| {
        let undo = "undo it with: npx @gltf-transform/cli dequantize packed.glb plain.glb";
        let found = format!("{name}; {undo}");
        Err(unexpected("positions that are not compressed", found))
    })
}

/// Whether everything that shapes are added to is of the type that it is added as: said before the work, not after.
fn can_be_added_to(json: &Value) -> Result<(), Fault> {
    let refuse = |expected, found: &Value| Err(unexpected(expected, beginning(found)));
    for primitive in primitives(json) {
        if !primitive.is_object() {
            return refuse("primitives that are objects", primitive);
        }
        let targets = list(&primitive["targets"]).len();
        if targets > TARGETS {
            return refuse("at most 1024 morph targets of a mesh", &json!(targets));
        }
    }
    let count = primitives(json).count();
    if count > PRIMITIVES {
        return refuse("at most 4096 primitives", &json!(count));
    }
    add_expressions_to(json)
}

/// Sets a key of `extras`. The standard lets these be of any type: what is no object goes along under a key of its own.
fn set_extra(extras: &mut Value, key: &str, value: Value) {
    if !extras.is_object() {
        *extras = match extras.take() {
            Value::Null => json!({}),
            other => json!({"extras": other}),
        };
    }
    extras[key] = value;
}

fn primitives(json: &Value) -> impl Iterator<Item = &Value> {
    let meshes = list(&json["meshes"]).iter();
    meshes.flat_map(|mesh| list(&mesh["primitives"]))
}

/// Names of a mesh's targets, made up where the file has none.
fn names(mesh: &Value) -> Vec<String> {
    let first = &mesh["primitives"][0];
    let of_mesh = mesh["extras"]["targetNames"].as_array();
    let given = of_mesh.or_else(|| first["extras"]["targetNames"].as_array());
    let name = |k: usize| Some(given?.get(k)?.as_str()?.to_owned());
    let all = 0..list(&first["targets"]).len();
    all.map(|k| name(k).unwrap_or_else(|| format!("target_{k}")))
        .collect()
}

/// Weights with zeros up to `count`.
fn lengthened(weights: &Value, count: usize) -> Value {
    let mut weights = list(weights).to_vec();
    weights.resize(count, json!(0.0));
    json!(weights)
}

#[cfg(test)]
mod tests {
    use super::super::mesh::tests::sheet;
    use super::super::morphs::build;
    use super::*;

    fn shape(name: &str, n: usize, at: usize, d: Vec3) -> Shape {
        let mut displacement = vec![Vec3::zeros(); n];
        displacement[at] = d;
        Shape {
            name: name.into(),
            displacement,
            area: vec![true; n],
            ..Shape::default()
        }
    }

    #[test]
    fn shapes_join_those_a_file_has_and_replace_their_namesakes() {
        let sheet = sheet(5, 0.1);
        let old = [
            shape("keep", 25, 3, Vec3::x()),
            shape("jawOpen", 25, 4, Vec3::y()),
        ];
        let file = build(&sheet, &old, 1.0, false, None);
        let before = file.json["materials"].clone();
        let (mesh, foreign) = Foreign::read(Glb::parse(&file.emit()).unwrap()).unwrap();
        assert_eq!((mesh.positions.len(), mesh.faces()), (25, 16));
        // Vertices come in the order of the file, which is that of the faces.
        let at = |k: usize| {
            let found = mesh
                .positions
                .iter()
                .position(|p| (p - sheet.positions[k]).norm() < 1e-6);
            found.unwrap()
        };
        let new = [
            shape("jawOpen", 25, at(7), Vec3::z()),
            shape("eyeBlinkLeft", 25, at(8), Vec3::z()),
        ];
        let glb = Glb::parse(&foreign.patched(&new, false).emit()).unwrap();
        assert_eq!(glb.json["materials"], before);
        let head = &glb.json["meshes"][0];
        assert_eq!(
            head["extras"]["targetNames"],
            json!(["keep", "jawOpen", "eyeBlinkLeft"])
        );
        assert_eq!(head["weights"].as_array().unwrap().len(), 3);
        let read = |k: usize| {
            let accessor = head["primitives"][0]["targets"][k]["POSITION"]
                .as_u64()
                .unwrap();
            let rows = glb.floats(accessor as usize, 3).unwrap();
            rows.chunks(3)
                .filter(|r| **r != [0.0; 3])
                .map(<[f32]>::to_vec)
                .collect::<Vec<_>>()
        };
        assert_eq!(read(0), [[1.0, 0.0, 0.0]]);
        assert_eq!(read(1), [[0.0, 0.0, 1.0]]);
        assert_eq!(read(2), [[0.0, 0.0, 1.0]]);
    }

    #[test]
    fn expressions_of_an_avatar_keep_their_meaning_and_gain_the_shapes() {
        let file = extended(json!({
            "VRM": {"blendShapeMaster": {"blendShapeGroups": [
                {"name": "A", "presetName": "a", "binds": [{"mesh": 0, "index": 0, "weight": 100.0}]},
                {"name": "cheekpuff", "presetName": "unknown", "binds": []},
            ]}},
            "VRMC_vrm": {"specVersion": "1.0", "expressions": {"preset": {
                "aa": {"morphTargetBinds": [{"node": 0, "index": 0, "weight": 1.0}]},
            }}},
        }));
        let (_, foreign) = Foreign::read(Glb::parse(&file.emit()).unwrap()).unwrap();
        let new = ["jawOpen", "cheekPuff"].map(|name| shape(name, 25, 7, Vec3::z()));
        let glb = Glb::parse(&foreign.patched(&new, false).emit()).unwrap();
        let head = &glb.json["meshes"][0];
        assert_eq!(
            head["extras"]["targetNames"],
            json!(["mouthA", "jawOpen", "cheekPuff"])
        );
        let kept = head["primitives"][0]["targets"][0]["POSITION"]
            .as_u64()
            .unwrap();
        let moved = glb.floats(kept as usize, 3).unwrap();
        assert_eq!(moved.iter().filter(|x| **x != 0.0).count(), 1);
        let (old, now) = (&file.json["extensions"], &glb.json["extensions"]);
        let groups = |json: &Value| json["VRM"]["blendShapeMaster"]["blendShapeGroups"].clone();
        assert_eq!(groups(now)[0], groups(old)[0]);
        assert_eq!(groups(now)[1], groups(old)[1]);
        assert_eq!(groups(now)[2]["name"], "JawOpen");
        assert_eq!(
            groups(now)[2]["binds"],
            json!([{"mesh": 0, "index": 1, "weight": 100.0}])
        );
        assert_eq!(groups(now).as_array().unwrap().len(), 3);
        let expressions = |json: &Value| json["VRMC_vrm"]["expressions"].clone();
        assert_eq!(expressions(now)["preset"], expressions(old)["preset"]);
        assert_eq!(
            expressions(now)["custom"]["JawOpen"]["morphTargetBinds"],
            json!([{"node": 0, "index": 1, "weight": 1.0}])
        );
        assert_eq!(
            expressions(now)["custom"]["CheekPuff"]["morphTargetBinds"][0]["index"],
            2
        );
    }

    #[test]
    fn visemes_become_an_avatar_s_preset_mouth_shapes_where_it_has_none_that_move() {
        let bind = json!({"mesh": 0, "index": 0, "weight": 100.0});
        let own = json!({"morphTargetBinds": [{"node": 0, "index": 0, "weight": 1.0}]});
        let file = extended(json!({
            "VRM": {"blendShapeMaster": {"blendShapeGroups": [
                {"name": "A", "presetName": "a", "binds": [bind]},
                {"name": "I", "presetName": "i", "binds": []},
            ]}},
            "VRMC_vrm": {"specVersion": "1.0", "expressions": {"preset": {"aa": own, "ih": {}}}},
        }));
        let (_, foreign) = Foreign::read(Glb::parse(&file.emit()).unwrap()).unwrap();
        let new = ["aa", "ih", "ou", "E", "oh", "PP"].map(|v| format!("viseme_{v}"));
        let new = new.map(|name| shape(&name, 25, 7, Vec3::z()));
        let json = Glb::parse(&foreign.patched(&new, false).emit())
            .unwrap()
            .json;
        let groups = &json["extensions"]["VRM"]["blendShapeMaster"]["blendShapeGroups"];
        let bound = |preset: &str| {
            let mut of_preset = list(groups).iter().filter(|g| g["presetName"] == preset);
            let group = of_preset.next().unwrap();
            assert!(of_preset.next().is_none(), "{preset}");
            group["binds"][0]["index"].clone()
        };
        // The first target is the avatar's own.
        assert_eq!(
            ["a", "i", "u", "e", "o"].map(bound),
            [0, 2, 3, 4, 5].map(Value::from)
        );
        let preset = &json["extensions"]["VRMC_vrm"]["expressions"]["preset"];
        let bound = |name: &str| preset[name]["morphTargetBinds"][0]["index"].clone();
        assert_eq!(
            ["aa", "ih", "ou", "ee", "oh"].map(bound),
            [0, 2, 3, 4, 5].map(Value::from)
        );
    }

    #[test]
    fn files_without_triangles_inside_are_refused() {
        let empty = json!({"asset": {"version": "2.0"}, "buffers": [{"byteLength": 0}]});
        let glb = |json: Value| Glb {
            json,
            bin: Vec::new(),
        };
        assert!(Foreign::read(glb(empty)).is_err());
    }

    /// Every place in a description, as a path.
    fn paths(json: &Value, at: &str, all: &mut Vec<String>) {
        all.push(at.to_owned());
        let mut inside = |key: &str, inner| paths(inner, &format!("{at}/{key}"), all);
        match json {
            Value::Object(map) => map.iter().for_each(|(key, inner)| inside(key, inner)),
            Value::Array(list) => {
                let numbered = list.iter().enumerate();
                numbered.for_each(|(k, inner)| inside(&k.to_string(), inner));
            }
            _ => {}
        }
    }

    /// A small avatar with everything that is looked at.
    fn avatar() -> Glb {
        extended(json!({
            "VRM": {"blendShapeMaster": {"blendShapeGroups": [{"name": "A", "binds": []}]}},
            "VRMC_vrm": {"expressions": {"preset": {"aa": {}}, "custom": {"b": {}}}},
        }))
    }

    /// A sheet with one shape and these extensions.
    fn extended(extensions: Value) -> Glb {
        let shape = shape("mouthA", 25, 3, Vec3::x());
        let mut file = build(&sheet(5, 0.1), &[shape], 1.0, false, None);
        file.json["extensions"] = extensions;
        file
    }

    #[test]
    fn whatever_type_a_value_has_it_is_carried_through_or_refused() {
        let file = avatar();
        let mut all = Vec::new();
        paths(&file.json, "", &mut all);
        assert!(all.len() > 100);
        let new = [shape("jawOpen", 25, 7, Vec3::z())];
        let odd = json!([null, true, -1, 5, 1.5e300, 1_000_000_000_000_000_000_u64, "x", [], [1], {}, {"a": [1]}]);
        let (mut carried, mut refused) = (0, 0);
        for path in &all {
            for value in odd.as_array().unwrap() {
                let mut json = file.json.clone();
                *json.pointer_mut(path).unwrap() = value.clone();
                let glb = Glb {
                    json,
                    bin: file.bin.clone(),
                };
                let Ok(glb) = Glb::parse(&glb.emit()) else {
                    refused += 1;
                    continue;
                };
                match Foreign::read(glb) {
                    Ok((mesh, foreign)) if mesh.positions.len() == 25 => {
                        drop(foreign.patched(&new, false).emit());
                        carried += 1;
                    }
                    Ok(_) => {}
                    Err(_) => refused += 1,
                }
            }
        }
        assert!(
            carried > 100 && refused > 100,
            "{carried} carried, {refused} refused"
        );
    }

    #[test]
    fn extras_of_any_type_stay_and_what_cannot_be_added_to_is_refused() {
        let new = [shape("jawOpen", 25, 7, Vec3::z())];
        for extras in [json!("by hand"), json!([1])] {
            let mut file = avatar();
            file.json["meshes"][0]["extras"] = extras.clone();
            file.json["meshes"][0]["primitives"][0]["extras"] = extras.clone();
            let (_, foreign) = Foreign::read(file).unwrap();
            let json = foreign.patched(&new, false).json;
            let mesh = &json["meshes"][0];
            for now in [&mesh["extras"], &mesh["primitives"][0]["extras"]] {
                assert_eq!(now["extras"], extras);
                assert_eq!(now["targetNames"][1], "jawOpen");
            }
        }
        for (path, word) in [
            ("/extensions/VRM/blendShapeMaster", "blendShapeMaster"),
            ("/extensions/VRMC_vrm/expressions", "expressions"),
        ] {
            let mut file = avatar();
            *file.json.pointer_mut(path).unwrap() = json!("x");
            let text = Foreign::read(file).err().expect(word).to_string();
            assert!(text.contains(word), "{text}");
        }
    }

    #[test]
    fn what_a_file_claims_beyond_its_size_is_refused_before_it_is_made() {
        let claims = |count: u64, targets: usize| {
            let bin: Vec<u8> = [[0.0_f32; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
                .into_iter()
                .flatten()
                .flat_map(f32::to_le_bytes)
                .collect();
            let accessor = |view: Value, count: u64| json!({"bufferView": view, "componentType": 5126, "count": count, "type": "VEC3"});
            let mut accessors = vec![accessor(json!(0), 3)];
            accessors.extend((0..targets).map(|_| accessor(Value::Null, count)));
            let targets: Vec<Value> = (1..=targets).map(|k| json!({"POSITION": k})).collect();
            Glb {
                json: json!({
                    "asset": {"version": "2.0"},
                    "buffers": [{"byteLength": bin.len()}],
                    "bufferViews": [{"buffer": 0, "byteLength": bin.len()}],
                    "accessors": accessors,
                    "meshes": [{"primitives": [
                        {"attributes": {"POSITION": 0}, "targets": targets},
                        {"mode": 0, "attributes": {"POSITION": 1}},
                    ]}],
                }),
                bin,
            }
        };
        // As many as there are vertices is what our own files have for targets that move nothing.
        assert_eq!(claims(3, 1).floats(1, 3).unwrap(), [0.0; 9]);
        for count in [4, 50_000_000, 1_000_000_000_000_000_000] {
            assert!(claims(count, 1).floats(1, 3).is_err(), "{count}");
            assert!(Foreign::read(claims(count, 1)).is_err(), "{count}");
        }
        // The same data over and over.
        let mut again = claims(3, 1);
        let primitive = json!({"attributes": {"POSITION": 0}});
        again.json["meshes"][0]["primitives"] = Value::Array(vec![primitive; 60_000]);
        assert!(Foreign::read(again).is_err());
    }
}
