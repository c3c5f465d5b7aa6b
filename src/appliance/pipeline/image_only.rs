//! People in frames without depth: position, rotation and expression of a face come from the image alone.
//!
//! A known face is fitted at its predicted pose. New faces are searched for in the whole image, one part of its pyramid per frame
//! ([`FaceSearch`]); the landmark fit confirms a candidate, and a face becomes a user once it has been tracked for some frames.
//! Distance comes from the size of a face: the size that depth has measured for this person, or else that of the mean face, which is
//! wrong by up to a tenth. A person who returns is recognised by position only, because head shape is measured with depth.

use super::follower::Follower;
use super::people::{CANDIDATE, People};
use super::stage::{FrameContext, Stage};
use core::f32::consts::PI;
use mien_stages::base::capacity::{HEIGHT, LANDMARKS, USERS, WIDTH};
use mien_stages::base::frames::{Face, Motion, SensorFromFace};
use mien_stages::base::geometry::{Point, Vector, rotation_from_yaw_pitch_roll};
use mien_stages::landmarks::face_search::FaceSearch;
use mien_stages::segment::PixelRect;

/// Consecutive frames in which a new face has [`NEW_CONFIDENCE`] before it becomes a user: most false detections are rejected by then.
const CONFIRMED_FRAMES: u64 = 3;
/// Least confidence of a new face in each of them, 0 to 1. One upright portrait in a hundred has less; of 770 pictures without an
/// upright face none has as much.
const NEW_CONFIDENCE: f32 = 0.9;
/// Score of the search from which a fit may have less than [`NEW_CONFIDENCE`], as behind hair, beard and glasses or in dim light. Such a
/// fit is rejected if the fit also succeeds at the face turned by half, because the search also finds faces that are upside down.
const SURE_SCORE: f32 = 6.0;
/// Frames for which a new face must be tracked before it becomes a user, if its fit is not sure in [`CONFIRMED_FRAMES`] of them in a row.
const UNSURE_FRAMES: u64 = 12;
/// Least confidence in each of these frames, 0 to 1.
const TRACKED_CONFIDENCE: f32 = 0.6;
/// Interval between searches while somebody is tracked, frames.
const SEARCH_STEP: u64 = 3;
/// Yaw angles at which a candidate is tried, radians.
const YAWS_RAD: [f32; 3] = [0.0, 0.4, -0.4];
/// Half the side of the square in the middle of a face that is checked for depth, metres.
const BLIND_M: f32 = 0.06;
/// Largest share of its pixels with depth, 0 to 1, at which the face counts as having no depth.
const BLIND_SHARE: f32 = 0.1;
/// Largest distance from a lost user's last position at which a new face is taken for that user, metres.
const SAME_PERSON_M: f32 = 0.3;
/// Largest distance across the line of sight at which two faces count as one, metres at the nearer face.
const SAME_FACE_M: f32 = 0.08;

impl Follower {
    /// Runs the stages on the image alone at the expected pose. Returns whether the face is found there.
    pub(super) fn follow_in_image(&mut self, context: &mut FrameContext<'_>) -> bool {
        self.person.head_box = None;
        let (frame, camera) = (context.frame, context.camera);
        let Some(expected) = self.pose.expected_face(frame.at) else {
            return false;
        };
        // Beyond its border the image is repeated, where a fit would follow itself.
        let pixel = camera.colour_pixel(&(expected * Point::origin()));
        let size = camera.depth_size().map(|pixels| pixels as f32);
        if (0..2).any(|k| !(0.0..size[k]).contains(&pixel[k])) {
            return false;
        }
        let depth = (!self.pose.ignores_depth()).then_some(&*frame.depth);
        // The paper's method needs depth.
        let fitted = self.landmarks.cascade_mut().and_then(|cascade| {
            let luma = &frame.luma;
            cascade.fit_in_image(context.scratch, luma, depth, camera, &expected, frame.at)
        });
        let Some((landmarks, seen)) = fitted else {
            return false;
        };
        let landmarks = landmarks.clone();
        (context.stage_done)(Stage::Landmarks);
        let sensor_from_face = self.pose.follow_in_image(&seen, frame.at);
        let points = landmarks.head.map(|point| sensor_from_face * point);
        self.person.head_box = Some(bounds(
            &points.map(|point| camera.depth_pixel(&point)),
            camera.depth_size(),
        ));
        let centre = sensor_from_face * Point::origin();
        self.observe_face(context, landmarks, sensor_from_face, centre);
        true
    }

