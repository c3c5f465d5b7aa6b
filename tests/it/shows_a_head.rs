//! The head that a user meets first: coloured and with its landmarks in every format, baked without a fault, with a neck that
//! stays; and what animates it refuses what it cannot do.
#![cfg(feature = "studio")]

use std::path::Path;
use std::process::Command;

use mien_baking::bake::glb::Glb;
use mien_baking::bake::{command, command::Request, obj};
use mien_baking::heads::default_head;
use mien_baking::heads::hero::{self, Hero};

fn lines(path: &Path) -> usize {
    std::fs::read_to_string(path).unwrap().lines().count()
}

/// Runs `mien-studio`, expects it to refuse, and returns what it says.
fn refused(words: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mien-studio"));
    let output = command.args(words).output().unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success(), "{words:?} was accepted");
    assert!(!text.contains("panicked"), "{text}");
    text
}

#[test]
fn a_bake_of_the_head_is_reported_without_a_red_cell() {
    let folder = tempfile::tempdir().unwrap();
    for ending in ["obj", "glb"] {
        let mesh = folder.path().join(format!("head.{ending}"));
        default_head::write_to(&mesh, false).unwrap();
        let report = folder.path().join("report.html");
        let shapes = command::run(&Request {
            mesh: mesh.clone(),
            landmarks: mesh.with_extension("txt"),
            out: folder.path().join("baked.glb"),
            report: Some(report.clone()),
            ..Request::default()
        })
        .unwrap();
        assert_eq!(shapes.len(), 67, "{ending}");
        let page = std::fs::read_to_string(&report).unwrap();
        let rows: Vec<&str> = page.split_inclusive("</tr>").skip(1).take(67).collect();
        for row in rows {
            assert!(row.ends_with("</tr>"), "one row a shape");
            assert!(!row.contains("class=\"bad\""), "{ending}: {row}");
        }
        // The tongue comes out by more than a centimetre beyond the lips, further than they are thick.
        let tongue = shapes.iter().find(|s| s.name == "tongueOut").unwrap();
        let out = tongue.displacement.iter().map(|d| d.z).fold(0.0, f64::max);
        assert!(out > 0.02, "{ending}: the tongue moves by {out} m");
    }
}

#[test]
fn the_head_is_coloured_and_has_its_landmarks_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    default_head::write_to(&at("a head.obj"), false).unwrap();
    assert_eq!(lines(&at("a head.txt")), 68);
    let text = std::fs::read_to_string(at("a head.obj")).unwrap();
    let mesh = obj::parse(&text).unwrap();
    let quads = (0..mesh.faces()).filter(|&f| mesh.face(f).len() == 4);
    let quads = quads.count();
    assert!(quads * 10 > mesh.faces() * 9, "{quads} of {}", mesh.faces());
    let library = text.lines().find_map(|l| l.strip_prefix("mtllib "));
    let library = std::fs::read_to_string(at(library.unwrap())).unwrap();
    for material in &mesh.materials {
        let named = format!("newmtl {material}\n");
        assert!(library.contains(&named), "{material}");
    }
    let pictures = library.lines().filter_map(|l| l.strip_prefix("map_Kd "));
    let pictures: Vec<&str> = pictures.collect();
    assert_eq!(pictures.len(), 2, "skin and eyes");
    for picture in pictures {
        image::load_from_memory(&std::fs::read(at(picture)).unwrap()).unwrap();
    }
    default_head::write_to(&at("head.glb"), false).unwrap();
    let [one, other] = ["head.txt", "a head.txt"].map(|name| std::fs::read(at(name)).unwrap());
    assert_eq!(one, other);
    let other = default_head::write_to(&at("head.fbx"), false).unwrap_err();
    assert!(other.to_string().contains(".glb") && !at("head.fbx").exists());
}

#[test]
fn the_neck_stays_where_the_head_turns() {
    let hero = Hero::shipped();
    let share = |k: usize| {
        let v = hero.landmarks[k] as usize;
        hero::turns(&hero.face.mesh.positions[v])
    };
    assert!((0..68).all(|k| share(k) == 1.0), "the whole face turns");
    let shirt = hero.dress.mesh.positions.iter();
    let lowest = shirt.min_by(|a, b| a.y.total_cmp(&b.y));
    assert_eq!(hero::turns(lowest.unwrap()), 0.0, "the shirt does not");
    let skin = hero.face.mesh.positions.iter();
    let half = skin.filter(|p| (0.3..0.7).contains(&hero::turns(p)));
    assert!(half.count() > 50, "the neck is between");

    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (mesh, table, out) = (at("head.glb"), at("run.csv"), at("run.glb"));
    default_head::write_to(Path::new(&mesh), false).unwrap();
    std::fs::write(
        &table,
        "frame,time_us,user,state,qx,qy,qz,qw,w_AU26\n0,0,0,tracking,0,0,0,1,0\n1,33000,0,tracking,0,0.2,0,0.98,1\n",
    )
    .unwrap();
    mien_studio::animate::animate(&mien_studio::animate::Args {
        mesh: Path::new(&mesh).into(),
        csv: Path::new(&table).into(),
        out: Path::new(&out).into(),
        user: None,
    })
    .unwrap();
    let glb = Glb::parse(&std::fs::read(&out).unwrap()).unwrap();
    let channels = glb.json["animations"][0]["channels"].as_array().unwrap();
    let turned = channels
        .iter()
        .filter(|c| c["target"]["path"] == "rotation")
        .map(|c| c["target"]["node"].as_u64().unwrap() as usize)
        .map(|node| glb.json["nodes"][node]["name"].as_str().unwrap());
    assert_eq!(turned.collect::<Vec<_>>(), ["head"]);

    let nobody = refused(&[
        "animate", "--mesh", &mesh, "--csv", &table, "--out", &out, "--user", "3",
    ]);
    let expected = "run.csv: expected rows of user 3, found user 0 only";
    assert!(nobody.contains(expected), "{nobody}");
    std::fs::write(&table, "time_us,user,w_AU26\n0,0,0\n9,0,much\n").unwrap();
    let damaged = refused(&["animate", "--mesh", &mesh, "--csv", &table, "--out", &out]);
    let expected = "run.csv: line 3: expected a finite weight";
    assert!(damaged.contains(expected), "{damaged}");
}

#[test]
fn a_kind_of_file_that_is_not_written_is_refused_before_the_work() {
    let bake = "bake --mesh no.obj --landmarks no.txt --out";
    let animate = "animate --mesh no.glb --csv no.csv --out";
    for (name, words) in [("x.fbx", bake), ("x.obj", bake), ("x", animate)] {
        let words: Vec<&str> = words.split(' ').chain([name]).collect();
        let text = refused(&words);
        let expected = format!("'{name}' for '--out <OUT>': expected a name that ends in .glb");
        assert!(text.contains(&expected), "{text}");
        assert!(text.contains("come out of Blender"), "{text}");
    }
}
