//! Commands over OSC. By default only this machine can send them. If the configuration sets another address to listen on, local
//! networks and targets configured by IP address can too.
//!
//! | address | arguments | effect |
//! | --- | --- | --- |
//! | `/face/cmd/forget` | slot | discards everything learned about the user |
//! | `/face/cmd/freeze` | slot, 0 or 1 | resumes (0) or stops (1) learning for the user |
//! | `/face/cmd/neutral` | slot | uses the user's current face as the neutral one |
//! | `/face/cmd/level` | gesture, hundredths | moves the level at which a gesture goes on |
//! | `/face/cmd/hold` | gesture, hundredths of a second | sets how long it must be kept |
//! | `/face/cmd/teach` | gesture, 1 or 0 | finds both from five repetitions (1), or stops that (0) |
//! | `/face/cmd/undo` | gesture | returns to the level and hold time before |
//! | `/face/cmd/schema` | | sends the schema now: to the targets on the requester's host, or if there are none, back to the requester |
//!
//! Those of a gesture need `osc.levels`. Input is untrusted: a datagram is read into a fixed buffer, bundles may be nested twice, and the work per frame is limited; the
//! remaining datagrams wait in the socket, which the system bounds. A sender may make 16 requests at once and 4 per second; all
//! together 32 at once and 8 per second. Excess, malformed and unknown requests, wrong arguments and unknown slots are counted and
//! ignored; so is the rest of a datagram that cannot be separated. Nothing allocates. Limitation: with more than eight senders,
//! the one silent for longest starts with a full allowance when it returns.

use super::packet::{Argument, messages, parse};
use crate::Command;

/// Most arguments of a command.
const ARGUMENTS: usize = 2;

/// Request of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Send the names of the units now.
    Schema,
    /// A command for the pipeline.
    Command(Command),
}

/// Passes the requests of a datagram to `take`, which returns whether it accepts them; returns the number of refused messages.
pub fn requests(datagram: &[u8], prefix: &str, take: &mut dyn FnMut(Request) -> bool) -> u64 {
    let [_, refused] = messages(datagram, &mut |one| {
        message(one, prefix).is_some_and(&mut *take)
    });
    refused
}

fn message(bytes: &[u8], prefix: &str) -> Option<Request> {
    let mut arguments = heapless::Vec::<i32, ARGUMENTS>::new();
    let address = parse(bytes, |argument| {
        // Numbers from patching programs are often floats.
        let number = match argument {
            Argument::Int(number) => number,
            Argument::Float(number) => whole(number)?,
            Argument::Bool(truth) => truth.into(),
            Argument::Text(_) => return None,
        };
        arguments.push(number).ok()
    })?;
    let what = address.strip_prefix(prefix)?.strip_prefix("/cmd/")?;
    let (index, number) = match arguments[..] {
        [] if what == "schema" => return Some(Request::Schema),
        [index] => (index, None),
        [index, number] => (index, Some(number.try_into().ok()?)),
        _ => return None,
    };
    Command::named(what, index.try_into().ok()?, number).map(Request::Command)
}

