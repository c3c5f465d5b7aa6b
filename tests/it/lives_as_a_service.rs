//! A run under a service manager: it says when it is ready, feeds the watchdog, reads its configuration again, and stops;
//! and what others do to its ports, its configuration and its standard output does not end or stop it.
//! One file: one promise, from its start to its stop.

use std::io::{BufRead, BufReader, PipeReader, PipeWriter, Read, Write};
use std::net::UdpSocket;
use std::process::Stdio;
use std::time::{Duration, Instant};

use serialport::{SerialPort, TTYPort};

use crate::common::service::{PATIENCE, Service};
use crate::common::{make_pipe, signal};

#[test]
fn ready_alive_reloaded_and_stopped_cleanly() {
    let folder = tempfile::tempdir().unwrap();
    let status = folder.path().join("status.json");
    let config = format!("[status]\npath = {status:?}\n");
    let mut service = Service::start(folder.path(), &config);
    assert_eq!(service.next_but(&[]), "READY=1");
    assert_eq!(service.next_but(&["STATUS="]), "WATCHDOG=1");
    assert!(service.next_but(&["WATCHDOG="]).starts_with("STATUS="));
    service.reload(folder.path(), &config);
    assert_eq!(service.stop(), Some(0));
}

#[test]
fn a_refused_configuration_leaves_the_run_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let mut service = Service::ready(folder.path(), "[status]\npath = \"\"\n");
    service.reload(folder.path(), "[status]\nnonsense = 1\n");
    // It still lives.
    assert_eq!(service.next_but(&["STATUS="]), "WATCHDOG=1");
    assert_eq!(service.stop(), Some(0));
}

/// Somewhere OSC goes.
fn receiver() -> (UdpSocket, String) {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(PATIENCE)).unwrap();
    let target = socket.local_addr().unwrap().to_string();
    (socket, target)
}

/// Waits until this many more frames have been told of over OSC.
fn hear_frames(socket: &UdpSocket, frames: usize) {
    let mut bytes = [0; 2048];
    socket.set_nonblocking(true).unwrap();
    while socket.recv(&mut bytes).is_ok() {}
    socket.set_nonblocking(false).unwrap();
    let mut heard = 0;
    while heard < frames {
        match socket.recv(&mut bytes) {
            Ok(length) => heard += usize::from(contains(&bytes[..length], b"/face/0/frame")),
            // With a time limit the system does not go on by itself after a signal.
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => panic!("frames go on: {error}"),
        }
    }
}

fn contains(bytes: &[u8], part: &[u8]) -> bool {
    bytes.windows(part.len()).any(|window| window == part)
}

#[test]
fn outputs_that_cannot_open_leave_the_old_ones_for_this_reload_and_every_later_one() {
    let folder = tempfile::tempdir().unwrap();
    let (socket, target) = receiver();
    let good = format!("[osc]\ntarget = {target:?}\n[status]\npath = \"\"\n");
    let said = folder.path().join("said");
    let log = std::fs::File::create(&said).unwrap();
    let mut service =
        Service::start_with(folder.path(), &good, &[], Stdio::null(), log).until_ready();
    hear_frames(&socket, 3);
    let (_other, taken) = receiver();
    let port_taken = good.replace(
        "[status]",
        &format!("commands = true\nlisten = {taken:?}\n[status]"),
    );
    // The paper's method has no such unit.
    let no_such_unit = format!(
        "{good}[learning]\nmethod = \"paper\"\n[serial]\nport = \"/dev/nowhere\"\nunits = [\"AU5L\"]\n"
    );
    for bad in [port_taken, no_such_unit, "[osc]\nnonsense = 1\n".into()] {
        service.reload(folder.path(), &bad);
        hear_frames(&socket, 3);
        service.reload(folder.path(), "[osc]\nnonsense = 1\n");
        hear_frames(&socket, 3);
    }
    assert_eq!(service.stop(), Some(0));
    let said = std::fs::read_to_string(said).unwrap();
    let stays = said.matches("; keeping the old configuration").count();
    assert!(stays == 5 && said.contains("\"AU5L\""), "{said}");
}

#[test]
fn a_configuration_that_has_become_a_pipe_is_not_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let (socket, target) = receiver();
    let config = format!("[osc]\ntarget = {target:?}\n[status]\npath = \"\"\n");
    let mut service = Service::ready(folder.path(), &config);
    make_pipe(&folder.path().join("mien.toml"));
    service.signal("-HUP");
    assert_eq!(service.next_but(&["WATCHDOG=", "STATUS="]), "RELOADING=1");
    assert_eq!(service.next_but(&["WATCHDOG=", "STATUS="]), "READY=1");
    hear_frames(&socket, 3);
    assert_eq!(service.stop(), Some(0));
}

