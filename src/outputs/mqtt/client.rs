//! The thread that talks to the broker: connects, speaks, listens, and comes back.

use std::error::Error;
use std::io::{self, ErrorKind, Read};
use std::os::fd::AsRawFd;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, poll};

use super::packet::{self, FromBroker, LONGEST, NotMqtt};
use super::stream::Stream;
use super::talk::Talk;
use super::watch::{Change, Draft, Watch};
use crate::board::{Bell, Shared, count, write_queued};
use crate::limits::{Allowance, BackOff};
use mien_stages::base::capacity::USERS;

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

/// Runs until told to stop.
pub(super) fn run(talk: &Talk, mut watch: Watch, shared: &Shared, mut bell: Bell) {
    let mut out = Vec::with_capacity(WAITING[1]);
    let mut heard = Box::new([0; LONGEST]);
    let mut draft = Draft {
        base: talk.base.clone(),
        topic: String::with_capacity(256),
        payload: String::with_capacity(4096),
    };
    let (mut back_off, mut told) = (BackOff::new(PAUSES), false);
    loop {
        let end = Stream::connect(&talk.settings.broker, &talk.trust).and_then(|stream| {
            let now = Instant::now();
            let mut connection = Connection {
                stream,
                talk,
                shared,
                watch: &mut watch,
                draft: &mut draft,
                out: &mut out,
                settled: false,
                begun: now,
                heard: now,
                wrote: now,
                pinged: now,
                length: 0,
                asked: None,
                number: 0,
                introduced: 0,
                weights_due: now,
                health_due: now,
                commands: Allowance::of_commands(now),
            };
            let end = connection.run(&mut bell, &mut heard);
            let (asked, settled) = (connection.asked, connection.settled);
            // What was not acknowledged goes first on the next connection.
            if let Some((Some(change), ..)) = asked
                && watch.queue.push_front(change).is_err()
            {
                count(&shared.dropped);
            }
            if settled {
                back_off.reset();
                told = false;
            }
            end
        });
        shared.connected.store(false, Ordering::Relaxed);
        let Err(end) = end else { return };
        if !std::mem::replace(&mut told, true) {
            let broker = &talk.settings.broker;
            tracing::warn!(
                "MQTT broker {broker}: {end}; retrying every {} s",
                PAUSES[1].as_secs()
            );
        }
        if rest(back_off.pause(), &mut watch, shared, &mut bell) {
            return;
        }
    }
}

/// Keeps what changes until the next attempt; whether told to stop.
fn rest(pause: Duration, watch: &mut Watch, shared: &Shared, bell: &mut Bell) -> bool {
    let again = Instant::now() + pause;
    while Instant::now() < again && !shared.stop.load(Ordering::Relaxed) {
        let left = again.saturating_duration_since(Instant::now()).as_millis() as i32;
        let mut asked = [PollFd::new(bell.fd(), PollFlags::POLLIN)];
        let _ = poll(&mut asked, left.max(1));
        bell.answer();
        watch.update(shared);
    }
    shared.stop.load(Ordering::Relaxed)
}

struct Connection<'a> {
    stream: Stream,
    talk: &'a Talk,
    shared: &'a Shared,
    watch: &'a mut Watch,
    draft: &'a mut Draft,
    /// What is to be written.
    out: &'a mut Vec<u8>,
    /// Whether the broker has accepted the connection.
    settled: bool,
    begun: Instant,
    /// When something was last received, and sent.
    heard: Instant,
    wrote: Instant,
    pinged: Instant,
    /// Bytes that were received but not understood yet.
    length: usize,
    /// The message waiting for its acknowledgement: the change in it, if it must come again; its number; since when.
    asked: Option<(Option<Change>, u16, Instant)>,
    number: u16,
    /// Messages after connecting: online, then the entities.
    introduced: usize,
    weights_due: Instant,
    health_due: Instant,
    commands: Allowance,
}

