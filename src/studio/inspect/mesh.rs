//! A mesh as pictures: shaded from the front, at an angle and from the side; of a GLB also each morph target at weight 1.
//!
//! Orthographic, flat shading by the angle to the viewer, depth by a z-buffer. The mesh is scaled to the picture and taken
//! as y up, z towards the viewer, as OBJ and glTF heads are. Of a GLB positions are taken as stored, before node transforms.

use std::path::Path;

use image::RgbImage;
use nalgebra::{Rotation3, Vector3};

use super::album::{Album, name_of};
use super::error::InspectError;
use crate::studio::bake::glb::{Glb, GlbError};
use crate::studio::bake::obj::{self, ObjError};

const SIZE: u32 = 420;

struct Mesh {
    vertices: Vec<Vector3<f32>>,
    triangles: Vec<[usize; 3]>,
}

impl Mesh {
    fn of_obj(text: &str) -> Result<Self, ObjError> {
        let mesh = obj::parse(text)?;
        Ok(Self {
            vertices: mesh.positions.iter().map(|p| p.map(|v| v as f32)).collect(),
            triangles: mesh
                .fans()
                .map(|fan| fan.map(|corner| corner.vertex as usize))
                .collect(),
        })
    }

    /// The mesh turned, or in another form of it: `moved` has as many vertices. The neutral one sets the scale.
    fn draw(&self, moved: &[Vector3<f32>], yaw: f32) -> RgbImage {
        let low = self
            .vertices
            .iter()
            .copied()
            .reduce(|a, b| a.inf(&b))
            .unwrap_or_default();
        let high = self
            .vertices
            .iter()
            .copied()
            .reduce(|a, b| a.sup(&b))
            .unwrap_or_default();
        let (centre, scale) = (
            (low + high) * 0.5,
            0.94 * SIZE as f32 / (high - low).max().max(f32::MIN_POSITIVE),
        );
        let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), yaw);
        let placed: Vec<Vector3<f32>> = moved
            .iter()
            .map(|v| {
                let v = turn * (v - centre) * scale;
                Vector3::new(v.x + SIZE as f32 / 2.0, SIZE as f32 / 2.0 - v.y, v.z)
            })
            .collect();
        let mut picture = RgbImage::from_pixel(SIZE, SIZE, image::Rgb([255; 3]));
        let mut depth = vec![f32::NEG_INFINITY; (SIZE * SIZE) as usize];
        for &[a, b, c] in &self.triangles {
            let (a, b, c) = (placed[a], placed[b], placed[c]);
            let normal = (b - a).cross(&(c - a));
            let area = normal.z;
            if area.abs() < 1e-9 {
                continue;
            }
            let light = (normal.z.abs() / normal.norm()).powf(0.8);
            let grey = (60.0 + 175.0 * light) as u8;
            let bound = |low: f32, high: f32| {
                (
                    low.floor().max(0.0) as u32,
                    (high.ceil().max(0.0) as u32).min(SIZE - 1),
                )
            };
            let (x0, x1) = bound(a.x.min(b.x).min(c.x), a.x.max(b.x).max(c.x));
            let (y0, y1) = bound(a.y.min(b.y).min(c.y), a.y.max(b.y).max(c.y));
            for y in y0..=y1 {
                for x in x0..=x1 {
                    let (px, py) = (x as f32, y as f32);
                    let edge = |p: Vector3<f32>, q: Vector3<f32>| {
                        ((q.x - p.x) * (py - p.y) - (q.y - p.y) * (px - p.x)) / area
                    };
                    let (u, v, w) = (edge(b, c), edge(c, a), edge(a, b));
                    if u < 0.0 || v < 0.0 || w < 0.0 {
                        continue;
                    }
                    let z = u * a.z + v * b.z + w * c.z;
                    let place = (y * SIZE + x) as usize;
                    if z > depth[place] {
                        depth[place] = z;
                        picture.put_pixel(
                            x,
                            y,
                            image::Rgb([grey, grey, (grey as f32 * 0.95) as u8]),
                        );
                    }
                }
            }
        }
        picture
    }
}

/// Reads an OBJ and draws it.
pub(super) fn inspect(path: &Path, text: &str) -> Result<Album, InspectError> {
    let mesh = Mesh::of_obj(text).map_err(|source| InspectError::Mesh {
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
    album.fact("vertices", mesh.vertices.len().to_string());
    album.fact("triangles", mesh.triangles.len().to_string());
    for (name, yaw_deg) in [("front", 0.0f32), ("half", -40.0), ("side", -90.0)] {
        album
            .pictures
            .push((name.into(), mesh.draw(&mesh.vertices, yaw_deg.to_radians())));
    }
    album
}

/// A morph target: what it is called, what drives it, and how far it moves each vertex.
struct Target {
    name: String,
    unit: String,
    moves: Vec<Vector3<f32>>,
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

/// Meshes and morph targets of a GLB as one.
fn read_glb(glb: &Glb) -> Result<(Mesh, Vec<Target>), GlbError> {
    let mut mesh = Mesh {
        vertices: Vec::new(),
        triangles: Vec::new(),
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
            .map(|v| Vector3::new(v[0], v[1], v[2]));
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
                    let first = mesh.vertices.len();
                    mesh.vertices.extend(rows(position)?);
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
                            moves.resize(first, Vector3::zeros());
                            moves.extend(rows(accessor)?);
                        }
                    }
                    first
                }
            };
            let count = mesh.vertices.len() - first;
            let order = order(glb, primitive, count)?;
            let corners = order.chunks_exact(3);
            mesh.triangles
                .extend(corners.map(|t| [t[0], t[1], t[2]].map(|k| first + k as usize)));
        }
    }
    // Each gets a row for every vertex.
    let bytes = targets.len().saturating_mul(12 * mesh.vertices.len());
    if bytes > LARGEST {
        return Err(too_many(LARGEST / (12 * mesh.vertices.len()).max(1)));
    }
    for target in &mut targets {
        target.moves.resize(mesh.vertices.len(), Vector3::zeros());
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
    if mesh.triangles.is_empty() {
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
        let moved = moves.iter().filter(|d| **d != Vector3::zeros()).count();
        let largest = moves.iter().map(Vector3::norm).fold(0.0, f32::max);
        let figures = [moved.to_string(), format!("{:.2}", largest * 1e3)];
        album
            .table
            .push([name.clone(), unit].into_iter().chain(figures).collect());
        let places: Vec<Vector3<f32>> = mesh
            .vertices
            .iter()
            .zip(&moves)
            .map(|(v, d)| v + d)
            .collect();
        album.pictures.push((name, mesh.draw(&places, 0.0)));
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
        assert_eq!(front.get_pixel(SIZE / 2 + 3, SIZE / 2 - 5).0[0], 235);
        assert_eq!(front.get_pixel(2, 2).0, [255; 3]);
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
