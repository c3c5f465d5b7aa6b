//! The packets of MQTT 3.1.1 (OASIS, 2014) and 5.0 (2019) needed by a client that publishes and accepts commands, written to
//! and read from preallocated buffers. Version 5 adds properties; we send none and skip all we receive.

/// Longest packet accepted, bytes; a broker has no longer ones for us.
pub(super) const LONGEST: usize = 2048;

/// The CONNECT packet's contents.
pub(super) struct Hello<'a> {
    /// 4 is 3.1.1, 5.
    pub(super) version: u8,
    pub(super) client: &'a str,
    /// Seconds.
    pub(super) keep_alive: u16,
    /// Last will, published by the broker when the client disappears: topic and payload.
    pub(super) will: (&'a str, &'a str),
    pub(super) user: Option<&'a str>,
    pub(super) password: Option<&'a str>,
}

/// A PUBLISH packet from the client.
pub(super) struct Message<'a> {
    pub(super) topic: &'a str,
    pub(super) payload: &'a [u8],
    pub(super) retain: bool,
    /// Packet number for QoS 1, and whether it is sent again.
    pub(super) number: Option<(u16, bool)>,
}

/// A packet from the broker.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Told<'a> {
    /// 0 if the client is accepted.
    Connected(u8),
    /// A message has arrived.
    Acknowledged(u16),
    Subscribed(u8),
    Alive,
    Message {
        topic: &'a [u8],
        payload: &'a [u8],
        retained: bool,
        /// Packet number to acknowledge.
        number: Option<u16>,
    },
    Goodbye,
}

/// Not MQTT, or longer than any packet we expect.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Nonsense;

fn text(bytes: &[u8], into: &mut Vec<u8>) {
    let bytes = &bytes[..bytes.len().min(usize::from(u16::MAX))];
    into.extend_from_slice(&(bytes.len() as u16).to_be_bytes());
    into.extend_from_slice(bytes);
}

/// Puts the first byte and the length before what `body` writes.
fn packet(first: u8, into: &mut Vec<u8>, body: impl FnOnce(&mut Vec<u8>)) {
    let start = into.len();
    into.extend_from_slice(&[first, 0, 0, 0, 0]);
    body(into);
    // As few bytes of length as it takes; room was left for four.
    let mut length = into.len() - start - 5;
    let mut digits = heapless::Vec::<u8, 4>::new();
    while digits.is_empty() || length > 0 {
        let more = if length > 0x7f { 0x80 } else { 0 };
        // The buffers are far shorter than 2²⁸.
        let _ = digits.push((length & 0x7f) as u8 | more);
        length >>= 7;
    }
    into[start + 1..start + 1 + digits.len()].copy_from_slice(&digits);
    into.drain(start + 1 + digits.len()..start + 5);
}

/// CONNECT.
pub(super) fn connect(hello: &Hello, into: &mut Vec<u8>) {
    packet(0x10, into, |into| {
        text(b"MQTT", into);
        // A clean session, and a will that is acknowledged and retained.
        let mut flags = 0b0010_1110;
        flags |= if hello.user.is_some() { 0x80 } else { 0 };
        flags |= if hello.password.is_some() { 0x40 } else { 0 };
        into.extend_from_slice(&[hello.version, flags]);
        into.extend_from_slice(&hello.keep_alive.to_be_bytes());
        let properties = hello.version == 5;
        into.extend(properties.then_some(0));
        text(hello.client.as_bytes(), into);
        into.extend(properties.then_some(0));
        text(hello.will.0.as_bytes(), into);
        text(hello.will.1.as_bytes(), into);
        for part in [hello.user, hello.password].into_iter().flatten() {
            text(part.as_bytes(), into);
        }
    });
}

/// PUBLISH.
pub(super) fn publish(version: u8, message: &Message, into: &mut Vec<u8>) {
    let again = message.number.is_some_and(|(_, again)| again);
    let quality = u8::from(message.number.is_some());
    let first = 0x30 | u8::from(again) << 3 | quality << 1 | u8::from(message.retain);
    packet(first, into, |into| {
        text(message.topic.as_bytes(), into);
        if let Some((number, _)) = message.number {
            into.extend_from_slice(&number.to_be_bytes());
        }
        into.extend((version == 5).then_some(0));
        into.extend_from_slice(message.payload);
    });
}

/// SUBSCRIBE with QoS 1.
pub(super) fn subscribe(version: u8, number: u16, topic: &str, into: &mut Vec<u8>) {
    packet(0x82, into, |into| {
        into.extend_from_slice(&number.to_be_bytes());
        into.extend((version == 5).then_some(0));
        text(topic.as_bytes(), into);
        into.push(1);
    });
}

/// PUBACK.
pub(super) fn acknowledge(number: u16, into: &mut Vec<u8>) {
    packet(0x40, into, |into| {
        into.extend_from_slice(&number.to_be_bytes())
    });
}

/// PINGREQ.
pub(super) fn ping(into: &mut Vec<u8>) {
    packet(0xc0, into, |_| {});
}

