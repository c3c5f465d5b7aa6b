//! mDNS and DNS-SD (RFC 6762, RFC 6763): announces the box's services, without a daemon, or beside one (avahi) on the same
//! port of the same host.
//!
//! | service | port | when |
//! | --- | --- | --- |
//! | `_osc._udp` | the command port | `[osc]` accepts commands |
//! | `_oscjson._tcp` | OSCQuery | `[oscquery]` is enabled |
//! | `_http._tcp` | the page, or else WebSocket, `path=/` | `[page]` or `[websocket]` is enabled |
//!
//! Instances are named `mien NAME`, the host `mien-NAME.local`, so that nothing conflicts with a daemon's own names. The name is
//! probed three times before it is used; if it is in use, `-2`, `-3`, … is appended, up to fifteen names; a network that
//! refuses them all is asked for the first again at growing intervals (RFC 6762, 8.1 and 9). Everything is then announced twice,
//! sent in reply to queries (except known answers), and withdrawn at the end. The address announced is the one on the
//! querier's network. Memory: two datagrams. Limits: IPv4; only networks whose interfaces exist at start-up or a minute later.
//! One file: the format, written and read, what is sent in it, and when.

use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, poll};
use nix::sys::socket::sockopt::{ReuseAddr, ReusePort};
use nix::sys::socket::{
    AddressFamily, ControlMessage, MsgFlags, MultiHeaders, SockFlag, SockType, SockaddrIn, bind,
    sendmmsg, setsockopt, socket,
};

use super::{Output, OutputError, Report, Tally, identity};

const GROUP: Ipv4Addr = Ipv4Addr::new(224, 0, 0, 251);
const PORT: u16 = 5353;
/// Longest datagram, bytes.
const LARGEST: usize = 1472;
/// Probes before a name is used, and the pause between them.
const PROBES: u8 = 3;
const PROBE_PAUSE: Duration = Duration::from_millis(250);
/// Announcements, and the pause between them.
const ANNOUNCEMENTS: u8 = 2;
const ANNOUNCE_PAUSE: Duration = Duration::from_secs(1);
/// Names tried without a pause; then the first one again, after pauses that double.
const NAMES: u32 = 15;
const PAUSES_S: [u64; 2] = [5, 50];
/// Shortest time between two checks of a name that is ours but that somebody else uses.
const CHECK_PAUSE: Duration = Duration::from_secs(60);
/// Interval at which new networks are joined.
const JOIN_PAUSE: Duration = Duration::from_secs(60);
/// Most replies per second, so that nobody can use us to flood a network.
const ANSWERS: u32 = 50;
/// Time to live of records, seconds: of names, and of records that may change (RFC 6762, 10).
const KEEP: u32 = 4500;
const KEEP_ADDRESS: u32 = 120;

const A: u16 = 1;
const PTR: u16 = 12;
const TXT: u16 = 16;
const SRV: u16 = 33;
const ANY: u16 = 255;
/// Class IN; with the top bit, cache flush (answers) or unicast reply wanted (questions).
const IN: u16 = 1;
const UNIQUE: u16 = 0x8000;

/// A service to announce.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Service {
    /// `_osc`, without the dot.
    pub kind: &'static str,
    /// `_udp` or `_tcp`.
    pub transport: &'static str,
    /// Where it is served.
    pub port: u16,
    /// A `key=value`, or empty.
    pub text: &'static str,
}

/// A name as labels.
type Name<'a> = heapless::Vec<&'a str, 5>;

fn labels<'a>(of: &[&'a str]) -> Name<'a> {
    of.iter().copied().collect()
}

/// A datagram being written.
struct Writer<'a> {
    bytes: &'a mut [u8; LARGEST],
    length: usize,
    /// Whether anything did not fit.
    cut: bool,
}

impl<'a> Writer<'a> {
    /// `flags` are those of the header; the counts are filled in at the end.
    fn new(bytes: &'a mut [u8; LARGEST], id: u16, flags: u16) -> Self {
        let mut writer = Self {
            bytes,
            length: 0,
            cut: false,
        };
        for word in [id, flags, 0, 0, 0, 0] {
            writer.word(word);
        }
        writer
    }

    fn put(&mut self, part: &[u8]) {
        match self.bytes.get_mut(self.length..self.length + part.len()) {
            Some(room) => {
                room.copy_from_slice(part);
                self.length += part.len();
            }
            None => self.cut = true,
        }
    }

    fn word(&mut self, word: u16) {
        self.put(&word.to_be_bytes());
    }

    fn name(&mut self, name: &[&str]) {
        for label in name {
            self.put(&[label.len() as u8]);
            self.put(label.as_bytes());
        }
        self.put(&[0]);
    }

