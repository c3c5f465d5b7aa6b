//! One OSC datagram: a bundle of messages in a fixed buffer (Open Sound Control 1.0). Strings are padded with 1 to 4 zeros to a
//! multiple of four; numbers have 32 bits, big endian; each message is preceded by its length. Nothing allocates.

use core::fmt::Write;

/// Largest datagram that Ethernet carries unfragmented, bytes: 1500 minus the IP and UDP headers.
pub(super) const LARGEST: usize = 1472;
/// Header of a bundle; the time tag 1 means "immediately", so that clocks need not agree.
const HEADER: [u8; 16] = *b"#bundle\0\0\0\0\0\0\0\0\x01";

/// An argument of a message.
#[derive(Clone, Copy, Debug)]
pub enum Argument<'a> {
    /// Tag `i`.
    Int(i32),
    /// Tag `f`.
    Float(f32),
    /// Tag `T` or `F`.
    Bool(bool),
    /// Tag `s`.
    Text(&'a str),
}

/// A bundle being filled.
pub struct Packet(heapless::Vec<u8, LARGEST>);

impl Default for Packet {
    /// A bundle without messages.
    fn default() -> Self {
        Self(HEADER.into_iter().collect())
    }
}

impl Packet {
    pub(crate) fn clear(&mut self) {
        self.0.truncate(HEADER.len());
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.0.len() == HEADER.len()
    }

    /// The bundle as it is sent.
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }

    /// Appends a message with the address `prefix` + `address`; if there is no room, appends nothing and returns `false`.
    pub fn push<'a>(
        &mut self,
        prefix: &str,
        address: core::fmt::Arguments,
        arguments: impl Iterator<Item = Argument<'a>> + Clone,
    ) -> bool {
        let start = self.0.len();
        let fits = self.append(prefix, address, arguments).is_ok();
        if fits {
            let length = (self.0.len() - start - 4) as u32;
            self.0[start..start + 4].copy_from_slice(&length.to_be_bytes());
        } else {
            self.0.truncate(start);
        }
        fits
    }

    fn append<'a>(
        &mut self,
        prefix: &str,
        address: core::fmt::Arguments,
        arguments: impl Iterator<Item = Argument<'a>> + Clone,
    ) -> core::fmt::Result {
        // Placeholder of the length.
        self.put(&[0; 4])?;
        let start = self.0.len();
        self.put(prefix.as_bytes())?;
        self.0.write_fmt(address)?;
        self.end_string(start)?;
        let start = self.0.len();
        self.put(b",")?;
        for argument in arguments.clone() {
            self.put(match argument {
                Argument::Int(_) => b"i",
                Argument::Float(_) => b"f",
                Argument::Bool(true) => b"T",
                Argument::Bool(false) => b"F",
                Argument::Text(_) => b"s",
            })?;
        }
        self.end_string(start)?;
        for argument in arguments {
            match argument {
                Argument::Int(value) => self.put(&value.to_be_bytes())?,
                Argument::Float(value) => self.put(&value.to_be_bytes())?,
                // The tag holds the value.
                Argument::Bool(_) => {}
                Argument::Text(text) => {
                    let start = self.0.len();
                    self.put(text.as_bytes())?;
                    self.end_string(start)?;
                }
            }
        }
        Ok(())
    }

    fn end_string(&mut self, start: usize) -> core::fmt::Result {
        let zeros = 4 - (self.0.len() - start) % 4;
        self.put(&[0; 4][..zeros])
    }

    fn put(&mut self, bytes: &[u8]) -> core::fmt::Result {
        let put = self.0.extend_from_slice(bytes);
        put.map_err(|_| core::fmt::Error)
    }
}

/// Nesting depth at which bundles are refused.
pub(super) const DEPTH: usize = 3;

/// Passes every message of a datagram to `take`, which returns whether it accepts it; returns the numbers of accepted and refused
/// messages. A part that cannot be separated or is nested too deeply counts as one refused. Time tags are ignored.
pub fn messages(datagram: &[u8], take: &mut dyn FnMut(&[u8]) -> bool) -> [u64; 2] {
    let mut counts = [0; 2];
    let mut counted = |taken: bool| counts[usize::from(!taken)] += 1;
    elements(datagram, DEPTH, &mut counted, take);
    counts
}

fn elements(
    bytes: &[u8],
    depth: usize,
    counted: &mut dyn FnMut(bool),
    take: &mut dyn FnMut(&[u8]) -> bool,
) {
    let Some(bundle) = bytes.strip_prefix(b"#bundle\0") else {
        return counted(take(bytes));
    };
    let Some(mut rest) = bundle.get(8..).filter(|_| depth > 0) else {
        return counted(false);
    };
    while let Some((length, after)) = rest.split_first_chunk::<4>() {
        let Some((inner, after)) = after.split_at_checked(u32::from_be_bytes(*length) as usize)
        else {
            break;
        };
        elements(inner, depth - 1, counted, take);
        rest = after;
    }
    if !rest.is_empty() {
        counted(false);
    }
}

/// A string, and the bytes after its padding; `None` if it is malformed.
fn string(bytes: &[u8]) -> Option<(&str, &[u8])> {
    let end = bytes.iter().position(|&byte| byte == 0)?;
    let (text, rest) = bytes.split_at_checked(end / 4 * 4 + 4)?;
    let zeros = text[end..].iter().all(|&byte| byte == 0);
    let text = core::str::from_utf8(&text[..end]).ok();
    Some((text.filter(|_| zeros)?, rest))
}

