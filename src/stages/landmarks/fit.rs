//! Fits a face frame by frame.
//!
//! Every frame starts from the mean shape at the depth pose and runs all stages: on held-out people, starting from the last
//! frame's shape tracks lids and brows worse (correlation of the lid measure 0.67 against 0.88). Two constants of the person
//! are averaged slowly: the size of the face relative to the mean, so that it adds no jitter, and the pose of the face within
//! the head seen by depth (rotation and shift), from which the next fit starts.
//! Shape coefficients pass the adaptive filter of [`super::steady`]. Method: paper section 1.2; see [`super::cascade`].
//! Metres in the head frame, colour pixels, confidence 0…1. No allocation after construction (60 kB per person; 0.7 MB of
//! [`Scratch`] is lent to each fit). Degenerate: a head outside the image, or a low-confidence result, gives `None`.

mod in_image;

use alloc::sync::Arc;

use super::cascade::{FaceFit, FitConfidence, Solver};
use super::eyes;
use super::features::OrientationMaps;
use super::image_pose::MeanShape;
use super::points::Landmarks;
use super::refine;
use super::relief;
use super::steady::ShapeFilter;
use super::view::View;
use super::visibility::{EYES, Evidence, MOUTH as MOUTH_REGION, NOSE, PROBE_FRAMES, Visibility};
use super::window::{PIXELS_PER_METRE, Placement, Region, sensor_image};
use crate::base::capacity::{LANDMARKS, PIXELS};
use crate::base::defaults;
use crate::base::frames::{Head, Motion, SensorFromFace, SensorFromHead};
use crate::base::geometry::{Point, Rigid, Rotation, Vector};
use crate::base::one_euro::Cutoffs;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::time::Timestamp;
use crate::camera::Camera;
use crate::face_model::refinement::{Inputs, Refinement, SITES, sites_of};
use crate::face_model::scheme::MOUTH;
use crate::face_model::{CascadeStage, ConfidenceModel, FaceModel, MAX_MODES, ShapeModel};
use crate::pose::{FaceInHead, HeadPose};

/// Duration assumed for the first frame after a start or loss, seconds.
const FIRST_FRAME_S: f32 = 0.1;
/// Duration for which a person's mean correction is a plain mean, seconds.
const CORRECTION_START_S: f32 = 2.0;
/// Time constant of a person's mean correction afterwards, seconds.
const CORRECTION_TIME_S: f32 = 120.0;

/// Factor on the least confidence for a tracked face, because confidence is trained on newly found faces.
const TRACKED_SHARE: f32 = 0.6;

defaults! {
    /// Settings of the stage.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Settings {
        /// Least confidence of a face, 0…1.
        pub min_confidence: f32 = 0.5,
        /// Averaging time of the face's size, seconds.
        pub size_time_s: f32 = 10.0,
        /// Whether regions that something covers are recognised ([`Visibility`]).
        pub visibility: bool = true,
        /// Temporal filter of the shape; speeds in standard deviations per second.
        pub steadiness: Cutoffs<f32> = Cutoffs { still_hz: 3.0, per_speed: 2.0, speed_hz: 3.0 },
    }
}

/// Least confidence of a face found by [`LandmarkFitter::search_face`] or [`LandmarkFitter::search_in_image`].
const MIN_FOUND: f32 = 0.8;
/// Longest time that one fit counts for when visibility is averaged, seconds: after a loss the last fit may be long ago.
const EVIDENCE_S: f32 = 0.04;
/// Least confidence at which the search continues from the last round's pose.
const MIN_TO_CONTINUE: f32 = 0.2;
/// Most rounds of a search.
const SEARCH_ROUNDS: usize = 4;

defaults! {
    /// Scratch of a fit, without state between fits; large, so all people fitted on one thread share it.
    pub struct Scratch {
        maps: OrientationMaps = OrientationMaps::default(),
        solver: Solver = Solver::default(),
    }
}

/// Margin around the mean shape, window pixels: half a patch with its blur (16), and the motion of landmarks.
const REACH_PX: f32 = 28.0;

/// Rotation, and shift across the line of sight in metres, from one view to another, in the axes of the face.
fn view_motion(start: &View, end: &View) -> Rigid {
    let back = start.rotation.inverse();
    let [x, y] = [0, 1].map(|k| end.shift[k] - start.shift[k]);
    let across = back * Vector::new(x, y, 0.0) / PIXELS_PER_METRE;
    Rigid::from_parts(across.into(), back * end.rotation)
}

