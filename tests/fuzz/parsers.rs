//! One program for all parsers; `MIEN_FUZZ` names the one that is fed. A panic, a hang or too much memory is a find.
//! With `MIEN_FUZZ_SEEDS` it writes the first inputs into that folder and ends.
#![no_main]

mod seeds;
#[path = "../common/small_model.rs"]
mod small_model;

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::time::SystemTime;

use libfuzzer_sys::{fuzz_mutator, fuzz_target, fuzzer_mutate};
use mien_stages::base::checksum::crc32;
use mien_stages::expression::saved::Learned;
use mien_stages::face_model::FaceModel;
use mien_stages::face_model::refinement;
use mien_outputs::csv::columns::Columns;
use mien_outputs::osc::{self, commands};
use mien_outputs::serial;
use mien_sensors::kinect::calibration::{self, Block};
use mien_sensors::kinect::registration::Registration;
use mien_sensors::kinect::command::{self, Command};
use mien_sensors::kinect::device::{Model, Stream};
use mien_sensors::kinect::stream::Assembler;
use mien_appliance::pipeline::Pipeline;
use mien_sensors::Frame;
use mien_appliance::source;
use mien_appliance::settings::Settings;
use mien_baking::bake::glb::Glb;
use mien_baking::bake::looks::Looks;
use mien_baking::bake::{self, obj};
use mien_baking::bake::patch::ImportedGltf;
use mien_baking::bake::recipe::Recipe;
use mien_training::nrsfm::{Shapes, Tracks};
use mien_studio::preview::hub::Hub;
use mien_studio::preview::http;
use mien_workbench::text_files;
use mien_stages::users::saved;
use serde_json::{Value, json};

static PARSER: LazyLock<String> =
    LazyLock::new(|| std::env::var("MIEN_FUZZ").expect("MIEN_FUZZ names a parser"));
/// Folders are read from memory.
static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
    let shared = Path::new("/dev/shm");
    let root = if shared.is_dir() { shared.into() } else { std::env::temp_dir() };
    root.join(format!("mien-fuzz-{}", std::process::id()))
});