    /// Does the same in a frame with depth, for a known face without depth pixels because it is too near or in sunlight.
    pub(super) fn follow_beside_depth(&mut self, context: &mut FrameContext<'_>) -> bool {
        let (frame, camera) = (context.frame, context.camera);
        let is_blind = || {
            let expected = self.pose.expected_face(frame.at)?;
            let [col, row] = camera.depth_pixel(&(expected * Point::origin()));
            let reach = camera.depth_focal_px() * BLIND_M / expected.translation.z;
            let span = |centre: f32, most: usize| {
                let pixel = |at: f32| at.clamp(0.0, most as f32) as usize;
                pixel(centre - reach)..pixel(centre + reach)
            };
            let [columns, rows] = [span(col, WIDTH), span(row, HEIGHT)];
            let all = columns.len() * rows.len();
            // A face beside the image is not one that depth does not show.
            if (all as f32) < 2.0 * reach * reach {
                return None;
            }
            let pixels = rows.flat_map(|row| &frame.depth[row * WIDTH..][columns.clone()]);
            let measured = pixels.filter(|&&raw| camera.depth_m(raw) > 0.0).count();
            Some(measured as f32 <= BLIND_SHARE * all as f32)
        };
        self.is_known_face()
            && frame.has_image()
            && is_blind().unwrap_or(false)
            && self.follow_in_image(context)
    }

    /// Whether this person's position is within `reach_m` of `place`; sensor frame, metres.
    fn is_at(&self, place: &Vector, reach_m: f32) -> bool {
        let position = self.person.position.as_ref();
        position.is_some_and(|position| (position.centre().coords - place).norm() < reach_m)
    }
}

/// Bounding box of the pixels, clipped to an image of `size` (columns, rows).
fn bounds(pixels: &[[f32; 2]; LANDMARKS], size: [usize; 2]) -> PixelRect {
    let along = |axis: usize| {
        let values = pixels.iter().map(|pixel| pixel[axis]);
        let within = |v: f32| v.clamp(0.0, size[axis] as f32) as u16;
        let first = values.clone().fold(f32::MAX, f32::min);
        let last = values.fold(f32::MIN, f32::max);
        [within(first), within(last + 1.0)]
    };
    let ([x0, x1], [y0, y1]) = (along(0), along(1));
    PixelRect { x0, y0, x1, y1 }
}

impl People {
    /// Runs everybody's stages on a frame without depth.
    pub(super) fn follow_in_image(
        &mut self,
        context: &mut FrameContext<'_>,
        search: &mut FaceSearch,
    ) {
        let at = context.frame.at;
        let has_image = context.frame.has_image();
        for slot in 0..USERS {
            let user = &mut self.followers[slot];
            if !user.is_taken() || (has_image && user.follow_in_image(context)) {
                continue;
            }
            if user.miss(at) {
                self.left[slot] = true;
                self.remember(slot);
                self.followers[slot].forget();
            }
        }
        if has_image {
            self.follow_new_face(context, search);
        }
        self.update_choice();
    }

    /// Follows the candidate, or searches for one.
    fn follow_new_face(&mut self, context: &mut FrameContext<'_>, search: &mut FaceSearch) {
        let seen = self.seen_users().count();
        if seen >= self.settings.most as usize {
            self.followers[CANDIDATE].forget();
            return;
        }
        let candidate = &mut self.followers[CANDIDATE];
        if candidate.is_taken() {
            let found = candidate.follow_in_image(context);
            let (confidence, frames) = (candidate.person.confidence, candidate.person.face_frames);
            let least = match self.candidate_score >= SURE_SCORE {
                true => TRACKED_CONFIDENCE,
                false => NEW_CONFIDENCE,
            };
            self.candidate_sure_frames = match confidence >= NEW_CONFIDENCE {
                true => self.candidate_sure_frames + 1,
                false => 0,
            };
            let is_confirmed =
                self.candidate_sure_frames >= CONFIRMED_FRAMES || frames >= UNSURE_FRAMES;
            if !found || confidence < least {
                candidate.forget();
            } else if is_confirmed {
                self.admit_face();
            }
            return;
        }
        if seen > 0 && !self.frame_count.is_multiple_of(SEARCH_STEP) {
            return;
        }
        let candidates = search.search(&context.frame.luma);
        (context.stage_done)(Stage::Segment);
        // A face agrees with the template far better than anything else, so only the best new candidate is tried.
        let places = candidates.iter().map(|found| {
            let camera = context.camera;
            let place = camera.point_in_image(found.pixel, found.pixels_per_metre);
            (place.coords, found.score)
        });
        let mut new = places.filter(|(place, _)| !self.is_tracked(place));
        let found = new.next().and_then(|(place, score)| {
            let seen = self.confirmed(context, place, score)?;
            Some((seen, score))
        });
        let Some((seen, score)) = found else {
            return;
        };
        let place = seen.translation.vector;
        let users = &mut self.followers[..USERS];
        let mut lost = users
            .iter_mut()
            .filter(|user| user.is_taken() && user.person.head_box.is_none());
        let starts = match lost.find(|user| user.is_at(&place, SAME_PERSON_M)) {
            Some(user) => user,
            None => &mut self.followers[CANDIDATE],
        };
        starts.pose.start_in_image(&seen, context.frame.at);
        starts.follow_in_image(context);
        let is_sure = starts.person.confidence >= NEW_CONFIDENCE;
        (self.candidate_sure_frames, self.candidate_score) = (is_sure.into(), score);
    }

