//! A small server: HTTP/1.1 requests without bodies, each answered and closed, or upgraded to a WebSocket or an event stream.
//!
//! There are [`SLOTS`] connections. When all are in use, one that has sent no request within a quarter of a second is dropped;
//! otherwise the new one is rejected. Either case is counted. A request must be complete within [`PATIENCE`], at most [`REQUEST`]
//! bytes long; a client that reads nothing for [`STUCK`] is disconnected. A page that reads slower than frames arrive skips to
//! the newest. Memory: read and write buffers per connection, allocated at start-up.
//! One file: requests, frames and connections are small, and used nowhere else.

use std::io::{ErrorKind, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::os::fd::AsRawFd;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, poll};

use super::handshake;
use crate::base::capacity::WEB_CONNECTIONS as SLOTS;
use crate::output::board::{Bell, Board, Shared, count};
use crate::output::{Command, OutputError};

/// Event streams at once: the places left answer requests.
const STREAMS: usize = SLOTS - 2;
/// Longest request, or frame of a page, bytes.
const REQUEST: usize = 2048;
/// How long a request may take.
const PATIENCE: Duration = Duration::from_secs(2);
/// How long a silent connection is kept when another one arrives.
const GRACE: Duration = Duration::from_millis(250);
/// How long a client may leave data unread.
const STUCK: Duration = Duration::from_secs(10);
/// Connections accepted between two frames.
const NEWCOMERS: usize = 32;
/// Longest wait, so that timeouts are noticed.
const TICK_MS: i32 = 250;
/// First and longest pause before retrying an address that is in use.
const PAUSES: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(5)];

/// What is served.
pub(super) trait Service {
    /// Bytes that may be queued for a connection.
    const WAITING: usize;

    /// Whether pages may stay connected.
    const STAYS: bool;

    /// The path of the event stream, if there is one.
    const STREAM: Option<&'static str> = None;

    /// Whether a request with this head is looked at, else the status that refuses it; `order` is for a POST.
    fn admits(&self, _head: &str, _order: bool, _peer: IpAddr) -> Result<(), u16> {
        Ok(())
    }

    /// What a POST to `path` is for.
    fn order(&self, _path: &str) -> Order {
        Order::Never
    }

    /// Headers of a reply, of its content and who may read it.
    fn headers(&self, _path: &str, _status: u16) -> &'static str {
        "Content-Type: application/json\r\nAccess-Control-Allow-Origin: *\r\n"
    }

    /// Answers a request for `path` and its query (after `?`) in `body`; returns the status.
    fn answer(&mut self, path: &str, query: Option<&str>, board: &Board, body: &mut String) -> u16;

    /// Writes the next message for all pages into `message`; false if there is none.
    fn next_message(&mut self, board: &mut Board, message: &mut String) -> bool;
}

/// What a POST is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    /// Nothing is ordered here.
    Never,
    /// No such order.
    Unknown,
    /// For the pipeline.
    Ask(Command),
}

/// What a connection is about.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    Request,
    Reply,
    Page,
    /// An event stream.
    Stream,
}

struct Place {
    stream: Option<TcpStream>,
    stage: Stage,
    /// When the request began, or data was last written.
    since: Instant,
    heard: Box<[u8; REQUEST]>,
    length: usize,
    waiting: Vec<u8>,
    written: usize,
}

/// A parsed request.
#[derive(Debug, PartialEq, Eq)]
enum Asked<'a> {
    Page(&'a [u8; handshake::KEY]),
    Document(&'a str, Option<&'a str>),
    Order(&'a str),
    Refused(u16),
}

/// Parses a request; `None` while incomplete.
fn request(bytes: &[u8]) -> Option<Asked<'_>> {
    let end = bytes.windows(4).position(|four| four == b"\r\n\r\n")?;
    let Ok(text) = std::str::from_utf8(&bytes[..end]) else {
        return Some(Asked::Refused(400));
    };
    let mut lines = text.split("\r\n");
    let mut words = lines.next().unwrap_or_default().split(' ');
    let (method, target) = (words.next(), words.next());
    let known = words
        .next()
        .is_some_and(|version| version.starts_with("HTTP/1."))
        && words.next().is_none();
    let Some(target) = target.filter(|target| known && target.starts_with('/')) else {
        return Some(Asked::Refused(400));
    };
    match method {
        Some("GET") => {}
        Some("POST") => return Some(Asked::Order(target)),
        _ => return Some(Asked::Refused(405)),
    }
    let (mut upgrade, mut key) = (false, None);
    for line in lines {
        let (name, value) = line.split_once(':').unwrap_or_default();
        if name.eq_ignore_ascii_case("upgrade") {
            upgrade = value.trim().eq_ignore_ascii_case("websocket");
        } else if name.eq_ignore_ascii_case("sec-websocket-key") {
            key = value.trim().as_bytes().try_into().ok();
        }
    }
    Some(match (upgrade, key, target.split_once('?')) {
        (true, Some(key), _) => Asked::Page(key),
        (true, None, _) => Asked::Refused(400),
        (false, _, Some((path, query))) => Asked::Document(path, Some(query)),
        (false, _, None) => Asked::Document(target, None),
    })
}

