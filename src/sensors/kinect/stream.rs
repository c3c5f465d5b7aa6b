//! Assembles the packets of one stream to whole pictures; incomplete pictures are discarded, and losses are counted by reason.
//!
//! A picture is whole if all its packets arrive in sequence, with the flag and length of their position. Any gap in the 8-bit
//! sequence ends the picture; a loss of a multiple of 256 packets shows because the last flag arrives at the wrong position. Only a
//! loss of exactly 128 pictures (4.3 s) would pass, but the driver restarts a stream that is silent for a second.
//!
//! Memory: one picture, allocated once. Cost: one copy of the payload. Limitations: runs of more than 255 lost packets are counted
//! modulo 256; damage inside the payload is detected only if the bus reports it.

use super::device::Stream;
use super::packet::{HEADER, Header, Position};
use super::unpack::PACKED_DEPTH;
use mien_stages::base::capacity::PIXELS;
#[cfg(not(feature = "std"))]
use mien_stages::base::prelude::*;

/// Division of a stream's pictures into packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Bytes of a picture.
    pub bytes: usize,
    /// Bytes of payload of every packet but the last.
    pub payload: usize,
}

impl Layout {
    /// Layout of the formats used: packed 11-bit depth and Bayer, both 640×480.
    pub const fn new(stream: Stream) -> Self {
        match stream {
            Stream::Depth => Self {
                bytes: PACKED_DEPTH,
                payload: 1748,
            },
            Stream::Colour => Self {
                bytes: PIXELS,
                payload: 1908,
            },
        }
    }

    /// Number of packets of a picture.
    pub const fn packets(&self) -> usize {
        self.bytes.div_ceil(self.payload)
    }

    /// Range of the picture's bytes in packet `number`.
    pub fn range(&self, number: usize) -> core::ops::Range<usize> {
        let start = number * self.payload;
        start..self.bytes.min(start + self.payload)
    }

    /// Position of packet `number`.
    pub const fn position(&self, number: usize) -> Position {
        if number == 0 {
            Position::First
        } else if number + 1 == self.packets() {
            Position::Last
        } else {
            Position::Middle
        }
    }
}

/// Counters of one stream; of packets unless stated otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Pictures delivered whole.
    pub pictures: u64,
    /// Pictures discarded as incomplete.
    pub broken: u64,
    /// Packets with a valid header.
    pub packets: u64,
    /// Missing from the sequence, including those with bus errors.
    pub lost: u64,
    /// Received twice; the second one was ignored.
    pub repeated: u64,
    /// Invalid header.
    pub damaged: u64,
    /// Microframes with a bus error, with or without a packet.
    pub bus_errors: u64,
    /// Wrong length of payload, or too short for a header.
    pub wrong_length: u64,
    /// Flag does not match the position in the picture.
    pub misplaced: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Just started, possibly in the middle of a picture: wait for the next one.
    Joining,
    /// The next packet opens a picture.
    Between,
    /// This number of packets has been received.
    Filling(usize),
    /// Discarded: wait for the next picture.
    Broken,
}

/// Assembles the pictures of one stream.
pub struct Assembler {
    stream: Stream,
    layout: Layout,
    /// The picture, valid when [`Self::push`] has just completed it; may be swapped for another buffer of the same length.
    pub picture: Box<[u8]>,
    state: State,
    previous: Option<Header>,
    /// Unreadable packets since `previous`, whose sequence numbers are missing but not lost.
    unreadable: u8,
    /// Counters so far.
    pub tally: Tally,
}

impl Assembler {
    /// An assembler waiting for the first picture of `stream`.
    pub fn new(stream: Stream) -> Self {
        let layout = Layout::new(stream);
        Self {
            stream,
            layout,
            picture: vec![0; layout.bytes].into_boxed_slice(),
            state: State::Joining,
            previous: None,
            unreadable: 0,
            tally: Tally::default(),
        }
    }

