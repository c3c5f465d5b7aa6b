//! Fits a face frame by frame: start, stages, loss of the face, result.
//!
//! Every frame starts from the mean shape at the depth pose and runs all stages: on held-out people, starting from the last
//! frame's shape tracks lids and brows worse (correlation of the lid measure 0.67 against 0.88). Two constants of the person
//! are averaged slowly: the size of the face relative to the mean, so that it adds no jitter to the points, and the pose of
//! the face within the head that depth sees (rotation and shift), from which the next fit starts.
//! Shape coefficients pass the adaptive filter of [`super::steady`]. Method: paper section 1.2; see [`super::cascade`].
//! Metres in the head frame, colour pixels, confidence 0…1. No allocation after construction (60 kB per person; 1 MB of
//! [`Scratch`] is lent to each fit). Degenerate: a head outside the picture, or a low-confidence result, gives `None`.
//! One file: the state of one face, and how a frame changes it.

use alloc::sync::Arc;

use super::cascade::{Belief, FaceFit, Solver};
use super::eyes;
use super::features::OrientationMaps;
use super::points::Landmarks;
use super::refine;
use super::relief;
use super::steady::ShapeFilter;
use super::view::View;
use super::window::{PIXELS_PER_METRE, Placement, Region, WINDOW, sensor_picture};
use crate::base::capacity::PIXELS;
use crate::base::defaults;
use crate::base::frames::{Head, HeadFromFace, Motion, SensorFromFace, SensorFromHead};
use crate::base::geometry::{Rigid, Rotation, Vector};
use crate::base::one_euro::Cutoffs;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::time::Timestamp;
use crate::camera::Camera;
use crate::face_model::refinement::{Inputs, Refinement};
use crate::face_model::scheme::MOUTH;
use crate::face_model::{CascadeStage, ConfidenceModel, FaceModel, MAX_MODES, ShapeModel};
use crate::pose::HeadPose;

/// Time that the first frame after a start or a loss stands for, seconds.
const FIRST_STEP_S: f32 = 0.1;
/// A person's usual correction is a plain mean for this long, then a slow running mean, seconds.
const SETTLED_S: f32 = 2.0;
const USUAL_S: f32 = 120.0;

/// Time over which the face's rotation within the head is averaged, seconds: its estimate changes with pose and expression,
/// so a shorter mean makes the pose wander.
const TURN_TIME_S: f32 = 40.0;

/// Factor on the least confidence for a face that is already tracked: confidence is trained on newly found faces.
const FOLLOWED_SHARE: f32 = 0.6;

defaults! {
    /// Settings of the stage.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Settings {
        /// Confidence of the face below which it is lost, 0…1.
        pub min_confidence: f32 = 0.5,
        /// Time over which the size of the face is averaged, seconds.
        pub size_time_s: f32 = 10.0,
        /// Temporal filter of the shape; speeds in deviations per second.
        pub steadiness: Cutoffs<f32> = Cutoffs { still_hz: 3.0, per_speed: 2.0, speed_hz: 3.0 },
    }
}

/// Least confidence of a face that depth does not confirm.
const FOUND: f32 = 0.8;
/// Confidence from which the search continues where the last round ended.
const PROMISING: f32 = 0.2;
/// Most rounds of a search.
const SEARCH_ROUNDS: usize = 4;

/// Decay per lost frame of the face's rotation and shift within the head: of a face that was seen before, and of a stranger's,
/// for whom they were only tried.
const FORGOTTEN: f32 = 0.98;
const TRIED: f32 = 0.5;

defaults! {
    /// Scratch of a fit, stateless between fits; large, so one serves all people who are fitted one after the other.
    pub struct Scratch {
        window: Vec<f32> = vec![0.0; WINDOW * WINDOW],
        maps: OrientationMaps = OrientationMaps::default(),
        solver: Solver = Solver::default(),
    }
}

/// Margin around the mean shape that the fit needs, pixels: half a patch with its blur (16), and the distance to the landmarks.
const REACH_PX: f32 = 28.0;

/// A new face this far from where depth has the head implies another pose: rotation, radians, and shift, metres.
const WRONG_RAD: f32 = 0.14;
const WRONG_M: f32 = 0.015;

/// Middle of a face in the head frame, the pivot for correcting the head pose, metres.
const MIDDLE: Vector = Vector::new(0.0, 0.03, 0.02);

