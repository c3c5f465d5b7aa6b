//! The subset of HTTP/1.1 that one page needs: GET, POST without a body, one answer per connection, and one unlimited
//! answer (server-sent events, WHATWG HTML section 9.2).
//!
//! A thread per connection, at most [`CONNECTIONS`] and [`CONNECTIONS_PER_PEER`] of one peer, of which [`STREAMS`]
//! may be events; beyond, the connection stalled for longest is closed. A whole request must arrive within
//! [`REQUEST_TIMEOUT`] and [`MAX_REQUEST_BYTES`] bytes; an answer must be read at [`MIN_BYTES_PER_S`]. Other requests
//! are refused in one line and counted. A request must name this server, once, by address or as `localhost`, and
//! changes require a POST with the header `X-Mien`; what that prevents stands at
//! [`http::Request::is_from_elsewhere`]. Pages from elsewhere may not embed resources, and sites learn of cross-site
//! requests ([`Request::elsewhere`]).
//!
//! Requests and heads of replies are those of the box's server ([`mien_outputs::web`]), which polls a few connections in
//! fixed memory and sends all of them the same. Here each connection has a thread of its own: an answer may be baked for a
//! minute or be hundreds of megabytes, and every page reads a session from its start.

use std::io::{Read, Write};
use std::net::{IpAddr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant};

use mien_outputs::web::http::{self, write_head};
use mien_workbench::fault::Fault;

/// Most connections.
const CONNECTIONS: usize = 64;
/// Most connections of one peer.
const CONNECTIONS_PER_PEER: usize = 48;
/// Stall after which a connection is closed in favour of a new one.
const EVICTION_AGE: Duration = Duration::from_millis(250);
/// Most connections with events; the others are reserved for pages.
const STREAMS: usize = 32;
/// Longest request, bytes.
const MAX_REQUEST_BYTES: usize = 8192;
/// Time for a request to arrive, from its first byte to its last, and for an event to be taken.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(5);
/// Least rate at which an answer must be read.
const MIN_BYTES_PER_S: usize = 64 << 10;
/// Longest stall of an answer.
const STALL_TIMEOUT: Duration = Duration::from_secs(10);

/// A parsed request.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// Path without the query.
    pub path: &'a str,
    /// The query, without its question mark.
    pub query: &'a str,
    /// Address of the client.
    pub peer: SocketAddr,
    /// Whether a page of another site sends it, as far as the browser states.
    pub elsewhere: bool,
    /// Whether it changes something: a POST of this page's own.
    pub post: bool,
}

impl Request<'_> {
    /// A value of the query; empty if absent.
    pub fn parameter(&self, name: &str) -> &str {
        let mut pairs = self.query.split('&').map(|pair| pair.split_once('='));
        let found = pairs.find_map(|pair| pair.filter(|(key, _)| *key == name));
        found.map_or("", |(_, value)| value)
    }

    /// Whether the browser runs on this machine.
    pub fn is_local(&self) -> bool {
        self.peer.ip().to_canonical().is_loopback()
    }
}

