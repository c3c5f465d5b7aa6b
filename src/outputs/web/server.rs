//! A small HTTP server: each request ([`super::http`]) is answered and closed, or becomes a WebSocket or an event stream.
//!
//! There are [`SLOTS`] connections. If all are in use, a new one replaces one that has sent no complete request within [`GRACE`],
//! or else is rejected; both cases are counted. A request must be complete within [`REQUEST_TIMEOUT`] and at most [`REQUEST`] bytes
//! long; a client that reads nothing for [`UNREAD_TIMEOUT`] is disconnected. A client slower than the frames skips to the newest.
//! Memory: read and write buffers per connection, allocated at start-up.

use std::io::{ErrorKind, Read};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsRawFd, RawFd};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nix::poll::{PollFd, PollFlags, poll};

use super::frames::{REQUEST, Sent, read_frame, write_frame_header};
use super::http::{Request, write_head};
use crate::Command;
use crate::limits::Listening;
use crate::mailbox::{Mailbox, Shared, Waker, count, write_queued};
use mien_stages::base::capacity::WEB_CONNECTIONS as SLOTS;

/// Most event streams; the other connections remain for requests.
const STREAMS: usize = SLOTS - 2;
/// Most event streams of one peer.
const STREAMS_OF_PEER: usize = STREAMS - 2;
/// Time limit for a complete request.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(2);
/// Age from which a connection without a request may be replaced.
const GRACE: Duration = Duration::from_millis(250);
/// Time limit for a client that does not read.
const UNREAD_TIMEOUT: Duration = Duration::from_secs(10);
/// Most connections accepted in one pass.
const ACCEPTS: usize = 32;
/// Longest wait in `poll`, so that timeouts are noticed.
const TICK_MS: i32 = 250;

/// Start of the reply that opens a WebSocket; the key's answer follows.
const SWITCHING: &[u8] = b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: ";
/// Reply that opens an event stream.
const STREAMING: &[u8] = b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nConnection: close\r\n\r\n";
/// Headers of JSON documents and of replies without a body.
pub(super) const PLAIN: &str = "Content-Type: application/json\r\nX-Content-Type-Options: nosniff\r\nCross-Origin-Resource-Policy: same-origin\r\n";
/// Header that requests the password.
const LOGIN: &str = "WWW-Authenticate: Basic realm=\"mien\", charset=\"UTF-8\"\r\n";

/// Content of a server.
pub(super) trait Service {
    /// Bytes that may be queued for a connection.
    const BUFFER: usize;

    /// Answers a request from `peer`; a document is appended to `body`.
    ///
    /// # Errors
    /// The HTTP status with which to refuse it.
    fn answer(&self, request: &Request, peer: IpAddr, body: &mut String) -> Result<Answer, u16>;

    /// Appends the next message for all clients to `message`; `false` if there is none.
    fn next_message(&mut self, mailbox: &mut Mailbox, message: &mut String) -> bool;
}

/// Answer to a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Answer {
    /// A document in the body, with these headers.
    Document(&'static str),
    /// A command for the pipeline.
    Command(Command),
    /// Messages over a WebSocket; the answer to its key.
    WebSocket([u8; 28]),
    /// Messages as an event stream.
    Stream,
}

/// State of a connection.
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
    /// When the connection was opened, or data was last written.
    since: Instant,
    received: Box<[u8; REQUEST]>,
    length: usize,
    unsent: Vec<u8>,
}