    /// The pose of the face near this position (sensor frame, metres), which the search gave this score, if the landmark fit confirms
    /// it and it is not tracked yet.
    fn confirmed(
        &self,
        context: &mut FrameContext<'_>,
        place: Vector,
        score: f32,
    ) -> Option<SensorFromFace> {
        let (luma, camera) = (&context.frame.luma, context.camera);
        let cascade = self.followers[CANDIDATE].landmarks.cascade()?;
        let half_turn = rotation_from_yaw_pitch_roll(0.0, 0.0, PI);
        let upside_down = Motion::<Face, Face>::from_parts(Vector::zeros(), half_turn);
        let mut search =
            |guess: &SensorFromFace| cascade.search_in_image(context.scratch, luma, camera, guess);
        YAWS_RAD.into_iter().find_map(|yaw| {
            let turn = rotation_from_yaw_pitch_roll(yaw, 0.0, 0.0);
            let (confidence, seen) = search(&SensorFromFace::from_parts(place, turn))?;
            let is_sure = confidence >= NEW_CONFIDENCE;
            let is_new = !self.is_tracked(&seen.translation.vector);
            let mut may_be_unsure =
                || score >= SURE_SCORE && search(&(seen * upside_down)).is_none();
            (is_new && (is_sure || may_be_unsure())).then_some(seen)
        })
    }

    /// The users who are seen in this frame.
    fn seen_users(&self) -> impl Iterator<Item = &Follower> {
        let users = self.followers[..USERS].iter();
        users.filter(|user| user.is_taken() && user.person.head_box.is_some())
    }

    /// Whether the face at this position (sensor frame, metres) is tracked.
    fn is_tracked(&self, place: &Vector) -> bool {
        let mut faces = self.seen_users().filter_map(|user| user.person.position);
        faces.any(|face| {
            let other = face.centre().coords;
            let apart = other / other.z - place / place.z;
            apart.norm() * other.z.min(place.z) < SAME_FACE_M
        })
    }

    /// Gives the candidate a slot.
    fn admit_face(&mut self) {
        if let Some(slot) = self.slot_for_newcomer() {
            self.move_candidate(slot);
        }
        self.followers[CANDIDATE].forget();
    }
}

#[cfg(test)]
mod tests {
    use crate::pipeline::{Pipeline, Settings};
    use mien_sensors::{Frame, NO_DEPTH};
    use mien_simulator::simulated::Simulated;
    use mien_stages::base::geometry::{Rigid, Rotation};
    use mien_stages::face_model::FaceModel;

    /// A frame's result: the pose of the only user's face, if it is tracked, and the truth.
    type Seen = (Option<Rigid>, Rigid);

    /// Simulates a seated person; `change` is applied to each frame and gets the frame's number and true pose.
    fn play(count: usize, mut change: impl FnMut(usize, &mut Frame, &Rigid)) -> Vec<Seen> {
        let mut sensor = Simulated::new(Some("acted")).expect("a scene");
        let camera = sensor.camera().clone();
        let settings = Settings::default();
        let model = FaceModel::shipped();
        let mut pipeline = Pipeline::new(&settings, &camera, &model).expect("a pipeline");
        let mut frame = Frame::default();
        let frames = (0..count).map(|number| {
            sensor.next_frame(&mut frame);
            let truth = sensor.truth().expect("somebody acts").sensor_from_head;
            change(number, &mut frame, &truth);
            pipeline.follow(&frame);
            let reports = pipeline.reports();
            assert!(reports.len() == 1 && reports[0].user.is_none_or(|slot| slot == 0));
            let pose = reports[0].sensor_from_face.copied();
            (pose.filter(|_| reports[0].landmarks.is_some()), truth)
        });
        frames.collect()
    }

    fn without_depth(frame: &mut Frame) {
        frame.depth.fill(NO_DEPTH);
    }

    fn distance_m(pose: &Rigid) -> f32 {
        pose.translation.vector.norm()
    }