/// An answer.
pub enum Answer {
    /// A whole file of a media type.
    File(&'static str, Arc<[u8]>),
    /// A file with an additional header line, line end included.
    Marked(&'static str, String, Arc<[u8]>),
    /// A status, such as 404, and a text that says what to do.
    Refused(u16, &'static str),
    /// Server-sent events, written by the site until it fails.
    Events,
}

impl Answer {
    /// An answer from the text of JSON.
    pub fn json(json: &impl ToString) -> Self {
        Self::File("application/json", json.to_string().into_bytes().into())
    }

    /// One of a page's files, each with its path and text.
    pub fn page_file<'a>(
        files: impl IntoIterator<Item = &'a (&'static str, &'static str)>,
        path: &str,
    ) -> Option<Self> {
        let kind = match path.rsplit_once('.') {
            _ if path == "/favicon.ico" => return Some(Self::File("image/x-icon", Arc::new([]))),
            Some((_, "js")) => "text/javascript; charset=utf-8",
            Some((_, "css")) => "text/css; charset=utf-8",
            _ => "text/html; charset=utf-8",
        };
        let mut files = files.into_iter();
        let (_, text) = files.find(|file| file.0 == path)?;
        Some(Self::File(kind, text.as_bytes().into()))
    }
}

/// A handler of requests.
pub trait Site: Send + Sync + 'static {
    /// The answer to a request.
    fn answer(&self, request: &Request) -> Answer;
    /// Sends events until the peer disconnects.
    ///
    /// # Errors
    /// When the peer has disconnected.
    fn events(&self, _send: &mut dyn FnMut(&[u8]) -> std::io::Result<()>) -> std::io::Result<()> {
        Ok(())
    }
    /// Called for every refused request.
    fn refused(&self) {}
}

/// Binds the address of a page; returns it with the actual port.
///
/// # Errors
/// If it is in use, or not of this machine.
pub fn listen(address: SocketAddr) -> Result<(TcpListener, SocketAddr), Fault> {
    let listener = TcpListener::bind(address);
    let opened = listener.and_then(|listener| Ok((listener.local_addr()?, listener)));
    let (page, listener) = opened.map_err(|error| {
        let problem = format!("cannot serve the page at {address}: {error}");
        Fault::new(problem + "; choose another with --port")
    })?;
    Ok((listener, page))
}

/// An open connection.
struct Open {
    stream: TcpStream,
    peer: SocketAddr,
    /// Time of the last transfer in either direction.
    moved: Mutex<Instant>,
    /// Whether it is a stream of events, which may be rare.
    endless: AtomicBool,
}

impl Open {
    /// Time without transfer.
    fn stalled(&self) -> Duration {
        let moved = self.moved.lock().unwrap_or_else(PoisonError::into_inner);
        if self.endless.load(Ordering::Relaxed) {
            return Duration::ZERO;
        }
        moved.elapsed()
    }
}

/// Whether another connection of this peer fits, closing the longest stalled one if necessary.
fn make_room(open: &mut Vec<Weak<Open>>, peer: IpAddr) -> bool {
    open.retain(|one| one.strong_count() > 0);
    let all = open.iter().filter_map(Weak::upgrade);
    let (own, others): (Vec<_>, Vec<_>) = all.partition(|one| one.peer.ip() == peer);
    let candidates = if own.len() >= CONNECTIONS_PER_PEER {
        own
    } else if own.len() + others.len() >= CONNECTIONS {
        own.into_iter().chain(others).collect()
    } else {
        return true;
    };
    let stalled = candidates.iter().max_by_key(|one| one.stalled());
    let stalled = stalled.filter(|one| one.stalled() > EVICTION_AGE);
    // Its thread ends on that.
    stalled.is_some_and(|one| one.stream.shutdown(Shutdown::Both).is_ok())
}

/// Serves until the process ends.
pub fn serve(listener: &TcpListener, site: &Arc<impl Site>) {
    let mut open: Vec<Weak<Open>> = Vec::new();
    // The reference count is the number of streams.
    let streams = Arc::<()>::default();
    for stream in listener.incoming() {
        let Ok(stream) = stream else {
            // Possibly out of descriptors; never loops at full speed.
            std::thread::sleep(Duration::from_millis(50));
            continue;
        };
        let Ok(peer) = stream.peer_addr() else {
            continue;
        };
        if !make_room(&mut open, peer.ip()) {
            site.refused();
            continue;
        }
        let one = Arc::new(Open {
            stream,
            peer,
            moved: Mutex::new(Instant::now()),
            endless: AtomicBool::new(false),
        });
        open.push(Arc::downgrade(&one));
        let (theirs, streams) = (Arc::clone(site), Arc::downgrade(&streams));
        let answer = move || {
            if connection(&one, &*theirs, &streams).is_err() {
                theirs.refused();
            }
        };
        let thread = std::thread::Builder::new().name("page".into());
        if thread.spawn(answer).is_err() {
            site.refused();
        }
    }
}

/// A refused request, already answered.
struct Refused;

/// A connection with a deadline: each read and write gets the remaining time.
struct Until<'a>(&'a Open, Instant);

