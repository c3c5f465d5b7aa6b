//! A mesh as pictures: shaded from the front, at an angle and from the side; of a GLB also each morph target at weight 1.
//!
//! The mesh is scaled to the picture and taken as y up, z towards the viewer, as OBJ and glTF heads are. Of a GLB positions are
//! taken as stored, before node transforms.

use std::path::Path;

use image::RgbImage;
use nalgebra::Rotation3;

use super::album::{Album, name_of};
use super::error::InspectError;
use crate::studio::bake::glb::{Glb, GlbError};
use crate::studio::bake::mesh::{Corner, Mesh, Vec3};
use crate::studio::bake::obj;
use crate::studio::bake::render::paint;

const SIZE: u32 = 420;
/// Grey of what faces the lamp.
const GREY: [f64; 3] = [235.0, 235.0, 223.0];

/// The mesh turned, or in another form of it: `moved` has as many vertices. The neutral one sets the scale.
fn draw(mesh: &Mesh, moved: &[Vec3], yaw: f64) -> RgbImage {
    let bound =
        |of: fn(&Vec3, &Vec3) -> Vec3| mesh.positions.iter().copied().reduce(|a, b| of(&a, &b));
    let low = bound(|a, b| a.inf(b)).unwrap_or_default();
    let high = bound(|a, b| a.sup(b)).unwrap_or_default();
    let turn = Rotation3::from_axis_angle(&Vec3::y_axis(), yaw);
    let middle = turn * ((low + high) * 0.5);
    let height = (high - low).max().max(f64::MIN_POSITIVE) / 0.94;
    let seen: Vec<Vec3> = moved.iter().map(|v| turn * v).collect();
    paint(mesh, &seen, &middle, height, SIZE, None, |_, _| Some(GREY)).image
}

/// Reads an OBJ and draws it.
pub(super) fn inspect(path: &Path, text: &str) -> Result<Album, InspectError> {
    let mesh = obj::parse(text).map_err(|source| InspectError::Mesh {
        path: path.into(),
        source,
    })?;
    Ok(views(path, &mesh))
}

/// Three views of a mesh.
fn views(path: &Path, mesh: &Mesh) -> Album {
    let mut album = Album {
        title: format!("Mesh {}", name_of(path)),
        ..Album::default()
    };
    album.fact("vertices", mesh.positions.len().to_string());
    album.fact("triangles", mesh.fans().count().to_string());
    for (name, yaw_deg) in [
        ("front", 0.0_f64),
        ("three-quarter", -40.0),
        ("side", -90.0),
    ] {
        let picture = draw(mesh, &mesh.positions, yaw_deg.to_radians());
        album.pictures.push((name.into(), picture));
    }
    album
}

/// A morph target: what it is called, what drives it, and how far it moves each vertex.
struct Target {
    name: String,
    unit: String,
    moves: Vec<Vec3>,
}

/// Morph targets that are drawn.
const TARGETS: usize = 1024;
/// Bytes that their rows may take: 67 of a mesh of a million vertices.
const LARGEST: usize = (67 * 12) << 20;

fn too_many(most: usize) -> GlbError {
    GlbError::Content {
        expected: "at most as many morph targets as can be drawn",
        found: format!("more than {most}"),
    }
}

/// The corners of a primitive's triangles, among its `count` vertices.
fn order(glb: &Glb, primitive: &serde_json::Value, count: usize) -> Result<Vec<u32>, GlbError> {
    let order: Vec<u32> = match primitive["indices"].as_u64() {
        Some(indices) => glb.indices(indices as usize)?,
        None => (0..count as u32).collect(),
    };
    if order.iter().any(|&k| k as usize >= count) {
        return Err(GlbError::Content {
            expected: "indices of existing vertices",
            found: format!("one beyond {count}"),
        });
    }
    Ok(order)
}

/// Adds triangles of vertices that are counted from `first`.
fn push_triangles(mesh: &mut Mesh, first: u32, order: &[u32]) {
    for t in order.chunks_exact(3) {
        let corner = |k: u32| Corner {
            vertex: first + k,
            uv: None,
            normal: None,
        };
        mesh.push_face(&[t[0], t[1], t[2]].map(corner), 0);
    }
}

