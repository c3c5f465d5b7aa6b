//! Lips that are one skin are cut open, refused or kept, as asked; and what speech does with them.
//! Needs no data: the lips of the built-in head are welded.
#![cfg(feature = "studio")]

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use mien_baking::bake::command::{self, Joined, Request};
use mien_baking::bake::glb::Glb;
use mien_baking::bake::head::Head;
use mien_baking::bake::mesh::{Corner, Mesh, Vec3};
use mien_baking::bake::obj;
use mien_baking::bake::patch::ImportedGltf;
use mien_baking::bake::shape::Shape;
use mien_baking::heads::hero::Hero;

/// The built-in head without an inside of the mouth, its lips one line of vertices; and its landmarks.
fn joined() -> (Mesh, Vec<u64>) {
    let hero = Hero::shipped();
    let whole = hero.face.mesh.clone();
    let head = Head::new(whole.clone(), &hero.landmarks).unwrap();
    assert!(!head.lips_are_joined());
    let [long, short] = match head.lips.upper.len() > head.lips.lower.len() {
        true => [&head.lips.upper, &head.lips.lower],
        false => [&head.lips.lower, &head.lips.upper],
    };
    let last = (long.len() - 1, short.len() - 1);
    let onto = |k: usize| short[(k * last.1 + last.0 / 2) / last.0];
    let onto: HashMap<u32, u32> = (0..=last.0).map(|k| (long[k], onto(k))).collect();
    let welded = |v: u32| *onto.get(&v).unwrap_or(&v);
    let mut mesh = Mesh {
        positions: whole.positions.clone(),
        materials: whole.materials.clone(),
        ..Mesh::default()
    };
    for f in 0..whole.faces() {
        let face = whole.face(f);
        if face
            .iter()
            .any(|c| !head.socket[c.vertex as usize].is_nan())
        {
            continue;
        }
        let mut around: Vec<u32> = face.iter().map(|c| welded(c.vertex)).collect();
        around.dedup();
        if around.len() > 2 && around.first() != around.last() {
            let corners: Vec<Corner> = around.into_iter().map(Corner::bare).collect();
            mesh.push_face(&corners, whole.face_material[f]);
        }
    }
    let landmarks = hero.landmarks.iter();
    let landmarks = landmarks.map(|&v| u64::from(welded(v as u32)));
    (mesh, landmarks.collect())
}

/// Writes it, and its landmarks, as files.
fn written(folder: &Path) -> [PathBuf; 2] {
    let (mesh, landmarks) = joined();
    let [head, points] = ["head.obj", "head.txt"].map(|name| folder.join(name));
    std::fs::write(&head, obj::emit(&mesh)).unwrap();
    std::fs::write(&points, lines(&landmarks)).unwrap();
    [head, points]
}

fn lines(numbers: &[u64]) -> String {
    numbers.iter().map(|v| format!("{v}\n")).collect()
}

/// The head cut open, with visemes: what came in, what came out, where the 68 points are on that.
struct Opened {
    before: Mesh,
    mesh: Mesh,
    points: Vec<usize>,
    shapes: Vec<Shape>,
}

static OPENED: LazyLock<Opened> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let [mesh, landmarks] = written(folder.path());
    let before = obj::parse(&std::fs::read_to_string(&mesh).unwrap()).unwrap();
    let out = folder.path().join("shapes");
    let shapes = command::run(&Request {
        mesh,
        landmarks,
        out: folder.path().join("baked.glb"),
        obj: Some(out.clone()),
        visemes: true,
        ..Request::default()
    });
    let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    let points = read("landmarks.txt");
    Opened {
        before,
        mesh: obj::parse(&read("neutral.obj")).unwrap(),
        points: points.lines().map(|line| line.parse().unwrap()).collect(),
        shapes: shapes.unwrap(),
    }
});

impl Opened {
    fn shape(&self, name: &str) -> &Shape {
        self.shapes.iter().find(|s| s.name == name).unwrap()
    }

    /// Where a point is in a shape, in eye distances.
    fn at(&self, shape: &str, point: usize) -> Vec3 {
        let place = |k: usize| self.mesh.positions[self.points[k]];
        let moved = self.shape(shape).displacement[self.points[point]];
        (place(point) + moved) / (place(39) - place(42)).norm()
    }

    /// How far the middles of the inner lips are apart.
    fn gap(&self, shape: &str) -> f64 {
        self.at(shape, 62).y - self.at(shape, 66).y
    }
}

#[test]
fn joined_lips_are_cut_open_from_corner_to_corner_with_a_closed_mouth_behind() {
    let all = &*OPENED;
    let n = all.before.positions.len();
    let near = |(p, q): (&Vec3, &Vec3)| (p - q).norm() < 1e-6;
    assert!(all.mesh.positions.len() > n);
    assert!(
        all.before
            .positions
            .iter()
            .zip(&all.mesh.positions)
            .all(near)
    );
    // No hole has come, nor a vertex without a face.
    let open = |mesh: &Mesh| mesh.border().iter().filter(|open| **open).count();
    assert_eq!(open(&all.mesh), open(&all.before));
    let mut used = vec![false; all.mesh.positions.len()];
    all.mesh
        .corners
        .iter()
        .for_each(|c| used[c.vertex as usize] = true);
    assert!(used[n..].iter().all(|used| *used));
    let numbers: Vec<u64> = all.points.iter().map(|&v| v as u64).collect();
    let head = Head::new(all.mesh.clone(), &numbers).unwrap();
    assert!(!head.lips_are_joined());
    // Both edges are the lines of the lips, and all that is behind them is the mouth's inside.
    let line = |v: &u32| head.lips.upper.contains(v) || head.lips.lower.contains(v);
    let behind = (n as u32..used.len() as u32).filter(|v| !line(v));
    let inside = behind
        .clone()
        .filter(|&v| !head.socket[v as usize].is_nan());
    assert_eq!(inside.count(), behind.count());
    assert!(all.gap("jawOpen") > 0.85, "{}", all.gap("jawOpen"));
    assert!(all.gap("mouthPucker") < 0.08);
    let missed = all
        .shapes
        .iter()
        .filter(|s| s.misses.iter().flatten().count() > 0);
    let missed: Vec<_> = missed.map(|s| (&s.name, &s.misses)).collect();
    assert!(missed.is_empty(), "{missed:?}");
}