    /// Counts a record in a section: 0 questions, 1 answers, 2 authority, 3 additional.
    fn counted(&mut self, section: usize) {
        let at = 4 + 2 * section;
        let count = u16::from_be_bytes([self.bytes[at], self.bytes[at + 1]]) + 1;
        self.bytes[at..at + 2].copy_from_slice(&count.to_be_bytes());
    }

    fn question(&mut self, name: &[&str], kind: u16, class: u16) {
        self.name(name);
        self.word(kind);
        self.word(class);
        self.counted(0);
    }

    /// A record whose data `data` writes.
    fn record(
        &mut self,
        section: usize,
        name: &[&str],
        kind: u16,
        class: u16,
        keep: u32,
        data: impl FnOnce(&mut Self),
    ) {
        let start = self.length;
        self.name(name);
        self.word(kind);
        self.word(class);
        self.put(&keep.to_be_bytes());
        let at = self.length;
        self.word(0);
        data(self);
        if self.cut {
            // What does not fit is left out; the asker asks again for it.
            self.length = start;
            return;
        }
        let length = (self.length - at - 2) as u16;
        self.bytes[at..at + 2].copy_from_slice(&length.to_be_bytes());
        self.counted(section);
    }

    fn bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

/// Whether the name at `at` is `name`, ignoring case, and the offset after it; `None` if it is not a name.
fn is_name(bytes: &[u8], mut at: usize, name: &[&str]) -> Option<(bool, usize)> {
    let (mut after, mut same, mut left) = (None, true, name.iter());
    // More labels than a name has room for are a circle.
    for _ in 0..128 {
        let length = usize::from(*bytes.get(at)?);
        match length >> 6 {
            0 if length == 0 => {
                return Some((same && left.next().is_none(), after.unwrap_or(at + 1)));
            }
            0 => {
                let label = bytes.get(at + 1..at + 1 + length)?;
                same &= left
                    .next()
                    .is_some_and(|name| name.as_bytes().eq_ignore_ascii_case(label));
                at += 1 + length;
            }
            3 => {
                let to = (length & 0x3f) << 8 | usize::from(*bytes.get(at + 1)?);
                after.get_or_insert(at + 2);
                // Only back, so that it ends.
                if to >= at {
                    return None;
                }
                at = to;
            }
            _ => return None,
        }
    }
    None
}

fn word(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_be_bytes([*bytes.get(at)?, *bytes.get(at + 1)?]))
}

/// A record of a datagram.
struct Record {
    /// Where its name begins.
    name: usize,
    kind: u16,
    keep: u32,
    /// Where its data begins.
    data: usize,
    next: usize,
}

fn record(bytes: &[u8], at: usize) -> Option<Record> {
    let (_, after) = is_name(bytes, at, &[])?;
    let keep = u32::from(word(bytes, after + 4)?) << 16 | u32::from(word(bytes, after + 6)?);
    let next = after + 10 + usize::from(word(bytes, after + 8)?);
    (next <= bytes.len()).then_some(Record {
        name: at,
        kind: word(bytes, after)?,
        keep,
        data: after + 10,
        next,
    })
}

/// The box's names and services.
struct Zone {
    /// The name wanted, and the number appended if others have the same.
    wanted: String,
    instance: String,
    host: String,
    services: Box<[Service]>,
}

impl Zone {
    fn new(name: &str, services: Vec<Service>) -> Self {
        let mut zone = Self {
            wanted: name.to_owned(),
            instance: String::new(),
            host: String::new(),
            services: services.into(),
        };
        zone.call(1);
        zone
    }

    fn call(&mut self, number: u32) {
        let behind = if number > 1 {
            format!("-{number}")
        } else {
            String::new()
        };
        let wanted: String = self.wanted.chars().take(48).collect();
        self.instance = format!("mien {wanted}{behind}");
        self.host = format!("mien-{wanted}{behind}");
    }

    fn kind<'a>(&self, service: &Service) -> Name<'a> {
        labels(&[service.kind, service.transport, "local"])
    }

