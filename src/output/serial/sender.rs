//! The serial line as an output: an encoder, and a thread that feeds the port.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;

use super::budget::{self, Plan};
use super::encoder::Encoder;
use super::port::{self, Shared};
use super::settings::Settings;
use crate::output::closing;
use crate::output::{Output, OutputError, Report, Tally};

/// A sender of weights, one face at a time.
pub struct Serial {
    encoder: Encoder,
    shared: Arc<Shared>,
    #[cfg(feature = "wires")]
    style: super::settings::Style,
    thread: Option<JoinHandle<()>>,
}

impl Serial {
    /// Starts feeding the port. `units` are the names in the order of the weights.
    ///
    /// # Errors
    /// If an unknown unit is requested, the names do not fit a line, or no thread can be started. Not if the port is absent.
    pub fn new(settings: &Settings, units: &[&str]) -> Result<Self, OutputError> {
        let (encoder, plan) = Encoder::planned(settings, units)?;
        tell(settings, units, &plan);
        let shared = Arc::<Shared>::default();
        let thread = port::feed(settings, encoder.header(), Arc::clone(&shared))?;
        Ok(Self {
            encoder,
            shared,
            #[cfg(feature = "wires")]
            style: settings.style,
            thread: Some(thread),
        })
    }

    /// Output names of the units sent.
    #[must_use]
    pub fn units(&self) -> &[String] {
        self.encoder.units()
    }
}

/// Logs what the line cannot carry.
fn tell(settings: &Settings, units: &[&str], plan: &Plan) {
    let Settings { port, baud, .. } = settings;
    let wanted = |unit: &str| {
        settings.units.is_empty() || settings.units.iter().any(|listed| listed == unit)
    };
    let left_out: Vec<&str> = (0..units.len())
        .filter(|unit| wanted(units[*unit]) && !plan.units.contains(unit))
        .map(|unit| settings.view.name(units[unit]))
        .collect();
    if !left_out.is_empty() {
        tracing::warn!(
            "serial port {port} carries {} of {} units at {baud} bit/s, omitting {}",
            plan.units.len(),
            plan.units.len() + left_out.len(),
            left_out.join(" ")
        );
    }
    if plan.rate_hz < budget::FRAMES_HZ {
        tracing::warn!(
            "serial port {port} carries {:.1} frames per second of up to {} bytes at {baud} bit/s, always the newest; the sensor delivers {}",
            plan.rate_hz,
            plan.frame_bytes,
            budget::FRAMES_HZ
        );
    }
}

impl Output for Serial {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        if let Some(line) = self.encoder.encode(report) {
            self.shared.put(line);
        }
        Ok(())
    }

    #[cfg(feature = "wires")]
    fn switch(&mut self, switch: &crate::output::gesture::Switch<'_>) {
        if crate::output::gesture::ENABLED {
            let shared = &self.shared;
            shared.put_switch(|line| super::frame::switch(self.style, switch, line));
        }
    }

    fn tally(&self) -> Tally {
        let of = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Tally {
            sent: of(&self.shared.sent),
            dropped: of(&self.shared.dropped),
            connected: self.shared.is_open(),
            not_numbers: self.encoder.face.weights.not_numbers(),
            ..Tally::of("serial")
        }
    }
}

impl Drop for Serial {
    /// Sends neutral and absent, as far as the port accepts it within half a second.
    fn drop(&mut self) {
        self.shared.put(self.encoder.neutral());
        self.shared.stop();
        if let Some(thread) = self.thread.take() {
            closing::wait_for(thread);
        }
    }
}
