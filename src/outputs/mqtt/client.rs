//! The broker's thread: connects, publishes, receives commands, reconnects.

use std::error::Error;
use std::io::{self, ErrorKind, Read};
use std::os::fd::AsRawFd;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, poll};

use super::config::BrokerConfig;
use super::messages::{Change, Draft, Messages};
use super::packet::{self, FromBroker, LONGEST, ProtocolError};
use super::stream::Stream;
use crate::limits::{BackOff, TokenBucket};
use crate::mailbox::{Shared, Waker, count, write_queued};
use mien_stages::base::capacity::USERS;

/// Keep-alive, seconds: after one and a half times this without traffic, either side considers the other dead.
const KEEP_ALIVE_S: u16 = 10;
/// Time limit for the broker's acceptance, and for writes without progress.
const TIMEOUT: Duration = Duration::from_secs(10);
/// First and longest pause before reconnecting.
const PAUSES: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(30)];
/// Queued bytes above which weights are dropped, and the capacity of the queue.
const QUEUE_LIMITS: [usize; 2] = [16 * 1024, 32 * 1024];
/// Longest time a message may stay unacknowledged.
const UNACKNOWLEDGED: Duration = Duration::from_secs(20);
/// Reads in a row before writing gets its turn.
const READS_IN_ROW: usize = 4;
/// Pause after that many reads.
const READ_PAUSE: Duration = Duration::from_millis(10);

/// Runs until asked to stop.
pub(super) fn run(
    config: &BrokerConfig,
    mut messages: Messages,
    shared: &Shared,
    mut waker: Waker,
) {
    let mut out = Vec::with_capacity(QUEUE_LIMITS[1]);
    let mut received = Box::new([0; LONGEST]);
    let mut draft = Draft {
        base: config.base.clone(),
        topic: String::with_capacity(256),
        payload: String::with_capacity(4096),
    };
    let (mut back_off, mut failure_logged) = (BackOff::new(PAUSES), false);
    while !shared.stop.load(Ordering::Relaxed) {
        let end = Stream::connect(&config.settings.broker, &config.trust).and_then(|stream| {
            let now = Instant::now();
            let mut connection = Connection {
                stream,
                config,
                shared,
                messages: &mut messages,
                draft: &mut draft,
                out: &mut out,
                accepted: false,
                last_received: now,
                last_write: now,
                last_ping: now,
                buffered: 0,
                in_flight: None,
                packet_id: 0,
                announced: 0,
                weights_due: now,
                health_due: now,
                commands: TokenBucket::per_sender(now),
            };
            let end = connection.run(&mut waker, &mut received);
            let (in_flight, accepted) = (connection.in_flight, connection.accepted);
            // An unacknowledged change is sent first on the next connection.
            if let Some((Some(change), ..)) = in_flight
                && messages.queue.push_front(change).is_err()
            {
                count(&shared.dropped);
            }
            if accepted {
                back_off.reset();
                failure_logged = false;
            }
            end
        });
        shared.connected.store(false, Ordering::Relaxed);
        let Err(end) = end else { return };
        if !std::mem::replace(&mut failure_logged, true) {
            let (broker, pause_s) = (&config.settings.broker, PAUSES[1].as_secs());
            tracing::warn!("MQTT broker {broker}: {end}; retrying every {pause_s} s");
        }
        wait_for_retry(back_off.pause(), &mut messages, shared, &mut waker);
    }
}

/// Waits for the next attempt, recording changes meanwhile, or until asked to stop.
fn wait_for_retry(pause: Duration, messages: &mut Messages, shared: &Shared, waker: &mut Waker) {
    let again = Instant::now() + pause;
    while Instant::now() < again && !shared.stop.load(Ordering::Relaxed) {
        let left = again.saturating_duration_since(Instant::now()).as_millis() as i32;
        let mut polled = [PollFd::new(waker.fd(), PollFlags::POLLIN)];
        let _ = poll(&mut polled, left.max(1));
        waker.clear();
        messages.update(shared);
    }
}