/// A fit, its confidence, and the evidence of each region's visibility.
type Fitted = (FaceFit, FitConfidence, Evidence);

/// The first confident fit of a new face of which something may hide a part, and which part that is. `run`: a partial fit.
fn find_partly_hidden(
    run: &mut impl FnMut(&Visibility, bool) -> Fitted,
    least: f32,
) -> Option<(Visibility, Fitted)> {
    let hidden = [&[MOUTH_REGION][..], &[NOSE, MOUTH_REGION], &EYES];
    hidden.into_iter().find_map(|regions| {
        let mut partial = Visibility::default();
        partial.hide(regions);
        let found = run(&partial, true);
        (found.1.face >= least).then_some((partial, found))
    })
}

/// Fits the landmarks of one face, frame by frame.
pub struct LandmarkFitter {
    settings: Settings,
    shape: ShapeModel,
    cold: Arc<[CascadeStage]>,
    warm: Arc<[CascadeStage]>,
    confidence: Arc<ConfidenceModel>,
    refinement: Option<Arc<Refinement>>,
    /// Inputs of the last refinement.
    inputs: Inputs,
    /// Mean correction of this person's coefficients, and the seconds averaged.
    mean_correction: ([f32; MAX_MODES], f32),
    /// Filters of the shape fitted to the image, and of the shape corrected by depth.
    filters: [ShapeFilter; 2],
    last_at: Option<Timestamp>,
    /// Logarithm of the face's size relative to the mean shape, and the seconds averaged.
    log_size: Option<(f32, f32)>,
    visibility: Visibility,
    /// For the pose without depth.
    mean_shape: MeanShape,
    landmarks: Landmarks,
}

impl LandmarkFitter {
    /// A fitter without history; all memory is allocated here.
    pub fn new(settings: Settings, model: &FaceModel) -> Self {
        Self {
            settings,
            shape: model.shape.clone(),
            cold: model.cold.clone(),
            warm: model.warm.clone(),
            confidence: model.confidence.clone(),
            refinement: model.refinement.clone(),
            inputs: Inputs::new(),
            mean_correction: ([0.0; MAX_MODES], 0.0),
            filters: [(); 2].map(|()| ShapeFilter::new(settings.steadiness)),
            last_at: None,
            log_size: None,
            visibility: Visibility::default(),
            mean_shape: MeanShape::default(),
            landmarks: Landmarks::default(),
        }
    }

    /// Forgets the person: the next frame starts cold.
    pub fn reset(&mut self) {
        self.last_at = None;
        self.log_size = None;
        self.visibility = Visibility::default();
        self.mean_shape = MeanShape::default();
        self.mean_correction = ([0.0; MAX_MODES], 0.0);
        self.filters.iter_mut().for_each(ShapeFilter::reset);
    }

    /// Fits one frame of grey and raw depth at a head pose; `None` if no face is found there.
    pub fn fit(
        &mut self,
        scratch: &mut Scratch,
        luma: &[u8; PIXELS],
        depth: &[u16; PIXELS],
        camera: &Camera,
        pose: &HeadPose,
        face: &mut FaceInHead,
        at: Timestamp,
    ) -> Option<&Landmarks> {
        let step_s = self.step_s(at);
        let is_new = self.log_size.is_none();
        let sensor_from_head = &pose.sensor_from_head;
        let mut fit = |fitter: &mut Self, face: &FaceInHead| {
            fitter.fit_at_pose(
                scratch,
                luma,
                camera,
                &(*sensor_from_head * face.pose()),
                step_s,
            )
        };
        let mut found = fit(self, face);
        if found.is_none() && is_new {
            face.search(&sensor_from_head.rotation);
            found = fit(self, face);
        }
        let Some(found) = found else {
            self.interrupt();
            face.decay(self.log_size.is_some());
            return None;
        };
        let (placement, fit, _) = &found;
        let share = self.update_size(fit, step_s);
        let moved = view_motion(&placement.start, &fit.view);
        face.update(&moved, step_s, share, self.visibility.is_covered());
        let sensor_from_face = *sensor_from_head * face.pose();
        self.accept(
            luma,
            Some(depth),
            camera,
            &found,
            &sensor_from_face,
            step_s,
            at,
        );
        Some(&self.landmarks)
    }