/// DISCONNECT.
pub(super) fn disconnect(into: &mut Vec<u8>) {
    packet(0xe0, into, |_| {});
}

/// A variable-length number of one to four bytes, and the rest; `None` while incomplete.
fn length(bytes: &[u8]) -> Result<Option<(usize, &[u8])>, Nonsense> {
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
    Err(Nonsense)
}

/// The first packet in `bytes` and its length; `None` while incomplete.
///
/// # Errors
/// If it is not a packet that a broker sends.
pub(super) fn read(version: u8, bytes: &[u8]) -> Result<Option<(Told<'_>, usize)>, Nonsense> {
    let Some((&first, rest)) = bytes.split_first() else {
        return Ok(None);
    };
    // Told at once: who talks something else may never say as much as its second byte promises.
    if !matches!(first, 0x20 | 0x30..=0x3f | 0x40 | 0x90 | 0xd0 | 0xe0) {
        return Err(Nonsense);
    }
    let Some((count, rest)) = length(rest)? else {
        return Ok(None);
    };
    let used = bytes.len() - rest.len() + count;
    if used > LONGEST {
        return Err(Nonsense);
    }
    let Some(body) = rest.get(..count) else {
        return Ok(None);
    };
    let number = |bytes: &[u8]| {
        bytes
            .first_chunk()
            .map(|two| u16::from_be_bytes(*two))
            .ok_or(Nonsense)
    };
    let told = match first {
        0x20 => Told::Connected(*body.get(1).ok_or(Nonsense)?),
        0x40 => Told::Acknowledged(number(body)?),
        0x90 if count >= 3 => Told::Subscribed(body[count - 1]),
        0xd0 if count == 0 => Told::Alive,
        0xe0 if version == 5 => Told::Goodbye,
        0x30..=0x3f => {
            let quality = first >> 1 & 3;
            let end = 2 + usize::from(number(body)?);
            let topic = body.get(2..end).ok_or(Nonsense)?;
            let mut rest = &body[end..];
            let mut asks = None;
            if quality > 0 {
                asks = Some(number(rest)?);
                rest = &rest[2..];
            }
            if version == 5 {
                let (properties, after) = length(rest)?.ok_or(Nonsense)?;
                rest = after.get(properties..).ok_or(Nonsense)?;
            }
            // We ask for no more than 1.
            if quality > 1 {
                return Err(Nonsense);
            }
            Told::Message {
                topic,
                payload: rest,
                retained: first & 1 == 1,
                number: asks,
            }
        }
        _ => return Err(Nonsense),
    };
    Ok(Some((told, used)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_are_those_of_the_standards() {
        let hello = Hello {
            version: 4,
            client: "c",
            keep_alive: 10,
            will: ("t", "off"),
            user: Some("u"),
            password: Some("p"),
        };
        let mut bytes = Vec::new();
        connect(&hello, &mut bytes);
        assert_eq!(
            bytes,
            b"\x10\x1b\0\x04MQTT\x04\xee\0\x0a\0\x01c\0\x01t\0\x03off\0\x01u\0\x01p"
        );
        bytes.clear();
        connect(
            &Hello {
                version: 5,
                user: None,
                password: None,
                ..hello
            },
            &mut bytes,
        );
        assert_eq!(
            bytes,
            b"\x10\x17\0\x04MQTT\x05\x2e\0\x0a\0\0\x01c\0\0\x01t\0\x03off"
        );
        let message = Message {
            topic: "a/b",
            payload: b"xyz",
            retain: true,
            number: Some((258, true)),
        };
        for (version, expected) in [
            (4, &b"\x3b\x0a\0\x03a/b\x01\x02xyz"[..]),
            (5, b"\x3b\x0b\0\x03a/b\x01\x02\0xyz"),
        ] {
            bytes.clear();
            publish(version, &message, &mut bytes);
            assert_eq!(bytes, expected);
            // What a client writes a broker passes on in the same form.
            let told = Told::Message {
                topic: b"a/b",
                payload: b"xyz",
                retained: true,
                number: Some(258),
            };
            assert_eq!(read(version, &bytes), Ok(Some((told, bytes.len()))));
            for cut in 0..bytes.len() {
                assert_eq!(read(version, &bytes[..cut]), Ok(None));
            }
        }
        bytes.clear();
        subscribe(4, 7, "a/+", &mut bytes);
        assert_eq!(bytes, b"\x82\x08\0\x07\0\x03a/+\x01");
        // Lengths of two bytes.
        bytes.clear();
        publish(
            4,
            &Message {
                payload: &[7; 300],
                ..message
            },
            &mut bytes,
        );
        assert_eq!(bytes[..3], [0x3b, 0xb3, 0x02]);
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
            assert_eq!(read(4, bad), Err(Nonsense), "{bad:?}");
        }
        let mut random = fastrand::Rng::with_seed(6);
        for _ in 0..200_000 {
            let bytes: Vec<u8> = (0..random.usize(..24)).map(|_| random.u8(..)).collect();
            if let Ok(Some((_, used))) = read(random.u8(4..6), &bytes) {
                assert!(used <= bytes.len());
            }
        }
    }
}
