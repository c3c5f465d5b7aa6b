//! A head to look at without having one: that of the simulated sensor, baked by our own baker when it is asked for, so that
//! nothing more is shipped.
//!
//! The mesh of `config/simulated.head` (see `NOTICE` for what it is made of) becomes binary glTF with colours: where the
//! mean photograph counts for all corners of a triangle that faces it, the photograph is its texture and the vertex colour
//! carries what differs from it; elsewhere the vertex colour is all. At the border both give the same, so there is no seam.
//!
//! Frames: the head frame (x left, y down, z in) becomes glTF's (x left, y up, z out), metres. Cost: about a second of
//! processor time for 67 shapes on 6657 vertices. Limits: no hair, closed neck line open below.

use std::io::Cursor;
use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use serde_json::{Value, json};

use crate::simulator::virtual_head::{HeadAsset, Part, Texture};
use crate::studio::bake::error::BakeError;
use crate::studio::bake::files::write;
use crate::studio::bake::glb::{Glb, push};
use crate::studio::bake::head::Head;
use crate::studio::bake::mesh::{Corner, Mesh, Vec3};
use crate::studio::bake::obj;
use crate::studio::bake::patch::Foreign;
use crate::studio::bake::recipe::{Recipe, SHIPPED};
use crate::studio::bake::rig::{self, Method};
use crate::studio::bake::solve::Settings;

const FLOAT: u32 = 5126;
const U32: u32 = 5125;
/// The photograph must count at least this much at a corner for it to be textured.
const PHOTO_SHARE: f32 = 0.02;
/// A triangle whose normal leans further from the photograph than this is coloured by its vertices, cosine.
const FACING: f64 = 0.15;
/// A place of the photograph with less than this, red, green and blue together, is one where it shows nothing.
const EMPTY: f32 = 24.0;
/// So near to such a place it does not count, pixels.
const MARGIN_PX: f32 = 4.0;
const JPEG_QUALITY: u8 = 90;

/// Why the head cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum DefaultHeadError {
    /// Baking or writing.
    #[error(transparent)]
    Bake(#[from] BakeError),
    /// Neither kind of file.
    #[error(
        "{path}: expected a name that ends in .glb (baked, coloured) or .obj (neutral, with its 68 landmarks in a .txt beside it)"
    )]
    Ending {
        /// What was given.
        path: String,
    },
}

/// From the head frame to glTF's.
fn upright([x, y, z]: [f32; 3]) -> Vec3 {
    Vec3::new(f64::from(x), f64::from(-y), f64::from(-z))
}

/// The neutral mesh, metres, and the vertices of the 68 landmarks.
fn neutral(asset: &HeadAsset) -> (Mesh, Vec<u64>) {
    let mut mesh = Mesh {
        positions: asset
            .neutral
            .iter()
            .map(|p| upright([p.x, p.y, p.z]))
            .collect(),
        materials: ["skin", "mouth", "gums", "teeth", "eyes", "sockets"]
            .map(str::to_owned)
            .to_vec(),
        ..Mesh::default()
    };
    for (t, &part) in asset.triangles.iter().zip(asset.parts.iter()) {
        // Clockwise in the picture is anticlockwise to the camera of glTF, whose y points up.
        let corners = [t[0], t[2], t[1]].map(|vertex| Corner {
            vertex,
            uv: None,
            normal: None,
        });
        mesh.push_face(&corners, part as u32);
    }
    let landmarks = asset
        .landmarks
        .iter()
        .map(|site| {
            let strongest = (0..3).max_by(|&a, &b| site.shares[a].total_cmp(&site.shares[b]));
            u64::from(site.vertices[strongest.unwrap_or(0)])
        })
        .collect();
    (mesh, landmarks)
}

/// An sRGB byte as linear light, 0…1 (IEC 61966-2-1).
fn linear(byte: f32) -> f32 {
    let v = (byte / 255.0).clamp(0.0, 1.0);
    if v <= 0.04045 {
        v / 12.92
    } else {
        ((v + 0.055) / 1.055).powf(2.4)
    }
}

/// How far the photograph counts at each vertex: not where it ends or is empty within a few pixels.
fn shares(asset: &HeadAsset, photograph: &Texture) -> Vec<f32> {
    let drawn = |x: f32, y: f32| {
        let inside = x >= 0.0
            && y >= 0.0
            && x <= photograph.width as f32 - 1.0
            && y <= photograph.height as f32 - 1.0;
        inside && photograph.at(x, y).iter().sum::<f32>() > EMPTY
    };
    let around = [[0.0, 0.0], [-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]];
    (0..asset.neutral.len())
        .map(|v| {
            let [x, y] = asset.photo[v];
            let whole = around
                .iter()
                .all(|d| drawn(x + d[0] * MARGIN_PX, y + d[1] * MARGIN_PX));
            if whole {
                asset.photo_share[v].clamp(0.0, 1.0)
            } else {
                0.0
            }
        })
        .collect()
}