fuzz_target!(init: {
    if let Some(folder) = std::env::var_os("MIEN_FUZZ_SEEDS") {
        seeds::write(Path::new(&folder));
        std::process::exit(0);
    }
}, |bytes: &[u8]| {
    let words = || text_files::decoded(bytes);
    match PARSER.as_str() {
        "settings" => {
            // Printing and reading all of them takes a hundred times as long as reading a few: one in sixty-four.
            if let Ok(settings) = Settings::parse(&words(), Path::new("fuzz.toml"))
                && crc32(bytes).is_multiple_of(64)
            {
                let printed = settings.clone().to_toml();
                let again = Settings::parse(&printed, Path::new("again.toml"));
                assert_eq!(again.as_ref(), Ok(&settings), "what is printed is accepted");
            }
        }
        "recipe" => drop(Recipe::read(&words())),
        "people" => {
            let text = words();
            drop(Learned::read(&text));
            // The checksum is no obstacle.
            let end = text.trim_end().rfind('\n').map_or(0, |at| at + 1);
            let sum = crc32(&text.as_bytes()[..end]);
            drop(saved::read(&text, SystemTime::now()));
            let summed = format!("{}checksum {sum:08x}\n", &text[..end]);
            drop(saved::read(&summed, SystemTime::now()));
        }
        "model" => {
            drop(FaceModel::read(bytes));
            drop(refinement::Refinement::parse(bytes, 8));
            if bytes.len() > 24 {
                // Length and checksum are no obstacle.
                let mut whole = bytes.to_vec();
                whole[12..20].copy_from_slice(&(bytes.len() as u64).to_le_bytes());
                let body = bytes.len() - 4;
                let sum = crc32(&whole[..body]).to_le_bytes();
                whole[body..].copy_from_slice(&sum);
                drop(FaceModel::read(&whole));
            }
        }
        // A small whole model whose numbers are changed, behind a valid checksum, and the stages that are built from it.
        "stages" => {
            let mut whole = SMALL.clone();
            for change in bytes.chunks_exact(8) {
                let [a, b, c, value @ ..] = change else { continue };
                let at = u32::from_le_bytes([*a, *b, *c, 0]) as usize % (whole.len() - 28);
                let value = match value[0] % 4 {
                    0 => value[1..].try_into().expect("four bytes"),
                    1 => ODD[usize::from(value[1]) % ODD.len()].to_le_bytes(),
                    _ => [value[1], 0, 0, 0],
                };
                whole[20 + at..24 + at].copy_from_slice(&value);
            }
            let body = whole.len() - 4;
            let sum = crc32(&whole[..body]).to_le_bytes();
            whole[body..].copy_from_slice(&sum);
            if let Ok(model) = FaceModel::read(&whole) {
                drop(Pipeline::check(&Settings::default().stages, &model));
            }
        }
        "recording" => recording(bytes),
        "camera" => camera(bytes),
        "film" => film(bytes),
        "usb_reply" => {
            for command in [Command::FixedParameters, Command::AlgorithmParameters] {
                let _ = black_box(command::parse_reply(bytes, command, 1));
            }
            let _ = black_box(command::parse_command(bytes));
            let mut registration = Registration::default();
            for block in [Block::ConstShift, Block::Padding, Block::Registration] {
                let _ = black_box(calibration::parse_block(block, bytes, &mut registration));
            }
            for model in [Model::Xbox1414, Model::Windows1517] {
                let _ = black_box(calibration::parse_fixed(bytes, model));
            }
        }
        "packets" => {
            for stream in [Stream::Depth, Stream::Colour] {
                let mut assembler = Assembler::new(stream);
                let mut rest = bytes;
                while let Some((&[low, high], after)) = rest.split_first_chunk() {
                    let length = usize::from(u16::from_le_bytes([low, high & 0x07]));
                    let (packet, after) = after.split_at(length.min(after.len()));
                    assembler.push(high & 0x80 == 0, packet);
                    rest = after;
                }
            }
        }
        "osc_commands" => {
            let mut taken = 0;
            commands::requests(bytes, "/face", &mut |_| {
                taken += 1;
                taken < 16
            });
        }
        "osc" => {
            let hub = Hub::new(false);
            osc::receiver::Receiver::default().take(bytes, &hub);
        }
        "serial" => {
            let hub = Hub::new(false);
            serial::receiver::Receiver::new(100.0).take(bytes, &hub);
        }
        "table" => {
            let text = words();
            let mut lines = text.lines();
            let header = lines.next().unwrap_or_default();
            if let Some(mut table) = Columns::new(header) {
                lines.for_each(|line| drop(table.row(line)));
            }
        }
        "tracks" => {
            drop(Tracks::parse(&words()));
            drop(Shapes::parse(&words()));
        }
        "landmarks" => {
            // As a table and as points of a picture; most of the time goes into the files, so one of them each time.
            let (name, file) = match crc32(bytes) % 2 {
                0 => ("table", "landmarks68.csv"),
                _ => ("points", "a.pts"),
            };
            let folder = FOLDER.join(name);
            if !folder.is_dir() {
                std::fs::create_dir_all(&folder).expect("a folder");
                std::fs::write(folder.join("a.pgm"), b"P5 1 1 255\n.").expect("a picture");
            }
            std::fs::write(folder.join(file), bytes).expect("a file");
            drop(mien_workbench::dataset::read_folder(&folder));
        }
        "obj" => {
            let text = words();
            if let Ok(mesh) = obj::parse(&text) {
                let printed = obj::with_positions(&text, &mesh.positions);
                assert!(obj::parse(&printed).is_ok(), "what is printed is accepted");
            }
        }
        "mtl" => black_box(Looks::default()).add(&words(), &FOLDER),
        "glb" => {
            if let Ok(glb) = Glb::parse(bytes) {
                if let Ok((mesh, imported)) = ImportedGltf::read(glb) {
                    let out = imported.patched(&mesh, &[], false).emit();
                    assert!(Glb::parse(&out).is_ok(), "what is written is accepted");
                }
            }
        }
        "controls" => {
            drop(bake::table::targets(&words(), Path::new("fuzz.csv"), 64, true));
        }
        "numbers" => drop(bake::source::landmarks(&words(), Path::new("fuzz.txt"))),
        "http" => drop(http::parse(bytes, ([127, 0, 0, 1], 9).into())),
        // Their entrances are there only where the compiler is told that this is fuzzing.
        #[cfg(fuzzing)]
        "web" => mien_outputs::web::fuzz(bytes),
        #[cfg(fuzzing)]
        "mqtt" => mien_outputs::mqtt::fuzz(bytes),
        other => panic!("no parser is called {other}"),
    }
});

/// Numbers that are none of a head.
const ODD: [f32; 8] = [1e6, -1e3, 0.31, f32::NAN, f32::INFINITY, 1e-30, 0.0, -0.0];
/// Built-in shape and head without the cascade, whose weights are not looked at when stages are built.
static SMALL: LazyLock<Vec<u8>> = LazyLock::new(small_model::small_model);

