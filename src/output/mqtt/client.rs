//! The thread that talks to the broker.
//! One file: what is sent, when, and what happens to it over a lost connection depend on each other.

use std::fmt::Write as _;
use std::io::{ErrorKind, Read, Write as _};
use std::os::fd::AsRawFd;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, poll};

use super::packet::{self, Hello, LONGEST, Message, Nonsense, Told};
use super::stream::{Stream, Trust};
use crate::base::capacity::USERS;
use crate::base::json::Quoted;
use crate::output::board::{Bell, Board, Shared, Weight, count};
use crate::output::features::MqttSettings;
use crate::output::{Command, TrackingState};

/// Presence changes that may wait for a broker.
pub(super) const QUEUE: usize = 64;

/// Keep-alive, seconds: after one and a half times this without traffic, either side considers the other dead.
const KEEP_ALIVE_S: u16 = 10;
/// How long a connection, or what is written, may take.
const PATIENCE: Duration = Duration::from_secs(10);
/// First and longest pause before reconnecting.
const PAUSES: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(30)];
/// Bytes that may be queued before weights are dropped, and at all.
const WAITING: [usize; 2] = [16 * 1024, 32 * 1024];
/// Longest time a message may stay unacknowledged.
const UNACKNOWLEDGED: Duration = Duration::from_secs(20);
/// Reads in a row, and the rest after as many.
const READS: usize = 4;
const REST: Duration = Duration::from_millis(10);
/// Burst of commands allowed, and the time after which one more is.
const AT_ONCE: u32 = 16;
const EACH: Duration = Duration::from_millis(250);
/// A sensor without frames for this long is reported as gone.
const NO_FRAMES: Duration = Duration::from_secs(2);

/// A message that must reach the broker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Item {
    Online,
    /// Index of a Home Assistant message.
    Discovery(usize),
    Faces(usize),
    State {
        slot: usize,
        state: TrackingState,
        changes: u32,
        at_us: u64,
    },
}

/// What is published, and to which broker.
pub(super) struct Talk {
    broker: String,
    trust: Trust,
    version: u8,
    client: String,
    user: Option<String>,
    password: Option<String>,
    /// Prefix and name.
    base: String,
    /// With a slash, of each user.
    presence: String,
    units: Box<[String]>,
    /// Topics and payloads for Home Assistant.
    discovery: Box<[(String, String)]>,
    commands: bool,
    /// Topic of the commands.
    heard: String,
    weights_each: Option<Duration>,
    health_each: Duration,
}

impl Talk {
    pub(super) fn new(
        settings: &MqttSettings,
        name: &str,
        (trust, password): (Trust, Option<String>),
        units: &[String],
    ) -> Self {
        let base = format!("{}/{name}", settings.prefix);
        let discovery = if settings.home_assistant {
            discovery(&base, name, settings.commands)
        } else {
            Vec::new()
        };
        Self {
            broker: settings.broker.clone(),
            trust,
            version: settings.version as u8,
            client: format!("mien-{name}"),
            user: Some(settings.user.clone()).filter(|user| !user.is_empty()),
            password,
            presence: format!("{base}/presence"),
            heard: format!("{base}/cmd/+"),
            base,
            units: units
                .iter()
                .map(|unit| format!("{}:", Quoted(unit)))
                .collect(),
            discovery: discovery.into(),
            commands: settings.commands,
            weights_each: (settings.rate_hz > 0.0)
                .then(|| Duration::from_secs_f32(1.0 / settings.rate_hz)),
            health_each: Duration::from_secs_f32(settings.health_s),
        }
    }

