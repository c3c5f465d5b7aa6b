//! Promise: the page of `mien-studio place` puts points on the skin of a head, mirrored, bakes with them, and saves what `bake`
//! reads; nobody from elsewhere moves or saves anything, and what cannot be opened is said in one sentence.
#![cfg(feature = "studio")]

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Stdio};

use crate::common::studio;

use mien_baking::bake::mesh::{Mesh, Vec3};
use mien_baking::bake::order::Ordered;
use mien_baking::bake::{glb::Glb, obj, patch::ImportedGltf, source};
use mien_baking::heads::default_head;
use mien_studio::place::surface::{Ray, Surface};
use serde_json::Value;

/// The program on a free port, ended with the test.
struct Served(Child, String);

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Served {
    /// Places points on a mesh with its landmarks beside it.
    fn start(mesh: &Path, words: &[&str]) -> Self {
        let mut command = studio("place --port 0 --mesh");
        command.arg(mesh).arg("--landmarks");
        let command = command.arg(mesh.with_extension("txt")).args(words);
        let command = command.stdout(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let mut line = String::new();
        let mut out = BufReader::new(child.stdout.take().unwrap());
        out.read_line(&mut line).unwrap();
        let host = line.split("http://").nth(1).unwrap().split('/').next();
        Self(child, host.unwrap().to_owned())
    }

    /// Status line and body.
    fn ask(&self, method: &str, target: &str, headers: &str) -> (String, Vec<u8>) {
        let mut stream = TcpStream::connect(&self.1).unwrap();
        let request = format!("{method} {target} HTTP/1.1\r\n{headers}\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let end = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
        let head = String::from_utf8(answer[..end].to_vec()).unwrap();
        let status = head.lines().next().unwrap().to_owned();
        (status, answer[end + 4..].to_vec())
    }

    fn get(&self, target: &str) -> Vec<u8> {
        let (status, body) = self.ask("GET", target, &format!("Host: {}\r\n", self.1));
        assert!(status.contains("200"), "{target}: {status}");
        body
    }

    fn post(&self, target: &str, points: &[u64]) -> Value {
        let points: Vec<String> = points.iter().map(u64::to_string).collect();
        let target = format!("{target}points={}", points.join(","));
        let headers = format!("Host: {}\r\nX-Mien: 1\r\n", self.1);
        let (status, body) = self.ask("POST", &target, &headers);
        assert!(status.contains("200"), "{target}: {status}");
        serde_json::from_slice(&body).unwrap()
    }
}

fn numbers(value: &Value) -> Vec<u64> {
    let all = value.as_array().unwrap().iter();
    all.map(|v| v.as_u64().unwrap()).collect()
}

fn place(value: &Value, k: usize) -> Vec3 {
    Vec3::from_fn(|row, _| value["places"][k][row].as_f64().unwrap())
}

/// How far the only shape of a file moves each vertex.
fn displacement(bytes: &[u8]) -> Vec<f32> {
    let glb = Glb::parse(bytes).unwrap();
    let target = &glb.json["meshes"][0]["primitives"][0]["targets"][0]["POSITION"];
    glb.floats(target.as_u64().unwrap() as usize, 3).unwrap()
}

#[test]
fn a_point_is_dragged_baked_and_saved_as_bake_reads_it() {
    let folder = tempfile::tempdir().unwrap();
    for ending in ["obj", "glb"] {
        let mesh = folder.path().join(format!("head-{ending}.{ending}"));
        default_head::write_to(&mesh, false).unwrap();
        let served = Served::start(&mesh, &[]);
        let page = String::from_utf8(served.get("/")).unwrap();
        assert!(page.contains("place.js") && served.get("/place.js").len() > 1000);
        assert!(served.get("/head.js").len() > 1000 && served.get("/glb.js").len() > 1000);
        assert_eq!(&served.get("/head.glb")[..4], b"glTF");

        let start: Value = serde_json::from_slice(&served.get("/start.json")).unwrap();
        let points = numbers(&start["points"]);
        assert!(start["confidence"].is_null() && start["symmetric"] == true);
        let first = served.post("/bake?", &points);
        assert_eq!(first["shapes"].as_array().unwrap().len(), 67);
        let smile = "/head.glb?shape=mouthSmileLeft";
        let before = displacement(&served.get(smile));

        // The left corner of the mouth, an eighth of the eyes' distance outwards, seen from in front.
        let eyes = (place(&start, 39) - place(&start, 42)).norm();
        let aim = place(&start, 54) + Vec3::x() * (0.125 * eyes);
        let ray = format!("{},{},{},0,0,-1", aim.x, aim.y, aim.z + 10.0 * eyes);
        let moved = served.post(&format!("/move?point=54&mirror=1&ray={ray}&"), &points);
        assert_eq!(moved["ok"], true);
        let (after, corner) = (numbers(&moved["points"]), place(&moved, 54));
        let others = (0..68).filter(|k| ![48, 54].contains(k));
        let stay = others.into_iter().all(|k| after[k] == points[k]);
        assert!(stay, "only the pair moves");
        let off = (corner - aim).xy().norm();
        assert!(off < 0.04 * eyes, "{off} of {eyes}");
        let twin = (place(&moved, 48) - Vec3::new(-corner.x, corner.y, corner.z)).norm();
        assert!(twin < 0.02 * eyes, "{twin} from its mirror image");

        // A step outwards and upwards from there is to another vertex, on that side, near by, and of the pair only.
        for towards in [Vec3::x(), Vec3::y(), -Vec3::x(), -Vec3::y()] {
            let (x, y) = (towards.x, towards.y);
            let step = format!("/step?point=54&mirror=1&sight=0,0,-1&towards={x},{y},0&");
            let stepped = served.post(&step, &after);
            assert_eq!(stepped["ok"], true);
            let went = place(&stepped, 54) - corner;
            assert!(went.dot(&towards) > 0.7 * went.xy().norm(), "{went:?}");
            assert!((1e-4..0.15).contains(&(went.norm() / eyes)), "{went:?}");
            let points = numbers(&stepped["points"]);
            let same = (0..68).filter(|&k| points[k] == after[k]).count();
            assert_eq!(same, 66, "{towards:?}");
        }
        // A point of the middle stays in it.
        let step = "/step?point=8&mirror=1&sight=0,0,-1&towards=0,1,0&";
        let chin = place(&served.post(step, &after), 8) - place(&moved, 8);
        assert!(chin.y > 0.0 && chin.x.abs() < 0.02 * eyes, "{chin:?}");

        assert_eq!(served.post("/bake?", &after)["ok"], true);
        let shaped = displacement(&served.get(smile));
        let change = before.iter().zip(&shaped).map(|(a, b)| (a - b).abs());
        let change = f64::from(change.fold(0.0, f32::max));
        assert!(change > 0.01 * eyes, "the smile is another");

        let out = mesh.with_extension("landmarks.txt");
        assert!(!out.exists(), "nothing is written before Save");
        assert_eq!(served.post("/save?", &after)["ok"], true);
        let text = std::fs::read_to_string(&out).unwrap();
        let read = source::landmarks(&text, &out).unwrap();
        let bytes = std::fs::read(&mesh).unwrap();
        let (head, read) = if ending == "glb" {
            let (head, imported) = ImportedGltf::read(Glb::parse(&bytes).unwrap()).unwrap();
            (head, imported.landmarks(&read))
        } else {
            let text = String::from_utf8(bytes).unwrap();
            (obj::parse(&text).unwrap(), read)
        };
        for (k, &v) in read.iter().enumerate() {
            let off = head.positions[v as usize] - place(&moved, k);
            assert!(off.norm() < 1e-6, "{k}");
        }
    }
}

#[test]
fn nobody_from_elsewhere_saves_and_bad_words_are_answered() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = folder.path().join("head.obj");
    default_head::write_to(&mesh, false).unwrap();
    let given = mesh.with_extension("txt");
    let out = folder.path().join("mine.txt");
    let served = Served::start(&mesh, &["--out", out.to_str().unwrap()]);
    let own = format!("Host: {}\r\n", served.1);
    let text = std::fs::read_to_string(&given).unwrap();
    let points: Vec<&str> = text.lines().collect();
    let all = points.join(",");
    let save = format!("/save?points={all}");
    for (host, more, status) in [
        ("Host: evil.example\r\n", "X-Mien: 1\r\n", "421"),
        (&own, "X-Mien: 1\r\nOrigin: http://evil.example\r\n", "403"),
        (&own, "X-Mien: 1\r\nSec-Fetch-Site: cross-site\r\n", "403"),
        (&own, "", "403"),
    ] {
        let (found, _) = served.ask("POST", &save, &format!("{host}{more}"));
        assert!(found.contains(status), "{host}{more}: {found}");
    }
    assert!(!out.exists());
    for bad in [
        "/save?points=1,2,3",
        "/save?points=",
        "/save?points=99999999999,0",
        &format!("/move?point=68&ray=0,0,1,0,0,-1&points={all}"),
        &format!("/move?point=1&ray=0,0,NaN,0,0,-1&points={all}"),
        &format!("/move?point=1&ray=0,0,1,0,0,0&points={all}"),
        &format!("/other?points={all}"),
    ] {
        let (_, body) = served.ask("POST", bad, &format!("{own}X-Mien: 1\r\n"));
        let answer: Value = serde_json::from_slice(&body).unwrap();
        assert_eq!(answer["ok"], false, "{bad}");
    }
    assert!(!out.exists());
    // All points on one vertex are no face; that is said, and the page goes on.
    let answer = served.post("/bake?", &[points[0].parse().unwrap(); 68]);
    let said = answer["said"].as_str().unwrap();
    assert_eq!(answer["ok"], false, "{said}");
    assert!(said.contains("eye corners"), "{said}");
    let (found, _) = served.ask("POST", &save, &format!("{own}X-Mien: 1\r\n"));
    assert!(found.contains("200") && out.exists());
}

#[test]
fn what_cannot_be_opened_is_said_in_one_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let cube = folder.path().join("short.txt");
    std::fs::write(&cube, "1\n2\n3\n").unwrap();
    let mesh = folder.path().join("head.obj");
    default_head::write_to(&mesh, false).unwrap();
    let at = |path: &Path| path.to_str().unwrap().to_owned();
    for (words, expected) in [
        (vec!["--mesh".into(), "nowhere.obj".into()], "cannot read"),
        (vec!["--mesh".into(), at(&cube)], "short.txt"),
        (
            vec!["--mesh".into(), at(&mesh), "--landmarks".into(), at(&cube)],
            "expected 68 vertex numbers",
        ),
        (vec![], "not provided: --mesh"),
    ] {
        let output = studio("place --port 0").args(&words).output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success(), "{said}");
        assert!(said.contains(expected), "{said}");
        assert!(!said.contains("panicked"), "{said}");
        assert!(said.lines().count() <= 2, "{said}");
    }
}

