//! A small server: requests ([`super::http`]), each answered and closed, or upgraded to a WebSocket or an event stream.
//!
//! There are [`SLOTS`] connections. When all are in use, one that has sent no request within a quarter of a second is dropped;
//! otherwise the new one is rejected. Either case is counted. A request must be complete within [`PATIENCE`], at most [`REQUEST`]
//! bytes long; a client that reads nothing for [`STUCK`] is disconnected. A page that reads slower than frames arrive skips to
//! the newest. Memory: read and write buffers per connection, allocated at start-up.

use std::io::{ErrorKind, Read, Write as _};
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::os::fd::AsRawFd;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, poll};

use super::http::{REQUEST, Request, Sent, frame, header};
use crate::base::capacity::WEB_CONNECTIONS as SLOTS;
use crate::output::Command;
use crate::output::board::{Bell, Board, Shared, count, write_queued};
use crate::output::limits::Listening;

/// Event streams at once: the places left answer requests.
const STREAMS: usize = SLOTS - 2;
/// Of them, those of one peer.
const STREAMS_OF_PEER: usize = STREAMS - 2;
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

/// Starts of replies.
const SWITCHING: &[u8] = b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: ";
const STREAMING: &[u8] = b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n";
/// Headers of documents, unless they have their own.
pub(super) const PLAIN: &str = "Content-Type: application/json\r\nX-Content-Type-Options: nosniff\r\nCross-Origin-Resource-Policy: same-origin\r\n";
const LOGIN: &str = "WWW-Authenticate: Basic realm=\"mien\", charset=\"UTF-8\"\r\n";

/// What is served.
pub(super) trait Service {
    /// Bytes that may be queued for a connection.
    const WAITING: usize;

    /// Answers a request from `peer`; a document goes to `body`.
    ///
    /// # Errors
    /// The status that refuses it.
    fn answer(&self, request: &Request, peer: IpAddr, body: &mut String) -> Result<Answer, u16>;

    /// Writes the next message for all pages into `message`; false if there is none.
    fn next_message(&mut self, board: &mut Board, message: &mut String) -> bool;
}

/// What a request gets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answer {
    /// The body, with these headers about it.
    Document(&'static str),
    /// A command was given to the pipeline.
    Order(Command),
    /// Messages over a WebSocket, accepted so.
    WebSocket([u8; 28]),
    /// Messages as an event stream.
    Stream,
}