/// Other places to search for a new face, one per frame: x and y of the head frame, metres.
const BESIDE: [[f32; 2]; 6] = [
    [0.0, 0.0],
    [0.0, 0.03],
    [0.03, 0.015],
    [-0.03, 0.015],
    [0.0, -0.03],
    [0.0, 0.055],
];

/// Rotation and shift of an upright face within a head that was found tilted or displaced.
fn upright(sensor_from_head: &Rotation, place: usize) -> (Rotation, Vector) {
    let (_, _, roll) = crate::base::geometry::yaw_pitch_roll(sensor_from_head);
    let turn = Rotation::from_axis_angle(&Vector::z_axis(), -roll);
    let [x, y] = BESIDE[place];
    (turn, MIDDLE + turn * (Vector::new(x, y, 0.0) - MIDDLE))
}

/// Rotation, and shift across the line of sight in metres, of a view relative to its start, in the axes of the face.
fn moved(start: &View, end: &View) -> Rigid {
    let back = start.rotation.inverse();
    let [x, y] = [0, 1].map(|k| end.shift[k] - start.shift[k]);
    let across = back * Vector::new(x, y, 0.0) / PIXELS_PER_METRE;
    Rigid::from_parts(across.into(), back * end.rotation)
}

/// Fits the landmarks of one face, frame by frame.
pub struct LandmarkFitter {
    settings: Settings,
    shape: ShapeModel,
    cold: Arc<[CascadeStage]>,
    warm: Arc<[CascadeStage]>,
    confidence: Arc<ConfidenceModel>,
    refinement: Option<Arc<Refinement>>,
    /// Inputs of the last refinement, and the coefficients before it.
    inputs: Inputs,
    /// Mean correction of this person, and the seconds averaged.
    usual: ([f32; MAX_MODES], f32),
    /// Filters of the shape as fitted to the image, and as corrected by depth.
    filters: [ShapeFilter; 2],
    last_at: Option<Timestamp>,
    /// Logarithm of the face's size relative to the mean shape, and the seconds averaged.
    log_size: Option<(f32, f32)>,
    /// Mean rotation from the head seen by depth to the face seen in the image.
    turn: Rotation,
    /// Seconds averaged.
    turned_s: f32,
    /// Index of the next place beside the pose to search for a new face; continues from person to person.
    tries: usize,
    /// Mean position of the face's origin in the head seen by depth, metres; across the line of sight only.
    shift: Vector,
    /// See [`Self::image_residual`].
    image_residual: Motion<Head, Head>,
    landmarks: Landmarks,
}