impl Connection<'_> {
    /// Until told to stop (`Ok`), or the connection ends.
    fn run(&mut self, bell: &mut Bell, heard: &mut [u8; LONGEST]) -> io::Result<()> {
        self.out.clear();
        let talk = self.talk;
        let will = [talk.presence.as_str(), "offline"];
        let user = Some(talk.settings.user.as_str()).filter(|user| !user.is_empty());
        let login = [user, talk.password.as_deref()];
        packet::connect(&talk.client, KEEP_ALIVE_S, will, login, self.out);
        while !self.shared.stop.load(Ordering::Relaxed) {
            self.step(bell, heard)?;
        }
        self.watch.update(self.shared);
        self.send_offline();
        Ok(())
    }

    fn step(&mut self, bell: &mut Bell, heard: &mut [u8; LONGEST]) -> io::Result<()> {
        let mut flags = PollFlags::POLLIN;
        let pending = !self.out.is_empty();
        flags.set(PollFlags::POLLOUT, self.stream.waits_to_write(pending));
        let mut asked = [
            PollFd::new(bell.fd(), PollFlags::POLLIN),
            PollFd::new(self.stream.socket.as_raw_fd(), flags),
        ];
        let _ = poll(&mut asked, 500);
        bell.answer();
        self.watch.update(self.shared);
        self.read(heard)?;
        let now = Instant::now();
        if self.settled {
            self.send_due(now);
        }
        if write_queued(&mut self.stream, self.out)? > 0 {
            self.wrote = Instant::now();
        }
        let unacknowledged = self.asked.is_some_and(|(.., at)| now - at > UNACKNOWLEDGED);
        let stuck = !self.out.is_empty() && now - self.wrote > PATIENCE;
        let late = !self.settled && now - self.begun > PATIENCE;
        if late || stuck || unacknowledged || now - self.heard > 2 * PATIENCE {
            return Err(io::Error::other("no reply"));
        }
        Ok(())
    }

    fn read(&mut self, heard: &mut [u8; LONGEST]) -> io::Result<()> {
        for _ in 0..READS {
            match self.stream.read(&mut heard[self.length..]) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(more) => self.length += more,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            }
            let mut used = 0;
            while let Some((told, more)) =
                packet::read(&heard[used..self.length]).map_err(|NotMqtt| self.not_mqtt())?
            {
                self.handle(&told)?;
                used += more;
            }
            heard.copy_within(used..self.length, 0);
            self.length -= used;
        }
        // A broker that talks without end waits: it takes neither the processor nor our turn to write.
        std::thread::sleep(REST);
        Ok(())
    }

    /// An answer that ends the connection.
    fn refused(&self, why: impl Into<Box<dyn Error + Send + Sync>>) -> io::Error {
        count(&self.shared.refused);
        io::Error::other(why)
    }

    fn not_mqtt(&self) -> io::Error {
        self.refused("the reply is not MQTT; is it a broker?")
    }

    fn handle(&mut self, told: &FromBroker) -> io::Result<()> {
        self.heard = Instant::now();
        let talk = self.talk;
        let broker = &talk.settings.broker;
        match *told {
            FromBroker::Connected(0) if !self.settled => {
                self.settled = true;
                self.shared.connected.store(true, Ordering::Relaxed);
                tracing::info!("connected to MQTT broker {broker}");
                if let Some(topic) = &talk.commands {
                    packet::subscribe(self.next_number(), topic, self.out);
                }
            }
            FromBroker::Connected(code @ 1..) => {
                return Err(self.refused(format!(
                    "connection refused with code {code}; are mqtt.user and mqtt.password_file right?"
                )));
            }
            FromBroker::Connected(_) => return Err(self.not_mqtt()),
            _ if !self.settled => return Err(self.not_mqtt()),
            FromBroker::Acknowledged(number) => {
                if self.asked.is_some_and(|(_, asked, _)| asked == number) {
                    self.asked = None;
                    count(&self.shared.sent);
                }
            }
            FromBroker::Subscribed(code) if code >= 0x80 => {
                tracing::warn!(
                    "MQTT broker {broker} refuses the subscription to commands; check the permissions of mqtt.user"
                );
                count(&self.shared.refused);
            }
            FromBroker::Subscribed(_) | FromBroker::Alive => {}
            FromBroker::Message {
                topic,
                payload,
                retained,
                number,
            } => {
                if let Some(number) = number
                    && self.out.len() < WAITING[1] - LONGEST
                {
                    packet::acknowledge(number, self.out);
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

    /// Publishes the draft.
    fn publish(&mut self, retain: bool, number: Option<u16>) {
        let Draft { topic, payload, .. } = &*self.draft;
        packet::publish(topic, payload.as_bytes(), retain, number, self.out);
    }

    /// Sends what is due.
    fn send_due(&mut self, now: Instant) {
        if self.asked.is_none() {
            self.send_acknowledged(now);
        }
        if now >= self.health_due {
            self.health_due = now + Duration::from_secs_f32(self.talk.settings.health_s);
            self.watch.health(self.shared, self.draft);
            self.publish(true, None);
        }
        let rate_hz = self.talk.settings.rate_hz;
        if rate_hz > 0.0 && now >= self.weights_due && self.send_weights() {
            let next = self.weights_due + Duration::from_secs_f32(1.0 / rate_hz);
            self.weights_due = next.max(now);
        }
        let quiet = Duration::from_secs(u64::from(KEEP_ALIVE_S)) / 2;
        // Also while weights go out: only this is answered, so only this tells whether somebody is there.
        if now - self.heard.max(self.pinged) > quiet && self.out.is_empty() {
            packet::ping(self.out);
            self.pinged = now;
        }
    }

    /// The next message that is acknowledged: online, the entities, the number of faces, then what has changed.
    fn send_acknowledged(&mut self, now: Instant) {
        let entities = &self.talk.entities;
        let change = match self.introduced.checked_sub(1) {
            None => {
                let presence = self.draft.about(format_args!("presence"));
                presence.push_str("online");
                None
            }
            Some(at) if at < entities.len() => {
                self.draft.topic.clone_from(&entities[at].0);
                self.draft.payload.clone_from(&entities[at].1);
                None
            }
            Some(at) if at == entities.len() => Some(self.watch.recall(self.shared)),
            Some(_) => match self.watch.queue.pop_front() {
                None => return,
                change => change,
            },
        };
        if let Some(change) = change {
            self.watch.write(change, self.draft);
        }
        self.introduced = (self.introduced + 1).min(entities.len() + 2);
        let number = self.next_number();
        self.asked = Some((change, number, now));
        self.publish(true, Some(number));
    }

    /// Sends unread weights; whether there were any.
    fn send_weights(&mut self) -> bool {
        let mut any = false;
        for slot in 0..USERS {
            if !self.watch.has_weights(slot) {
                continue;
            }
            any = true;
            if self.out.len() > WAITING[0] {
                count(&self.shared.dropped);
                continue;
            }
            self.watch.weights(slot, self.draft);
            self.publish(false, None);
            count(&self.shared.sent);
        }
        any
    }

    /// Publishes that everybody and the box are gone, as far as the broker accepts it in a moment.
    fn send_offline(&mut self) {
        if !self.settled {
            return;
        }
        while let Some(change) = self.watch.queue.pop_front()
            && self.out.len() <= WAITING[0]
        {
            self.watch.write(change, self.draft);
            let number = self.next_number();
            self.publish(true, Some(number));
        }
        let presence = self.draft.about(format_args!("presence"));
        presence.push_str("offline");
        let number = self.next_number();
        self.publish(true, Some(number));
        packet::disconnect(self.out);
        self.stream.finish(self.out);
    }
}
