//! Renderings of a mesh: shaded from the front, at an angle and from the side; of a GLB also each morph target at
//! weight 1.
//!
//! The mesh is scaled to the image, with y up and z towards the viewer, as in OBJ and glTF heads. A GLB is read as
//! `bake` reads it.

use image::RgbImage;
use nalgebra::Rotation3;

use super::album::Album;
use mien_baking::bake::glb::{Glb, unexpected};
use mien_baking::bake::mesh::{Mesh, Vec3, bounding_box};
use mien_baking::bake::obj;
use mien_baking::bake::patch::{ImportedGltf, position};
use mien_baking::bake::render::paint;
use mien_workbench::fault::Fault;

const SIZE: u32 = 420;
/// Grey of a surface that faces the lamp.
const GREY: [f64; 3] = [235.0, 235.0, 223.0];

/// Renders the mesh with its vertices at `moved`, rotated by `yaw`, radians. The neutral mesh sets the scale.
fn draw(mesh: &Mesh, moved: &[Vec3], yaw: f64) -> RgbImage {
    let (low, high) = bounding_box(&mesh.positions);
    let turn = Rotation3::from_axis_angle(&Vec3::y_axis(), yaw);
    let middle = turn * ((low + high) * 0.5);
    let height = (high - low).max().max(f64::MIN_POSITIVE) / 0.94;
    let seen: Vec<Vec3> = moved.iter().map(|v| turn * v).collect();
    paint(mesh, &seen, &middle, height, SIZE, None, |_, _| Some(GREY)).image
}

/// Reads an OBJ and draws it.
pub(super) fn inspect(name: &str, text: &str) -> Result<Album, Fault> {
    Ok(views(name, &obj::parse(text)?))
}

/// Three views of a mesh.
fn views(name: &str, mesh: &Mesh) -> Album {
    let mut album = Album::new(format!("Mesh {name}"));
    album.fact("vertices", mesh.positions.len().to_string());
    album.fact("triangles", mesh.fans().count().to_string());
    for (name, yaw) in [("front", 0), ("three-quarter", -40), ("side", -90)] {
        let picture = draw(mesh, &mesh.positions, f64::from(yaw).to_radians());
        album.pictures.push((name.into(), picture));
    }
    album
}

/// A morph target: name, driving unit, and displacement of each vertex.
struct Target {
    name: String,
    unit: String,
    moves: Vec<Vec3>,
}

/// Most bytes of all displacements together: 67 of a mesh of a million vertices.
const MAX_TARGET_BYTES: usize = (67 * 12) << 20;

/// The morph targets of a file, merged by name.
fn targets(imported: &ImportedGltf, vertices: usize) -> Result<Vec<Target>, Fault> {
    let glb = &imported.glb;
    // Several targets may share data.
    let mut left = glb.budget();
    let too_much = |found: String| unexpected("targets that fit into the file's size", found);
    let mut targets: Vec<Target> = Vec::new();
    for shape in glb.json["meshes"].as_array().into_iter().flatten() {
        let extras = &shape["extras"];
        let mut seen = Vec::new();
        for primitive in shape["primitives"].as_array().into_iter().flatten() {
            let Some(position) = position(primitive) else {
                continue;
            };
            let rows = imported.position_rows(position);
            // Materials may share vertices.
            let Some(rows) = rows.filter(|_| !seen.contains(&position)) else {
                continue;
            };
            seen.push(position);
            let listed = primitive["targets"].as_array().into_iter().flatten();
            for (k, target) in listed.enumerate() {
                let name = extras["targetNames"][k].as_str();
                let name = name.map_or_else(|| k.to_string(), str::to_owned);
                let known = targets.iter().position(|known| known.name == name);
                let at = known.unwrap_or(targets.len());
                if known.is_none() {
                    if (at + 1) * 12 * vertices > MAX_TARGET_BYTES {
                        return Err(too_much(format!("more than {at}")));
                    }
                    let unit = extras["mien"]["units"][k].as_str().unwrap_or_default();
                    targets.push(Target {
                        name,
                        unit: unit.to_owned(),
                        moves: vec![Vec3::zeros(); vertices],
                    });
                }
                let Some(accessor) = target["POSITION"].as_u64() else {
                    continue;
                };
                let shared = || too_much("more, because several targets use the same data".into());
                let used = 12 * glb.count(accessor as usize)?;
                left = left.checked_sub(used).ok_or_else(shared)?;
                let moves = glb.floats(accessor as usize, 3)?;
                for (vertex, way) in rows.placed(&moves) {
                    targets[at].moves[vertex] = way;
                }
            }
        }
    }
    Ok(targets)
}