impl LandmarkFitter {
    /// Creates a fitter without history; all memory is allocated here.
    pub fn new(settings: Settings, model: &FaceModel) -> Self {
        Self {
            settings,
            shape: model.shape.clone(),
            cold: model.cold.clone(),
            warm: model.warm.clone(),
            confidence: model.confidence.clone(),
            refinement: model.refinement.clone(),
            inputs: Inputs::new(),
            usual: ([0.0; MAX_MODES], 0.0),
            filters: [(); 2].map(|()| ShapeFilter::new(settings.steadiness)),
            last_at: None,
            log_size: None,
            turn: Rotation::identity(),
            turned_s: 0.0,
            tries: 0,
            shift: Vector::zeros(),
            image_residual: Motion::identity(),
            landmarks: Landmarks::default(),
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
        scratch: &mut Scratch,
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
        let mut found = self.look(scratch, luma, camera, pose);
        if found.is_none() && is_new {
            // Hair leans a head that is only just found; most people sit upright.
            (self.turn, self.shift) = upright(&pose.sensor_from_head.rotation, self.tries);
            self.tries = (self.tries + 1) % BESIDE.len();
            found = self.look(scratch, luma, camera, pose);
        }
        let Some((placement, fit, belief)) = found else {
            self.lose();
            return None;
        };
        self.settle(&placement, &fit, step_s);
        let sensor_from_face = pose.sensor_from_head * self.head_from_face();
        let shape = self.refined(&fit, depth, camera, &sensor_from_face, step_s);
        self.report(luma, &placement, &fit, &shape, &belief, at);
        let mouth = &self.landmarks.head[MOUTH];
        let hidden = mouth
            .iter()
            .filter(|p| relief::is_hidden(depth, camera, &sensor_from_face, p));
        self.landmarks.mouth_hidden = hidden.count() as f32 / MOUTH.len() as f32;
        Some(&self.landmarks)
    }

    /// The fit at the expected pose, if confident.
    fn look(
        &mut self,
        scratch: &mut Scratch,
        luma: &[u8; PIXELS],
        camera: &Camera,
        pose: &HeadPose,
    ) -> Option<(Placement, FaceFit, Belief)> {
        let placement =
            Placement::of_pose(camera, &(pose.sensor_from_head * self.head_from_face()))?;
        let mut start = placement.start;
        start.log_scale += self.log_size.map_or(0.0, |(mean, _)| mean);
        let (fit, belief) = self.run(scratch, luma, &placement, &start);
        // What was a face in the frame before is one on less.
        let share = self.last_at.map_or(1.0, |_| FOLLOWED_SHARE);
        (belief.face >= self.settings.min_confidence * share).then_some((placement, fit, belief))
    }

    /// Rotation that makes a depth pose agree with the face in the image. Where a head's frame sits on a face is a convention
    /// that depth alone determines badly, because foreheads and chins slope differently. The image determines it; averaged over
    /// seconds, because it is a constant of the person.
    pub fn rotation_in_head(&self) -> HeadFromFace {
        HeadFromFace::from_parts(Vector::zeros(), self.turn)
    }

    /// Pose of the face within the head seen by depth.
    fn head_from_face(&self) -> HeadFromFace {
        HeadFromFace::from_parts(self.shift, self.turn)
    }

    /// Difference between the head pose implied by the last fit, given the usual pose of the face within the head, and the depth
    /// pose: `sensor_from_head * image_residual` is the pose according to the image.
    pub fn image_residual(&self) -> Motion<Head, Head> {
        self.image_residual
    }

    /// Looks for any face near a guessed pose: its confidence and the head pose. Nothing is learned from it.
    pub fn search_face(
        &self,
        scratch: &mut Scratch,
        luma: &[u8; PIXELS],
        camera: &Camera,
        guess: &SensorFromHead,
    ) -> Option<(f32, SensorFromHead)> {
        let mut pose = *guess;
        for _ in 0..SEARCH_ROUNDS {
            let placement = Placement::of_pose(camera, &pose)?;
            let (fit, belief) = self.run(scratch, luma, &placement, &placement.start);
            // Nothing is known of how this face sits in its head: as usual.
            pose = pose * Motion::<Head, Head>::of(moved(&placement.start, &fit.view));
            if belief.face >= FOUND {
                return Some((belief.face, pose));
            }
            if belief.face < PROMISING {
                break;
            }
        }
        None
    }

    /// Pose of the last fit's face within the head seen by depth, if it is so far off that the depth pose must be wrong; the next
    /// fit then starts from the pose alone.
    pub fn take_correction(&mut self) -> Option<HeadFromFace> {
        let off = self.turn.angle() > WRONG_RAD || self.shift.norm() > WRONG_M;
        let head_from_face = self.head_from_face();
        off.then(|| {
            (self.turn, self.turned_s) = (Rotation::identity(), 0.0);
            self.shift = Vector::zeros();
            head_from_face
        })
    }

    fn lose(&mut self) {
        self.last_at = None;
        self.filters.iter_mut().for_each(ShapeFilter::reset);
        // Perhaps what was learnt of this face is what misleads: back to depth alone within two seconds, not at once, for most
        // faces are lost by a look down.
        let is_known = self.log_size.is_some();
        let kept = if is_known { FORGOTTEN } else { TRIED };
        self.turn = Rotation::from_scaled_axis(self.turn.scaled_axis() * kept);
        self.turned_s *= kept;
        self.shift *= kept;
    }

    /// Starts from the mean shape at the pose: continuing from the last frame's shape lags behind blinks and brows.
    fn run(
        &self,
        scratch: &mut Scratch,
        luma: &[u8; PIXELS],
        placement: &Placement,
        depth: &View,
    ) -> (FaceFit, Belief) {
        let Scratch {
            window,
            maps,
            solver,
        } = scratch;
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

    /// Averages the constants of the person, size and rotation.
    fn settle(&mut self, placement: &Placement, fit: &FaceFit, step_s: f32) {
        let log_size = fit.view.log_scale - PIXELS_PER_METRE.ln();
        let (mean, time) = self.log_size.unwrap_or((log_size, 0.0));
        let time = (time + step_s).min(self.settings.size_time_s);
        let share = (step_s / time.max(step_s)).clamp(0.0, 1.0);
        let mean = mean + (log_size - mean) * share;
        let moved = moved(&placement.start, &fit.view);
        // Further off than this is no way to sit in a head.
        let usual = HeadFromFace::of(Rigid::new(
            self.shift.cap_magnitude(WRONG_M),
            self.turn.scaled_axis().cap_magnitude(WRONG_RAD),
        ));
        let seen = HeadFromFace::of(*self.head_from_face() * moved);
        self.image_residual = seen * usual.inverse();
        self.shift += self.turn * moved.translation.vector * share;
        self.turned_s = (self.turned_s + step_s).min(TURN_TIME_S);
        let share = (step_s / self.turned_s.max(step_s)).clamp(0.0, 1.0);
        self.turn *= Rotation::from_scaled_axis(moved.rotation.scaled_axis() * share);
        self.log_size = Some((mean, time));
    }

    /// Size of the face relative to the model.
    fn size(&self) -> f32 {
        self.log_size.map_or(1.0, |(mean, _)| mean.exp())
    }

    /// The fitted coefficients, corrected by depth.
    fn refined(
        &mut self,
        fit: &FaceFit,
        depth: &[u16; PIXELS],
        camera: &Camera,
        sensor_from_face: &SensorFromFace,
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
            sensor_from_face,
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

    /// Inputs of the last refinement: see [`refine::inputs`].
    pub fn refined_from(&self) -> &Inputs {
        &self.inputs
    }

    fn report(
        &mut self,
        luma: &[u8; PIXELS],
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
        self.landmarks.eyes = eyes::cut(&sensor_picture(luma), &self.landmarks.pixels);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::{Point, rotation_from_yaw_pitch_roll, yaw_pitch_roll};

    fn fitter() -> LandmarkFitter {
        LandmarkFitter::new(Settings::default(), &FaceModel::shipped())
    }

    fn placement() -> Placement {
        let head = Rigid::from_parts(
            Vector::new(0.02, -0.03, 0.8).into(),
            rotation_from_yaw_pitch_roll(0.3, 0.1, 0.2),
        );
        let camera = Camera::default();
        Placement::of_pose(&camera, &head).expect("in the picture")
    }

    /// A fit that ended turned by `turn` against its start, larger by the logarithm `log_size`, and aside in pixels.
    fn ended(at: &Placement, turn: Rotation, log_size: f32, aside: [f32; 2]) -> FaceFit {
        let mut view = at.start;
        view.rotation *= turn;
        view.log_scale = PIXELS_PER_METRE.ln() + log_size;
        view.shift = [0, 1].map(|k| at.start.shift[k] + aside[k]);
        FaceFit {
            view,
            shape: [0.0; MAX_MODES],
        }
    }

    #[test]
    fn size_and_turn_are_means_over_time_that_then_follow_slowly() {
        let (mut fitter, at) = (fitter(), placement());
        let none = Rotation::identity();
        // A plain mean first: 0.1, then of 0.1 and 0.3, then of 0.1, 0.3 and 0.2.
        for (log_size, mean) in [(0.1, 0.1), (0.3, 0.2), (0.2, 0.2)] {
            fitter.settle(&at, &ended(&at, none, log_size, [0.0; 2]), 0.1);
            assert!((fitter.size() - f32::exp(mean)).abs() < 1e-5);
        }
        // After ten seconds a second is a tenth.
        for _ in 0..100 {
            fitter.settle(&at, &ended(&at, none, 0.2, [0.0; 2]), 0.1);
        }
        fitter.settle(&at, &ended(&at, none, 0.3, [0.0; 2]), 1.0);
        assert!((fitter.size() - f32::exp(0.21)).abs() < 1e-4);

        // The first turn is taken whole, half of what the second frame says beside it, then a third.
        let mut fitter = self::fitter();
        let turn = Rotation::new(Vector::new(0.03, -0.12, 0.05));
        let more = Rotation::new(Vector::new(0.02, 0.01, -0.06));
        fitter.settle(&at, &ended(&at, turn, 0.0, [0.0; 2]), 0.1);
        assert!(fitter.rotation_in_head().rotation.angle_to(&turn) < 1e-3);
        fitter.settle(&at, &ended(&at, more, 0.0, [0.0; 2]), 0.1);
        let half = turn * Rotation::new(more.scaled_axis() * 0.5);
        assert!(fitter.rotation_in_head().rotation.angle_to(&half) < 1e-3);
        // From forty seconds on a second is a fortieth.
        for _ in 0..400 {
            fitter.settle(&at, &ended(&at, none, 0.0, [0.0; 2]), 0.1);
        }
        fitter.settle(&at, &ended(&at, more, 0.0, [0.0; 2]), 1.0);
        let last = half * Rotation::new(more.scaled_axis() / 40.0);
        assert!(fitter.rotation_in_head().rotation.angle_to(&last) < 1e-3);
    }

    #[test]
    fn a_shift_in_the_window_is_one_across_the_line_of_sight() {
        let (mut fitter, at) = (fitter(), placement());
        let aside = [0.004, -0.007].map(|m| m * PIXELS_PER_METRE);
        fitter.settle(&at, &ended(&at, Rotation::identity(), 0.0, aside), 0.1);
        // In the window's axes it is what was seen, whichever way the head looks.
        let seen = at.start.rotation * fitter.shift;
        assert!(
            (seen - Vector::new(0.004, -0.007, 0.0)).norm() < 1e-5,
            "{seen}"
        );
        // In a head that is turned to its face, the face's axes are turned against the head's.
        let mut turned = self::fitter();
        let turn = Rotation::new(Vector::new(0.0, 0.1, 0.0));
        turned.settle(&at, &ended(&at, turn, 0.0, [0.0; 2]), 0.1);
        turned.settle(&at, &ended(&at, Rotation::identity(), 0.0, aside), 0.1);
        let half = turn * fitter.shift * 0.5;
        assert!((turned.shift - half).norm() < 1e-5);
    }

    #[test]
    fn what_is_learnt_of_a_face_fades_with_every_frame_it_is_lost() {
        let (mut fitter, at) = (fitter(), placement());
        let turn = Rotation::new(Vector::new(0.0, 0.12, 0.0));
        fitter.settle(&at, &ended(&at, turn, 0.1, [9.0, 0.0]), 0.1);
        let (shift, size) = (fitter.shift, fitter.size());
        fitter.lose();
        assert!((fitter.rotation_in_head().rotation.angle() - 0.1176).abs() < 1e-4);
        assert!((fitter.shift - shift * 0.98).norm() < 1e-7);
        assert!((fitter.turned_s - 0.098).abs() < 1e-6 && fitter.last_at.is_none());
        // A person's size stays theirs, until they are forgotten.
        assert!((fitter.size() - size).abs() < 1e-7);
        fitter.reset();
        assert!(fitter.rotation_in_head().rotation.angle() < 1e-6 && fitter.shift.norm() < 1e-9);
        assert!((fitter.size() - 1.0).abs() < 1e-6 && fitter.turned_s == 0.0);
        // What was only tried on a stranger is dropped sooner.
        fitter.turn = turn;
        fitter.lose();
        assert!((fitter.rotation_in_head().rotation.angle() - 0.06).abs() < 1e-4);
    }

    #[test]
    fn a_face_far_from_where_depth_has_it_straightens_the_head_once() {
        let at = placement();
        for (turn, aside_m, is_wrong) in [
            (0.13, 0.0, false),
            (0.15, 0.0, true),
            (0.0, 0.014, false),
            (0.0, 0.016, true),
        ] {
            let mut fitter = fitter();
            let turn = Rotation::new(Vector::new(0.0, turn, 0.0));
            let aside = [aside_m * PIXELS_PER_METRE, 0.0];
            fitter.settle(&at, &ended(&at, turn, 0.0, aside), 0.1);
            let (shift, turn) = (fitter.shift, fitter.rotation_in_head().rotation);
            let found = fitter.take_correction();
            assert_eq!(found.is_some(), is_wrong, "{turn} {aside_m}");
            if let Some(head_from_face) = found {
                assert!(head_from_face.rotation.angle_to(&turn) < 1e-6);
                assert!((head_from_face.translation.vector - shift).norm() < 1e-7);
                assert!(
                    fitter.take_correction().is_none()
                        && fitter.rotation_in_head().rotation.angle() < 1e-6
                );
            }
        }
    }

    #[test]
    fn a_new_face_is_looked_for_upright_and_at_each_place() {
        let head = rotation_from_yaw_pitch_roll(0.2, -0.1, 0.4);
        for (place, [x, y]) in BESIDE.into_iter().enumerate() {
            let (turn, shift) = upright(&head, place);
            let (_, _, roll) = yaw_pitch_roll(&(head * turn));
            assert!(roll.abs() < 0.05, "{roll}");
            // The middle of the face turns about itself and moves by the place, in the axes of the upright face.
            let middle = turn * Point::from(MIDDLE) + shift;
            let moved = turn.inverse() * (middle - Point::from(MIDDLE));
            assert!((moved - Vector::new(x, y, 0.0)).norm() < 1e-6, "{moved}");
        }
    }
}
