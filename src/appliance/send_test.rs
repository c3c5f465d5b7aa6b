//! `mien send-test`: sweeps each unit from 0 to 1 and back on every output and logs its name, so that a rig can be wired
//! without a face. The head faces the sensor at 0.8 m; the landmarks of the mean face move with the unit.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::service::{Failure, model, settings};
use crate::settings::Settings;
use crate::signals::Signals;
use crate::source;
use mien_outputs::table;
use mien_outputs::{Output, OutputError, Report, TrackingState, View};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::{Point, Rigid, Vector};
use mien_stages::base::time::Timestamp;
use mien_stages::camera::Camera;
use mien_stages::expression::Expression;
use mien_stages::expression::unit_words;
use mien_stages::expression::units::Units;
use mien_stages::face_model::FaceModel;
use mien_stages::landmarks::Landmarks;

/// Frames of one unit's sweep: a second at 30 Hz.
const SWEEP: u32 = 30;
/// Frames of the neutral face before and after.
const NEUTRAL: u32 = 15;
/// Duration of a frame at the sensor's 30 Hz.
const FRAME: Duration = Duration::from_nanos(33_333_333);
/// Position of the head, sensor frame, metres.
const HEAD_POSITION_M: [f32; 3] = [0.0, 0.0, 0.8];

/// `mien send-test`: every unit swept on every output.
///
/// # Errors
/// As [`Failure`] lists.
pub fn send_test(config: Option<&Path>) -> Result<(), Failure> {
    let settings = settings(config)?;
    // Unit names are logged as information.
    crate::log::start(settings.log_level.max(tracing::Level::INFO));
    let (model, signals) = (model(settings.sensor.model())?, Signals::watch()?);
    Ok(sweep(&settings, &model, &signals.stop)?)
}

/// Motion at weight 1: unit, landmarks, displacement in millimetres to the subject's left, down, into the head.
type Motion = (&'static str, &'static [usize], [f32; 3]);
/// Motions of the units; landmarks that move differently have separate entries.
const MOTIONS: [Motion; 31] = [
    ("AU25", &[65, 66, 67], [0.0, 15.0, 0.0]),
    ("AU20", &[54], [8.0, 0.0, 0.0]),
    ("AU20", &[48], [-8.0, 0.0, 0.0]),
    ("AU18", &[54], [-8.0, 0.0, 0.0]),
    ("AU18", &[48], [8.0, 0.0, 0.0]),
    ("AU30L", &[56, 57, 58, 65, 66, 67], [8.0, 0.0, 0.0]),
    ("AU30R", &[56, 57, 58, 65, 66, 67], [-8.0, 0.0, 0.0]),
    ("AU29", &[56, 57, 58, 65, 66, 67], [0.0, 0.0, -6.0]),
    ("AU22", &[50, 51, 52, 56, 57, 58], [0.0, 0.0, -8.0]),
    ("AU28", &[50, 51, 52, 56, 57, 58], [0.0, 0.0, 6.0]),
    ("AU2L", &[22, 23, 24, 25, 26], [0.0, -6.0, 0.0]),
    ("AU2R", &[17, 18, 19, 20, 21], [0.0, -6.0, 0.0]),
    ("AU4L", &[22, 23, 24, 25, 26], [0.0, 6.0, 0.0]),
    ("AU4R", &[17, 18, 19, 20, 21], [0.0, 6.0, 0.0]),
    ("AU5L", &[43, 44], [0.0, -2.0, 0.0]),
    ("AU5R", &[37, 38], [0.0, -2.0, 0.0]),
    ("AU43L", &[43, 44], [0.0, 9.0, 0.0]),
    ("AU43R", &[37, 38], [0.0, 9.0, 0.0]),
    ("AU9L", &[34, 35], [0.0, -4.0, 0.0]),
    ("AU9R", &[31, 32], [0.0, -4.0, 0.0]),
    ("AU26", &[5, 6, 7, 8, 9, 10, 11], [0.0, 25.0, 0.0]),
    ("AU26", &[55, 56, 57, 58, 59, 65, 66, 67], [0.0, 15.0, 0.0]),
    ("AU17", &[6, 7, 8, 9, 10], [0.0, -8.0, 0.0]),
    ("AU12L", &[54], [6.0, -10.0, 0.0]),
    ("AU12R", &[48], [-6.0, -10.0, 0.0]),
    ("AU1L", &[22, 23], [0.0, -5.0, 0.0]),
    ("AU1R", &[20, 21], [0.0, -5.0, 0.0]),
    ("AU10L", &[52, 53], [0.0, -5.0, 0.0]),
    ("AU10R", &[49, 50], [0.0, -5.0, 0.0]),
    ("AU43", &[37, 38, 43, 44], [0.0, 9.0, 0.0]),
    ("AU5", &[37, 38, 43, 44], [0.0, -2.0, 0.0]),
];

