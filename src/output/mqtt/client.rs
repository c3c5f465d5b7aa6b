//! The thread that talks to the broker: connects, speaks, listens, and comes back.

use std::io::{ErrorKind, Read, Write as _};
use std::os::fd::AsRawFd;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, poll};

use super::packet::{self, LONGEST, Nonsense, Told};
use super::stream::Stream;
use super::talk::Talk;
use super::watch::{Change, Draft, Watch};
use crate::base::capacity::USERS;
use crate::output::board::{Bell, Shared, count};
use crate::output::limits::{Allowance, BackOff};

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

/// Why a connection ended.
#[derive(Debug, thiserror::Error)]
enum End {
    #[error("stopped")]
    Stopped,
    #[error(transparent)]
    Lost(#[from] std::io::Error),
    #[error("connection refused with code {0}; are mqtt.user and mqtt.password_file right?")]
    Refused(u8),
    #[error("the reply is not MQTT; is it a broker?")]
    Nonsense,
    #[error("no reply")]
    Slow,
}

/// Runs until told to stop.
pub(super) fn run(talk: Talk, shared: &Arc<Shared>, mut bell: Bell) {
    let mut watch = Watch::new(&talk.units, &talk.gestures);
    let mut buffers = Buffers {
        out: Vec::with_capacity(WAITING[1]),
        heard: Box::new([0; LONGEST]),
        draft: Draft {
            topic: String::with_capacity(256),
            payload: String::with_capacity(4096),
        },
    };
    let (mut back_off, mut told) = (BackOff::new(PAUSES), false);
    loop {
        let end = match Stream::connect(&talk.broker, &talk.trust) {
            Ok(stream) => {
                let mut connection = Connection::new(stream, &talk, shared);
                let end = connection.run(&mut bell, &mut watch, &mut buffers);
                // What was not acknowledged goes first on the next connection.
                if let Some((Some(change), ..)) = connection.asked
                    && watch.queue.push_front(change).is_err()
                {
                    count(&shared.dropped);
                }
                if connection.settled {
                    back_off.reset();
                    told = false;
                }
                end
            }
            Err(error) => End::Lost(error),
        };
        shared.connected.store(false, Ordering::Relaxed);
        if matches!(end, End::Stopped) {
            return;
        }
        if matches!(end, End::Nonsense | End::Refused(_)) {
            count(&shared.refused);
        }
        if !std::mem::replace(&mut told, true) {
            let broker = &talk.broker;
            tracing::warn!("MQTT broker {broker}: {end}; retrying until it is back");
        }
        // Meanwhile what changes is kept.
        let again = Instant::now() + back_off.pause();
        while Instant::now() < again {
            if shared.stop.load(Ordering::Relaxed) {
                return;
            }
            let left = again.saturating_duration_since(Instant::now()).as_millis() as i32;
            let mut asked = [PollFd::new(bell.fd(), PollFlags::POLLIN)];
            let _ = poll(&mut asked, left.max(1));
            bell.answer();
            watch.look(shared);
        }
    }
}

/// Buffers, allocated once.
struct Buffers {
    out: Vec<u8>,
    heard: Box<[u8; LONGEST]>,
    draft: Draft,
}

impl Buffers {
    /// Publishes the draft.
    fn publish(&mut self, retain: bool, number: Option<u16>) {
        let Draft { topic, payload } = &self.draft;
        packet::publish(topic, payload.as_bytes(), retain, number, &mut self.out);
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
    /// The message waiting for its acknowledgement: the change in it, if it must come again; its number; since when.
    asked: Option<(Option<Change>, u16, Instant)>,
    number: u16,
    /// Messages after connecting: online, then the entities.
    introduced: usize,
    weights_due: Instant,
    health_due: Instant,
    commands: Allowance,
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
            commands: Allowance::of_commands(now),
        }
    }

