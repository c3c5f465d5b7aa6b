//! Weights that came out of the virtual machine against what the same frames give without a Kinect, USB or a guest.
//!
//! `vm-judge listen PORT FILE` keeps UDP datagrams until it is killed, each behind its length (u32, little endian).
//! `vm-judge compare CSV DATAGRAMS SERIAL` draws the frames that the rows of `mien run --csv` name, runs the pipeline on
//! them, and compares: the rows byte for byte, the weights of the OSC datagrams and of the serial lines with the rows'.
//! Frames that the guest did not get are left out on both sides. Exit code 1 if anything differs, 3 if nothing does but a
//! busy host let so few frames through that hardly a face could be followed, here as there.

use std::collections::{BTreeMap, VecDeque};
use std::error::Error;
use std::fs::File;
use std::io::Write;
use std::net::UdpSocket;
use std::process::ExitCode;

use mien_appliance::pipeline::Pipeline;
use mien_appliance::settings::Settings;
use mien_appliance::source::{self, Source};
use mien_outputs::Output;
use mien_outputs::csv::Csv;
use mien_sensors::Frame;
use mien_stages::base::time::Timestamp;
use mien_stages::camera::Camera;
use mien_stages::face_model::FaceModel;
use rosc::{OscPacket, OscType};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Exit codes.
const DIFFERS: u8 = 1;
const TOO_LITTLE: u8 = 3;
/// Rows with a face that a comparison needs to mean anything.
const ENOUGH: usize = 30;
/// Frames that may be lost before the first row.
const MOST_LOST: u64 = 300;
/// Rows in a gap of whose frames it is tried which had colour.
const MOST_UNSURE: usize = 6;
/// Half a step of the CSV's six decimals.
const CSV_STEP: f32 = 0.6e-6;
/// Time between frames of the simulated sensor, µs.
const FRAME_US: f64 = 1e6 / 30.0;

fn listen(port: &str, file: &str) -> Result<()> {
    let socket = UdpSocket::bind(format!("127.0.0.1:{port}"))?;
    let mut file = File::create(file)?;
    let mut buffer = vec![0; 65_536];
    loop {
        let n = socket.recv(&mut buffer)?;
        file.write_all(&(n as u32).to_le_bytes())?;
        file.write_all(&buffer[..n])?;
    }
}

/// One row of the CSV.
struct Row<'a> {
    text: &'a str,
    frame: u64,
    at_us: u64,
    /// Weights, if a face is seen in this very frame: only then the wires carry them as they are.
    weights: Option<Vec<f32>>,
    state: &'a str,
    /// Whether the frame's colour was lost: so for a head followed by depth alone, for the scene hides no face. A head held
    /// or lost may be due to that or to a gap in the frames; [`compare`] tries both.
    colourless: bool,
}

fn rows(csv: &str) -> Result<Vec<Row<'_>>> {
    let mut lines = csv.lines();
    let names: Vec<&str> = lines.next().ok_or("the CSV is empty")?.split(',').collect();
    let first = names
        .iter()
        .position(|name| name.starts_with("w_"))
        .ok_or("no weights in the CSV")?;
    // The head's box comes after them.
    let units = names.iter().filter(|name| name.starts_with("w_")).count();
    lines
        .map(|text| {
            let fields: Vec<&str> = text.split(',').collect();
            let state = *fields.get(3).ok_or("a row without a state")?;
            let seen = matches!(state, "tracking" | "warming");
            let weights = seen.then(|| {
                let weights = fields.iter().skip(first).take(units);
                weights.map(|field| field.parse()).collect()
            });
            Ok(Row {
                text,
                frame: fields[0].parse()?,
                at_us: fields.get(1).ok_or("a row without a time")?.parse()?,
                weights: weights.transpose()?,
                state,
                colourless: state == "posed",
            })
        })
        .collect()
}

/// Frames after the first row's at which this one's was taken.
fn since_first(row: &Row) -> usize {
    (row.at_us as f64 / FRAME_US).round() as usize
}

/// What a new pipeline makes of the frames that `rows` name, as lines of a CSV. `frame_of` gives the frame so many after the
/// first row's.
fn direct(
    rows: &[Row],
    camera: &Camera,
    model: &FaceModel,
    mut frame_of: impl FnMut(usize) -> Result<Frame>,
) -> Result<Vec<String>> {
    let mut pipeline = Pipeline::new(&Settings::default().stages, camera, model)?;
    let mut csv = Vec::new();
    let names = (Pipeline::measure_names(), pipeline.unit_names());
    let mut writer = Csv::new(&mut csv, &names.0, &names.1, &[])?;
    for row in rows {
        let mut frame = frame_of(since_first(row))?;
        (frame.index, frame.at) = (row.frame, Timestamp::from_us(row.at_us));
        frame.has_colour &= !row.colourless;
        pipeline.follow(&frame);
        writer.send(&pipeline.report())?;
    }
    drop(writer);
    let lines = String::from_utf8(csv)?;
    Ok(lines.lines().skip(1).map(str::to_owned).collect())
}