/// Colours of the vertices, linear: by themselves, and as what the photograph is to be multiplied with.
fn colours(asset: &HeadAsset, photograph: &Texture, shares: &[f32]) -> [Vec<[f32; 3]>; 2] {
    let mut out = [Vec::new(), Vec::new()];
    for v in 0..asset.neutral.len() {
        let [x, y] = asset.photo[v];
        let (photo, own, share) = (photograph.at(x, y), asset.colour[v], shares[v]);
        let whole = [0, 1, 2].map(|k| linear(photo[k] * share + own[k] * (1.0 - share)));
        out[0].push(whole);
        out[1].push([0, 1, 2].map(|k| (whole[k] / linear(photo[k]).max(1e-3)).min(1.0)));
    }
    out
}

/// The neutral head as binary glTF.
fn coloured(asset: &HeadAsset, mesh: &Mesh) -> Glb {
    let empty = Texture::default();
    let photograph = asset.texture.first().unwrap_or(&empty);
    let mut glb = Glb {
        json: json!({
            "asset": {"version": "2.0", "generator": concat!("mien-studio ", env!("CARGO_PKG_VERSION")),
                "copyright": "made from ICT-FaceKit (MIT) and the Face Research Lab London Set and Young Adult White Faces (CC BY 4.0)"},
            "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "name": "head"}],
        }),
        bin: Vec::new(),
    };
    let rows = |glb: &mut Glb, rows: &[[f32; 3]], bounds: bool| {
        let data: Vec<u8> = rows
            .iter()
            .flatten()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        let view = glb.push_view(&data, 34962);
        let mut accessor = json!({"bufferView": view, "componentType": FLOAT, "count": rows.len(), "type": "VEC3"});
        if bounds {
            let extreme = |of: fn(f32, f32) -> f32, from: f32| {
                [0, 1, 2].map(|k| rows.iter().map(|r| r[k]).fold(from, of))
            };
            accessor["min"] = json!(extreme(f32::min, f32::INFINITY));
            accessor["max"] = json!(extreme(f32::max, f32::NEG_INFINITY));
        }
        glb.push_accessor(accessor)
    };
    let floats = |v: &Vec3| [v.x as f32, v.y as f32, v.z as f32];
    let places: Vec<[f32; 3]> = mesh.positions.iter().map(floats).collect();
    let normals: Vec<[f32; 3]> = mesh
        .vertex_normals(&mesh.positions)
        .iter()
        .map(floats)
        .collect();
    let position = rows(&mut glb, &places, true);
    let normal = rows(&mut glb, &normals, false);
    let shares = shares(asset, photograph);
    let [whole, ratio] = colours(asset, photograph, &shares);
    let plain =
        json!({"POSITION": position, "NORMAL": normal, "COLOR_0": rows(&mut glb, &whole, false)});
    let mut pictured =
        json!({"POSITION": position, "NORMAL": normal, "COLOR_0": rows(&mut glb, &ratio, false)});
    let size = [
        photograph.width.max(1) as f32,
        photograph.height.max(1) as f32,
    ];
    let uv: Vec<u8> = asset
        .photo
        .iter()
        .flat_map(|p| [0, 1].map(|k| (p[k] + 0.5) / size[k]))
        .flat_map(f32::to_le_bytes)
        .collect();
    let view = glb.push_view(&uv, 34962);
    pictured["TEXCOORD_0"] = glb
        .push_accessor(json!({"bufferView": view, "componentType": FLOAT, "count": places.len(), "type": "VEC2"}))
        .into();
    if let Some(jpeg) = jpeg(photograph) {
        let view = glb.push_view(&jpeg, 0);
        glb.json["images"] =
            json!([{"bufferView": view, "mimeType": "image/jpeg", "name": "photograph"}]);
        // Clamped: places beyond the photograph have a colour of their own.
        glb.json["samplers"] = json!([{"wrapS": 33071, "wrapT": 33071}]);
        glb.json["textures"] = json!([{"source": 0, "sampler": 0}]);
    }
    // For each material what is textured and what is not.
    let mut lists = vec![[Vec::new(), Vec::new()]; mesh.materials.len()];
    for f in 0..mesh.faces() {
        let t: Vec<u32> = mesh.face(f).iter().map(|corner| corner.vertex).collect();
        let at = |k: usize| mesh.positions[t[k] as usize];
        let facing = (at(1) - at(0)).cross(&(at(2) - at(0))).normalize().z;
        let shows = |&v: &u32| shares[v as usize] > PHOTO_SHARE;
        let textured = facing > FACING && t.iter().all(shows);
        lists[mesh.face_material[f] as usize][usize::from(textured)].extend(t);
    }
    let mut primitives = Vec::new();
    for (m, lists) in lists.iter().enumerate() {
        for (textured, list) in [false, true].into_iter().zip(lists) {
            if list.is_empty() {
                continue;
            }
            let data: Vec<u8> = list.iter().flat_map(|v| v.to_le_bytes()).collect();
            let view = glb.push_view(&data, 34963);
            let indices = glb.push_accessor(
                json!({"bufferView": view, "componentType": U32, "count": list.len(), "type": "SCALAR"}),
            );
            let wet = m == Part::Eye as usize || m == Part::Teeth as usize;
            let mut look =
                json!({"metallicFactor": 0.0, "roughnessFactor": if wet { 0.35 } else { 0.8 }});
            if textured {
                look["baseColorTexture"] = json!({"index": 0});
            }
            let material = push(
                &mut glb.json["materials"],
                json!({"name": mesh.materials[m], "pbrMetallicRoughness": look}),
            );
            let attributes = if textured { &pictured } else { &plain };
            primitives
                .push(json!({"attributes": attributes, "indices": indices, "material": material}));
        }
    }
    glb.json["meshes"] = json!([{"name": "head", "primitives": Value::Array(primitives)}]);
    glb
}

