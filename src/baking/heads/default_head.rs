//! The default head: the [`Hero`], baked on demand, so that only its neutral mesh is shipped.
//!
//! As binary glTF it has colours, 67 morph targets and two joints, neck and head; the neck stays when the head turns.
//! As OBJ it is neutral, with materials and images in files beside it. Both have their 68 landmarks in a file, for
//! `mien-studio bake`.
//!
//! Frame: glTF's (x left, y up, z out), metres. Cost: two to three seconds of processor time for 67 shapes on 24 000
//! vertices.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::hero::{Hero, JOINT, Layer, Look, NECK, turns};
use crate::bake::glb::{Glb, VERTICES, push};
use crate::bake::head::Head;
use crate::bake::mesh::Vec3;
use crate::bake::morphs::single;
use crate::bake::neck;
use crate::bake::obj::faces;
use crate::bake::patch::ImportedGltf;
use crate::bake::prior::Prior;
use crate::bake::recipe::{Recipe, SHIPPED};
use crate::bake::rig::{self, Method};
use crate::bake::shape::Shape;
use mien_workbench::atomic_write::{is_free, write_out};
use mien_workbench::fault::Fault;

/// Adds a layer as a mesh, with the head's share of rotation by [`turns`].
fn add(glb: &mut Glb, hero: &Hero, layer: &Layer, name: &str) {
    let mesh = &layer.mesh;
    let places: Vec<[f32; 3]> = mesh.positions.iter().map(single).collect();
    let normals = mesh.vertex_normals(&mesh.positions);
    // Vertices of no face have no normal; the standard requires one.
    let normal = |n: &Vec3| single(&n.try_normalize(1e-9).unwrap_or_else(Vec3::y));
    let normals: Vec<[f32; 3]> = normals.iter().map(normal).collect();
    let shares = mesh.positions.iter().map(|p| turns(p) as f32);
    let [joints, weights] = neck::weighed(glb, shares);
    let attributes = json!({
        "POSITION": glb.push_rows_with_bounds(&places, VERTICES),
        "NORMAL": glb.push_rows(&normals, VERTICES),
        "COLOR_0": glb.push_rows(&layer.tints, VERTICES),
        "TEXCOORD_0": glb.push_rows(&layer.uv, VERTICES),
        "JOINTS_0": joints,
        "WEIGHTS_0": weights,
    });
    let mut primitives = Vec::new();
    for (number, look) in hero.looks.iter().enumerate() {
        let faces = (0..mesh.faces()).filter(|&f| mesh.face_material[f] as usize == number);
        let corners = faces.flat_map(|f| mesh.fan(f)).flatten();
        let corners: Vec<u32> = corners.map(|corner| corner.vertex).collect();
        if corners.is_empty() {
            continue;
        }
        let indices = glb.push_corners(&corners);
        let material = surface(glb, look);
        primitives
            .push(json!({"attributes": attributes, "indices": indices, "material": material}));
    }
    let whole = json!({"name": name, "primitives": Value::Array(primitives)});
    push(&mut glb.json["meshes"], whole);
}

/// Adds the material of a look; returns its number.
fn surface(glb: &mut Glb, look: &Look) -> usize {
    let [r, g, b] = look.colour;
    let mut surface = json!({"metallicFactor": 0.0, "roughnessFactor": look.rough, "baseColorFactor": [r, g, b, 1.0]});
    if let Some(picture) = look.picture {
        surface["baseColorTexture"] = json!({"index": textured(glb, picture, look.name)});
    }
    let mut material = json!({"name": look.name, "pbrMetallicRoughness": surface});
    if look.thin {
        material["doubleSided"] = true.into();
    }
    push(&mut glb.json["materials"], material)
}

/// Adds a picture; returns the number of its texture.
fn textured(glb: &mut Glb, jpeg: &[u8], name: &str) -> usize {
    let view = glb.push_view(jpeg, 0);
    let image = json!({"bufferView": view, "mimeType": "image/jpeg", "name": name});
    let image = push(&mut glb.json["images"], image);
    // Clamped, so that texels beyond have the colour of the edge.
    glb.json["samplers"] = json!([{"wrapS": 33071, "wrapT": 33071}]);
    let texture = json!({"source": image, "sampler": 0});
    push(&mut glb.json["textures"], texture)
}

