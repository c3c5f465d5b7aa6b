//! Heads in binary glTF (also VRM): the skin is read for baking, and shapes are added to the file
//! ([`super::targets`]).
//!
//! All triangles of all meshes are combined; duplicates of a vertex at a seam are welded and move alike, so that
//! seams stay closed ([`super::weld`]). Landmarks count the vertices of the POSITION accessors in the order of their
//! first use. Materials, textures, skeletons, animations, targets and face order stay unchanged.
//!
//! Vertices are placed by their nodes ([`super::scene`]).
//!
//! Units: the file's own (metres by the standard). Limits: no compressed or quantised positions.

use std::collections::HashMap;

use nalgebra::{Matrix3, Matrix4, Point3};
use serde_json::{Value, json};

use super::glb::{FLOAT, Glb, list, unexpected};
use super::looks::material_names;
use super::mesh::{Corner, Mesh, Vec3};
use super::morphs::single;
use super::scene::placed;
use super::vrm::{add_expressions_to, beginning};
use super::weld::{faces, welded};
use mien_workbench::fault::Fault;

/// Bytes per row or corner while reading: position, number, edges.
const ROW_BYTES: usize = 64;
/// Most primitives of a file, each of which gets all shapes.
const MAX_PRIMITIVES: usize = 4096;
/// Most targets that a mesh may already have.
const MAX_TARGETS: usize = 1024;

/// A head read from glTF, and the mapping of its vertices.
pub struct ImportedGltf {
    /// The file.
    pub glb: Glb,
    sources: Vec<Rows>,
    /// Number of inward triangles in the file, turned in the mesh.
    pub(crate) turned: usize,
}

/// The rows of a position accessor.
pub struct Rows {
    accessor: usize,
    /// Index of the first one among all rows.
    first: usize,
    /// Vertex of the mesh for each row.
    pub(super) vertices: Vec<u32>,
    /// From displacements in the scene to those in the file, where a node rotates or scales.
    pub(super) back: Option<Matrix3<f64>>,
}

/// Rows of all position accessors, and the triangles between them.
#[derive(Default)]
struct Gathered {
    places: Vec<[f32; 3]>,
    /// Per row; empty if no mesh has any.
    uv: Vec<[f32; 2]>,
    tints: Vec<[f32; 3]>,
    sources: Vec<Rows>,
    triangles: Vec<[u32; 3]>,
    /// Source and material of each triangle.
    parts: Vec<u32>,
    materials: Vec<Option<u64>>,
}

impl Gathered {
    fn read(glb: &Glb) -> Result<Self, Fault> {
        let mut all = Self::default();
        // Several accessors may refer to the same data.
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
            // Also for lines and points, which get empty targets.
            let count = glb.count(accessor)?;
            let mode = primitive["mode"].as_u64().unwrap_or(TRIANGLES);
            if mode < TRIANGLES {
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
            for t in cut(mode, &order) {
                all.triangles.push(t.map(|k| first + k));
                all.parts.push(at as u32);
                all.materials.push(primitive["material"].as_u64());
            }
        }
        Ok(all)
    }

