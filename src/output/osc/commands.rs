//! Commands over OSC. Off by default, and accepted from this machine only unless the configuration names another address.
//!
//! | address | arguments | what it does |
//! | --- | --- | --- |
//! | `/face/cmd/forget` | slot | forgets what was learned about the user |
//! | `/face/cmd/freeze` | slot, 0 or 1 | resumes or stops learning for the user |
//! | `/face/cmd/neutral` | slot | takes the user's current face as rest |
//! | `/face/cmd/schema` | | sends the schema now: to the targets on the requester's host, or if there are none, back to the requester |
//!
//! Input is untrusted: a datagram is read into a fixed buffer, bundles may be nested twice, and only so many datagrams are
//! examined per frame; the rest waits in the socket, which the system bounds. Every sender may make [`AT_ONCE`] requests, and
//! one more every [`EACH`]. Requests beyond that, malformed or unknown ones, and those with other arguments or a slot that does
//! not exist are counted and otherwise ignored, with the rest of their datagram if that cannot be separated. Replies go to the
//! requester only. Nothing allocates. Limits: with more than [`SENDERS`] senders, the one silent for longest counts as new when
//! it returns.
//! One file: every command, what it may do, and who may send it how often.

#[cfg(feature = "std")]
use std::net::{IpAddr, SocketAddr, UdpSocket};
#[cfg(feature = "std")]
use std::time::{Duration, Instant};

use super::packet::{element, string};
use crate::base::capacity::USERS;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::output::Command;
#[cfg(feature = "std")]
use crate::output::OutputError;

/// Longest datagram accepted; the system truncates longer ones, which are then malformed.
#[cfg(feature = "std")]
const LARGEST: usize = 1472;
/// Work allowed between two frames, in datagrams received; parsing one costs as much as [`READING`].
#[cfg(feature = "std")]
const DATAGRAMS: usize = 64;
#[cfg(feature = "std")]
const READING: usize = 8;
/// Senders tracked by the rate limit.
#[cfg(feature = "std")]
const SENDERS: usize = 8;
/// Burst size: requests that a sender may make at once.
#[cfg(feature = "std")]
const AT_ONCE: u32 = 16;
/// Time after which it may make another one.
#[cfg(feature = "std")]
const EACH: Duration = Duration::from_millis(250);
/// Commands accepted from one datagram; further ones are refused.
#[cfg(feature = "std")]
const REQUESTS: usize = 16;
/// First and longest pause before retrying an address that is in use.
#[cfg(feature = "std")]
const PAUSES: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(5)];
/// Nesting depth at which bundles are refused.
const DEPTH: usize = 3;
/// Most arguments of a command.
const ARGUMENTS: usize = 2;

/// What a message requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Send the names of the units now.
    Schema,
    /// A command for the pipeline.
    Command(Command),
}

/// A sender, and when its allowance is full again.
#[cfg(feature = "std")]
struct Sender {
    host: IpAddr,
    whole: Instant,
}

/// The rate limits.
#[cfg(feature = "std")]
#[derive(Default)]
struct Senders(heapless::Vec<Sender, SENDERS>);

#[cfg(feature = "std")]
impl Senders {
    /// The allowance of a host.
    fn of(&mut self, host: IpAddr, now: Instant) -> &mut Sender {
        let at = match self.0.iter().position(|sender| sender.host == host) {
            Some(at) => at,
            None => {
                let new = Sender { host, whole: now };
                if let Err(new) = self.0.push(new) {
                    let mut longest = 0;
                    for at in 1..SENDERS {
                        if self.0[at].whole < self.0[longest].whole {
                            longest = at;
                        }
                    }
                    self.0[longest] = new;
                    longest
                } else {
                    self.0.len() - 1
                }
            }
        };
        &mut self.0[at]
    }
}

#[cfg(feature = "std")]
impl Sender {
    fn may(&self, now: Instant) -> bool {
        self.whole.saturating_duration_since(now) <= EACH * (AT_ONCE - 1)
    }