    /// Topic and payload of an item.
    fn item(&self, item: Item, topic: &mut String, payload: &mut String) {
        topic.clear();
        payload.clear();
        // Strings take everything.
        let _ = match item {
            Item::Online => {
                topic.push_str(&self.presence);
                payload.push_str("online");
                Ok(())
            }
            Item::Discovery(i) => {
                topic.push_str(&self.discovery[i].0);
                payload.push_str(&self.discovery[i].1);
                Ok(())
            }
            Item::Faces(faces) => {
                write!(topic, "{}/faces", self.base).and_then(|()| write!(payload, "{faces}"))
            }
            Item::State {
                slot,
                state,
                changes,
                at_us,
            } => write!(topic, "{}/{slot}/state", self.base).and_then(|()| {
                write!(
                    payload,
                    "{{\"state\":\"{}\",\"present\":{},\"changes\":{changes},\"time_us\":{at_us}}}",
                    state.name(),
                    state.is_present()
                )
            }),
        };
    }

    /// The command in a message on one of our topics.
    fn command(&self, topic: &[u8], payload: &[u8]) -> Option<Command> {
        let topic = std::str::from_utf8(topic).ok()?;
        let what = topic
            .strip_prefix(self.base.as_str())?
            .strip_prefix("/cmd/")?;
        let mut words = std::str::from_utf8(payload).ok()?.split_whitespace();
        let slot = words
            .next()?
            .parse()
            .ok()
            .filter(|&slot: &usize| slot < USERS)?;
        let on = words.next();
        if words.next().is_some() {
            return None;
        }
        match (what, on) {
            ("forget", None) => Some(Command::Forget(slot)),
            ("neutral", None) => Some(Command::Neutral(slot)),
            ("freeze", Some("0" | "1")) => Some(Command::Freeze(slot, on == Some("1"))),
            _ => None,
        }
    }
}

/// Home Assistant discovery messages: topics and payloads.
fn discovery(base: &str, name: &str, commands: bool) -> Vec<(String, String)> {
    let device = format!(
        "\"availability_topic\":\"{base}/presence\",\"device\":{{\"identifiers\":[\"mien_{name}\"],\"name\":\"mien {name}\",\"model\":\"mien\",\"sw_version\":\"{}\"}}",
        env!("CARGO_PKG_VERSION")
    );
    let one = |kind: &str, id: &str, rest: &str| {
        let topic = format!("homeassistant/{kind}/mien_{name}/{id}/config");
        (
            topic,
            format!("{{\"unique_id\":\"mien_{name}_{id}\",{rest},{device}}}"),
        )
    };
    let state = |topic: &str, template: &str, rest: &str| {
        format!(
            "\"state_topic\":\"{base}/{topic}\",\"value_template\":\"{{{{ {template} }}}}\",{rest}"
        )
    };
    let switch = |condition: &str| format!("'ON' if {condition} else 'OFF'");
    let mut all = vec![
        one(
            "binary_sensor",
            "face",
            &state(
                "faces",
                &switch("value|int > 0"),
                "\"name\":\"Face\",\"device_class\":\"occupancy\"",
            ),
        ),
        one(
            "sensor",
            "faces",
            &state(
                "faces",
                "value",
                "\"name\":\"Faces\",\"state_class\":\"measurement\"",
            ),
        ),
        one(
            "binary_sensor",
            "sensor",
            &state(
                "health",
                &switch("value_json.sensor"),
                "\"name\":\"Depth camera\",\"device_class\":\"connectivity\",\"entity_category\":\"diagnostic\"",
            ),
        ),
        one(
            "sensor",
            "rate",
            &state(
                "health",
                "value_json.rate_hz",
                "\"name\":\"Rate\",\"unit_of_measurement\":\"Hz\",\"device_class\":\"frequency\",\"entity_category\":\"diagnostic\"",
            ),
        ),
    ];
    if commands {
        for (id, shown) in [("forget", "Forget"), ("neutral", "Set neutral")] {
            all.push(one(
                "button",
                id,
                &format!("\"name\":\"{shown}\",\"command_topic\":\"{base}/cmd/{id}\",\"payload_press\":\"0\""),
            ));
        }
    }
    all
}

/// State of the users since the start.
struct Watch {
    board: Board,
    states: [TrackingState; USERS],
    changes: [u32; USERS],
    faces: usize,
    queue: heapless::Deque<Item, QUEUE>,
    /// The newest frame and when it came.
    frame: (u64, Instant),
    /// Frames and time at the last health message.
    told: (u64, Instant),
    start: Instant,
}