    fn full<'a>(&'a self, service: &Service) -> Name<'a> {
        labels(&[&self.instance, service.kind, service.transport, "local"])
    }

    fn host(&self) -> Name<'_> {
        labels(&[&self.host, "local"])
    }

    fn pointer(&self, service: &Service, section: usize, keep: u32, out: &mut Writer) {
        let full = self.full(service);
        out.record(section, &self.kind(service), PTR, IN, keep, |out| {
            out.name(&full)
        });
    }

    fn place(&self, service: &Service, section: usize, class: u16, keep: u32, out: &mut Writer) {
        out.record(
            section,
            &self.full(service),
            SRV,
            class,
            keep.min(KEEP_ADDRESS),
            |out| {
                out.word(0);
                out.word(0);
                out.word(service.port);
                out.name(&self.host());
            },
        );
    }

    fn text(&self, service: &Service, section: usize, class: u16, keep: u32, out: &mut Writer) {
        out.record(section, &self.full(service), TXT, class, keep, |out| {
            out.put(&[service.text.len() as u8]);
            out.put(service.text.as_bytes());
        });
    }

    fn address(&self, section: usize, class: u16, keep: u32, address: Ipv4Addr, out: &mut Writer) {
        out.record(
            section,
            &self.host(),
            A,
            class,
            keep.min(KEEP_ADDRESS),
            |out| out.put(&address.octets()),
        );
    }

    /// All records with this time to live; 0 withdraws them.
    fn announce(&self, keep: u32, address: Ipv4Addr, out: &mut Writer) {
        for service in &self.services {
            self.pointer(service, 1, keep, out);
            self.place(service, 1, IN | UNIQUE, keep, out);
            self.text(service, 1, IN | UNIQUE, keep, out);
        }
        self.address(1, IN | UNIQUE, keep, address, out);
    }

    /// Probe: asks whether anybody has our names, with the records we propose.
    fn probe(&self, address: Ipv4Addr, out: &mut Writer) {
        for service in &self.services {
            out.question(&self.full(service), ANY, IN | UNIQUE);
        }
        out.question(&self.host(), ANY, IN | UNIQUE);
        for service in &self.services {
            self.place(service, 2, IN, KEEP, out);
        }
        self.address(2, IN, KEEP_ADDRESS, address, out);
    }

    /// Whether an answer shows that somebody else has one of our names, at another address or port.
    fn is_taken(&self, bytes: &[u8], own: &dyn Fn(Ipv4Addr) -> bool) -> Option<bool> {
        let mut at = 12;
        for _ in 0..word(bytes, 4)? {
            at = is_name(bytes, at, &[])?.1 + 4;
        }
        let records = usize::from(word(bytes, 6)?)
            + usize::from(word(bytes, 8)?)
            + usize::from(word(bytes, 10)?);
        for _ in 0..records {
            let record = record(bytes, at)?;
            at = record.next;
            if record.kind == A && is_name(bytes, record.name, &self.host())?.0 {
                let octets: [u8; 4] = bytes.get(record.data..record.data + 4)?.try_into().ok()?;
                if !own(Ipv4Addr::from(octets)) {
                    return Some(true);
                }
            }
            for service in &self.services {
                if record.kind == SRV && is_name(bytes, record.name, &self.full(service))?.0 {
                    let port = word(bytes, record.data + 4)?;
                    let same =
                        is_name(bytes, record.data + 6, &self.host())?.0 && port == service.port;
                    if !same {
                        return Some(true);
                    }
                }
            }
        }
        Some(false)
    }

    /// Answers a query; `None` if there is nothing to answer. `address` is the one that the querier can reach; `legacy` queriers
    /// are not mDNS responders and need their questions repeated.
    fn answer(
        &self,
        bytes: &[u8],
        address: Ipv4Addr,
        legacy: bool,
        out: &mut Writer,
    ) -> Option<()> {
        let (questions, known) = (word(bytes, 4)?, word(bytes, 6)?);
        let class = if legacy { IN } else { IN | UNIQUE };
        let keep = |long: u32| if legacy { 10 } else { long };
        let mut at = 12;
        for _ in 0..questions {
            at = is_name(bytes, at, &[])?.1 + 4;
        }
        let answers = at;
        let mut at = 12;
        for _ in 0..questions {
            let (name, after) = (at, is_name(bytes, at, &[])?.1);
            let kind = word(bytes, after)?;
            at = after + 4;
            let asked = |wanted: u16| kind == wanted || kind == ANY;
            let is = |what: &[&str]| is_name(bytes, name, what).is_some_and(|(same, _)| same);
            if legacy {
                // Before any answer, and once: who asks so asks one thing.
                if word(out.bytes, 4) == Some(0) {
                    out.put(bytes.get(name..at)?);
                    out.counted(0);
                }
            }
            if asked(PTR) && is(&["_services", "_dns-sd", "_udp", "local"]) {
                for service in &self.services {
                    let kind = self.kind(service);
                    out.record(
                        1,
                        &["_services", "_dns-sd", "_udp", "local"],
                        PTR,
                        IN,
                        keep(KEEP),
                        |out| out.name(&kind),
                    );
                }
            }
            for service in &self.services {
                if asked(PTR)
                    && is(&self.kind(service))
                    && !self.is_known(bytes, answers, known, service)
                {
                    self.pointer(service, 1, keep(KEEP), out);
                    self.place(service, 3, class, keep(KEEP), out);
                    self.text(service, 3, class, keep(KEEP), out);
                    self.address(3, class, keep(KEEP), address, out);
                }
                if is(&self.full(service)) {
                    if asked(SRV) {
                        self.place(service, 1, class, keep(KEEP), out);
                        self.address(3, class, keep(KEEP), address, out);
                    }
                    if asked(TXT) {
                        self.text(service, 1, class, keep(KEEP), out);
                    }
                }
            }
            if asked(A) && is(&self.host()) {
                self.address(1, class, keep(KEEP), address, out);
            }
        }
        Some(())
    }

    /// Whether the query lists our pointer as a known answer, with at least half of its time to live.
    fn is_known(&self, bytes: &[u8], mut at: usize, known: u16, service: &Service) -> bool {
        for _ in 0..known {
            let Some(record) = record(bytes, at) else {
                return false;
            };
            at = record.next;
            let is = |at, name: &[&str]| is_name(bytes, at, name).is_some_and(|(same, _)| same);
            if record.kind == PTR
                && record.keep >= KEEP / 2
                && is(record.name, &self.kind(service))
                && is(record.data, &self.full(service))
            {
                return true;
            }
        }
        false
    }
}