/// The integer of a float without fraction, below 10⁶.
fn whole(number: f32) -> Option<i32> {
    (number % 1.0 == 0.0 && number.abs() < 1e6).then_some(number as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::osc::packet::{DEPTH, Packet};
    use mien_stages::base::capacity::USERS;

    fn read(bytes: &[u8]) -> (Vec<Request>, u64) {
        let mut all = Vec::new();
        let refused = requests(bytes, "/face", &mut |request| {
            all.push(request);
            true
        });
        (all, refused)
    }

    fn bundle(messages: &[(&str, &[Argument])]) -> Packet {
        let mut packet = Packet::default();
        for &(address, arguments) in messages {
            let arguments = arguments.iter().copied();
            assert!(packet.push("/face", format_args!("{address}"), arguments));
        }
        packet
    }

    #[test]
    fn commands_are_what_they_say() {
        use Argument::{Bool, Float, Int};
        let packet = bundle(&[
            ("/cmd/forget", &[Int(2)]),
            ("/cmd/freeze", &[Int(0), Int(1)]),
            ("/cmd/freeze", &[Float(3.0), Bool(false)]),
            ("/cmd/neutral", &[Float(1.0)]),
            ("/cmd/schema", &[]),
        ]);
        let expected = [
            Request::Command(Command::Forget(2)),
            Request::Command(Command::Freeze(0, true)),
            Request::Command(Command::Freeze(3, false)),
            Request::Command(Command::Neutral(1)),
            Request::Schema,
        ];
        assert_eq!(read(packet.bytes()), (expected.to_vec(), 0));
        // The same without a bundle around it.
        assert_eq!(read(&packet.bytes()[20..48]), (vec![expected[0]], 0));
    }

    #[test]
    fn commands_come_back_as_they_were_written() {
        let mut random = fastrand::Rng::with_seed(9);
        for _ in 0..2000 {
            let mut packet = Packet::default();
            let expected = (0..random.usize(..16)).map(|_| {
                let (slot, on) = (random.usize(..USERS), random.bool());
                let numbers = [slot as i32, on.into()];
                let (name, numbers, request) = match random.u8(..4) {
                    0 => ("forget", &numbers[..1], Some(Command::Forget(slot))),
                    1 => ("neutral", &numbers[..1], Some(Command::Neutral(slot))),
                    2 => ("freeze", &numbers[..], Some(Command::Freeze(slot, on))),
                    _ => ("schema", &numbers[..0], None),
                };
                let arguments = numbers.iter().copied().map(Argument::Int);
                assert!(packet.push("/face", format_args!("/cmd/{name}"), arguments));
                request.map_or(Request::Schema, Request::Command)
            });
            let expected: Vec<Request> = expected.collect();
            assert_eq!(read(packet.bytes()), (expected, 0));
        }
    }

    #[test]
    fn what_is_malformed_is_refused_one_by_one() {
        use Argument::{Float, Int, Text};
        let packet = bundle(&[
            ("/cmd/forget", &[Int(4)]),
            ("/cmd/forget", &[Int(-1)]),
            ("/cmd/forget", &[]),
            ("/cmd/forget", &[Int(0), Int(0), Int(0)]),
            ("/cmd/forget", &[Text("0")]),
            ("/cmd/freeze", &[Int(0), Int(2)]),
            ("/cmd/neutral", &[Float(f32::NAN)]),
            ("/cmd/neutral", &[Float(0.5)]),
            ("/cmd/fly", &[Int(0)]),
            ("/0/frame", &[Int(0)]),
            ("/cmd/neutral", &[Int(0)]),
        ]);
        let neutral = Request::Command(Command::Neutral(0));
        assert_eq!(read(packet.bytes()), (vec![neutral], 10));
        for bytes in [
            &b""[..],
            b"#bundle\0",
            b"/face",
            b"/face/cmd/schema\0\0\0\0",
        ] {
            assert_eq!(read(bytes), (vec![], 1), "{bytes:?}");
        }
    }

    #[test]
    fn deep_nests_are_not_followed() {
        let mut bytes = bundle(&[("/cmd/schema", &[])]).bytes().to_vec();
        for depth in 1..8 {
            assert_eq!(read(&bytes).0.len(), usize::from(depth <= DEPTH));
            let length = u32::try_from(bytes.len()).unwrap().to_be_bytes();
            let outer = [
                b"#bundle\0\0\0\0\0\0\0\0\x01".to_vec(),
                length.to_vec(),
                bytes,
            ];
            bytes = outer.concat();
        }
    }

    #[test]
    fn no_bytes_whatever_do_harm() {
        let mut random = fastrand::Rng::with_seed(7);
        let good = bundle(&[
            ("/cmd/forget", &[Argument::Int(2)]),
            ("/cmd/freeze", &[Argument::Int(0), Argument::Int(1)]),
        ]);
        for _ in 0..200_000 {
            let mut bytes = good.bytes().to_vec();
            for _ in 0..random.usize(1..6) {
                let i = random.usize(..bytes.len());
                bytes[i] = random.u8(..);
            }
            bytes.truncate(random.usize(..=bytes.len()));
            let (taken, _) = read(&bytes);
            assert!(taken.len() <= 2);
        }
    }
}
