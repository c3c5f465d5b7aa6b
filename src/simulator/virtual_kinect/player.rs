//! Sends frames as packets on time.

use core::time::Duration;

use mien_sensors::kinect::device::{Received, Stream};
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::packet::LONGEST;
use mien_sensors::kinect::stream::Cutter;
use mien_sensors::kinect::unpack::{PACKED_DEPTH, pack_depth};

/// Share of a picture's time in which its packets are sent; the other microframes are empty.
const SEND_SHARE: f64 = 0.95;
/// Longest delay that is caught up; after a longer one the clock slips.
const CATCH_UP_LIMIT: Duration = Duration::from_millis(50);

/// Cuts the frames of a source into packets and sends them on time.
pub struct Player<D> {
    /// Source of the frames.
    pub source: D,
    /// The frame being sent.
    pub frame: Box<KinectFrame>,
    packed: Box<[u8; PACKED_DEPTH]>,
    cutters: [Cutter; 2],
    /// Number of packets sent of the current picture, by stream.
    sent: [usize; 2],
    began: Option<Duration>,
    /// Time per picture; longer on hosts too slow for 30 Hz through a virtual machine.
    pub period: Duration,
    /// Number of frames begun.
    pub frames: u64,
}

impl<D: FrameSource> Player<D> {
    /// Plays `source`, one frame per `period`.
    pub fn new(source: D, period: Duration) -> Self {
        Self {
            source,
            frame: Box::default(),
            packed: vec![0; PACKED_DEPTH].try_into().expect("as long"),
            cutters: Stream::BOTH.map(|stream| Cutter::new(stream, 0)),
            sent: [0; 2],
            began: None,
            period,
            frames: 0,
        }
    }

    fn next_frame(&mut self) -> bool {
        self.sent = [0; 2];
        self.frames += 1;
        let alive = self.source.draw(&mut self.frame);
        pack_depth(&self.frame.depth, &mut self.packed);
        alive
    }

    /// Passes all packets due until `now` on the streams that are `on` to `sink`; `false` when the source has ended. Starts when both
    /// streams are on, so that the first frame has both pictures; pauses when both are off. A stream switched on during a frame starts
    /// with the next one.
    pub fn play(
        &mut self,
        now: Duration,
        on: [bool; 2],
        sink: &mut dyn FnMut(Received<'_>),
    ) -> bool {
        if on == [false; 2] {
            self.began = None;
        }
        if self.began.is_none() && on != [true; 2] {
            return true;
        }
        let cutters = self.cutters.each_ref();
        let total = cutters.map(|cutter| cutter.layout.packets());
        loop {
            if self.began.is_none() && !self.next_frame() {
                return false;
            }
            let began = *self.began.get_or_insert(now);
            let elapsed = now.saturating_sub(began);
            let share = elapsed.as_secs_f64() / (self.period.as_secs_f64() * SEND_SHARE);
            for stream in Stream::BOTH {
                let i = stream.index();
                if !on[i] {
                    self.sent[i] = total[i];
                }
                let due = ((share * total[i] as f64) as usize).min(total[i]);
                let original = &self.frame.original;
                let (picture, ticks) = match stream {
                    Stream::Colour => (&original.bayer[..], original.colour_ticks),
                    Stream::Depth => (&self.packed[..], original.ticks),
                };
                let mut packet = [0; LONGEST];
                while self.sent[i] < due {
                    let n = self.cutters[i].cut(picture, ticks, self.sent[i], &mut packet);
                    self.sent[i] += 1;
                    sink(Received {
                        stream,
                        intact: true,
                        bytes: &packet[..n],
                    });
                }
            }
            if elapsed < self.period {
                return true;
            }
            let next = began + self.period;
            if !self.next_frame() {
                return false;
            }
            let slips = now.saturating_sub(next) > CATCH_UP_LIMIT;
            self.began = Some(if slips { now } else { next });
        }
    }
}

/// A source of frames for a virtual Kinect, also any `FnMut(&mut KinectFrame) -> bool`.
pub trait FrameSource {
    /// Draws depth, Bayer and both time stamps of the next frame; `false` when the source has ended.
    fn draw(&mut self, frame: &mut KinectFrame) -> bool;
}

impl<F: FnMut(&mut KinectFrame) -> bool> FrameSource for F {
    fn draw(&mut self, frame: &mut KinectFrame) -> bool {
        self(frame)
    }
}
