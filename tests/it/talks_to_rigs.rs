//! What a rig is wired with: several targets of every kind, names and gains, mirrors, commands, the sweep without a face.
//! One file: all wires share one recording and its run.

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use mien_outputs::osc::vmc::{self, Vmc};
use mien_outputs::osc::vrchat::{self, VrChat};
use mien_outputs::osc::{self, Osc, Style};
use mien_outputs::serial::{self, Encoder, Serial};
use mien_outputs::{Command, Output, OutputError, Report, TrackingState, UnitView, View};
use mien_stages::base::geometry::{Rigid, Vector, rotation_from_yaw_pitch_roll};
use mien_stages::base::time::Timestamp;
use rosc::{OscMessage, OscPacket, OscType};
use serialport::{SerialPort, TTYPort};

const UNITS: [&str; 4] = ["AU26", "AU2L", "AU2R", "AU43L"];

fn report(ms: u64, weights: &[f32]) -> Report<'_> {
    Report {
        at: Timestamp::from_us(1000 * ms),
        user: Some(0),
        state: TrackingState::Tracking,
        confidence: 1.0,
        weights,
        ..Report::default()
    }
}

pub(crate) fn receiver(address: &str) -> UdpSocket {
    let socket = UdpSocket::bind(address).unwrap();
    let timeout = Some(Duration::from_millis(300));
    socket.set_read_timeout(timeout).unwrap();
    socket
}

/// A socket as a target.
fn target(socket: &UdpSocket) -> String {
    socket.local_addr().unwrap().to_string()
}

/// An address where nobody listens.
fn free() -> SocketAddr {
    receiver("127.0.0.1:0").local_addr().unwrap()
}

pub(crate) fn messages(socket: &UdpSocket) -> Vec<OscMessage> {
    let (mut all, mut bytes) = (Vec::new(), vec![0; 65_536]);
    while let Ok(length) = socket.recv(&mut bytes) {
        let (_, packet) = rosc::decoder::decode_udp(&bytes[..length]).unwrap();
        let OscPacket::Bundle(bundle) = packet else {
            panic!("not a bundle")
        };
        all.extend(bundle.content.into_iter().map(|packet| match packet {
            OscPacket::Message(message) => message,
            OscPacket::Bundle(_) => panic!("bundle in a bundle"),
        }));
    }
    all
}

fn floats(all: &[OscMessage], address: &str) -> Vec<f32> {
    let found = all.iter().filter(|message| message.addr == address);
    let arguments = found.flat_map(|message| &message.args);
    arguments.filter_map(|one| one.clone().float()).collect()
}

/// The datagram of a command with these numbers.
fn command(name: &str, numbers: &[i32]) -> Vec<u8> {
    let message = OscMessage {
        addr: format!("/face/cmd/{name}"),
        args: numbers.iter().map(|&number| OscType::Int(number)).collect(),
    };
    rosc::encoder::encode(&OscPacket::Message(message)).unwrap()
}

/// An output that takes commands at an address.
fn commanded(targets: &[&UdpSocket], listen: &str) -> Result<Osc, OutputError> {
    let settings = osc::Settings {
        targets: targets.iter().map(|socket| target(socket)).collect(),
        commands: true,
        listen: listen.into(),
        ..osc::Settings::default()
    };
    Osc::new(settings, &UNITS)
}

fn view(mirror: bool) -> View {
    let unit = |unit: &str, name: &str, gain| UnitView {
        unit: unit.into(),
        name: name.into(),
        gain,
    };
    View {
        mirror,
        units: vec![unit("AU26", "jaw", 2.0), unit("AU2L", "AU2L", 0.5)],
        ..View::default()
    }
}

#[test]
fn hosts_groups_and_networks_all_hear_the_same_and_absent_ones_hold_nobody_up() {
    let host = receiver("127.0.0.1:0");
    let sixth = UdpSocket::bind("[::1]:0").is_ok();
    let sixth = sixth.then(|| receiver("[::1]:0"));
    let broadcast = receiver("0.0.0.0:0");
    let group = receiver("0.0.0.0:0");
    let joined = group.join_multicast_v4(&Ipv4Addr::new(239, 255, 91, 30), &Ipv4Addr::UNSPECIFIED);
    let port = |socket: &UdpSocket| socket.local_addr().unwrap().port();
    let mut targets = vec![
        "240.0.0.1:9".to_owned(),
        "nobody.invalid:9".to_owned(),
        target(&host),
        format!("127.255.255.255:{}", port(&broadcast)),
        format!("239.255.91.30:{}", port(&group)),
    ];
    targets.extend(sixth.as_ref().map(target));
    let settings = osc::Settings {
        targets,
        ..osc::Settings::default()
    };
    let mut osc = Osc::new(settings, &UNITS).unwrap();
    for ms in 0..30 {
        osc.send(&report(33 * ms, &[0.25, 0.5, 0.75, 1.0])).unwrap();
    }
    let sent = osc.tally();
    assert!(sent.sent >= 2 * 32 && sent.dropped >= 32, "{sent:?}");
    let expected = messages(&host);
    assert_eq!(floats(&expected, "/face/0/au/AU26"), [0.25; 30]);
    assert_eq!(messages(&broadcast), expected, "broadcast");
    match joined {
        Ok(()) if sent.sent >= 4 * 32 => assert_eq!(messages(&group), expected, "multicast"),
        _ => println!("skipped: this machine has no way to a multicast group"),
    }
    if let Some(sixth) = sixth {
        assert_eq!(messages(&sixth), expected, "IPv6");
    }
}