impl Watch {
    fn new() -> Self {
        let now = Instant::now();
        Self {
            board: Board::default(),
            states: Default::default(),
            changes: [0; USERS],
            faces: 0,
            queue: heapless::Deque::new(),
            frame: (0, now),
            told: (0, now),
            start: now,
        }
    }

    fn push(&mut self, item: Item, shared: &Shared) {
        if self.queue.is_full() {
            self.queue.pop_front();
            count(&shared.dropped);
        }
        // There is room now.
        let _ = self.queue.push_back(item);
    }

    fn state(&self, slot: usize) -> Item {
        Item::State {
            slot,
            state: self.states[slot],
            changes: self.changes[slot],
            at_us: self.board.users[slot].at_us,
        }
    }

    /// Processes new reports.
    fn look(&mut self, shared: &Shared) {
        shared.take(&mut self.board);
        let users = self.board.users.iter().chain([&self.board.nobody]);
        let frame = users.map(|shot| shot.frame).max().unwrap_or(0);
        // Backwards if another source has taken its place.
        if frame != self.frame.0 {
            self.frame = (frame, Instant::now());
        }
        for slot in 0..USERS {
            let state = self.board.users[slot].state;
            if state != self.states[slot] {
                self.states[slot] = state;
                self.changes[slot] += 1;
                self.push(self.state(slot), shared);
            }
        }
        let faces = self
            .states
            .iter()
            .filter(|state| state.is_present())
            .count();
        if faces != self.faces {
            self.faces = faces;
            self.push(Item::Faces(faces), shared);
        }
    }

    fn health(&mut self, shared: &Shared, payload: &mut String) {
        let now = Instant::now();
        let (frames, since) = self.told;
        let rate =
            self.frame.0.saturating_sub(frames) as f64 / (now - since).as_secs_f64().max(1e-3);
        self.told = (self.frame.0, now);
        let latency_us = self
            .board
            .users
            .iter()
            .map(|shot| shot.latency_us)
            .max()
            .unwrap_or(0);
        let _ = write!(
            payload,
            "{{\"sensor\":{},\"rate_hz\":{rate:.1},\"latency_ms\":{:.1},\"faces\":{},\"frames\":{},\"uptime_s\":{:.1},\"dropped\":{}}}",
            now - self.frame.1 < NO_FRAMES && self.frame.0 > 0,
            f64::from(latency_us) * 1e-3,
            self.faces,
            self.frame.0,
            (now - self.start).as_secs_f64(),
            shared.dropped.load(Ordering::Relaxed)
        );
    }
}

/// Buffers, allocated once.
struct Buffers {
    out: Vec<u8>,
    heard: Box<[u8; LONGEST]>,
    topic: String,
    payload: String,
}

/// Why a connection ended.
#[derive(Debug)]
enum End {
    Stopped,
    Lost(std::io::Error),
    Refused(u8),
    Nonsense,
    Slow,
}

impl std::fmt::Display for End {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Stopped => f.write_str("stopped"),
            Self::Lost(error) => write!(f, "{error}"),
            Self::Refused(code) => write!(
                f,
                "connection refused with code {code}; are mqtt.user and mqtt.password_file right?"
            ),
            Self::Nonsense => f.write_str("the reply is not MQTT; is it a broker?"),
            Self::Slow => f.write_str("no reply"),
        }
    }
}