    /// Seconds since the last fit.
    fn step_s(&self, at: Timestamp) -> f32 {
        self.last_at.map_or(FIRST_FRAME_S, |last| {
            at.seconds_since(last).clamp(0.0, 1.0) as f32
        })
    }

    /// Notes a frame without a face.
    fn interrupt(&mut self) {
        self.last_at = None;
        self.filters.iter_mut().for_each(ShapeFilter::reset);
        self.visibility.interrupt();
    }

    /// Updates the landmarks by a fit.
    fn accept(
        &mut self,
        luma: &[u8; PIXELS],
        depth: Option<&[u16; PIXELS]>,
        camera: &Camera,
        (placement, fit, confidence): &(Placement, FaceFit, FitConfidence),
        sensor_from_face: &SensorFromFace,
        step_s: f32,
        at: Timestamp,
    ) {
        let shape = self.refined(fit, depth, camera, sensor_from_face, step_s);
        self.fill_landmarks(luma, placement, fit, &shape, confidence, at);
        let mouth = &self.landmarks.head[MOUTH];
        let is_hidden = |p: &&Point| {
            depth.is_some_and(|depth| relief::is_hidden(depth, camera, sensor_from_face, p))
        };
        let hidden = mouth.iter().filter(is_hidden);
        self.landmarks.mouth_hidden = hidden.count() as f32 / MOUTH.len() as f32;
        self.landmarks.seen = self.visibility.fade(step_s);
    }

    /// The fit at the face's expected pose, if confident. Updates which regions are hidden.
    fn fit_at_pose(
        &mut self,
        scratch: &mut Scratch,
        luma: &[u8; PIXELS],
        camera: &Camera,
        sensor_from_face: &SensorFromFace,
        step_s: f32,
    ) -> Option<(Placement, FaceFit, FitConfidence)> {
        let placement = Placement::from_pose(camera, sensor_from_face)?;
        let mut start = placement.start;
        start.log_scale += self.log_size.map_or(0.0, |(mean, _)| mean);
        // A face of the last frame needs less confidence.
        let share = self.last_at.map_or(1.0, |_| TRACKED_SHARE);
        let least = self.settings.min_confidence * share;
        let mut run = |visibility: &Visibility, is_partial: bool| {
            scratch.solver.hidden = [false; LANDMARKS];
            if is_partial {
                scratch.solver.hidden = visibility.covered_landmarks();
            }
            let hides_eyes = is_partial && visibility.hides_eyes();
            self.run(scratch, luma, &placement, &start, hides_eyes)
        };
        let step_s = step_s.min(EVIDENCE_S);
        let distance_m = sensor_from_face.translation.vector.norm();
        let mut visibility = self.visibility.clone();
        let is_partial = visibility.is_partial();
        let (mut fit, mut confidence, evidence) = run(&visibility, is_partial);
        if !self.settings.visibility {
            // Everything counts as seen.
        } else if visibility.is_covered() {
            if visibility.is_probe_due() {
                let (own, other) = ((fit, confidence, evidence), run(&visibility, !is_partial));
                let (partial, full) = if is_partial {
                    (&own, &other)
                } else {
                    (&other, &own)
                };
                let dt = step_s * PROBE_FRAMES as f32;
                visibility.compare(&partial.1.discriminants, &full.1.discriminants, dt);
                visibility.observe(&full.2, [full.0.view.rotation.angle(), distance_m], dt);
            }
        } else if confidence.face >= least {
            let view = [fit.view.rotation.angle(), distance_m];
            if visibility.observe(&evidence, view, step_s) {
                (fit, confidence, _) = run(&visibility, true);
            }
        } else if self.log_size.is_none()
            && let Some(found) = find_partly_hidden(&mut run, least)
        {
            (visibility, (fit, confidence, _)) = found;
        }
        let is_sure = confidence.face >= least;
        if !is_sure || visibility.hides_face() {
            return None;
        }
        self.visibility = visibility;
        Some((placement, fit, confidence))
    }