/// Reads a GLB and draws it with each of its morph targets.
pub(super) fn inspect_glb(name: &str, bytes: &[u8]) -> Result<Album, Fault> {
    let (mesh, imported) = ImportedGltf::read(Glb::parse(bytes)?)?;
    let targets = targets(&imported, mesh.positions.len())?;
    let mut album = views(name, &mesh);
    album.fact("morph targets", targets.len().to_string());
    if !targets.is_empty() {
        album.header(["morph target", "unit", "vertices moved", "largest, mm"]);
    }
    for Target { name, unit, moves } in targets {
        let moved = moves.iter().filter(|d| **d != Vec3::zeros()).count();
        let largest = moves.iter().map(Vec3::norm).fold(0.0, f64::max);
        let largest = format!("{:.2}", largest * 1e3);
        let row = [name.clone(), unit, moved.to_string(), largest];
        album.table.push(row.to_vec());
        let places = mesh.positions.iter().zip(&moves).map(|(v, d)| v + d);
        let picture = draw(&mesh, &places.collect::<Vec<_>>(), 0.0);
        album.pictures.push((name, picture));
    }
    Ok(album)
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_baking::heads::{default_head, hero::Hero};

    #[test]
    fn a_baked_head_is_shown_with_its_targets() {
        let head = default_head::glb(&Hero::shipped()).unwrap();
        let album = inspect_glb("head.glb", &head).unwrap();
        assert_eq!((album.pictures.len(), album.table.len()), (3 + 67, 1 + 67));
        let jaw = album.table.iter().find(|row| row[0] == "jawOpen").unwrap();
        assert_eq!(jaw[1], "AU26");
        let picture = |name: &str| &album.pictures.iter().find(|(n, _)| n == name).unwrap().1;
        assert!(picture("jawOpen") != picture("front"));
        assert!(inspect_glb("head.glb", &head[..5000]).is_err());
    }

    #[test]
    fn a_square_is_drawn_and_a_broken_face_is_refused() {
        let square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1 4/1\n";
        let album = inspect("s.obj", square).unwrap();
        let front = &album.pictures[0].1;
        // Facing the viewer, slightly off the lamp; nothing at the corner.
        assert_eq!(front.get_pixel(SIZE / 2 + 3, SIZE / 2 - 5).0[0], 209);
        assert_eq!(front.get_pixel(2, 2).0, [38, 40, 44]);
        for broken in [
            "v 0 0 nan\n",
            "v 0 0 0\nf 1 1 9\n",
            "v 0 0 0\nf 1 1\n",
            "hello\n",
        ] {
            assert!(inspect("s.obj", broken).is_err(), "{broken}");
        }
    }

    #[test]
    fn targets_beyond_what_the_file_accounts_for_are_refused() {
        let refused = |vertices: usize, targets: usize| {
            let accessor = serde_json::json!({"bufferView": 0, "componentType": 5126, "count": vertices, "type": "VEC3"});
            let targets = vec![serde_json::json!({"POSITION": 0}); targets];
            let places = (0..3 * vertices).map(|k| (k % 997) as f32);
            let glb = Glb {
                json: serde_json::json!({
                    "bufferViews": [{"buffer": 0, "byteLength": 12 * vertices}],
                    "accessors": [accessor],
                    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "targets": targets}]}],
                }),
                bin: places.flat_map(f32::to_le_bytes).collect(),
            };
            let read = ImportedGltf::read(glb);
            let all =
                read.and_then(|(mesh, imported)| super::targets(&imported, mesh.positions.len()));
            all.err().map(|problem| problem.to_string())
        };
        assert_eq!(refused(3, 1024), None);
        // Three hundred large ones sharing data, and more than the limit.
        let large = refused(120_000, 300).expect("refused");
        assert!(large.contains("fit into the file's size"), "{large}");
        let many = refused(3, 1025).expect("refused");
        assert!(many.contains("at most 1024"), "{many}");
    }
}