impl Connection {
    fn new(unsent: usize) -> Self {
        Self {
            stream: None,
            peer: IpAddr::V4(Ipv4Addr::UNSPECIFIED),
            stage: Stage::Request,
            since: Instant::now(),
            received: Box::new([0; REQUEST]),
            length: 0,
            unsent: Vec::with_capacity(unsent),
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
        self.unsent.clear();
    }

    /// Writes queued data, as far as the socket accepts it.
    fn write(&mut self) {
        let Some(stream) = &mut self.stream else {
            return;
        };
        match write_queued(stream, &mut self.unsent) {
            Ok(0) => {}
            Ok(_) => self.since = Instant::now(),
            Err(_) => return self.close(),
        }
        if self.stage == Stage::Reply && self.unsent.is_empty() {
            let _ = stream.shutdown(std::net::Shutdown::Write);
            self.close();
        }
    }

    /// Reads available data; `false` if the connection is closed or failed.
    fn read(&mut self) -> bool {
        let Some(stream) = &mut self.stream else {
            return false;
        };
        match stream.read(&mut self.received[self.length..]) {
            Ok(0) => false,
            Ok(more) => {
                self.length += more;
                true
            }
            Err(error) => matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted),
        }
    }

    /// Queues the parts of a reply and enters `stage`.
    fn reply(&mut self, stage: Stage, parts: &[&[u8]]) {
        for part in parts {
            self.unsent.extend_from_slice(part);
        }
        (self.stage, self.length, self.since) = (stage, 0, Instant::now());
    }

    /// Sends a message if nothing is queued; returns whether it did. `kind`: opcode of a WebSocket frame.
    fn send(&mut self, kind: u8, payload: &[u8]) -> bool {
        if !self.unsent.is_empty() {
            return false;
        }
        if self.stage == Stage::Stream {
            self.unsent.extend_from_slice(b"data: ");
            self.unsent.extend_from_slice(payload);
            self.unsent.extend_from_slice(b"\n\n");
        } else {
            write_frame_header(kind, payload.len(), &mut self.unsent);
            self.unsent.extend_from_slice(payload);
        }
        self.since = Instant::now();
        self.write();
        true
    }

