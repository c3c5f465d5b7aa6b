//! As much of HTTP/1.1 as one page needs: GET, one answer per connection, and one answer that does not end (server-sent
//! events, WHATWG HTML section 9.2).
//!
//! A thread per connection, at most [`CONNECTIONS`]; a request has [`PATIENCE`] to arrive and [`LONGEST`] bytes. Whatever is
//! not a GET of something that is here is refused in one line and counted. A request must name this server by address or
//! as `localhost`: a page from elsewhere that points a name of its own at this machine (DNS rebinding) is turned away.

use std::io::{Read, Write};
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Connections at once.
const CONNECTIONS: usize = 64;
/// Longest request, bytes.
const LONGEST: usize = 8192;
/// How long a request may take to arrive, and an answer to be taken.
const PATIENCE: Duration = Duration::from_secs(5);

/// What was asked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// Path without the query.
    pub path: String,
    /// The query, without its question mark.
    pub query: String,
    /// Who asks.
    pub peer: SocketAddr,
}

/// What is answered.
pub enum Answer {
    /// A whole file of a media type.
    File(&'static str, Arc<[u8]>),
    /// The same, with a header of its own.
    Marked(&'static str, String, Arc<[u8]>),
    /// Nothing here; the sentence says what to do.
    Missing(&'static str),
    /// Not for this peer.
    Forbidden(&'static str),
    /// Events, written by the function until it fails.
    Events,
}

/// Who answers.
pub trait Site: Send + Sync + 'static {
    /// The answer to a request.
    fn answer(&self, request: &Request) -> Answer;
    /// Writes events until the peer is gone.
    ///
    /// # Errors
    /// When the peer is gone.
    fn events(&self, to: &mut dyn Write) -> std::io::Result<()>;
    /// A request was refused.
    fn refused(&self);
}

/// Serves until the process ends.
pub fn serve(listener: &TcpListener, site: &Arc<impl Site>) {
    let open = Arc::new(AtomicUsize::new(0));
    for stream in listener.incoming() {
        let Ok(stream) = stream else {
            // Out of descriptors, perhaps; never at full speed.
            std::thread::sleep(Duration::from_millis(50));
            continue;
        };
        if open.load(Ordering::Relaxed) >= CONNECTIONS {
            site.refused();
            continue;
        }
        open.fetch_add(1, Ordering::Relaxed);
        let (theirs, count) = (Arc::clone(site), Arc::clone(&open));
        let started = std::thread::Builder::new()
            .name("page".into())
            .spawn(move || {
                if connection(stream, &*theirs).is_err() {
                    theirs.refused();
                }
                count.fetch_sub(1, Ordering::Relaxed);
            });
        if started.is_err() {
            open.fetch_sub(1, Ordering::Relaxed);
            site.refused();
        }
    }
}

/// What cannot be answered; its line is the answer all the same.
struct Refused;

fn connection(mut stream: TcpStream, site: &impl Site) -> Result<(), Refused> {
    let limits = stream
        .set_read_timeout(Some(PATIENCE))
        .and_then(|()| stream.set_write_timeout(Some(PATIENCE)))
        .and_then(|()| stream.set_nodelay(true));
    let peer = stream.peer_addr().map_err(|_| Refused)?;
    limits.map_err(|_| Refused)?;
    let mut bytes = Vec::new();
    let mut chunk = [0; 1024];
    while !bytes.windows(4).any(|end| end == b"\r\n\r\n") {
        let count = stream.read(&mut chunk).map_err(|_| Refused)?;
        bytes.extend(&chunk[..count]);
        if count == 0 || bytes.len() > LONGEST {
            return Err(Refused);
        }
    }
    let request = match parse(&bytes, peer) {
        Ok(request) => request,
        Err(status) => {
            let _ = write_answer(&mut stream, status, "text/plain", "", status.as_bytes());
            return Err(Refused);
        }
    };
    // That a peer goes away is no fault of its request.
    let _ = match site.answer(&request) {
        Answer::File(kind, body) => write_answer(&mut stream, "200 OK", kind, "", &body),
        Answer::Marked(kind, mark, body) => {
            write_answer(&mut stream, "200 OK", kind, &mark, &body)
        }
        Answer::Missing(text) => {
            write_answer(&mut stream, "404 Not Found", "text/plain", "", text.as_bytes())
        }
        Answer::Forbidden(text) => {
            write_answer(&mut stream, "403 Forbidden", "text/plain", "", text.as_bytes())
        }
        Answer::Events => stream
            .write_all(b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n")
            .and_then(|()| site.events(&mut stream)),
    };
    Ok(())
}

/// `mark` is a header line with its line end, or nothing.
fn write_answer(
    stream: &mut TcpStream,
    status: &str,
    kind: &str,
    mark: &str,
    body: &[u8],
) -> std::io::Result<()> {
    // Nothing from elsewhere, and nothing kept: another mesh may be served under the same name tomorrow.
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nCache-Control: no-store\r\n\
         X-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
         Content-Security-Policy: default-src 'self'; img-src 'self' blob: data:; connect-src 'self' blob:; frame-ancestors 'none'\r\n\
         {mark}Connection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    stream.write_all(body)
}

/// The request, or the status line that refuses it.
fn parse(bytes: &[u8], peer: SocketAddr) -> Result<Request, &'static str> {
    let bad = "400 Bad Request";
    let text = std::str::from_utf8(bytes).map_err(|_| bad)?;
    let mut lines = text.split("\r\n");
    let mut words = lines.next().unwrap_or_default().split(' ');
    let (method, target, version) = (words.next(), words.next(), words.next());
    if words.next().is_some() || !version.is_some_and(|version| version.starts_with("HTTP/1.")) {
        return Err(bad);
    }
    if method != Some("GET") {
        return Err("405 Method Not Allowed");
    }
    let target = target.filter(|target| target.starts_with('/')).ok_or(bad)?;
    let host = lines
        .filter_map(|line| line.split_once(':'))
        .find(|(name, _)| name.eq_ignore_ascii_case("host"))
        .map(|(_, host)| host.trim());
    if !host.is_some_and(is_address) {
        return Err("421 Misdirected Request");
    }
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    Ok(Request {
        path: path.to_owned(),
        query: query.to_owned(),
        peer,
    })
}

/// Whether a host, with or without a port, is `localhost` or an IP address.
fn is_address(host: &str) -> bool {
    let numeric = |host: &str| host.parse::<IpAddr>().is_ok() || host == "localhost";
    host.parse::<SocketAddr>().is_ok()
        || numeric(host)
        || host.rsplit_once(':').is_some_and(|(name, port)| {
            port.bytes().all(|byte| byte.is_ascii_digit()) && numeric(name)
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ask(request: &str) -> Result<Request, &'static str> {
        parse(request.as_bytes(), "127.0.0.1:5".parse().unwrap())
    }

    #[test]
    fn a_request_is_a_get_to_this_machine_by_address() {
        let get = |host: &str| {
            ask(&format!(
                "GET /a?b=1 HTTP/1.1\r\nX: y\r\nHost: {host}\r\n\r\n"
            ))
        };
        for host in [
            "127.0.0.1:80",
            "localhost",
            "localhost:9180",
            "[::1]:9180",
            "10.0.0.3",
        ] {
            let request = get(host).unwrap();
            assert_eq!((&*request.path, &*request.query), ("/a", "b=1"), "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:9180",
            "127.0.0.1.evil.example",
            "",
        ] {
            assert_eq!(get(host), Err("421 Misdirected Request"), "{host}");
        }
        assert!(ask("POST / HTTP/1.1\r\nHost: localhost\r\n\r\n").is_err());
        assert!(ask("GET http://x/ HTTP/1.1\r\nHost: localhost\r\n\r\n").is_err());
        assert!(ask("GET / HTTP/1.1\r\n\r\n").is_err());
    }
}
