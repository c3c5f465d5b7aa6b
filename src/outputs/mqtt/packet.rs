//! The packets of MQTT 3.1.1 (OASIS, 2014) needed by a client that publishes and accepts commands, written to and read from
//! preallocated buffers.

/// Longest packet accepted, bytes; a broker has no longer ones for us.
pub(super) const LONGEST: usize = 2048;

/// A packet from the broker.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum FromBroker<'a> {
    /// 0 if the client is accepted.
    Connected(u8),
    /// A message has arrived.
    Acknowledged(u16),
    /// 0x80 or more if refused.
    Subscribed(u8),
    /// The answer to a ping.
    Alive,
    Message {
        topic: &'a [u8],
        payload: &'a [u8],
        retained: bool,
        /// Packet number to acknowledge.
        number: Option<u16>,
    },
}

/// Not MQTT, or longer than any packet we expect.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct NotMqtt;

/// A packet of this first byte and what `body` writes.
fn packet(first: u8, into: &mut Vec<u8>, body: impl FnOnce(&mut Vec<u8>)) {
    into.push(first);
    let start = into.len();
    body(into);
    // The length goes between: as few bytes as it takes, seven bits each.
    let mut length = into.len() - start;
    for at in start.. {
        let more = u8::from(length > 0x7f) << 7;
        into.insert(at, (length & 0x7f) as u8 | more);
        length >>= 7;
        if length == 0 {
            return;
        }
    }
}

fn word(word: u16, into: &mut Vec<u8>) {
    into.extend_from_slice(&word.to_be_bytes());
}

fn text(text: &str, into: &mut Vec<u8>) {
    let bytes = &text.as_bytes()[..text.len().min(usize::from(u16::MAX))];
    word(bytes.len() as u16, into);
    into.extend_from_slice(bytes);
}

/// CONNECT, of version 4 (3.1.1): of user and password, whichever there are. The last will, a topic and a payload, is published
/// by the broker when the client disappears.
pub(super) fn connect(
    client: &str,
    keep_alive_s: u16,
    will: [&str; 2],
    login: [Option<&str>; 2],
    into: &mut Vec<u8>,
) {
    packet(0x10, into, |into| {
        text("MQTT", into);
        // A clean session, and a will that is acknowledged and retained.
        let [user, password] = login.map(|part| u8::from(part.is_some()));
        into.extend_from_slice(&[4, 0b0010_1110 | user << 7 | password << 6]);
        word(keep_alive_s, into);
        for part in [client].iter().chain(&will).chain(login.iter().flatten()) {
            text(part, into);
        }
    });
}

/// PUBLISH; with a number for QoS 1.
pub(super) fn publish(
    topic: &str,
    payload: &[u8],
    retain: bool,
    number: Option<u16>,
    into: &mut Vec<u8>,
) {
    let quality = u8::from(number.is_some());
    packet(0x30 | quality << 1 | u8::from(retain), into, |into| {
        text(topic, into);
        if let Some(number) = number {
            word(number, into);
        }
        into.extend_from_slice(payload);
    });
}

/// SUBSCRIBE with QoS 1.
pub(super) fn subscribe(number: u16, topic: &str, into: &mut Vec<u8>) {
    packet(0x82, into, |into| {
        word(number, into);
        text(topic, into);
        into.push(1);
    });
}

/// PUBACK.
pub(super) fn acknowledge(number: u16, into: &mut Vec<u8>) {
    packet(0x40, into, |into| word(number, into));
}

/// PINGREQ.
pub(super) fn ping(into: &mut Vec<u8>) {
    packet(0xc0, into, |_| {});
}

/// DISCONNECT.
pub(super) fn disconnect(into: &mut Vec<u8>) {
    packet(0xe0, into, |_| {});
}

/// A length of one to four bytes, and the rest; `None` while incomplete.
fn length(bytes: &[u8]) -> Result<Option<(usize, &[u8])>, NotMqtt> {
    let mut value = 0;
    for at in 0..4 {
        let Some(&byte) = bytes.get(at) else {
            return Ok(None);
        };
        value |= usize::from(byte & 0x7f) << (7 * at);
        if byte & 0x80 == 0 {
            return Ok(Some((value, &bytes[at + 1..])));
        }
    }
    Err(NotMqtt)
}