/// Runs until told to stop.
pub(super) fn run(talk: Talk, shared: &Arc<Shared>, mut bell: Bell) {
    let mut watch = Watch::new();
    let mut buffers = Buffers {
        out: Vec::with_capacity(WAITING[1]),
        heard: Box::new([0; LONGEST]),
        topic: String::with_capacity(256),
        payload: String::with_capacity(4096),
    };
    let (mut pause, mut told) = (PAUSES[0], false);
    loop {
        let end = match Stream::connect(&talk.broker, &talk.trust) {
            Ok(stream) => {
                let mut connection = Connection::new(stream, &talk, shared);
                let end = connection.run(&mut bell, &mut watch, &mut buffers);
                // What was not acknowledged goes first on the next connection.
                if let Some((item @ (Item::State { .. } | Item::Faces(_)), ..)) = connection.asked
                    && watch.queue.push_front(item).is_err()
                {
                    count(&shared.dropped);
                }
                if connection.settled {
                    (pause, told) = (PAUSES[0], false);
                }
                end
            }
            Err(error) => End::Lost(error),
        };
        shared.connected.store(false, Ordering::Relaxed);
        if matches!(end, End::Stopped) || shared.stop.load(Ordering::Relaxed) {
            return;
        }
        if matches!(end, End::Nonsense | End::Refused(_)) {
            count(&shared.refused);
        }
        if !std::mem::replace(&mut told, true) {
            tracing::warn!(
                "MQTT broker {}: {end}; retrying until it is back",
                talk.broker
            );
        }
        // Meanwhile what changes is kept.
        let again = Instant::now() + pause;
        pause = (2 * pause).min(PAUSES[1]);
        while Instant::now() < again {
            let left = again.saturating_duration_since(Instant::now()).as_millis() as i32;
            let _ = poll(
                &mut [PollFd::new(bell.fd(), PollFlags::POLLIN)],
                left.max(1),
            );
            bell.answer();
            watch.look(shared);
            if shared.stop.load(Ordering::Relaxed) {
                return;
            }
        }
    }
}

struct Connection<'a> {
    stream: Stream,
    talk: &'a Talk,
    shared: &'a Shared,
    /// Whether the broker has accepted the connection.
    settled: bool,
    begun: Instant,
    /// When something was last received, and sent.
    heard: Instant,
    wrote: Instant,
    pinged: Instant,
    length: usize,
    written: usize,
    /// The message waiting for its acknowledgement, its number, and since when.
    asked: Option<(Item, u16, Instant)>,
    number: u16,
    /// Messages after connecting: online, then discovery.
    introduced: usize,
    weights_due: Instant,
    health_due: Instant,
    /// When the allowance for commands is full again.
    whole: Instant,
}

impl<'a> Connection<'a> {
    fn new(stream: Stream, talk: &'a Talk, shared: &'a Shared) -> Self {
        let now = Instant::now();
        Self {
            stream,
            talk,
            shared,
            settled: false,
            begun: now,
            heard: now,
            wrote: now,
            pinged: now,
            length: 0,
            written: 0,
            asked: None,
            number: 0,
            introduced: 0,
            weights_due: now,
            health_due: now,
            whole: now,
        }
    }

    fn run(&mut self, bell: &mut Bell, watch: &mut Watch, buffers: &mut Buffers) -> End {
        buffers.out.clear();
        let talk = self.talk;
        packet::connect(
            &Hello {
                version: talk.version,
                client: &talk.client,
                keep_alive: KEEP_ALIVE_S,
                will: (&talk.presence, "offline"),
                user: talk.user.as_deref(),
                password: talk.password.as_deref(),
            },
            &mut buffers.out,
        );
        loop {
            if let Err(end) = self.step(bell, watch, buffers) {
                return end;
            }
            if self.shared.stop.load(Ordering::Relaxed) {
                watch.look(self.shared);
                self.goodbye(watch, buffers);
                return End::Stopped;
            }
        }
    }