/// The head with its 67 shapes and colours, as the bytes of a GLB file.
///
/// # Errors
/// If the shapes cannot be solved for.
pub fn glb(hero: &Hero) -> Result<Vec<u8>, Fault> {
    let mut face = Glb {
        json: json!({
            "asset": {"version": "2.0", "generator": concat!("mien-studio ", env!("CARGO_PKG_VERSION")),
                "copyright": "made from ICT-FaceKit, Copyright (c) 2020 USC Institute for Creative Technologies (MIT)"},
            "scene": 0, "scenes": [{"nodes": [0, 1]}],
            "nodes": [{"mesh": 0, "name": "face"}, {"mesh": 1, "name": "hair_and_shirt"}],
        }),
        bin: Vec::new(),
    };
    add(&mut face, hero, &hero.face, "face");
    // Read as an imported head, which settles the numbers of vertices.
    let (mesh, imported) = ImportedGltf::read(face).map_err(Fault::within("built-in head"))?;
    let head = Head::new(mesh, &imported.landmarks(&hero.landmarks))?;
    let mut glb = imported.patched(&head.mesh, &shapes(&head)?, false);
    // Parts that do not move with the face.
    add(&mut glb, hero, &hero.dress, "hair_and_shirt");
    neck::joined(&mut glb, &[NECK, JOINT]);
    Ok(glb.emit())
}

/// The shapes of the shipped recipe on a head.
///
/// # Errors
/// If they cannot be solved for.
pub fn shapes(head: &Head) -> Result<Vec<Shape>, Fault> {
    let targets = Recipe::read(SHIPPED).and_then(|shipped| shipped.targets(head));
    let targets = targets.map_err(Fault::within("built-in recipe"))?;
    rig::bake(head, &targets, Method::Aoi, Some(Prior::shipped()), &|_| ())
}

/// The neutral head as OBJ text that names `materials`.
fn obj(hero: &Hero, materials: &str) -> String {
    let mut out = format!("mtllib {materials}\n");
    let mut first = 1;
    for layer in [&hero.face, &hero.dress] {
        let mesh = &layer.mesh;
        for (p, tint) in mesh.positions.iter().zip(&layer.tints) {
            let [x, y, z] = single(p);
            // OBJ's colours are sRGB.
            let [r, g, b] = tint.map(|c| c.powf(1.0 / 2.2));
            let _ = writeln!(out, "v {x} {y} {z} {r:.4} {g:.4} {b:.4}");
        }
        for [u, v] in &layer.uv {
            let _ = writeln!(out, "vt {u:.5} {:.5}", 1.0 - v);
        }
        faces(&mut out, mesh, 0, |corner| {
            let number = corner.vertex + first;
            format!("{number}/{number}")
        });
        first += mesh.positions.len() as u32;
    }
    out
}

/// The materials of an OBJ, and their images, whose names begin with `stem`.
fn materials(hero: &Hero, stem: &str) -> (String, Vec<(String, Vec<u8>)>) {
    let (mut text, mut pictures) = (String::new(), Vec::new());
    for look in &hero.looks {
        // OBJ's colours are sRGB.
        let [r, g, b] = look.colour.map(|c| c.powf(1.0 / 2.2));
        let shine = (1.0 - look.rough) * 0.5;
        let _ = writeln!(
            text,
            "newmtl {}\nKd {r:.3} {g:.3} {b:.3}\nKs {shine:.3} {shine:.3} {shine:.3}\nNs {:.0}",
            look.name,
            4.0 + 160.0 * (1.0 - look.rough).powi(2)
        );
        if let Some(jpeg) = look.picture {
            let name = format!("{stem}_{}.jpg", look.name);
            let _ = writeln!(text, "map_Kd {name}");
            pictures.push((name, jpeg.to_vec()));
        }
    }
    (text, pictures)
}

/// Paths of files with their bytes.
type Files = Vec<(PathBuf, Vec<u8>)>;

/// The files of the head, the named one first, with the stem of the others' names.
fn files(hero: &Hero, out: &Path, stem: &str) -> Result<(&'static str, Files), Fault> {
    let ending = out.extension().unwrap_or_default().to_ascii_lowercase();
    let (what, mut files) = if ending == "glb" {
        let glb = (out.to_path_buf(), glb(hero)?);
        ("67 shapes, coloured", vec![glb])
    } else if ending == "obj" {
        // The name must be a single word in the OBJ.
        let stem = stem.replace(char::is_whitespace, "_");
        let library = format!("{stem}.mtl");
        let (text, pictures) = materials(hero, &stem);
        let mut files = vec![
            (out.to_path_buf(), obj(hero, &library).into_bytes()),
            (out.with_file_name(library), text.into_bytes()),
        ];
        let pictures = pictures.into_iter();
        files.extend(pictures.map(|(name, bytes)| (out.with_file_name(name), bytes)));
        ("neutral, coloured", files)
    } else {
        return Err(Fault::within(out)(
            "expected a name that ends in .glb (baked, coloured) or .obj (neutral, coloured); the 68 landmarks are written to a .txt beside it",
        ));
    };
    let lines: String = hero.landmarks.iter().map(|v| format!("{v}\n")).collect();
    let landmarks = out.with_file_name(format!("{stem}.txt"));
    files.push((landmarks, lines.into_bytes()));
    Ok((what, files))
}