#[test]
fn a_table_whose_pipe_nobody_opens_ends_with_the_signal() {
    let folder = tempfile::tempdir().unwrap();
    let table = folder.path().join("table.csv");
    make_pipe(&table);
    let words = ["--fast", "--frames", "3", "--csv", table.to_str().unwrap()];
    let started = || {
        let (said, log) = std::io::pipe().unwrap();
        let service = Service::start_with(folder.path(), "", &words, Stdio::null(), log);
        let mut lines = BufReader::new(said).lines().map(Result::unwrap);
        assert!(lines.any(|line| line.contains("table.csv: waiting for a reader")));
        service
    };
    let mut service = started();
    signal(&service.child, "-TERM");
    assert_eq!(service.child.wait().unwrap().code(), Some(0));

    // Who comes late gets it whole.
    let mut service = started();
    let text = std::fs::read_to_string(&table).unwrap();
    assert!(
        text.starts_with("frame,") && text.lines().count() >= 4,
        "{text}"
    );
    assert_eq!(service.child.wait().unwrap().code(), Some(0));
}

#[test]
fn a_key_that_needs_a_restart_says_so_once() {
    let folder = tempfile::tempdir().unwrap();
    let said = folder.path().join("said");
    let log = std::fs::File::create(&said).unwrap();
    let mut service = Service::start_with(folder.path(), "", &[], Stdio::null(), log).until_ready();
    for tilt_deg in ["1.0", "1.0", "2.0"] {
        let config = format!("[sensor]\ntilt_deg = {tilt_deg}\n[users]\nmost = 2\n");
        service.reload(folder.path(), &config);
    }
    service.reload(folder.path(), "[log]\nlevel = \"debug\"\n");
    assert_eq!(service.stop(), Some(0));
    let said = std::fs::read_to_string(said).unwrap();
    let lines = said.lines().filter(|line| line.contains("restart"));
    let lines: Vec<&str> = lines.collect();
    // Once for each change, the way back too.
    assert_eq!(lines.len(), 4, "{said}");
    assert!(
        lines[0].contains("[sensor]") && lines[3].contains("[log]"),
        "{said}"
    );
}

#[test]
fn a_command_port_that_is_taken_is_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let (socket, target) = receiver();
    let (other, listen) = receiver();
    let status = folder.path().join("status.json");
    let config = format!(
        "[osc]\ntarget = {target:?}\ncommands = true\nlisten = {listen:?}\n[status]\npath = {status:?}\n"
    );
    let mut service = Service::ready(folder.path(), &config);
    hear_frames(&socket, 3);
    drop(other);
    // "/face/cmd/schema" with no arguments.
    let ask = b"/face/cmd/schema\0\0\0\0,\0\0\0";
    let asker = UdpSocket::bind("127.0.0.1:0").unwrap();
    let heard = |service: &Service| {
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            asker.send_to(ask, &listen).unwrap();
            assert_eq!(service.next_but(&["STATUS="]), "WATCHDOG=1");
            let text = std::fs::read_to_string(&status).unwrap_or_default();
            if text.contains("\"commands\": ") && !text.contains("\"commands\": 0,") {
                return true;
            }
        }
        false
    };
    assert!(
        heard(&service),
        "the port that became free is not listened at"
    );
    // The port is its own: a reload takes it over.
    service.reload(folder.path(), &format!("{config}[users]\nhold_s = 0.25\n"));
    assert!(
        heard(&service),
        "the port is not listened at after a reload"
    );
    assert_eq!(service.stop(), Some(0));
}

/// A pipe that takes nothing more and whose reader does not read.
fn full_pipe() -> (PipeReader, PipeWriter) {
    let (reader, writer) = std::io::pipe().unwrap();
    let mut filler = writer.try_clone().unwrap();
    let (filled, full) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        // Blocks for good at the first byte that does not fit.
        while filler.write_all(&[b'-'; 1]).is_ok() && filled.send(()).is_ok() {}
    });
    while full.recv_timeout(Duration::from_secs(1)).is_ok() {}
    (reader, writer)
}