/// Meshes and morph targets of a GLB as one.
fn read_glb(glb: &Glb) -> Result<(Mesh, Vec<Target>), GlbError> {
    let mut mesh = Mesh {
        materials: vec![String::new()],
        ..Mesh::default()
    };
    let mut targets: Vec<Target> = Vec::new();
    // Many targets may say they are of the same data, or of none.
    let left = std::cell::Cell::new(glb.budget());
    let rows = |accessor: u64| {
        let bytes = 12 * glb.count(accessor as usize)?;
        left.set(left.get().checked_sub(bytes).ok_or(GlbError::Content {
            expected: "targets that fit into the file's size",
            found: "more, from data used repeatedly".to_owned(),
        })?);
        let values = glb.floats(accessor as usize, 3)?;
        let rows = values
            .chunks_exact(3)
            .map(|v| Vec3::new(v[0].into(), v[1].into(), v[2].into()));
        Ok::<_, GlbError>(rows.collect::<Vec<_>>())
    };
    for shape in glb.json["meshes"].as_array().into_iter().flatten() {
        let names = &shape["extras"]["targetNames"];
        // Materials may share their vertices.
        let mut known: Vec<(u64, usize)> = Vec::new();
        for primitive in shape["primitives"].as_array().into_iter().flatten() {
            let Some(position) = primitive["attributes"]["POSITION"].as_u64() else {
                continue;
            };
            let known_at = known.iter().find(|(accessor, _)| *accessor == position);
            let first = match known_at {
                Some((_, first)) => *first,
                None => {
                    let first = mesh.positions.len();
                    mesh.positions.extend(rows(position)?);
                    known.push((position, first));
                    let listed = primitive["targets"].as_array().into_iter().flatten();
                    for (k, target) in listed.enumerate() {
                        let name = names[k]
                            .as_str()
                            .map_or_else(|| k.to_string(), str::to_owned);
                        let at = match targets.iter().position(|known| known.name == name) {
                            Some(at) => at,
                            None if targets.len() == TARGETS => return Err(too_many(TARGETS)),
                            None => {
                                let unit = shape["extras"]["mien"]["units"][k].as_str();
                                targets.push(Target {
                                    name,
                                    unit: unit.unwrap_or_default().to_owned(),
                                    moves: Vec::new(),
                                });
                                targets.len() - 1
                            }
                        };
                        if let Some(accessor) = target["POSITION"].as_u64() {
                            let moves = &mut targets[at].moves;
                            moves.resize(first, Vec3::zeros());
                            moves.extend(rows(accessor)?);
                        }
                    }
                    first
                }
            };
            let count = mesh.positions.len() - first;
            let order = order(glb, primitive, count)?;
            push_triangles(&mut mesh, first as u32, &order);
        }
    }
    // Each gets a row for every vertex.
    let bytes = targets.len().saturating_mul(12 * mesh.positions.len());
    if bytes > LARGEST {
        return Err(too_many(LARGEST / (12 * mesh.positions.len()).max(1)));
    }
    for target in &mut targets {
        target.moves.resize(mesh.positions.len(), Vec3::zeros());
    }
    Ok((mesh, targets))
}

/// Reads a GLB and draws it, and each of its morph targets.
pub(super) fn inspect_glb(path: &Path, bytes: &[u8]) -> Result<Album, InspectError> {
    let refuse = |source| InspectError::Glb {
        path: path.into(),
        source,
    };
    let glb = Glb::parse(bytes).map_err(refuse)?;
    let (mesh, targets) = read_glb(&glb).map_err(refuse)?;
    if mesh.faces() == 0 {
        return Err(refuse(GlbError::Content {
            expected: "triangles",
            found: "none".into(),
        }));
    }
    let mut album = views(path, &mesh);
    album.fact("morph targets", targets.len().to_string());
    if !targets.is_empty() {
        let header = ["morph target", "unit", "vertices moved", "largest, mm"];
        album.table.push(header.map(str::to_owned).to_vec());
    }
    for Target { name, unit, moves } in targets {
        let moved = moves.iter().filter(|d| **d != Vec3::zeros()).count();
        let largest = moves.iter().map(Vec3::norm).fold(0.0, f64::max);
        let figures = [moved.to_string(), format!("{:.2}", largest * 1e3)];
        album
            .table
            .push([name.clone(), unit].into_iter().chain(figures).collect());
        let places: Vec<Vec3> = mesh
            .positions
            .iter()
            .zip(&moves)
            .map(|(v, d)| v + d)
            .collect();
        album.pictures.push((name, draw(&mesh, &places, 0.0)));
    }
    Ok(album)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_baked_head_is_shown_with_its_targets() {
        let head = crate::studio::heads::default_head::glb().unwrap();
        let album = inspect_glb(Path::new("head.glb"), &head).unwrap();
        assert_eq!((album.pictures.len(), album.table.len()), (3 + 67, 1 + 67));
        let jaw = album.table.iter().find(|row| row[0] == "jawOpen").unwrap();
        assert_eq!(jaw[1], "AU26");
        let picture = |name: &str| &album.pictures.iter().find(|(n, _)| n == name).unwrap().1;
        assert!(picture("jawOpen") != picture("front"));
        assert!(inspect_glb(Path::new("head.glb"), &head[..5000]).is_err());
    }

    #[test]
    fn a_square_is_drawn_and_a_broken_face_is_refused() {
        let square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1 4/1\n";
        let album = inspect(Path::new("s.obj"), square).unwrap();
        let front = &album.pictures[0].1;
        // Facing the viewer, a little off the lamp; and nothing at the corner.
        assert_eq!(front.get_pixel(SIZE / 2 + 3, SIZE / 2 - 5).0[0], 209);
        assert_eq!(front.get_pixel(2, 2).0, [38, 40, 44]);
        for broken in [
            "v 0 0 nan\n",
            "v 0 0 0\nf 1 1 9\n",
            "v 0 0 0\nf 1 1\n",
            "hello\n",
        ] {
            assert!(inspect(Path::new("s.obj"), broken).is_err(), "{broken}");
        }
    }

    #[test]
    fn targets_beyond_what_the_file_accounts_for_are_refused() {
        let refused = |vertices: usize, targets: usize| {
            let accessor = serde_json::json!({"bufferView": 0, "componentType": 5126, "count": vertices, "type": "VEC3"});
            let targets = vec![serde_json::json!({"POSITION": 0}); targets];
            let glb = Glb {
                json: serde_json::json!({
                    "bufferViews": [{"buffer": 0, "byteLength": 12 * vertices}],
                    "accessors": [accessor],
                    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "targets": targets}]}],
                }),
                bin: vec![0; 12 * vertices],
            };
            read_glb(&glb).err().map(|problem| problem.to_string())
        };
        assert_eq!(refused(3, 1024), None);
        // Three hundred large ones, all of the same data; and more than anybody draws.
        let large = refused(120_000, 300).expect("refused");
        assert!(large.contains("fit into the file's size"), "{large}");
        let many = refused(3, 1025).expect("refused");
        assert!(many.contains("more than 1024"), "{many}");
    }
}