/// What a page sends.
#[derive(Debug, PartialEq, Eq)]
enum Sent {
    /// A ping, answered with the same bytes.
    Ping(heapless::Vec<u8, 125>),
    /// Ignored.
    Other,
    Close,
}

/// The first frame in `bytes`, unmasked, and its length; `None` while incomplete. An invalid or overlong frame closes the
/// connection.
fn frame(bytes: &[u8]) -> Option<(Sent, usize)> {
    let (&first, &second) = (bytes.first()?, bytes.get(1)?);
    let (length, at) = match second & 0x7f {
        126 => (
            usize::from(u16::from_be_bytes([*bytes.get(2)?, *bytes.get(3)?])),
            4,
        ),
        127 => return Some((Sent::Close, bytes.len())),
        length => (usize::from(length), 2),
    };
    let control = first & 0x08 != 0;
    // Pages mask what they send; control frames are short and whole.
    let wrong =
        second & 0x80 == 0 || first & 0x70 != 0 || control && (length > 125 || first & 0x80 == 0);
    if wrong || at + 4 + length > REQUEST {
        return Some((Sent::Close, bytes.len()));
    }
    let masked = bytes.get(at + 4..at + 4 + length)?;
    let sent = match first & 0x0f {
        0 | 1 | 2 | 10 => Sent::Other,
        9 => {
            let mask = &bytes[at..at + 4];
            Sent::Ping(
                masked
                    .iter()
                    .zip(mask.iter().cycle())
                    .map(|(byte, mask)| byte ^ mask)
                    .collect(),
            )
        }
        _ => Sent::Close,
    };
    Some((sent, at + 4 + length))
}

/// Header of a frame that we send, unfragmented and unmasked.
fn header(kind: u8, length: usize, into: &mut Vec<u8>) {
    into.push(0x80 | kind);
    if length < 126 {
        into.push(length as u8);
    } else {
        into.push(126);
        into.extend_from_slice(&(length as u16).to_be_bytes());
    }
}

impl Place {
    fn new(waiting: usize) -> Self {
        Self {
            stream: None,
            stage: Stage::Request,
            since: Instant::now(),
            heard: Box::new([0; REQUEST]),
            length: 0,
            waiting: Vec::with_capacity(waiting),
            written: 0,
        }
    }

    fn seat(&mut self, stream: TcpStream) {
        (self.stream, self.stage, self.since) = (Some(stream), Stage::Request, Instant::now());
        self.leave_nothing();
    }

    fn leave_nothing(&mut self) {
        (self.length, self.written) = (0, 0);
        self.waiting.clear();
    }

    fn close(&mut self) {
        self.stream = None;
        self.leave_nothing();
    }

    fn is_waiting(&self) -> bool {
        self.written < self.waiting.len()
    }

    /// Writes queued data, as far as the socket accepts it.
    fn write(&mut self) {
        let Some(stream) = &mut self.stream else {
            return;
        };
        while self.written < self.waiting.len() {
            match stream.write(&self.waiting[self.written..]) {
                Ok(0) => return self.close(),
                Ok(more) => {
                    self.written += more;
                    self.since = Instant::now();
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return self.close(),
            }
        }
        self.waiting.clear();
        self.written = 0;
        if self.stage == Stage::Reply {
            let _ = stream.shutdown(std::net::Shutdown::Write);
            self.close();
        }
    }

    /// Reads what is available; false if the other end is gone.
    fn read(&mut self) -> bool {
        let Some(stream) = &mut self.stream else {
            return false;
        };
        match stream.read(&mut self.heard[self.length..]) {
            Ok(0) => false,
            Ok(more) => {
                self.length += more;
                true
            }
            Err(error) => matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted),
        }
    }

    /// Sends a frame if nothing is queued; whether it did.
    fn send(&mut self, kind: u8, payload: &[u8]) -> bool {
        if self.is_waiting() {
            return false;
        }
        if self.stage == Stage::Stream {
            self.waiting.extend_from_slice(b"data: ");
            self.waiting.extend_from_slice(payload);
            self.waiting.extend_from_slice(b"\n\n");
        } else {
            header(kind, payload.len(), &mut self.waiting);
            self.waiting.extend_from_slice(payload);
        }
        self.since = Instant::now();
        self.write();
        true
    }
}

