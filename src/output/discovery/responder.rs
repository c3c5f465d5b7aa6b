//! The thread: when to probe, announce and answer, and on which networks.

use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::os::fd::AsRawFd;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, poll};
use socket2::{Domain, SockRef, Socket, Type};

use super::message::{LARGEST, Message, REPLY, Section, Writer};
use super::zone::Zone;
use crate::output::limits::{Allowance, BackOff};
use crate::output::worker::{Bell, Shared, count};

const GROUP: Ipv4Addr = Ipv4Addr::new(224, 0, 0, 251);
const PORT: u16 = 5353;
/// Probes before a name is used, and the pause between them.
const PROBES: u8 = 3;
const PROBE_PAUSE: Duration = Duration::from_millis(250);
/// Announcements, and the pause between them.
const ANNOUNCEMENTS: u8 = 2;
const ANNOUNCE_PAUSE: Duration = Duration::from_secs(1);
/// Names tried without a pause; then the first one again, after pauses that double.
const NAMES: u32 = 15;
const PAUSES: [Duration; 2] = [Duration::from_secs(5), Duration::from_secs(50)];
/// Shortest time between two checks of a name that is ours but that somebody else uses, and between two looks for networks.
const CHECK_PAUSE: Duration = Duration::from_secs(60);
const JOIN_PAUSE: Duration = Duration::from_secs(60);
/// Replies at once and pause between more, so that nobody can use us to flood a network.
const REPLIES: (u32, Duration) = (50, Duration::from_millis(20));
/// Datagrams read in a row.
const READS: usize = 64;

/// A network to announce on: our address there, and its mask.
#[derive(Clone, Copy)]
struct Network {
    address: Ipv4Addr,
    mask: Ipv4Addr,
}

impl Network {
    fn has(&self, host: IpAddr) -> bool {
        let masked = |address: Ipv4Addr| u32::from(address) & u32::from(self.mask);
        matches!(host, IpAddr::V4(host) if masked(host) == masked(self.address))
    }
}

/// Networks of this host that can be reached by multicast.
fn networks() -> impl Iterator<Item = Network> {
    use nix::net::if_::InterfaceFlags;
    use nix::sys::socket::SockaddrStorage;
    let reached = InterfaceFlags::IFF_UP | InterfaceFlags::IFF_MULTICAST;
    let v4 = |address: Option<SockaddrStorage>| Some(address?.as_sockaddr_in()?.ip().into());
    let all = nix::ifaddrs::getifaddrs().into_iter().flatten();
    all.filter(move |one| {
        one.flags.contains(reached) || one.flags.contains(InterfaceFlags::IFF_LOOPBACK)
    })
    .filter_map(move |one| {
        Some(Network {
            address: v4(one.address)?,
            mask: v4(one.netmask).unwrap_or(Ipv4Addr::BROADCAST),
        })
    })
}

/// A socket on the port shared with daemons. Everything uses this one: another bound to a network's address would receive what
/// is meant for a daemon on this host.
fn open() -> std::io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, None)?;
    socket.set_reuse_address(true)?;
    socket.set_reuse_port(true)?;
    socket.bind(&SocketAddr::from((Ipv4Addr::UNSPECIFIED, PORT)).into())?;
    socket.set_nonblocking(true)?;
    socket.set_multicast_ttl_v4(255)?;
    // Others on this host want to know too.
    socket.set_multicast_loop_v4(true)?;
    Ok(socket.into())
}

/// Which name to try after one was refused.
struct Claim {
    /// Of the name; 1 is the configured one.
    number: u32,
    pauses: BackOff,
}

impl Claim {
    const FIRST: Self = Self {
        number: 1,
        pauses: BackOff::new(PAUSES),
    };

    /// The name is another's: chooses the next, and says how long to wait before it is probed.
    fn lost(&mut self) -> Duration {
        if self.number < NAMES && self.pauses.tries == 0 {
            self.number += 1;
            return Duration::ZERO;
        }
        self.number = 1;
        self.pauses.pause()
    }
}

