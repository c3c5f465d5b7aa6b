//! A worker thread, started once, for half of a frame's work.
//!
//! [`SecondCore::join`] lends a job to the worker and returns when both jobs have returned. A lock and a condition variable
//! suffice, so nothing is allocated after the start.
#![expect(
    unsafe_code,
    reason = "what is lent to a thread for a call must outlive the call alone, which the compiler cannot see"
)]

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{Builder, JoinHandle};

type Job = dyn FnMut() + Send;

#[derive(Default)]
enum State {
    #[default]
    Idle,
    Submitted(&'static mut Job),
    Running,
    Panicked,
    Stopped,
}

#[derive(Default)]
struct Worker(Mutex<State>, Condvar);

impl Worker {
    fn set(&self, state: State) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = state;
        self.1.notify_all();
    }

    fn wait_while(&self, waits: impl Fn(&State) -> bool) -> MutexGuard<'_, State> {
        let state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let state = self.1.wait_while(state, |state| waits(state));
        state.unwrap_or_else(PoisonError::into_inner)
    }

    /// The thread's loop.
    fn run(&self) {
        loop {
            let mut state =
                self.wait_while(|state| !matches!(state, State::Submitted(_) | State::Stopped));
            let State::Submitted(job) = core::mem::replace(&mut *state, State::Running) else {
                return;
            };
            drop(state);
            let ended = catch_unwind(AssertUnwindSafe(job));
            self.set(ended.map_or(State::Panicked, |()| State::Idle));
        }
    }
}

/// Owns the worker thread; dropping it ends the thread.
pub struct SecondCore {
    worker: Arc<Worker>,
    thread: Option<JoinHandle<()>>,
}

impl SecondCore {
    /// Whether this process may run on more than one core.
    pub fn is_available() -> bool {
        std::thread::available_parallelism().is_ok_and(|cores| cores.get() > 1)
    }

    /// Starts the thread; `None` if the system cannot create one.
    pub fn start() -> Option<Self> {
        let worker = Arc::<Worker>::default();
        let there = worker.clone();
        let thread = Builder::new().name("second-core".to_owned());
        let thread = thread.spawn(move || there.run()).ok()?;
        Some(Self {
            worker,
            thread: Some(thread),
        })
    }

    /// Runs `theirs` on the worker and `mine` on this thread; returns when both have returned.
    ///
    /// # Panics
    /// If either panics.
    pub fn join(&mut self, mine: impl FnOnce(), theirs: &mut (dyn FnMut() + Send)) {
        // SAFETY: the worker no longer uses the job when `done` is dropped, which is before this call ends, even by a panic.
        let job = unsafe { core::mem::transmute::<&mut (dyn FnMut() + Send), &mut Job>(theirs) };
        self.worker.set(State::Submitted(job));
        let done = Done(&self.worker);
        mine();
        drop(done);
    }
}

/// Waits for the job when dropped.
struct Done<'a>(&'a Worker);

impl Drop for Done<'_> {
    fn drop(&mut self) {
        let worker = self.0;
        let mut state =
            worker.wait_while(|state| matches!(state, State::Submitted(_) | State::Running));
        if let State::Panicked = core::mem::take(&mut *state)
            && !std::thread::panicking()
        {
            drop(state);
            panic!("the second core's job panicked");
        }
    }
}

impl Drop for SecondCore {
    fn drop(&mut self) {
        self.worker.set(State::Stopped);
        // Its panics were already reported.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_jobs_run_concurrently_and_are_done_on_return() {
        let mut second = SecondCore::start().expect("a thread");
        let meet = std::sync::Barrier::new(2);
        let mut sums = [0; 2];
        let [one, other] = &mut sums;
        for k in 1..=100 {
            // Each waits for the other: neither could run first.
            second.join(
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
    fn a_panic_of_either_job_propagates_and_the_thread_survives() {
        let mut second = SecondCore::start().expect("a thread");
        let mut there = 0;
        let mut fails = |mine: bool, theirs: bool| {
            let both = AssertUnwindSafe(|| {
                second.join(|| assert!(!mine), &mut || {
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