#[test]
fn names_gains_and_the_mirror_are_the_output_s() {
    let socket = receiver("127.0.0.1:0");
    let targets = vec![target(&socket)];
    let turn = rotation_from_yaw_pitch_roll(0.5, 0.0, 0.0);
    let pose = Rigid::from_parts(Vector::new(0.1, 0.2, 0.7).into(), turn);
    let face = Report {
        sensor_from_face: Some(&pose),
        ..report(0, &[0.3, 0.8, 0.2, 0.0])
    };
    let settings = osc::Settings {
        targets: targets.clone(),
        style: Style::Both,
        view: view(true),
        ..osc::Settings::default()
    };
    Osc::new(settings, &UNITS).unwrap().send(&face).unwrap();
    let heard = messages(&socket);
    // The jaw twice as wide; the left brow shows half of the right one.
    assert_eq!(floats(&heard, "/face/0/au")[..3], [0.6, 0.1, 0.8]);
    assert_eq!(floats(&heard, "/face/0/au/jaw")[0], 0.6);
    let place = &floats(&heard, "/face/0/pose")[..7];
    assert_eq!(place[..3], [-0.1, 0.2, 0.7]);
    assert!((place[4] + 0.25f32.sin()).abs() < 1e-6, "{place:?}");
    let schema = heard.iter().find(|m| m.addr == "/face/schema").unwrap();
    assert_eq!(schema.args[1], OscType::String("jaw".into()));

    for (names, expected) in [
        (vmc::Names::Units, vec!["jaw", "AU2L", "AU2R", "AU43L"]),
        (vmc::Names::Vrm0, vec!["A", "Blink_L"]),
        (vmc::Names::Vrm1, vec!["aa", "blinkLeft", "surprised"]),
    ] {
        let settings = vmc::Settings {
            targets: targets.clone(),
            names,
            view: view(false),
            ..vmc::Settings::default()
        };
        Vmc::new(settings, &UNITS).unwrap().send(&face).unwrap();
        let heard = messages(&socket);
        let values = heard.iter().filter(|m| m.addr == "/VMC/Ext/Blend/Val");
        let names = values.map(|message| message.args[0].clone().string().unwrap());
        let names: Vec<String> = names.collect();
        // Once with the face, once neutral.
        assert_eq!(names, [&expected[..], &expected].concat());
    }
}

#[test]
fn switches_are_the_bits_of_a_value() {
    let socket = receiver("127.0.0.1:0");
    let settings = vrchat::Settings {
        targets: vec![target(&socket)],
        values: vrchat::Values::Binary,
        bits: 3,
        ..vrchat::Settings::default()
    };
    let mut vrchat = VrChat::new(settings, &["AU30L", "AU30R", "AU26"]).unwrap();
    // The switches that change, on (+) or off (-).
    let mut heard = |ms: u64, weights: [f32; 3]| {
        vrchat.send(&report(ms, &weights)).unwrap();
        let all = messages(&socket);
        let switches = all.into_iter().filter_map(|message| {
            let name = message.addr.strip_prefix("/avatar/parameters/FT/v2/")?;
            let on = message.args[0].clone().bool()?;
            let shown = ["JawOpen", "JawX"].iter().any(|of| name.starts_with(of));
            shown.then(|| format!("{}{name}", if on { '+' } else { '-' }))
        });
        switches.collect::<Vec<_>>().join(" ")
    };
    // |−0.75| × 7 = 5.25: 1 and 4. 0.9 × 7 = 6.3: 2 and 4.
    let first = "-JawOpen1 +JawOpen2 +JawOpen4 +JawX1 -JawX2 +JawX4 +JawXNegative";
    assert_eq!(heard(0, [0.75, 0.0, 0.9]), first);
    assert_eq!(heard(33, [0.75, 0.0, 0.9]), "");
    assert_eq!(heard(66, [0.0, 0.75, 1.0]), "+JawOpen1 -JawXNegative");
}