    /// Searches for any face near a guessed pose; returns its confidence and head pose. Changes no state.
    pub fn search_face(
        &self,
        scratch: &mut Scratch,
        luma: &[u8; PIXELS],
        camera: &Camera,
        guess: &SensorFromHead,
    ) -> Option<(f32, SensorFromHead)> {
        // The pose of this face within its head is unknown: assume identity.
        self.search(scratch, luma, camera, *guess, |pose, start, end| {
            pose * Motion::<Head, Head>::assume_frames(view_motion(start, end))
        })
    }

    /// Fits at a guessed pose, again at the pose that `moved` gives for the views at start and end of the fit, and so on, until the fit
    /// is a face. Returns its confidence and pose. Changes no state.
    fn search<To, From>(
        &self,
        scratch: &mut Scratch,
        luma: &[u8; PIXELS],
        camera: &Camera,
        mut pose: Motion<To, From>,
        moved: impl Fn(Motion<To, From>, &View, &View) -> Motion<To, From>,
    ) -> Option<(f32, Motion<To, From>)> {
        scratch.solver.hidden = [false; LANDMARKS];
        for _ in 0..SEARCH_ROUNDS {
            let placement = Placement::from_pose(camera, &pose)?;
            let start = &placement.start;
            let (fit, confidence, _) = self.run(scratch, luma, &placement, start, false);
            pose = moved(pose, start, &fit.view);
            if confidence.face >= MIN_FOUND {
                return Some((confidence.face, pose));
            }
            if confidence.face < MIN_TO_CONTINUE {
                break;
            }
        }
        None
    }

    /// Runs all stages from the mean shape at the view `depth`. Without the patches of the eyes each update is so much smaller that the
    /// first stages run twice.
    fn run(
        &self,
        scratch: &mut Scratch,
        luma: &[u8; PIXELS],
        placement: &Placement,
        depth: &View,
        hides_eyes: bool,
    ) -> Fitted {
        let Scratch { maps, solver } = scratch;
        let start = FaceFit {
            view: *depth,
            shape: [0.0; MAX_MODES],
        };
        solver.project(&self.shape, &start);
        let region = Region::around(&solver.window, REACH_PX);
        let image = sensor_image(luma);
        maps.sample(placement, image, &region);
        let mut near = solver.run(&self.cold, &self.shape, maps, &start, depth);
        if hides_eyes {
            near = solver.run(&self.cold, &self.shape, maps, &near, depth);
        }
        // The last stages use finer patches and all modes.
        let fit = solver.run(&self.warm, &self.shape, maps, &near, depth);
        let confidence = solver.confidence(&self.confidence, &self.shape, maps, &fit);
        let grey = |pixel| {
            let [x, y] = placement.image_pixel(pixel);
            image.bilinear(x, y)
        };
        let evidence = Evidence::new(&confidence.discriminants, grey, &solver.window);
        (fit, confidence, evidence)
    }

    /// Averages the size of the face; returns the frame's share in the mean.
    fn update_size(&mut self, fit: &FaceFit, step_s: f32) -> f32 {
        let log_size = fit.view.log_scale - PIXELS_PER_METRE.ln();
        let (mean, time) = self.log_size.unwrap_or((log_size, 0.0));
        let time = (time + step_s).min(self.settings.size_time_s);
        let share = (step_s / time.max(step_s)).clamp(0.0, 1.0);
        self.log_size = Some((mean + (log_size - mean) * share, time));
        share
    }

    /// Size of the face relative to the model.
    fn size(&self) -> f32 {
        self.log_size.map_or(1.0, |(mean, _)| mean.exp())
    }

    /// The fitted coefficients, corrected by depth.
    fn refined(
        &mut self,
        fit: &FaceFit,
        depth: Option<&[u16; PIXELS]>,
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
        // There depth measures what hides the face.
        let hidden = self.visibility.covered_landmarks();
        let first = self.inputs.len().saturating_sub(SITES);
        let offsets = self.inputs[first..].iter_mut().zip(sites_of(&hidden));
        for (offset, _) in offsets.filter(|(_, hidden)| *hidden) {
            *offset = f32::NAN;
        }
        if let Some(refinement) = &self.refinement {
            let mut inputs = self.inputs.clone();
            self.landmarks.cheeks = refinement.refine(&mut inputs, &mut shape);
            // The refinement is trained on changes: its constant part for a person is removed.
            let (usual, time) = &mut self.mean_correction;
            *time = (*time + step_s).min(CORRECTION_START_S);
            let memory = if *time < CORRECTION_START_S {
                *time
            } else {
                CORRECTION_TIME_S
            };
            for ((b, usual), fitted) in shape.iter_mut().zip(usual).zip(&fit.shape) {
                *usual += (*b - fitted - *usual) * (step_s / memory).min(1.0);
                *b -= *usual;
            }
        }
        shape
    }

