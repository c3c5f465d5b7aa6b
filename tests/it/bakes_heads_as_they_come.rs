//! Promise: a head gets the same shapes whichever way its faces run, its axes point, its unit is and its file is cut.
#![cfg(feature = "studio")]

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use mien_baking::bake::command::{Request, run};
use mien_baking::bake::glb::Glb;
use mien_baking::bake::mesh::{Mesh, Vec3};
use mien_baking::bake::patch::ImportedGltf;
use mien_baking::bake::recipe::SHIPPED;
use mien_baking::bake::shape::Shape;
use mien_baking::bake::{morphs, obj};
use mien_baking::heads::hero::Hero;
use mien_stages::face_model::scheme::MIRROR;
use serde_json::json;

/// Shapes that what is wrong with a mesh showed in, and their mirror images.
const SHAPES: [&str; 6] = [
    "jawOpen",
    "tongueOut",
    "eyeBlinkLeft",
    "cheekSquintLeft",
    "mouthSmileLeft",
    "mouthFunnel",
];
/// Relative error of a shape's displacement.
const SAME: f64 = 0.01;
/// A mirrored head is solved in another order: .03 in one shape, which then takes another of two solutions that are about as good.
const MIRRORED: f64 = 0.05;

/// The shipped recipe of these shapes alone.
fn recipe(folder: &Path) -> PathBuf {
    let named = |block: &&str| {
        let name = SHAPES.map(|name| format!("\nname = \"{name}\"\n"));
        name.iter().any(|name| block.contains(name))
    };
    let blocks = SHIPPED.split("[[shape]]").filter(named);
    // Correctives follow the last.
    let blocks = blocks.filter_map(|block| block.split("\n[[").next());
    let text: String = blocks.map(|block| format!("[[shape]]{block}")).collect();
    let path = folder.join("recipe.toml");
    std::fs::write(&path, text).unwrap();
    path
}

/// Bakes the file of these bytes with landmarks at these numbers.
fn baked(folder: &Path, name: &str, bytes: &[u8], landmarks: &[u64]) -> Vec<Shape> {
    let mesh = folder.join(name);
    std::fs::write(&mesh, bytes).unwrap();
    let numbers: String = landmarks.iter().map(|v| format!("{v}\n")).collect();
    let text = mesh.with_extension("txt");
    std::fs::write(&text, numbers).unwrap();
    let request = Request {
        mesh,
        landmarks: text,
        out: folder.join("baked.glb"),
        recipe: Some(recipe(folder)),
        ..Request::default()
    };
    run(&request).unwrap()
}

/// A mesh with its vertices moved and some faces turned round.
fn changed(mesh: &Mesh, to: impl Fn(&Vec3) -> Vec3, turns: impl Fn(usize) -> bool) -> Mesh {
    let mut out = mesh.clone();
    out.positions.iter_mut().for_each(|p| *p = to(p));
    for f in (0..mesh.faces()).filter(|&f| turns(f)) {
        out.corners[mesh.starts[f] as usize..mesh.starts[f + 1] as usize].reverse();
    }
    out
}

/// The largest relative error of a shape; `back` brings ways of `other` back, `of` says which vertices of its are which.
fn apart(
    plain: &[Shape],
    other: &[Shape],
    back: impl Fn(&Vec3) -> Vec3,
    of: impl Fn(usize) -> Vec<usize>,
) -> (f64, String) {
    let errors = plain.iter().map(|one| {
        let two = other.iter().find(|s| s.name == one.name).unwrap();
        let (mut miss, mut size) = (0.0, 0.0);
        for (v, d) in one.displacement.iter().enumerate() {
            let off = of(v)
                .into_iter()
                .map(|o| (back(&two.displacement[o]) - d).norm_squared());
            // Vertices without a face are not in every file.
            let off = off.fold(f64::INFINITY, f64::min);
            miss += if off.is_finite() { off } else { 0.0 };
            size += d.norm_squared();
        }
        ((miss / size).sqrt(), one.name.clone())
    });
    errors.max_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
}

