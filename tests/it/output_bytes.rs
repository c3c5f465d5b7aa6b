//! What goes over the wires, byte for byte, and what the wires do when nobody is at the other end.
//! One file: the bytes of every wire, held against each other.

use std::io::{Read, Write};
use std::net::UdpSocket;
use std::time::{Duration, Instant};

use mien_outputs::csv::Csv;
use mien_outputs::osc::faceosc::{self, FaceOsc};
use mien_outputs::osc::vmc::{self, Vmc};
use mien_outputs::osc::vrchat::{self, VrChat};
use mien_outputs::osc::{self, Osc, Style};
use mien_outputs::serial::{self, Serial};
use mien_outputs::{Output, OutputError, Report, TrackingState};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::{Point, Rigid, Vector, rotation_from_yaw_pitch_roll};
use mien_stages::base::time::Timestamp;
use mien_stages::landmarks::Landmarks;
use mien_stages::segment::PixelRect;
use rosc::{OscMessage, OscPacket, OscType};
use serialport::{SerialPort, TTYPort};

const MEASURES: [&str; 2] = ["lip_gap", "eye_distance"];
const UNITS: [&str; 3] = ["AU25", "AU12L", "AU12R"];

fn landmarks() -> Landmarks {
    Landmarks {
        pixels: std::array::from_fn(|i| [i as f32 + 0.5, -0.00001 * i as f32]),
        point_confidence: [0.75; LANDMARKS],
        seen: [1.0, 0.75, 0.5, 0.254, 0.125, 0.0],
        confidence: 0.9,
        ..Landmarks::default()
    }
}

fn pose() -> Rigid {
    Rigid::from_parts(
        Vector::new(0.1, -0.25, 0.75).into(),
        rotation_from_yaw_pitch_roll(0.5, 0.0, 0.0),
    )
}

/// A report of `user` at `ms`.
fn report<'a>(ms: u64, user: usize, state: TrackingState, weights: &'a [f32]) -> Report<'a> {
    Report {
        frame: ms / 33,
        at: Timestamp::from_us(1000 * ms),
        user: Some(user),
        state,
        confidence: 0.8,
        weights,
        ..Report::default()
    }
}

/// The report of a tracked face.
fn tracked(ms: u64, user: usize, weights: &[f32]) -> Report<'_> {
    report(ms, user, TrackingState::Tracking, weights)
}

fn nobody(ms: u64) -> Report<'static> {
    Report {
        frame: ms / 33,
        at: Timestamp::from_us(1000 * ms),
        ..Report::default()
    }
}

#[test]
fn csv_has_the_columns_in_their_order_and_stable_numbers() {
    let (landmarks, pose) = (landmarks(), pose());
    let mut bytes = Vec::new();
    {
        let mut csv = Csv::new(&mut bytes, &MEASURES, &UNITS, &[]).unwrap();
        let weights = [1.25, f32::NAN, -0.1];
        let [x0, y0, x1, y1] = [7, 120, 140, 300];
        let head_box = PixelRect { x0, y0, x1, y1 };
        let full = Report {
            sensor_from_face: Some(&pose),
            head_box: Some(head_box),
            landmarks: Some(&landmarks),
            measures: &[0.1, 0.032_5],
            ..report(33, 2, TrackingState::Warming, &weights)
        };
        csv.send(&full).unwrap();
        // Whatever is handed in, a head without a face has a place and nothing else.
        for (state, confidence) in [(TrackingState::Posed, 0.8), (TrackingState::Lost, 0.0)] {
            let without = Report {
                state,
                confidence,
                ..full
            };
            csv.send(&without).unwrap();
        }
        csv.send(&nobody(99)).unwrap();
    }
    let text = String::from_utf8(bytes).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let points: String = (0..68).map(|i| format!(",x{i},y{i}")).collect();
    let confidences: String = (0..68).map(|i| format!(",c{i}")).collect();
    assert_eq!(
        lines[0],
        format!(
            "frame,time_us,user,state,confidence,tx_m,ty_m,tz_m,qx,qy,qz,qw{points}{confidences},\
             m_lip_gap,m_eye_distance,w_AU25,w_AU12L,w_AU12R,head_x0,head_y0,head_x1,head_y1,\
             s_brow_L,s_brow_R,s_eye_L,s_eye_R,s_nose,s_mouth"
        )
    );
    let points = (0..68).map(|i| match i {
        // What rounds to zero has no sign: -0.00005 does, -0.00006 does not.
        0..6 => format!(",{i}.5000,0.0000"),
        _ => format!(",{i}.5000,{:.4}", -0.00001 * i as f32),
    });
    let (points, confidences) = (points.collect::<String>(), ",0.7500".repeat(68));
    let head = "0.8000,0.100000,-0.250000,0.750000,0.000000,0.247404,0.000000,0.968912";
    let face = "0.100000,0.032500,1.250000,,0.000000,7,120,140,300";
    let seen = "1.0000,0.7500,0.5000,0.2540,0.1250,0.0000";
    let warming = format!("1,33000,2,warming,{head}{points}{confidences},{face},{seen}");
    assert_eq!(lines[1], warming);
    let nothing = ",".repeat(3 * 68 + 5);
    assert_eq!(
        lines[2],
        format!("1,33000,2,posed,{head}{nothing},7,120,140,300,,,,,,")
    );
    let nothing = ",".repeat(7 + 3 * 68 + 5 + 4 + 6);
    assert_eq!(lines[3], format!("1,33000,2,lost,0.0000{nothing}"));
    assert_eq!(lines[4], format!("3,99000,,absent,0.0000{nothing}"));
    assert_eq!((lines.len(), text.ends_with('\n')), (5, true));
}