/// Passes every argument of a message to `take`; returns the address, or `None` if the message is malformed or `take` refuses an
/// argument.
pub fn parse<'a>(
    message: &'a [u8],
    mut take: impl FnMut(Argument<'a>) -> Option<()>,
) -> Option<&'a str> {
    let (address, rest) = string(message)?;
    let (tags, mut rest) = string(rest)?;
    for tag in tags.strip_prefix(',')?.chars() {
        take(match tag {
            'i' | 'f' => {
                let (bits, after) = rest.split_first_chunk()?;
                rest = after;
                let bits = u32::from_be_bytes(*bits);
                match tag {
                    'i' => Argument::Int(bits.cast_signed()),
                    _ => Argument::Float(f32::from_bits(bits)),
                }
            }
            's' => {
                let (text, after) = string(rest)?;
                rest = after;
                Argument::Text(text)
            }
            // A Bool has no bytes.
            'T' | 'F' => Argument::Bool(tag == 'T'),
            _ => return None,
        })?;
    }
    rest.is_empty().then_some(address)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(hex: &str) -> Vec<u8> {
        hex.split_whitespace()
            .map(|byte| u8::from_str_radix(byte, 16).unwrap())
            .collect()
    }

    #[test]
    fn one_weight_is_the_reference_message() {
        let mut packet = Packet::default();
        let weight = [Argument::Float(0.5)].into_iter();
        assert!(packet.push("/face", format_args!("/0/au/AU12"), weight));
        let message =
            bytes("2f 66 61 63 65 2f 30 2f 61 75 2f 41 55 31 32 00 2c 66 00 00 3f 00 00 00");
        assert_eq!(packet.bytes()[16..20], [0, 0, 0, 24]);
        assert_eq!(packet.bytes()[20..], message);
    }

    #[test]
    fn a_bundle_is_the_reference_bundle() {
        let mut packet = Packet::default();
        let arguments = [Argument::Text("jawOpen"), Argument::Float(0.25)].into_iter();
        assert!(packet.push("/VMC", format_args!("/Ext/Blend/Val"), arguments));
        let none = core::iter::empty();
        assert!(packet.push("/VMC", format_args!("/Ext/Blend/Apply"), none));
        let expected = bytes(
            "23 62 75 6e 64 6c 65 00 00 00 00 00 00 00 00 01 00 00 00 24 2f 56 4d 43 2f 45 78 74 2f 42 6c 65 6e 64 2f 56 \
             61 6c 00 00 2c 73 66 00 6a 61 77 4f 70 65 6e 00 3e 80 00 00 00 00 00 1c 2f 56 4d 43 2f 45 78 74 2f 42 6c 65 \
             6e 64 2f 41 70 70 6c 79 00 00 00 00 2c 00 00 00",
        );
        assert_eq!(packet.bytes(), expected);
    }

    #[test]
    fn another_decoder_reads_back_whatever_is_written() {
        use rosc::OscType;
        let mut random = fastrand::Rng::with_seed(3);
        for _ in 0..5000 {
            let mut text = |_| -> String {
                let letters = 0..random.usize(..12);
                letters.map(|_| random.alphanumeric()).collect()
            };
            let texts: Vec<String> = (0..8).map(&mut text).collect();
            let mut packet = Packet::default();
            let mut expected = Vec::new();
            loop {
                let address = &texts[random.usize(..8)];
                let arguments: Vec<(Argument, OscType)> = (0..random.usize(..24))
                    .map(|_| match random.u8(..4) {
                        0 => {
                            let number = random.i32(..);
                            (Argument::Int(number), OscType::Int(number))
                        }
                        1 => {
                            let number = f32::from_bits(random.u32(..) & 0xff7f_ffff);
                            (Argument::Float(number), OscType::Float(number))
                        }
                        2 => {
                            let truth = random.bool();
                            (Argument::Bool(truth), OscType::Bool(truth))
                        }
                        _ => {
                            let text = &texts[random.usize(..8)];
                            (Argument::Text(text), OscType::String(text.clone()))
                        }
                    })
                    .collect();
                let ours = arguments.iter().map(|(ours, _)| *ours);
                if !packet.push("/p", format_args!("/{address}"), ours) {
                    break;
                }
                let theirs = arguments.into_iter().map(|(_, theirs)| theirs);
                expected.push((format!("/p/{address}"), theirs.collect::<Vec<_>>()));
            }
            assert!(packet.bytes().len() <= LARGEST && packet.bytes().len().is_multiple_of(4));
            let (rest, read) = rosc::decoder::decode_udp(packet.bytes()).unwrap();
            let rosc::OscPacket::Bundle(bundle) = read else {
                panic!("not a bundle")
            };
            let read = bundle.content.into_iter().map(|packet| match packet {
                rosc::OscPacket::Message(message) => (message.addr, message.args),
                rosc::OscPacket::Bundle(_) => panic!("bundle in a bundle"),
            });
            let read: Vec<_> = read.collect();
            assert!(rest.is_empty());
            assert_eq!(read, expected);
        }
    }

    #[test]
    fn what_does_not_fit_leaves_no_trace() {
        let mut packet = Packet::default();
        let frame = |packet: &mut Packet, numbers| {
            let numbers = core::iter::repeat_n(Argument::Int(1), numbers);
            packet.push("/face", format_args!("/0/frame"), numbers)
        };
        let mut count = 0;
        while frame(&mut packet, 1) {
            count += 1;
        }
        // 16 + 28 n ≤ 1472: length 4, address 16, tags 4, number 4.
        assert_eq!((count, packet.bytes().len()), (52, 16 + 52 * 28));
        let before = packet.bytes().to_vec();
        assert!(!frame(&mut packet, 400));
        assert_eq!(packet.bytes(), before);
    }
}