    #[test]
    fn a_face_is_found_within_ten_frames_and_followed_without_depth() {
        let seen = play(120, |_, frame, _| without_depth(frame));
        let first = seen.iter().position(|(pose, _)| pose.is_some());
        assert!(first.is_some_and(|first| first <= 10), "{first:?}");
        let followed = seen[10..].iter();
        let followed = followed.map(|(pose, truth)| (pose.expect("a face"), truth));
        // The axes of the face differ slightly from those of the truth; its distance assumes a face of mean size.
        let mut usual: Option<Rotation> = None;
        let mut sizes = Vec::new();
        for (pose, truth) in followed {
            let off = truth.rotation.inverse() * pose.rotation;
            let first = *usual.get_or_insert(off);
            assert!(off.angle() < 0.15, "{} rad", off.angle());
            assert!(off.angle_to(&first) < 0.1, "{} rad", off.angle_to(&first));
            let [seen, true_] = [&pose, truth].map(|pose| pose.translation.vector.normalize());
            assert!(seen.angle(&true_) < 0.02, "{} rad", seen.angle(&true_));
            sizes.push(distance_m(&pose) / distance_m(truth));
        }
        let mean = sizes.iter().sum::<f32>() / sizes.len() as f32;
        assert!((mean - 1.0).abs() < 0.1, "{mean}");
        assert!(sizes.iter().all(|size| (size / mean - 1.0).abs() < 0.05));
    }

    #[test]
    fn a_camera_of_three_frames_a_second_is_followed_with_and_without_depth() {
        for has_depth in [true, false] {
            let mut sensor = Simulated::new(Some("acted")).expect("a scene");
            let (camera, model) = (sensor.camera().clone(), FaceModel::shipped());
            let mut pipeline =
                Pipeline::new(&Settings::default(), &camera, &model).expect("a pipeline");
            let mut frame = Frame::default();
            for number in 0..300 {
                sensor.next_frame(&mut frame);
                if number % 10 != 0 {
                    continue;
                }
                if !has_depth {
                    without_depth(&mut frame);
                }
                pipeline.follow(&frame);
                let has_face = pipeline.report().landmarks.is_some();
                assert!(has_face || number < 40, "{has_depth}: frame {number}");
            }
        }
    }

    /// Largest step of a pose relative to the truth from one frame to the next, radians and metres.
    fn largest_step(seen: &[Seen]) -> [f32; 2] {
        let off = |(pose, truth): &Seen| truth.inverse() * pose.expect("a face");
        let steps = seen.windows(2).map(|two| {
            let step = off(&two[0]).inverse() * off(&two[1]);
            [step.rotation.angle(), step.translation.vector.norm()]
        });
        steps.fold([0.0; 2], |[a, b], [c, d]| [a.max(c), b.max(d)])
    }

    #[test]
    fn depth_comes_and_goes_without_a_jump() {
        let seen = play(180, |number, frame, _| {
            if (60..120).contains(&number) {
                without_depth(frame);
            }
        });
        let [turn, shift] = largest_step(&seen[30..]);
        assert!(turn < 0.04 && shift < 0.012, "{turn} rad, {shift} m");
        // Depth has measured the size of the face.
        for (pose, truth) in &seen[60..120] {
            let ratio = distance_m(&pose.expect("a face")) / distance_m(truth);
            assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
        }
    }

    #[test]
    fn a_face_that_depth_does_not_show_is_followed_before_a_room_that_it_shows() {
        let camera = mien_sensors::kinect::geometry::nominal();
        let seen = play(90, |number, frame, truth| {
            if number >= 45 {
                let near = camera.raw_from_m(truth.translation.z + 0.3) as u16;
                for raw in frame.depth.iter_mut().filter(|raw| **raw < near) {
                    *raw = NO_DEPTH;
                }
            }
        });
        let [turn, shift] = largest_step(&seen[30..]);
        assert!(turn < 0.04 && shift < 0.012, "{turn} rad, {shift} m");
    }

    #[test]
    fn pictures_without_a_face_show_nobody() {
        let mut random = fastrand::Rng::with_seed(3);
        for kind in 0..3 {
            let seen = play(24, |_, frame, _| {
                without_depth(frame);
                match kind {
                    0 => frame.luma.fill_with(|| random.u8(..)),
                    // Upside down, and as a negative.
                    1 => frame.luma.reverse(),
                    _ => frame.luma.iter_mut().for_each(|grey| *grey = 255 - *grey),
                }
            });
            assert!(seen.iter().all(|(pose, _)| pose.is_none()), "{kind}");
        }
    }
}
