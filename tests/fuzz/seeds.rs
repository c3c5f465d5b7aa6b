//! What every parser is fed with first: files and messages as our own tools make them, into `<folder>/<parser>/`.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::SystemTime;

use mien_stages::face_model;
use mien_outputs::csv::Rows;
use mien_outputs::osc::{self, Datagrams, Osc};
use mien_outputs::serial::{self, Encoder};
use mien_outputs::{Output, Report, TrackingState, View};
use mien_sensors::kinect::calibration::{Block, emit_block, emit_fixed};
use mien_sensors::kinect::registration::Registration;
use mien_sensors::kinect::command::{Command, emit_command, emit_reply};
use mien_sensors::kinect::device::{Model, Stream};
use mien_sensors::kinect::packet::LONGEST;
use mien_sensors::kinect::recording::Recorder;
use mien_sensors::kinect::stream::Cutter;
use mien_sensors::kinect::frame::KinectFrame;
use mien_appliance::source;
use mien_appliance::settings::Settings;
use mien_baking::bake::mesh::{Corner, Mesh, Vec3};
use mien_baking::bake::shape::Shape;
use mien_baking::bake::{morphs, obj, recipe};
use mien_stages::base::time::Timestamp;
use mien_stages::users::saved;

const UNITS: [&str; 3] = ["AU25", "AU12L", "AU12R"];

struct Corpus(PathBuf);

impl Corpus {
    fn add(&self, parser: &str, name: &str, bytes: impl AsRef<[u8]>) {
        let folder = self.0.join(parser);
        fs::create_dir_all(&folder).expect("a folder");
        fs::write(folder.join(name), bytes).expect("a seed");
    }
}

/// Keeps datagrams.
struct Kept(Arc<Mutex<Vec<Vec<u8>>>>);

impl Datagrams for Kept {
    fn send(&mut self, datagram: &[u8]) -> bool {
        self.0.lock().expect("nobody panicked").push(datagram.to_vec());
        true
    }
}

fn report(ms: u64) -> Report<'static> {
    Report {
        at: Timestamp::from_us(1000 * ms),
        user: Some(0),
        state: TrackingState::Tracking,
        confidence: 0.9,
        weights: &[0.25, 0.5, 1.0],
        measures: &[0.1, 0.2],
        ..Report::default()
    }
}

/// Lines of a TOML file that say something.
fn bare(text: &str) -> String {
    let lines = text.lines().filter(|line| !line.trim().is_empty() && !line.starts_with('#'));
    lines.flat_map(|line| [line.split("  #").next().unwrap_or_default().trim_end(), "\n"]).collect()
}

/// A text cut where each of its parts begins.
fn parts(text: &str, begin: &str) -> Vec<String> {
    let mut parts: Vec<String> = text.split(begin).map(|part| format!("{part}\n")).collect();
    parts.iter_mut().skip(1).for_each(|part| part.insert_str(0, &begin[1..]));
    parts
}

