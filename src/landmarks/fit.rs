//! Frame by frame: where to start, which schedule to run, when the face is lost, what is reported.
//!
//! Every frame starts from the mean shape at the depth pose and runs all stages: measured on held-out people, a start from
//! the last frame's shape follows lids and brows worse (correlation of the lid measure 0.67 against 0.88). What is constant
//! about a person is averaged slowly: the size of the face against the mean, which then adds nothing to the jitter of the
//! points, and how the face sits in the frame of the head that depth sees (turn and shift), from which the next fit starts.
//! Shape coefficients pass the adaptive filter of [`super::steady`]. Method: paper section 1.2; see
//! [`super::cascade`]. Metres in the head frame, colour pixels, confidence 0…1. No allocation after construction
//! (60 kB a person and 1 MB of [`Scratch`] that fitters of one pipeline share).
//! Degenerate: a head outside the picture, or an end that is not believed, is `None`.

use alloc::sync::Arc;

use super::cascade::{Belief, FaceFit, Solver};
use super::features::OrientationMaps;
use super::refine::{self, Inputs, Refinement};
use super::steady::{ShapeFilter, Steadiness};
use super::view::View;
use super::window::{PIXELS_PER_METRE, Placement, Region, WINDOW, sensor_picture};
use super::{Landmarks, empty_landmarks};
use crate::capacity::PIXELS;
use crate::face_model::{CascadeStage, ConfidenceModel, FaceModel, MAX_MODES, ShapeModel};
use crate::geometry::{Rigid, Rotation, Vector};
use crate::pose::HeadPose;
#[cfg(not(feature = "std"))]
use crate::prelude::*;
use crate::sensor::camera::Camera;
use crate::shared::Shared;
use crate::time::Timestamp;

/// Time that a first frame, or one after a loss, stands for, seconds.
const FIRST_STEP_S: f32 = 0.1;
/// A person's usual correction is a plain mean for so long, and then follows slowly, seconds.
const SETTLED_S: f32 = 2.0;
const USUAL_S: f32 = 120.0;

/// Time over which the turn of the face in its head is averaged, seconds: what the picture shows of it changes with pose and
/// expression, so a shorter mean makes the pose wander.
const TURN_TIME_S: f32 = 40.0;

/// Share of the least confidence that a face which is followed needs: confidence is learnt from faces that are new.
const FOLLOWED_SHARE: f32 = 0.6;

/// Settings of the stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Confidence of the face below which it is lost, 0…1.
    pub min_confidence: f32,
    /// Time over which the size of the face is averaged, seconds.
    pub size_time_s: f32,
    /// Temporal filter of the shape.
    pub steadiness: Steadiness,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            min_confidence: 0.5,
            size_time_s: 10.0,
            steadiness: Steadiness::default(),
        }
    }
}

/// What stays of a face's turn and shift in its head with every frame it is lost.
const FORGOTTEN: f32 = 0.5;

/// What a fit works on and leaves nothing in: big, so that people who are fitted one after the other share it.
pub struct Scratch {
    window: Vec<f32>,
    maps: OrientationMaps,
    solver: Solver,
}

impl Scratch {
    /// Bytes on the heap.
    pub const BYTES: usize = WINDOW * WINDOW * 4 + OrientationMaps::BYTES + Solver::BYTES;
}

impl Default for Scratch {
    fn default() -> Self {
        Self {
            window: vec![0.0; WINDOW * WINDOW],
            maps: OrientationMaps::default(),
            solver: Solver::default(),
        }
    }
}

/// How far beside the mean shape the fit looks, pixels: half a patch and its blur (16), and the way to the landmarks.
const REACH_PX: f32 = 28.0;

/// A new face so far from where depth has the head means another pose: turn, radians, and shift, metres.
const WRONG_RAD: f32 = 0.14;
const WRONG_M: f32 = 0.015;

/// Middle of a face in the head frame, about which a head is leant, metres.
const MIDDLE: Vector = Vector::new(0.0, 0.03, 0.02);

