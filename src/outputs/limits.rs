//! Rate limits: retry pauses that double, a listening socket that retries its address, and a token bucket. Time limit for the end
//! of an output's thread.

use std::net::{IpAddr, SocketAddr};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::OutputError;

/// Pauses before trying again, doubling from the first to the longest.
pub(super) struct BackOff {
    first: Duration,
    longest: Duration,
    /// Pauses so far.
    pauses: u32,
}

impl BackOff {
    pub(super) const fn new([first, longest]: [Duration; 2]) -> Self {
        Self {
            first,
            longest,
            pauses: 0,
        }
    }

    /// The next pause.
    pub(super) fn pause(&mut self) -> Duration {
        let doubled = self.first * (1 << self.pauses.min(16));
        self.pauses = self.pauses.saturating_add(1);
        doubled.min(self.longest)
    }

    /// After a success: the next pause is the first one again.
    pub(super) fn reset(&mut self) {
        self.pauses = 0;
    }
}

/// First and longest pause before retrying an address that is in use.
const IN_USE: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(5)];

/// A listening socket that retries while its address is in use or not this machine's.
pub(super) struct Listening<T> {
    address: SocketAddr,
    pub(super) socket: Option<T>,
    retry_at: Instant,
    back_off: BackOff,
}

impl<T> Listening<T> {
    /// For `address:port`; does not bind yet.
    ///
    /// # Errors
    /// If the text is not an address with a port.
    pub(super) fn new(address: &str) -> Result<Self, OutputError> {
        let parsed = address.parse();
        Ok(Self {
            address: parsed.map_err(|_| OutputError::Listen(address.to_owned()))?,
            socket: None,
            retry_at: Instant::now(),
            back_off: BackOff::new(IN_USE),
        })
    }

    /// Binds if the socket is not open and the pause is over; `what` names its purpose in the warning.
    pub(super) fn open(&mut self, what: &str, bind: fn(SocketAddr) -> std::io::Result<T>) {
        if self.socket.is_some() || Instant::now() < self.retry_at {
            return;
        }
        let address = self.address;
        let bound = bind(address).inspect_err(|error| {
            // The first failure is not logged: after a reload the former socket may still be closing.
            if self.back_off.pauses == 1 {
                let pause_s = IN_USE[1].as_secs();
                tracing::warn!(
                    "cannot listen{what} at {address} ({error}); retrying every {pause_s} s"
                );
            }
        });
        self.socket = bound.ok();
        self.retry_at = Instant::now() + self.back_off.pause();
    }
}

/// Whether the address is a loopback, private or link-local one.
pub(super) fn is_local(address: IpAddr) -> bool {
    match address.to_canonical() {
        IpAddr::V4(four) => four.is_loopback() || four.is_private() || four.is_link_local(),
        IpAddr::V6(six) => {
            six.is_loopback() || six.is_unique_local() || six.is_unicast_link_local()
        }
    }
}

/// A token bucket: so many at once, then one more every `interval`.
#[derive(Clone, Copy)]
pub struct TokenBucket {
    burst: u32,
    interval: Duration,
    /// Time at which it will be full.
    pub(super) full_at: Instant,
}

impl TokenBucket {
    /// `burst` events at a time, and one more every `interval`.
    pub const fn new(burst: u32, interval: Duration, now: Instant) -> Self {
        Self {
            burst,
            interval,
            full_at: now,
        }
    }

    /// Limit on commands from one sender.
    pub(super) const fn per_sender(now: Instant) -> Self {
        Self::new(16, Duration::from_millis(250), now)
    }

    /// Limit on commands from all senders together, because a sender can use many addresses.
    pub(super) const fn all_senders(now: Instant) -> Self {
        Self::new(32, Duration::from_millis(125), now)
    }

    /// Whether an event is allowed now.
    pub(super) fn has_token(&self, now: Instant) -> bool {
        self.full_at.saturating_duration_since(now) <= self.interval * (self.burst - 1)
    }

    /// Uses a token; `false` if there was none.
    pub fn take(&mut self, now: Instant) -> bool {
        let had_token = self.has_token(now);
        if had_token {
            self.full_at = self.full_at.max(now) + self.interval;
        }
        had_token
    }
}

/// Starts the thread of an output.
///
/// # Errors
/// If the system refuses a thread.
pub(super) fn start_thread(
    name: &str,
    work: impl FnOnce() + Send + 'static,
) -> Result<JoinHandle<()>, OutputError> {
    let thread = std::thread::Builder::new().name(name.to_owned());
    thread.spawn(work).map_err(OutputError::Thread)
}

/// Longest wait for a thread to end.
const JOIN_LIMIT: Duration = Duration::from_millis(500);

/// Joins a thread that has been asked to stop; abandons it after [`JOIN_LIMIT`].
pub(super) fn join_or_abandon(thread: &mut Option<JoinHandle<()>>) {
    let Some(thread) = thread.take() else { return };
    let start = Instant::now();
    while !thread.is_finished() && start.elapsed() < JOIN_LIMIT {
        std::thread::sleep(Duration::from_millis(2));
    }
    if thread.is_finished() {
        // The panic hook has already reported a panic.
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
        let mut commands = TokenBucket::per_sender(now);
        assert_eq!((0..40).filter(|_| commands.take(now)).count(), 16);
        let later = now + Duration::from_secs(1);
        assert_eq!((0..40).filter(|_| commands.take(later)).count(), 4);
    }
}