/// What a connection is about.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    Request,
    Reply,
    /// A WebSocket.
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
        }
    }

    /// Given to whoever comes, or to nobody.
    fn seat(&mut self, stream: Option<TcpStream>) {
        (self.stream, self.stage, self.since) = (stream, Stage::Request, Instant::now());
        self.length = 0;
        self.waiting.clear();
    }

    /// Writes queued data, as far as the socket accepts it.
    fn write(&mut self) {
        let Some(stream) = &mut self.stream else {
            return;
        };
        match write_queued(stream, &mut self.waiting) {
            Ok(0) => {}
            Ok(_) => self.since = Instant::now(),
            Err(_) => return self.seat(None),
        }
        if self.stage == Stage::Reply && self.waiting.is_empty() {
            let _ = stream.shutdown(std::net::Shutdown::Write);
            self.seat(None);
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

    /// Queues the parts of a reply, and what the connection is about from now on.
    fn reply(&mut self, stage: Stage, parts: &[&[u8]]) {
        for part in parts {
            self.waiting.extend_from_slice(part);
        }
        (self.stage, self.length, self.since) = (stage, 0, Instant::now());
    }

    /// Sends a frame if nothing is queued; whether it did.
    fn send(&mut self, kind: u8, payload: &[u8]) -> bool {
        if !self.waiting.is_empty() {
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

    /// Looks at the frames of a page.
    fn hear_page(&mut self) {
        while self.stage == Stage::Page && self.length > 0 {
            let Some((sent, used)) = frame(&self.heard[..self.length]) else {
                return;
            };
            self.heard.copy_within(used..self.length, 0);
            self.length -= used;
            match sent {
                Sent::Other => {}
                // One that waits is answered by the next message.
                Sent::Ping(payload) => {
                    self.send(10, &payload);
                }
                Sent::Close => {
                    self.send(8, &[]);
                    return self.seat(None);
                }
            }
        }
    }

    /// Whether whoever is at the other end has taken too long.
    fn is_late(&self) -> bool {
        let patience = match self.stage {
            Stage::Request => PATIENCE,
            Stage::Reply => STUCK,
            Stage::Page | Stage::Stream if !self.waiting.is_empty() => STUCK,
            Stage::Page | Stage::Stream => return false,
        };
        self.stream.is_some() && self.since.elapsed() > patience
    }
}

/// The service, its connections and its listening socket.
struct Server<S> {
    service: S,
    shared: Arc<Shared>,
    places: [Place; SLOTS],
    body: String,
    at: Listening<TcpListener>,
}

/// Serves until told to stop.
pub(super) fn serve<S: Service>(
    service: S,
    at: Listening<TcpListener>,
    shared: Arc<Shared>,
    mut bell: Bell,
) {
    let mut board = Board::default();
    let mut server = Server {
        service,
        shared,
        places: std::array::from_fn(|_| Place::new(S::WAITING)),
        body: String::with_capacity(S::WAITING),
        at,
    };
    loop {
        server.at.open("", bind);
        let is_open = server.at.socket.is_some();
        server.shared.connected.store(is_open, Ordering::Relaxed);
        let ready = server.wait(&bell);
        bell.answer();
        let stopping = server.shared.stop.load(Ordering::Relaxed);
        server.shared.take(&mut board);
        server.tell(&mut board);
        if stopping {
            for place in pages(&mut server.places).filter(|place| place.stage == Stage::Page) {
                // 1001: going away.
                place.send(8, &[3, 233]);
            }
            return;
        }
        if !ready[1].is_empty() {
            server.accept();
        }
        for (at, ready) in ready[2..].iter().enumerate() {
            server.attend(at, *ready);
        }
    }
}

fn bind(address: SocketAddr) -> std::io::Result<TcpListener> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// The connected pages.
fn pages(places: &mut [Place; SLOTS]) -> impl Iterator<Item = &mut Place> {
    places.iter_mut().filter(|place| {
        matches!(place.stage, Stage::Page | Stage::Stream) && place.stream.is_some()
    })
}

impl<S: Service> Server<S> {
    /// Waits until there is something to do, or a tick has passed: which of the wake-up socket, the listener and the
    /// connections are ready.
    fn wait(&self, bell: &Bell) -> [PollFlags; SLOTS + 2] {
        let mut asked: [PollFd; SLOTS + 2] = std::array::from_fn(|i| {
            let mut flags = PollFlags::POLLIN;
            // Descriptors below 0 are passed over.
            let fd = match i {
                0 => bell.fd(),
                1 => self.at.socket.as_ref().map_or(-1, |one| one.as_raw_fd()),
                _ => {
                    let place = &self.places[i - 2];
                    flags.set(PollFlags::POLLOUT, !place.waiting.is_empty());
                    place.stream.as_ref().map_or(-1, |one| one.as_raw_fd())
                }
            };
            PollFd::new(fd, flags)
        });
        // Interrupted or not: what there is to do is looked at.
        let _ = poll(&mut asked, TICK_MS);
        asked.map(|one| one.revents().unwrap_or(PollFlags::empty()))
    }

    /// Sends new messages to all pages.
    fn tell(&mut self, board: &mut Board) {
        loop {
            self.body.clear();
            if !self.service.next_message(board, &mut self.body) {
                return;
            }
            let shared = &self.shared;
            for place in pages(&mut self.places) {
                let sent = place.send(1, self.body.as_bytes());
                count(if sent { &shared.sent } else { &shared.dropped });
            }
        }
    }

    /// Gives new connections a slot: a free one, or that of the one silent for longest. Counts those turned away.
    fn accept(&mut self) {
        for _ in 0..NEWCOMERS {
            let Some(Ok((stream, _))) = self.at.socket.as_ref().map(TcpListener::accept) else {
                return;
            };
            let _ = stream.set_nodelay(true);
            if stream.set_nonblocking(true).is_ok()
                && let Some(free) = self.places.iter_mut().find(|place| place.stream.is_none())
            {
                free.seat(Some(stream));
                continue;
            }
            count(&self.shared.refused);
            let asking = self
                .places
                .iter_mut()
                .filter(|place| place.stage == Stage::Request);
            let silent = asking.max_by_key(|place| place.since.elapsed());
            if let Some(place) = silent.filter(|place| place.since.elapsed() > GRACE) {
                place.seat(Some(stream));
            }
        }
    }

    /// Reads from a connection if ready, answers, writes queued data, and closes it after a timeout.
    fn attend(&mut self, at: usize, ready: PollFlags) {
        let place = &mut self.places[at];
        if place.stream.is_none() {
            return;
        }
        if !ready.is_empty() && !place.read() {
            return place.seat(None);
        }
        match place.stage {
            Stage::Request => self.hear(at),
            Stage::Page => place.hear_page(),
            // Who has asked already is not listened to.
            Stage::Reply | Stage::Stream => place.length = 0,
        }
        let place = &mut self.places[at];
        place.write();
        if place.is_late() {
            count(&self.shared.refused);
            place.seat(None);
        }
    }

    /// Answers a request once it is complete.
    fn hear(&mut self, at: usize) {
        let streams = pages(&mut self.places).filter(|place| place.stage == Stage::Stream);
        let of = |place: &Place| {
            place
                .stream
                .as_ref()
                .and_then(|stream| stream.peer_addr().ok())
        };
        let hosts: heapless::Vec<_, SLOTS> =
            streams.map(|place| of(place).map(|at| at.ip())).collect();
        let place = &mut self.places[at];
        self.body.clear();
        // One who is gone already has no address.
        let peer = place.stream.as_ref().map(TcpStream::peer_addr);
        let host = of(place).map(|at| at.ip());
        let theirs = hosts.iter().filter(|other| **other == host);
        let is_full = hosts.len() >= STREAMS || theirs.count() >= STREAMS_OF_PEER;
        let answer = match (Request::read(&place.heard[..place.length]), peer) {
            (Ok(None), _) => return,
            (Ok(Some(request)), Some(Ok(peer))) => {
                self.service.answer(&request, peer.ip(), &mut self.body)
            }
            (Ok(Some(_)), _) => Err(400),
            (Err(status), _) => Err(status),
        };
        let (status, headers) = match answer {
            Ok(Answer::WebSocket(accepted)) => {
                return place.reply(Stage::Page, &[SWITCHING, &accepted, b"\r\n\r\n"]);
            }
            Ok(Answer::Stream) if !is_full => return place.reply(Stage::Stream, &[STREAMING]),
            Ok(Answer::Document(headers)) => (200, headers),
            Ok(Answer::Order(command)) if self.shared.ask(command) => (204, PLAIN),
            Ok(Answer::Stream | Answer::Order(_)) => (503, PLAIN),
            Err(status @ 401) => (status, LOGIN),
            Err(status) => (status, PLAIN),
        };
        count(if status < 300 {
            &self.shared.sent
        } else {
            &self.shared.refused
        });
        head(&mut place.waiting, status, headers, self.body.len());
        place.reply(Stage::Reply, &[self.body.as_bytes()]);
    }
}

/// Writes the head of a reply. The reason behind the status may be empty (RFC 9112, 4).
fn head(waiting: &mut Vec<u8>, status: u16, headers: &str, length: usize) {
    let _ = write!(
        waiting,
        "HTTP/1.1 {status} \r\n{headers}Content-Length: {length}\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n"
    );
}