    fn run(&mut self, bell: &mut Bell, watch: &mut Watch, buffers: &mut Buffers) -> End {
        buffers.out.clear();
        let (talk, out) = (self.talk, &mut buffers.out);
        let will = [talk.presence.as_str(), "offline"];
        let login = [&talk.user, &talk.password].map(|part| part.as_deref());
        packet::connect(&talk.client, KEEP_ALIVE_S, will, login, out);
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
        let mut flags = PollFlags::POLLIN;
        flags.set(PollFlags::POLLOUT, self.stream.waits_to_write(pending));
        let mut asked = [
            PollFd::new(bell.fd(), PollFlags::POLLIN),
            PollFd::new(self.stream.socket.as_raw_fd(), flags),
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
        let unacknowledged = self.asked.is_some_and(|(.., at)| now - at > UNACKNOWLEDGED);
        let stuck = self.written < buffers.out.len() && now - self.wrote > PATIENCE;
        let late = !self.settled && now - self.begun > PATIENCE;
        if late || stuck || unacknowledged || now - self.heard > 2 * PATIENCE {
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
                packet::read(&buffers.heard[used..self.length]).map_err(|Nonsense| End::Nonsense)?
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
        let talk = self.talk;
        let broker = &talk.broker;
        match *told {
            Told::Connected(0) if !self.settled => {
                self.settled = true;
                self.shared.connected.store(true, Ordering::Relaxed);
                tracing::info!("connected to MQTT broker {broker}");
                if let Some(topic) = &talk.commands {
                    packet::subscribe(self.next_number(), topic, out);
                }
            }
            Told::Connected(code @ 1..) => return Err(End::Refused(code)),
            Told::Connected(_) => return Err(End::Nonsense),
            _ if !self.settled => return Err(End::Nonsense),
            Told::Acknowledged(number) => {
                if self.asked.is_some_and(|(_, asked, _)| asked == number) {
                    self.asked = None;
                    count(&self.shared.sent);
                }
            }
            Told::Subscribed(code) if code >= 0x80 => {
                tracing::warn!("MQTT broker {broker} refuses the subscription to commands");
                count(&self.shared.refused);
            }
            Told::Subscribed(_) | Told::Alive => {}
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
                let wanted = !retained && talk.commands.is_some();
                match talk.command(topic, payload) {
                    Some(command) if wanted && self.commands.take(self.heard) => {
                        self.shared.ask(command);
                    }
                    _ => count(&self.shared.refused),
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
            self.tell(watch, buffers, now);
        }
        if now >= self.health_due {
            self.health_due = now + self.talk.health_each;
            watch.health(self.shared, &self.talk.base, &mut buffers.draft);
            buffers.publish(true, None);
        }
        if let Some(each) = self.talk.weights_each
            && now >= self.weights_due
            && self.send_weights(watch, buffers)
        {
            self.weights_due = (self.weights_due + each).max(now);
        }
        let quiet = Duration::from_secs(u64::from(KEEP_ALIVE_S)) / 2;
        // Also while weights go out: only this is answered, so only this tells whether somebody is there.
        if now - self.heard.max(self.pinged) > quiet && buffers.out.is_empty() {
            packet::ping(&mut buffers.out);
            self.pinged = now;
        }
    }

    /// The next message that is acknowledged: online, the entities, the number of faces, then what has changed.
    fn tell(&mut self, watch: &mut Watch, buffers: &mut Buffers, now: Instant) {
        let draft = &mut buffers.draft;
        let entities = &self.talk.entities;
        let change = match self.introduced.checked_sub(1) {
            None => {
                draft.about(&self.talk.base, format_args!("presence"));
                draft.payload.push_str("online");
                None
            }
            Some(at) if at < entities.len() => {
                draft.topic.clone_from(&entities[at].0);
                draft.payload.clone_from(&entities[at].1);
                None
            }
            Some(at) if at == entities.len() => Some(watch.recall(self.shared)),
            Some(_) => match watch.queue.pop_front() {
                None => return,
                change => change,
            },
        };
        if let Some(change) = change {
            watch.write(change, &self.talk.base, draft);
        }
        self.introduced = (self.introduced + 1).min(entities.len() + 2);
        let number = self.next_number();
        self.asked = Some((change, number, now));
        buffers.publish(true, Some(number));
    }

    /// Sends unread weights; whether there were any.
    fn send_weights(&self, watch: &mut Watch, buffers: &mut Buffers) -> bool {
        let mut any = false;
        for slot in 0..USERS {
            if !watch.has_weights(slot) {
                continue;
            }
            any = true;
            if buffers.out.len() > WAITING[0] {
                count(&self.shared.dropped);
                continue;
            }
            watch.weights(slot, &self.talk.base, &mut buffers.draft);
            buffers.publish(false, None);
            count(&self.shared.sent);
        }
        any
    }

    /// Publishes that everybody and the box are gone, as far as the broker accepts it in a moment.
    fn goodbye(&mut self, watch: &mut Watch, buffers: &mut Buffers) {
        if !self.settled {
            return;
        }
        while let Some(change) = watch.queue.pop_front()
            && buffers.out.len() <= WAITING[0]
        {
            watch.write(change, &self.talk.base, &mut buffers.draft);
            let number = self.next_number();
            buffers.publish(true, Some(number));
        }
        let draft = &mut buffers.draft;
        draft.about(&self.talk.base, format_args!("presence"));
        draft.payload.push_str("offline");
        let number = self.next_number();
        buffers.publish(true, Some(number));
        packet::disconnect(&mut buffers.out);
        self.stream.finish(&buffers.out[self.written..]);
    }
}