    /// Appends the rows of an accessor, transformed by `placed`.
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
        // Damage here costs only colours.
        let of_corners = |name: &str, width: usize| {
            let description = glb.list_entry("accessors", &attributes[name]);
            let width = width + usize::from(description["type"] == "VEC4");
            let accessor = attributes[name].as_u64()? as usize;
            let rows = glb.floats(accessor, width).ok()?;
            let fits = description["count"] == count && rows.iter().all(|x| x.is_finite());
            fits.then_some((rows, width))
        };
        if let Some((rows, width)) = of_corners("TEXCOORD_0", 2) {
            self.uv.resize(first, [0.0; 2]);
            // glTF counts v from the top.
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

    /// Turns inward triangles; returns their number.
    fn turn_outward(&mut self) -> usize {
        let place = |p: &[f32; 3]| Vec3::from(p.map(f64::from));
        let mut mesh = Mesh {
            positions: self.places.iter().map(place).collect(),
            ..Mesh::default()
        };
        for t in &self.triangles {
            mesh.push_face(&t.map(Corner::bare), 0);
        }
        let turned = mesh.turn_outward();
        let corners = mesh.corners.as_chunks().0.iter();
        self.triangles = corners.map(|t| t.map(|c| c.vertex)).collect();
        turned
    }

    /// Builds the mesh with these material names, and maps the sources' rows to its vertices.
    fn mesh(&mut self, names: &[String]) -> Mesh {
        let same = welded(&self.places, &self.triangles, &self.parts);
        let mut mesh = Mesh::default();
        // Vertices are numbered at their first use.
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
            // One triangle, or two consecutive ones.
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
    /// Vertices of the mesh and their displacements by `moves`, the accessor's rows.
    pub fn placed(&self, moves: &[f32]) -> impl Iterator<Item = (usize, Vec3)> {
        let turn = self.back.and_then(|back| back.try_inverse());
        let rows = self.vertices.iter().zip(moves.chunks_exact(3));
        rows.map(move |(&vertex, row)| {
            let way = Vec3::new(row[0].into(), row[1].into(), row[2].into());
            (vertex as usize, turn.map_or(way, |turn| turn * way))
        })
    }
}

impl ImportedGltf {
    /// Reads the meshes of a file as one, with the mapping back.
    ///
    /// # Errors
    /// If it has no triangles, or data that are compressed, external or damaged.
    pub fn read(glb: Glb) -> Result<(Mesh, Self), Fault> {
        is_plain(&glb.json)?;
        can_be_added_to(&glb.json)?;
        let mut gathered = Gathered::read(&glb)?;
        let odd = |p: &&[f32; 3]| p.iter().any(|x| !x.is_finite());
        let odd = gathered.places.iter().filter(odd).count();
        if odd > 0 {
            let found = format!("{odd} with NaN or infinity; delete these vertices");
            return Err(unexpected("vertices at finite positions", found));
        }
        if gathered.triangles.is_empty() {
            let found = "points and lines alone; export the head with its faces";
            return Err(unexpected("triangles, or strips or fans of them", found));
        }
        let turned = gathered.turn_outward();
        let mesh = gathered.mesh(&material_names(&glb.json));
        let sources = gathered.sources;
        let imported = Self {
            glb,
            sources,
            turned,
        };
        Ok((mesh, imported))
    }

    /// From the scene to (right, up, towards the viewer): glTF faces along z, VRM 0 against it.
    pub(super) fn front(&self) -> Matrix3<f64> {
        let back = self.glb.json["extensions"]["VRM"].is_object();
        let along = if back { -1.0 } else { 1.0 };
        Matrix3::from_diagonal(&Vec3::new(along, 1.0, along))
    }

    /// Vertex of the mesh for each number of a landmark file.
    fn numbered(&self) -> Vec<u64> {
        let all = self.sources.iter().flat_map(|s| &s.vertices);
        all.map(|&v| u64::from(v)).collect()
    }

    /// Vertices of the mesh from numbers of a landmark file; unknown numbers stay out of range.
    pub fn landmarks(&self, numbers: &[u64]) -> Vec<u64> {
        let all = self.numbered();
        let vertex = |&k: &u64| all.get(k as usize).copied();
        let beyond = |k: &u64| (*k).max(u64::from(u32::MAX));
        let known = |k| vertex(k).unwrap_or_else(|| beyond(k));
        numbers.iter().map(known).collect()
    }

    /// The first landmark-file number of each of these vertices.
    pub fn rows(&self, vertices: &[u64]) -> Vec<u64> {
        let all = self.numbered();
        let row = |v: &u64| all.iter().position(|o| o == v);
        let known = |v: &u64| row(v).map_or(*v, |row| row as u64);
        vertices.iter().map(known).collect()
    }

    /// The rows of a position accessor, if it was read.
    pub fn position_rows(&self, accessor: usize) -> Option<&Rows> {
        self.sources.iter().find(|s| s.accessor == accessor)
    }
}

/// Primitive mode of triangles in glTF: below are points and lines, above strips and fans.
const TRIANGLES: u64 = 4;

/// The triangles of a primitive, from its vertices in order.
fn cut(mode: u64, order: &[u32]) -> Vec<[u32; 3]> {
    let all: Vec<[u32; 3]> = match mode {
        TRIANGLES => return order.as_chunks().0.to_vec(),
        5 => {
            let odd = |(k, t): (usize, &[u32])| [t[0], t[1 + k % 2], t[2 - k % 2]];
            order.windows(3).enumerate().map(odd).collect()
        }
        _ => order
            .windows(2)
            .skip(1)
            .map(|t| [t[0], t[1], order[0]])
            .collect(),
    };
    // Strips restart by triangles without area.
    let apart = |[a, b, c]: &[u32; 3]| a != b && b != c && a != c;
    all.into_iter().filter(apart).collect()
}

/// The accessor of a primitive's positions.
pub fn position(primitive: &Value) -> Option<usize> {
    let accessor = primitive["attributes"]["POSITION"].as_u64();
    accessor.map(|accessor| accessor as usize)
}

/// Extensions that encode positions.
const PACKED: [&str; 3] = [
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_draco_mesh_compression",
];

/// Checks that positions are plain; the error names the extension.
fn is_plain(json: &Value) -> Result<(), Fault> {
    let is_float = |accessor: usize| json["accessors"][accessor]["componentType"] == FLOAT;
    let used = list(&json["extensionsUsed"]).iter();
    let mut used = used.filter_map(Value::as_str);
    let packed = used.find(|&name| match name {
        // Often only for normals and texture coordinates.
        "KHR_mesh_quantization" => !primitives(json).filter_map(position).all(is_float),
        _ => PACKED.contains(&name),
    });
    packed.map_or(Ok(()), |name| {
        let undo = "undo it with: npx @gltf-transform/cli dequantize packed.glb plain.glb";
        let found = format!("{name}; {undo}");
        Err(unexpected("positions that are not compressed", found))
    })
}

/// Checks the types of everything that shapes are added to, before the solve.
fn can_be_added_to(json: &Value) -> Result<(), Fault> {
    let refuse = |expected, found: &Value| Err(unexpected(expected, beginning(found)));
    for primitive in primitives(json) {
        if !primitive.is_object() {
            return refuse("primitives that are objects", primitive);
        }
        let targets = list(&primitive["targets"]).len();
        if targets > MAX_TARGETS {
            return refuse("at most 1024 morph targets of a mesh", &json!(targets));
        }
    }
    let count = primitives(json).count();
    if count > MAX_PRIMITIVES {
        return refuse("at most 4096 primitives", &json!(count));
    }
    add_expressions_to(json)
}

fn primitives(json: &Value) -> impl Iterator<Item = &Value> {
    let meshes = list(&json["meshes"]).iter();
    meshes.flat_map(|mesh| list(&mesh["primitives"]))
}

#[cfg(test)]
mod tests {
    use super::super::mesh::tests::sheet;
    use super::super::morphs::build;
    use super::super::shape::Shape;
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
    fn textures_count_from_the_top_in_gltf_and_from_the_bottom_in_a_mesh() {
        let mut mesh = sheet(3, 0.1);
        mesh.uv = vec![[0.25, 0.125]];
        for corner in &mut mesh.corners {
            corner.uv = Some(0);
        }
        let shapes = [shape("some", 9, 3, Vec3::x())];
        let glb = Glb::parse(&build(&mesh, &shapes, 1.0, true, None).emit()).unwrap();
        let attributes = &glb.json["meshes"][0]["primitives"][0]["attributes"];
        let written = glb.floats(attributes["TEXCOORD_0"].as_u64().unwrap() as usize, 2);
        assert!(written.unwrap().chunks(2).all(|at| *at == [0.25, 0.875]));
        let (read, _) = ImportedGltf::read(glb).unwrap();
        let place =
            |corner: &super::super::mesh::Corner| read.uv[corner.uv.expect("a place") as usize];
        assert!(
            read.corners
                .iter()
                .all(|corner| place(corner) == [0.25, 0.125])
        );
    }

    #[test]
    fn vrm_0_faces_away_from_the_front_of_gltf() {
        for (back, along) in [(false, 1.0), (true, -1.0)] {
            let mut glb = build(&sheet(3, 0.1), &[], 1.0, false, None);
            if back {
                glb.json["extensions"]["VRM"] = serde_json::json!({});
            }
            let (_, imported) = ImportedGltf::read(Glb::parse(&glb.emit()).unwrap()).unwrap();
            assert_eq!(
                imported.front() * Vec3::new(1.0, 2.0, 3.0),
                Vec3::new(along, 2.0, 3.0 * along)
            );
        }
    }

    #[test]
    fn shapes_join_those_a_file_has_and_namesakes_keep_their_numbers() {
        let sheet = sheet(5, 0.1);
        let old = [
            shape("keep", 25, 3, Vec3::x()),
            shape("jawOpen", 25, 4, Vec3::y()),
        ];
        let mut file = build(&sheet, &old, 1.0, false, None);
        // As others write it.
        file.json["meshes"][0]["extras"]["mien"] = Value::Null;
        let before = file.json["materials"].clone();
        let (mesh, imported) = ImportedGltf::read(Glb::parse(&file.emit()).unwrap()).unwrap();
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
        let glb = Glb::parse(&imported.patched(&mesh, &new, false).emit()).unwrap();
        assert_eq!(glb.json["materials"], before);
        let head = &glb.json["meshes"][0];
        assert_eq!(
            head["extras"]["targetNames"],
            json!(["keep", "jawOpen.original", "jawOpen", "eyeBlinkLeft"])
        );
        assert_eq!(head["weights"].as_array().unwrap().len(), 4);
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
        assert_eq!(read(1), [[0.0, 1.0, 0.0]]);
        assert_eq!(read(2), [[0.0, 0.0, 1.0]]);
        assert_eq!(read(3), [[0.0, 0.0, 1.0]]);
    }

    #[test]
    fn earlier_bakes_are_replaced_and_foreign_names_recognised_in_any_spelling() {
        let with_unit = |name: &str, at: usize| Shape {
            unit: Some("AU26".into()),
            ..shape(name, 25, at, Vec3::x())
        };
        let old = [with_unit("blink.EyeBlink_L", 3), with_unit("jawOpen", 4)];
        let mut file = build(&sheet(5, 0.1), &old, 1.0, false, None);
        file.json["meshes"][0]["extras"]["mien"]["baked"][0] = Value::Null;
        let (mesh, imported) = ImportedGltf::read(file).unwrap();
        assert!(imported.has("eyeBlinkLeft"));
        assert!(!imported.has("jawOpen") && !imported.has("eyeBlinkRight"));
        let new = ["jawOpen", "eyeBlinkLeft"].map(|name| with_unit(name, 5));
        let again = imported.patched(&mesh, &new, false);
        let names = json!(["blink.EyeBlink_L.original", "jawOpen", "eyeBlinkLeft"]);
        assert_eq!(again.json["meshes"][0]["extras"]["targetNames"], names);
        let (_, imported) = ImportedGltf::read(again).unwrap();
        assert!(!imported.has("eyeBlinkLeft"));
    }

    #[test]
    fn animations_of_weights_get_as_many_as_there_are_targets() {
        let old = ["one", "two"].map(|name| shape(name, 25, 3, Vec3::x()));
        let mut file = build(&sheet(5, 0.1), &old, 1.0, false, None);
        let times = file.push_rows_with_bounds(&[[0.0], [1.0]], 0);
        let weights = file.push_rows(&[[0.1], [0.2], [0.3], [0.4]], 0);
        file.json["animations"] = json!([{
            "samplers": [{"input": times, "output": weights}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "weights"}}],
        }]);
        let (mesh, imported) = ImportedGltf::read(file).unwrap();
        let new = [shape("jawOpen", 25, 5, Vec3::x())];
        let glb = imported.patched(&mesh, &new, false);
        let output = &glb.json["animations"][0]["samplers"][0]["output"];
        let read = glb.floats(output.as_u64().unwrap() as usize, 1).unwrap();
        assert_eq!(read, [0.1, 0.2, 0.0, 0.3, 0.4, 0.0]);
    }