    /// Inputs of the last refinement: see [`refine::inputs`].
    pub fn refinement_inputs(&self) -> &Inputs {
        &self.inputs
    }

    fn fill_landmarks(
        &mut self,
        luma: &[u8; PIXELS],
        placement: &Placement,
        fit: &FaceFit,
        shape: &[f32; MAX_MODES],
        confidence: &FitConfidence,
        at: Timestamp,
    ) {
        self.last_at = Some(at);
        // Pixels are from the image's fit, 3D points from the shape corrected by depth.
        let [fitted, refined] = &mut self.filters;
        self.shape
            .shape(&fitted.follow(&fit.shape, at), &mut self.landmarks.head);
        let project = fit.view.projection();
        for (pixel, point) in self.landmarks.pixels.iter_mut().zip(&self.landmarks.head) {
            *pixel = placement.image_pixel(project(point));
        }
        self.landmarks.eyes = eyes::cut(&sensor_image(luma), &self.landmarks.pixels);
        self.shape
            .shape(&refined.follow(shape, at), &mut self.landmarks.head);
        let size = self.size();
        for point in &mut self.landmarks.head {
            *point *= size;
        }
        self.landmarks.point_confidence = confidence.landmark;
        self.landmarks.confidence = confidence.face;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::geometry::{Rotation, rotation_from_yaw_pitch_roll};

    fn placement() -> Placement {
        let head = Rigid::from_parts(
            Vector::new(0.02, -0.03, 0.8).into(),
            rotation_from_yaw_pitch_roll(0.3, 0.1, 0.2),
        );
        let camera = Camera::default();
        Placement::from_pose(&camera, &head).expect("in the image")
    }

    #[test]
    fn a_window_shift_is_a_shift_across_the_line_of_sight() {
        let at = placement();
        let mut end = at.start;
        let aside = [0.004, -0.007].map(|m| m * PIXELS_PER_METRE);
        end.shift = [0, 1].map(|k| at.start.shift[k] + aside[k]);
        end.rotation *= Rotation::new(Vector::new(0.0, 0.1, 0.0));
        let moved = view_motion(&at.start, &end);
        // In the window's axes the shift is as measured, for any head rotation.
        let seen = at.start.rotation * moved.translation.vector;
        assert!(
            (seen - Vector::new(0.004, -0.007, 0.0)).norm() < 1e-5,
            "{seen}"
        );
        assert!((moved.rotation.angle() - 0.1).abs() < 1e-4);
    }

    #[test]
    fn the_size_is_a_running_mean_and_stays_until_the_person_is_forgotten() {
        let mut fitter = LandmarkFitter::new(Settings::default(), &FaceModel::shipped());
        let mut view = placement().start;
        let mut update = |fitter: &mut LandmarkFitter, log_size: f32, step_s: f32| {
            view.log_scale = PIXELS_PER_METRE.ln() + log_size;
            let shape = [0.0; MAX_MODES];
            fitter.update_size(&FaceFit { view, shape }, step_s)
        };
        // A plain mean first: 0.1, then of 0.1 and 0.3, then of 0.1, 0.3 and 0.2.
        for (log_size, mean, share) in [(0.1, 0.1, 1.0), (0.3, 0.2, 0.5), (0.2, 0.2, 1.0 / 3.0)] {
            assert!((update(&mut fitter, log_size, 0.1) - share).abs() < 1e-5);
            assert!((fitter.size() - f32::exp(mean)).abs() < 1e-5);
        }
        // After ten seconds a second is a tenth.
        for _ in 0..100 {
            update(&mut fitter, 0.2, 0.1);
        }
        update(&mut fitter, 0.3, 1.0);
        assert!((fitter.size() - f32::exp(0.21)).abs() < 1e-4);
        fitter.reset();
        assert!((fitter.size() - 1.0).abs() < 1e-6);
    }
}
