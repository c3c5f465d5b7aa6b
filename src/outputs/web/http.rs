//! Requests of browsers and heads of replies, for the box's servers and the workstation's: HTTP/1.1 without bodies, parsed by
//! `httparse`.

use std::fmt::Display;
use std::io::Write as _;
use std::net::IpAddr;

/// Most headers of a request.
const HEADERS: usize = 48;

/// A parsed request.
#[derive(Debug)]
pub struct Request<'a> {
    /// Whether it is a POST; otherwise it is a GET.
    pub is_post: bool,
    /// Path without its query.
    pub path: &'a str,
    /// Query without its question mark; empty if there is none.
    pub query: &'a str,
    headers: heapless::Vec<httparse::Header<'a>, HEADERS>,
}

impl<'a> Request<'a> {
    /// Parses a request of at most `longest` bytes; `None` while incomplete.
    ///
    /// # Errors
    /// The HTTP status with which to refuse it.
    pub fn read(bytes: &'a [u8], longest: usize) -> Result<Option<Self>, u16> {
        let mut headers = [httparse::EMPTY_HEADER; HEADERS];
        let mut request = httparse::Request::new(&mut headers);
        match request.parse(bytes) {
            Ok(httparse::Status::Complete(_)) => {}
            Ok(httparse::Status::Partial) if bytes.len() < longest => return Ok(None),
            Ok(_) | Err(httparse::Error::TooManyHeaders) => return Err(431),
            Err(_) => return Err(400),
        }
        let target = request.path.filter(|path| path.starts_with('/'));
        let target = target.ok_or(400_u16)?;
        let is_post = match request.method {
            Some("GET") => false,
            Some("POST") => true,
            _ => return Err(405),
        };
        let (path, query) = target.split_once('?').unwrap_or((target, ""));
        Ok(Some(Self {
            is_post,
            path,
            query,
            headers: request.headers.iter().copied().collect(),
        }))
    }

    /// The value of a header, if it is there.
    ///
    /// # Errors
    /// 400 if there are several.
    pub fn header(&self, name: &str) -> Result<Option<&'a str>, u16> {
        let is_it = |header: &&httparse::Header| header.name.eq_ignore_ascii_case(name);
        let mut all = self.headers.iter().filter(is_it);
        let value = all.next().map(|header| std::str::from_utf8(header.value));
        if all.next().is_some() {
            return Err(400);
        }
        value.transpose().map_err(|_| 400)
    }

    /// Whether a page of another site sends it, as far as the browser states. `name` is that of this server in the network.
    ///
    /// # Errors
    /// 421 if it addresses another server, as by a name that another site points at this one (DNS rebinding); 403 if it would
    /// change something from elsewhere or without the header `X-Mien`, which neither a form nor a link of another site can add,
    /// and a script only after a preflight, which is not answered.
    pub fn is_from_elsewhere(&self, name: &str) -> Result<bool, u16> {
        let host = self.header("host")?;
        let host = host.filter(|host| is_own(host, name)).ok_or(421_u16)?;
        let elsewhere = |origin: &str| {
            let of = origin.strip_prefix("http://");
            of.is_none_or(|of| !of.eq_ignore_ascii_case(host))
        };
        let other = |site: &str| !["same-origin", "none"].contains(&site);
        let elsewhere = self.header("origin")?.is_some_and(elsewhere)
            || self.header("sec-fetch-site")?.is_some_and(other);
        if self.is_post && (elsewhere || self.header("x-mien")?.is_none()) {
            return Err(403);
        }
        Ok(elsewhere)
    }
}

/// Whether a host, with or without a port, is an IP address, `localhost` or this name, with or without `.local`.
fn is_own(host: &str, own: &str) -> bool {
    let split = host.rsplit_once(':');
    let split = split.filter(|(_, port)| port.parse::<u16>().is_ok());
    let name = split.map_or(host, |(name, _)| name);
    let bare = name.trim_matches(['[', ']']);
    let name = name.to_ascii_lowercase();
    let label = name.strip_suffix(".local").unwrap_or(&name);
    bare.parse::<IpAddr>().is_ok()
        || name == "localhost"
        || !own.is_empty() && label.eq_ignore_ascii_case(own)
}

/// Appends the head of a reply; the reason after the status may be empty (RFC 9112, 4). Nothing may be kept: the next reply to
/// the same request may be another.
pub fn write_head(to: &mut Vec<u8>, status: u16, headers: impl Display, length: usize) {
    let _ = write!(
        to,
        "HTTP/1.1 {status} \r\n{headers}Content-Length: {length}\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n"
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    const LONGEST: usize = 2048;

    #[test]
    fn requests_are_read_and_nonsense_is_refused() {
        let ask = |text: &str| {
            let text = format!("{text}\r\n\r\n");
            let read = Request::read(text.as_bytes(), LONGEST);
            read.map(|request| request.map(|one| (one.is_post, one.path.to_owned())))
        };
        for (text, is_post, path) in [
            ("GET /a/b?VALUE HTTP/1.1\r\nHost: x", false, "/a/b"),
            ("GET / HTTP/1.0", false, "/"),
            ("POST /a HTTP/1.1", true, "/a"),
        ] {
            assert_eq!(ask(text), Ok(Some((is_post, path.to_owned()))), "{text}");
        }
        for (text, status) in [
            ("PUT / HTTP/1.1", 405),
            ("GET a HTTP/1.1", 400),
            ("GET /", 400),
            ("GET / HTTP/2", 400),
            ("\u{ff}", 400),
        ] {
            assert_eq!(ask(text), Err(status), "{text}");
        }
        assert!(
            Request::read(b"GET / HTTP/1.1\r\n", LONGEST)
                .unwrap()
                .is_none()
        );
        let long = format!("GET /{} HTTP/1.1\r\n", "x".repeat(LONGEST));
        assert_eq!(
            Request::read(&long.as_bytes()[..LONGEST], LONGEST).err(),
            Some(431)
        );
    }
}
