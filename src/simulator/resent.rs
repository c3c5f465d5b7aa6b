//! A frame sent again: cut into the packets a Kinect would have sent, and made of them once more, step by step.

use crate::sensor::Frame;
use crate::sensor::kinect::device::Stream;
use crate::sensor::kinect::driver::{develop_colour, develop_depth};
use crate::sensor::kinect::frame::KinectFrame;
use crate::sensor::kinect::packet::LONGEST;
use crate::sensor::kinect::pairing::{Pairing, RawPair};
use crate::sensor::kinect::stream::{Assembler, Cutter};
use crate::sensor::kinect::unpack::{PACKED_DEPTH, pack_depth};

/// A frame and its packets, as both streams send them, and where they become pictures again.
pub struct Resent {
    /// The frame to send.
    pub drawn: KinectFrame,
    cutters: [Cutter; 2],
    packed: Box<[u8; PACKED_DEPTH]>,
    /// Stream, length and bytes of each packet, in order of time.
    cut: Vec<(Stream, usize, [u8; LONGEST])>,
    assemblers: [Assembler; 2],
    pairing: Pairing,
    pair: RawPair,
}

impl Default for Resent {
    fn default() -> Self {
        let packed = vec![0; PACKED_DEPTH].into_boxed_slice();
        Self {
            drawn: KinectFrame::default(),
            cutters: Stream::BOTH.map(|stream| Cutter::new(stream, 0)),
            packed: packed.try_into().expect("PACKED_DEPTH long"),
            cut: Vec::new(),
            assemblers: Stream::BOTH.map(Assembler::new),
            pairing: Pairing::default(),
            pair: RawPair::default(),
        }
    }
}

impl Resent {
    /// Cuts the frame into packets.
    pub fn cut(&mut self) {
        let frame = &self.drawn;
        pack_depth(&frame.depth, &mut self.packed);
        self.cut.clear();
        // Where there is no colour a black picture makes the same way.
        let colour_ticks = if frame.has_colour {
            frame.original.colour_ticks
        } else {
            frame.original.ticks
        };
        let total = self
            .cutters
            .each_ref()
            .map(|cutter| cutter.layout().packets());
        let mut sent = [0; 2];
        while sent != total {
            // The stream that is behind in its picture.
            let i = usize::from(sent[1] * total[0] < sent[0] * total[1] || sent[0] == total[0]);
            let (picture, ticks): (&[u8], u32) = match Stream::BOTH[i] {
                Stream::Colour => (frame.original.bayer.as_slice(), colour_ticks),
                Stream::Depth => (self.packed.as_slice(), frame.original.ticks),
            };
            let mut packet = [0; LONGEST];
            let n = self.cutters[i].cut(picture, ticks, sent[i], &mut packet);
            self.cut.push((Stream::BOTH[i], n, packet));
            sent[i] += 1;
        }
    }

    /// Packets to pictures; `number` counts frames.
    pub fn assemble(&mut self, number: u64) {
        for (stream, length, bytes) in &self.cut {
            let assembler = &mut self.assemblers[stream.index()];
            if let Some(ticks) = assembler.push(true, &bytes[..*length])
                && let Some(paired) =
                    (self.pairing).offer(*stream, number, ticks, assembler.picture())
            {
                paired.swap_into(&mut self.pair);
            }
        }
    }

    /// Depth pictures to raw values.
    pub fn unpack(&self, frame: &mut Frame) {
        develop_depth(&self.pair, frame);
    }

    /// Mosaic to luma.
    pub fn develop(&self, frame: &mut Frame) {
        develop_colour(&self.pair, frame);
    }
}