/// The listening socket. Retries while the address is in use.
struct Door {
    address: SocketAddr,
    listener: Option<TcpListener>,
    again: Instant,
    pause: Duration,
}

impl Door {
    fn open(&mut self) {
        match TcpListener::bind(self.address)
            .and_then(|one| one.set_nonblocking(true).map(|()| one))
        {
            Ok(one) => self.listener = Some(one),
            Err(error) => {
                if self.pause == PAUSES[1] {
                    tracing::warn!(
                        "cannot listen at {} ({error}), retrying until it is free",
                        self.address
                    );
                }
                self.again = Instant::now() + self.pause;
                self.pause = if self.pause == PAUSES[0] {
                    PAUSES[1]
                } else {
                    2 * PAUSES[1]
                };
            }
        }
    }
}

/// Where to listen.
pub(super) fn address(listen: &str) -> Result<SocketAddr, OutputError> {
    listen.parse().map_err(|_| OutputError::Listen {
        address: listen.to_owned(),
    })
}

/// Serves until told to stop.
pub(super) fn serve<S: Service>(
    mut service: S,
    address: SocketAddr,
    shared: Arc<Shared>,
    mut bell: Bell,
) {
    let mut places: [Place; SLOTS] = std::array::from_fn(|_| Place::new(S::WAITING));
    let (mut body, mut board) = (String::with_capacity(S::WAITING), Board::default());
    let mut door = Door {
        address,
        listener: None,
        again: Instant::now(),
        pause: PAUSES[0],
    };
    loop {
        if door.listener.is_none() && Instant::now() >= door.again {
            door.open();
            let is_open = door.listener.is_some();
            shared.connected.store(is_open, Ordering::Relaxed);
        }
        let ready = wait(&bell, door.listener.as_ref(), &places);
        bell.answer();
        let stopping = shared.stop.load(Ordering::Relaxed);
        shared.take(&mut board);
        loop {
            body.clear();
            if !service.next_message(&mut board, &mut body) {
                break;
            }
            for place in pages(&mut places) {
                let sent = place.send(1, body.as_bytes());
                count(if sent { &shared.sent } else { &shared.dropped });
            }
        }
        if stopping {
            for place in pages(&mut places).filter(|place| place.stage == Stage::Page) {
                // 1001: going away.
                place.send(8, &[3, 233]);
            }
            return;
        }
        if !ready[1].is_empty()
            && let Some(listener) = &door.listener
        {
            for _ in 0..NEWCOMERS {
                let Ok((stream, _)) = listener.accept() else {
                    break;
                };
                if !admit(&mut places, stream) {
                    count(&shared.refused);
                }
            }
        }
        for (at, ready) in ready[2..].iter().enumerate() {
            let streams = pages(&mut places).filter(|place| place.stage == Stage::Stream);
            let is_full = streams.count() >= STREAMS;
            let place = &mut places[at];
            attend(
                place,
                *ready,
                is_full,
                &mut service,
                &board,
                &mut body,
                &shared,
            );
        }
    }
}

/// The connected pages.
fn pages(places: &mut [Place; SLOTS]) -> impl Iterator<Item = &mut Place> {
    places.iter_mut().filter(|place| {
        matches!(place.stage, Stage::Page | Stage::Stream) && place.stream.is_some()
    })
}

/// Waits until there is something to do, or a tick has passed: which of the wake-up socket, the listener and the connections are
/// ready.
fn wait(
    bell: &Bell,
    listener: Option<&TcpListener>,
    places: &[Place; SLOTS],
) -> [PollFlags; SLOTS + 2] {
    let mut asked: [PollFd; SLOTS + 2] = std::array::from_fn(|i| {
        let reading = PollFlags::POLLIN;
        let (fd, flags) = match i.checked_sub(2) {
            None if i == 0 => (bell.fd(), reading),
            None => (listener.map_or(-1, |one| one.as_raw_fd()), reading),
            Some(at) => {
                let place = &places[at];
                let flags = if place.is_waiting() {
                    reading | PollFlags::POLLOUT
                } else {
                    reading
                };
                (
                    place.stream.as_ref().map_or(-1, |one| one.as_raw_fd()),
                    flags,
                )
            }
        };
        // Descriptors below 0 are passed over.
        PollFd::new(fd, flags)
    });
    // Interrupted or not: what there is to do is looked at.
    let _ = poll(&mut asked, TICK_MS);
    asked.map(|one| one.revents().unwrap_or(PollFlags::empty()))
}

