//! Signals as requests to a run.

use std::io::{IsTerminal, stderr, stdout};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use crate::service::Failure;

/// Requests set by signals.
pub(super) struct Signals {
    /// SIGTERM, SIGINT, or SIGHUP on a terminal.
    pub(super) stop: Arc<AtomicBool>,
    /// SIGHUP without a terminal.
    pub(super) reload: Arc<AtomicBool>,
}

impl Signals {
    pub(super) fn watch() -> Result<Self, Failure> {
        let signals = Self {
            stop: Arc::default(),
            reload: Arc::default(),
        };
        let Self { stop, reload } = &signals;
        // SIGHUP: closing a terminal ends the run; a service manager requests a reload.
        let on_a_terminal = stdout().is_terminal() || stderr().is_terminal();
        let hang_up = if on_a_terminal { stop } else { reload };
        for (signal, flag) in [(SIGTERM, stop), (SIGINT, stop), (SIGHUP, hang_up)] {
            let registered = signal_hook::flag::register(signal, Arc::clone(flag));
            registered.map_err(Failure::Signals)?;
        }
        Ok(signals)
    }
}