    #[test]
    fn normals_turn_with_the_surface_where_the_file_has_some() {
        let tilt = |mesh: &Mesh| Shape {
            name: "tilt".into(),
            displacement: mesh.positions.iter().map(|p| Vec3::z() * p.x).collect(),
            area: vec![true; mesh.positions.len()],
            ..Shape::default()
        };
        let flat = || {
            let mut mesh = sheet(5, 0.1);
            mesh.positions.iter_mut().for_each(|p| p.z = 0.0);
            build(&mesh, &[], 1.0, false, None)
        };
        let bent = |file: Glb| {
            let (mesh, imported) = ImportedGltf::read(file).unwrap();
            let glb = imported.patched(&mesh, &[tilt(&mesh)], false);
            let target = &glb.json["meshes"][0]["primitives"][0]["targets"][0];
            let at = target["NORMAL"].as_u64()?;
            Some(glb.floats(at as usize, 3).unwrap())
        };
        // By 45 degrees.
        let half = 0.5_f32.sqrt();
        let near = |read: &[f32], to: [f32; 3]| {
            let off = read
                .iter()
                .zip(to.iter().cycle())
                .map(|(a, b)| (a - b).abs());
            assert!(off.fold(0.0, f32::max) < 1e-5, "{read:?}");
        };
        near(&bent(flat()).unwrap(), [-half, 0.0, half - 1.0]);
        // Stored flatter than it is shown.
        let mut scaled = flat();
        scaled.json["nodes"][0]["scale"] = json!([2.0, 1.0, 1.0]);
        let slope = 2.0_f32.atan();
        near(
            &bent(scaled).unwrap(),
            [-slope.sin(), 0.0, slope.cos() - 1.0],
        );
        let mut without = flat();
        let attributes = &mut without.json["meshes"][0]["primitives"][0]["attributes"];
        attributes.as_object_mut().unwrap().remove("NORMAL");
        assert_eq!(bent(without), None);
    }

