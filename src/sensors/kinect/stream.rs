//! Packets of one stream to whole pictures. A picture is delivered whole or not at all, and losses are counted by reason.
//!
//! A picture is whole if all its packets arrived, in sequence, with the flag and length their position demands. The 8-bit
//! sequence alone would mistake a loss of 256 + k packets for one of k; here any gap ends the picture, and a loss of a
//! multiple of 256 shows when the last flag arrives at the wrong place. Only a loss of exactly 128 pictures (4.3 s) would
//! pass; the driver restarts a stream that is silent for a second.
//!
//! Memory: one picture, allocated once, plus what the caller swaps in. Cost: one copy of the payload. Limitations: a run of
//! lost packets longer than 255 is counted modulo 256; damage inside the payload is visible only if the bus reports it.

use super::device::Stream;
use super::packet::{HEADER, Header, Place};
use super::unpack::PACKED_DEPTH;
use mien_stages::base::capacity::PIXELS;
#[cfg(not(feature = "std"))]
use mien_stages::base::prelude::*;

/// How a stream's pictures are cut into packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Bytes of a picture.
    pub bytes: usize,
    /// Payload of every packet but the last.
    pub payload: usize,
}

impl Layout {
    /// Of the formats used: packed 11-bit depth and Bayer, both 640×480.
    pub const fn of(stream: Stream) -> Self {
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

    /// Packets of a picture.
    pub const fn packets(&self) -> usize {
        self.bytes.div_ceil(self.payload)
    }

    /// Bytes of the picture that packet `number` carries.
    pub fn range(&self, number: usize) -> core::ops::Range<usize> {
        let start = number * self.payload;
        start..self.bytes.min(start + self.payload)
    }

    /// Flag of packet `number`.
    pub const fn place(&self, number: usize) -> Place {
        if number == 0 {
            Place::First
        } else if number + 1 == self.packets() {
            Place::Last
        } else {
            Place::Middle
        }
    }
}

/// What happened on one stream, by reason. Packets unless said otherwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Pictures delivered whole.
    pub pictures: u64,
    /// Pictures begun (or found running) and given up.
    pub broken: u64,
    /// Packets with a valid header.
    pub packets: u64,
    /// Missing from the sequence, those with an error of the bus among them.
    pub lost: u64,
    /// Came twice; the second was ignored.
    pub repeated: u64,
    /// Header unreadable.
    pub damaged: u64,
    /// Microframes that the bus reported bad, with or without a packet in them.
    pub bus_errors: u64,
    /// Header whole, payload of the wrong length; or too short for a header.
    pub wrong_length: u64,
    /// Flag does not fit the place in the picture.
    pub misplaced: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Switched on in the middle of a picture: wait for the next.
    Joining,
    /// The next packet opens a picture.
    Between,
    /// So many packets are in.
    Filling(usize),
    /// Given up; wait for the next picture.
    Broken,
}

/// Assembles the pictures of one stream.
pub struct Assembler {
    stream: Stream,
    layout: Layout,
    /// The buffer behind the picture that [`Self::push`] has just completed; it may be swapped for another of the same length.
    pub picture: Box<[u8]>,
    state: State,
    previous: Option<Header>,
    /// Packets since `previous` that came but could not be read: their numbers are missing without being lost.
    unreadable: u8,
    /// Counts so far.
    pub tally: Tally,
}

impl Assembler {
    /// Waits for the first picture of `stream`.
    pub fn new(stream: Stream) -> Self {
        let layout = Layout::of(stream);
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

    /// Forgets the picture in progress and the sequence, keeps the tally: after the stream was stopped.
    pub fn restart(&mut self) {
        (self.state, self.previous, self.unreadable) = (State::Joining, None, 0);
    }

    /// Takes what came in one microframe. `Some(ticks)` if that completed a picture; it stays in [`Self::picture`] until
    /// the next call.
    pub fn push(&mut self, intact: bool, bytes: &[u8]) -> Option<u32> {
        if !intact {
            // Whether the microframe held a packet, and so a number, only the sequence can tell.
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
                self.give_up();
            }
        }
        self.unreadable = 0;
        self.previous = Some(header);
        self.place(header, &bytes[HEADER..])
    }

    fn give_up(&mut self) {
        // Between pictures nothing is spoilt: if a first packet was lost, its followers show it.
        if let State::Filling(_) = self.state {
            self.tally.broken += 1;
            self.state = State::Broken;
        }
    }

    fn place(&mut self, header: Header, payload: &[u8]) -> Option<u32> {
        let number = match (self.state, header.place) {
            (State::Filling(number), place) if place == self.layout.place(number) => number,
            (State::Filling(_), _) => {
                self.tally.misplaced += 1;
                self.give_up();
                if header.place != Place::First {
                    return None;
                }
                0
            }
            (_, Place::First) => 0,
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
        if header.place == Place::Last {
            self.state = State::Between;
            self.tally.pictures += 1;
            return Some(header.ticks);
        }
        self.state = State::Filling(number + 1);
        None
    }
}

/// Cuts a picture into packets: the camera's side of [`Assembler`].
#[derive(Clone, Debug)]
pub struct Cutter {
    stream: Stream,
    /// How pictures are cut.
    pub layout: Layout,
    sequence: u8,
}

impl Cutter {
    /// Starts at `sequence`, which the camera chooses as it likes.
    pub const fn new(stream: Stream, sequence: u8) -> Self {
        Self {
            stream,
            layout: Layout::of(stream),
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
            place: self.layout.place(number),
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