/// The scene from its first frame, with the frames that the guest's may be told by.
struct Scene {
    source: Source,
    /// The oldest is frame `first` of the scene.
    frames: VecDeque<Frame>,
    first: u64,
}

impl Scene {
    fn new() -> Result<Self> {
        Ok(Self {
            source: source::simulated(None)?,
            frames: VecDeque::new(),
            first: 0,
        })
    }

    /// Goes on until the oldest frame kept is `number`, and the `ahead` after it are there.
    fn go_to(&mut self, number: u64, ahead: usize) -> Result<()> {
        while self.first < number || self.frames.len() <= ahead {
            let mut frame = Frame::default();
            self.source.next_frame(&mut frame)?;
            self.frames.push_back(frame);
            if self.first < number {
                self.frames.pop_front();
                self.first += 1;
            }
        }
        Ok(())
    }
}

/// The scene's frame that the first row is of: its number, or more if frames before it were lost with their packets. It is
/// told by the rows until the first with a face: those before it say nothing. `None`: no frame of the scene gives these rows.
fn first_frame(rows: &[Row], model: &FaceModel) -> Result<Option<u64>> {
    let first = rows.first().ok_or("no rows")?.frame;
    let told = rows.iter().position(|row| row.weights.is_some());
    let told = &rows[..told.map_or(rows.len(), |face| face + 1)];
    let ahead = since_first(&told[told.len() - 1]);
    let mut scene = Scene::new()?;
    let camera = scene.source.camera().clone();
    for number in first..first + MOST_LOST {
        scene.go_to(number, ahead)?;
        let lines = direct(told, &camera, model, |at| Ok(scene.frames[at].clone()))?;
        if told.iter().zip(&lines).all(|(row, line)| row.text == line) {
            return Ok(Some(number));
        }
    }
    Ok(None)
}

/// Weights by time in ms. Several reports may have the same time, because a report of nobody has the clock's time; all are kept.
type Wire = BTreeMap<u64, Vec<Vec<f32>>>;

/// Weights from the datagrams of the schema `native`.
fn from_osc(mut bytes: &[u8]) -> Result<Wire> {
    let mut found = Wire::new();
    while let Some((length, rest)) = bytes.split_first_chunk::<4>() {
        let (datagram, rest) = rest.split_at(u32::from_le_bytes(*length) as usize);
        bytes = rest;
        let OscPacket::Bundle(bundle) = rosc::decoder::decode_udp(datagram)?.1 else {
            continue;
        };
        let mut ms = None;
        for packet in bundle.content {
            let OscPacket::Message(message) = packet else {
                continue;
            };
            if message.addr.ends_with("/0/frame") {
                ms = message
                    .args
                    .get(1)
                    .and_then(|argument| argument.clone().int());
            } else if message.addr.ends_with("/0/au")
                && let Some(ms) = ms
            {
                let weights = message
                    .args
                    .into_iter()
                    .filter_map(OscType::float)
                    .collect();
                found.entry(u64::try_from(ms)?).or_default().push(weights);
            }
        }
    }
    Ok(found)
}

/// Weights from the lines `$AU,number,ms,state,confidence,weights…*checksum`.
fn from_serial(bytes: &[u8]) -> Wire {
    let read = |line: &str| {
        let (body, checksum) = line.strip_prefix('$')?.split_once('*')?;
        let expected = body.bytes().fold(0, |all, byte| all ^ byte);
        if u8::from_str_radix(checksum.trim(), 16) != Ok(expected) {
            return None;
        }
        let mut fields = body.strip_prefix("AU,")?.split(',').skip(1);
        let ms = fields.next()?.parse().ok()?;
        let weights: Option<Vec<f32>> = fields.skip(2).map(|field| field.parse().ok()).collect();
        Some((ms, weights?))
    };
    let mut found = Wire::new();
    for (ms, weights) in String::from_utf8_lossy(bytes).lines().filter_map(read) {
        found.entry(ms).or_default().push(weights);
    }
    found
}

fn faces(rows: &[Row]) -> usize {
    rows.iter().filter(|row| row.weights.is_some()).count()
}

