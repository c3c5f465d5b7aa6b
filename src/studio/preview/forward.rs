//! Forwards the data of a live page to other receivers, with the outputs of `mien run`, and sends a test face.
//!
//! One thread handles all receivers. A received stream has no landmarks, so receivers that need them are not in the
//! table. The page names a host and a port, which are turned into a configuration and validated like one. Times in
//! seconds; at most one receiver of each name in [`RECEIVERS`].

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, LazyLock};
use std::time::{Duration, Instant};

use super::hub::{Hub, Passed};
use mien_appliance::settings::Settings;
use mien_outputs::received::Sample;
use mien_outputs::table;
use mien_outputs::{Output, Report, TrackingState};
use mien_stages::base::geometry::Rigid;
use mien_stages::base::time::Timestamp;
use mien_stages::expression::units::Units;

/// A receiver that can be connected by name, as sent to the page.
#[derive(serde::Serialize, serde::Deserialize)]
pub struct ReceiverInfo {
    /// Identifier in URLs.
    pub id: String,
    /// Display name.
    pub name: String,
    /// Section of the configuration.
    pub section: String,
    /// Further lines of the section, beside `enabled` and `target`.
    pub more: String,
    /// Its usual port.
    pub port: u16,
    /// Instructions for it, one sentence.
    pub hint: String,
}

/// Every receiver the page offers.
pub static RECEIVERS: LazyLock<Vec<ReceiverInfo>> = LazyLock::new(|| {
    let known = serde_json::from_str(include_str!("receivers.json"));
    let mut known: Vec<ReceiverInfo> = known.expect("a test reads it");
    let missing = known.iter_mut().filter(|one| one.section == "live_link");
    for one in missing.filter(|_| !cfg!(feature = "wires")) {
        one.hint = "This needs a build with the feature wires (cargo build --release --features studio,wires) or the Debian package.".into();
    }
    known
});

/// An action of the page on a receiver.
#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
pub enum ForwardAction {
    /// Forward the live data.
    Connect,
    /// Send a jaw that opens, a smile and a blink.
    Test,
    /// Stop forwarding.
    Stop,
}

struct Order {
    known: &'static ReceiverInfo,
    target: String,
    action: ForwardAction,
    settings: Settings,
}

/// Most frames queued for the thread.
const QUEUE_LENGTH: usize = 64;
/// Interval of polling for orders, and of frames of a test.
const FRAME: Duration = Duration::from_millis(33);
/// Units of a test, for a second each.
const TESTED: [&[&str]; 3] = [&["AU26"], &["AU12L", "AU12R"], &["AU43L", "AU43R"]];
/// Absence of the person shown after which single-person receivers get another.
const ABSENCE: Duration = Duration::from_secs(1);

/// Handle of the thread.
pub struct Forwarder {
    orders: SyncSender<Order>,
}

impl Forwarder {
    /// Starts the thread.
    pub fn start(hub: Arc<Hub>) -> Self {
        let (onward, passed) = sync_channel(QUEUE_LENGTH);
        let (orders, waiting) = sync_channel(QUEUE_LENGTH);
        hub.pass_on_to(onward);
        // If the thread cannot start, orders are refused.
        let _ = std::thread::Builder::new()
            .name("forward".into())
            .spawn(move || Thread::new(hub).run(&passed, &waiting));
        Self { orders }
    }

    /// Passes an action to the thread; the text says what happens, or why nothing does.
    ///
    /// # Errors
    /// If the receiver is unknown or the address invalid.
    pub fn ask(
        &self,
        id: &str,
        host: &str,
        port: &str,
        action: ForwardAction,
    ) -> Result<String, String> {
        let known = RECEIVERS.iter().find(|known| known.id == id);
        let known = known.ok_or("unknown receiver")?;
        let target = target(host, port)?;
        let settings = settings(known, &target)?;
        let order = Order {
            known,
            target: target.clone(),
            action,
            settings,
        };
        let busy = |_| "too many requests at the same time; try again".to_owned();
        self.orders.try_send(order).map_err(busy)?;
        let name = &known.name;
        Ok(match action {
            ForwardAction::Connect => format!("sending to {name} at {target}"),
            ForwardAction::Test => format!("testing {name} at {target}: jaw, smile, blink"),
            ForwardAction::Stop => format!("stopped sending to {name}"),
        })
    }
}

/// `host:port`, validated.
fn target(host: &str, port: &str) -> Result<String, String> {
    let letters = |byte: u8| byte.is_ascii_alphanumeric() || b".-_:".contains(&byte);
    if host.is_empty() || host.len() > 253 || !host.bytes().all(letters) {
        let expected = "expected a host name or an address";
        return Err(format!("{expected}, found {host:?}"));
    }
    let none = |_| format!("expected a port from 1 to 65535, found {port:?}");
    let number: std::num::NonZeroU16 = port.parse().map_err(none)?;
    Ok(match host.contains(':') {
        true => format!("[{host}]:{number}"),
        false => format!("{host}:{number}"),
    })
}