#[test]
fn a_viseme_is_the_sum_that_the_recipe_says() {
    let all = &*OPENED;
    let visemes = all.shapes.iter().filter(|s| s.name.starts_with("viseme_"));
    let names: Vec<&str> = visemes.map(|s| &s.name[7..]).collect();
    let usual = "sil PP FF TH DD kk CH SS nn RR aa E ih oh ou";
    assert_eq!(names.join(" "), usual);
    let recipe = mien_baking::bake::recipe::SHIPPED;
    let recipe: toml::Table = recipe.parse().unwrap();
    for viseme in recipe["viseme"].as_array().unwrap() {
        let shape = all.shape(viseme["name"].as_str().unwrap());
        let mut sum = vec![Vec3::zeros(); shape.displacement.len()];
        for row in viseme["sum"].as_array().unwrap() {
            let name = row[0].as_str().unwrap();
            let other = name.replace("Left", "Right");
            let both = [Some(name), Some(&*other).filter(|other| *other != name)];
            for part in both.into_iter().flatten() {
                for (sum, d) in sum.iter_mut().zip(&all.shape(part).displacement) {
                    *sum += d * row[1].as_float().unwrap();
                }
            }
        }
        let off = sum.iter().zip(&shape.displacement);
        let off = off.map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        assert!(off < 1e-12, "{}: {off}", shape.name);
    }
    assert!(
        all.shape("viseme_sil")
            .displacement
            .iter()
            .all(|d| *d == Vec3::zeros())
    );
}

#[test]
fn lips_shut_for_p_and_open_the_further_the_opener_the_vowel() {
    let all = &*OPENED;
    let gap = |viseme: &str| all.gap(&format!("viseme_{viseme}"));
    assert!(gap("PP") < 0.03, "{}", gap("PP"));
    let opener = ["PP", "SS", "ih", "E", "aa"].map(gap);
    assert!(opener.is_sorted() && gap("ou") < gap("oh"), "{opener:?}");
    let forward =
        |viseme: &str| all.at(&format!("viseme_{viseme}"), 62).z - all.at("viseme_sil", 62).z;
    let rounder = ["ih", "oh", "ou"].map(forward);
    assert!(rounder.is_sorted(), "{rounder:?}");
    let wide = |viseme: &str| {
        let name = format!("viseme_{viseme}");
        all.at(&name, 54).x - all.at(&name, 48).x
    };
    let wider = ["ou", "oh", "sil", "E", "ih"].map(wide);
    assert!(wider.is_sorted(), "{wider:?}");
}

#[test]
fn joined_lips_are_kept_when_asked_for_and_refused_where_they_cannot_be_cut() {
    let folder = tempfile::tempdir().unwrap();
    let [mesh, landmarks] = written(folder.path());
    // The jaw alone is enough.
    let recipe = folder.path().join("jaw.toml");
    let shipped = mien_baking::bake::recipe::SHIPPED;
    let jaw = shipped
        .split("[[shape]]")
        .find(|s| s.contains("\"jawOpen\"\nunit"));
    std::fs::write(&recipe, format!("[[shape]]{}", jaw.unwrap())).unwrap();
    let baked = folder.path().join("baked.glb");
    let request = |lips| Request {
        mesh: mesh.clone(),
        landmarks: landmarks.clone(),
        out: baked.clone(),
        recipe: Some(recipe.clone()),
        lips,
        ..Request::default()
    };
    let kept = command::run(&request(Some(Joined::Keep))).unwrap();
    let before = obj::parse(&std::fs::read_to_string(&mesh).unwrap()).unwrap();
    assert_eq!(kept[0].displacement.len(), before.positions.len());
    let missed = kept[0].misses.clone().unwrap();
    assert!(missed[0].starts_with("part lip_upper_inner"), "{missed:?}");
    // The same head as glTF.
    let glb = Glb::parse(&std::fs::read(&baked).unwrap()).unwrap();
    let (of_glb, imported) = ImportedGltf::read(glb).unwrap();
    let (_, points) = joined();
    let nearest = |v: &u64| {
        let p = before.positions[*v as usize];
        let far = |k: &usize| (of_glb.positions[*k] - p).norm();
        (0..of_glb.positions.len())
            .min_by(|a, b| far(a).total_cmp(&far(b)))
            .unwrap() as u64
    };
    let points: Vec<u64> = points.iter().map(nearest).collect();
    std::fs::write(&landmarks, lines(&imported.rows(&points))).unwrap();
    let out = folder.path().join("again.glb");
    let of_glb = |lips| Request {
        mesh: baked.clone(),
        out: out.clone(),
        ..request(lips)
    };
    let refused = command::run(&of_glb(None)).unwrap_err();
    let text = refused.to_string();
    assert!(
        refused.code == 1 && text.contains("--lips keep") && text.contains("OBJ"),
        "{text}"
    );
    assert!(!out.exists());
    command::run(&of_glb(Some(Joined::Keep))).unwrap();
    assert!(out.exists());
}
