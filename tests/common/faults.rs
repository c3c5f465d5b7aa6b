//! A [`PacketSource`] around a [`PacketSource`] that loses, repeats and damages packets, and stalls: seeded, and counted, so
//! that a test can compare injected with detected faults.

#![allow(dead_code, reason = "each test program uses some of it")]

use std::time::Duration;

use mien_sensors::kinect::device::{DeviceError, Model, PacketSource, Received, Request, Stream};

/// How often what goes wrong. Rates are per packet; all zero by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Rates {
    /// Begins a run of lost packets.
    pub(crate) lost: f64,
    /// Longest run of lost packets; 0 and 1 lose single ones.
    pub(crate) longest_run: u8,
    /// Comes twice.
    pub(crate) repeated: f64,
    /// Magic spoilt.
    pub(crate) damaged: f64,
    /// Payload cut short.
    pub(crate) short: f64,
    /// Reported bad by the bus.
    pub(crate) bus_error: f64,
    /// Stream falls silent until it is stopped and started.
    pub(crate) stall: f64,
}

/// What was done to one stream, in packets (stalls: times).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Injected {
    /// Lost.
    pub(crate) lost: u64,
    /// Sent twice.
    pub(crate) repeated: u64,
    /// Magic spoilt.
    pub(crate) damaged: u64,
    /// Cut short.
    pub(crate) short: u64,
    /// Marked bad.
    pub(crate) bus_errors: u64,
    /// Times the stream fell silent.
    pub(crate) stalls: u64,
}

/// The wrapper.
pub(crate) struct Faulty<S> {
    /// The source inside.
    pub(crate) inner: S,
    /// What goes wrong.
    pub(crate) faults: Faults,
}

/// What goes wrong, and what went wrong so far.
pub(crate) struct Faults {
    /// May change on the way: zero to let the last losses be noticed.
    pub(crate) rates: Rates,
    /// What was done so far, by stream.
    pub(crate) injected: [Injected; 2],
    random: fastrand::Rng,
    /// Packets of a run of losses still to swallow, by stream.
    run: [u8; 2],
    stalled: [bool; 2],
}

impl<S: PacketSource> Faulty<S> {
    /// Wraps `inner`; the same seed gives the same faults.
    pub(crate) fn new(inner: S, rates: Rates, seed: u64) -> Self {
        let faults = Faults {
            rates,
            injected: [Injected::default(); 2],
            random: fastrand::Rng::with_seed(seed),
            run: [0; 2],
            stalled: [false; 2],
        };
        Self { inner, faults }
    }
}

impl Faults {
    /// Hands a packet on, or what becomes of it.
    fn pass(&mut self, received: Received<'_>, sink: &mut dyn FnMut(Received<'_>)) {
        let (i, rates, random) = (received.stream.index(), self.rates, &mut self.random);
        let done = &mut self.injected[i];
        if received.bytes.is_empty() || self.stalled[i] {
            return;
        }
        if self.run[i] > 0 {
            self.run[i] -= 1;
            done.lost += 1;
            return;
        }
        let mut chance = random.f64();
        let mut hit = |rate: f64| {
            chance -= rate;
            chance < 0.0
        };
        // Asks for memory only where it is written to.
        let mut damaged = Vec::new();
        let (mut intact, mut bytes) = (received.intact, received.bytes);
        if hit(rates.lost) {
            self.run[i] = random.u8(0..rates.longest_run.max(1));
            done.lost += 1;
            return;
        } else if hit(rates.repeated) {
            done.repeated += 1;
            sink(received);
        } else if hit(rates.damaged) {
            done.damaged += 1;
            damaged.extend_from_slice(bytes);
            damaged[random.usize(..2)] ^= random.u8(1..);
            bytes = &damaged;
        } else if hit(rates.short) {
            done.short += 1;
            bytes = &bytes[..random.usize(1..bytes.len())];
        } else if hit(rates.bus_error) {
            done.bus_errors += 1;
            intact = false;
            bytes = &[];
        } else if hit(rates.stall) {
            done.stalls += 1;
            self.stalled[i] = true;
            return;
        }
        sink(Received {
            stream: received.stream,
            intact,
            bytes,
        });
    }
}

impl<S: PacketSource> PacketSource for Faulty<S> {
    fn poll(
        &mut self,
        wait: Duration,
        sink: &mut dyn FnMut(Received<'_>),
    ) -> Result<(), DeviceError> {
        let faults = &mut self.faults;
        (self.inner).poll(wait, &mut |received| faults.pass(received, sink))
    }

    fn stop(&mut self, stream: Stream) {
        self.faults.stalled[stream.index()] = false;
        self.inner.stop(stream);
    }

    fn model(&self) -> Model {
        self.inner.model()
    }

    fn serial(&self) -> &str {
        self.inner.serial()
    }

    fn request(&mut self, request: Request<'_>) -> Result<usize, DeviceError> {
        self.inner.request(request)
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
}