/// A head of the built-in face and its landmarks.
fn head() -> (Mesh, Vec<u64>) {
    let hero = Hero::shipped();
    (hero.face.mesh, hero.landmarks)
}

#[test]
fn the_same_shapes_however_faces_run_and_whatever_unit_and_axes() {
    let folder = tempfile::tempdir().unwrap();
    let (mesh, landmarks) = head();
    let bake = |mesh: &Mesh, landmarks: &[u64]| {
        baked(
            folder.path(),
            "head.obj",
            obj::emit(mesh).as_bytes(),
            landmarks,
        )
    };
    let plain = bake(&mesh, &landmarks);
    let (part, _) = mesh.components(&mesh.rings());
    let skin = part[landmarks[8] as usize];
    let of_skin = |f: usize| part[mesh.face(f)[0].vertex as usize] == skin;
    let stays = |p: &Vec3| *p;
    let no = |_: usize| false;
    let yes = |_: usize| true;
    let same = |v: usize| vec![v];
    let mut seen: Vec<(&str, (f64, String))> = Vec::new();
    for (name, other) in [
        ("reversed", changed(&mesh, stays, yes)),
        ("skin reversed", changed(&mesh, stays, of_skin)),
        (
            "all but skin reversed",
            changed(&mesh, stays, |f| !of_skin(f)),
        ),
        (
            "every third face reversed",
            changed(&mesh, stays, |f| f % 3 == 0),
        ),
    ] {
        seen.push((name, apart(&plain, &bake(&other, &landmarks), stays, same)));
    }
    for (name, scale) in [("centimetres", 100.0), ("decimetres", 10.0)] {
        let other = bake(&changed(&mesh, |p| p * scale, no), &landmarks);
        seen.push((name, apart(&plain, &other, |d| d / scale, same)));
    }
    let lying = changed(&mesh, |p| Vec3::new(p.x, -p.z, p.y), no);
    let back = |d: &Vec3| Vec3::new(d.x, d.z, -d.y);
    seen.push(("z up", apart(&plain, &bake(&lying, &landmarks), back, same)));
    let mirror = |p: &Vec3| Vec3::new(-p.x, p.y, p.z);
    let partners: Vec<u64> = MIRROR.iter().map(|&k| landmarks[k]).collect();
    let mut other = bake(&changed(&mesh, mirror, yes), &partners);
    for Shape { name, .. } in &mut other {
        *name = match name.strip_suffix("Left") {
            Some(stem) => format!("{stem}Right"),
            None => name.replace("Right", "Left"),
        };
    }
    seen.push(("mirrored", apart(&plain, &other, mirror, same)));
    let mut cut = Mesh {
        corners: Vec::new(),
        starts: Vec::new(),
        face_material: Vec::new(),
        ..mesh.clone()
    };
    for f in 0..mesh.faces() {
        for t in mesh.split(f) {
            cut.push_face(&t.map(|k| mesh.face(f)[k]), mesh.face_material[f]);
        }
    }
    seen.push((
        "triangulated",
        apart(&plain, &bake(&cut, &landmarks), stays, same),
    ));
    for (name, (error, shape)) in &seen {
        println!("{name}: {error:.5} ({shape})");
    }
    let most = |name: &str| if name == "mirrored" { MIRRORED } else { SAME };
    let alike = seen.iter().all(|(name, (error, _))| *error < most(name));
    assert!(alike, "{seen:?}");
}

/// Numbers of a landmark file for a GLB: the first row at each place.
fn rows(glb: &Glb, mesh: &Mesh, landmarks: &[u64]) -> Vec<u64> {
    let places = glb.floats(0, 3).unwrap();
    let bits = |p: &[f32]| [p[0], p[1], p[2]].map(|x| (x + 0.0).to_bits());
    let mut first = HashMap::new();
    for (row, p) in places.chunks(3).enumerate() {
        first.entry(bits(p)).or_insert(row as u64);
    }
    let place = |v: &u64| bits(mesh.positions[*v as usize].cast::<f32>().as_slice());
    landmarks.iter().map(|v| first[&place(v)]).collect()
}