/// The configuration with this receiver as only output.
fn settings(known: &ReceiverInfo, target: &str) -> Result<Settings, String> {
    let ReceiverInfo { section, more, .. } = known;
    let only = match &**section {
        "osc" => "",
        _ => "[osc]\nenabled = false\n",
    };
    let text = format!("{only}[{section}]\nenabled = true\ntarget = \"{target}\"\n{more}");
    Settings::parse(&text, Path::new("receiver")).map_err(|error| error.to_string())
}

struct Line {
    target: String,
    settings: Settings,
    outputs: Vec<Box<dyn Output>>,
    /// Start time of a test.
    tested: Option<Instant>,
    /// Whether live data are forwarded.
    connected: bool,
}

struct Thread {
    hub: Arc<Hub>,
    units: Vec<String>,
    lines: BTreeMap<&'static str, Line>,
    /// The person for single-person receivers, and when last seen.
    main: Option<(usize, Instant)>,
    start: Instant,
    tests: u64,
}

impl Thread {
    fn new(hub: Arc<Hub>) -> Self {
        let units = Units::shipped().columns(false);
        Self {
            hub,
            units: units.iter().map(ToString::to_string).collect(),
            lines: BTreeMap::new(),
            main: None,
            start: Instant::now(),
            tests: 0,
        }
    }