#[test]
fn csv_on_a_full_disk_is_an_error_in_one_sentence() {
    struct Full;
    impl Write for Full {
        fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
            Err(std::io::ErrorKind::StorageFull.into())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let error = Csv::new(Full, &MEASURES, &UNITS, &[]).err().unwrap();
    assert_eq!(
        error.to_string(),
        "cannot write the CSV: no storage space; check the path and the free space"
    );
}

/// A receiver, and settings to send to it.
fn receiver(style: Style) -> (UdpSocket, osc::Settings) {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket
        .set_read_timeout(Some(Duration::from_millis(300)))
        .unwrap();
    let targets = vec![socket.local_addr().unwrap().to_string()];
    (
        socket,
        osc::Settings {
            targets,
            style,
            ..osc::Settings::default()
        },
    )
}

/// As [`receiver`], of another schema: the target only.
fn target() -> (UdpSocket, Vec<String>) {
    let (socket, osc::Settings { targets, .. }) = receiver(Style::Both);
    (socket, targets)
}

/// All messages that have arrived, datagram by datagram; checks what holds for every datagram.
fn received(socket: &UdpSocket) -> Vec<Vec<OscMessage>> {
    let mut datagrams = Vec::new();
    let mut bytes = vec![0; 65_536];
    while let Ok(length) = socket.recv(&mut bytes) {
        assert!(length <= 1472, "{length} bytes");
        let (rest, packet) = rosc::decoder::decode_udp(&bytes[..length]).unwrap();
        assert!(rest.is_empty());
        let OscPacket::Bundle(bundle) = packet else {
            panic!("not a bundle")
        };
        assert_eq!((bundle.timetag.seconds, bundle.timetag.fractional), (0, 1));
        let messages = bundle.content.into_iter().map(|packet| match packet {
            OscPacket::Message(message) => message,
            OscPacket::Bundle(_) => panic!("bundle in a bundle"),
        });
        datagrams.push(messages.collect());
    }
    datagrams
}

fn find<'a>(datagrams: &'a [Vec<OscMessage>], address: &str) -> Vec<&'a [OscType]> {
    let messages = datagrams.iter().flatten();
    messages
        .filter(|message| message.addr == address)
        .map(|message| &message.args[..])
        .collect()
}

/// The first numbers of all messages to this address.
fn first_floats(datagrams: &[Vec<OscMessage>], address: &str) -> Vec<f32> {
    let arguments = find(datagrams, address).into_iter();
    let first = arguments.map(|args| match args[0] {
        Float(number) => number,
        Int(number) => number as f32,
        _ => panic!("{address} begins with a number"),
    });
    first.collect()
}

use OscType::{Float, Int, String as Text};

