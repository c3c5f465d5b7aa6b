//! A second thread, started once, for half of a frame's work.
//!
//! [`SecondCore::both`] is a fork and join: it lends a closure to the thread and returns when both halves are done. The lock and the
//! condition variable are all there is to it, so nothing is allocated after the start.
#![expect(
    unsafe_code,
    reason = "what is lent to a thread for a call must outlive the call alone, which the compiler cannot see"
)]

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{Builder, JoinHandle};

type Half = dyn FnMut() + Send;

#[derive(Default)]
enum Work {
    #[default]
    None,
    Lent(&'static mut Half),
    Begun,
    Panicked,
    Over,
}

#[derive(Default)]
struct Desk(Mutex<Work>, Condvar);

impl Desk {
    fn put(&self, work: Work) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = work;
        self.1.notify_all();
    }

    fn wait(&self, waits: impl Fn(&Work) -> bool) -> MutexGuard<'_, Work> {
        let work = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let until = self.1.wait_while(work, |work| waits(work));
        until.unwrap_or_else(PoisonError::into_inner)
    }

    /// The thread: whatever is lent, until it is over.
    fn serve(&self) {
        loop {
            let mut work = self.wait(|work| !matches!(work, Work::Lent(_) | Work::Over));
            let Work::Lent(half) = core::mem::replace(&mut *work, Work::Begun) else {
                return;
            };
            drop(work);
            let ended = catch_unwind(AssertUnwindSafe(half));
            self.put(ended.map_or(Work::Panicked, |()| Work::None));
        }
    }
}

/// The thread; ends with its owner.
pub(crate) struct SecondCore {
    desk: Arc<Desk>,
    thread: Option<JoinHandle<()>>,
}

impl SecondCore {
    /// Whether this process may run on more than one core.
    pub(crate) fn is_there() -> bool {
        std::thread::available_parallelism().is_ok_and(|cores| cores.get() > 1)
    }

    /// Starts the thread; `None` if the system refuses.
    pub(crate) fn start() -> Option<Self> {
        let desk = Arc::<Desk>::default();
        let there = desk.clone();
        let thread = Builder::new().name("second-core".to_owned());
        let thread = thread.spawn(move || there.serve()).ok()?;
        Some(Self {
            desk,
            thread: Some(thread),
        })
    }

    /// Runs `theirs` on the thread while this one runs `mine`; both are done on return.
    pub(crate) fn both(&mut self, mine: impl FnOnce(), theirs: &mut (dyn FnMut() + Send)) {
        // SAFETY: the thread has let go of it when `Done` is dropped, which is before this call ends, by a panic in `mine` too.
        let lent = unsafe { core::mem::transmute::<&mut (dyn FnMut() + Send), &mut Half>(theirs) };
        self.desk.put(Work::Lent(lent));
        let done = Done(&self.desk);
        mine();
        drop(done);
    }
}

/// Waits until nothing is lent any more.
struct Done<'a>(&'a Desk);

impl Drop for Done<'_> {
    fn drop(&mut self) {
        let mut work = self
            .0
            .wait(|work| matches!(work, Work::Lent(_) | Work::Begun));
        if let Work::Panicked = core::mem::take(&mut *work)
            && !std::thread::panicking()
        {
            drop(work);
            panic!("the second core's half failed");
        }
    }
}

impl Drop for SecondCore {
    fn drop(&mut self) {
        self.desk.put(Work::Over);
        // Its panics were told.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_halves_are_done_on_return_and_run_at_the_same_time() {
        let mut second = SecondCore::start().expect("a thread");
        let meet = std::sync::Barrier::new(2);
        let mut sums = [0; 2];
        let [one, other] = &mut sums;
        for k in 1..=100 {
            // Each waits for the other: neither could run first.
            second.both(
                || {
                    meet.wait();
                    *one += k;
                },
                &mut || {
                    meet.wait();
                    *other += 2 * k;
                },
            );
        }
        assert_eq!(sums, [5_050, 10_100]);
    }

    #[test]
    fn a_panic_of_either_half_is_one_here_and_the_thread_goes_on() {
        let mut second = SecondCore::start().expect("a thread");
        let mut there = 0;
        let mut fails = |mine: bool, theirs: bool| {
            let both = AssertUnwindSafe(|| {
                second.both(|| assert!(!mine), &mut || {
                    there += 1;
                    assert!(!theirs);
                });
            });
            catch_unwind(both).is_err()
        };
        assert!(fails(true, false) && fails(false, true) && fails(true, true));
        assert!(!fails(false, false));
        assert_eq!(there, 4);
    }
}
