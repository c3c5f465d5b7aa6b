//! Cuts a frame into a Kinect's packets and assembles it again, step by step, for benchmarks.

use core::time::Duration;

use super::virtual_kinect::{FrameSource, PERIOD, Player, STEP};
use mien_sensors::Frame;
use mien_sensors::kinect::device::Stream;
use mien_sensors::kinect::driver::{depth_from_pair, luma_from_pair};
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::pairing::{Pairing, RawPair};
use mien_sensors::kinect::stream::Assembler;
use mien_stages::base::defaults;

defaults! {
    /// A frame, its packets on both streams, and the pictures assembled from them.
    pub struct PacketRoundTrip {
        player: Player<NextFrame> = Player::new(NextFrame(KinectFrame::default()), PERIOD),
        now: Duration = Duration::ZERO,
        /// Stream and length of each packet, in time order.
        packets: Vec<(Stream, usize)> = Vec::new(),
        /// Their bytes, one after another.
        bytes: Vec<u8> = Vec::new(),
        assemblers: [Assembler; 2] = Stream::BOTH.map(Assembler::new),
        pairing: Pairing = Pairing::default(),
        pair: RawPair = RawPair::default(),
    }
}

/// The frame that the player sends next.
struct NextFrame(KinectFrame);

impl FrameSource for NextFrame {
    fn draw(&mut self, frame: &mut KinectFrame) -> bool {
        core::mem::swap(&mut self.0, frame);
        // Without colour a black picture is sent.
        if !frame.has_colour {
            frame.original.colour_ticks = frame.original.ticks;
        }
        true
    }
}

impl PacketRoundTrip {
    /// The frame to send next, to be filled by the caller.
    pub fn next_frame(&mut self) -> &mut KinectFrame {
        &mut self.player.source.0
    }

    /// The frame cut last.
    pub fn sent(&self) -> &Frame {
        &self.player.frame
    }

    /// Cuts the frame into packets.
    pub fn cut(&mut self) {
        self.packets.clear();
        self.bytes.clear();
        let end = self.now + PERIOD;
        while self.now < end {
            self.player.play(self.now, [true; 2], &mut |packet| {
                self.packets.push((packet.stream, packet.bytes.len()));
                self.bytes.extend_from_slice(packet.bytes);
            });
            self.now += STEP;
        }
        self.now = end;
    }

    /// Assembles packets to pictures; `number`: number of the frame.
    pub fn assemble(&mut self, number: u64) {
        let mut rest = &self.bytes[..];
        for (stream, length) in &self.packets {
            let (bytes, after) = rest.split_at(*length);
            rest = after;
            let assembler = &mut self.assemblers[stream.index()];
            if let Some(ticks) = assembler.push(true, bytes)
                && let Some(paired) =
                    (self.pairing).offer(*stream, number, ticks, &mut assembler.picture)
            {
                paired.swap_into(&mut self.pair);
            }
        }
    }

    /// Unpacks the depth picture to raw values.
    pub fn unpack(&self, frame: &mut Frame) {
        depth_from_pair(&self.pair, frame);
    }

    /// Converts the mosaic to luma.
    pub fn demosaic(&self, frame: &mut Frame) {
        luma_from_pair(&self.pair, frame);
    }
}
