//! The command port: reads datagrams, and who may send how often.

use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::time::Instant;

use super::commands::{Request, requests};
use super::packet::LARGEST;
use crate::limits::{Allowance, Listening, is_near};
use crate::{Command, OutputError};

/// Work allowed between two frames, in datagrams received; parsing one costs as much as [`READING`].
const DATAGRAMS: usize = 64;
const READING: usize = 8;
/// Senders tracked by the rate limit.
const SENDERS: usize = 8;
/// What the socket is for, in words.
const FOR: &str = " for OSC commands";
/// Commands accepted from one datagram; further ones are refused.
const REQUESTS: usize = 16;
/// The allowances of the senders; that of the one silent for longest is given to a newcomer.
#[derive(Default)]
struct Senders(heapless::Vec<(IpAddr, Allowance), SENDERS>);

impl Senders {
    fn allowance_of(&mut self, host: IpAddr, now: Instant) -> &mut Allowance {
        let known = self.0.iter().position(|sender| sender.0 == host);
        let at = known.unwrap_or_else(|| {
            if self.0.is_full() {
                let silent = (0..SENDERS).min_by_key(|&at| self.0[at].1.full);
                self.0.swap_remove(silent.unwrap_or(0));
            }
            // There is room now.
            let _ = self.0.push((host, Allowance::of_commands(now)));
            self.0.len() - 1
        });
        &mut self.0[at].1
    }
}

/// The listening socket.
pub(super) struct Listener {
    at: Listening<UdpSocket>,
    /// Start of the addresses, as `/face`.
    prefix: String,
    /// Whether gestures' levels may be moved.
    levels: bool,
    /// Receivers, from which commands are taken wherever they are.
    named: Box<[IpAddr]>,
    waiting: heapless::Deque<(Request, SocketAddr), REQUESTS>,
    senders: Senders,
    /// Of all senders together.
    all: Allowance,
    done: usize,
    taken: u64,
    refused: u64,
}

impl Listener {
    /// Listens at `address:port`, for addresses that start with `prefix` and `/cmd/`; `targets` are heard from anywhere, and `levels`
    /// allows moving those of gestures. Retries while the address is in use, or not
    /// this machine's.
    ///
    /// # Errors
    /// If it is not an address with a port.
    pub(super) fn open(
        address: &str,
        prefix: &str,
        targets: &[String],
        levels: bool,
    ) -> Result<Self, OutputError> {
        let mut at = Listening::on(address)?;
        at.open(FOR, bind);
        let named = targets
            .iter()
            .filter_map(|to| Some(to.parse::<SocketAddr>().ok()?.ip()));
        Ok(Self {
            at,
            prefix: prefix.to_owned(),
            levels,
            named: named.collect(),
            all: Allowance::of_all_commands(Instant::now()),
            waiting: heapless::Deque::new(),
            senders: Senders::default(),
            done: 0,
            taken: 0,
            refused: 0,
        })
    }

    /// Commands accepted and refused.
    pub(super) fn counts(&self) -> [u64; 2] {
        [self.taken, self.refused]
    }

    /// Sends a reply to the requester.
    pub(super) fn answer(&self, datagram: &[u8], to: SocketAddr) -> bool {
        let socket = self.at.socket.as_ref();
        socket.is_some_and(|socket| socket.send_to(datagram, to).is_ok())
    }

    /// The next request and its sender; `None` ends a round, after which the datagram limit is reset.
    pub(super) fn next_request(&mut self) -> Option<(Request, SocketAddr)> {
        self.at.open(FOR, bind);
        // The system cuts longer datagrams, which are then malformed.
        let mut bytes = [0; LARGEST];
        loop {
            if let Some(request) = self.waiting.pop_front() {
                self.taken += 1;
                return Some(request);
            }
            let datagram = (self.done < DATAGRAMS)
                .then(|| self.at.socket.as_ref()?.recv_from(&mut bytes).ok())
                .flatten();
            let Some((length, from)) = datagram else {
                self.done = 0;
                return None;
            };
            self.done += 1;
            let (now, host) = (Instant::now(), from.ip().to_canonical());
            // One from far away takes no place among the senders.
            let is_heard = is_near(host) || self.named.contains(&host);
            let allowance = is_heard.then(|| self.senders.allowance_of(host, now));
            let allowance = allowance.filter(|own| own.is_left(now) && self.all.is_left(now));
            let Some(allowance) = allowance else {
                self.refused += 1;
                continue;
            };
            self.done += READING - 1;
            let (waiting, all, levels) = (&mut self.waiting, &mut self.all, self.levels);
            self.refused += requests(&bytes[..length], &self.prefix, &mut |request| {
                let is_level = matches!(request, Request::Command(Command::Level(..)));
                (levels || !is_level)
                    && allowance.take(now)
                    && all.take(now)
                    && waiting.push_back((request, from)).is_ok()
            });
        }
    }
}

fn bind(address: SocketAddr) -> std::io::Result<UdpSocket> {
    let socket = UdpSocket::bind(address)?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}
