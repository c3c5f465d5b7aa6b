//! Outputs with their own thread (web, MQTT), as the pipeline sees them: reports are stored for the thread with the weights as
//! that output presents them.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;

use super::worker::{Bell, Shared, Shot};
use super::{
    Command, Output, OutputError, Report, Tally, TrackingState, View, WireWeights, closing,
    unit_range,
};
use crate::base::capacity::{UNITS, USERS};

/// Where reports are stored for an output's thread.
pub struct Front {
    name: &'static str,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    users: [(bool, WireWeights); USERS],
    view: View,
}

impl Front {
    /// Starts `work` on a thread called `name`, the section of the configuration.
    pub(super) fn start(
        name: &'static str,
        units: &[&str],
        view: &View,
        work: impl FnOnce(Arc<Shared>, Bell) + Send + 'static,
    ) -> Result<Self, OutputError> {
        let (shared, bell) = Shared::new().map_err(OutputError::Socket)?;
        let shared = Arc::new(shared);
        let its = Arc::clone(&shared);
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(move || work(its, bell))
            .map_err(OutputError::Thread)?;
        Ok(Self {
            name,
            shared,
            thread: Some(thread),
            users: std::array::from_fn(|_| {
                (false, WireWeights::new(view.channels(units), view.loss))
            }),
            view: view.clone(),
        })
    }
}

impl Output for Front {
    /// Stores the report and wakes the thread.
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        let mut board = self.shared.board();
        if let Some(slot) = report.user.filter(|&slot| slot < USERS) {
            let (known, weights) = &mut self.users[slot];
            *known = true;
            weights.observe(report);
            let present = report.state.is_present();
            let pose = report.sensor_from_face.filter(|_| present);
            let pose = pose.map(|pose| {
                let pose = self.view.pose(pose);
                let (place, turn) = (pose.translation.vector, pose.rotation.coords);
                [place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w]
            });
            let pose = pose.filter(|pose| pose.iter().all(|number| number.is_finite()));
            let confidence = if present {
                unit_range(report.confidence)
            } else {
                0.0
            };
            let shot = &mut board.users[slot];
            fill(shot, report, report.state, weights);
            (shot.pose, shot.confidence, shot.frozen) = (pose, confidence, report.frozen);
        } else {
            for ((known, weights), shot) in self.users.iter_mut().zip(&mut board.users) {
                if *known {
                    weights.observe(report);
                    // Told once more when all is at rest, then no more.
                    *known = !weights.is_neutral();
                    fill(shot, report, TrackingState::Absent, weights);
                }
            }
            let nobody = &mut board.nobody;
            (nobody.frame, nobody.at_us, nobody.fresh) = (report.frame, report.at.as_us(), true);
        }
        drop(board);
        self.shared.ring();
        Ok(())
    }

    fn next_command(&mut self) -> Option<Command> {
        self.shared.board().commands.pop_front()
    }

    fn tally(&self) -> Tally {
        let weights = self.users.iter().map(|(_, weights)| weights);
        Tally {
            not_numbers: weights.map(WireWeights::not_numbers).sum(),
            ..self.shared.tally(self.name)
        }
    }
}

fn fill(shot: &mut Shot, report: &Report, state: TrackingState, weights: &WireWeights) {
    shot.frame = report.frame;
    shot.at_us = report.at.as_us();
    shot.count = shot.count.wrapping_add(1);
    (shot.latency_us, shot.gestures) = (report.latency_us, report.gestures);
    shot.state = state;
    (shot.pose, shot.confidence) = (None, 0.0);
    shot.weights.clear();
    shot.weights.extend(weights.shown().take(UNITS));
    shot.fresh = true;
}

impl Drop for Front {
    /// Sends neutral and absent, as far as receivers accept it within half a second.
    fn drop(&mut self) {
        let mut board = self.shared.board();
        for ((_, weights), shot) in self.users.iter_mut().zip(&mut board.users) {
            if shot.count > 0 {
                weights.reset();
                let at = crate::base::time::Timestamp::from_us(shot.at_us);
                let report = Report {
                    frame: shot.frame,
                    at,
                    ..Report::default()
                };
                fill(shot, &report, TrackingState::Absent, weights);
            }
        }
        drop(board);
        self.shared.stop.store(true, Ordering::Relaxed);
        self.shared.ring();
        if let Some(thread) = self.thread.take() {
            closing::wait_for(thread);
        }
    }
}

/// A weight in JSON: four decimals.
pub(super) struct Weight(pub(super) f32);

impl std::fmt::Display for Weight {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // By hand: a float's own way takes most of the time of a message.
        let parts = (unit_range(self.0) * 10_000.0).round() as u32;
        write!(f, "{}.{:04}", parts / 10_000, parts % 10_000)
    }
}
