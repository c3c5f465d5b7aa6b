//! A source at the speed of the world, or a multiple of it.

use std::time::{Duration, Instant};

use mien_sensors::kinect::device::{DeviceError, Model, PacketSource, Received, Request, Stream};

/// A source that delivers no sooner than its own clock, so many times as fast as the world's, says.
pub(crate) struct Paced<S> {
    source: S,
    speed: u32,
    started: Instant,
}

impl<S> Paced<S> {
    /// Begins now.
    pub(crate) fn new(source: S, speed: u32) -> Self {
        Self {
            source,
            speed,
            started: Instant::now(),
        }
    }
}

impl<S: PacketSource> PacketSource for Paced<S> {
    fn model(&self) -> Model {
        self.source.model()
    }
    fn serial(&self) -> &str {
        self.source.serial()
    }
    fn request(&mut self, request: Request<'_>) -> Result<usize, DeviceError> {
        self.source.request(request)
    }
    fn start(&mut self, stream: Stream) -> Result<(), DeviceError> {
        self.source.start(stream)
    }
    fn stop(&mut self, stream: Stream) {
        self.source.stop(stream);
    }
    fn poll(
        &mut self,
        wait: Duration,
        sink: &mut dyn FnMut(Received<'_>),
    ) -> Result<(), DeviceError> {
        let world = self.started.elapsed() * self.speed;
        let ahead = self.source.clock().saturating_sub(world);
        std::thread::sleep(ahead / self.speed);
        self.source.poll(wait, sink)
    }
    fn clock(&self) -> Duration {
        self.source.clock()
    }
    fn sleep(&mut self, time: Duration) {
        self.source.sleep(time);
    }
}