/// Counters of the thread.
#[derive(Default)]
struct Counts {
    stop: AtomicBool,
    there: AtomicBool,
    sent: AtomicU64,
    dropped: AtomicU64,
    refused: AtomicU64,
}

/// Announces and answers.
pub struct Discovery {
    counts: Arc<Counts>,
    bell: UnixStream,
    thread: Option<JoinHandle<()>>,
}

impl Discovery {
    /// Starts announcing. `name` is the box's.
    ///
    /// # Errors
    /// If no thread can be started; not if there is no network yet.
    pub fn new(name: &str, services: Vec<Service>) -> Result<Self, OutputError> {
        let pair = UnixStream::pair().map_err(|source| OutputError::Socket { source })?;
        let (bell, heard) = pair;
        let counts = Arc::new(Counts::default());
        let its = Arc::clone(&counts);
        let zone = Zone::new(&identity::name(name), services);
        let thread = std::thread::Builder::new()
            .name("discovery".to_owned())
            .spawn(move || run(zone, &its, &heard))
            .map_err(|source| OutputError::Thread { source })?;
        Ok(Self {
            counts,
            bell,
            thread: Some(thread),
        })
    }
}

impl Output for Discovery {
    fn send(&mut self, _: &Report) -> Result<(), OutputError> {
        Ok(())
    }

    fn tally(&self) -> Tally {
        let of = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Tally {
            sent: of(&self.counts.sent),
            dropped: of(&self.counts.dropped),
            connected: self.counts.there.load(Ordering::Relaxed),
            commands: [0, of(&self.counts.refused)],
            ..Tally::of("discovery")
        }
    }
}

impl Drop for Discovery {
    /// Withdraws everything.
    fn drop(&mut self) {
        self.counts.stop.store(true, Ordering::Relaxed);
        let _ = std::io::Write::write(&mut &self.bell, &[1]);
        if let Some(thread) = self.thread.take() {
            // It waits for nothing but the bell.
            thread.join().ok();
        }
    }
}

/// A socket on the port shared with daemons.
fn open() -> std::io::Result<UdpSocket> {
    let raw = socket(
        AddressFamily::Inet,
        SockType::Datagram,
        SockFlag::SOCK_CLOEXEC,
        None,
    )?;
    let socket = owned(raw);
    setsockopt(socket.as_raw_fd(), ReuseAddr, &true)?;
    setsockopt(socket.as_raw_fd(), ReusePort, &true)?;
    let any = SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, PORT);
    bind(socket.as_raw_fd(), &SockaddrIn::from(any))?;
    let socket = UdpSocket::from(socket);
    socket.set_nonblocking(true)?;
    socket.set_multicast_ttl_v4(255)?;
    // Others on this host want to know too.
    socket.set_multicast_loop_v4(true)?;
    Ok(socket)
}

/// An owned descriptor.
#[expect(unsafe_code, reason = "nix 0.26 hands out numbers")]
fn owned(raw: std::os::fd::RawFd) -> OwnedFd {
    // SAFETY: it was just opened, and nothing else owns it.
    unsafe { OwnedFd::from_raw_fd(raw) }
}