struct Connection<'a> {
    stream: Stream,
    config: &'a BrokerConfig,
    shared: &'a Shared,
    messages: &'a mut Messages,
    draft: &'a mut Draft,
    /// Bytes to write.
    out: &'a mut Vec<u8>,
    /// Whether the broker has accepted the connection.
    accepted: bool,
    /// When a packet was last received, at first when the connection was opened.
    last_received: Instant,
    /// When bytes were last written.
    last_write: Instant,
    last_ping: Instant,
    /// Received bytes that are not parsed yet.
    buffered: usize,
    /// The unacknowledged message: its change, if it must be sent again; its packet number; when it was sent.
    in_flight: Option<(Option<Change>, u16, Instant)>,
    packet_id: u16,
    /// Messages sent since connecting: online, then the entities, then the faces.
    announced: usize,
    weights_due: Instant,
    health_due: Instant,
    commands: TokenBucket,
}

impl Connection<'_> {
    /// Serves the connection until asked to stop (`Ok`) or it fails.
    fn run(&mut self, waker: &mut Waker, received: &mut [u8; LONGEST]) -> io::Result<()> {
        self.out.clear();
        let config = self.config;
        let will = [config.presence.as_str(), "offline"];
        let user = Some(config.settings.user.as_str()).filter(|user| !user.is_empty());
        let login = [user, config.password.as_deref()];
        packet::connect(&config.client, KEEP_ALIVE_S, will, login, self.out);
        while !self.shared.stop.load(Ordering::Relaxed) {
            self.step(waker, received)?;
        }
        self.messages.update(self.shared);
        self.send_offline();
        Ok(())
    }

    fn step(&mut self, waker: &mut Waker, received: &mut [u8; LONGEST]) -> io::Result<()> {
        let mut flags = PollFlags::POLLIN;
        let pending = !self.out.is_empty();
        flags.set(PollFlags::POLLOUT, self.stream.waits_to_write(pending));
        let mut polled = [
            PollFd::new(waker.fd(), PollFlags::POLLIN),
            PollFd::new(self.stream.socket.as_raw_fd(), flags),
        ];
        let _ = poll(&mut polled, 500);
        waker.clear();
        self.messages.update(self.shared);
        self.read(received)?;
        let now = Instant::now();
        if self.accepted {
            self.send_due(now);
        }
        if write_queued(&mut self.stream, self.out)? > 0 {
            self.last_write = Instant::now();
        }
        let is_late = |(.., at): (_, _, Instant)| now - at > UNACKNOWLEDGED;
        let unacknowledged = self.in_flight.is_some_and(is_late);
        let stuck = !self.out.is_empty() && now - self.last_write > TIMEOUT;
        // Nothing is received before the acceptance.
        let silence = if self.accepted { 2 * TIMEOUT } else { TIMEOUT };
        if stuck || unacknowledged || now - self.last_received > silence {
            return Err(io::Error::other("no reply"));
        }
        Ok(())
    }

    fn read(&mut self, received: &mut [u8; LONGEST]) -> io::Result<()> {
        for _ in 0..READS_IN_ROW {
            match self.stream.read(&mut received[self.buffered..]) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(more) => self.buffered += more,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            }
            let mut used = 0;
            while let Some((packet, more)) = packet::read(&received[used..self.buffered])
                .map_err(|ProtocolError| self.not_mqtt())?
            {
                self.handle(&packet)?;
                used += more;
            }
            received.copy_within(used..self.buffered, 0);
            self.buffered -= used;
        }
        // A broker that sends without end must not take the processor or our turn to write.
        std::thread::sleep(READ_PAUSE);
        Ok(())
    }

    /// Counts a refused reply; the error ends the connection.
    fn refusal(&self, why: impl Into<Box<dyn Error + Send + Sync>>) -> io::Error {
        count(&self.shared.refused);
        io::Error::other(why)
    }

    fn not_mqtt(&self) -> io::Error {
        self.refusal("the reply is not MQTT; is it a broker?")
    }

    fn handle(&mut self, packet: &FromBroker) -> io::Result<()> {
        self.last_received = Instant::now();
        let config = self.config;
        let broker = &config.settings.broker;
        match *packet {
            FromBroker::Connected(0) if !self.accepted => {
                self.accepted = true;
                self.shared.connected.store(true, Ordering::Relaxed);
                tracing::info!("connected to MQTT broker {broker}");
                if let Some(topic) = &config.commands {
                    packet::subscribe(self.next_packet_id(), topic, self.out);
                }
            }
            FromBroker::Connected(code @ 1..) => {
                return Err(self.refusal(format!(
                    "connection refused with code {code}; are mqtt.user and mqtt.password_file right?"
                )));
            }
            FromBroker::Connected(_) => return Err(self.not_mqtt()),
            _ if !self.accepted => return Err(self.not_mqtt()),
            FromBroker::Acknowledged(packet_id) => {
                let is_it = |(_, sent, _): &mut (_, u16, _)| *sent == packet_id;
                if self.in_flight.take_if(is_it).is_some() {
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
                packet_id,
            } => {
                if let Some(packet_id) = packet_id
                    && self.out.len() < QUEUE_LIMITS[1] - LONGEST
                {
                    packet::acknowledge(packet_id, self.out);
                }
                let wanted = !retained && config.commands.is_some();
                match config.command(topic, payload) {
                    Some(command) if wanted && self.commands.take(self.last_received) => {
                        self.shared.queue_command(command);
                    }
                    _ => count(&self.shared.refused),
                }
            }
        }
        Ok(())
    }

    fn next_packet_id(&mut self) -> u16 {
        self.packet_id = self.packet_id.checked_add(1).unwrap_or(1);
        self.packet_id
    }

    /// Publishes the draft.
    fn publish(&mut self, retain: bool, packet_id: Option<u16>) {
        let Draft { topic, payload, .. } = &*self.draft;
        packet::publish(topic, payload.as_bytes(), retain, packet_id, self.out);
    }

    /// Queues the messages that are due.
    fn send_due(&mut self, now: Instant) {
        if self.in_flight.is_none() {
            self.send_acknowledged(now);
        }
        if now >= self.health_due {
            self.health_due = now + Duration::from_secs_f32(self.config.settings.health_s);
            self.messages.health(self.shared, self.draft);
            self.publish(true, None);
        }
        let rate_hz = self.config.settings.rate_hz;
        if rate_hz > 0.0 && now >= self.weights_due && self.send_weights() {
            let next = self.weights_due + Duration::from_secs_f32(1.0 / rate_hz);
            self.weights_due = next.max(now);
        }
        let quiet = Duration::from_secs(u64::from(KEEP_ALIVE_S)) / 2;
        // Also while weights are sent: only a ping is answered and shows that the broker is alive.
        if now - self.last_received.max(self.last_ping) > quiet && self.out.is_empty() {
            packet::ping(self.out);
            self.last_ping = now;
        }
    }

    /// Sends the next message with QoS 1: online, the entities, the number of faces, then changes.
    fn send_acknowledged(&mut self, now: Instant) {
        let entities = &self.config.entities;
        let change = match self.announced.checked_sub(1) {
            None => {
                self.draft.presence("online");
                None
            }
            Some(at) if at < entities.len() => {
                self.draft.topic.clone_from(&entities[at].0);
                self.draft.payload.clone_from(&entities[at].1);
                None
            }
            Some(at) if at == entities.len() => Some(self.messages.requeue_all(self.shared)),
            Some(_) if self.messages.queue.is_empty() => return,
            Some(_) => self.messages.queue.pop_front(),
        };
        if let Some(change) = change {
            self.messages.write(change, self.draft);
        }
        self.announced = (self.announced + 1).min(entities.len() + 2);
        let packet_id = self.next_packet_id();
        self.in_flight = Some((change, packet_id, now));
        self.publish(change.is_none_or(Change::is_retained), Some(packet_id));
    }

    /// Sends unread weights; returns whether there were any.
    fn send_weights(&mut self) -> bool {
        let mut any = false;
        for slot in 0..USERS {
            if !self.messages.has_weights(slot) {
                continue;
            }
            any = true;
            if self.out.len() > QUEUE_LIMITS[0] {
                count(&self.shared.dropped);
                continue;
            }
            self.messages.weights(slot, self.draft);
            self.publish(false, None);
            count(&self.shared.sent);
        }
        any
    }

    /// Publishes that everybody is absent and the box offline, within a short time limit.
    fn send_offline(&mut self) {
        if !self.accepted {
            return;
        }
        while let Some(change) = self.messages.queue.pop_front()
            && self.out.len() <= QUEUE_LIMITS[0]
        {
            self.messages.write(change, self.draft);
            let packet_id = self.next_packet_id();
            self.publish(change.is_retained(), Some(packet_id));
        }
        self.draft.presence("offline");
        let packet_id = self.next_packet_id();
        self.publish(true, Some(packet_id));
        packet::disconnect(self.out);
        self.stream.finish(self.out);
    }
}
