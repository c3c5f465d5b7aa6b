//! What signals ask for.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use crate::appliance::service::Failure;

/// What the signals asked for.
pub(super) struct Signals {
    pub(super) stop: Arc<AtomicBool>,
    pub(super) reload: Arc<AtomicBool>,
}

impl Signals {
    pub(super) fn watch() -> Result<Self, Failure> {
        let signals = Self {
            stop: Arc::default(),
            reload: Arc::default(),
        };
        for signal in [SIGTERM, SIGINT] {
            signal_hook::flag::register(signal, Arc::clone(&signals.stop))
                .map_err(Failure::Signals)?;
        }
        signal_hook::flag::register(SIGHUP, Arc::clone(&signals.reload))
            .map_err(Failure::Signals)?;
        Ok(signals)
    }
}
