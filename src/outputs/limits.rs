//! How often something may be tried or asked for: pauses that double, an address that is tried until it is free, and an
//! allowance that fills again. How long the end of an output may take, whose thread may still send the messages that report
//! nobody, but no more.

use std::net::{IpAddr, SocketAddr};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::OutputError;

/// Pauses before trying again, doubling from the first to the longest.
pub(super) struct BackOff {
    first: Duration,
    longest: Duration,
    /// Pauses so far.
    tries: u32,
}

impl BackOff {
    pub(super) const fn new([first, longest]: [Duration; 2]) -> Self {
        Self {
            first,
            longest,
            tries: 0,
        }
    }

    /// How long to wait now.
    pub(super) fn pause(&mut self) -> Duration {
        let doubled = self.first * (1 << self.tries.min(16));
        self.tries = self.tries.saturating_add(1);
        doubled.min(self.longest)
    }

    /// It has worked: the next pause is the first one again.
    pub(super) fn reset(&mut self) {
        self.tries = 0;
    }
}

/// First and longest pause before retrying an address that is in use.
const IN_USE: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(5)];

/// A socket that listens as soon as its address is free, or this machine's.
pub(super) struct Listening<T> {
    address: SocketAddr,
    pub(super) socket: Option<T>,
    again: Instant,
    back_off: BackOff,
}

impl<T> Listening<T> {
    /// At `address:port`; not tried yet.
    ///
    /// # Errors
    /// If it is not an address with a port.
    pub(super) fn on(address: &str) -> Result<Self, OutputError> {
        let parsed = address.parse();
        Ok(Self {
            address: parsed.map_err(|_| OutputError::Listen(address.to_owned()))?,
            socket: None,
            again: Instant::now(),
            back_off: BackOff::new(IN_USE),
        })
    }

    /// Tries, if need be, when it is time to; `what` it is for is told if that fails.
    pub(super) fn open(&mut self, what: &str, bind: fn(SocketAddr) -> std::io::Result<T>) {
        if self.socket.is_some() || Instant::now() < self.again {
            return;
        }
        let address = self.address;
        let bound = bind(address).inspect_err(|error| {
            // Not the first failure: before a reload the address is still this program's own for a moment.
            if self.back_off.tries == 1 {
                tracing::warn!(
                    "cannot listen{what} at {address} ({error}); retrying every {} s",
                    IN_USE[1].as_secs()
                );
            }
        });
        self.socket = bound.ok();
        self.again = Instant::now() + self.back_off.pause();
    }
}

/// Whether an address is one of this machine or of its networks.
pub(super) fn is_near(address: IpAddr) -> bool {
    match address.to_canonical() {
        IpAddr::V4(four) => four.is_loopback() || four.is_private() || four.is_link_local(),
        IpAddr::V6(six) => {
            six.is_loopback() || six.is_unique_local() || six.is_unicast_link_local()
        }
    }
}

/// A token bucket: so many at once, then one more every `each`.
#[derive(Clone, Copy)]
pub struct Allowance {
    at_once: u32,
    each: Duration,
    /// When it is full again.
    pub(super) full: Instant,
}

impl Allowance {
    /// `at_once` events at a time, and one more every `each`.
    pub const fn new(at_once: u32, each: Duration, now: Instant) -> Self {
        Self {
            at_once,
            each,
            full: now,
        }
    }

    /// Of commands from one sender.
    pub(super) const fn of_commands(now: Instant) -> Self {
        Self::new(16, Duration::from_millis(250), now)
    }

    /// Of commands from all senders together: an address costs nothing.
    pub(super) const fn of_all_commands(now: Instant) -> Self {
        Self::new(32, Duration::from_millis(125), now)
    }

    /// Whether there is one left.
    pub(super) fn is_left(&self, now: Instant) -> bool {
        self.full.saturating_duration_since(now) <= self.each * (self.at_once - 1)
    }

    /// Takes one; whether there was one.
    pub fn take(&mut self, now: Instant) -> bool {
        let left = self.is_left(now);
        if left {
            self.full = self.full.max(now) + self.each;
        }
        left
    }
}

/// Starts the thread of an output.
pub(super) fn start_thread(
    name: &str,
    work: impl FnOnce() + Send + 'static,
) -> Result<JoinHandle<()>, OutputError> {
    let thread = std::thread::Builder::new().name(name.to_owned());
    thread.spawn(work).map_err(OutputError::Thread)
}

/// Time limit of the end.
const CLOSING: Duration = Duration::from_millis(500);

/// Waits for a thread that was told to stop; a hanging one is abandoned.
pub(super) fn wait_for(thread: &mut Option<JoinHandle<()>>) {
    let Some(thread) = thread.take() else { return };
    let start = Instant::now();
    while !thread.is_finished() && start.elapsed() < CLOSING {
        std::thread::sleep(Duration::from_millis(2));
    }
    if thread.is_finished() {
        // A panic of the thread has been reported by itself.
        thread.join().ok();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_double_up_to_the_longest_and_start_again() {
        let mut back_off = BackOff::new([1, 30].map(Duration::from_secs));
        let pauses: Vec<u64> = (0..7).map(|_| back_off.pause().as_secs()).collect();
        assert_eq!(pauses, [1, 2, 4, 8, 16, 30, 30]);
        back_off.reset();
        assert_eq!(back_off.pause().as_secs(), 1);
    }

    #[test]
    fn an_allowance_is_spent_at_once_and_fills_one_by_one() {
        let now = Instant::now();
        let mut commands = Allowance::of_commands(now);
        assert_eq!((0..40).filter(|_| commands.take(now)).count(), 16);
        let later = now + Duration::from_secs(1);
        assert_eq!((0..40).filter(|_| commands.take(later)).count(), 4);
    }
}
