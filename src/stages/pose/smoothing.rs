//! Temporal smoothing of the head pose: removes the jitter caused by depth noise, with little delay.
//!
//! Two filters. `Window`: a weighted mean of the last poses (paper section 1.1, step 3), with weights of the least-squares line
//! evaluated at the newest pose, so without delay at constant speed. `Adaptive`: a first-order low-pass whose cut-off rises with
//! speed (1 € filter, Casiez, Roussel & Vogel 2012), so that a head at rest does not jitter and a moving one has little delay.
//!
//! Rotations are averaged in the tangent space at the newest one (exponential map), translations as vectors; both in the
//! sensor frame, metres and radians. Memory: [`MAX_WINDOW`] poses. Degenerate: after a gap of [`GAP_S`] or time running
//! backwards the filter restarts. Limitation: no prediction.

use crate::base::geometry::{Rigid, Rotation, Vector};
use crate::base::time::Timestamp;

/// Most poses of a window.
pub const MAX_WINDOW: usize = 16;
/// Without a pose for this long the filter restarts, seconds.
const GAP_S: f64 = 0.35;
/// Cut-off of the adaptive filter's speed estimate, hertz: its authors' default.
const SPEED_CUTOFF_HZ: f32 = 1.0;
/// Lever that converts rotations to paths on the face, metres, so that one cut-off law serves rotation and translation.
const LEVER_M: f32 = 0.1;

/// The filter and its strength.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Smoothing {
    /// No smoothing.
    Off,
    /// Least-squares line through this many poses, 1 to [`MAX_WINDOW`]; up to 2 are not smoothed.
    Window(usize),
    /// Low-pass with speed-dependent cut-off.
    Adaptive {
        /// Cut-off at rest, hertz; clamped to at least 0.001, so that the filter never stops.
        rest_hz: f32,
        /// Rise of the cut-off, hertz per (m/s) of the face's surface.
        rise: f32,
    },
}

impl Smoothing {
    /// Best settings for tracking a head.
    pub const ADAPTIVE: Self = Self::Adaptive {
        rest_hz: 1.0,
        rise: 800.0,
    };
}

impl Default for Smoothing {
    fn default() -> Self {
        Self::ADAPTIVE
    }
}

/// The filter's state.
#[derive(Clone, Debug, Default)]
pub struct PoseFilter {
    smoothing: Smoothing,
    window: heapless::Deque<Rigid, MAX_WINDOW>,
    last: Option<(Rigid, Timestamp)>,
    /// Smoothed velocities: rotation vector (rad/s, sensor frame), translation (m/s).
    speed: (Vector, Vector),
    last_raw: Rigid,
}

fn low_pass_gain(cutoff_hz: f32, dt: f32) -> f32 {
    let tau = 1.0 / (core::f32::consts::TAU * cutoff_hz.max(1e-3));
    dt / (dt + tau)
}

impl PoseFilter {
    /// An empty filter.
    pub fn new(smoothing: Smoothing) -> Self {
        Self {
            smoothing,
            ..Self::default()
        }
    }

    /// Forgets the past.
    pub fn reset(&mut self) {
        *self = Self::new(self.smoothing);
    }

    /// Adds a measured pose (`sensor_from_head`) and returns the smoothed one.
    pub fn smooth(&mut self, raw: Rigid, at: Timestamp) -> Rigid {
        let dt = self.last.map(|(_, before)| at.seconds_since(before));
        if !dt.is_some_and(|dt| dt > 0.0 && dt < GAP_S) {
            self.reset();
        }
        let smoothed = match (self.smoothing, self.last) {
            (Smoothing::Off, _) => raw,
            (Smoothing::Window(frames), _) => self.window_mean(raw, frames),
            (Smoothing::Adaptive { .. }, None) => raw,
            (Smoothing::Adaptive { rest_hz, rise }, Some((previous, _))) => {
                self.adaptive(raw, previous, dt.unwrap_or_default() as f32, rest_hz, rise)
            }
        };
        self.last = Some((smoothed, at));
        self.last_raw = raw;
        smoothed
    }

    fn window_mean(&mut self, raw: Rigid, frames: usize) -> Rigid {
        let frames = frames.clamp(1, MAX_WINDOW);
        while self.window.len() >= frames {
            self.window.pop_front();
        }
        let _ = self.window.push_back(raw);
        let (mut turn, mut shift) = (Vector::zeros(), Vector::zeros());
        let n = self.window.len() as f32;
        for (k, pose) in self.window.iter().enumerate() {
            // Least squares of a line, at its newest end.
            let weight = (6.0 * k as f32 - 2.0 * n + 4.0) / (n * (n + 1.0));
            turn += (pose.rotation * raw.rotation.inverse()).scaled_axis() * weight;
            shift += pose.translation.vector * weight;
        }
        Rigid::from_parts(shift.into(), Rotation::new(turn) * raw.rotation)
    }