/// Longer than any machine needs.
fn wait_for(mut condition: impl FnMut() -> bool) {
    for _ in 0..6000 {
        if condition() {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("waited for a minute");
}

#[test]
fn commands_are_taken_only_if_allowed_and_what_is_malformed_is_counted() {
    let closed = osc::Settings {
        commands: false,
        ..osc::Settings::default()
    };
    let mut closed = Osc::new(closed, &UNITS).unwrap();
    assert_eq!(closed.next_command(), None);

    let (socket, to) = (receiver("127.0.0.1:0"), free());
    let mut osc = commanded(&[&socket], &to.to_string()).unwrap();
    let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
    let send = |bytes: &[u8]| sender.send_to(bytes, to).unwrap();
    send(&command("freeze", &[0, 1]));
    send(b"nonsense");
    send(&command("forget", &[9]));
    send(&command("schema", &[]));
    send(&command("neutral", &[0]));
    assert_eq!(osc.next_command(), Some(Command::Freeze(0, true)));
    assert_eq!(osc.next_command(), Some(Command::Neutral(0)));
    assert_eq!(osc.next_command(), None);
    assert_eq!(osc.tally().commands, [3, 2]);
    assert_eq!(messages(&socket)[0].addr, "/face/schema");
    // A flood takes no more of a frame than a few datagrams, its sender is held to a rate, and others are heard.
    for _ in 0..200 {
        send(&command("forget", &[0]));
    }
    let other = UdpSocket::bind("127.0.0.2:0").unwrap();
    let neutral = command("neutral", &[3]);
    other.send_to(&neutral, to).unwrap();
    let (mut obeyed, mut heard) = (0, false);
    while !heard {
        let mut round = 0;
        while let Some(command) = osc.next_command() {
            round += 1;
            heard |= command == Command::Neutral(3);
        }
        assert!(round <= 16, "{round} in one round");
        obeyed += round;
    }
    assert!((10..100).contains(&obeyed), "{obeyed} of 201 obeyed");
    let [taken, refused] = osc.tally().commands;
    assert_eq!(taken + refused, 5 + 201, "what is not obeyed is counted");

    // A second one waits until the address is free; what is no address is refused.
    let mut waits = commanded(&[&socket], &to.to_string()).unwrap();
    assert_eq!(waits.next_command(), None);
    drop(osc);
    wait_for(|| {
        send(&neutral);
        waits.next_command() == Some(Command::Neutral(3))
    });
    let refused = commanded(&[&socket], "here").err().unwrap().to_string();
    let expected = "cannot listen for OSC commands at";
    assert!(refused.starts_with(expected), "{refused}");
}

#[test]
fn who_asks_is_answered_and_nobody_else() {
    let (here, there) = (receiver("127.0.0.1:0"), receiver("127.0.0.2:0"));
    let to = free();
    let mut osc = commanded(&[&here, &there], &to.to_string()).unwrap();
    let mut ask = |asker: &UdpSocket| {
        asker.send_to(&command("schema", &[]), to).unwrap();
        wait_for(|| {
            let before = osc.tally().commands[0];
            osc.next_command();
            osc.tally().commands[0] > before
        });
    };
    ask(&UdpSocket::bind("127.0.0.2:0").unwrap());
    assert_eq!(messages(&there)[0].addr, "/face/schema");
    assert_eq!(messages(&here), []);
    // Nothing goes there otherwise: the answer goes back where the question came from.
    let asker = receiver("127.0.0.3:0");
    ask(&asker);
    assert_eq!(messages(&asker)[0].addr, "/face/schema");
    assert_eq!((messages(&here), messages(&there)), (vec![], vec![]));
}

#[test]
fn a_slow_line_leaves_out_the_least_telling_units() {
    let (_reader, port) = TTYPort::pair().unwrap();
    let units = ["AU5L", "AU26", "AU9L", "AU25", "AU43L", "AU43R"];
    let sent = |baud, units_wanted: &[&str], min_rate_hz| {
        let settings = serial::Settings {
            port: port.name().unwrap(),
            baud,
            units: units_wanted.iter().map(|&unit| unit.to_owned()).collect(),
            min_rate_hz,
            ..serial::Settings::default()
        };
        Encoder::new(&settings, &units).map(|line| line.units().to_vec())
    };
    assert_eq!(sent(115_200, &[], 10.0).unwrap(), units);
    // 456 bytes a second: ten lines of 45 bytes, of which 30 are not weights.
    assert_eq!(sent(4800, &[], 10.0).unwrap(), ["AU26", "AU25", "AU43L"]);
    let two = ["AU9L", "AU26"];
    assert_eq!(sent(115_200, &two, 10.0).unwrap(), two);
    assert_eq!(sent(1200, &two, 30.0).unwrap(), ["AU9L"]);
    let refused = sent(115_200, &["AU99"], 10.0).unwrap_err().to_string();
    assert!(refused.contains("\"AU99\""), "{refused}");
}

#[test]
fn ports_open_at_every_speed() {
    for baud in [
        1200, 9600, 57_600, 115_200, 230_400, 250_000, 921_600, 2_000_000, 4_000_000,
    ] {
        let (_reader, port) = TTYPort::pair().unwrap();
        let settings = serial::Settings {
            port: port.name().unwrap(),
            baud,
            ..serial::Settings::default()
        };
        let serial = Serial::new(&settings, &UNITS).unwrap();
        let start = Instant::now();
        while !serial.tally().connected {
            assert!(start.elapsed() < Duration::from_secs(20), "{baud} bit/s");
            std::thread::sleep(Duration::from_millis(2));
        }
        assert_eq!(port.baud_rate().unwrap(), baud);
    }
}