/// Writes the head: baked to a `.glb`, or neutral to an `.obj`, with its landmarks in a file beside it. Existing
/// files beside it are kept, and all new ones get a number, unless `force`.
///
/// # Errors
/// If the name ends otherwise, or it cannot be written.
pub fn write_to(out: &Path, force: bool) -> Result<String, Fault> {
    let hero = Hero::shipped();
    let name = out.file_stem().unwrap_or_default().to_string_lossy();
    let mut stem = name.clone().into_owned();
    let mut number = 1;
    let (what, files) = loop {
        let (what, files) = files(&hero, out, &stem)?;
        if force || files[1..].iter().all(|(path, bytes)| is_free(path, bytes)) {
            break (what, files);
        }
        number += 1;
        stem = format!("{name}-{number}");
    };
    for (path, bytes) in &files {
        write_out(path, bytes)?;
    }
    let beside = files[1..].iter().map(|file| file.0.display().to_string());
    let beside = beside.collect::<Vec<_>>().join(", ");
    Ok(format!("{} ({what}); beside it {beside}", out.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::locate::guess;
    use crate::bake::looks::Looks;
    use crate::bake::patch::ImportedGltf;
    use crate::golden::{coloured, compare_with_golden, equals_golden};
    use mien_stages::face_model::FaceModel;

    #[test]
    fn the_head_has_its_shapes_and_opens_its_jaw() {
        let glb = Glb::parse(&glb(&Hero::shipped()).unwrap()).unwrap();
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

        // All shapes, in twentieths of a millimetre, at a sample of vertices that move by one or more.
        let moved = mesh["primitives"][0]["targets"].as_array().unwrap().iter();
        let moved = moved.map(|target| target["POSITION"].as_u64().unwrap() as usize);
        let moved: Vec<_> = moved.map(|at| glb.floats(at, 3).unwrap()).collect();
        let lines = names.iter().zip(&moved).map(|(name, moved)| {
            let far = moved.chunks(3).filter(|d| d.iter().any(|x| x.abs() > 1e-3));
            let far: Vec<&[f32]> = far.collect();
            let some = far.iter().step_by(far.len() / 16 + 1).copied().flatten();
            let some = some.map(|x| format!(" {}", (x * 2e4).round() as i32));
            format!(
                "{} {}{}",
                name.as_str().unwrap(),
                far.len(),
                some.collect::<String>()
            )
        });
        compare_with_golden("heads/baked", &lines.collect::<Vec<_>>());
        let mut looks = vec![glb.json["materials"].to_string()];
        for mesh in glb.json["meshes"].as_array().unwrap() {
            let parts = mesh["primitives"].as_array().unwrap().iter();
            looks.extend(parts.map(|part| format!("material {}", part["material"])));
        }
        equals_golden("heads/looks", &looks);
        // Strands of hair bend either way: none may count as inward.
        assert_eq!(ImportedGltf::read(glb).unwrap().1.turned, 0);
    }

    /// Landmarks in tenths of a millimetre and how sure they are in two hundredths, on the plain mesh.
    #[test]
    fn the_default_heads_landmarks_equal_the_golden_ones() {
        let mesh = Hero::shipped().face.mesh;
        let found = guess(&mesh, &Looks::default(), None, &FaceModel::shipped()).expect("a face");
        let mut lines = vec![format!("{} {}", found.up, found.facing)];
        for (&v, sure) in found.vertices.iter().zip(found.point_confidence) {
            let [x, y, z] = (mesh.positions[v as usize] * 1e4).into();
            lines.push(format!("{x:.0} {y:.0} {z:.0} {:.0}", sure * 200.0));
        }
        lines.extend(coloured::<16, 16>(&found.picture));
        equals_golden("heads/located", &lines);
    }
}
