//! A [`PacketSource`] around a [`PacketSource`] that loses, repeats and damages packets, and stalls: seeded, and counted, so
//! that a test can compare injected with detected faults.

use core::time::Duration;

use crate::sensor::kinect::device::{DeviceError, Model, PacketSource, Received, Stream};

/// How often what goes wrong. Rates are per packet; all zero by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rates {
    /// Begins a run of lost packets.
    pub lost: f64,
    /// Longest run of lost packets; 0 and 1 lose single ones.
    pub longest_run: u8,
    /// Comes twice.
    pub repeated: f64,
    /// Magic spoilt.
    pub damaged: f64,
    /// Payload cut short.
    pub short: f64,
    /// Reported bad by the bus.
    pub bus_error: f64,
    /// Stream falls silent until it is stopped and started.
    pub stall: f64,
}

/// What was done to one stream, in packets (stalls: times).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Injected {
    /// Lost.
    pub lost: u64,
    /// Sent twice.
    pub repeated: u64,
    /// Magic spoilt.
    pub damaged: u64,
    /// Cut short.
    pub short: u64,
    /// Marked bad.
    pub bus_errors: u64,
    /// Times the stream fell silent.
    pub stalls: u64,
}

/// The wrapper.
pub struct Faulty<S> {
    inner: S,
    rates: Rates,
    random: fastrand::Rng,
    injected: [Injected; 2],
    /// Packets of a run of losses still to swallow, by stream.
    run: [u8; 2],
    stalled: [bool; 2],
}

impl<S: PacketSource> Faulty<S> {
    /// Wraps `inner`; the same seed gives the same faults.
    #[must_use]
    pub fn new(inner: S, rates: Rates, seed: u64) -> Self {
        Self {
            inner,
            rates,
            random: fastrand::Rng::with_seed(seed),
            injected: [Injected::default(); 2],
            run: [0; 2],
            stalled: [false; 2],
        }
    }

    /// From now on other rates; zero to let the last losses be noticed.
    pub const fn set_rates(&mut self, rates: Rates) {
        self.rates = rates;
    }

    /// What was done so far, by stream.
    #[must_use]
    pub const fn injected(&self) -> &[Injected; 2] {
        &self.injected
    }

    /// The source inside.
    #[must_use]
    pub const fn inner(&self) -> &S {
        &self.inner
    }
}

impl<S: PacketSource> PacketSource for Faulty<S> {
    fn poll(
        &mut self,
        wait: Duration,
        sink: &mut dyn FnMut(Received<'_>),
    ) -> Result<(), DeviceError> {
        let Self {
            inner,
            rates,
            random,
            injected,
            run,
            stalled,
        } = self;
        inner.poll(wait, &mut |received| {
            let i = received.stream.index();
            let done = &mut injected[i];
            if received.bytes.is_empty() || stalled[i] {
                return;
            }
            if run[i] > 0 {
                run[i] -= 1;
                done.lost += 1;
                return;
            }
            let mut chance = random.f64();
            let mut hit = |rate: f64| {
                chance -= rate;
                chance < 0.0
            };
            if hit(rates.lost) {
                run[i] = random.u8(0..rates.longest_run.max(1));
                done.lost += 1;
            } else if hit(rates.repeated) {
                done.repeated += 1;
                sink(received);
                sink(received);
            } else if hit(rates.damaged) {
                done.damaged += 1;
                let mut bytes = received.bytes.to_vec();
                bytes[random.usize(..2)] ^= random.u8(1..);
                sink(Received {
                    bytes: &bytes,
                    ..received
                });
            } else if hit(rates.short) {
                done.short += 1;
                let n = random.usize(1..received.bytes.len());
                sink(Received {
                    bytes: &received.bytes[..n],
                    ..received
                });
            } else if hit(rates.bus_error) {
                done.bus_errors += 1;
                sink(Received {
                    intact: false,
                    bytes: &[],
                    ..received
                });
            } else if hit(rates.stall) {
                done.stalls += 1;
                stalled[i] = true;
            } else {
                sink(received);
            }
        })
    }

    fn stop(&mut self, stream: Stream) {
        self.stalled[stream.index()] = false;
        self.inner.stop(stream);
    }

    fn model(&self) -> Model {
        self.inner.model()
    }

    fn serial(&self) -> &str {
        self.inner.serial()
    }

    fn send(&mut self, command: &[u8]) -> Result<(), DeviceError> {
        self.inner.send(command)
    }

    fn receive(&mut self, reply: &mut [u8]) -> Result<usize, DeviceError> {
        self.inner.receive(reply)
    }

    fn start(&mut self, stream: Stream) -> Result<(), DeviceError> {
        self.inner.start(stream)
    }

    fn clock(&self) -> Duration {
        self.inner.clock()
    }

    fn sleep(&mut self, time: Duration) {
        self.inner.sleep(time);
    }

    fn motor_write(&mut self, request: u8, value: u16) -> Result<(), DeviceError> {
        self.inner.motor_write(request, value)
    }

    fn motor_read(&mut self, request: u8, reply: &mut [u8]) -> Result<usize, DeviceError> {
        self.inner.motor_read(request, reply)
    }

    fn audio_write(&mut self, message: &[u8]) -> Result<(), DeviceError> {
        self.inner.audio_write(message)
    }

    fn audio_read(&mut self, reply: &mut [u8]) -> Result<usize, DeviceError> {
        self.inner.audio_read(reply)
    }
}