/// Where else a new face is looked for, one place a frame: x and y of the head frame, metres.
const BESIDE: [[f32; 2]; 6] = [
    [0.0, 0.0],
    [0.0, 0.03],
    [0.03, 0.015],
    [-0.03, 0.015],
    [0.0, -0.03],
    [0.0, 0.055],
];

/// Turn and shift of an upright face in a head that is found leaning or beside it.
fn upright(sensor_from_head: &Rotation, place: usize) -> (Rotation, Vector) {
    let (_, _, roll) = crate::geometry::yaw_pitch_roll(sensor_from_head);
    let turn = Rotation::from_axis_angle(&Vector::z_axis(), -roll);
    let [x, y] = BESIDE[place];
    (turn, MIDDLE + turn * (Vector::new(x, y, 0.0) - MIDDLE))
}

/// Fits the landmarks of one face, frame by frame.
pub struct LandmarkFitter {
    settings: Settings,
    shape: ShapeModel,
    cold: Arc<[CascadeStage]>,
    warm: Arc<[CascadeStage]>,
    confidence: Arc<ConfidenceModel>,
    refinement: Option<Arc<Refinement>>,
    /// What the last refinement was made from, and the coefficients before it.
    inputs: Inputs,
    /// Mean correction of this person, and the seconds it was averaged over.
    usual: ([f32; MAX_MODES], f32),
    scratch: Shared<Scratch>,
    /// Of the shape as fitted, which the picture shows, and as depth corrects it.
    filters: [ShapeFilter; 2],
    last_at: Option<Timestamp>,
    /// Logarithm of the face's size against the mean shape, and the seconds it was averaged over.
    log_size: Option<(f32, f32)>,
    /// Mean turn from the head that depth sees to the face that the picture shows.
    turn: Rotation,
    /// Seconds it was averaged over.
    turned_s: f32,
    /// Next of the places beside the pose to look for a new face; goes on from person to person.
    tries: usize,
    /// Mean place of the face's origin in the head that depth sees, metres; across the line of sight only.
    shift: Vector,
    landmarks: Landmarks,
}

impl LandmarkFitter {
    /// A fitter without history; all memory is allocated here.
    #[must_use]
    pub fn new(settings: Settings, model: &FaceModel) -> Self {
        Self::with(settings, model, Shared::default())
    }

    /// As [`Self::new`], with the scratch of others, none of which then runs at the same time.
    #[must_use]
    pub fn with(settings: Settings, model: &FaceModel, scratch: Shared<Scratch>) -> Self {
        Self {
            settings,
            shape: model.shape.clone(),
            cold: model.cold.clone(),
            warm: model.warm.clone(),
            confidence: model.confidence.clone(),
            refinement: model.refinement.clone(),
            inputs: Inputs::new(),
            usual: ([0.0; MAX_MODES], 0.0),
            scratch,
            filters: [(); 2].map(|()| ShapeFilter::new(settings.steadiness)),
            last_at: None,
            log_size: None,
            turn: Rotation::identity(),
            turned_s: 0.0,
            tries: 0,
            shift: Vector::zeros(),
            landmarks: empty_landmarks(),
        }
    }

    /// Forgets the person: the next frame starts cold.
    pub fn reset(&mut self) {
        self.last_at = None;
        self.log_size = None;
        (self.turn, self.turned_s) = (Rotation::identity(), 0.0);
        self.shift = Vector::zeros();
        self.usual = ([0.0; MAX_MODES], 0.0);
        self.filters.iter_mut().for_each(ShapeFilter::reset);
    }