#[test]
fn osc_tells_everything_of_a_face() {
    let (socket, settings) = receiver(Style::Both);
    let mut osc = Osc::new(settings, &UNITS).unwrap();
    let pose = pose();
    let weights = [0.5, f32::NAN, 1.5];
    osc.send(&Report {
        sensor_from_face: Some(&pose),
        ..tracked(33, 1, &weights)
    })
    .unwrap();
    let datagrams = received(&socket);
    let names = UNITS.map(|name| Text(name.into()));
    assert_eq!(
        find(&datagrams, "/face/schema"),
        [[&[Int(1)][..], &names].concat()]
    );
    let alive = [Int(0), Text(env!("CARGO_PKG_VERSION").into()), Float(0.033)];
    assert_eq!(find(&datagrams, "/face/alive"), [alive]);
    assert_eq!(datagrams[2][0].addr, "/face/1/frame", "first in its bundle");
    assert_eq!(
        datagrams[2][0].args,
        [Int(0), Int(33), Int(2), Float(0.8), Float(0.0)]
    );
    assert_eq!(
        find(&datagrams, "/face/1/au"),
        [[Float(0.5), Float(0.0), Float(1.0)]]
    );
    assert_eq!(find(&datagrams, "/face/1/au/AU25"), [[Float(0.5)]]);
    assert_eq!(find(&datagrams, "/face/1/au/AU12R"), [[Float(1.0)]]);
    let turn = pose.rotation.coords;
    let numbers = [0.1, -0.25, 0.75, turn.x, turn.y, turn.z, turn.w].map(Float);
    assert_eq!(find(&datagrams, "/face/1/pose"), [numbers]);
    assert_eq!(find(&datagrams, "/face/1/present"), [[Int(1)]]);
    assert_eq!((osc.tally().sent, osc.tally().dropped), (3, 0));
}

#[test]
fn osc_tells_which_regions_are_seen_on_change_and_each_second() {
    for mirror in [false, true] {
        let (socket, mut settings) = receiver(Style::Vector);
        settings.view.mirror = mirror;
        let mut osc = Osc::new(settings, &UNITS).unwrap();
        let mut face = landmarks();
        let mut told = |ms, state, seen| {
            face.seen = seen;
            osc.send(&Report {
                landmarks: Some(&face),
                ..report(ms, 1, state, &[0.0; 3])
            })
            .unwrap();
            let all = received(&socket).concat().into_iter();
            let all = all.filter_map(|message| {
                let region = message.addr.strip_prefix("/face/1/seen/")?.to_owned();
                Some((region, message.args[0].clone().float().unwrap()))
            });
            all.collect::<Vec<_>>()
        };
        let (first, tracking) = (landmarks().seen, TrackingState::Tracking);
        let [left, right] = if mirror { ["R", "L"] } else { ["L", "R"] };
        let mut whole = [
            (format!("brow_{left}"), 1.0),
            (format!("brow_{right}"), 0.75),
            (format!("eye_{left}"), 0.5),
            (format!("eye_{right}"), 0.25),
            ("nose".into(), 0.13),
            ("mouth".into(), 0.0),
        ];
        if mirror {
            whole.swap(0, 1);
            whole.swap(2, 3);
        }
        assert_eq!(told(0, tracking, first), whole);
        // Less than half a hundredth is no change.
        let mut next = first;
        (next[0], next[2]) = (0.9, 0.501);
        let changed = [(format!("brow_{left}"), 0.9)];
        assert_eq!(told(33, tracking, next), changed);
        assert_eq!(told(66, tracking, next), []);
        assert_eq!(told(1000, tracking, first), whole, "a second later");
        assert_eq!(told(1033, TrackingState::Posed, first), [], "no face");
        assert_eq!(told(1066, tracking, first), whole, "a face again");
    }
}