/// Reads from a connection if ready, answers, writes queued data, and closes it after a timeout.
fn attend<S: Service>(
    place: &mut Place,
    ready: PollFlags,
    is_full: bool,
    service: &mut S,
    board: &Board,
    body: &mut String,
    shared: &Shared,
) {
    if place.stream.is_none() {
        return;
    }
    if !ready.is_empty() && !place.read() {
        place.close();
        return;
    }
    hear(place, is_full, service, board, body, shared);
    place.write();
    let patience = match place.stage {
        Stage::Request => PATIENCE,
        Stage::Reply => STUCK,
        Stage::Page | Stage::Stream if place.is_waiting() => STUCK,
        Stage::Page | Stage::Stream => Duration::MAX,
    };
    if place.stream.is_some() && place.since.elapsed() > patience {
        count(&shared.refused);
        place.close();
    }
}

/// Gives a new connection a slot: a free one, or that of the one silent for longest. False if one is turned away.
fn admit(places: &mut [Place; SLOTS], stream: TcpStream) -> bool {
    if stream.set_nonblocking(true).is_err() {
        return false;
    }
    let _ = stream.set_nodelay(true);
    if let Some(place) = places.iter_mut().find(|place| place.stream.is_none()) {
        place.seat(stream);
        return true;
    }
    let asking = places
        .iter_mut()
        .filter(|place| place.stage == Stage::Request);
    let silent = asking.max_by_key(|place| place.since.elapsed());
    if let Some(place) = silent.filter(|place| place.since.elapsed() > GRACE) {
        place.seat(stream);
    }
    false
}

/// Looks at the frames of a page.
fn hear_page(place: &mut Place) {
    while place.stage == Stage::Page && place.length > 0 {
        let Some((sent, used)) = frame(&place.heard[..place.length]) else {
            return;
        };
        place.heard.copy_within(used..place.length, 0);
        place.length -= used;
        match sent {
            Sent::Other => {}
            // One that waits is answered by the next message.
            Sent::Ping(payload) => {
                place.send(10, &payload);
            }
            Sent::Close => {
                place.send(8, &[]);
                return place.close();
            }
        }
    }
}

