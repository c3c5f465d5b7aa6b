//! A scene's frames as packets, on time.

use core::time::Duration;

use mien_sensors::kinect::device::{Received, Stream};
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::packet::LONGEST;
use mien_sensors::kinect::stream::Cutter;
use mien_sensors::kinect::unpack::{PACKED_DEPTH, pack_depth};

/// Share of a picture's time within which its packets go out; the rest of the microframes are empty.
const BUSY: f64 = 0.95;
/// A player that is asked later than this does not catch up: its clock slips.
const SLIP: Duration = Duration::from_millis(50);

/// Cuts the frames of a scene into packets, on time.
pub struct Player<D> {
    /// What it plays.
    pub view: D,
    /// The frame whose packets are going out.
    pub frame: Box<KinectFrame>,
    packed: Box<[u8; PACKED_DEPTH]>,
    cutters: [Cutter; 2],
    /// Packets of the present picture already sent, by stream.
    sent: [usize; 2],
    began: Option<Duration>,
    /// Time of a picture: slow hosts cannot carry 30 a second through a virtual machine.
    pub period: Duration,
    /// Frames begun.
    pub frames: u64,
}

impl<D: View> Player<D> {
    /// Plays `view`, one frame per `period`.
    pub fn new(view: D, period: Duration) -> Self {
        Self {
            view,
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
        let alive = self.view.draw(&mut self.frame);
        pack_depth(&self.frame.depth, &mut self.packed);
        alive
    }

    /// Hands to `sink` every packet due until `now` on the streams that are `on`. False when the scene has ended. The scene
    /// begins when both streams are on, so that its first frame has both pictures; with both off it stands still. A stream
    /// switched on in the middle of a frame starts with the next one.
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
            let share = elapsed.as_secs_f64() / (self.period.as_secs_f64() * BUSY);
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
            let slips = now.saturating_sub(next) > SLIP;
            self.began = Some(if slips { now } else { next });
        }
    }
}

/// What a virtual Kinect sees. Closures do: `FnMut(&mut KinectFrame) -> bool`.
pub trait View {
    /// Draws depth, Bayer and both stamps of the next frame; false when the scene has ended.
    fn draw(&mut self, frame: &mut KinectFrame) -> bool;
}

impl<F: FnMut(&mut KinectFrame) -> bool> View for F {
    fn draw(&mut self, frame: &mut KinectFrame) -> bool {
        self(frame)
    }
}
