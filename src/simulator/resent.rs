//! A frame sent again: cut into the packets a Kinect would have sent, and made of them once more, step by step.

use core::time::Duration;

use super::virtual_kinect::{PERIOD, Player, STEP, View};
use mien_sensors::Frame;
use mien_sensors::kinect::device::Stream;
use mien_sensors::kinect::driver::{develop_colour, develop_depth};
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::packet::LONGEST;
use mien_sensors::kinect::pairing::{Pairing, RawPair};
use mien_sensors::kinect::stream::Assembler;
use mien_stages::base::defaults;

defaults! {
    /// A frame and its packets, as both streams send them, and where they become pictures again.
    pub struct Resent {
        player: Player<Drawn> = Player::new(Drawn(KinectFrame::default()), PERIOD),
        now: Duration = Duration::ZERO,
        /// Stream, length and bytes of each packet, in order of time.
        cut: Vec<(Stream, usize, [u8; LONGEST])> = Vec::new(),
        assemblers: [Assembler; 2] = Stream::BOTH.map(Assembler::new),
        pairing: Pairing = Pairing::default(),
        pair: RawPair = RawPair::default(),
    }
}

/// What the player sends next.
struct Drawn(KinectFrame);

impl View for Drawn {
    fn draw(&mut self, frame: &mut KinectFrame) -> bool {
        core::mem::swap(&mut self.0, frame);
        // Where there is no colour a black picture makes the same way.
        if !frame.has_colour {
            frame.original.colour_ticks = frame.original.ticks;
        }
        true
    }
}

impl Resent {
    /// Where to put the next frame to send.
    pub fn next_frame(&mut self) -> &mut KinectFrame {
        &mut self.player.view.0
    }

    /// The frame that was cut last.
    pub fn sent(&self) -> &Frame {
        &self.player.frame
    }

    /// Cuts the frame into packets.
    pub fn cut(&mut self) {
        self.cut.clear();
        let end = self.now + PERIOD;
        while self.now < end {
            self.player.play(self.now, [true; 2], &mut |packet| {
                let mut bytes = [0; LONGEST];
                bytes[..packet.bytes.len()].copy_from_slice(packet.bytes);
                self.cut.push((packet.stream, packet.bytes.len(), bytes));
            });
            self.now += STEP;
        }
        self.now = end;
    }

    /// Packets to pictures; `number` counts frames.
    pub fn assemble(&mut self, number: u64) {
        for (stream, length, bytes) in &self.cut {
            let assembler = &mut self.assemblers[stream.index()];
            if let Some(ticks) = assembler.push(true, &bytes[..*length])
                && let Some(paired) =
                    (self.pairing).offer(*stream, number, ticks, &mut assembler.picture)
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