/// The next step.
enum Step {
    Probe(u8),
    Announce(u8),
    Wait,
}

/// State of probing and announcing.
struct Responder<'a> {
    zone: Zone,
    shared: &'a Shared,
    socket: Option<UdpSocket>,
    networks: heapless::Vec<Network, 8>,
    /// What comes next, and when.
    step: Step,
    due: Instant,
    /// When to look for new networks again.
    joined: Instant,
    claim: Claim,
    /// When a name that is ours was last checked because somebody else uses it.
    checked: Option<Instant>,
    replies: Allowance,
}

/// Announces and answers until told to stop.
pub(super) fn run(zone: Zone, shared: &Shared, mut bell: Bell) {
    let now = Instant::now();
    let mut responder = Responder {
        zone,
        shared,
        socket: None,
        networks: heapless::Vec::new(),
        step: Step::Probe(0),
        due: now,
        joined: now,
        claim: Claim::FIRST,
        checked: None,
        replies: Allowance::new(REPLIES.0, REPLIES.1, now),
    };
    let mut heard = [0; LARGEST];
    while !shared.stop.load(Ordering::Relaxed) {
        let now = Instant::now();
        if now >= responder.joined || responder.socket.is_none() {
            responder.join(now);
        }
        if now >= responder.due {
            responder.go_on(now);
        }
        responder.wait(&mut bell);
        for _ in 0..READS {
            let Some(Ok((length, from))) =
                responder.socket.as_ref().map(|s| s.recv_from(&mut heard))
            else {
                break;
            };
            responder.hear(&heard[..length], from);
        }
    }
    if !matches!(responder.step, Step::Probe(_)) {
        responder.announce(0);
    }
}