/// The first byte says which file of a depth camera's recording the rest is.
fn camera(bytes: &[u8]) {
    let Some((which, rest)) = bytes.split_first() else { return };
    let folder = FOLDER.join("camera");
    std::fs::create_dir_all(&folder).expect("a folder");
    let camera: &[u8] = b"{\"depth\": {\"width\": 64, \"height\": 64, \"fx\": 60, \"fy\": 60, \"cx\": 32, \"cy\": 32}}";
    let names = ["camera.json", "depth.txt", "rgb.txt"];
    for (name, text) in names.into_iter().zip([camera, b"0.0 a.pgm\n0.1 a.pgm\n", b"0.0 b.pgm\n"]) {
        std::fs::write(folder.join(name), text).expect("a file");
    }
    std::fs::write(folder.join(names[usize::from(which % 3)]), rest).expect("a file");
    if let Ok(mut source) = source::recording(&folder) {
        drop(source.next_frame(&mut Frame::default()));
    }
}

/// A film from a file.
fn film(bytes: &[u8]) {
    std::fs::create_dir_all(&*FOLDER).expect("a folder");
    let path = FOLDER.join("film.y4m");
    std::fs::write(&path, bytes).expect("a file");
    if let Ok(mut source) = source::recording(&path) {
        while let Ok(true) = source.next_frame(&mut Frame::default()) {}
    }
}

/// The first byte says which file of a recording the rest is.
fn recording(bytes: &[u8]) {
    let Some((which, rest)) = bytes.split_first() else { return };
    let folder = &*FOLDER;
    std::fs::create_dir_all(folder).expect("a folder");
    let depth = ("d-1.000000-1000000.pgm", b"P5 640 480 65535\n".as_slice());
    let colour = ("r-1.000000-1000000.ppm", b"P6 640 480 255\n".as_slice());
    let index = ("INDEX.txt", b"d-1.000000-1000000.pgm\nr-1.000000-1000000.ppm\n".as_slice());
    for (name, head) in [depth, colour, index] {
        std::fs::write(folder.join(name), head).expect("a file");
    }
    let name = match which % 4 {
        0 => index.0,
        1 => depth.0,
        2 => colour.0,
        _ => "device.json",
    };
    let _ = std::fs::remove_file(folder.join("device.json"));
    std::fs::write(folder.join(name), rest).expect("a file");
    if let Ok(mut source) = source::recording(folder) {
        let mut frame = Frame::default();
        for _ in 0..8 {
            if !matches!(source.next_frame(&mut frame), Ok(true)) {
                break;
            }
        }
    }
}

fuzz_mutator!(|data: &mut [u8], size: usize, max_size: usize, seed: u32| {
    let mut random = fastrand::Rng::with_seed(seed.into());
    if PARSER.as_str() == "glb"
        && random.u8(..4) > 0
        && let Ok(mut glb) = Glb::parse(&data[..size])
    {
        swap_types(&mut glb.json, &mut random);
        let out = glb.emit();
        if out.len() <= max_size {
            data[..out.len()].copy_from_slice(&out);
            return out.len();
        }
    }
    fuzzer_mutate(data, size, max_size)
});

/// Gives some value in a description another type, or that of another place.
fn swap_types(json: &mut Value, random: &mut fastrand::Rng) {
    fn paths(json: &Value, at: String, all: &mut Vec<String>) {
        match json {
            Value::Object(map) => map.iter().for_each(|(k, v)| paths(v, format!("{at}/{k}"), all)),
            Value::Array(list) => {
                let numbered = list.iter().enumerate();
                numbered.for_each(|(k, v)| paths(v, format!("{at}/{k}"), all));
            }
            _ => {}
        }
        all.push(at);
    }
    let mut all = Vec::new();
    paths(json, String::new(), &mut all);
    let other = json.pointer(&all[random.usize(..all.len())]).cloned();
    let odd = match random.u8(..12) {
        0 => Value::Null,
        1 => json!(true),
        2 => json!(-1),
        3 => json!(random.u64(..)),
        4 => json!(random.u8(..)),
        5 => json!(1.5e300),
        6 => json!("x"),
        7 => json!([1]),
        8 => json!({}),
        9 => json!(50_000_000),
        _ => other.unwrap_or_default(),
    };
    // Values grow when they are put into each other; not for ever.
    if odd.to_string().len() < 4096
        && let Some(place) = json.pointer_mut(&all[random.usize(..all.len())])
    {
        *place = odd;
    }
}
