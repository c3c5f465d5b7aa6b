//! Sending on every wire at once takes less than a tenth of a millisecond and no memory.

use std::io::Read;
use std::net::UdpSocket;
use std::time::{Duration, Instant};

use mien_appliance::status::Status;
use mien_outputs::osc::faceosc::{self, FaceOsc};
use mien_outputs::osc::vmc::{self, Vmc};
use mien_outputs::osc::vrchat::{self, VrChat};
use mien_outputs::osc::{self, Osc};
use mien_outputs::serial::{self, Serial};
use mien_outputs::{Output, Report, TrackingState};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::{Point, Rigid};
use mien_stages::base::time::Timestamp;
use mien_stages::expression::UnitRange;
use mien_stages::landmarks::Landmarks;
use serialport::{SerialPort, TTYPort};

use crate::{MEMORY, alone};

const UNITS: [&str; 19] = [
    "AU25", "AU20", "AU18", "AU30L", "AU30R", "AU29", "AU22", "AU28", "AU2L", "AU4L", "AU2R",
    "AU4R", "AU5L", "AU43L", "AU5R", "AU43R", "AU9L", "AU9R", "AU26",
];
/// Frames of a run: 100 s.
const FRAMES: u64 = 3000;
/// Frames until everything has been sent once.
const FIRST: u64 = 200;