    #[test]
    fn strips_and_fans_are_triangles_and_what_is_none_is_named() {
        let mut sheet = sheet(2, 1.0);
        sheet.positions.iter_mut().for_each(|p| p.z = 0.0);
        let read = |mode: u64, order: &[u32]| {
            let mut file = build(&sheet, &[], 1.0, false, None);
            let indices = file.push_corners(order);
            let primitive = &mut file.json["meshes"][0]["primitives"][0];
            primitive["mode"] = mode.into();
            primitive["indices"] = indices.into();
            ImportedGltf::read(file)
        };
        // Rows are 0, 1, 3, 2 of the sheet.
        for (mode, order) in [
            (4, &[0, 1, 2, 0, 2, 3][..]),
            (5, &[0, 1, 3, 2]),
            (6, &[0, 1, 2, 3]),
        ] {
            let (mesh, imported) = read(mode, order).unwrap();
            assert_eq!((mesh.faces(), imported.turned), (1, 0), "{mode}");
            let up = mesh.vertex_normals(&mesh.positions);
            assert!(up.iter().all(|n| n.z > 0.5), "{mode}");
        }
        let lines = read(1, &[0, 1, 1, 2]).err().unwrap().to_string();
        assert!(lines.contains("points and lines alone"), "{lines}");
        let mut file = build(&sheet, &[], 1.0, false, None);
        file.bin[..4].copy_from_slice(&f32::NAN.to_le_bytes());
        let odd = ImportedGltf::read(file).err().unwrap().to_string();
        assert!(odd.contains("1 with NaN"), "{odd}");
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
        let (mesh, imported) = ImportedGltf::read(Glb::parse(&file.emit()).unwrap()).unwrap();
        let new = ["jawOpen", "cheekPuff"].map(|name| shape(name, 25, 7, Vec3::z()));
        let glb = Glb::parse(&imported.patched(&mesh, &new, false).emit()).unwrap();
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
        assert_eq!(groups(now)[1]["name"], "cheekpuff.original");
        assert_eq!(groups(now)[1]["binds"], groups(old)[1]["binds"]);
        assert_eq!(groups(now)[2]["name"], "JawOpen");
        assert_eq!(
            groups(now)[2]["binds"],
            json!([{"mesh": 0, "index": 1, "weight": 100.0}])
        );
        assert_eq!(groups(now)[3]["name"], "CheekPuff");
        assert_eq!(groups(now).as_array().unwrap().len(), 4);
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
        let (mesh, imported) = ImportedGltf::read(Glb::parse(&file.emit()).unwrap()).unwrap();
        let new = ["aa", "ih", "ou", "E", "oh", "PP"].map(|v| format!("viseme_{v}"));
        let new = new.map(|name| shape(&name, 25, 7, Vec3::z()));
        let json = Glb::parse(&imported.patched(&mesh, &new, false).emit())
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
    fn numbers_of_a_file_come_back_to_the_last_bit() {
        let mut random = fastrand::Rng::with_seed(7);
        for _ in 0..20_000 {
            let least = f64::from(random.f32() - 0.5);
            let text = json!({"min": [least]}).to_string();
            let read = super::super::glb::parse_json(text.as_bytes()).unwrap();
            assert_eq!(read["min"][0].as_f64(), Some(least));
        }
    }

    #[test]
    fn files_without_triangles_inside_are_refused() {
        let empty = json!({"asset": {"version": "2.0"}, "buffers": [{"byteLength": 0}]});
        let glb = |json: Value| Glb {
            json,
            bin: Vec::new(),
        };
        assert!(ImportedGltf::read(glb(empty)).is_err());
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

    /// A small avatar with every feature that is read.
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
    fn values_of_any_type_are_kept_or_refused() {
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
                match ImportedGltf::read(glb) {
                    Ok((mesh, imported)) if mesh.positions.len() == 25 => {
                        drop(imported.patched(&mesh, &new, false).emit());
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
            let (mesh, imported) = ImportedGltf::read(file).unwrap();
            let json = imported.patched(&mesh, &new, false).json;
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
            let text = ImportedGltf::read(file).err().expect(word).to_string();
            assert!(text.contains(word), "{text}");
        }
    }

    #[test]
    fn counts_beyond_the_size_of_a_file_are_refused_before_allocation() {
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
            assert!(ImportedGltf::read(claims(count, 1)).is_err(), "{count}");
        }
        // The same data over and over.
        let mut again = claims(3, 1);
        let primitive = json!({"attributes": {"POSITION": 0}});
        again.json["meshes"][0]["primitives"] = Value::Array(vec![primitive; 60_000]);
        assert!(ImportedGltf::read(again).is_err());
    }
}