    /// Discards the picture in progress and the sequence, after the stream was stopped; keeps the counters.
    pub fn restart(&mut self) {
        (self.state, self.previous, self.unreadable) = (State::Joining, None, 0);
    }

    /// Takes the bytes of one microframe. Returns the time stamp if they complete a picture, which stays in [`Self::picture`] until
    /// the next call.
    pub fn push(&mut self, intact: bool, bytes: &[u8]) -> Option<u32> {
        if !intact {
            // Only the sequence shows whether the microframe had a packet.
            self.tally.bus_errors += 1;
            return None;
        }
        if bytes.is_empty() {
            return None;
        }
        let Some(header) = Header::parse(bytes, self.stream) else {
            if bytes.len() < HEADER {
                self.tally.wrong_length += 1;
            } else {
                self.tally.damaged += 1;
            }
            self.unreadable = self.unreadable.saturating_add(1);
            return None;
        };
        if self.previous == Some(header) {
            self.tally.repeated += 1;
            return None;
        }
        self.tally.packets += 1;
        if let Some(previous) = self.previous {
            let step = header.sequence.wrapping_sub(previous.sequence);
            let gap = step.wrapping_sub(1);
            if gap != 0 {
                self.tally.lost += u64::from(gap.saturating_sub(self.unreadable));
                self.abandon_picture();
            }
        }
        self.unreadable = 0;
        self.previous = Some(header);
        self.insert(header, &bytes[HEADER..])
    }

    fn abandon_picture(&mut self) {
        // Between pictures nothing is lost yet: a lost first packet shows at the next one.
        if let State::Filling(_) = self.state {
            self.tally.broken += 1;
            self.state = State::Broken;
        }
    }

    fn insert(&mut self, header: Header, payload: &[u8]) -> Option<u32> {
        let number = match (self.state, header.position) {
            (State::Filling(number), position) if position == self.layout.position(number) => {
                number
            }
            (State::Filling(_), _) => {
                self.tally.misplaced += 1;
                self.abandon_picture();
                if header.position != Position::First {
                    return None;
                }
                0
            }
            (_, Position::First) => 0,
            (State::Between, _) => {
                self.tally.broken += 1;
                self.state = State::Broken;
                return None;
            }
            (State::Broken | State::Joining, _) => return None,
        };
        let range = self.layout.range(number);
        if payload.len() != range.len() {
            self.tally.wrong_length += 1;
            self.tally.broken += 1;
            self.state = State::Broken;
            return None;
        }
        self.picture[range].copy_from_slice(payload);
        if header.position == Position::Last {
            self.state = State::Between;
            self.tally.pictures += 1;
            return Some(header.ticks);
        }
        self.state = State::Filling(number + 1);
        None
    }
}

/// Cuts pictures into packets; the camera's counterpart of [`Assembler`].
#[derive(Clone, Debug)]
pub struct Cutter {
    stream: Stream,
    /// Division of the pictures.
    pub layout: Layout,
    sequence: u8,
}

impl Cutter {
    /// Numbers packets from `sequence`, which is arbitrary.
    pub const fn new(stream: Stream, sequence: u8) -> Self {
        Self {
            stream,
            layout: Layout::new(stream),
            sequence,
        }
    }

    /// Writes packet `number` of a picture into `packet` and returns its length.
    pub fn cut(
        &mut self,
        picture: &[u8],
        ticks: u32,
        number: usize,
        packet: &mut [u8; super::packet::LONGEST],
    ) -> usize {
        let payload = &picture[self.layout.range(number)];
        let header = Header {
            stream: self.stream,
            position: self.layout.position(number),
            sequence: self.sequence,
            ticks,
        };
        self.sequence = self.sequence.wrapping_add(1);
        packet[..HEADER].copy_from_slice(&header.emit(payload.len()));
        packet[HEADER..HEADER + payload.len()].copy_from_slice(payload);
        HEADER + payload.len()
    }
}

#[cfg(test)]
mod tests;