    /// Counts one request; whether it is allowed.
    fn takes_one(&mut self, now: Instant) -> bool {
        let may = self.may(now);
        if may {
            self.whole = self.whole.max(now) + EACH;
        }
        may
    }
}

/// The listening socket.
#[cfg(feature = "std")]
pub struct Commands {
    /// `None` while the address is in use, or not this machine's.
    socket: Option<UdpSocket>,
    address: SocketAddr,
    /// When to try again, and how long to wait after that.
    again: Instant,
    pause: Duration,
    /// Start of the addresses, as `/face`.
    prefix: String,
    waiting: heapless::Deque<(Request, SocketAddr), REQUESTS>,
    senders: Senders,
    done: usize,
    taken: u64,
    refused: u64,
}

#[cfg(feature = "std")]
impl Commands {
    /// Listens at `address:port`, for addresses that start with `prefix` and `/cmd/`. Retries while the address is in use, or not
    /// this machine's.
    ///
    /// # Errors
    /// If it is not an address with a port.
    pub fn listen(address: &str, prefix: &str) -> Result<Self, OutputError> {
        let parsed = address.parse();
        let address = parsed.map_err(|_| OutputError::Listen {
            address: address.to_owned(),
        })?;
        Ok(Self {
            socket: bind(address).ok(),
            address,
            again: Instant::now(),
            pause: PAUSES[0],
            prefix: prefix.to_owned(),
            waiting: heapless::Deque::new(),
            senders: Senders::default(),
            done: 0,
            taken: 0,
            refused: 0,
        })
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> Option<SocketAddr> {
        self.socket.as_ref()?.local_addr().ok()
    }

    /// Tries again when it is time to: first when the first request is asked for, as whoever had the address before a
    /// reload has left it then.
    fn try_again(&mut self) -> Option<&UdpSocket> {
        let now = Instant::now();
        if self.socket.is_none() && now >= self.again {
            match bind(self.address) {
                Ok(socket) => self.socket = Some(socket),
                Err(error) => {
                    if self.pause == PAUSES[0] {
                        tracing::warn!(
                            "cannot listen for OSC commands at {} ({error}), retrying until it is free",
                            self.address
                        );
                    }
                    self.again = now + self.pause;
                    self.pause = (2 * self.pause).min(PAUSES[1]);
                }
            }
        }
        self.socket.as_ref()
    }

    /// Commands accepted and refused.
    #[must_use]
    pub fn counts(&self) -> [u64; 2] {
        [self.taken, self.refused]
    }

    /// Sends a reply to the requester.
    pub(super) fn answer(&self, datagram: &[u8], to: SocketAddr) -> bool {
        let socket = self.socket.as_ref();
        socket.is_some_and(|socket| socket.send_to(datagram, to).is_ok())
    }

    /// The next request and its sender; `None` ends a round, after which the datagram limit is reset.
    pub fn next_request(&mut self) -> Option<(Request, SocketAddr)> {
        let mut bytes = [0; LARGEST];
        loop {
            if let Some(request) = self.waiting.pop_front() {
                self.taken += 1;
                return Some(request);
            }
            let datagram = (self.done < DATAGRAMS)
                .then(|| self.try_again()?.recv_from(&mut bytes).ok())
                .flatten();
            let Some((length, from)) = datagram else {
                self.done = 0;
                return None;
            };
            self.done += 1;
            let now = Instant::now();
            let sender = self.senders.of(from.ip(), now);
            if !sender.may(now) {
                self.refused += 1;
                continue;
            }
            self.done += READING - 1;
            let waiting = &mut self.waiting;
            self.refused += requests(&bytes[..length], &self.prefix, &mut |request| {
                sender.takes_one(now) && waiting.push_back((request, from)).is_ok()
            });
        }
    }
}

#[cfg(feature = "std")]
fn bind(address: SocketAddr) -> std::io::Result<UdpSocket> {
    let socket = UdpSocket::bind(address)?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

/// Passes the requests of a datagram to `take`, which returns whether it had room; returns how many messages were refused.
pub fn requests(datagram: &[u8], prefix: &str, take: &mut dyn FnMut(Request) -> bool) -> u64 {
    packet(datagram, prefix, DEPTH, take)
}

fn packet(bytes: &[u8], prefix: &str, depth: usize, take: &mut dyn FnMut(Request) -> bool) -> u64 {
    let Some(mut rest) = bytes.strip_prefix(b"#bundle\0") else {
        let done = message(bytes, prefix).is_some_and(take);
        return u64::from(!done);
    };
    // The time tag says when; commands are for now.
    if depth == 0 || rest.len() < 8 {
        return 1;
    }
    rest = &rest[8..];
    let mut refused = 0;
    while !rest.is_empty() {
        let Some((element, after)) = element(rest) else {
            return refused + 1;
        };
        refused += packet(element, prefix, depth - 1, take);
        rest = after;
    }
    refused
}

fn message(bytes: &[u8], prefix: &str) -> Option<Request> {
    let (address, rest) = string(bytes)?;
    let (tags, mut rest) = string(rest)?;
    let mut arguments = heapless::Vec::<i32, ARGUMENTS>::new();
    for tag in tags.strip_prefix(',')?.chars() {
        // Numbers from patching programs are often floats; truth has no bytes.
        let value = match tag {
            'i' | 'f' => {
                let (number, after) = rest.split_first_chunk::<4>()?;
                rest = after;
                if tag == 'i' {
                    i32::from_be_bytes(*number)
                } else {
                    whole(f32::from_be_bytes(*number))?
                }
            }
            'T' => 1,
            'F' => 0,
            _ => return None,
        };
        arguments.push(value).ok()?;
    }
    if !rest.is_empty() {
        return None;
    }
    let slot = |number: i32| usize::try_from(number).ok().filter(|&slot| slot < USERS);
    let command = match (
        address.strip_prefix(prefix)?.strip_prefix("/cmd/")?,
        &arguments[..],
    ) {
        ("forget", &[user]) => Command::Forget(slot(user)?),
        ("neutral", &[user]) => Command::Neutral(slot(user)?),
        ("freeze", &[user, on @ 0..=1]) => Command::Freeze(slot(user)?, on == 1),
        ("level", &[gesture, level]) => {
            Command::Level(gesture.try_into().ok()?, level.try_into().ok()?)
        }
        ("schema", []) => return Some(Request::Schema),
        _ => return None,
    };
    Some(Request::Command(command))
}

/// An integer sent as a float.
fn whole(number: f32) -> Option<i32> {
    (number.fract() == 0.0 && number.abs() < 1e6).then_some(number as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::osc::packet::{Argument, Packet};

    fn read(bytes: &[u8]) -> (Vec<Request>, u64) {
        let mut all = Vec::new();
        let refused = requests(bytes, "/face", &mut |request| {
            all.push(request);
            true
        });
        (all, refused)
    }

    fn bundle(messages: &[(&str, &[Argument])]) -> Packet {
        let mut packet = Packet::new();
        for &(address, arguments) in messages {
            let arguments = arguments.iter().copied();
            assert!(packet.push("/face", format_args!("{address}"), arguments));
        }
        packet
    }

    #[test]
    fn commands_are_what_they_say() {
        use Argument::{Bool, Float, Int};
        let packet = bundle(&[
            ("/cmd/forget", &[Int(2)]),
            ("/cmd/freeze", &[Int(0), Int(1)]),
            ("/cmd/freeze", &[Float(3.0), Bool(false)]),
            ("/cmd/neutral", &[Float(1.0)]),
            ("/cmd/schema", &[]),
        ]);
        let expected = [
            Request::Command(Command::Forget(2)),
            Request::Command(Command::Freeze(0, true)),
            Request::Command(Command::Freeze(3, false)),
            Request::Command(Command::Neutral(1)),
            Request::Schema,
        ];
        assert_eq!(read(packet.bytes()), (expected.to_vec(), 0));
        // The same without a bundle around it.
        assert_eq!(read(&packet.bytes()[20..48]), (vec![expected[0]], 0));
    }

    #[test]
    fn commands_come_back_as_they_were_written() {
        let mut random = fastrand::Rng::with_seed(9);
        for _ in 0..2000 {
            let mut packet = Packet::new();
            let expected: Vec<Request> = (0..random.usize(..16))
                .map(|_| {
                    let (slot, on) = (random.usize(..USERS), random.bool());
                    let slot_sent = Argument::Int(slot as i32);
                    let (name, arguments, request) = match random.u8(..4) {
                        0 => (
                            "forget",
                            vec![slot_sent],
                            Request::Command(Command::Forget(slot)),
                        ),
                        1 => (
                            "neutral",
                            vec![slot_sent],
                            Request::Command(Command::Neutral(slot)),
                        ),
                        2 => {
                            let frozen = Request::Command(Command::Freeze(slot, on));
                            ("freeze", vec![slot_sent, Argument::Int(on.into())], frozen)
                        }
                        _ => ("schema", vec![], Request::Schema),
                    };
                    let address = format_args!("/cmd/{name}");
                    assert!(packet.push("/face", address, arguments.into_iter()));
                    request
                })
                .collect();
            assert_eq!(read(packet.bytes()), (expected, 0));
        }
    }

    #[test]
    fn what_is_malformed_is_refused_one_by_one() {
        use Argument::{Float, Int, Text};
        let packet = bundle(&[
            ("/cmd/forget", &[Int(4)]),
            ("/cmd/forget", &[Int(-1)]),
            ("/cmd/forget", &[]),
            ("/cmd/forget", &[Int(0), Int(0), Int(0)]),
            ("/cmd/forget", &[Text("0")]),
            ("/cmd/freeze", &[Int(0), Int(2)]),
            ("/cmd/neutral", &[Float(f32::NAN)]),
            ("/cmd/neutral", &[Float(0.5)]),
            ("/cmd/fly", &[Int(0)]),
            ("/0/frame", &[Int(0)]),
            ("/cmd/neutral", &[Int(0)]),
        ]);
        let neutral = Request::Command(Command::Neutral(0));
        assert_eq!(read(packet.bytes()), (vec![neutral], 10));
        for bytes in [
            &b""[..],
            b"#bundle\0",
            b"/face",
            b"/face/cmd/schema\0\0\0\0",
        ] {
            assert_eq!(read(bytes), (vec![], 1), "{bytes:?}");
        }
    }

    #[test]
    fn deep_nests_are_not_followed() {
        let mut bytes = bundle(&[("/cmd/schema", &[])]).bytes().to_vec();
        for depth in 1..8 {
            assert_eq!(read(&bytes).0.len(), usize::from(depth <= DEPTH));
            let length = u32::try_from(bytes.len()).unwrap().to_be_bytes();
            let outer = [
                b"#bundle\0\0\0\0\0\0\0\0\x01".to_vec(),
                length.to_vec(),
                bytes,
            ];
            bytes = outer.concat();
        }
    }

    #[test]
    fn no_bytes_whatever_do_harm() {
        let mut random = fastrand::Rng::with_seed(7);
        let good = bundle(&[
            ("/cmd/forget", &[Argument::Int(2)]),
            ("/cmd/freeze", &[Argument::Int(0), Argument::Int(1)]),
        ]);
        for _ in 0..200_000 {
            let mut bytes = good.bytes().to_vec();
            for _ in 0..random.usize(1..6) {
                let i = random.usize(..bytes.len());
                bytes[i] = random.u8(..);
            }
            bytes.truncate(random.usize(..=bytes.len()));
            let (taken, _) = read(&bytes);
            assert!(taken.len() <= 2);
        }
    }
}