/// Networks of this host that can be reached by multicast.
fn interfaces(each: &mut dyn FnMut(Network)) {
    use nix::net::if_::InterfaceFlags;
    let Ok(all) = nix::ifaddrs::getifaddrs() else {
        return;
    };
    for one in all {
        let up = one
            .flags
            .contains(InterfaceFlags::IFF_UP | InterfaceFlags::IFF_MULTICAST)
            || one.flags.contains(InterfaceFlags::IFF_LOOPBACK);
        let v4 = |address: Option<&nix::sys::socket::SockaddrStorage>| {
            address.and_then(|address| address.as_sockaddr_in().map(|v4| Ipv4Addr::from(v4.ip())))
        };
        let (address, mask) = (v4(one.address.as_ref()), v4(one.netmask.as_ref()));
        let number = nix::net::if_::if_nametoindex(one.interface_name.as_str());
        if let (Some(address), Ok(interface)) = (address.filter(|_| up), number) {
            each(Network {
                address,
                mask: mask.unwrap_or(Ipv4Addr::BROADCAST),
                interface,
            });
        }
    }
}

/// The address by which a host can reach us.
fn towards(whom: SocketAddr) -> Option<Ipv4Addr> {
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).ok()?;
    socket.connect(whom).ok()?;
    match socket.local_addr().ok()? {
        SocketAddr::V4(address) => Some(*address.ip()),
        SocketAddr::V6(_) => None,
    }
}

/// A network to announce on.
#[derive(Clone, Copy)]
struct Network {
    /// Ours there.
    address: Ipv4Addr,
    mask: Ipv4Addr,
    /// Index of the interface.
    interface: u32,
}

type Networks = heapless::Vec<Network, 8>;

/// Joins the group on every new network; whether there is any.
fn join(socket: &UdpSocket, networks: &mut Networks) -> bool {
    let mut new = false;
    interfaces(&mut |network| {
        if !networks
            .iter()
            .any(|known| known.address == network.address)
        {
            // Joined already is as well.
            let _ = socket.join_multicast_v4(&GROUP, &network.address);
            new |= networks.push(network).is_ok();
        }
    });
    new
}

/// Which name to try after one was refused.
struct Claim {
    /// Of the name; 1 is the configured one.
    number: u32,
    /// Names refused since one was ours.
    refused: u32,
}

impl Claim {
    /// The name is another's: chooses the next, and says how long to wait before it is probed.
    fn lost(&mut self) -> Duration {
        self.refused += 1;
        if self.refused < NAMES {
            self.number += 1;
            return Duration::ZERO;
        }
        self.number = 1;
        let doubled = (self.refused - NAMES).min(8);
        Duration::from_secs((PAUSES_S[0] << doubled).min(PAUSES_S[1]))
    }
}

/// The next step.
enum Step {
    Probe(u8),
    Announce(u8),
    Wait,
}

fn run(mut zone: Zone, counts: &Counts, bell: &UnixStream) {
    let mut talk = Talk {
        networks: Networks::new(),
        voice: Voice {
            head: MultiHeaders::preallocate(1, Some(nix::cmsg_space!(libc::in_pktinfo))),
            counts,
        },
        listener: None,
        step: Step::Probe(0),
        due: Instant::now(),
        joined: Instant::now(),
        claim: Claim {
            number: 1,
            refused: 0,
        },
        checked: None,
        said: [0; LARGEST],
        second: Instant::now(),
        answers: 0,
    };
    let mut heard = [0; LARGEST];
    while !counts.stop.load(Ordering::Relaxed) {
        let now = Instant::now();
        if talk.listener.is_none() || now >= talk.joined {
            talk.join(now);
        }
        if now >= talk.due {
            talk.go_on(&zone, now);
        }
        talk.wait(bell);
        for _ in 0..64 {
            let Some((length, from)) = talk.listen(&mut heard) else {
                break;
            };
            talk.hear(&mut zone, &heard[..length], from);
        }
    }
    if !matches!(talk.step, Step::Probe(_)) {
        talk.shout(0x8400, |address, out| zone.announce(0, address, out));
    }
}

/// State of probing and announcing.
struct Talk<'a> {
    networks: Networks,
    voice: Voice<'a>,
    listener: Option<UdpSocket>,
    /// What comes next, and when.
    step: Step,
    due: Instant,
    /// When to look for new networks again.
    joined: Instant,
    claim: Claim,
    /// When a name that is ours was last checked because somebody else uses it.
    checked: Option<Instant>,
    said: [u8; LARGEST],
    /// Start of the second in which replies are counted.
    second: Instant,
    answers: u32,
}