#[test]
fn osc_repeats_counts_fades_and_closes() {
    let (socket, settings) = receiver(Style::Vector);
    let mut osc = Osc::new(settings, &UNITS).unwrap();
    // Two seconds of a face, then two of nobody, at 30 frames a second.
    for i in 0..60 {
        osc.send(&tracked(i * 100 / 3, 0, &[0.4, 0.0, 0.0]))
            .unwrap();
    }
    for i in 60..120 {
        osc.send(&nobody(i * 100 / 3)).unwrap();
    }
    drop(osc);
    let datagrams = received(&socket);
    let numbers = first_floats(&datagrams, "/face/0/frame");
    assert!(numbers.into_iter().eq((0..121_u8).map(f32::from)));
    assert_eq!(find(&datagrams, "/face/schema").len(), 1);
    assert_eq!(find(&datagrams, "/face/alive").len(), 4);
    let present = first_floats(&datagrams, "/face/0/present");
    // Each second, on change and at the end.
    assert_eq!(present, [1.0, 1.0, 0.0, 0.0, 0.0]);
    let weights = first_floats(&datagrams, "/face/0/au");
    assert!(
        weights.windows(2).all(|pair| pair[1] <= pair[0]),
        "only falls: {weights:?}"
    );
    // 0.2 s held, 0.4 s of fading, and neutral once more at the end.
    assert!(weights[..65].iter().all(|&weight| weight == 0.4));
    assert!((weights[71] - 0.2).abs() < 0.02, "{}", weights[71]);
    assert_eq!(weights.last(), Some(&0.0));
    let scalars = find(&datagrams, "/face/0/au/AU25");
    assert!(scalars.is_empty(), "style vector");
    let last = datagrams.last().unwrap();
    assert_eq!(last[0].args[2], Int(0));
    assert_eq!(last[1].args, [Float(0.0), Float(0.0), Float(0.0)]);
    assert_eq!(last[2].addr, "/face/0/present");
    assert_eq!(last[2].args, [Int(0)]);
}

