//! People in frames without depth: the image alone gives position, rotation and expression of a face.
//!
//! A known face is fitted where its motion leads. A new one is searched for in the whole image, a part of it a frame
//! ([`FaceSearch`]); the landmark fit confirms a candidate, and a face becomes a user once it was followed for [`CONFIRMED_FRAMES`].
//! Distance comes from the size of a face: the size that depth has shown of this person, or else that of the mean face, which is
//! wrong by up to a tenth. A person who returns is recognised by their position only, because a head has no shape without depth.

use super::follower::Follower;
use super::people::{CANDIDATE, People};
use super::stage::{FrameContext, Stage};
use mien_stages::base::capacity::{LANDMARKS, USERS};
use mien_stages::base::frames::SensorFromFace;
use mien_stages::base::geometry::{Point, Vector, rotation_from_yaw_pitch_roll};
use mien_stages::landmarks::face_search::{Candidate, FaceSearch};
use mien_stages::segment::PixelRect;
use mien_stages::users::TrackingState;

/// Consecutive frames in which a new face is followed before it becomes a user: most false faces are gone by then.
const CONFIRMED_FRAMES: u64 = 3;
/// Interval of the search while somebody is tracked, in frames.
const SEARCH_STEP: u64 = 3;
/// Rotations about the vertical at which a candidate is tried, radians.
const YAWS_RAD: [f32; 3] = [0.0, 0.4, -0.4];
/// Distance from a lost user's last position within which a new face is theirs, metres.
const SAME_PERSON_M: f32 = 0.3;
/// Distance of two faces across the line of sight within which they are the same, metres at the nearer one.
const SAME_FACE_M: f32 = 0.08;

impl Follower {
    /// Runs the stages on the image alone, where the face is expected. Returns whether it is there.
    pub(super) fn follow_in_image(&mut self, context: &mut FrameContext<'_>) -> bool {
        self.person.head_box = None;
        let (frame, camera) = (context.frame, context.camera);
        let Some(expected) = self.pose.expected_face(frame.at) else {
            return false;
        };
        let depth = (!self.pose.ignores_depth()).then_some(&*frame.depth);
        let fitted = self.landmarks.fit_in_image(
            context.scratch,
            &frame.luma,
            depth,
            camera,
            &expected,
            frame.at,
        );
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

    /// Whether a face at this position, sensor frame, metres, is this person's.
    fn is_at(&self, place: &Vector, reach_m: f32) -> bool {
        let position = self.person.position.as_ref();
        position.is_some_and(|position| (position.centre().coords - place).norm() < reach_m)
    }
}

/// Box of the pixels within an image of `size` (columns, rows).
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
            let before = user.person.state;
            user.miss(at);
            if user.person.state == TrackingState::Absent && before != TrackingState::Absent {
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
        let users = &self.followers[..USERS];
        let present = users.iter().filter(|user| user.person.state.is_present());
        let tracked = users
            .iter()
            .filter(|user| user.person.state.has_face())
            .count();
        if present.count() >= self.settings.most as usize && tracked >= self.settings.most as usize
        {
            return;
        }
        let candidate = &mut self.followers[CANDIDATE];
        if candidate.is_taken() {
            if !candidate.follow_in_image(context) {
                candidate.forget();
            } else if candidate.person.face_frames >= CONFIRMED_FRAMES {
                self.admit_face();
            }
            return;
        }
        if tracked > 0 && !self.frame_count.is_multiple_of(SEARCH_STEP) {
            return;
        }
        let candidates = search.search(&context.frame.luma);
        (context.stage_done)(Stage::Segment);
        let found = candidates
            .iter()
            .find_map(|found| self.confirmed(context, found));
        let Some(seen) = found else {
            return;
        };
        let place = seen.translation.vector;
        let users = &mut self.followers[..USERS];
        let mut lost = users
            .iter_mut()
            .filter(|user| user.is_taken() && !user.person.state.has_face());
        let starts = match lost.find(|user| user.is_at(&place, SAME_PERSON_M)) {
            Some(user) => user,
            None => &mut self.followers[CANDIDATE],
        };
        starts.pose.start_in_image(&seen, context.frame.at);
        starts.follow_in_image(context);
    }

    /// The pose of a candidate's face, if the landmark fit confirms it and it is nobody's.
    fn confirmed(
        &self,
        context: &mut FrameContext<'_>,
        found: &Candidate,
    ) -> Option<SensorFromFace> {
        let (luma, camera) = (&context.frame.luma, context.camera);
        let [column, row] = found.pixel;
        let distance_m = camera.depth_focal_px() / found.pixels_per_metre;
        let place = camera.point(column, row, distance_m);
        if self.is_tracked(&place.coords) {
            return None;
        }
        let stage = &self.followers[CANDIDATE].landmarks;
        YAWS_RAD.into_iter().find_map(|yaw| {
            let turn = rotation_from_yaw_pitch_roll(yaw, 0.0, 0.0);
            let guess = SensorFromFace::from_parts(place.coords, turn);
            let (_, seen) = stage.search_in_image(context.scratch, luma, camera, &guess)?;
            (!self.is_tracked(&seen.translation.vector)).then_some(seen)
        })
    }

    /// Whether the face at this position, sensor frame, metres, is tracked.
    fn is_tracked(&self, place: &Vector) -> bool {
        let users = self.followers[..USERS].iter();
        let users = users.filter(|user| user.person.state.has_face());
        let mut faces = users.filter_map(|user| user.person.position);
        faces.any(|face| {
            let other = face.centre().coords;
            let apart = other / other.z - place / place.z;
            apart.norm() * other.z.min(place.z) < SAME_FACE_M
        })
    }

    /// Gives the candidate a free slot, or that of the user lost for longest.
    fn admit_face(&mut self) {
        let most = self.settings.most as usize;
        let free = self.memory.slot_for_newcomer(&self.free_slots());
        let slot = free.or_else(|| {
            let lost = self.lost().filter(|&slot| slot < most);
            lost.min_by_key(|&slot| self.followers[slot].person.last_seen)
        });
        if let Some(slot) = slot {
            self.memory.forget_slot(slot);
            self.followers.swap(slot, CANDIDATE);
        }
        self.followers[CANDIDATE].forget();
    }
}