/// How many of the wire's frames equal the rows' weights, within `step` after `scale`.
fn equal(name: &str, wire: &Wire, rows: &[Row], scale: f32, step: f32) -> bool {
    let faces = faces(rows);
    let (mut compared, mut different) = (0, 0);
    for row in rows {
        if let (Some(weights), Some(sent)) = (&row.weights, wire.get(&(row.at_us / 1000))) {
            compared += 1;
            let equals = |sent: &Vec<f32>| {
                let mut pairs = sent.iter().zip(weights);
                sent.len() == weights.len()
                    && pairs
                        .all(|(sent, weight)| (sent - weight.clamp(0.0, 1.0) * scale).abs() <= step)
            };
            let same = sent.iter().any(equals);
            if !same && different == 0 {
                println!("{name}: at {} us sent {sent:?} for {}", row.at_us, row.text);
            }
            different += usize::from(!same);
        }
    }
    let moved = wire
        .values()
        .flatten()
        .flatten()
        .any(|&weight| weight > 0.3 * scale);
    println!(
        "{name}: frames {}, compared {compared}, different {different}, any weight above 0.3 {moved}",
        wire.len()
    );
    // Where a frame's colour was lost a wire may show the held face for another one.
    let held = rows
        .iter()
        .filter(|row| matches!(row.state, "posed" | "held"))
        .count();
    compared >= ENOUGH.min(faces) && different <= held && (moved || faces < ENOUGH)
}

fn compare(csv: &str, datagrams: &str, serial: &str) -> Result<u8> {
    let csv = std::fs::read_to_string(csv)?;
    let mut rows = rows(&csv)?;
    let model = FaceModel::shipped();
    let told = first_frame(&rows, &model)?;
    let first = told.unwrap_or(rows[0].frame);
    let camera = Scene::new()?.source.camera().clone();
    // The rows before the first difference that tell nothing of their colour, and which of them are tried without it.
    let (mut differs, mut without) = (0, 0_u32);
    let expected = loop {
        let mut scene = Scene::new()?;
        let expected = direct(&rows, &camera, &model, |at| {
            scene.go_to(first + at as u64, 0)?;
            Ok(scene.frames[0].clone())
        })?;
        let unlike = |(row, line): (&Row, &String)| row.text != line;
        let Some(at) = rows.iter().zip(&expected).position(unlike) else {
            break expected;
        };
        if at > differs {
            (differs, without) = (at, 0);
        }
        let face = rows[..differs]
            .iter()
            .rposition(|row| row.weights.is_some());
        let mut unsure: Vec<&mut Row> = rows[face.map_or(0, |face| face + 1)..=differs]
            .iter_mut()
            .filter(|row| matches!(row.state, "held" | "lost"))
            .collect();
        without += 1;
        if unsure.len() > MOST_UNSURE || without >> unsure.len() != 0 {
            break expected;
        }
        for (bit, row) in unsure.iter_mut().enumerate() {
            row.colourless = without >> bit & 1 == 1;
        }
    };
    let unlike = || {
        rows.iter()
            .zip(&expected)
            .filter(|(row, line)| row.text != *line)
    };
    let different = unlike().count();
    let faces = faces(&rows);
    println!(
        "rows: {}, with a face {faces}, different from the direct run {different}, the first of them frame {first} of the scene{}",
        rows.len(),
        told.map_or(" by its number: no frame gives these rows", |_| "")
    );
    if let Some((row, line)) = unlike().next() {
        println!("guest  {}\ndirect {line}", row.text);
    }
    let osc = equal(
        "osc",
        &from_osc(&std::fs::read(datagrams)?)?,
        &rows,
        1.0,
        CSV_STEP,
    );
    let lines = equal(
        "serial",
        &from_serial(&std::fs::read(serial)?),
        &rows,
        100.0,
        0.5 + CSV_STEP * 100.0,
    );
    Ok(match different == 0 && osc && lines {
        false => DIFFERS,
        true if faces < ENOUGH => TOO_LITTLE,
        true => 0,
    })
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    let words: Vec<&str> = arguments.iter().skip(1).map(String::as_str).collect();
    let done = match words[..] {
        ["listen", port, file] => listen(port, file).map(|()| 0),
        ["compare", csv, datagrams, serial] => compare(csv, datagrams, serial),
        _ => Err("expected listen PORT FILE or compare CSV DATAGRAMS SERIAL".into()),
    };
    match done {
        Ok(code) => ExitCode::from(code),
        Err(problem) => {
            eprintln!("vm-judge: {problem}");
            ExitCode::from(2)
        }
    }
}