#[test]
fn all_wires_at_once_cost_no_memory() {
    let _alone = alone();
    let receiver = UdpSocket::bind("127.0.0.1:0").unwrap();
    let targets = vec![receiver.local_addr().unwrap().to_string()];
    let (mut reader, port) = TTYPort::pair().unwrap();
    reader.set_timeout(Duration::from_millis(20)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut status = Status::new(
        folder.path().join("status.json").to_str().unwrap(),
        "",
        &UNITS,
        &[],
    );
    let serial = serial::Settings {
        port: port.name().unwrap(),
        baud: 921_600,
        pose: true,
        ..serial::Settings::default()
    };
    let serial = Serial::new(&serial, &UNITS).unwrap();
    let waited = Instant::now();
    while !serial.tally().connected && waited.elapsed() < Duration::from_secs(20) {
        std::thread::sleep(Duration::from_millis(5));
    }
    let osc = osc::Settings {
        targets: targets.clone(),
        ranges: true,
        commands: true,
        listen: "127.0.0.1:0".into(),
        ..osc::Settings::default()
    };
    let vmc = vmc::Settings {
        targets: targets.clone(),
        ..vmc::Settings::default()
    };
    let vrchat = vrchat::Settings {
        targets: targets.clone(),
        values: vrchat::Values::Both,
        bits: 8,
        ..vrchat::Settings::default()
    };
    let faceosc = faceosc::Settings {
        targets: targets.clone(),
        ..faceosc::Settings::default()
    };
    let network = network(&targets[0]);
    let mut outputs: Vec<Box<dyn Output>> = vec![
        Box::new(Osc::new(osc, &UNITS).unwrap()),
        Box::new(Vmc::new(vmc, &UNITS).unwrap()),
        Box::new(VrChat::new(vrchat, &UNITS).unwrap()),
        Box::new(FaceOsc::new(faceosc).unwrap()),
        Box::new(serial),
    ];
    outputs.extend(network);

    let pose = Rigid::translation(0.1, 0.0, 0.8);
    let landmarks = Landmarks {
        pixels: [[320.0, 240.0]; LANDMARKS],
        ..Landmarks::certain(std::array::from_fn(|i| {
            Point::new(i as f32 * 1e-3, 0.01, 0.0)
        }))
    };
    let mut random = fastrand::Rng::with_seed(1);
    let mut times = Vec::with_capacity(FRAMES as usize);
    let mut before = 0;
    let mut bytes = [0; 4096];
    for frame in 0..FRAMES {
        // Every unit moves in every frame; now and then nobody is there.
        let weights: [f32; UNITS.len()] = std::array::from_fn(|_| random.f32());
        let ranges = [UnitRange::default(); UNITS.len()];
        let at = Timestamp::from_us(frame * 33_333);
        let face = Report {
            frame,
            at,
            user: Some(0),
            state: TrackingState::Tracking,
            confidence: 0.9,
            sensor_from_face: Some(&pose),
            landmarks: Some(&landmarks),
            weights: &weights,
            ranges: &ranges,
            latency_us: 9000,
            ..Report::default()
        };
        let nobody = Report {
            frame,
            at,
            ..Report::default()
        };
        let report = if frame % 300 < 250 { &face } else { &nobody };
        if frame == FIRST {
            before = MEMORY.requests();
        }
        let start = Instant::now();
        for output in &mut outputs {
            output.send(report).unwrap();
            while output.next_command().is_some() {}
        }
        times.push(start.elapsed());
        status.observe(report, Some(start.elapsed()));
        status.write(outputs.iter().map(|output| output.tally()));
        if frame % 10 == 0 {
            // Time for the port, which is read so that it goes on taking.
            let _ = reader.read(&mut bytes);
        }
    }
    let asked = MEMORY.requests() - before;
    for tally in outputs.iter().map(|output| output.tally()) {
        println!(
            "{}: {} sent, {} dropped",
            tally.name, tally.sent, tally.dropped
        );
        // It has no broker; the page's stream is told a few times a second only.
        let asked = tally.name == "mqtt";
        let least = if tally.name == "page" { 3 } else { 100 };
        assert!(tally.sent > least || asked, "{tally:?}");
    }
    times.sort_unstable();
    let at = |share: f64| times[(share * (times.len() - 1) as f64) as usize];
    println!(
        "per frame: median {:?}, 99 % {:?}; {asked} requests for memory in {} frames",
        at(0.5),
        at(0.99),
        FRAMES - FIRST
    );
    assert_eq!(asked, 0);
}

/// Nothing beyond OSC and serial.
#[cfg(not(feature = "wires"))]
fn network(_: &str) -> Vec<Box<dyn Output>> {
    Vec::new()
}

/// All that are features of the build, with a page that reads; the broker is away.
#[cfg(feature = "wires")]
fn network(target: &str) -> Vec<Box<dyn Output>> {
    use mien_outputs::features::{LiveLinkSettings, MqttSettings, PageSettings, WebSocketSettings};
    use mien_outputs::live_link::LiveLink;
    use mien_outputs::{mqtt, web};
    use std::io::Write;
    use std::net::{TcpListener, TcpStream};

    let live_link = LiveLinkSettings {
        targets: vec![target.to_owned()],
        ..LiveLinkSettings::default()
    };
    let free = || {
        TcpListener::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap()
    };
    let page = free();
    let websocket = WebSocketSettings {
        listen: page.to_string(),
        ..WebSocketSettings::default()
    };
    let phone = PageSettings {
        listen: free().to_string(),
        ..PageSettings::default()
    };
    let broker = MqttSettings {
        broker: free().to_string(),
        ..MqttSettings::default()
    };
    let outputs: Vec<Box<dyn Output>> = vec![
        Box::new(LiveLink::new(live_link, "", &UNITS).unwrap()),
        Box::new(web::websocket::open(&websocket, &UNITS, &["smile"]).unwrap()),
        Box::new(web::page::open(&phone, &[], "", "", &UNITS, &[]).unwrap()),
        Box::new(mqtt::open(&broker, "", &UNITS, &["smile"]).unwrap()),
    ];
    let live = format!("GET /events HTTP/1.1\r\nHost: {}\r\n\r\n", phone.listen);
    let upgrade = "GET / HTTP/1.1\r\nUpgrade: websocket\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";
    for (address, asked) in [(page, upgrade), (phone.listen.parse().unwrap(), &live)] {
        let mut stream = loop {
            match TcpStream::connect(address) {
                Ok(stream) => break stream,
                Err(_) => std::thread::sleep(Duration::from_millis(5)),
            }
        };
        stream.write_all(asked.as_bytes()).unwrap();
        std::thread::spawn(move || {
            let mut bytes = [0; 4096];
            while stream.read(&mut bytes).is_ok_and(|read| read > 0) {}
        });
    }
    outputs
}