/// Writes them.
pub fn write(folder: &Path) {
    let corpus = Corpus(folder.into());

    // What takes a millisecond to read is not read ten million times: texts come in parts, without their comments. All of the
    // settings are printed and read again besides.
    let defaults = bare(&Settings::default().to_toml());
    for (k, section) in parts(&defaults, "\n[").iter().enumerate() {
        corpus.add("settings", &format!("section{k}"), section);
    }
    // Shapes of every kind: those that bring a key none before them has.
    let mut keys = Vec::new();
    for (k, shape) in parts(&bare(recipe::SHIPPED), "\n[[").iter().enumerate() {
        let known = keys.len();
        for line in shape.lines() {
            let key = line.split(['=', ',']).next().unwrap_or_default().trim().to_owned();
            if !keys.contains(&key) {
                keys.push(key);
            }
        }
        if keys.len() > known {
            corpus.add("recipe", &format!("shape{k}"), shape);
        }
    }
    let mut text = String::new();
    saved::write(std::iter::empty(), (Timestamp::default(), SystemTime::UNIX_EPOCH), &mut text)
        .expect("a string takes everything");
    corpus.add("people", "nobody", &text);
    corpus.add(
        "people",
        "somebody",
        "mien-people 2\nperson 0 1763720000 0.012 0.00041 - -0.00112\nmien-ranges 1 0.0372\nlip_gap 0.0213 0.0213 0.7961\nchecksum 0\n",
    );

    // A whole model is too long to be changed and read ten million times; its sections begin alike.
    corpus.add("model", "start", &face_model::SHIPPED[..8192]);
    corpus.add("model", "empty", face_model::SHIPPED[..24].iter().chain(&[0; 64]).copied().collect::<Vec<u8>>());

    corpus.add("stages", "count", [20, 0, 0, 0, 255, 255, 255, 127]);
    corpus.add("camera", "json", b"\0{\"depth\": {\"width\": 64, \"height\": 64, \"fx\": 60, \"fy\": 60, \"cx\": 32, \"cy\": 32, \"metres_per_unit\": 0.001}}");
    corpus.add("camera", "depth", b"\x011305031102.160407 a.pgm\n1305031102.194330 a.pgm\n");
    corpus.add("film", "grey", [b"YUV4MPEG2 W64 H64 F25:1 Ip A1:1 Cmono\nFRAME\n".as_slice(), &[90; 64 * 64]].concat());
    corpus.add("camera", "picture", b"\x02# colour\n0.001 b.pgm\n0.034 b.pgm\n");
    recording(&corpus);
    usb(&corpus);
    wires(&corpus);

    let mut rows = Rows::new(&["lip_gap", "eye_distance"], &UNITS, &[]);
    let mut table = rows.text().to_owned();
    for ms in [0, 33, 66] {
        rows.fill(&report(ms));
        table += rows.text();
    }
    corpus.add("table", "run", table);
    corpus.add("tracks", "two", "1.5,2,3\n4,5,\n1,nan,3\n4,5,6\n");
    corpus.add("tracks", "shape", "1,2\n3,4\n5,6\n");
    let points: String = (0..68).map(|k| format!("{k}.5 {}\n", 2 * k)).collect();
    corpus.add("landmarks", "pts", format!("version: 1\nn_points: 68\n{{\n{points}}}\n"));
    let names: String = (0..68).map(|k| format!(",x{k},y{k}")).collect();
    let cells = ",1.5,2".repeat(68);
    corpus.add("landmarks", "csv", format!("file{names}\na.pgm{cells}\n"));

    corpus.add("controls", "two", "shape,vertex,dx,dy,dz\njawOpen,5,0,-.5,-.1\njawOpen,6,0,-1e-3,0\n\nmouthA,6,0,0,1,more\n");
    corpus.add("numbers", "four", "# right to left\n0\n17\n\n 63\n18446744073709551615\n");

    let (mesh, shapes) = head();
    corpus.add("obj", "sheet", obj::emit(&mesh));
    corpus.add("obj", "quads", "o a\nv 0 0 0\nv 1 0 0 .5 .5 .5\nv 1 1 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nusemtl s\nf 1/1/1 2/1/1 3//1 -1\n");
    corpus.add("mtl", "skin", "newmtl the skin\nKd 0.8 .7 0.6\nd 1.0\nTr 0\nmap_Kd -o 1 0 -imfchan r a picture.png\nnewmtl s\nmap_Kd ../b.jpg\n");
    for dense in [false, true] {
        let mut glb = morphs::build(&mesh, &shapes, 1.0, dense, None);
        glb.json["extensions"] = serde_json::json!({
            "VRM": {"blendShapeMaster": {"blendShapeGroups": [{"name": "A", "binds": []}]}},
            "VRMC_vrm": {"expressions": {"preset": {"aa": {}}, "custom": {"b": {}}}},
        });
        corpus.add("glb", if dense { "dense" } else { "sparse" }, glb.emit());
    }
    for (name, path) in [("page", "/"), ("picture", "/picture?n=3"), ("mesh", "/mesh/0")] {
        let headers = "Host: 127.0.0.1:9180\r\nSec-Fetch-Site: same-origin\r\nOrigin: http://127.0.0.1:9180\r\n";
        corpus.add("http", name, format!("GET {path} HTTP/1.1\r\n{headers}\r\n"));
    }
}

fn recording(corpus: &Corpus) {
    let folder = std::env::temp_dir().join(format!("mien-seeds-{}", std::process::id()));
    let mut source = source::simulated(None).expect("the simulated sensor");
    let mut recorder =
        Recorder::create(&folder, source.registration().expect("a Kinect"), 1.0e9).expect("a recording");
    let mut frame = KinectFrame::default();
    for _ in 0..2 {
        source.next_frame(&mut frame).expect("a frame");
        recorder.write(&frame).expect("a frame is written");
    }
    drop(recorder);
    for entry in fs::read_dir(&folder).expect("the recording") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().expect("a name").to_string_lossy().into_owned();
        let which = match &name[..1] {
            "I" => 0,
            "d" if name.ends_with(".pgm") => 1,
            "r" => 2,
            _ => 3,
        };
        let bytes = fs::read(&path).expect("readable");
        // Pictures are told apart by their headers; what follows is numbers.
        let kept = bytes.len().min(4096);
        corpus.add("recording", &name, [&[which], &bytes[..kept]].concat());
    }
    fs::remove_dir_all(folder).expect("removed");
}