/// Sweeps all units once, a second each; `stop` ends it early.
///
/// # Errors
/// If an output cannot be opened or can never work.
pub fn sweep(settings: &Settings, model: &FaceModel, stop: &AtomicBool) -> Result<(), OutputError> {
    let expression = Expression::new(settings.stages.learning, Units::shipped());
    let names = expression.unit_names();
    let units: Vec<&str> = names.iter().map(|name| name.as_str()).collect();
    let mut sender = Sender {
        outputs: table::open(&settings.outputs, &units)?,
        model,
        camera: source::nominal(),
        start: Instant::now(),
        frames: 0,
    };
    if sender.outputs.is_empty() {
        tracing::warn!(
            "no output is enabled in the configuration, so nothing is sent; enable one (see `mien print-config`)"
        );
        return Ok(());
    }
    let mut weights = vec![0.0; units.len()];
    tracing::info!("sending to {}", table::named(&settings.outputs));
    for _ in 0..NEUTRAL {
        sender.send(&weights, "")?;
    }
    let view = View {
        units: settings.outputs.units.clone(),
        ..View::default()
    };
    for (i, unit) in units.iter().enumerate() {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        let name = Some(view.name(unit)).filter(|name| name != unit);
        let renamed = name.map_or_else(String::new, |name| format!("as {name} "));
        let plain = unit_words::plain(unit).map_or_else(String::new, |plain| plain + " ");
        tracing::info!("{unit} {plain}{renamed}({} of {})", i + 1, units.len());
        for step in 1..=SWEEP {
            weights[i] = 1.0 - (2.0 * step as f32 / SWEEP as f32 - 1.0).abs();
            sender.send(&weights, unit)?;
        }
    }
    for _ in 0..NEUTRAL {
        sender.send(&weights, "")?;
    }
    Ok(())
}

struct Sender<'a> {
    outputs: Vec<Box<dyn Output>>,
    model: &'a FaceModel,
    camera: Camera,
    start: Instant,
    frames: u32,
}

impl Sender<'_> {
    /// Sends one frame when due; `moving` names the unit that moves the landmarks, empty for none.
    fn send(&mut self, weights: &[f32], moving: &str) -> Result<(), OutputError> {
        let due = FRAME * self.frames;
        std::thread::sleep(due.saturating_sub(self.start.elapsed()));
        let pose = Rigid::translation(HEAD_POSITION_M[0], HEAD_POSITION_M[1], HEAD_POSITION_M[2]);
        let weight = weights.iter().copied().fold(0.0, f32::max);
        let head = face(&self.model.shape.mean, moving, weight);
        let landmarks = Landmarks {
            pixels: head.map(|point| self.camera.colour_pixel(&(pose * point))),
            ..Landmarks::certain(head)
        };
        let report = Report {
            frame: self.frames.into(),
            at: Timestamp::from_us(due.as_micros() as u64),
            user: Some(0),
            state: TrackingState::Tracking,
            confidence: 1.0,
            sensor_from_face: Some(&pose),
            landmarks: Some(&landmarks),
            weights,
            ..Report::default()
        };
        self.frames += 1;
        for output in &mut self.outputs {
            output.send(&report)?;
            // Commands have no effect here.
            while output.next_command().is_some() {}
        }
        Ok(())
    }
}

/// The mean face with one unit at a weight, metres.
fn face(mean: &[Point], unit: &str, weight: f32) -> [Point; LANDMARKS] {
    let mut points: [Point; LANDMARKS] = std::array::from_fn(|i| mean[i]);
    for (_, moved, mm) in MOTIONS.iter().filter(|(name, ..)| *name == unit) {
        for &i in *moved {
            points[i] += Vector::from(*mm) * (1e-3 * weight);
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::expression::measures;

    #[test]
    fn every_unit_moves_its_measure_in_the_right_direction() {
        let model = FaceModel::shipped();
        let units = Units::shipped();
        let rest = measures::raw(&face(&model.shape.mean, "", 0.0));
        let mut checked = 0;
        for row in &units.rows {
            for (unit, sign) in [(&row.rises, 1.0), (&row.falls, -1.0)] {
                // No landmark shows a blown cheek.
                let Some(unit) = unit.as_ref().filter(|unit| !unit.starts_with("AU34")) else {
                    continue;
                };
                let acted = measures::raw(&face(&model.shape.mean, unit, 1.0));
                let change = sign * (acted[row.measure as usize] - rest[row.measure as usize]);
                assert!(change > 0.0015, "{unit}: {change}");
                checked += 1;
            }
        }
        assert!(checked >= 26);
    }
}