impl Talk<'_> {
    /// Joins all networks and announces on new ones.
    fn join(&mut self, now: Instant) {
        self.joined = now + JOIN_PAUSE;
        if self.listener.is_none() {
            self.listener = open()
                .inspect_err(|error| tracing::debug!("mDNS: {error}"))
                .ok();
        }
        if let Some(listener) = &self.listener
            && join(listener, &mut self.networks)
            && matches!(self.step, Step::Wait)
        {
            (self.step, self.due) = (Step::Announce(0), now);
        }
        let there = !self.networks.is_empty();
        self.voice.counts.there.store(there, Ordering::Relaxed);
    }

    /// Does the next step.
    fn go_on(&mut self, zone: &Zone, now: Instant) {
        let (next, pause) = match self.step {
            Step::Probe(done) if done < PROBES => {
                self.shout(0, |address, out| zone.probe(address, out));
                (Step::Probe(done + 1), PROBE_PAUSE)
            }
            Step::Probe(_) => (Step::Announce(0), Duration::ZERO),
            Step::Announce(done) if done < ANNOUNCEMENTS => {
                self.shout(0x8400, |address, out| zone.announce(KEEP, address, out));
                if done == 0 {
                    self.claim.refused = 0;
                    tracing::info!("announced as {:?} at {}.local", zone.instance, zone.host);
                }
                (Step::Announce(done + 1), ANNOUNCE_PAUSE)
            }
            _ => (Step::Wait, JOIN_PAUSE),
        };
        (self.step, self.due) = (next, now + pause);
    }

    /// Waits for the bell, a datagram or the next step.
    fn wait(&self, bell: &UnixStream) {
        let fd = self.listener.as_ref().map_or(-1, |one| one.as_raw_fd());
        let mut asked = [
            PollFd::new(bell.as_raw_fd(), PollFlags::POLLIN),
            PollFd::new(fd, PollFlags::POLLIN),
        ];
        let next = self.due.min(self.joined);
        let wait = next.saturating_duration_since(Instant::now());
        let _ = poll(&mut asked, wait.as_millis().min(1000) as i32 + 1);
    }

    /// A received datagram, if any.
    fn listen(&self, heard: &mut [u8]) -> Option<(usize, SocketAddr)> {
        self.listener.as_ref()?.recv_from(heard).ok()
    }

    /// Handles a query, or an answer from somebody who may have our name.
    fn hear(&mut self, zone: &mut Zone, bytes: &[u8], from: SocketAddr) {
        let counts = self.voice.counts;
        let Some(flags) = word(bytes, 2).filter(|_| bytes.len() >= 12) else {
            counts.refused.fetch_add(1, Ordering::Relaxed);
            return;
        };
        if flags & 0x8000 == 0 {
            self.answer(zone, bytes, from);
            return;
        }
        let own = |address: Ipv4Addr| self.networks.iter().any(|known| known.address == address);
        match zone.is_taken(bytes, &own) {
            Some(true) if from.port() == PORT && self.is_near(from) => self.contest(zone),
            Some(_) => {}
            None => {
                counts.refused.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Whether a datagram comes from one of our networks; others have no say about names here.
    fn is_near(&self, from: SocketAddr) -> bool {
        let SocketAddr::V4(from) = from else {
            return false;
        };
        let same = |network: &Network| {
            let mask = u32::from(network.mask);
            u32::from(network.address) & mask == u32::from(*from.ip()) & mask
        };
        self.networks.iter().any(same)
    }

    /// Somebody else uses our name: one that was just probed is theirs, one that is ours is probed anew, now and then.
    fn contest(&mut self, zone: &mut Zone) {
        let now = Instant::now();
        match self.step {
            Step::Probe(0) => {}
            Step::Probe(_) => {
                let pause = self.claim.lost();
                zone.call(self.claim.number);
                if pause.is_zero() {
                    tracing::info!("the name is already in use, trying {:?}", zone.instance);
                } else {
                    tracing::warn!(
                        "{NAMES} names in a row are in use, trying {:?} again in {} s; set network.name if other boxes have them",
                        zone.instance,
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
    fn answer(&mut self, zone: &Zone, bytes: &[u8], from: SocketAddr) {
        // Nothing is promised before the name is ours.
        let (Some(listener), false) = (&self.listener, matches!(self.step, Step::Probe(_))) else {
            return;
        };
        if self.second.elapsed() > Duration::from_secs(1) {
            (self.second, self.answers) = (Instant::now(), 0);
        }
        let legacy = from.port() != PORT;
        let address = towards(from).unwrap_or(Ipv4Addr::LOCALHOST);
        let id = if legacy {
            word(bytes, 0).unwrap_or(0)
        } else {
            0
        };
        let mut out = Writer::new(&mut self.said, id, 0x8400);
        if zone.answer(bytes, address, legacy, &mut out).is_none() {
            self.voice.counts.refused.fetch_add(1, Ordering::Relaxed);
            return;
        }
        if word(out.bytes, 6) == Some(0) {
            return;
        }
        self.answers += 1;
        if self.answers > ANSWERS {
            self.voice.counts.dropped.fetch_add(1, Ordering::Relaxed);
            return;
        }
        match self.networks.iter().find(|known| known.address == address) {
            Some(network) if !legacy => self.voice.call(listener, out.bytes(), *network),
            _ => {
                let to = if legacy {
                    from
                } else {
                    SocketAddr::from((GROUP, PORT))
                };
                self.voice.count(listener.send_to(out.bytes(), to).is_ok());
            }
        }
    }

    /// Sends to every network, with our address there.
    fn shout(&mut self, flags: u16, what: impl Fn(Ipv4Addr, &mut Writer)) {
        let (socket, networks) = (self.listener.as_ref(), &self.networks);
        self.voice
            .shout(socket, networks, &mut self.said, flags, what);
    }
}

/// Sending. Everything uses one socket: another one bound to a network's address would receive what is meant for a daemon on
/// this host.
struct Voice<'a> {
    /// Buffer for the head of a datagram, allocated once.
    head: MultiHeaders<SockaddrIn>,
    counts: &'a Counts,
}

impl Voice<'_> {
    fn count(&self, sent: bool) {
        let counter = if sent {
            &self.counts.sent
        } else {
            &self.counts.dropped
        };
        counter.fetch_add(1, Ordering::Relaxed);
    }

    /// Sends to everybody on a network.
    fn call(&mut self, socket: &UdpSocket, bytes: &[u8], network: Network) {
        let info = libc::in_pktinfo {
            ipi_ifindex: network.interface as i32,
            ipi_spec_dst: libc::in_addr {
                s_addr: u32::from_ne_bytes(network.address.octets()),
            },
            ipi_addr: libc::in_addr { s_addr: 0 },
        };
        let to = [Some(SockaddrIn::from(SocketAddrV4::new(GROUP, PORT)))];
        let parts = [[std::io::IoSlice::new(bytes)]];
        let out = [ControlMessage::Ipv4PacketInfo(&info)];
        let flags = MsgFlags::MSG_DONTWAIT;
        let sent = sendmmsg(socket.as_raw_fd(), &mut self.head, &parts, to, out, flags).is_ok();
        self.count(sent);
    }

    /// Sends to every network, with our address there.
    fn shout(
        &mut self,
        socket: Option<&UdpSocket>,
        networks: &Networks,
        said: &mut [u8; LARGEST],
        flags: u16,
        what: impl Fn(Ipv4Addr, &mut Writer),
    ) {
        let Some(socket) = socket else {
            return;
        };
        for network in networks {
            let mut out = Writer::new(said, 0, flags);
            what(network.address, &mut out);
            self.call(socket, out.bytes(), *network);
        }
    }
}

/// A datagram as it comes from the network, for `tests/fuzz`.
#[cfg(fuzzing)]
pub fn fuzz(bytes: &[u8]) {
    let service = |kind, port, text| Service {
        kind,
        transport: "_udp",
        port,
        text,
    };
    let services = vec![service("_osc", 9131, ""), service("_http", 9133, "path=/")];
    let (zone, here) = (Zone::new("hall", services), Ipv4Addr::LOCALHOST);
    for legacy in [false, true] {
        let mut said = [0; LARGEST];
        let mut out = Writer::new(&mut said, 0, 0x8400);
        zone.answer(bytes, here, legacy, &mut out);
        assert!(out.length <= LARGEST);
    }
    zone.is_taken(bytes, &|address| address == here);
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: Ipv4Addr = Ipv4Addr::new(192, 0, 2, 7);

    fn zone() -> Zone {
        let osc = Service {
            kind: "_osc",
            transport: "_udp",
            port: 9131,
            text: "",
        };
        let web = Service {
            kind: "_http",
            transport: "_tcp",
            port: 9133,
            text: "path=/",
        };
        Zone::new("hall", vec![osc, web])
    }

    /// Answers to a question, as counts of answers and more, and the bytes.
    fn ask(name: &[&str], kind: u16, legacy: bool) -> Option<(u16, u16, Vec<u8>)> {
        let (mut question, mut said) = ([0; LARGEST], [0; LARGEST]);
        let mut out = Writer::new(&mut question, 77, 0);
        out.question(name, kind, IN);
        let asked = out.bytes().to_vec();
        let mut out = Writer::new(&mut said, 0, 0x8400);
        zone().answer(&asked, HERE, legacy, &mut out)?;
        let bytes = out.bytes().to_vec();
        Some((word(&bytes, 6)?, word(&bytes, 10)?, bytes))
    }

    #[test]
    fn questions_are_answered_with_what_else_will_be_asked_for() {
        let (answers, more, bytes) = ask(&["_OSC", "_udp", "local"], PTR, false).unwrap();
        assert_eq!((answers, more), (1, 3));
        let pointer = record(&bytes, 12).unwrap();
        assert!(
            is_name(
                &bytes,
                pointer.data,
                &["mien hall", "_osc", "_udp", "local"]
            )
            .unwrap()
            .0
        );
        let place = record(&bytes, pointer.next).unwrap();
        assert_eq!(
            (place.kind, word(&bytes, place.data + 4)),
            (SRV, Some(9131))
        );
        assert!(
            is_name(&bytes, place.data + 6, &["mien-hall", "local"])
                .unwrap()
                .0
        );
        let (answers, ..) = ask(&["_services", "_dns-sd", "_udp", "local"], PTR, false).unwrap();
        assert_eq!(answers, 2);
        let (answers, _, bytes) = ask(&["mien-hall", "local"], A, true).unwrap();
        assert_eq!((answers, word(&bytes, 4)), (1, Some(1)));
        assert_eq!(bytes[bytes.len() - 4..], HERE.octets());
        for (name, kind) in [
            (&["_osc", "_tcp", "local"][..], PTR),
            (&["_osc", "_udp", "local"], A),
            (&["other", "local"], A),
        ] {
            assert_eq!(ask(name, kind, false).unwrap().0, 0);
        }
    }

    #[test]
    fn what_the_asker_knows_is_not_told_again() {
        let (mut question, mut said) = ([0; LARGEST], [0; LARGEST]);
        let zone = zone();
        for (keep, answers) in [(KEEP, 0), (KEEP / 3, 1)] {
            let mut out = Writer::new(&mut question, 0, 0);
            out.question(&["_osc", "_udp", "local"], PTR, IN);
            zone.pointer(&zone.services[0], 1, keep, &mut out);
            let asked = out.bytes().to_vec();
            let mut out = Writer::new(&mut said, 0, 0x8400);
            zone.answer(&asked, HERE, false, &mut out).unwrap();
            assert_eq!(word(out.bytes(), 6), Some(answers));
        }
    }

    #[test]
    fn a_name_that_another_has_is_left_to_them() {
        let (mut bytes, mut zone) = ([0; LARGEST], zone());
        let elsewhere = Ipv4Addr::new(192, 0, 2, 8);
        let own = |address: Ipv4Addr| address == HERE;
        for (address, port, taken) in [
            (HERE, 9131, false),
            (elsewhere, 9131, true),
            (HERE, 9, true),
        ] {
            let mut other = Zone::new("hall", zone.services.to_vec());
            other.services[0].port = port;
            let mut out = Writer::new(&mut bytes, 0, 0x8400);
            other.announce(KEEP, address, &mut out);
            assert_eq!(
                zone.is_taken(out.bytes(), &own),
                Some(taken),
                "{address} {port}"
            );
        }
        zone.call(2);
        assert_eq!(
            (zone.instance.as_str(), zone.host.as_str()),
            ("mien hall-2", "mien-hall-2")
        );
    }

    #[test]
    fn a_network_that_refuses_every_name_is_asked_for_few_and_for_the_first_within_a_minute() {
        let mut claim = Claim {
            number: 1,
            refused: 0,
        };
        let (mut seconds, mut taken) = (0, std::collections::BTreeSet::new());
        while seconds < 600 {
            let pause = claim.lost().as_secs();
            assert!(pause < 60 && (claim.refused < NAMES || (pause >= 5 && claim.number == 1)));
            taken.insert(claim.number);
            seconds += pause;
        }
        assert!((NAMES as usize..=20).contains(&taken.len()), "{taken:?}");
        // Of the fleet's own names the next free one is taken at once.
        claim.refused = 0;
        assert_eq!((claim.lost(), claim.number), (Duration::ZERO, 2));
    }

    #[test]
    fn no_bytes_whatever_do_harm() {
        let (mut question, mut said, zone) = ([0; LARGEST], [0; LARGEST], zone());
        let mut out = Writer::new(&mut question, 0, 0);
        zone.announce(KEEP, HERE, &mut out);
        out.question(&["_osc", "_udp", "local"], PTR, IN);
        let good = out.bytes().to_vec();
        let mut random = fastrand::Rng::with_seed(8);
        for _ in 0..100_000 {
            let mut bytes = good.clone();
            for _ in 0..random.usize(1..8) {
                let at = random.usize(..bytes.len());
                bytes[at] = random.u8(..);
            }
            bytes.truncate(random.usize(12..=bytes.len()));
            let mut out = Writer::new(&mut said, 0, 0x8400);
            zone.answer(&bytes, HERE, random.bool(), &mut out);
            assert!(out.length <= LARGEST);
            zone.is_taken(&bytes, &|_| false);
        }
        // A name that leads to itself.
        let mut circle = vec![0; 12];
        circle[5] = 1;
        circle.extend([0xc0, 12, 0, 12, 0, 1]);
        let mut out = Writer::new(&mut said, 0, 0x8400);
        assert!(zone.answer(&circle, HERE, false, &mut out).is_none());
    }
}