fn usb(corpus: &Corpus) {
    let registration = Registration::default();
    for (name, block) in [
        ("const_shift", Block::ConstShift),
        ("padding", Block::Padding),
        ("registration", Block::Registration),
    ] {
        let body = emit_block(block, &registration);
        corpus.add("usb_reply", name, &body);
        let mut bytes = Vec::new();
        emit_reply(Command::AlgorithmParameters, 1, &body, &mut bytes);
        corpus.add("usb_reply", &format!("{name}_reply"), &bytes);
    }
    corpus.add("usb_reply", "fixed", emit_fixed(&registration, Model::Xbox1414));
    let mut bytes = Vec::new();
    emit_command(Command::SetParameter, 1, &[6, 2], &mut bytes);
    corpus.add("usb_reply", "command", &bytes);
    for (name, stream) in [("depth", Stream::Depth), ("colour", Stream::Colour)] {
        let mut cutter = Cutter::new(stream, 7);
        let picture = vec![3; 640 * 480 * 2];
        let mut packet = [0; LONGEST];
        let mut bytes = Vec::new();
        for number in 0..3 {
            let length = cutter.cut(&picture, 1_000_000, number, &mut packet);
            bytes.extend((length as u16).to_le_bytes());
            bytes.extend(&packet[..length]);
        }
        corpus.add("packets", name, &bytes);
    }
}

fn wires(corpus: &Corpus) {
    let kept = Arc::new(Mutex::new(Vec::new()));
    let targets = vec![Box::new(Kept(Arc::clone(&kept))) as Box<dyn Datagrams>];
    let settings = osc::Settings { ranges: true, ..osc::Settings::default() };
    let mut osc = Osc::with_targets(targets.into(), settings, &UNITS).expect("an output");
    for ms in [0, 33, 2000] {
        osc.send(&report(ms)).expect("sent");
    }
    drop(osc);
    for (k, datagram) in kept.lock().expect("nobody panicked").iter().enumerate() {
        corpus.add("osc", &k.to_string(), datagram);
    }
    for (name, bytes) in [
        ("forget", b"/face/cmd/forget\0\0\0\0,i\0\0\0\0\0\x01".as_slice()),
        ("freeze", b"/face/cmd/freeze\0\0\0\0,iT\0\0\0\0\x01"),
        ("schema", b"#bundle\0\0\0\0\0\0\0\0\x01\0\0\0\x18/face/cmd/schema\0\0\0\0,\0\0\0"),
    ] {
        corpus.add("osc_commands", name, bytes);
    }
    // A request for a document and one for a WebSocket with its frames, and what
    // a broker says to a client.
    let page = b"GET /0/au?VALUE HTTP/1.1\r\nUpgrade: websocket\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";
    let broker = b"\x20\x02\0\0\x90\x03\0\x01\x01\x32\x11\0\x0amien/cmd/x\0\x07\x00on\xd0\0\x40\x02\0\x09";
    for (parser, name, bytes) in [
        ("web", "page", page.as_slice()),
        ("web", "frames", b"\x89\x84abcdABCD\x81\xfe\0\x80abcd"),
        ("mqtt", "broker", broker),
    ] {
        corpus.add(parser, name, bytes);
    }
    for (name, style) in [
        ("text", serial::Style::Text),
        ("plot", serial::Style::Plot),
        ("cobs", serial::Style::Cobs),
    ] {
        let settings = serial::Settings {
            style,
            pose: true,
            view: View::default(),
            ..serial::Settings::default()
        };
        let mut encoder = Encoder::new(&settings, &UNITS).expect("an encoder");
        let mut bytes = encoder.header().bytes().to_vec();
        for ms in [0, 33] {
            let line = encoder.encode(&report(ms)).expect("a frame");
            bytes.extend(line.bytes());
        }
        corpus.add("serial", name, bytes);
    }
}

/// A sheet of four by four vertices and two shapes.
fn head() -> (Mesh, Vec<Shape>) {
    let mut mesh = Mesh { materials: vec!["skin".into()], ..Mesh::default() };
    for k in 0..16_u8 {
        mesh.positions.push(Vec3::new(f64::from(k % 4), f64::from(k / 4), 0.0));
    }
    for row in 0..3 {
        for column in 0..3 {
            let corner = |k: u32| Corner { vertex: 4 * row + column + k, uv: None, normal: None };
            mesh.push_face(&[corner(0), corner(1), corner(5), corner(4)], 0);
        }
    }
    let shape = |name: &str, moved: usize| {
        let mut displacement = vec![Vec3::zeros(); 16];
        displacement[moved] = Vec3::z();
        Shape {
            misses: None,
            name: name.into(),
            unit: Some("AU26".into()),
            upon: None,
            displacement,
            area: vec![true; 16],
        }
    };
    (mesh, vec![shape("jawOpen", 5), shape("mouthA", 6)])
}