fn jpeg(photograph: &Texture) -> Option<Vec<u8>> {
    let mut out = Cursor::new(Vec::new());
    let (width, height) = (
        u32::try_from(photograph.width).ok()?,
        u32::try_from(photograph.height).ok()?,
    );
    JpegEncoder::new_with_quality(&mut out, JPEG_QUALITY)
        .encode(
            &photograph.rgb,
            width,
            height,
            image::ExtendedColorType::Rgb8,
        )
        .ok()?;
    Some(out.into_inner())
}

/// The head with its 67 shapes and colours, as the bytes of a GLB file.
///
/// # Errors
/// If the shapes cannot be solved for.
pub fn glb() -> Result<Vec<u8>, BakeError> {
    let asset = HeadAsset::shipped();
    let (mesh, landmarks) = neutral(&asset);
    // Through the door that heads of others take, so that the numbers of the vertices are settled there.
    let refuse = |source| BakeError::Glb {
        path: "built-in head".into(),
        source,
    };
    let (mesh, foreign) = Foreign::read(coloured(&asset, &mesh)).map_err(refuse)?;
    let head = Head::new(mesh, &foreign.landmarks(&landmarks))?;
    let recipe = |source| BakeError::Recipe {
        path: "built-in recipe".into(),
        source,
    };
    let targets = Recipe::read(SHIPPED)
        .and_then(|shipped| shipped.targets(&head))
        .map_err(recipe)?;
    let shapes = rig::bake(&head, &targets, &Settings::default(), Method::Aoi, &|_| {})?;
    Ok(foreign.patched(&shapes, false).emit())
}

/// Writes the head: baked to a `.glb`, or neutral to an `.obj` with the numbers of its landmarks beside it.
///
/// # Errors
/// If the name ends otherwise, or it cannot be written.
pub fn write_to(out: &Path) -> Result<String, DefaultHeadError> {
    match out.extension().and_then(|ending| ending.to_str()) {
        Some("glb") => {
            let bytes = glb()?;
            write(out, &bytes)?;
            Ok(format!(
                "{}: {} bytes, 67 shapes",
                out.display(),
                bytes.len()
            ))
        }
        Some("obj") => {
            let (mesh, landmarks) = neutral(&HeadAsset::shipped());
            let lines: String = landmarks.iter().map(|v| format!("{v}\n")).collect();
            let beside = out.with_extension("txt");
            write(out, obj::emit(&mesh).as_bytes())?;
            write(&beside, lines.as_bytes())?;
            Ok(format!(
                "{} and its landmarks {}",
                out.display(),
                beside.display()
            ))
        }
        _ => Err(DefaultHeadError::Ending {
            path: out.display().to_string(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_head_has_its_shapes_and_opens_its_jaw() {
        let glb = Glb::parse(&glb().unwrap()).unwrap();
        let mesh = &glb.json["meshes"][0];
        let names = mesh["extras"]["targetNames"].as_array().unwrap();
        let jaw = names.iter().position(|name| name == "jawOpen").unwrap();
        assert_eq!(
            (names.len(), &mesh["extras"]["mien"]["units"][jaw]),
            (67, &json!("AU26"))
        );
        let target = &mesh["primitives"][0]["targets"][jaw]["POSITION"];
        let moved = glb.floats(target.as_u64().unwrap() as usize, 3).unwrap();
        let down = moved.chunks(3).map(|d| -d[1]).fold(0.0, f32::max);
        assert!((0.008..0.05).contains(&down), "{down} m");
    }
}