    /// Fits one frame; `None` if there is no face to be found at the pose.
    pub fn fit(
        &mut self,
        luma: &[u8; PIXELS],
        depth: &[u16; PIXELS],
        camera: &Camera,
        pose: &HeadPose,
        at: Timestamp,
    ) -> Option<&Landmarks> {
        let step_s = self.last_at.map_or(FIRST_STEP_S, |last| {
            at.seconds_since(last).clamp(0.0, 1.0) as f32
        });
        let is_new = self.log_size.is_none();
        let mut found = self.look(luma, camera, pose);
        if found.is_none() && is_new {
            // Hair leans a head that is only just found; most people sit upright.
            (self.turn, self.shift) = upright(&pose.sensor_from_head.rotation, self.tries);
            self.tries = (self.tries + 1) % BESIDE.len();
            found = self.look(luma, camera, pose);
        }
        let Some((placement, fit, belief)) = found else {
            self.lose();
            return None;
        };
        self.settle(&placement, &fit, step_s);
        let shape = self.refined(&fit, depth, camera, &pose.sensor_from_head, step_s);
        self.report(&placement, &fit, &shape, &belief, at);
        Some(&self.landmarks)
    }

    /// The fit where the face is expected, if it is believed.
    fn look(
        &mut self,
        luma: &[u8; PIXELS],
        camera: &Camera,
        pose: &HeadPose,
    ) -> Option<(Placement, FaceFit, Belief)> {
        let head_from_face = Rigid::from_parts(self.shift.into(), self.turn);
        let placement = Placement::of_pose(camera, &(pose.sensor_from_head * head_from_face))?;
        let mut start = placement.start;
        start.log_scale += self.log_size.map_or(0.0, |(mean, _)| mean);
        let (fit, belief) = self.run(luma, &placement, &start);
        // What was a face in the frame before is one on less.
        let share = self.last_at.map_or(1.0, |_| FOLLOWED_SHARE);
        (belief.face >= self.settings.min_confidence * share).then_some((placement, fit, belief))
    }

    /// What to turn a depth pose by (`sensor_from_head * turn`) to agree with the face in the picture. Where a head's frame
    /// sits on a face is a convention that depth alone knows badly: a person's forehead leans as much as their chin. The
    /// picture tells; averaged over seconds, because it is a constant of the person.
    #[must_use]
    pub fn turn(&self) -> Rotation {
        self.turn
    }

    /// Where the face of the last fit is in the head that depth sees, if that is so far off that depth has the wrong pose;
    /// the next fit then starts from the pose alone.
    pub fn straighten(&mut self) -> Option<Rigid> {
        let off = self.turn.angle() > WRONG_RAD || self.shift.norm() > WRONG_M;
        let head_from_face = Rigid::from_parts(self.shift.into(), self.turn);
        off.then(|| {
            (self.turn, self.turned_s) = (Rotation::identity(), 0.0);
            self.shift = Vector::zeros();
            head_from_face
        })
    }

    fn lose(&mut self) {
        self.last_at = None;
        self.filters.iter_mut().for_each(ShapeFilter::reset);
        // Perhaps what was learnt of this face is what misleads: back to depth alone within a few frames.
        self.turn = Rotation::from_scaled_axis(self.turn.scaled_axis() * FORGOTTEN);
        self.turned_s *= FORGOTTEN;
        self.shift *= FORGOTTEN;
    }

    /// From the mean shape at the pose: a fit that goes on from the last frame's shape lags behind blinks and brows.
    fn run(&self, luma: &[u8; PIXELS], placement: &Placement, depth: &View) -> (FaceFit, Belief) {
        let mut scratch = self.scratch.borrow();
        let Scratch {
            window,
            maps,
            solver,
        } = &mut *scratch;
        let start = FaceFit {
            view: *depth,
            shape: [0.0; MAX_MODES],
        };
        solver.project(&self.shape, &start);
        let region = Region::around(&solver.window, REACH_PX);
        placement.resample(&sensor_picture(luma), &region, window);
        maps.compute(window, &region);
        let near = solver.run(&self.cold, &self.shape, maps, &start, depth);
        // The later stages see finer patches and move all modes: they finish the fit.
        let fit = solver.run(&self.warm, &self.shape, maps, &near, depth);
        let belief = solver.belief(&self.confidence, &self.shape, maps, &fit);
        (fit, belief)
    }

