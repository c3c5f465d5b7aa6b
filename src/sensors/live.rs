//! A device that may come and go: a thread opens it, keeps it streaming, and reopens it after it was lost; the consumer takes frames
//! from a bounded ring, or the reason why there are none.

use core::fmt::Display;
use core::time::Duration;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

/// Interval between attempts to open a device.
const RETRY: Duration = Duration::from_millis(500);

/// What a device's thread and its consumer share.
pub(crate) trait Live: Send + 'static {
    /// Why there are no frames.
    type Problem: PartialEq + Display;
    /// Name of the thread.
    const NAME: &str;
    /// The device's name in messages.
    const TITLE: &str;

    /// Why there are no frames; `None` while streaming, and before the first attempt.
    fn waiting_for(&mut self) -> &mut Option<Self::Problem>;

    /// Whether a device was ever opened.
    fn was_opened(&self) -> bool;

    /// Whether the thread is to end.
    fn stop(&mut self) -> &mut bool;
}

/// Shared state, and notice of its changes.
pub(crate) struct Shared<T> {
    inner: Mutex<T>,
    changed: Condvar,
}

impl<T> Shared<T> {
    pub(crate) fn lock(&self) -> MutexGuard<'_, T> {
        // The content is consistent at every step, even if a holder panicked.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until `is_over` returns true, but at most `wait`.
    pub(crate) fn wait(
        &self,
        wait: Duration,
        mut is_over: impl FnMut(&mut T) -> bool,
    ) -> MutexGuard<'_, T> {
        let waited = (self.changed).wait_timeout_while(self.lock(), wait, |inner| !is_over(inner));
        waited.unwrap_or_else(PoisonError::into_inner).0
    }

    /// Wakes who waits.
    pub(crate) fn notify(&self) {
        self.changed.notify_all();
    }
}

/// The thread of a device; it ends when this is dropped.
pub(crate) struct Worker<T: Live> {
    pub(crate) shared: Arc<Shared<T>>,
    thread: Option<JoinHandle<()>>,
}

impl<T: Live> Worker<T> {
    /// Starts the thread. `stream` opens the device and streams until asked to stop (`Ok`) or the device fails, and is then called
    /// again.
    pub(crate) fn start(
        inner: T,
        stream: impl FnMut(&Shared<T>) -> Result<(), T::Problem> + Send + 'static,
    ) -> Self {
        let shared = Arc::new(Shared {
            inner: Mutex::new(inner),
            changed: Condvar::new(),
        });
        let thread_shared = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name(T::NAME.to_owned())
            .spawn(move || run(&thread_shared, stream))
            .map_err(|problem| tracing::error!("cannot start the sensor thread: {problem}"))
            .ok();
        Self { shared, thread }
    }
}

impl<T: Live> Drop for Worker<T> {
    fn drop(&mut self) {
        *self.shared.lock().stop() = true;
        self.shared.notify();
        if let Some(thread) = self.thread.take() {
            // The panic hook has already reported a panic.
            let _ = thread.join();
        }
    }
}

fn run<T: Live>(shared: &Shared<T>, mut stream: impl FnMut(&Shared<T>) -> Result<(), T::Problem>) {
    let mut attempted = false;
    while let Err(problem) = stream(shared) {
        let mut inner = shared.lock();
        if inner.waiting_for().as_ref() != Some(&problem) {
            // The caller reports the first failure.
            if attempted || inner.was_opened() {
                tracing::warn!("waiting for the {}: {problem}", T::TITLE);
            }
            *inner.waiting_for() = Some(problem);
            shared.notify();
        }
        drop(inner);
        attempted = true;
        if *shared.wait(RETRY, |inner| *inner.stop()).stop() {
            return;
        }
    }
}
