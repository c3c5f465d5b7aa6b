//! One person's session: results of each frame, and the truth.

use super::acted::Acted;
use super::sessions::{Trial, landmark_error, lighting, person_seed};
use crate::frame_time::frame_time;
use mien_appliance::pipeline::PipelineError;
use mien_baking::heads::PersonHead;
use mien_sensors::Frame;
use mien_simulator::virtual_head::{HeadAsset, Scene, Simulator, Truth};
use mien_stages::base::capacity::LEARNT_MEASURES;
use mien_stages::base::geometry::Rigid;
use mien_stages::expression::measures::{self, Measure};
use mien_stages::face_model::refinement::PUFFS;
use mien_stages::landmarks::Landmarks;
use mien_stages::users::TrackingState;

/// One frame's results and truth.
pub(super) struct Seen {
    pub(super) pose: Rigid,
    pub(super) true_pose: Rigid,
    /// Mean error of all points, and without the jaw, in outer-eye distances.
    pub(super) error: [f64; 2],
    /// Weights by column.
    pub(super) weights: Vec<f64>,
    /// True weights by column.
    pub(super) acted: Vec<f64>,
    /// True weights by the head's expressions.
    pub(super) expressions: Vec<f32>,
    /// Each measure, found and true, in the unit of the weights.
    pub(super) measures: [[f64; 2]; LEARNT_MEASURES],
}

/// One person's session.
#[derive(Default)]
pub(super) struct Played {
    pub(super) person: usize,
    pub(super) frames: usize,
    /// Names of the weight columns and of the head's expressions.
    pub(super) columns: Vec<String>,
    pub(super) expressions: Vec<String>,
    pub(super) seen: Vec<Seen>,
}

/// Plays one person's session through the whole pipeline.
pub(super) fn play(
    head: PersonHead,
    trial: &Trial,
    numbers: &mut dyn Iterator<Item = usize>,
) -> Result<Played, PipelineError> {
    let seed = person_seed(trial.sessions.seed, head.person);
    let truth = Measured::new(&head.asset);
    let acted = Acted::new(&head.asset);
    let expressions = head.asset.expressions.iter().map(|e| e.name.clone());
    let expressions: Vec<String> = expressions.collect();
    let (light, exposure) = lighting(&mut fastrand::Rng::with_seed(seed));
    let mut simulator = Simulator::new(head.asset, Scene::Acted, seed).with_light(light, exposure);
    let mut pipeline = trial.pipeline(simulator.camera())?;
    let names = pipeline.unit_names();
    let mut frame = Frame::default();
    let mut played = Played {
        person: head.person,
        columns: names.iter().map(|&name| name.to_owned()).collect(),
        expressions,
        ..Played::default()
    };
    for number in numbers {
        let Some(shown) = simulator.draw(frame_time(number), &mut frame) else {
            continue;
        };
        played.frames += 1;
        pipeline.follow(&frame);
        let report = pipeline.report();
        let (TrackingState::Warming | TrackingState::Tracking, Some(pose), Some(landmarks)) =
            (report.state, report.sensor_from_face, report.landmarks)
        else {
            continue;
        };
        let columns = played.columns.iter();
        let truths = columns.map(|unit| acted.true_weight(unit, &shown));
        played.seen.push(Seen {
            pose: *pose,
            true_pose: shown.sensor_from_head,
            error: landmark_error(&landmarks.pixels, &shown),
            weights: report.weights.iter().map(|&w| f64::from(w)).collect(),
            acted: truths.map(|truth| truth.unwrap_or(0.0)).collect(),
            expressions: shown.activations.to_vec(),
            measures: truth.seen_and_true(landmarks, &shown),
        });
    }
    Ok(played)
}

/// True measures of one person.
struct Measured {
    eye_distance: f32,
    /// Indices of right and left cheek among the expressions.
    cheeks: [Option<usize>; PUFFS],
}

impl Measured {
    fn new(asset: &HeadAsset) -> Self {
        let neutral = measures::raw(&asset.landmarks_on(&asset.neutral));
        Self {
            eye_distance: neutral[Measure::EyeDistance as usize],
            cheeks: ["cheekPuff_R", "cheekPuff_L"].map(|name| asset.expression(name)),
        }
    }

    /// Each measure, found and true, both over the true eye distance.
    fn seen_and_true(&self, seen: &Landmarks, shown: &Truth) -> [[f64; 2]; LEARNT_MEASURES] {
        let blown = |k: usize| shown.activations.get(k).copied();
        let blown = self.cheeks.map(|k| k.and_then(blown).unwrap_or(0.0));
        let both = [
            measures::with_cheeks(&seen.head, seen.cheeks),
            measures::with_cheeks(&shown.landmarks_head, blown),
        ];
        core::array::from_fn(|m| [0, 1].map(|k| f64::from(both[k][m] / self.eye_distance)))
    }
}