/// Looks at what was read.
fn hear<S: Service>(
    place: &mut Place,
    is_full: bool,
    service: &mut S,
    board: &Board,
    body: &mut String,
    shared: &Shared,
) {
    if place.stage == Stage::Page {
        return hear_page(place);
    }
    if place.stage != Stage::Request {
        // Who has asked already is not listened to.
        place.length = 0;
        return;
    }
    let full = place.length == REQUEST;
    let heard = &place.heard[..place.length];
    let asked = match request(heard) {
        Some(asked) => asked,
        None if full => Asked::Refused(431),
        None => return,
    };
    body.clear();
    let mut path = "";
    let asked = match allowed(service, place.stream.as_ref(), heard, &asked) {
        Ok(()) => asked,
        Err(status) => Asked::Refused(status),
    };
    let status = match asked {
        Asked::Page(key) if S::STAYS => {
            let head = b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: ";
            place.waiting.extend_from_slice(head);
            place.waiting.extend_from_slice(&handshake::answer(key));
            place.waiting.extend_from_slice(b"\r\n\r\n");
            (place.stage, place.length) = (Stage::Page, 0);
            place.since = Instant::now();
            return;
        }
        Asked::Page(_) => 426,
        Asked::Document(stream, _) if S::STREAM == Some(stream) && is_full => 503,
        Asked::Document(stream, _) if S::STREAM == Some(stream) => {
            place.waiting.extend_from_slice(b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n");
            (place.stage, place.length) = (Stage::Stream, 0);
            place.since = Instant::now();
            return;
        }
        Asked::Document(wanted, query) => {
            path = wanted;
            service.answer(wanted, query, board, body)
        }
        Asked::Order(what) => match service.order(what) {
            Order::Never => 405,
            Order::Unknown => 404,
            Order::Ask(command) if shared.ask(command) => 204,
            Order::Ask(_) => 503,
        },
        Asked::Refused(status) => status,
    };
    if status < 300 {
        count(&shared.sent);
    } else {
        count(&shared.refused);
    }
    head(
        &mut place.waiting,
        status,
        service.headers(path, status),
        body.len(),
    );
    place.waiting.extend_from_slice(body.as_bytes());
    (place.stage, place.length) = (Stage::Reply, 0);
    place.since = Instant::now();
}

/// What a browser or a program sends, for `tests/fuzz`: a request, and the frames of a WebSocket.
#[cfg(fuzzing)]
pub fn fuzz(bytes: &[u8]) {
    request(bytes);
    let mut rest = &bytes[..bytes.len().min(REQUEST)];
    while let Some((_, used)) = frame(rest).filter(|_| !rest.is_empty()) {
        rest = &rest[used..];
    }
}

/// Writes the head of a reply.
fn head(waiting: &mut Vec<u8>, status: u16, headers: &str, length: usize) {
    let reason = match status {
        200 => "OK",
        204 => "No Content",
        400 => "Bad Request",
        401 => "Unauthorized",
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        421 => "Misdirected Request",
        426 => "Upgrade Required",
        503 => "Service Unavailable",
        _ => "Refused",
    };
    let _ = write!(
        waiting,
        "HTTP/1.1 {status} {reason}\r\n{headers}Content-Length: {length}\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n"
    );
}

/// Whether what is asked for may be had.
fn allowed<S: Service>(
    service: &S,
    stream: Option<&TcpStream>,
    heard: &[u8],
    asked: &Asked<'_>,
) -> Result<(), u16> {
    let order = match asked {
        Asked::Refused(status) => return Err(*status),
        asked => matches!(asked, Asked::Order(_)),
    };
    let end = heard.windows(4).position(|four| four == b"\r\n\r\n");
    let head = std::str::from_utf8(&heard[..end.unwrap_or_default()]).map_err(|_| 400_u16)?;
    // One who is gone already has no address.
    let peer = stream.and_then(|stream| stream.peer_addr().ok());
    service.admits(head, order, peer.ok_or(400_u16)?.ip())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_read_and_nonsense_is_refused() {
        let ask = |text: &str| format!("{text}\r\n\r\n");
        for (text, expected) in [
            (
                "GET /a/b?VALUE HTTP/1.1\r\nHost: x",
                Asked::Document("/a/b", Some("VALUE")),
            ),
            ("GET / HTTP/1.0", Asked::Document("/", None)),
            (
                "GET / HTTP/1.1\r\nupgrade: WebSocket\r\nSEC-WEBSOCKET-KEY: dGhlIHNhbXBsZSBub25jZQ==",
                Asked::Page(b"dGhlIHNhbXBsZSBub25jZQ=="),
            ),
            (
                "GET / HTTP/1.1\r\nUpgrade: websocket\r\nSec-WebSocket-Key: short",
                Asked::Refused(400),
            ),
            ("POST /a HTTP/1.1", Asked::Order("/a")),
            ("PUT / HTTP/1.1", Asked::Refused(405)),
            ("GET a HTTP/1.1", Asked::Refused(400)),
            ("GET /", Asked::Refused(400)),
            ("GET / HTTP/2", Asked::Refused(400)),
            ("", Asked::Refused(400)),
        ] {
            assert_eq!(request(ask(text).as_bytes()), Some(expected), "{text}");
        }
        assert_eq!(request(b"GET / HTTP/1.1\r\n"), None);
        assert_eq!(request(b"\xff\r\n\r\n"), Some(Asked::Refused(400)));
    }

    #[test]
    fn frames_of_pages_are_read_and_others_close() {
        let ping = [0x89, 0x83, 1, 2, 3, 4, b'a' ^ 1, b'b' ^ 2, b'c' ^ 3];
        let (sent, used) = frame(&ping).unwrap();
        assert_eq!(
            (sent, used),
            (Sent::Ping(heapless::Vec::from_slice(b"abc").unwrap()), 9)
        );
        for cut in 0..ping.len() {
            assert_eq!(frame(&ping[..cut]), None);
        }
        assert_eq!(frame(&[0x81, 0x80, 0, 0, 0, 0]), Some((Sent::Other, 6)));
        for bad in [
            &[0x81, 0x00][..],
            &[0x88, 0x80, 0, 0, 0, 0],
            &[0x81, 0xff],
            &[0x81, 0xfe, 0xff, 0xff],
            &[0xc1, 0x80],
            &[0x09, 0x80],
        ] {
            assert_eq!(
                frame(bad).map(|(sent, _)| sent),
                Some(Sent::Close),
                "{bad:?}"
            );
        }
        let mut random = fastrand::Rng::with_seed(5);
        for _ in 0..100_000 {
            let bytes: Vec<u8> = (0..random.usize(..40)).map(|_| random.u8(..)).collect();
            if let Some((_, used)) = frame(&bytes) {
                assert!(used > 0 && used <= bytes.len());
            }
            request(&bytes);
        }
    }
}