impl Responder<'_> {
    /// Joins the group on every new network, and announces there.
    fn join(&mut self, now: Instant) {
        self.joined = now + JOIN_PAUSE;
        let opened = self.socket.take().map_or_else(open, Ok);
        match opened {
            Ok(socket) => {
                for network in networks() {
                    let is_new = |known: &Network| known.address != network.address;
                    // Joined already is as well.
                    if self.networks.iter().all(is_new)
                        && self.networks.push(network).is_ok()
                        && socket.join_multicast_v4(&GROUP, &network.address).is_ok()
                        && matches!(self.step, Step::Wait)
                    {
                        (self.step, self.due) = (Step::Announce(0), now);
                    }
                }
                self.socket = Some(socket);
            }
            Err(error) => tracing::debug!("mDNS: {error}"),
        }
        let there = !self.networks.is_empty();
        self.shared.connected.store(there, Ordering::Relaxed);
    }

    /// Does the next step.
    fn go_on(&mut self, now: Instant) {
        let (next, pause) = match self.step {
            Step::Probe(done) if done < PROBES => {
                self.shout(0, |zone, address, out| zone.probe(address, out));
                (Step::Probe(done + 1), PROBE_PAUSE)
            }
            Step::Probe(_) => (Step::Announce(0), Duration::ZERO),
            Step::Announce(done) if done < ANNOUNCEMENTS => {
                self.announce(u32::MAX);
                if done == 0 {
                    self.claim.pauses.reset();
                    let (instance, host) = (&self.zone.instance, &self.zone.host);
                    tracing::info!("announced as {instance:?} at {host}.local");
                }
                (Step::Announce(done + 1), ANNOUNCE_PAUSE)
            }
            _ => (Step::Wait, JOIN_PAUSE),
        };
        (self.step, self.due) = (next, now + pause);
    }

    /// Waits for the bell, a datagram or the next step.
    fn wait(&self, bell: &mut Bell) {
        let fd = self.socket.as_ref().map_or(-1, |one| one.as_raw_fd());
        let mut asked = [bell.fd(), fd].map(|fd| PollFd::new(fd, PollFlags::POLLIN));
        let next = self.due.min(self.joined);
        let wait = next.saturating_duration_since(Instant::now());
        let _ = poll(&mut asked, wait.as_millis().min(1000) as i32 + 1);
        bell.answer();
    }

    /// Handles a query, or an answer from somebody who may have our name. Only those on one of our networks have a say.
    fn hear(&mut self, bytes: &[u8], from: SocketAddr) {
        let Some(heard) = Message::read(bytes) else {
            return count(&self.shared.refused);
        };
        let Some(network) = self.networks.iter().find(|one| one.has(from.ip())).copied() else {
            return;
        };
        let is_reply = heard.word(2).is_some_and(|flags| flags & 0x8000 != 0);
        let own = |address| self.networks.iter().any(|known| known.address == address);
        if !is_reply {
            self.answer(&heard, from, network);
        } else if from.port() == PORT && self.zone.is_taken(&heard, own) {
            self.contest();
        }
    }

    /// Somebody else uses our name: one that was just probed is theirs, one that is ours is probed anew, now and then.
    fn contest(&mut self) {
        let now = Instant::now();
        match self.step {
            Step::Probe(0) => {}
            Step::Probe(_) => {
                let pause = self.claim.lost();
                self.zone.call(self.claim.number);
                let next = &self.zone.instance;
                if pause.is_zero() {
                    tracing::info!("the name is already in use, trying {next:?}");
                } else {
                    tracing::warn!(
                        "{NAMES} names in a row are in use, trying {next:?} again in {} s; set network.name if other boxes have them",
                        pause.as_secs()
                    );
                }
                (self.step, self.due) = (Step::Probe(0), now + pause);
            }
            _ if self.checked.is_some_and(|at| now < at + CHECK_PAUSE) => {}
            _ => {
                self.checked = Some(now);
                (self.step, self.due) = (Step::Probe(0), now);
            }
        }
    }

    /// Answers a query: by unicast if it came from another port, otherwise to everybody on its network.
    fn answer(&mut self, query: &Message, from: SocketAddr, network: Network) {
        // Nothing is promised before the name is ours.
        if matches!(self.step, Step::Probe(_)) {
            return;
        }
        let legacy = from.port() != PORT;
        let out = self.zone.answer(query, network.address, legacy);
        if out.count(Section::Answers) == 0 {
            return;
        }
        if !self.replies.take(Instant::now()) {
            return count(&self.shared.dropped);
        }
        let to = if legacy {
            from
        } else {
            SocketAddr::from((GROUP, PORT))
        };
        self.send(out.bytes(), network, to);
    }

    /// Sends all records to every network; with a `keep` of 0 withdraws them.
    fn announce(&self, keep: u32) {
        self.shout(REPLY, |zone, address, out| {
            out.keep = keep;
            zone.announce(address, out);
        });
    }

    /// Sends to every network, with our address there.
    fn shout(&self, flags: u16, what: impl Fn(&Zone, Ipv4Addr, &mut Writer)) {
        for network in &self.networks {
            let mut out = Writer::new(0, flags);
            what(&self.zone, network.address, &mut out);
            self.send(out.bytes(), *network, (GROUP, PORT).into());
        }
    }

    fn send(&self, bytes: &[u8], network: Network, to: SocketAddr) {
        let Some(socket) = &self.socket else {
            return;
        };
        let sent = SockRef::from(socket)
            .set_multicast_if_v4(&network.address)
            .and_then(|()| socket.send_to(bytes, to));
        count(if sent.is_ok() {
            &self.shared.sent
        } else {
            &self.shared.dropped
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_network_that_refuses_every_name_is_asked_for_few_and_for_the_first_within_a_minute() {
        let mut claim = Claim::FIRST;
        let (mut seconds, mut taken) = (0, std::collections::BTreeSet::new());
        while seconds < 600 {
            let pause = claim.lost().as_secs();
            assert!(pause < 60 && (pause == 0 || pause >= 5 && claim.number == 1));
            taken.insert(claim.number);
            seconds += pause;
        }
        assert!((NAMES as usize..=20).contains(&taken.len()), "{taken:?}");
        // Of the fleet's own names the next free one is taken at once.
        claim.pauses.reset();
        assert_eq!((claim.lost(), claim.number), (Duration::ZERO, 2));
    }
}
