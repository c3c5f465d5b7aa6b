//! A small server: requests ([`super::http`]), each answered and closed, or upgraded to a WebSocket or an event stream.
//!
//! There are [`SLOTS`] connections. When all are in use, one that has sent no request within a quarter of a second is dropped;
//! otherwise the new one is rejected. Either case is counted. A request must be complete within [`PATIENCE`], at most [`REQUEST`]
//! bytes long; a client that reads nothing for [`STUCK`] is disconnected. A page that reads slower than frames arrive skips to
//! the newest. Memory: read and write buffers per connection, allocated at start-up.

use std::io::{ErrorKind, Read, Write as _};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::os::fd::AsRawFd;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, poll};

use super::http::{REQUEST, Request, Sent, read_frame, write_frame_header};
use crate::Command;
use crate::board::{Bell, Board, Shared, count, write_queued};
use crate::limits::Listening;
use mien_stages::base::capacity::WEB_CONNECTIONS as SLOTS;

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

struct Connection {
    stream: Option<TcpStream>,
    peer: IpAddr,
    stage: Stage,
    /// When the request began, or data was last written.
    since: Instant,
    heard: Box<[u8; REQUEST]>,
    length: usize,
    waiting: Vec<u8>,
}

impl Connection {
    fn new(waiting: usize) -> Self {
        Self {
            stream: None,
            peer: IpAddr::V4(Ipv4Addr::UNSPECIFIED),
            stage: Stage::Request,
            since: Instant::now(),
            heard: Box::new([0; REQUEST]),
            length: 0,
            waiting: Vec::with_capacity(waiting),
        }
    }

    /// Starts a connection in this slot.
    fn open(&mut self, stream: TcpStream, peer: IpAddr) {
        self.close();
        (self.stream, self.peer, self.since) = (Some(stream), peer, Instant::now());
    }

    /// Ends the connection; the slot is free.
    fn close(&mut self) {
        (self.stream, self.stage, self.length) = (None, Stage::Request, 0);
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
            Err(_) => return self.close(),
        }
        if self.stage == Stage::Reply && self.waiting.is_empty() {
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
            write_frame_header(kind, payload.len(), &mut self.waiting);
            self.waiting.extend_from_slice(payload);
        }
        self.since = Instant::now();
        self.write();
        true
    }

    /// Answers the frames that a page has sent.
    fn read_frames(&mut self) {
        while self.stage == Stage::Page && self.length > 0 {
            let Some((sent, used)) = read_frame(&self.heard[..self.length]) else {
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
                    return self.close();
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
    connections: [Connection; SLOTS],
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
        connections: std::array::from_fn(|_| Connection::new(S::WAITING)),
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
        server.send_messages(&mut board);
        if stopping {
            for connection in subscribers(&mut server.connections)
                .filter(|connection| connection.stage == Stage::Page)
            {
                // 1001: going away.
                connection.send(8, &[3, 233]);
            }
            return;
        }
        if !ready[1].is_empty() {
            server.accept();
        }
        for (at, ready) in ready[2..].iter().enumerate() {
            server.serve_connection(at, *ready);
        }
    }
}

fn bind(address: SocketAddr) -> std::io::Result<TcpListener> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// The connections that messages are sent to.
fn subscribers(connections: &mut [Connection; SLOTS]) -> impl Iterator<Item = &mut Connection> {
    connections.iter_mut().filter(|connection| {
        matches!(connection.stage, Stage::Page | Stage::Stream) && connection.stream.is_some()
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
                    let connection = &self.connections[i - 2];
                    flags.set(PollFlags::POLLOUT, !connection.waiting.is_empty());
                    connection.stream.as_ref().map_or(-1, |one| one.as_raw_fd())
                }
            };
            PollFd::new(fd, flags)
        });
        // Interrupted or not: what there is to do is looked at.
        let _ = poll(&mut asked, TICK_MS);
        asked.map(|one| one.revents().unwrap_or(PollFlags::empty()))
    }

    /// Sends new messages to all pages.
    fn send_messages(&mut self, board: &mut Board) {
        loop {
            self.body.clear();
            if !self.service.next_message(board, &mut self.body) {
                return;
            }
            let shared = &self.shared;
            for connection in subscribers(&mut self.connections) {
                let sent = connection.send(1, self.body.as_bytes());
                count(if sent { &shared.sent } else { &shared.dropped });
            }
        }
    }

    /// Gives new connections a slot: a free one, or that of the one silent for longest. Counts those turned away.
    fn accept(&mut self) {
        for _ in 0..NEWCOMERS {
            let Some(Ok((stream, peer))) = self.at.socket.as_ref().map(TcpListener::accept) else {
                return;
            };
            let _ = stream.set_nodelay(true);
            let mut slots = self.connections.iter_mut();
            if stream.set_nonblocking(true).is_ok()
                && let Some(free) = slots.find(|slot| slot.stream.is_none())
            {
                free.open(stream, peer.ip());
                continue;
            }
            count(&self.shared.refused);
            let slots = self.connections.iter_mut();
            let asking = slots.filter(|slot| slot.stage == Stage::Request);
            let silent = asking.max_by_key(|slot| slot.since.elapsed());
            if let Some(slot) = silent.filter(|slot| slot.since.elapsed() > GRACE) {
                slot.open(stream, peer.ip());
            }
        }
    }

    /// Reads from a connection if ready, answers, writes queued data, and closes it after a timeout.
    fn serve_connection(&mut self, at: usize, ready: PollFlags) {
        let connection = &mut self.connections[at];
        if connection.stream.is_none() {
            return;
        }
        if !ready.is_empty() && !connection.read() {
            return connection.close();
        }
        match connection.stage {
            Stage::Request => self.answer_request(at),
            Stage::Page => connection.read_frames(),
            // Who has asked already is not listened to.
            Stage::Reply | Stage::Stream => connection.length = 0,
        }
        let connection = &mut self.connections[at];
        connection.write();
        if connection.is_late() {
            count(&self.shared.refused);
            connection.close();
        }
    }

    /// Answers a request once it is complete.
    fn answer_request(&mut self, at: usize) {
        let peer = self.connections[at].peer;
        let streams = subscribers(&mut self.connections);
        let streams = streams.filter(|other| other.stage == Stage::Stream);
        let peers: heapless::Vec<IpAddr, SLOTS> = streams.map(|other| other.peer).collect();
        let theirs = peers.iter().filter(|other| **other == peer);
        let is_full = peers.len() >= STREAMS || theirs.count() >= STREAMS_OF_PEER;
        let connection = &mut self.connections[at];
        self.body.clear();
        let answer = match Request::read(&connection.heard[..connection.length]) {
            Ok(None) => return,
            Ok(Some(request)) => self.service.answer(&request, peer, &mut self.body),
            Err(status) => Err(status),
        };
        let (status, headers) = match answer {
            Ok(Answer::WebSocket(accepted)) => {
                return connection.reply(Stage::Page, &[SWITCHING, &accepted, b"\r\n\r\n"]);
            }
            Ok(Answer::Stream) if !is_full => return connection.reply(Stage::Stream, &[STREAMING]),
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
        head(&mut connection.waiting, status, headers, self.body.len());
        connection.reply(Stage::Reply, &[self.body.as_bytes()]);
    }
}

/// Writes the head of a reply. The reason behind the status may be empty (RFC 9112, 4).
fn head(waiting: &mut Vec<u8>, status: u16, headers: &str, length: usize) {
    let _ = write!(
        waiting,
        "HTTP/1.1 {status} \r\n{headers}Content-Length: {length}\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n"
    );
}
