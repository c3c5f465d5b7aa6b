//! Promise: `mien send-test` sweeps every unit to every output, one after the other, and names it.
//!
//! It takes half a minute of waiting, so it stands among the first: tests run in the order of their names.

use std::net::UdpSocket;
use std::process::Stdio;
use std::time::Duration;

use mien_stages::expression::Units;
use rosc::{OscMessage, OscType};
use serialport::{SerialPort, TTYPort};

use crate::common::mien;
use crate::talks_to_rigs::{messages, receiver};

/// What a serial port sends until the line of nobody.
fn lines_until_nobody(mut reader: TTYPort) -> String {
    let (mut text, mut bytes) = (String::new(), [0; 4096]);
    let mut quiet = 0;
    // It is over when the line of nobody has come: state and user are 0 there too.
    let nobody = ",0".repeat(2 + Units::shipped().columns(false).len()) + "*";
    while quiet < 400 && !text.lines().any(|line| line.contains(&nobody)) {
        match std::io::Read::read(&mut reader, &mut bytes) {
            Ok(length) => text.push_str(&String::from_utf8_lossy(&bytes[..length])),
            Err(_) => quiet += 1,
        }
    }
    text
}

/// What a socket receives until nobody is present.
fn messages_until_nobody(socket: &UdpSocket) -> Vec<OscMessage> {
    let mut all = Vec::new();
    let mut quiet = 0;
    while quiet < 20 {
        let some = messages(socket);
        quiet = if some.is_empty() { quiet + 1 } else { 0 };
        let last = some
            .last()
            .is_some_and(|m| m.addr == "/face/0/present" && m.args == [OscType::Int(0)]);
        all.extend(some);
        if last {
            break;
        }
    }
    all
}

#[test]
fn send_test_sweeps_every_unit_and_names_it() {
    let socket = receiver("127.0.0.1:0");
    let (mut reader, port) = TTYPort::pair().unwrap();
    reader.set_timeout(Duration::from_millis(50)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mien.toml");
    let configuration = format!(
        "[osc]\ntarget = \"{}\"\n[serial]\nport = \"{}\"\n[units]\nAU26.name = \"jaw\"\n[log]\nlevel = \"error\"\n",
        socket.local_addr().unwrap(),
        port.name().unwrap()
    );
    std::fs::write(&path, configuration).unwrap();
    let child = mien("send-test --config")
        .arg(&path)
        .stderr(Stdio::piped())
        .stdin(Stdio::null())
        .spawn()
        .unwrap();
    let lines = std::thread::spawn(move || lines_until_nobody(reader));
    let heard = std::thread::spawn(move || messages_until_nobody(&socket));
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    let log = String::from_utf8(output.stderr).unwrap();
    let (heard, text) = (heard.join().unwrap(), lines.join().unwrap());
    let schema = heard.iter().find(|m| m.addr == "/face/schema").unwrap();
    let names = schema.args[1..].iter();
    let names: Vec<String> = names.map(|name| name.clone().string().unwrap()).collect();
    assert!(names.len() >= 19 && names.contains(&"jaw".to_owned()));
    let floats = |args: &[OscType]| -> Vec<f32> {
        let floats = args.iter().map(|arg| arg.clone().float().unwrap());
        floats.collect()
    };
    let vectors = heard.iter().filter(|m| m.addr == "/face/0/au");
    let vectors: Vec<Vec<f32>> = vectors.map(|m| floats(&m.args)).collect();
    let is_rest = |vector: &Vec<f32>| vector.iter().all(|&weight| weight == 0.0);
    let mut at = 0;
    for (i, name) in names.iter().enumerate() {
        let logged = if name == "jaw" {
            "AU26 jaw drop as jaw ("
        } else {
            &format!("{name} ")
        };
        assert!(log.contains(logged), "{logged} not in {log}");
        // Up to 1 and down again, all others at rest, one unit after the other.
        let peak = vectors[at..].iter().position(|vector| vector[i] == 1.0);
        at += peak.unwrap_or_else(|| panic!("{name} does not come to 1 in its turn"));
        let mut others = vectors[at].iter().enumerate().filter(|&(j, _)| j != i);
        assert!(others.all(|(_, &weight)| weight == 0.0));
        assert!(vectors[at..].iter().any(is_rest));
    }
    assert!(is_rest(vectors.last().unwrap()));
    let full = text
        .lines()
        .filter(|line| line.starts_with("$AU,") && (line.contains(",100") || line.contains(",93")));
    // A port that is late shows the newest frame: of the three around a peak one may be left out.
    let full = full.count();
    assert!(full >= names.len(), "{full} peaks on the serial port");
}
