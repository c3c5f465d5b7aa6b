//! What others write is read, what is written stands as they write it: messages of python-zeroconf 0.154 (PyPI).

use std::net::Ipv4Addr;

use super::message::{A, ANY, IN, LARGEST, Message, PTR, REPLY, Section, Writer};
use super::zone::{Service, Zone};

const HERE: Ipv4Addr = Ipv4Addr::new(192, 0, 2, 7);

/// A browser asks for `_osc._udp`.
const BROWSE: &[u8] = b"\0\0\0\0\0\x01\0\0\0\0\0\0\x04_osc\x04_udp\x05local\0\0\x0c\0\x01";
/// It asks for `_http._tcp` too, and knows our `_osc._udp`; names are compressed.
const KNOWS: &[u8] = b"\0\0\0\0\0\x02\0\x01\0\0\0\0\x04_osc\x04_udp\x05local\0\0\x0c\0\x01\
    \x05_http\x04_tcp\xc0\x16\0\x0c\0\x01\
    \xc0\x0c\0\x0c\0\x01\0\0\x11\x94\0\x0c\x09mien hall\xc0\x0c";
/// Another box of our name announces itself, at 192.0.2.8.
const OTHER: &[u8] = b"\0\0\x84\0\0\0\0\x04\0\0\0\0\x04_osc\x04_udp\x05local\0\0\x0c\0\x01\0\0\x11\x94\0\x0c\x09mien hall\xc0\x0c\
    \xc0\x27\0\x21\x80\x01\0\0\0\x78\0\x12\0\0\0\0\x23\xab\x09mien-hall\xc0\x16\
    \xc0\x27\0\x10\x80\x01\0\0\x11\x94\0\x01\0\
    \xc0\x45\0\x01\x80\x01\0\0\0\x78\0\x04\xc0\0\x02\x08";
/// What we answer to `BROWSE`, by RFC 1035 and 6762: the pointer, then the place, the text and the address.
const ANSWER: &[u8] = b"\0\0\x84\0\0\0\0\x01\0\0\0\x03\
    \x04_osc\x04_udp\x05local\0\0\x0c\0\x01\0\0\x11\x94\0\x1b\x09mien hall\x04_osc\x04_udp\x05local\0\
    \x09mien hall\x04_osc\x04_udp\x05local\0\0\x21\x80\x01\0\0\0\x78\0\x17\0\0\0\0\x23\xab\x09mien-hall\x05local\0\
    \x09mien hall\x04_osc\x04_udp\x05local\0\0\x10\x80\x01\0\0\x11\x94\0\x01\0\
    \x09mien-hall\x05local\0\0\x01\x80\x01\0\0\0\x78\0\x04\xc0\0\x02\x07";

fn zone() -> Zone {
    let osc = Service {
        kind: "_osc",
        transport: "_udp",
        port: 9131,
        text: "",
    };
    let web = Service {
        kind: "_http",
        transport: "_tcp",
        port: 9133,
        text: "path=/",
    };
    Zone::new("hall", vec![osc, web])
}

fn answer(query: &[u8], legacy: bool) -> Writer {
    zone().answer(&Message::read(query).unwrap(), HERE, legacy)
}

/// A question, as another would ask it.
fn asked(name: &[&str], kind: u16) -> Vec<u8> {
    let mut out = Writer::new(77, 0);
    out.question(name, kind, IN);
    out.bytes().to_vec()
}

#[test]
fn a_browser_is_answered_with_what_else_it_will_ask_for() {
    assert_eq!(answer(BROWSE, false).bytes(), ANSWER);
    let services = asked(&["_services", "_dns-sd", "_udp", "local"], PTR);
    assert_eq!(answer(&services, false).count(Section::Answers), 2);
    let whole = asked(&["mien hall", "_OSC", "_udp", "Local"], ANY);
    let whole = answer(&whole, false);
    let counts = [Section::Answers, Section::Additional].map(|of| whole.count(of));
    assert_eq!(counts, [2, 1]);
    for (name, kind) in [
        (&["_osc", "_tcp", "local"][..], PTR),
        (&["_osc", "_udp", "local"], A),
        (&["other", "local"], A),
    ] {
        let out = answer(&asked(name, kind), false);
        assert_eq!(out.count(Section::Answers), 0, "{name:?}");
    }
}

#[test]
fn who_is_no_responder_gets_the_question_back_and_ten_seconds() {
    let out = answer(&asked(&["mien-hall", "local"], A), true);
    let expected = b"\0\x4d\x84\0\0\x01\0\x01\0\0\0\0\x09mien-hall\x05local\0\0\x01\0\x01\
        \x09mien-hall\x05local\0\0\x01\0\x01\0\0\0\x0a\0\x04\xc0\0\x02\x07";
    assert_eq!(out.bytes(), expected);
}

#[test]
fn what_the_asker_knows_is_not_told_again() {
    let out = answer(KNOWS, false);
    assert_eq!(out.count(Section::Answers), 1);
    assert!(out.bytes().windows(5).any(|part| part == b"_http"));
    // With a third of its time left, it is.
    let mut stale = KNOWS.to_vec();
    let at = stale.windows(2).position(|two| two == [0x11, 0x94]);
    stale[at.unwrap()..][..2].copy_from_slice(&1500_u16.to_be_bytes());
    assert_eq!(answer(&stale, false).count(Section::Answers), 2);
}

#[test]
fn a_name_that_another_has_is_left_to_them() {
    let mut zone = zone();
    let heard = Message::read(OTHER).unwrap();
    assert_eq!((heard.records.len(), heard.answers), (4, 4));
    assert!(zone.is_taken(&heard, |address| address == HERE));
    let there = Ipv4Addr::new(192, 0, 2, 8);
    assert!(
        !zone.is_taken(&heard, |address| address == there),
        "it is ours"
    );
    // The same host, with another port.
    let mut other = OTHER.to_vec();
    let at = other
        .windows(2)
        .position(|two| two == [0x23, 0xab])
        .unwrap();
    other[at] = 0;
    let other = Message::read(&other).unwrap();
    assert!(zone.is_taken(&other, |address| address == there));
    zone.call(2);
    assert_eq!(
        (zone.instance.as_str(), zone.host.as_str()),
        ("mien hall-2", "mien-hall-2")
    );
    assert!(!zone.is_taken(&heard, |address| address == HERE));
}

#[test]
fn no_bytes_whatever_do_harm() {
    let zone = zone();
    let mut out = Writer::new(0, REPLY);
    zone.announce(HERE, &mut out);
    out.question(&["_osc", "_udp", "local"], PTR, IN);
    let mut random = fastrand::Rng::with_seed(8);
    for good in [out.bytes(), KNOWS, OTHER] {
        for _ in 0..40_000 {
            let mut bytes = good.to_vec();
            for _ in 0..random.usize(1..8) {
                let at = random.usize(..bytes.len());
                bytes[at] = random.u8(..);
            }
            bytes.truncate(random.usize(12..=bytes.len()));
            if let Some(heard) = Message::read(&bytes) {
                let out = zone.answer(&heard, HERE, random.bool());
                assert!(out.bytes().len() <= LARGEST);
                zone.is_taken(&heard, |_| false);
            }
        }
    }
    // A name that leads to itself.
    let mut circle = vec![0; 12];
    circle[5] = 1;
    circle.extend([0xc0, 12, 0, 12, 0, 1]);
    assert!(Message::read(&circle).is_none());
}