/// The first packet in `bytes` and its length; `None` while incomplete.
///
/// # Errors
/// If it is not a packet that a broker sends.
pub(super) fn read(bytes: &[u8]) -> Result<Option<(FromBroker<'_>, usize)>, NotMqtt> {
    let Some((&first, rest)) = bytes.split_first() else {
        return Ok(None);
    };
    // Refused at once: a peer that is no broker may never send as many bytes as its second byte announces.
    if !matches!(first, 0x20 | 0x30..=0x3f | 0x40 | 0x90 | 0xd0) {
        return Err(NotMqtt);
    }
    let Some((count, rest)) = length(rest)? else {
        return Ok(None);
    };
    let used = bytes.len() - rest.len() + count;
    if used > LONGEST {
        return Err(NotMqtt);
    }
    let body = rest.get(..count);
    let told = body.map(|body| parse_body(first, body).ok_or(NotMqtt));
    Ok(told.transpose()?.map(|told| (told, used)))
}

/// Parses the body of a packet; `None` if no broker sends such a packet.
fn parse_body(first: u8, body: &[u8]) -> Option<FromBroker<'_>> {
    let number = |bytes: &[u8]| bytes.first_chunk().map(|two| u16::from_be_bytes(*two));
    Some(match first {
        0x20 => FromBroker::Connected(*body.get(1)?),
        0x40 => FromBroker::Acknowledged(number(body)?),
        0x90 if body.len() >= 3 => FromBroker::Subscribed(*body.last()?),
        0xd0 if body.is_empty() => FromBroker::Alive,
        0x30..=0x3f => {
            let length = number(body)?;
            let (topic, rest) = body[2..].split_at_checked(length.into())?;
            // We ask for no more than QoS 1.
            let (number, payload) = match first >> 1 & 3 {
                0 => (None, rest),
                1 => (Some(number(rest)?), &rest[2..]),
                _ => return None,
            };
            FromBroker::Message {
                topic,
                payload,
                retained: first & 1 == 1,
                number,
            }
        }
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_are_those_of_the_standards() {
        let mut bytes = Vec::new();
        let login = [Some("u"), Some("p")];
        connect("c", 10, ["t", "off"], login, &mut bytes);
        assert_eq!(
            bytes,
            b"\x10\x1b\0\x04MQTT\x04\xee\0\x0a\0\x01c\0\x01t\0\x03off\0\x01u\0\x01p"
        );
        bytes.clear();
        publish("a/b", b"xyz", true, Some(258), &mut bytes);
        assert_eq!(bytes, b"\x33\x0a\0\x03a/b\x01\x02xyz");
        // What a client writes a broker passes on in the same form.
        let told = FromBroker::Message {
            topic: b"a/b",
            payload: b"xyz",
            retained: true,
            number: Some(258),
        };
        assert_eq!(read(&bytes), Ok(Some((told, bytes.len()))));
        for cut in 0..bytes.len() {
            assert_eq!(read(&bytes[..cut]), Ok(None));
        }
        bytes.clear();
        subscribe(7, "a/+", &mut bytes);
        assert_eq!(bytes, b"\x82\x08\0\x07\0\x03a/+\x01");
        // Lengths of two bytes.
        bytes.clear();
        publish("a/b", &[7; 300], true, Some(258), &mut bytes);
        assert_eq!(bytes[..3], [0x33, 0xb3, 0x02]);
        assert_eq!(bytes.len(), 3 + 307);
    }

    #[test]
    fn nonsense_is_told_from_what_is_not_whole() {
        for bad in [
            &b"\xff\xff\xff\xff\xff"[..],
            b"\x30\xff\xff\x03",
            b"\x00\x00",
            b"\x20\x00",
            b"\x40\x01\x00",
            b"\x34\x05\0\x01a\0\x01",
            b"\x30\x02\0\x09",
            b"HTTP/1.1 400 Bad Request",
        ] {
            assert_eq!(read(bad), Err(NotMqtt), "{bad:?}");
        }
        let mut random = fastrand::Rng::with_seed(6);
        for _ in 0..200_000 {
            let bytes: Vec<u8> = (0..random.usize(..24)).map(|_| random.u8(..)).collect();
            if let Ok(Some((_, used))) = read(&bytes) {
                assert!(used <= bytes.len());
            }
        }
    }
}
