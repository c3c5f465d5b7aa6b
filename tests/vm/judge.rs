//! Weights that came out of the virtual machine against what the same frames give without a Kinect, USB or a guest.
//!
//! `vm-judge listen PORT FILE` keeps UDP datagrams until it is killed, each behind its length (u32, little endian).
//! `vm-judge compare CSV DATAGRAMS SERIAL` draws the frames that the rows of `mien run --csv` name, runs the pipeline on
//! them, and compares: the rows byte for byte, the weights of the OSC datagrams and of the serial lines with the rows'.
//! Frames that the guest did not get are left out on both sides. Exit code 1 if anything differs or too little came.

use std::collections::BTreeMap;
use std::error::Error;
use std::fs::File;
use std::io::Write;
use std::net::UdpSocket;
use std::process::ExitCode;

use mien::face_model::FaceModel;
use mien::output::Output;
use mien::output::csv::Csv;
use mien::pipeline::Pipeline;
use mien::sensor::{Frame, Source};
use mien::settings::Settings;
use mien::time::Timestamp;
use rosc::{OscPacket, OscType};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Rows with a face that a comparison needs to mean anything.
const ENOUGH: usize = 30;
/// Frames that may be lost before the first row.
const MOST_LOST: u64 = 300;
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
}

fn rows(csv: &str) -> Result<Vec<Row<'_>>> {
    let mut lines = csv.lines();
    let names: Vec<&str> = lines.next().ok_or("the CSV is empty")?.split(',').collect();
    let first = names
        .iter()
        .position(|name| name.starts_with("w_"))
        .ok_or("no weights in the CSV")?;
    lines
        .map(|text| {
            let fields: Vec<&str> = text.split(',').collect();
            let seen = matches!(fields.get(3), Some(&("tracking" | "warming")));
            let weights = seen.then(|| fields[first..].iter().map(|field| field.parse()).collect());
            Ok(Row {
                text,
                frame: fields[0].parse()?,
                at_us: fields.get(1).ok_or("a row without a time")?.parse()?,
                weights: weights.transpose()?,
            })
        })
        .collect()
}

/// What the pipeline makes of the frames that `rows` name, as lines of a CSV. `first`: the scene's frame that the first row
/// is of.
fn direct(rows: &[Row], first: u64, model: &FaceModel) -> Result<Vec<String>> {
    let mut source = Source::simulated(None)?;
    let mut pipeline = Pipeline::new(&Settings::default(), source.registration(), model)?;
    let mut csv = Vec::new();
    let names = (Pipeline::measure_names(), pipeline.unit_names());
    let mut writer = Csv::new(&mut csv, &names.0, &names.1)?;
    let (mut frame, mut drawn) = (Frame::default(), 0);
    for row in rows {
        let number = first + (row.at_us as f64 / FRAME_US).round() as u64;
        while drawn <= number {
            source.next_frame(&mut frame)?;
            drawn += 1;
        }
        (frame.index, frame.at) = (row.frame, Timestamp::from_us(row.at_us));
        pipeline.follow(&frame);
        writer.send(&pipeline.report())?;
    }
    drop(writer);
    let lines = String::from_utf8(csv)?;
    Ok(lines.lines().skip(1).map(str::to_owned).collect())
}

/// The scene's frame that the first row is of: its number, or more if frames before it were lost with their packets. A
/// pipeline's first row depends on that frame alone.
fn first_frame(rows: &[Row], model: &FaceModel) -> Result<u64> {
    let first = rows.first().ok_or("no rows")?;
    let mut source = Source::simulated(None)?;
    let mut frame = Frame::default();
    for number in 0..first.frame + MOST_LOST {
        source.next_frame(&mut frame)?;
        if number < first.frame {
            continue;
        }
        let mut pipeline = Pipeline::new(&Settings::default(), source.registration(), model)?;
        (frame.index, frame.at) = (first.frame, Timestamp::from_us(first.at_us));
        pipeline.follow(&frame);
        let mut csv = Vec::new();
        let names = (Pipeline::measure_names(), pipeline.unit_names());
        Csv::new(&mut csv, &names.0, &names.1)?.send(&pipeline.report())?;
        if String::from_utf8(csv)?.lines().nth(1) == Some(first.text) {
            return Ok(number);
        }
    }
    Err("the first row is of no frame of the scene".into())
}

/// Weights by time in ms, from the datagrams of the schema `native`.
fn from_osc(mut bytes: &[u8]) -> Result<BTreeMap<u64, Vec<f32>>> {
    let mut found = BTreeMap::new();
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
                // Closing repeats a time, with neutral weights.
                found.entry(u64::try_from(ms)?).or_insert(weights);
            }
        }
    }
    Ok(found)
}

/// Weights by time in ms, from the lines `$AU,number,ms,state,confidence,weights…*checksum`.
fn from_serial(bytes: &[u8]) -> BTreeMap<u64, Vec<f32>> {
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
    let mut found = BTreeMap::new();
    for (ms, weights) in String::from_utf8_lossy(bytes).lines().filter_map(read) {
        found.entry(ms).or_insert(weights);
    }
    found
}

/// How many of the wire's frames equal the rows' weights, within `step` after `scale`.
fn equal(name: &str, wire: &BTreeMap<u64, Vec<f32>>, rows: &[Row], scale: f32, step: f32) -> bool {
    let (mut compared, mut different) = (0, 0);
    for row in rows {
        if let (Some(weights), Some(sent)) = (&row.weights, wire.get(&(row.at_us / 1000))) {
            compared += 1;
            let same = sent.len() == weights.len()
                && sent
                    .iter()
                    .zip(weights)
                    .all(|(sent, weight)| (sent - weight.clamp(0.0, 1.0) * scale).abs() <= step);
            different += usize::from(!same);
        }
    }
    let moved = wire.values().flatten().any(|&weight| weight > 0.3 * scale);
    println!(
        "{name}: frames {}, compared {compared}, different {different}, any weight above 0.3 {moved}",
        wire.len()
    );
    compared >= ENOUGH && different == 0 && moved
}

fn compare(csv: &str, datagrams: &str, serial: &str) -> Result<bool> {
    let csv = std::fs::read_to_string(csv)?;
    let rows = rows(&csv)?;
    let model = FaceModel::shipped();
    let first = first_frame(&rows, &model)?;
    let expected = direct(&rows, first, &model)?;
    let unlike = || {
        rows.iter()
            .zip(&expected)
            .filter(|(row, line)| row.text != *line)
    };
    let different = unlike().count();
    let faces = rows.iter().filter(|row| row.weights.is_some()).count();
    println!(
        "rows: {}, with a face {faces}, different from the direct run {different}, the first of them frame {first} of the scene",
        rows.len()
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
    Ok(different == 0 && faces >= ENOUGH && osc && lines)
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    let words: Vec<&str> = arguments.iter().skip(1).map(String::as_str).collect();
    let done = match words[..] {
        ["listen", port, file] => listen(port, file).map(|()| true),
        ["compare", csv, datagrams, serial] => compare(csv, datagrams, serial),
        _ => Err("expected listen PORT FILE or compare CSV DATAGRAMS SERIAL".into()),
    };
    match done {
        Ok(good) => ExitCode::from(u8::from(!good)),
        Err(problem) => {
            eprintln!("vm-judge: {problem}");
            ExitCode::from(2)
        }
    }
}