#[test]
fn a_log_and_a_table_that_nobody_reads_stop_neither_the_frames_nor_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let (socket, target) = receiver();
    // What cannot be opened is said at once.
    let config = format!("[osc]\ntarget = {target:?}\n[serial]\nport = \"/dev/nowhere\"\n");
    let (_reader, pipe) = full_pipe();
    let out = pipe.try_clone().unwrap();
    let mut service = Service::start_with(folder.path(), &config, &[], out, pipe).until_ready();
    hear_frames(&socket, 100);
    assert_eq!(service.stop(), Some(0));

    // A recording's table is waited for, as long as there is no signal.
    let (_reader, pipe) = std::io::pipe().unwrap();
    let words = ["--fast", "--csv", "-"];
    let mut service =
        Service::start_with(folder.path(), &config, &words, pipe, Stdio::null()).until_ready();
    let silence = Some(Duration::from_secs(2));
    service.socket.set_read_timeout(silence).unwrap();
    while service.socket.recv(&mut [0; 512]).is_ok() {}
    service.socket.set_read_timeout(Some(PATIENCE)).unwrap();
    assert_eq!(service.stop(), Some(0));
}

#[test]
fn weights_are_shown_on_a_terminal_only_and_one_that_is_not_read_stops_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (socket, target) = receiver();
    let config = format!("[osc]\ntarget = {target:?}\n[status]\npath = \"\"\n");
    let (mut terminal, port) = TTYPort::pair().unwrap();
    terminal.set_timeout(PATIENCE).unwrap();
    let name = port.name().unwrap();
    let open = || std::fs::File::options().write(true).open(&name).unwrap();
    let mut service =
        Service::start_with(folder.path(), &config, &["--fast"], open(), open()).until_ready();
    // Three times what it keeps for its reader.
    hear_frames(&socket, 300);
    let mut text = Vec::new();
    while !contains(&text, b"tracking") || !contains(&text, b"sends to: OSC to ") {
        let mut bytes = [0; 4096];
        let length = terminal.read(&mut bytes).expect("a live line");
        text.extend_from_slice(&bytes[..length]);
    }
    assert_eq!(service.stop(), Some(0));

    let (mut out, written) = std::io::pipe().unwrap();
    let words = ["--fast", "--frames", "60"];
    let mut service = Service::start_with(folder.path(), &config, &words, written, Stdio::null());
    assert_eq!(service.child.wait().unwrap().code(), Some(0));
    let mut text = String::new();
    out.read_to_string(&mut text).unwrap();
    assert_eq!(text, "", "weights for everybody who reads the log");
}

#[test]
fn commands_fill_no_log() {
    let folder = tempfile::tempdir().unwrap();
    let (socket, target) = receiver();
    // Any free port: it is given back before the run takes it.
    let listen = receiver().1;
    let config = format!(
        "[osc]\ntarget = {target:?}\ncommands = true\nlisten = {listen:?}\n[status]\npath = \"\"\n"
    );
    let said = folder.path().join("said");
    let log = std::fs::File::create(&said).unwrap();
    let mut service =
        Service::start_with(folder.path(), &config, &[], Stdio::null(), log).until_ready();
    let forget = b"/face/cmd/forget\0\0\0\0,i\0\0\0\0\0\0";
    // Each sender has its own allowance.
    for sender in 1..=8 {
        let asker = UdpSocket::bind(format!("127.0.0.{sender}:0")).unwrap();
        for _ in 0..8 {
            asker.send_to(forget, &listen).unwrap();
        }
        hear_frames(&socket, 8);
    }
    assert_eq!(service.stop(), Some(0));
    let said = std::fs::read_to_string(said).unwrap();
    let lines = said.matches("receiver asked to forget person 1").count();
    // Eight lines of a kind at once, then one a minute.
    assert!((1..=8).contains(&lines), "{lines} lines:\n{said}");
}

#[test]
fn a_bad_configuration_is_said_at_once_and_not_tried_again_every_moment() {
    let folder = tempfile::tempdir().unwrap();
    let (mut said, log) = std::io::pipe().unwrap();
    let start = Instant::now();
    let words = [];
    let mut service = Service::start_with(folder.path(), "nonsense", &words, Stdio::null(), log);
    let mut line = [0; 256];
    let length = said.read(&mut line).unwrap();
    assert!(contains(&line[..length], b"mien.toml:1:"));
    assert_eq!(service.child.wait().unwrap().code(), Some(2));
    assert!(start.elapsed() >= Duration::from_secs(10));
}