    /// Averages the constants of the person, size and turn.
    fn settle(&mut self, placement: &Placement, fit: &FaceFit, step_s: f32) {
        let log_size = fit.view.log_scale - PIXELS_PER_METRE.ln();
        let (mean, time) = self.log_size.unwrap_or((log_size, 0.0));
        let time = (time + step_s).min(self.settings.size_time_s);
        let share = (step_s / time.max(step_s)).clamp(0.0, 1.0);
        let mean = mean + (log_size - mean) * share;
        let start = &placement.start;
        let [x, y] = [0, 1].map(|k| fit.view.shift[k] - start.shift[k]);
        let across = Vector::new(x, y, 0.0) / PIXELS_PER_METRE;
        self.shift += self.turn * (start.rotation.inverse() * across) * share;
        let turn = start.rotation.inverse() * fit.view.rotation;
        self.turned_s = (self.turned_s + step_s).min(TURN_TIME_S);
        let share = (step_s / self.turned_s.max(step_s)).clamp(0.0, 1.0);
        self.turn *= Rotation::from_scaled_axis(turn.scaled_axis() * share);
        self.log_size = Some((mean, time));
    }

    /// Size of the face against the model's.
    fn size(&self) -> f32 {
        self.log_size.map_or(1.0, |(mean, _)| mean.exp())
    }

    /// The fitted coefficients, corrected by what depth sees.
    fn refined(
        &mut self,
        fit: &FaceFit,
        depth: &[u16; PIXELS],
        camera: &Camera,
        pose: &Rigid,
        step_s: f32,
    ) -> [f32; MAX_MODES] {
        let mut shape = fit.shape;
        self.shape.shape(&shape, &mut self.landmarks.head);
        self.inputs = refine::inputs(
            &shape[..self.shape.modes.len()],
            &fit.view.rotation.scaled_axis(),
            &self.landmarks.head,
            self.size(),
            depth,
            camera,
            &(pose * Rigid::from_parts(self.shift.into(), self.turn)),
        );
        if let Some(refinement) = &self.refinement {
            let mut inputs = self.inputs.clone();
            self.landmarks.cheeks = refinement.refine(&mut inputs, &mut shape);
            // Learnt were changes; what is constant of a person is not known better than the fit has it.
            let (usual, time) = &mut self.usual;
            *time = (*time + step_s).min(SETTLED_S);
            let memory = if *time < SETTLED_S { *time } else { USUAL_S };
            for ((b, usual), fitted) in shape.iter_mut().zip(usual).zip(&fit.shape) {
                *usual += (*b - fitted - *usual) * (step_s / memory).min(1.0);
                *b -= *usual;
            }
        }
        shape
    }

    /// What the last fit was refined from: see [`refine::inputs`].
    #[must_use]
    pub fn refined_from(&self) -> &Inputs {
        &self.inputs
    }

    fn report(
        &mut self,
        placement: &Placement,
        fit: &FaceFit,
        shape: &[f32; MAX_MODES],
        belief: &Belief,
        at: Timestamp,
    ) {
        self.last_at = Some(at);
        // Depth knows heights and expressions better, the picture its own pixels.
        let [fitted, refined] = &mut self.filters;
        self.shape
            .shape(&fitted.follow(&fit.shape, at), &mut self.landmarks.head);
        let project = fit.view.projection();
        for (pixel, point) in self.landmarks.pixels.iter_mut().zip(&self.landmarks.head) {
            *pixel = placement.picture_pixel(project(point));
        }
        self.shape
            .shape(&refined.follow(shape, at), &mut self.landmarks.head);
        let size = self.size();
        for point in &mut self.landmarks.head {
            *point *= size;
        }
        self.landmarks.point_confidence = belief.landmark;
        self.landmarks.confidence = belief.face;
    }
}