impl Until<'_> {
    /// The remaining time; a socket rejects a timeout of zero.
    fn left(&self) -> std::io::Result<Option<Duration>> {
        match self.1.saturating_duration_since(Instant::now()) {
            Duration::ZERO => Err(std::io::ErrorKind::TimedOut.into()),
            left => Ok(Some(left.min(STALL_TIMEOUT))),
        }
    }

    /// Notes a transfer.
    fn moved<T>(&self, done: std::io::Result<T>) -> std::io::Result<T> {
        if done.is_ok() {
            *self.0.moved.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now();
        }
        done
    }
}

impl Read for Until<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        let mut stream = &self.0.stream;
        stream.set_read_timeout(self.left()?)?;
        self.moved(stream.read(bytes))
    }
}

impl Write for Until<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let mut stream = &self.0.stream;
        stream.set_write_timeout(self.left()?)?;
        self.moved(stream.write(bytes))
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

fn connection(open: &Open, site: &impl Site, streams: &Weak<()>) -> Result<(), Refused> {
    open.stream.set_nodelay(true).map_err(|_| Refused)?;
    let mut asked = Until(open, Instant::now() + REQUEST_TIMEOUT);
    let mut bytes = Vec::new();
    let mut chunk = [0; 1024];
    while let Ok(None) = parse(&bytes, open.peer) {
        match asked.read(&mut chunk) {
            Ok(count @ 1..) => bytes.extend(&chunk[..count]),
            _ => return Err(Refused),
        }
    }
    let mut stream = Until(open, Instant::now() + REQUEST_TIMEOUT);
    let request = match parse(&bytes, open.peer) {
        Ok(request) => request.ok_or(Refused)?,
        Err(status) => {
            let text = format!("refused with status {status}\n");
            let _ = write_answer(&mut stream, status, "text/plain", "", text.as_bytes());
            return Err(Refused);
        }
    };
    let (status, kind, mark, body): (_, _, _, Arc<[u8]>) = match site.answer(&request) {
        Answer::File(kind, body) => (200, kind, String::new(), body),
        Answer::Marked(kind, mark, body) => (200, kind, mark, body),
        Answer::Refused(status, text) => {
            (status, "text/plain", String::new(), text.as_bytes().into())
        }
        Answer::Events => {
            // Counted before the comparison, so that two at once cannot both take the last place.
            let _counted = streams.upgrade();
            if streams.strong_count() <= STREAMS + 1 {
                open.endless.store(true, Ordering::Relaxed);
                // Each event has its own deadline.
                let mut send =
                    |bytes: &[u8]| Until(open, Instant::now() + REQUEST_TIMEOUT).write_all(bytes);
                let _ = send(EVENTS).and_then(|()| site.events(&mut send));
            } else {
                let text = b"too many pages are open; close some\n";
                let _ = write_answer(&mut stream, 503, "text/plain", "", text);
            }
            return Ok(());
        }
    };
    let seconds = body.len() / MIN_BYTES_PER_S;
    // From here on: baking may have taken a minute.
    let until = Instant::now() + REQUEST_TIMEOUT + Duration::from_secs(seconds as u64);
    let mut stream = Until(open, until);
    // A disconnected peer is no bad request.
    let _ = write_answer(&mut stream, status, kind, &mark, &body);
    Ok(())
}

/// Header of events.
const EVENTS: &[u8] =
    b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\n\
      Cross-Origin-Resource-Policy: same-origin\r\nConnection: close\r\n\r\n";

/// Headers of every answer: no embedding by other sites.
const GUARDS: &str = "X-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
    Cross-Origin-Resource-Policy: same-origin\r\n\
    Content-Security-Policy: default-src 'self'; img-src 'self' blob: data:; connect-src 'self' blob:; frame-ancestors 'none'\r\n";