#[test]
fn a_glb_that_is_split_reversed_or_mirrored_by_its_node_gets_the_shapes_of_the_obj_and_keeps_its_faces()
 {
    let folder = tempfile::tempdir().unwrap();
    let (mesh, landmarks) = head();
    let text = obj::emit(&mesh);
    let plain = baked(folder.path(), "head.obj", text.as_bytes(), &landmarks);
    let mirror = |p: &Vec3| Vec3::new(-p.x, p.y, p.z);
    for (name, turns, scale) in [
        ("split", false, 1.0),
        ("reversed", true, 1.0),
        ("mirrored by its node", true, -1.0),
    ] {
        // Mirrored twice: stored the other way round, and put back by the node.
        let to = |p: &Vec3| if scale < 0.0 { mirror(p) } else { *p };
        let stored = changed(&mesh, to, |_| turns);
        let mut glb = morphs::build(&stored, &[], 1.0, false, None);
        if scale < 0.0 {
            glb.json["nodes"][0]["scale"] = json!([-1.0, 1.0, 1.0]);
        }
        let numbers = rows(&glb, &stored, &landmarks);
        let file = glb.emit();
        let shapes = baked(folder.path(), "head.glb", &file, &numbers);
        let (read, _) = ImportedGltf::read(Glb::parse(&file).unwrap()).unwrap();
        let bits = |p: &Vec3| [p.x, p.y, p.z].map(|x| (x as f32 + 0.0).to_bits());
        let mut there: HashMap<[u32; 3], Vec<usize>> = HashMap::new();
        for (v, p) in read.positions.iter().enumerate() {
            there.entry(bits(p)).or_default().push(v);
        }
        let copies = |v: usize| {
            there
                .get(&bits(&mesh.positions[v]))
                .cloned()
                .unwrap_or_default()
        };
        let (error, shape) = apart(&plain, &shapes, |d| *d, copies);
        println!("{name}: {error:.5} ({shape})");
        assert!(error < SAME, "{name}: {error} ({shape})");
        // The faces of the file are as they were.
        let baked = Glb::parse(&std::fs::read(folder.path().join("baked.glb")).unwrap()).unwrap();
        let corners = |glb: &Glb| {
            let primitives = glb.json["meshes"][0]["primitives"]
                .as_array()
                .unwrap()
                .iter();
            let at = primitives.map(|p| p["indices"].as_u64().unwrap() as usize);
            at.map(|at| glb.indices(at).unwrap()).collect::<Vec<_>>()
        };
        assert!(corners(&baked) == corners(&glb), "{name}");
    }
}

#[test]
fn an_obj_that_is_reversed_is_written_with_its_faces_outwards() {
    let folder = tempfile::tempdir().unwrap();
    let (mesh, landmarks) = head();
    let other = changed(&mesh, |p| *p, |_| true);
    baked(
        folder.path(),
        "head.obj",
        obj::emit(&other).as_bytes(),
        &landmarks,
    );
    let file = std::fs::read(folder.path().join("baked.glb")).unwrap();
    let glb = Glb::parse(&file).unwrap();
    let head = &glb.json["meshes"][0]["primitives"];
    let mut volume = 0.0;
    for primitive in head.as_array().unwrap() {
        let read = |at: &serde_json::Value| at.as_u64().unwrap() as usize;
        let places = glb
            .floats(read(&primitive["attributes"]["POSITION"]), 3)
            .unwrap();
        let order = glb.indices(read(&primitive["indices"])).unwrap();
        let place = |v: u32| {
            Vec3::from_iterator(places[3 * v as usize..][..3].iter().map(|&x| f64::from(x)))
        };
        for t in order.as_chunks::<3>().0 {
            let [a, b, c] = t.map(place);
            volume += a.dot(&b.cross(&c)) / 6.0;
        }
    }
    // Litres.
    assert!(volume * 1e3 > 1.0, "{volume}");
}
