//! The packets of MQTT 3.1.1 (OASIS, 2014) needed by a client that publishes and accepts commands, written to and read from
//! preallocated buffers.

/// Longest packet accepted, bytes; our subscriptions need no longer ones.
pub(super) const LONGEST: usize = 2048;

/// A packet from the broker.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum FromBroker<'a> {
    /// CONNACK: 0 if the client is accepted.
    Connected(u8),
    /// PUBACK: number of the packet that has arrived.
    Acknowledged(u16),
    /// SUBACK: 0x80 or more if refused.
    Subscribed(u8),
    /// PINGRESP.
    Alive,
    Message {
        topic: &'a [u8],
        payload: &'a [u8],
        retained: bool,
        /// Packet number to acknowledge.
        packet_id: Option<u16>,
    },
}

/// Not MQTT, or longer than any packet we expect.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct ProtocolError;

/// Appends a packet: its first byte, its length, and the bytes written by `body`.
fn packet(first: u8, into: &mut Vec<u8>, body: impl FnOnce(&mut Vec<u8>)) {
    into.push(first);
    let start = into.len();
    body(into);
    // The length goes before the body, seven bits per byte.
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

/// CONNECT, protocol level 4 (3.1.1), with user and password if given. `will` is topic and payload of the message that the broker
/// publishes when the client disappears.
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

/// PUBLISH; QoS 1 with a packet number, else QoS 0.
pub(super) fn publish(
    topic: &str,
    payload: &[u8],
    retain: bool,
    packet_id: Option<u16>,
    into: &mut Vec<u8>,
) {
    let quality = u8::from(packet_id.is_some());
    packet(0x30 | quality << 1 | u8::from(retain), into, |into| {
        text(topic, into);
        if let Some(packet_id) = packet_id {
            word(packet_id, into);
        }
        into.extend_from_slice(payload);
    });
}

/// SUBSCRIBE with QoS 1.
pub(super) fn subscribe(packet_id: u16, topic: &str, into: &mut Vec<u8>) {
    packet(0x82, into, |into| {
        word(packet_id, into);
        text(topic, into);
        into.push(1);
    });
}

/// PUBACK.
pub(super) fn acknowledge(packet_id: u16, into: &mut Vec<u8>) {
    packet(0x40, into, |into| word(packet_id, into));
}

/// PINGREQ.
pub(super) fn ping(into: &mut Vec<u8>) {
    packet(0xc0, into, |_| {});
}

/// DISCONNECT.
pub(super) fn disconnect(into: &mut Vec<u8>) {
    packet(0xe0, into, |_| {});
}

/// A length of one to four bytes, and the remaining bytes; `None` while incomplete.
///
/// # Errors
/// If the length is longer.
fn length(bytes: &[u8]) -> Result<Option<(usize, &[u8])>, ProtocolError> {
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
    Err(ProtocolError)
}

/// The first packet in `bytes` and its length; `None` while incomplete.
///
/// # Errors
/// If it is not a packet that a broker sends.
pub(super) fn read(bytes: &[u8]) -> Result<Option<(FromBroker<'_>, usize)>, ProtocolError> {
    let Some((&first, rest)) = bytes.split_first() else {
        return Ok(None);
    };
    // Refused before the length is read: a peer that is no broker may never send as many bytes as it announces.
    if !matches!(first, 0x20 | 0x30..=0x3f | 0x40 | 0x90 | 0xd0) {
        return Err(ProtocolError);
    }
    let Some((count, rest)) = length(rest)? else {
        return Ok(None);
    };
    let used = bytes.len() - rest.len() + count;
    if used > LONGEST {
        return Err(ProtocolError);
    }
    let body = rest.get(..count);
    let packet = body.map(|body| parse_body(first, body).ok_or(ProtocolError));
    Ok(packet.transpose()?.map(|packet| (packet, used)))
}

/// Parses the body of a packet; `None` if no broker sends such a packet.
fn parse_body(first: u8, body: &[u8]) -> Option<FromBroker<'_>> {
    let read_u16 = |bytes: &[u8]| bytes.first_chunk().map(|two| u16::from_be_bytes(*two));
    Some(match first {
        0x20 => FromBroker::Connected(*body.get(1)?),
        0x40 => FromBroker::Acknowledged(read_u16(body)?),
        0x90 if body.len() >= 3 => FromBroker::Subscribed(*body.last()?),
        0xd0 if body.is_empty() => FromBroker::Alive,
        0x30..=0x3f => {
            let length = read_u16(body)?;
            let (topic, rest) = body[2..].split_at_checked(length.into())?;
            // Subscriptions ask for at most QoS 1.
            let (packet_id, payload) = match first >> 1 & 3 {
                0 => (None, rest),
                1 => (Some(read_u16(rest)?), &rest[2..]),
                _ => return None,
            };
            FromBroker::Message {
                topic,
                payload,
                retained: first & 1 == 1,
                packet_id,
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
        let packet = FromBroker::Message {
            topic: b"a/b",
            payload: b"xyz",
            retained: true,
            packet_id: Some(258),
        };
        assert_eq!(read(&bytes), Ok(Some((packet, bytes.len()))));
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
            assert_eq!(read(bad), Err(ProtocolError), "{bad:?}");
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