/// Writes an answer; `mark` is a header line with its line end, or empty.
fn write_answer(
    stream: &mut Until<'_>,
    status: u16,
    kind: &str,
    mark: &str,
    body: &[u8],
) -> std::io::Result<()> {
    let mut head = Vec::new();
    let headers = format_args!("Content-Type: {kind}\r\n{GUARDS}{mark}");
    write_head(&mut head, status, headers, body.len());
    stream.write_all(&head)?;
    stream.write_all(body)
}

/// Parses a request; `None` while incomplete.
///
/// # Errors
/// The HTTP status with which to refuse it.
pub fn parse(bytes: &[u8], peer: SocketAddr) -> Result<Option<Request<'_>>, u16> {
    let Some(request) = http::Request::read(bytes, MAX_REQUEST_BYTES)? else {
        return Ok(None);
    };
    let has_body = request.header("transfer-encoding")?.is_some()
        || request
            .header("content-length")?
            .is_some_and(|length| length != "0");
    if request.is_post && has_body {
        return Err(413);
    }
    Ok(Some(Request {
        path: request.path,
        query: request.query,
        peer,
        elsewhere: request.is_from_elsewhere("")?,
        post: request.is_post,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Path, query and whether it is a POST.
    fn ask(request: &str) -> Result<(String, String, bool), u16> {
        let parsed = parse(request.as_bytes(), "127.0.0.1:5".parse().unwrap());
        parsed.map(|request| {
            let Request {
                path, query, post, ..
            } = request.unwrap();
            (path.to_owned(), query.to_owned(), post)
        })
    }

    #[test]
    fn a_request_is_a_get_to_this_machine_by_address() {
        let get = |host: &str| {
            ask(&format!(
                "GET /a?b=1 HTTP/1.1\r\nX: y\r\nHost: {host}\r\n\r\n"
            ))
        };
        for host in "127.0.0.1:80 localhost LocalHost:9180 [::1]:9180 10.0.0.3".split(' ') {
            let expected = ("/a".to_owned(), "b=1".to_owned(), false);
            assert_eq!(get(host), Ok(expected), "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:9180",
            "127.0.0.1.evil.example",
            "",
        ] {
            assert_eq!(get(host), Err(421), "{host}");
        }
        assert!(ask("POST / HTTP/1.1\r\nHost: localhost\r\n\r\n").is_err());
        assert!(ask("GET http://x/ HTTP/1.1\r\nHost: localhost\r\n\r\n").is_err());
        assert!(ask("GET / HTTP/1.1\r\n\r\n").is_err());
    }

    #[test]
    fn only_this_page_changes_something() {
        let post = |headers: &str| {
            ask(&format!(
                "POST /command?what=forget HTTP/1.1\r\nHost: localhost:9180\r\n{headers}\r\n"
            ))
        };
        let own = "X-Mien: 1\r\nContent-Length: 0\r\n";
        assert!(post(own).unwrap().2);
        assert!(post(&format!("{own}Origin: http://localhost:9180\r\n")).is_ok());
        for headers in [
            "",
            "X-Mien: 1\r\nOrigin: http://evil.example\r\n",
            "X-Mien: 1\r\nOrigin: http://localhost:1\r\n",
            "X-Mien: 1\r\nSec-Fetch-Site: cross-site\r\n",
        ] {
            assert_eq!(post(headers), Err(403), "{headers}");
        }
        for headers in ["Content-Length: 5\r\n", "Transfer-Encoding: chunked\r\n"] {
            let found = post(&format!("X-Mien: 1\r\n{headers}"));
            assert_eq!(found, Err(413), "{headers}");
        }
        let preflight = "OPTIONS /command HTTP/1.1\r\nHost: localhost\r\n\r\n";
        assert_eq!(ask(preflight), Err(405));
        assert!(!ask("GET / HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap().2);
    }

    struct Page;

    impl Site for Page {
        fn answer(&self, request: &Request) -> Answer {
            match request.path {
                "/events" => Answer::Events,
                "/big" => Answer::File("text/plain", vec![b'.'; 16 << 20].into()),
                "/picture" if request.elsewhere => Answer::Refused(403, "no\n"),
                _ => Answer::File("text/plain", b"here".as_slice().into()),
            }
        }

        fn events(
            &self,
            send: &mut dyn FnMut(&[u8]) -> std::io::Result<()>,
        ) -> std::io::Result<()> {
            loop {
                send(b": alive\n\n")?;
                std::thread::sleep(Duration::from_millis(100));
            }
        }

        fn refused(&self) {}
    }

    fn served() -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        std::thread::spawn(move || serve(&listener, &Arc::new(Page)));
        address
    }

    fn get(address: SocketAddr, path: &str, headers: &str) -> (TcpStream, String) {
        let mut stream = TcpStream::connect(address).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(60)))
            .unwrap();
        // Turned away at the door, there is nobody to write to.
        let _sent = write!(
            stream,
            "GET {path} HTTP/1.1\r\nHost: {address}\r\n{headers}\r\n"
        );
        let mut line = [0; 16];
        let length = stream.read(&mut line).unwrap_or(0);
        let line = String::from_utf8_lossy(&line[..length]).into_owned();
        (stream, line)
    }

    #[test]
    fn event_streams_leave_places_for_pages() {
        let address = served();
        let streams: Vec<_> = (0..CONNECTIONS)
            .map(|_| get(address, "/events", ""))
            .collect();
        let open = streams.iter().filter(|s| s.1.contains("200")).count();
        assert!(open >= 16, "{open} streams at once");
        let (_, line) = get(address, "/", "");
        assert!(line.starts_with("HTTP/1.1 200"), "{line}");
    }

    #[test]
    fn clients_that_read_nothing_do_not_block_others() {
        let address = served();
        let silent: Vec<_> = (0..CONNECTIONS)
            .map(|_| {
                let mut stream = TcpStream::connect(address).unwrap();
                let _ = write!(stream, "GET /big HTTP/1.1\r\nHost: {address}\r\n\r\n");
                stream
            })
            .collect();
        std::thread::sleep(2 * EVICTION_AGE);
        for _ in 0..8 {
            let began = Instant::now();
            let (_, line) = get(address, "/", "");
            assert!(line.starts_with("HTTP/1.1 200"), "{line}");
            assert!(began.elapsed() < Duration::from_secs(1));
        }
        drop(silent);
    }

    #[test]
    fn a_slow_request_has_one_deadline() {
        let address = served();
        let mut slow: Vec<TcpStream> = (0..CONNECTIONS)
            .map(|_| TcpStream::connect(address).unwrap())
            .collect();
        // A letter now and then, for far longer than a request may take.
        let answered = (0..240).any(|_| {
            std::thread::sleep(REQUEST_TIMEOUT / 20);
            for stream in &mut slow {
                let _gone = stream.write(b"G");
            }
            get(address, "/", "").1.starts_with("HTTP/1.1 200")
        });
        assert!(answered, "the page is closed for as long as they wish");
    }

    #[test]
    fn other_sites_get_no_pictures_and_nothing_may_be_embedded() {
        let address = served();
        let elsewhere = |headers: &str| get(address, "/picture", headers).1.contains("403");
        assert!(!elsewhere(""));
        assert!(!elsewhere("Sec-Fetch-Site: same-origin\r\n"));
        assert!(!elsewhere("Sec-Fetch-Site: none\r\n"));
        assert!(!elsewhere(&format!("Origin: http://{address}\r\n")));
        assert!(elsewhere("Sec-Fetch-Site: cross-site\r\n"));
        assert!(elsewhere("Sec-Fetch-Site: same-site\r\n"));
        assert!(elsewhere("Origin: http://127.0.0.1:1\r\n"));
        assert!(elsewhere("Origin: null\r\n"));
        let (mut stream, _) = get(address, "/", "");
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        assert!(
            text.contains("Cross-Origin-Resource-Policy: same-origin"),
            "{text}"
        );
    }

    #[test]
    fn a_request_has_one_host() {
        let two = "GET / HTTP/1.1\r\nHost: localhost\r\nhost: evil.example\r\n\r\n";
        assert_eq!(ask(two), Err(400));
    }
}