    fn run(mut self, passed: &Receiver<Passed>, orders: &Receiver<Order>) {
        let mut states_sent = Instant::now();
        loop {
            while let Ok(order) = orders.try_recv() {
                self.handle_order(order);
                self.send_states();
            }
            match passed.recv_timeout(FRAME) {
                Ok(Passed::Sample(sample)) => self.pass_on(&sample),
                Ok(Passed::Units(units)) if units == self.units => {}
                Ok(Passed::Units(units)) => {
                    self.units = units;
                    for line in self.lines.values_mut() {
                        line.outputs = Self::open(&self.units, &line.settings);
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                // A session is not forwarded, but receivers can be tested.
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(FRAME),
            }
            self.test();
            if states_sent.elapsed() > Duration::from_secs(1) {
                states_sent = Instant::now();
                self.send_states();
            }
        }
    }

    fn open(units: &[String], settings: &Settings) -> Vec<Box<dyn Output>> {
        let units: Vec<&str> = units.iter().map(String::as_str).collect();
        // The settings were checked; without a socket nothing is sent, and the page shows that.
        table::open(&settings.outputs, &units).unwrap_or_default()
    }

    fn handle_order(&mut self, order: Order) {
        if order.action == ForwardAction::Stop {
            self.lines.remove(&*order.known.id);
            return;
        }
        let units = &self.units;
        let fresh = || Line {
            target: order.target.clone(),
            outputs: Self::open(units, &order.settings),
            settings: order.settings.clone(),
            tested: None,
            connected: false,
        };
        let line = self.lines.entry(&order.known.id).or_insert_with(fresh);
        if line.target != order.target {
            *line = fresh();
        }
        match order.action {
            ForwardAction::Test => line.tested = Some(Instant::now()),
            _ => line.connected = true,
        }
    }

    /// Whether this slot is the person for single-person receivers.
    fn is_main(&mut self, slot: usize) -> bool {
        let is_free = |(main, seen): (usize, Instant)| main == slot || seen.elapsed() > ABSENCE;
        let free = self.main.is_none_or(is_free);
        if free {
            self.main = Some((slot, Instant::now()));
        }
        free
    }

    fn pass_on(&mut self, sample: &Sample) {
        let other_is_shown = sample.user.is_some_and(|slot| !self.is_main(slot));
        let pose = sample.pose.map(rigid);
        let seen = sample.state.has_face() && sample.weights.len() == self.units.len();
        let report = Report {
            frame: sample.number,
            at: Timestamp::from_us((sample.seconds.max(0.0) * 1e6) as u64),
            user: sample.user,
            state: sample.state,
            none_left: sample.user.is_none(),
            other_is_shown,
            confidence: sample.confidence,
            frozen: sample.frozen,
            sensor_from_face: pose.as_ref(),
            weights: if seen { &sample.weights } else { &[] },
            ..Report::default()
        };
        let lines = self.lines.values_mut();
        for line in lines.filter(|line| line.connected && line.tested.is_none()) {
            send(line, &report);
        }
    }

    fn test(&mut self) {
        let at = Timestamp::from_us(self.start.elapsed().as_micros() as u64);
        let pose = Rigid::translation(0.0, 0.0, 0.8);
        for line in self.lines.values_mut() {
            let Some(begun) = line.tested else { continue };
            let seconds = begun.elapsed().as_secs_f32();
            let Some(moved) = TESTED.get(seconds as usize) else {
                line.tested = None;
                continue;
            };
            let weight = 1.0 - (2.0 * seconds.fract() - 1.0).abs();
            let of = |unit: &String| f32::from(u8::from(moved.contains(&unit.as_str()))) * weight;
            let weights: Vec<f32> = self.units.iter().map(of).collect();
            self.tests += 1;
            let report = Report {
                frame: self.tests,
                at,
                user: Some(0),
                state: TrackingState::Tracking,
                confidence: 1.0,
                sensor_from_face: Some(&pose),
                weights: &weights,
                ..Report::default()
            };
            send(line, &report);
        }
    }

    /// Sends the receivers' states to all pages.
    fn send_states(&self) {
        let line = |(id, line): (&&'static str, &Line)| {
            let tallies = || line.outputs.iter().map(|output| output.tally());
            let sent: u64 = tallies().map(|tally| tally.sent).sum();
            let dropped: u64 = tallies().map(|tally| tally.dropped).sum();
            let why = if line.outputs.is_empty() {
                "cannot open a socket, or this build does not support it"
            } else if sent == 0 && dropped > 0 {
                "the host name does not resolve yet, or the host is unreachable"
            } else {
                ""
            };
            let json = serde_json::json!({"target": line.target, "sent": sent, "connected": line.connected,
                "testing": line.tested.is_some(), "why": why});
            ((*id).to_owned(), json)
        };
        let all: serde_json::Map<String, serde_json::Value> = self.lines.iter().map(line).collect();
        let json = serde_json::Value::Object(all).to_string();
        self.hub.fact("receivers", "receivers", &json);
    }
}

fn send(line: &mut Line, report: &Report) {
    // An output that failed for good is removed.
    line.outputs.retain_mut(|output| {
        let sent = output.send(report).is_ok();
        // Commands of a receiver are for the tracking process.
        while output.next_command().is_some() {}
        sent
    });
}

fn rigid([x, y, z, qx, qy, qz, qw]: [f32; 7]) -> Rigid {
    let turn = nalgebra::Quaternion::new(qw, qx, qy, qz);
    let turn = nalgebra::UnitQuaternion::from_quaternion(turn);
    Rigid::from_parts([x, y, z].into(), turn)
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_outputs::received::Receive as _;
    use std::net::UdpSocket;

    #[test]
    fn every_known_receiver_is_a_configuration() {
        for known in RECEIVERS.iter() {
            let found = settings(known, "10.0.0.7:4000");
            assert!(found.is_ok(), "{}: {:?}", known.id, found.err());
        }
    }

    #[test]
    fn only_a_host_and_a_port_become_a_target() {
        assert_eq!(
            target("stage-pc.local", "9000").unwrap(),
            "stage-pc.local:9000"
        );
        assert_eq!(target("fe80::1", "9000").unwrap(), "[fe80::1]:9000");
        for host in ["", "a b", "a\"\nx"] {
            assert!(target(host, "1").is_err(), "{host:?}");
        }
        for port in ["0", "65536", ""] {
            assert!(target("a", port).is_err(), "{port:?}");
        }
    }

    #[test]
    fn live_data_and_a_test_reach_a_receiver() {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket
            .set_read_timeout(Some(Duration::from_secs(30)))
            .unwrap();
        let port = socket.local_addr().unwrap().port().to_string();
        let hub = Arc::new(Hub::new(false));
        let forwarder = Forwarder::start(Arc::clone(&hub));
        hub.schema(&["AU25".into(), "AU26".into()]);
        let has = |wanted: &[u8]| {
            let mut bytes = [0; 4096];
            (0..200).any(|_| {
                let length = socket.recv(&mut bytes).unwrap();
                let mut parts = bytes[..length].windows(wanted.len());
                parts.any(|part| part == wanted)
            })
        };
        let ask = |id, action| forwarder.ask(id, "127.0.0.1", &port, action).is_ok();
        assert!(ask("max", ForwardAction::Test));
        assert!(has(b"/face/0/au/AU26"));
        assert!(ask("max", ForwardAction::Stop));
        assert!(ask("max", ForwardAction::Connect));
        let shown = Sample {
            user: Some(2),
            state: TrackingState::Tracking,
            weights: vec![0.0, 0.625],
            ..Sample::default()
        };
        std::thread::scope(|scope| {
            let teller = scope.spawn(|| {
                for _ in 0..100 {
                    hub.sample(&shown);
                    std::thread::sleep(Duration::from_millis(20));
                }
            });
            assert!(has(&0.625_f32.to_be_bytes()));
            teller.join().unwrap();
        });
        assert!(!ask("nobody", ForwardAction::Test));
    }
}