#[test]
fn osc_splits_what_is_too_long_for_a_datagram_between_messages() {
    let (socket, settings) = receiver(Style::Both);
    let names: Vec<String> = (0..80).map(|i| format!("AU{i}L")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut osc = Osc::new(settings, &names).unwrap();
    osc.send(&report(0, 3, TrackingState::Held, &[0.25; 80]))
        .unwrap();
    let datagrams = received(&socket);
    assert!(datagrams.len() > 3, "{} datagrams", datagrams.len());
    for name in names {
        let found = find(&datagrams, &format!("/face/3/au/{name}"));
        assert_eq!(found, [[Float(0.25)]]);
    }
}

#[test]
fn osc_without_a_receiver_goes_on() {
    let (socket, settings) = receiver(Style::Both);
    drop(socket);
    let others = ["240.0.0.1:9", "no-such-host.invalid:9"].map(|other| vec![other.to_owned()]);
    for targets in others.into_iter().chain([settings.targets]) {
        let settings = osc::Settings {
            targets,
            ..osc::Settings::default()
        };
        let mut osc = Osc::new(settings, &UNITS).unwrap();
        for ms in 0..50 {
            osc.send(&tracked(ms, 0, &[0.1; 3])).unwrap();
        }
        assert_eq!(osc.tally().sent + osc.tally().dropped, 52);
    }
}

#[test]
fn osc_settings_that_cannot_work_are_told() {
    let refused = |target: &str, prefix: &str| {
        let settings = osc::Settings {
            targets: vec![target.into()],
            prefix: prefix.into(),
            ..osc::Settings::default()
        };
        Osc::new(settings, &UNITS).err().unwrap().to_string()
    };
    let nowhere = refused("nowhere", "/face");
    assert!(nowhere.starts_with("OSC target is \"nowhere\", expected host:port"));
    assert!(refused(":9130", "/face").starts_with("OSC target is "));
    assert!(refused("localhost:99999", "/face").starts_with("OSC target is "));
    for prefix in ["face", "/face/", "/f#", "/a b", ""] {
        let refused = refused("127.0.0.1:9", prefix);
        assert!(refused.starts_with("OSC prefix is "), "{prefix}");
    }
    let long = "x".repeat(2000);
    let names = Osc::new(osc::Settings::default(), &[&long]).err().unwrap();
    assert!(matches!(names, OutputError::Names(1, ..)));
}

#[test]
fn vmc_moves_an_avatar() {
    let (socket, targets) = target();
    let units = ["AU26", "AU12L", "AU12R", "AU43L", "AU43R", "AU99"];
    let settings = vmc::Settings {
        targets,
        ..vmc::Settings::default()
    };
    let mut vmc = Vmc::new(settings, &units).unwrap();
    // The nose turns to the left of the picture: to the subject's right, Unity's +x.
    let pose = pose();
    let weights = [0.25, 1.0, 0.0, 0.5, 0.5, 1.0];
    let face = Report {
        sensor_from_face: Some(&pose),
        ..tracked(1500, 0, &weights)
    };
    vmc.send(&face).unwrap();
    // A second person is not on this wire.
    vmc.send(&tracked(1500, 1, &[0.9; 6])).unwrap();
    let datagrams = received(&socket);
    assert_eq!(datagrams.len(), 1);
    let addresses = datagrams[0].iter().map(|message| message.addr.as_str());
    let addresses: Vec<&str> = addresses.collect();
    let vals = " /VMC/Ext/Blend/Val".repeat(11);
    let frame = "/VMC/Ext/OK /VMC/Ext/T /VMC/Ext/Root/Pos /VMC/Ext/Bone/Pos";
    let expected = format!("{frame}{vals} /VMC/Ext/Blend/Apply");
    assert_eq!(addresses.join(" "), expected);
    assert_eq!(find(&datagrams, "/VMC/Ext/T"), [[Float(1.5)]]);
    let turn = [0.0, 0.25f32.sin(), 0.0, 0.25f32.cos()];
    let head = find(&datagrams, "/VMC/Ext/Bone/Pos")[0][1..].iter();
    let head: Vec<f32> = head.map(|arg| arg.clone().float().unwrap()).collect();
    assert_eq!(head[..3], [0.0; 3]);
    let mut turns = head[3..].iter().zip(turn);
    let is_same = turns.all(|(found, expected)| (found - expected).abs() < 1e-6);
    assert!(is_same, "{head:?}");
    let shape = |name: &str, value| [Text(name.into()), Float(value)];
    assert_eq!(
        find(&datagrams, "/VMC/Ext/Blend/Val"),
        [
            shape("eyeBlinkLeft", 0.5),
            shape("eyeBlinkRight", 0.5),
            shape("jawOpen", 0.25),
            shape("mouthSmileLeft", 1.0),
            shape("mouthSmileRight", 0.0),
            // Not measured: the cheek goes with the smile, lips over a jaw without AU25 stay together.
            shape("cheekSquintLeft", 0.7),
            shape("cheekSquintRight", 0.0),
            shape("eyeSquintLeft", 0.3),
            shape("eyeSquintRight", 0.0),
            shape("mouthClose", 0.25),
            shape("tongueOut", 0.0),
        ]
    );
    drop(vmc);
    let datagrams = received(&socket);
    let mut shapes = find(&datagrams, "/VMC/Ext/Blend/Val").into_iter();
    assert!(shapes.all(|args| args[1] == Float(0.0)));
}

#[test]
fn vmc_with_everything_measured_applies_once_and_last() {
    let (socket, targets) = target();
    let names = (0..70).flat_map(|i| ["", "L", "R"].map(|side| format!("AU{i}{side}")));
    let names: Vec<String> = names.collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let settings = vmc::Settings {
        targets,
        role: vmc::Role::Assistant,
        derived: false,
        ..vmc::Settings::default()
    };
    let mut vmc = Vmc::new(settings, &names).unwrap();
    let pose = pose();
    let face = Report {
        sensor_from_face: Some(&pose),
        ..tracked(0, 0, &[1.0; 210])
    };
    vmc.send(&face).unwrap();
    let datagrams = received(&socket);
    assert_eq!(datagrams.len(), 2);
    let shapes = find(&datagrams, "/VMC/Ext/Blend/Val");
    // Four of ARKit's 52 are no unit of FACS.
    assert_eq!(shapes.len(), 48);
    assert!(shapes.iter().all(|args| args[1] == Float(1.0)));
    let place = [Text("Head".into()), Float(-0.1), Float(0.25), Float(-0.75)];
    assert_eq!(find(&datagrams, "/VMC/Ext/Tra/Pos")[0][..4], place);
    assert_eq!(find(&datagrams, "/VMC/Ext/Blend/Apply").len(), 1);
    assert_eq!(datagrams[1].last().unwrap().addr, "/VMC/Ext/Blend/Apply");
}

#[test]
fn vrchat_hears_what_has_changed() {
    let (socket, targets) = target();
    let units = ["AU26", "AU12L", "AU43L", "AU5L"];
    let settings = vrchat::Settings {
        targets,
        ..vrchat::Settings::default()
    };
    let mut vrchat = VrChat::new(settings, &units).unwrap();
    vrchat.send(&tracked(0, 0, &[0.5, 0.0, 0.0, 0.0])).unwrap();
    vrchat.send(&tracked(33, 0, &[0.5, 0.0, 1.0, 0.0])).unwrap();
    vrchat.send(&tracked(66, 0, &[0.5, 0.0, 1.0, 0.0])).unwrap();
    vrchat
        .send(&tracked(1066, 0, &[0.5, 0.0, 1.0, 0.0]))
        .unwrap();
    drop(vrchat);
    let datagrams = received(&socket);
    let sizes: Vec<usize> = datagrams.iter().map(Vec::len).collect();
    // Three switches, four parameters and eleven others; the closed eye in six of them; nothing; all again; all at rest.
    assert_eq!(sizes, [18, 6, 18, 18]);
    let name = |name: &str| format!("/avatar/parameters/FT/v2/{name}");
    let lid = first_floats(&datagrams, &name("EyeLidLeft"));
    assert_eq!(lid, [0.75, 0.0, 0.0, 0.75]);
    let jaw = first_floats(&datagrams, &name("JawOpen"));
    assert_eq!(jaw, [0.5, 0.5, 0.0]);
    let active = find(&datagrams, &name("LipTrackingActive"));
    assert_eq!(active, [true, true, false].map(|is| [OscType::Bool(is)]));
}

#[test]
fn faceosc_sends_distances_on_the_face() {
    let (socket, targets) = target();
    let settings = faceosc::Settings {
        targets,
        ..faceosc::Settings::default()
    };
    let mut faceosc = FaceOsc::new(settings).unwrap();
    let mut face = landmarks();
    let pose = pose();
    // A mouth of 50.4 mm is 14 wide, wherever the head is turned.
    let corner = |x| Point::new(x, 0.06, 0.0);
    (face.head[48], face.head[54]) = (corner(-0.0252), corner(0.0252));
    // Eyes 36 mm apart seem 36 mm × cos(yaw) apart; they are 20 pixels apart in the picture.
    (face.head[39], face.head[42]) = (Point::new(-0.018, 0.0, 0.0), Point::new(0.018, 0.0, 0.0));
    (face.pixels[39], face.pixels[42]) = ([300.0, 200.0], [320.0, 200.0]);
    let whole = Report {
        sensor_from_face: Some(&pose),
        landmarks: Some(&face),
        ..tracked(0, 0, &[0.0; 3])
    };
    faceosc.send(&whole).unwrap();
    // Held, then not found.
    faceosc.send(&nobody(150)).unwrap();
    faceosc.send(&nobody(250)).unwrap();
    let datagrams = received(&socket);
    assert_eq!(find(&datagrams, "/found"), [[Int(1)], [Int(0)]]);
    assert_eq!(find(&datagrams, "/gesture/jaw").len(), 2);
    assert_eq!(datagrams[1].len(), 11);
    let number = |address: &str, i: usize| find(&datagrams, address)[0][i].clone().float().unwrap();
    assert!((number("/gesture/mouth/width", 0) - 14.0).abs() < 1e-4);
    assert!((number("/pose/scale", 0) - 20.0 / (10.0 * 0.5f32.cos())).abs() < 1e-4);
    assert!((number("/pose/orientation", 1) - 0.5).abs() < 1e-5);
}

fn serial_settings(path: &str) -> serial::Settings {
    serial::Settings {
        port: path.to_owned(),
        ..serial::Settings::default()
    }
}

/// An open serial output.
fn opened(settings: &serial::Settings, units: &[&str]) -> Serial {
    let serial = Serial::new(settings, units).unwrap();
    wait_for("open", || serial.tally().connected);
    serial
}

/// A pseudo-terminal: the end to read from, the other end, and its path. Once the other end is closed everywhere, what it
/// left behind cannot be read any more; so a test keeps it.
fn terminal() -> (TTYPort, TTYPort, String) {
    let (mut reader, port) = TTYPort::pair().unwrap();
    reader.set_timeout(Duration::from_millis(200)).unwrap();
    let path = port.name().unwrap();
    (reader, port, path)
}

/// What is never late in earnest: as long as this only what stands still takes, however busy the machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// Long enough to hear what should not be said.
const SILENCE: Duration = Duration::from_secs(1);

/// Reads until `enough`, which comes unless something stands still.
fn read_until(port: &mut TTYPort, enough: impl Fn(&str) -> bool) -> String {
    read_for(PATIENCE, port, enough)
}

/// Reads until `enough`, or as long as is said.
fn read_for(patience: Duration, port: &mut TTYPort, enough: impl Fn(&str) -> bool) -> String {
    let (start, mut text, mut bytes) = (Instant::now(), String::new(), [0; 4096]);
    while !enough(&text) && start.elapsed() < patience {
        if let Ok(length) = port.read(&mut bytes) {
            text.push_str(std::str::from_utf8(&bytes[..length]).unwrap());
        } else {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
    text
}

/// The sentences of whole lines; each must check.
fn sentences(text: &str) -> Vec<&str> {
    let lines = text.split_inclusive("\r\n");
    let whole = lines.filter_map(|line| line.strip_suffix("\r\n"));
    let sentences = whole.map(|line| {
        let (sentence, checksum) = line.strip_prefix('$').unwrap().split_once('*').unwrap();
        let sum = sentence.bytes().fold(0, |sum, byte| sum ^ byte);
        assert_eq!(checksum, format!("{sum:02X}"), "{line}");
        sentence
    });
    sentences.collect()
}

fn wait_for(what: &str, mut condition: impl FnMut() -> bool) {
    let start = Instant::now();
    while !condition() {
        assert!(start.elapsed() < PATIENCE, "{what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn serial_lines_are_the_references() {
    let (mut reader, _port, path) = terminal();
    let settings = serial::Settings {
        pose: true,
        ..serial_settings(&path)
    };
    let mut serial = opened(&settings, &UNITS);
    let pose = pose();
    let weights = [0.0, 0.5, 1.7];
    let first = Report {
        confidence: 0.784,
        sensor_from_face: Some(&pose),
        ..tracked(33, 0, &weights)
    };
    serial.send(&first).unwrap();
    let mut text = read_until(&mut reader, |text| {
        text.contains("$AUP") && text.ends_with('\n')
    });
    serial
        .send(&report(66, 0, TrackingState::Lost, &[]))
        .unwrap();
    text += &read_until(&mut reader, |text| text.ends_with('\n'));
    drop(serial);
    text += &read_until(&mut reader, |text| text.ends_with('\n'));
    assert_eq!(
        sentences(&text),
        [
            "AUH,1,1,AU25,AU12L,AU12R",
            "AU,0,33,2,78,0,50,100",
            "AUP,0,100,-250,750,286,0,0",
            "AU,1,66,4,0,0,50,100",
            "AU,2,66,0,0,0,0,0",
        ]
    );
    assert!(text.starts_with("$AUH,1,1,AU25,AU12L,AU12R*"));
}

#[test]
fn serial_styles_plot_and_cobs_are_the_references() {
    let plot = &b"AU25:0,AU12L:50,AU12R:100\r\nAU25:0,AU12L:0,AU12R:0\r\n"[..];
    // The names first.
    let cobs = b"\x17\x10\x01\x03\x04AU25\x05AU12L\x05AU12R";
    for (style, expected) in [(serial::Style::Plot, plot), (serial::Style::Cobs, cobs)] {
        let (mut reader, _port, path) = terminal();
        let settings = serial::Settings {
            style,
            ..serial_settings(&path)
        };
        let mut serial = opened(&settings, &UNITS);
        let mut bytes = Vec::new();
        let mut read = |enough: usize| {
            wait_for("bytes", || {
                let mut some = [0; 512];
                let length = reader.read(&mut some).unwrap_or(0);
                bytes.extend_from_slice(&some[..length]);
                bytes.len() >= enough
            });
        };
        serial.send(&tracked(0, 0, &[0.0, 0.5, 1.0])).unwrap();
        read(27);
        drop(serial);
        read(expected.len());
        assert_eq!(&bytes[..expected.len()], expected, "{style:?}");
    }
}

#[test]
fn serial_follows_one_face_until_it_is_lost() {
    let (mut reader, _port, path) = terminal();
    let mut serial = opened(&serial_settings(&path), &UNITS);
    let mut said = |patience, report: &Report| {
        serial.send(report).unwrap();
        let text = read_for(patience, &mut reader, |text| {
            text.ends_with('\n') && text.contains("$AU,")
        });
        let lines = sentences(&text);
        // The header comes again every few seconds.
        let line = lines.iter().rfind(|line| line.starts_with("AU,"))?;
        Some(line.split(',').skip(3).collect::<Vec<_>>().join(" "))
    };
    let first = said(PATIENCE, &tracked(0, 0, &[0.1; 3]));
    assert_eq!(first.unwrap(), "2 79 10 10 10");
    let another = said(SILENCE, &tracked(0, 1, &[0.2; 3]));
    assert_eq!(another, None, "another face is not on the line");
    let lost = said(PATIENCE, &report(33, 0, TrackingState::Lost, &[]));
    assert_eq!(lost.unwrap(), "4 0 10 10 10");
    let next = said(PATIENCE, &tracked(33, 1, &[0.2; 3]));
    assert_eq!(next.unwrap(), "2 79 20 20 20");
    let former = said(SILENCE, &report(66, 0, TrackingState::Lost, &[]));
    assert_eq!(former, None);
    assert_eq!(said(PATIENCE, &nobody(99)).unwrap(), "0 0 20 20 20");
}

#[test]
fn serial_port_that_is_absent_or_unplugged_is_found_again() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("by-id");
    let mut serial = Serial::new(&serial_settings(path.to_str().unwrap()), &UNITS).unwrap();
    for plugged in 0..2 {
        assert!(!serial.tally().connected);
        let start = Instant::now();
        for ms in 0..100 {
            serial.send(&tracked(ms, 0, &[0.1; 3])).unwrap();
        }
        // If each waited for the next look, half a second after the last, they would take five times as long.
        let took = start.elapsed();
        assert!(took < Duration::from_secs(10), "an absent port holds up");
        let (mut reader, _, port) = terminal();
        std::os::unix::fs::symlink(port, &path).unwrap();
        wait_for("opened", || serial.tally().connected);
        let text = read_until(&mut reader, |text| {
            text.contains("$AU,") && text.ends_with('\n')
        });
        let lines = sentences(&text);
        assert_eq!(lines[0], "AUH,1,1,AU25,AU12L,AU12R", "plugged {plugged}");
        // The newest frame waited.
        assert!(lines[1].contains(",99,2,79,10,10,10"), "{}", lines[1]);
        assert!(serial.tally().dropped >= 99);
        std::fs::remove_file(&path).unwrap();
        drop(reader);
        wait_for("lost", || {
            serial.send(&tracked(200, 0, &[0.1; 3])).unwrap();
            !serial.tally().connected
        });
    }
}

#[test]
fn serial_port_that_takes_nothing_holds_nothing_up() {
    let (reader, _port, path) = terminal();
    let settings = serial::Settings {
        baud: 921_600,
        ..serial_settings(&path)
    };
    let mut serial = opened(&settings, &["AU25"; 60]);
    // Nobody reads; a pseudo-terminal takes some tens of kB, then no more.
    let mut in_calls = Duration::ZERO;
    for ms in 0..600 {
        let start = Instant::now();
        serial.send(&tracked(ms, 0, &[0.1; 3])).unwrap();
        in_calls += start.elapsed();
        std::thread::sleep(Duration::from_millis(3));
    }
    let replaced = serial.tally().dropped;
    println!("600 calls took {in_calls:?}, {replaced} frames replaced");
    // If each waited for the port, if only until writing to it is given up after 20 ms, they would take twice as long.
    assert!(in_calls < Duration::from_secs(6));
    assert!(serial.tally().dropped > 100);
    let start = Instant::now();
    drop(serial);
    assert!(start.elapsed() < PATIENCE, "closing does not wait for ever");
    drop(reader);
}

#[test]
fn serial_keeps_to_the_baud_rate() {
    let (mut reader, _port, path) = terminal();
    let settings = serial::Settings {
        baud: 9600,
        ..serial_settings(&path)
    };
    let mut serial = opened(&settings, &UNITS);
    let start = Instant::now();
    let mut bytes = 0;
    while bytes < 900 && start.elapsed() < PATIENCE {
        let ms = start.elapsed().as_millis() as u64;
        serial.send(&tracked(ms, 0, &[0.1; 3])).unwrap();
        let mut some = [0; 256];
        bytes += reader.read(&mut some).unwrap_or(0);
    }
    let budget = start.elapsed().as_secs_f64() * 960.0;
    println!("{bytes} bytes, budget {budget:.0}");
    // The header and a line may be on their way.
    assert!((bytes as f64) < budget + 70.0);
    assert!(bytes >= 900, "it stands still");
}