/// A folded sheet that is its own mirror image about x = 0.
fn roof() -> Mesh {
    let mut text = String::new();
    for row in 0..9 {
        for col in -4_i32..=4 {
            text += &format!("v {col} {} {}\n", row - 4, -0.5 * f64::from(col.abs()));
        }
    }
    for row in 0..8 {
        for col in 0..8 {
            let v = row * 9 + col + 1;
            text += &format!("f {} {} {} {}\n", v, v + 1, v + 10, v + 9);
        }
    }
    obj::parse(&text).unwrap()
}

#[test]
fn a_point_lies_where_the_ray_meets_the_skin_and_its_twin_across_the_middle() {
    let mesh = roof();
    let surface = Surface::new(&mesh, &Ordered::new(&mesh), 0);
    assert!(surface.is_symmetric());
    let look = |x: f64, y: f64| Ray {
        from: Vec3::new(x, y, 7.0),
        along: Vec3::new(0.0, 0.0, -2.0),
    };
    // Between vertices, exactly on the plane of the triangle; beside the sheet, nowhere.
    let hit = surface.hit(&look(1.3, 0.4)).unwrap();
    assert!((hit - Vec3::new(1.3, 0.4, -0.65)).norm() < 1e-12, "{hit}");
    assert!(surface.hit(&look(9.0, 0.0)).is_none());
    let vertex = |x: i32, y: i32| ((y + 4) * 9 + x + 4) as u64;
    let points: Vec<u64> = (0..68).collect();
    // Landmark 16 is the left end of the jaw, 0 the right one.
    let moved = |k, x, y, mirrored| surface.moved(&points, k, &look(x, y), mirrored);
    let both = moved(16, 2.2, 3.9, true);
    assert_eq!((both[16], both[0]), (vertex(2, 4), vertex(-2, 4)));
    let alone = moved(16, 2.2, 3.9, false);
    assert_eq!((alone[16], alone[0]), (vertex(2, 4), points[0]));
    // The chin stays in the middle when mirrored; and a vertex that another point has is left to it.
    assert_eq!(moved(8, 1.2, 4.0, true)[8], vertex(0, 4));
    assert_eq!(moved(8, 1.2, 4.0, false)[8], vertex(1, 4));
    // Row -4 is other points' but for its end, which is its own.
    let there = moved(8, 1.9, -4.0, false)[8];
    assert_eq!(there, points[8], "no two points on one vertex");
    // Past the rim the nearest vertex to the line of sight takes it.
    assert_eq!(moved(16, 6.0, 4.1, false)[16], vertex(4, 4));
}