    fn adaptive(&mut self, raw: Rigid, previous: Rigid, dt: f32, rest_hz: f32, rise: f32) -> Rigid {
        let gain = low_pass_gain(SPEED_CUTOFF_HZ, dt);
        let turn_speed = (raw.rotation * self.last_raw.rotation.inverse()).scaled_axis() / dt;
        let shift_speed = (raw.translation.vector - self.last_raw.translation.vector) / dt;
        self.speed.0 += (turn_speed - self.speed.0) * gain;
        self.speed.1 += (shift_speed - self.speed.1) * gain;
        let turn_gain = low_pass_gain(rest_hz + rise * LEVER_M * self.speed.0.norm(), dt);
        let shift_gain = low_pass_gain(rest_hz + rise * self.speed.1.norm(), dt);
        let turn = (raw.rotation * previous.rotation.inverse()).scaled_axis();
        Rigid::from_parts(
            (previous.translation.vector
                + (raw.translation.vector - previous.translation.vector) * shift_gain)
                .into(),
            Rotation::new(turn * turn_gain) * previous.rotation,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::rotation_from_yaw_pitch_roll;

    fn pose(yaw: f32, x: f32) -> Rigid {
        Rigid::from_parts(
            Vector::new(x, 0.0, 0.7).into(),
            rotation_from_yaw_pitch_roll(yaw, 0.0, 0.0),
        )
    }

    /// Jitter at rest (share of the noise that is left) and lag at 60°/s (frames) of a filter.
    fn jitter_and_lag(smoothing: Smoothing) -> (f32, f32) {
        let frame = |k: u64| Timestamp::from_us(k * 33_333);
        let mut rng = fastrand::Rng::with_seed(5);
        // Noise of a tenth of a degree, the size the tracker measures at 0.7 m.
        let noise = 0.1f32.to_radians();
        let mut filter = PoseFilter::new(smoothing);
        let (mut sum_in, mut sum_out) = (0.0f64, 0.0f64);
        for k in 0..2000 {
            let yaw = (0..12).map(|_| rng.f32() - 0.5).sum::<f32>() * noise;
            let out = filter
                .smooth(pose(yaw, 0.0), frame(k))
                .rotation
                .scaled_axis()
                .y;
            if k > 30 {
                sum_in += f64::from(yaw * yaw);
                sum_out += f64::from(out * out);
            }
        }
        let speed = 60f32.to_radians() / 30.0;
        filter.reset();
        let mut lag = 0.0;
        for k in 0..30u64 {
            let yaw = speed * k as f32;
            let out = filter
                .smooth(pose(yaw, 0.0), frame(k))
                .rotation
                .scaled_axis()
                .y;
            lag = (yaw - out) / speed;
        }
        ((sum_out / sum_in).sqrt() as f32, lag)
    }

    #[test]
    fn jitter_against_lag() {
        println!("filter                      jitter left   lag at 60 deg/s, frames");
        let line = |name: &str, s| {
            let (jitter, lag) = jitter_and_lag(s);
            println!("{name:<28}{jitter:>10.2}{lag:>14.2}");
            (jitter, lag)
        };
        line("off", Smoothing::Off);
        for n in [2, 3, 5, 7, 9] {
            let (jitter, lag) = line(&format!("window {n}"), Smoothing::Window(n));
            // Deviation of a line at its end.
            let expected = ((4 * n - 2) as f32 / (n * (n + 1)) as f32).sqrt();
            assert!((jitter - expected).abs() < 0.03, "{n}: {jitter}");
            assert!(lag.abs() < 0.01, "{n}: {lag}");
        }
        for (rest_hz, rise) in [
            (1.0, 60.0),
            (1.5, 60.0),
            (2.5, 60.0),
            (1.5, 120.0),
            (1.5, 30.0),
        ] {
            line(
                &format!("adaptive {rest_hz} Hz, {rise}"),
                Smoothing::Adaptive { rest_hz, rise },
            );
        }
        let (jitter, lag) = line("default", Smoothing::default());
        let (window, _) = jitter_and_lag(Smoothing::Window(7));
        assert!(jitter < window && lag < 0.33, "no better than a window");
    }

    #[test]
    fn a_pose_at_rest_is_kept_exactly_and_a_gap_starts_anew() {
        for smoothing in [Smoothing::Off, Smoothing::Window(5), Smoothing::default()] {
            let mut filter = PoseFilter::new(smoothing);
            for k in 0..20 {
                let out = filter.smooth(pose(0.4, 0.1), Timestamp::from_us(k * 33_333));
                assert!((pose(0.4, 0.1).inverse() * out).rotation.angle() < 1e-3);
            }
            let late = Timestamp::from_us(20 * 33_333 + 1_000_000);
            let out = filter.smooth(pose(-0.4, 0.0), late);
            assert!((out.translation.vector.x).abs() < 1e-6);
        }
    }

    /// Two poses whose turns do not commute: a head far turned that nods a little.
    fn turned_and_nodding() -> [Rigid; 2] {
        [0.0, 0.1].map(|nod| {
            Rigid::from_parts(
                Vector::new(0.1 * nod, 0.0, 0.7).into(),
                Rotation::new(Vector::x() * nod) * rotation_from_yaw_pitch_roll(0.9, 0.2, 0.1),
            )
        })
    }

    #[test]
    fn filters_interpolate_by_their_gain() {
        let [one, other] = turned_and_nodding();
        let time = |k: u64| Timestamp::from_us(k * 33_333);
        // A line through one, one and other ends at 5/6. A low-pass at 5 Hz takes dt/(dt + 1/(2 pi 5)) of the way.
        let low_pass = Smoothing::Adaptive {
            rest_hz: 5.0,
            rise: 0.0,
        };
        for (smoothing, share) in [(Smoothing::Window(3), 5.0 / 6.0), (low_pass, 0.511_54)] {
            let mut filter = PoseFilter::new(smoothing);
            filter.smooth(one, time(0));
            filter.smooth(one, time(1));
            let out = filter.smooth(other, time(2));
            let expected = one.lerp_slerp(&other, share);
            let apart = out.rotation.angle_to(&expected.rotation);
            assert!(apart < 2e-4, "{smoothing:?}: {apart} rad");
            let apart = (out.translation.vector - expected.translation.vector).norm();
            assert!(apart < 2e-6, "{smoothing:?}: {apart} m");
        }
    }

    #[test]
    fn the_cut_off_rises_with_speed() {
        // 0.01 m a frame are 0.3 m/s, of which the estimate takes 0.173 17 (1 Hz): 0.051 95 m/s. Cut-off 5 + 300 * that =
        // 20.585 Hz takes 0.811 73 of the way. Then the head rests: 0.042 95 m/s, 17.886 Hz, 0.789 29 of what is left.
        // A turn of 0.1 rad at a lever of 0.1 m is the same path.
        let time = |k: u64| Timestamp::from_us(k * 33_333);
        let mut filter = PoseFilter::new(Smoothing::Adaptive {
            rest_hz: 5.0,
            rise: 300.0,
        });
        filter.smooth(pose(0.0, 0.0), time(0));
        for (k, share) in [(1, 0.811_73), (2, 0.960_33)] {
            let out = filter.smooth(pose(0.1, 0.01), time(k));
            assert!((out.translation.vector.x - 0.01 * share).abs() < 3e-6);
            assert!((out.rotation.angle() - 0.1 * share).abs() < 1e-4);
        }
    }

    #[test]
    fn restarts_after_a_gap_or_backward_time() {
        for (gap_ms, bridged) in [(340, true), (360, false)] {
            let mut filter = PoseFilter::new(Smoothing::Window(3));
            filter.smooth(pose(0.0, 0.0), Timestamp::from_us(967_000));
            filter.smooth(pose(0.0, 0.0), Timestamp::from_us(1_000_000));
            let out = filter.smooth(
                pose(0.0, 0.3),
                Timestamp::from_us(1_000_000 + gap_ms * 1000),
            );
            let expected = if bridged { 0.25 } else { 0.3 };
            assert!((out.translation.vector.x - expected).abs() < 1e-6);
        }
        let mut filter = PoseFilter::new(Smoothing::Window(2));
        filter.smooth(pose(0.0, 0.0), Timestamp::from_us(1_000_000));
        let out = filter.smooth(pose(0.0, 0.3), Timestamp::from_us(1_000_000));
        assert!((out.translation.vector.x - 0.3).abs() < 1e-6);
    }

    #[test]
    fn the_least_cut_off_is_a_millihertz() {
        // 0.2 s of a time constant of 1/(2 pi 0.001 Hz) = 159.155 s.
        let mut filter = PoseFilter::new(Smoothing::Adaptive {
            rest_hz: 0.0,
            rise: 0.0,
        });
        filter.smooth(pose(0.0, 0.0), Timestamp::from_us(0));
        let out = filter.smooth(pose(0.0, 1.0), Timestamp::from_us(200_000));
        let share = out.translation.vector.x;
        assert!((share - 0.2 / 159.355).abs() < 1e-6, "{share}");
    }
}