    /// Answers the WebSocket frames of a page.
    fn read_frames(&mut self) {
        while self.stage == Stage::Page && self.length > 0 {
            let Some((sent, used)) = read_frame(&self.received[..self.length]) else {
                return;
            };
            self.received.copy_within(used..self.length, 0);
            self.length -= used;
            match sent {
                Sent::Other => {}
                // Not answered while data is queued: the next message shows that the connection lives.
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

    /// Whether the client has exceeded the time limit of its stage.
    fn has_timed_out(&self) -> bool {
        let limit = match self.stage {
            Stage::Request => REQUEST_TIMEOUT,
            Stage::Reply => UNREAD_TIMEOUT,
            Stage::Page | Stage::Stream if !self.unsent.is_empty() => UNREAD_TIMEOUT,
            Stage::Page | Stage::Stream => return false,
        };
        self.stream.is_some() && self.since.elapsed() > limit
    }
}

/// The service, its connections and its listening socket.
struct Server<S> {
    service: S,
    shared: Arc<Shared>,
    connections: [Connection; SLOTS],
    body: String,
    listener: Listening<TcpListener>,
}

/// Serves until asked to stop.
pub(super) fn serve<S: Service>(
    service: S,
    listener: Listening<TcpListener>,
    shared: Arc<Shared>,
    mut waker: Waker,
) {
    let mut mailbox = Mailbox::default();
    let mut server = Server {
        service,
        shared,
        connections: std::array::from_fn(|_| Connection::new(S::BUFFER)),
        body: String::with_capacity(S::BUFFER),
        listener,
    };
    loop {
        server.listener.open("", bind);
        let is_open = server.listener.socket.is_some();
        server.shared.connected.store(is_open, Ordering::Relaxed);
        let ready = server.wait(&waker);
        waker.clear();
        let stopping = server.shared.stop.load(Ordering::Relaxed);
        server.shared.fetch(&mut mailbox);
        server.send_messages(&mut mailbox);
        if stopping {
            let open = subscribers(&mut server.connections);
            for connection in open.filter(|connection| connection.stage == Stage::Page) {
                // 1001: going away.
                connection.send(8, &[3, 233]);
            }
            return;
        }
        if !ready[1].is_empty() {
            server.accept();
        }
        for (index, ready) in ready[2..].iter().enumerate() {
            server.serve_connection(index, *ready);
        }
    }
}

fn bind(address: SocketAddr) -> std::io::Result<TcpListener> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// The descriptor to poll; `poll` ignores a negative one.
fn fd(socket: Option<&impl AsRawFd>) -> RawFd {
    socket.map_or(-1, AsRawFd::as_raw_fd)
}

/// The connections that receive messages.
fn subscribers(connections: &mut [Connection; SLOTS]) -> impl Iterator<Item = &mut Connection> {
    connections.iter_mut().filter(|connection| {
        matches!(connection.stage, Stage::Page | Stage::Stream) && connection.stream.is_some()
    })
}

impl<S: Service> Server<S> {
    /// Waits for events for at most a tick; returns those of the wake-up socket, the listener and the connections.
    fn wait(&self, waker: &Waker) -> [PollFlags; SLOTS + 2] {
        let mut polled: [PollFd; SLOTS + 2] = std::array::from_fn(|i| {
            let mut flags = PollFlags::POLLIN;
            let fd = match i {
                0 => waker.fd(),
                1 => fd(self.listener.socket.as_ref()),
                _ => {
                    let connection = &self.connections[i - 2];
                    flags.set(PollFlags::POLLOUT, !connection.unsent.is_empty());
                    fd(connection.stream.as_ref())
                }
            };
            PollFd::new(fd, flags)
        });
        // An interruption needs no handling: all events are checked anyway.
        let _ = poll(&mut polled, TICK_MS);
        polled.map(|one| one.revents().unwrap_or(PollFlags::empty()))
    }

    /// Sends new messages to all subscribers.
    fn send_messages(&mut self, mailbox: &mut Mailbox) {
        loop {
            self.body.clear();
            if !self.service.next_message(mailbox, &mut self.body) {
                return;
            }
            let shared = &self.shared;
            for connection in subscribers(&mut self.connections) {
                let sent = connection.send(1, self.body.as_bytes());
                count(if sent { &shared.sent } else { &shared.dropped });
            }
        }
    }

    /// Gives new connections a free slot, or that of the oldest connection without a request; counts replaced and rejected ones.
    fn accept(&mut self) {
        for _ in 0..ACCEPTS {
            let Some(Ok((stream, peer))) = self.listener.socket.as_ref().map(TcpListener::accept)
            else {
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
    fn serve_connection(&mut self, index: usize, ready: PollFlags) {
        let connection = &mut self.connections[index];
        if connection.stream.is_none() {
            return;
        }
        if !ready.is_empty() && !connection.read() {
            return connection.close();
        }
        match connection.stage {
            Stage::Request => self.answer_request(index),
            Stage::Page => connection.read_frames(),
            // Further input is discarded.
            Stage::Reply | Stage::Stream => connection.length = 0,
        }
        let connection = &mut self.connections[index];
        connection.write();
        if connection.has_timed_out() {
            count(&self.shared.refused);
            connection.close();
        }
    }

    /// Answers a request once it is complete.
    fn answer_request(&mut self, index: usize) {
        let peer = self.connections[index].peer;
        let streams = subscribers(&mut self.connections);
        let streams = streams.filter(|other| other.stage == Stage::Stream);
        let peers: heapless::Vec<IpAddr, SLOTS> = streams.map(|other| other.peer).collect();
        let theirs = peers.iter().filter(|other| **other == peer);
        let is_full = peers.len() >= STREAMS || theirs.count() >= STREAMS_OF_PEER;
        let connection = &mut self.connections[index];
        self.body.clear();
        let answer = match Request::read(&connection.received[..connection.length], REQUEST) {
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
            Ok(Answer::Command(command)) if self.shared.queue_command(command) => (204, PLAIN),
            Ok(Answer::Stream | Answer::Command(_)) => (503, PLAIN),
            Err(status @ 401) => (status, LOGIN),
            Err(status) => (status, PLAIN),
        };
        let (sent, refused) = (&self.shared.sent, &self.shared.refused);
        count(if status < 300 { sent } else { refused });
        write_head(&mut connection.unsent, status, headers, self.body.len());
        connection.reply(Stage::Reply, &[self.body.as_bytes()]);
    }
}
