//! The command port: reads datagrams and limits senders.

use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::time::Instant;

use super::commands::{Request, requests};
use super::packet::LARGEST;
use crate::limits::{Listening, TokenBucket, is_local};
use crate::{Command, OutputError};

/// Work allowed between two frames; receiving a datagram counts 1.
const DATAGRAMS: usize = 64;
/// Work counted for receiving and parsing a datagram.
const PARSE_COST: usize = 8;
/// Senders tracked by the rate limit.
const SENDERS: usize = 8;
/// Purpose of the socket, for messages.
const PURPOSE: &str = " for OSC commands";
/// Commands accepted from one datagram; further ones are refused.
const REQUESTS: usize = 16;

/// A token bucket per sender; a new sender replaces the one silent for longest.
#[derive(Default)]
struct Senders(heapless::Vec<(IpAddr, TokenBucket), SENDERS>);

impl Senders {
    fn bucket(&mut self, host: IpAddr, now: Instant) -> &mut TokenBucket {
        let known = self.0.iter().position(|sender| sender.0 == host);
        let at = known.unwrap_or_else(|| {
            if self.0.is_full() {
                let silent = (0..SENDERS).min_by_key(|&at| self.0[at].1.full_at);
                self.0.swap_remove(silent.unwrap_or(0));
            }
            // There is room now.
            let _ = self.0.push((host, TokenBucket::per_sender(now)));
            self.0.len() - 1
        });
        &mut self.0[at].1
    }
}

/// The listening socket.
pub(super) struct Listener {
    port: Listening<UdpSocket>,
    /// Prefix of the addresses, such as `/face`.
    prefix: String,
    /// Whether gestures may be set up.
    levels: bool,
    /// IP addresses of targets, from which commands are accepted on any network.
    target_hosts: Box<[IpAddr]>,
    queue: heapless::Deque<(Request, SocketAddr), REQUESTS>,
    senders: Senders,
    /// Limit for all senders together.
    all: TokenBucket,
    work: usize,
    accepted: u64,
    refused: u64,
}

impl Listener {
    /// Listens at `address:port` for OSC addresses below `prefix` + `/cmd/`. Hosts of `targets` may send from any network; `levels`
    /// allows setting up gestures. Retries while the address is in use or not this machine's.
    ///
    /// # Errors
    /// If `address` is not an IP address with a port.
    pub(super) fn open(
        address: &str,
        prefix: &str,
        targets: &[String],
        levels: bool,
    ) -> Result<Self, OutputError> {
        let mut port = Listening::new(address)?;
        port.open(PURPOSE, bind);
        let host = |to: &String| Some(to.parse::<SocketAddr>().ok()?.ip());
        Ok(Self {
            port,
            prefix: prefix.to_owned(),
            levels,
            target_hosts: targets.iter().filter_map(host).collect(),
            all: TokenBucket::all_senders(Instant::now()),
            queue: heapless::Deque::new(),
            senders: Senders::default(),
            work: 0,
            accepted: 0,
            refused: 0,
        })
    }

    /// Commands accepted and refused.
    pub(super) fn counts(&self) -> [u64; 2] {
        [self.accepted, self.refused]
    }

    /// Sends a reply to the requester; returns whether the system accepted it.
    pub(super) fn answer(&self, datagram: &[u8], to: SocketAddr) -> bool {
        let socket = self.port.socket.as_ref();
        socket.is_some_and(|socket| socket.send_to(datagram, to).is_ok())
    }

    /// The next request and its sender; `None` if there is none or the limit per frame is reached, which resets the limit.
    pub(super) fn next_request(&mut self) -> Option<(Request, SocketAddr)> {
        self.port.open(PURPOSE, bind);
        // Longer datagrams are truncated by the system and then refused as malformed.
        let mut bytes = [0; LARGEST];
        loop {
            if let Some(request) = self.queue.pop_front() {
                self.accepted += 1;
                return Some(request);
            }
            let socket = self.port.socket.as_ref();
            let socket = socket.filter(|_| self.work < DATAGRAMS);
            let datagram = socket.and_then(|socket| socket.recv_from(&mut bytes).ok());
            let Some((length, from)) = datagram else {
                self.work = 0;
                return None;
            };
            self.work += 1;
            let (now, host) = (Instant::now(), from.ip().to_canonical());
            // Disallowed senders get no bucket.
            let is_allowed = is_local(host) || self.target_hosts.contains(&host);
            let bucket = is_allowed.then(|| self.senders.bucket(host, now));
            let bucket = bucket.filter(|own| own.has_token(now) && self.all.has_token(now));
            let Some(bucket) = bucket else {
                self.refused += 1;
                continue;
            };
            self.work += PARSE_COST - 1;
            let (queue, all, levels) = (&mut self.queue, &mut self.all, self.levels);
            self.refused += requests(&bytes[..length], &self.prefix, &mut |request| {
                let is_allowed = |command: Command| levels || !command.is_of_gesture();
                (!matches!(request, Request::Command(command) if !is_allowed(command)))
                    && bucket.take(now)
                    && all.take(now)
                    && queue.push_back((request, from)).is_ok()
            });
        }
    }
}

fn bind(address: SocketAddr) -> std::io::Result<UdpSocket> {
    let socket = UdpSocket::bind(address)?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}