    fn step(
        &mut self,
        bell: &mut Bell,
        watch: &mut Watch,
        buffers: &mut Buffers,
    ) -> Result<(), End> {
        let pending = self.written < buffers.out.len();
        let flags = if self.stream.waits_to_write(pending) {
            PollFlags::POLLIN | PollFlags::POLLOUT
        } else {
            PollFlags::POLLIN
        };
        let mut asked = [
            PollFd::new(bell.fd(), PollFlags::POLLIN),
            PollFd::new(self.stream.as_raw_fd(), flags),
        ];
        let _ = poll(&mut asked, 500);
        bell.answer();
        watch.look(self.shared);
        self.read(buffers)?;
        let now = Instant::now();
        if self.settled {
            self.speak(watch, buffers, now);
        }
        self.write(&mut buffers.out)?;
        let silence = now - self.heard;
        let unacknowledged = self
            .asked
            .is_some_and(|(.., since)| now - since > UNACKNOWLEDGED);
        let stuck = self.written < buffers.out.len() && now - self.wrote > PATIENCE;
        let late = !self.settled && now - self.begun > PATIENCE;
        if late || stuck || unacknowledged || silence > 2 * PATIENCE {
            return Err(End::Slow);
        }
        Ok(())
    }

    fn write(&mut self, out: &mut Vec<u8>) -> Result<(), End> {
        while self.written < out.len() {
            match self.stream.write(&out[self.written..]) {
                Ok(more) => {
                    self.written += more;
                    self.wrote = Instant::now();
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(End::Lost(error)),
            }
        }
        out.drain(..self.written);
        self.written = 0;
        Ok(())
    }

    fn read(&mut self, buffers: &mut Buffers) -> Result<(), End> {
        for _ in 0..READS {
            match self.stream.read(&mut buffers.heard[self.length..]) {
                Ok(0) => return Err(End::Lost(ErrorKind::UnexpectedEof.into())),
                Ok(more) => self.length += more,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => return Err(End::Lost(error)),
            }
            let mut used = 0;
            while let Some((told, more)) =
                packet::read(self.talk.version, &buffers.heard[used..self.length])
                    .map_err(|Nonsense| End::Nonsense)?
            {
                self.hear(&told, &mut buffers.out)?;
                used += more;
            }
            buffers.heard.copy_within(used..self.length, 0);
            self.length -= used;
        }
        // A broker that talks without end waits: it takes neither the processor nor our turn to write.
        std::thread::sleep(REST);
        Ok(())
    }

    fn hear(&mut self, told: &Told, out: &mut Vec<u8>) -> Result<(), End> {
        self.heard = Instant::now();
        match *told {
            Told::Connected(0) if !self.settled => {
                self.settled = true;
                self.shared.connected.store(true, Ordering::Relaxed);
                tracing::info!("connected to MQTT broker {}", self.talk.broker);
                if self.talk.commands {
                    let number = self.next_number();
                    packet::subscribe(self.talk.version, number, &self.talk.heard, out);
                }
            }
            Told::Connected(0) => return Err(End::Nonsense),
            Told::Connected(code) => return Err(End::Refused(code)),
            _ if !self.settled => return Err(End::Nonsense),
            Told::Acknowledged(number) => {
                if self.asked.is_some_and(|(_, asked, _)| asked == number) {
                    self.asked = None;
                    count(&self.shared.sent);
                }
            }
            Told::Subscribed(code) if code >= 0x80 => {
                tracing::warn!(
                    "MQTT broker {} refuses the subscription to commands",
                    self.talk.broker
                );
                count(&self.shared.refused);
            }
            Told::Subscribed(_) | Told::Alive => {}
            Told::Goodbye => return Err(End::Lost(ErrorKind::ConnectionAborted.into())),
            Told::Message {
                topic,
                payload,
                retained,
                number,
            } => {
                if let Some(number) = number
                    && out.len() < WAITING[1] - LONGEST
                {
                    packet::acknowledge(number, out);
                }
                let now = Instant::now();
                let may = self.whole.saturating_duration_since(now) <= EACH * (AT_ONCE - 1);
                match self
                    .talk
                    .command(topic, payload)
                    .filter(|_| may && !retained && self.talk.commands)
                {
                    Some(command) => {
                        self.whole = self.whole.max(now) + EACH;
                        self.shared.ask(command);
                    }
                    None => count(&self.shared.refused),
                }
            }
        }
        Ok(())
    }

    fn next_number(&mut self) -> u16 {
        self.number = self.number.checked_add(1).unwrap_or(1);
        self.number
    }

    /// Sends what is due.
    fn speak(&mut self, watch: &mut Watch, buffers: &mut Buffers, now: Instant) {
        if self.asked.is_none() {
            let discovery = self.talk.discovery.len();
            let item = match self.introduced {
                0 => Some(Item::Online),
                i if i <= discovery => Some(Item::Discovery(i - 1)),
                i if i == discovery + 1 => {
                    // What the broker keeps of us may be older than what it missed.
                    for slot in 0..USERS {
                        if watch.changes[slot] > 0 && !watch.queue.is_full() {
                            watch.push(watch.state(slot), self.shared);
                        }
                    }
                    Some(Item::Faces(watch.faces))
                }
                _ => watch.queue.pop_front(),
            };
            self.introduced = (self.introduced + 1).min(discovery + 2);
            if let Some(item) = item {
                let number = self.next_number();
                self.talk
                    .item(item, &mut buffers.topic, &mut buffers.payload);
                self.asked = Some((item, number, now));
                self.publish(buffers, true, Some((number, false)));
            }
        }
        if now >= self.health_due {
            self.health_due = now + self.talk.health_each;
            buffers.payload.clear();
            watch.health(self.shared, &mut buffers.payload);
            buffers.topic.clear();
            let _ = write!(buffers.topic, "{}/health", self.talk.base);
            self.publish(buffers, true, None);
        }
        if let Some(each) = self.talk.weights_each
            && now >= self.weights_due
        {
            let mut any = false;
            for slot in 0..USERS {
                let shot = &mut watch.board.users[slot];
                // A lost face is told while it fades.
                if !std::mem::take(&mut shot.fresh) {
                    continue;
                }
                any = true;
                if buffers.out.len() > WAITING[0] {
                    count(&self.shared.dropped);
                    continue;
                }
                let shot = &watch.board.users[slot];
                buffers.topic.clear();
                buffers.payload.clear();
                let _ = write!(buffers.topic, "{}/{slot}/weights", self.talk.base);
                let _ = write!(buffers.payload, "{{\"time_us\":{}", shot.at_us);
                for (name, weight) in self.talk.units.iter().zip(&shot.weights) {
                    let _ = write!(buffers.payload, ",{name}{}", Weight(*weight));
                }
                buffers.payload.push('}');
                self.publish(buffers, false, None);
                count(&self.shared.sent);
            }
            if any {
                self.weights_due = (self.weights_due + each).max(now);
            }
        }
        let quiet = Duration::from_secs(u64::from(KEEP_ALIVE_S)) / 2;
        // Also while weights go out: only this is answered, so only this tells whether somebody is there.
        if now - self.heard.max(self.pinged) > quiet && buffers.out.is_empty() {
            packet::ping(&mut buffers.out);
            self.pinged = now;
        }
    }

    /// Topic and payload of the buffers.
    fn publish(&self, buffers: &mut Buffers, retain: bool, number: Option<(u16, bool)>) {
        let message = Message {
            topic: &buffers.topic,
            payload: buffers.payload.as_bytes(),
            retain,
            number,
        };
        packet::publish(self.talk.version, &message, &mut buffers.out);
    }

    /// Publishes that everybody and the box are gone, as far as the broker accepts it in a moment.
    fn goodbye(&mut self, watch: &mut Watch, buffers: &mut Buffers) {
        if !self.settled {
            return;
        }
        while let Some(item) = watch.queue.pop_front() {
            if buffers.out.len() > WAITING[0] {
                break;
            }
            let number = self.next_number();
            self.talk
                .item(item, &mut buffers.topic, &mut buffers.payload);
            self.publish(buffers, true, Some((number, false)));
        }
        buffers.topic.clone_from(&self.talk.presence);
        buffers.payload.clear();
        buffers.payload.push_str("offline");
        let number = self.next_number();
        self.publish(buffers, true, Some((number, false)));
        packet::disconnect(&mut buffers.out);
        self.stream.finish(&buffers.out[self.written..]);
    }
}
