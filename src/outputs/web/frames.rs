//! WebSocket (RFC 6455): the upgrade of a request, and frames.

use base64::{Engine as _, engine::general_purpose::STANDARD};
use sha1_smol::Sha1;

use super::http::Request;

/// Longest request or WebSocket frame accepted, bytes.
pub(super) const REQUEST: usize = 2048;
/// Bytes of a WebSocket key: 16 in base 64.
const KEY: usize = 24;

impl Request<'_> {
    /// The reply to a WebSocket key (4.2.2): SHA-1 of the key and a fixed text, in base 64; `None` if no upgrade is requested. Not
    /// for security: it only shows that the server speaks WebSocket.
    ///
    /// # Errors
    /// 400 if there is no such key.
    pub(super) fn upgrade(&self) -> Result<Option<[u8; 28]>, u16> {
        let wanted = self.header("upgrade")?;
        if !wanted.is_some_and(|protocol| protocol.eq_ignore_ascii_case("websocket")) {
            return Ok(None);
        }
        let key = self.header("sec-websocket-key")?;
        let key = key.filter(|key| key.len() == KEY).ok_or(400_u16)?;
        let mut hash = Sha1::from(key);
        hash.update(b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11");
        let mut text = [0; 28];
        let length = STANDARD.encode_slice(hash.digest().bytes(), &mut text);
        debug_assert_eq!(length, Ok(text.len()));
        Ok(Some(text))
    }
}

/// A WebSocket frame from a page.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Sent {
    /// A ping, answered with the same bytes.
    Ping(heapless::Vec<u8, 125>),
    /// Ignored.
    Other,
    Close,
}

/// The first frame in `bytes`, unmasked, and its length; `None` while incomplete. An invalid or overlong frame closes the
/// connection.
pub(super) fn read_frame(bytes: &[u8]) -> Option<(Sent, usize)> {
    let (&first, &second) = (bytes.first()?, bytes.get(1)?);
    let (length, at) = match second & 0x7f {
        126 => (u16::from_be_bytes([*bytes.get(2)?, *bytes.get(3)?]), 4),
        127 => return Some((Sent::Close, bytes.len())),
        length => (u16::from(length), 2),
    };
    let length = usize::from(length);
    let control = first & 0x08 != 0;
    // Frames from pages are masked; control frames are short and unfragmented.
    let wrong =
        second & 0x80 == 0 || first & 0x70 != 0 || control && (length > 125 || first & 0x80 == 0);
    if wrong || at + 4 + length > REQUEST {
        return Some((Sent::Close, bytes.len()));
    }
    let masked = bytes.get(at + 4..at + 4 + length)?;
    let sent = match first & 0x0f {
        0 | 1 | 2 | 10 => Sent::Other,
        9 => {
            let mask = bytes[at..at + 4].iter().cycle();
            let plain = masked.iter().zip(mask).map(|(byte, mask)| byte ^ mask);
            Sent::Ping(plain.collect())
        }
        _ => Sent::Close,
    };
    Some((sent, at + 4 + length))
}

/// Appends the header of an unfragmented, unmasked frame.
pub(super) fn write_frame_header(kind: u8, length: usize, into: &mut Vec<u8>) {
    into.push(0x80 | kind);
    if length < 126 {
        into.push(length as u8);
    } else {
        into.push(126);
        into.extend_from_slice(&(length as u16).to_be_bytes());
    }
}

/// Parses bytes as a request and as WebSocket frames, for `tests/fuzz`.
#[cfg(fuzzing)]
pub fn fuzz(bytes: &[u8]) {
    if let Ok(Some(request)) = Request::read(bytes, REQUEST) {
        let _ = (request.upgrade(), request.header("host"));
    }
    let mut rest = &bytes[..bytes.len().min(REQUEST)];
    while let Some((_, used)) = read_frame(rest).filter(|_| !rest.is_empty()) {
        rest = &rest[used..];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_upgrade_is_answered_as_in_the_standard() {
        let ask = |headers: &str| {
            let text = format!("GET / HTTP/1.1\r\n{headers}\r\n\r\n");
            Request::read(text.as_bytes(), REQUEST)
                .unwrap()
                .unwrap()
                .upgrade()
        };
        assert_eq!(
            ask("upgrade: WebSocket\r\nSEC-WEBSOCKET-KEY: dGhlIHNhbXBsZSBub25jZQ=="),
            Ok(Some(*b"s3pPLMBiTxaQ9kYGzzhZRbK+xOo="))
        );
        assert_eq!(ask("Host: x"), Ok(None));
        for bad in [
            "Upgrade: websocket",
            "Upgrade: websocket\r\nSec-WebSocket-Key: short",
        ] {
            assert_eq!(ask(bad), Err(400));
        }
    }

    #[test]
    fn frames_of_pages_are_read_and_others_close() {
        let ping = [0x89, 0x83, 1, 2, 3, 4, b'a' ^ 1, b'b' ^ 2, b'c' ^ 3];
        let (sent, used) = read_frame(&ping).unwrap();
        assert_eq!(
            (sent, used),
            (Sent::Ping(heapless::Vec::from_slice(b"abc").unwrap()), 9)
        );
        for cut in 0..ping.len() {
            assert_eq!(read_frame(&ping[..cut]), None);
        }
        assert_eq!(
            read_frame(&[0x81, 0x80, 0, 0, 0, 0]),
            Some((Sent::Other, 6))
        );
        for bad in [
            &[0x81, 0x00][..],
            &[0x88, 0x80, 0, 0, 0, 0],
            &[0x81, 0xff],
            &[0x81, 0xfe, 0xff, 0xff],
            &[0xc1, 0x80],
            &[0x09, 0x80],
        ] {
            assert_eq!(
                read_frame(bad).map(|(sent, _)| sent),
                Some(Sent::Close),
                "{bad:?}"
            );
        }
        let mut random = fastrand::Rng::with_seed(5);
        for _ in 0..100_000 {
            let bytes: Vec<u8> = (0..random.usize(..40)).map(|_| random.u8(..)).collect();
            if let Some((_, used)) = read_frame(&bytes) {
                assert!(used > 0 && used <= bytes.len());
            }
            let _ = Request::read(&bytes, REQUEST);
        }
    }
}
