//! The people in front of the sensor: assignment of heads to users, admission and recognition of newcomers.
//!
//! Heads are assigned to users by position ([`mien_stages::users::matching`]); each user has their own stages
//! ([`super::follower`]). One unassigned head at a time goes to the candidate's follower. It becomes a user once a face is found
//! on it (without colour: once depth has tracked it for a few frames) and, if anybody left before, once it was compared with
//! them ([`mien_stages::users::memory`]). A head without a face is retried every few frames, in an empty scene at first every
//! frame. While all users are where expected, every third frame is segmented. With a user present, a frame runs at most half of
//! an initial pose search, which bounds its cost.
//!
//! When all slots are in use, a newcomer waits until a user is forgotten.

use std::sync::Arc;

use super::follower::Follower;
use super::settings::Settings;
use super::stage::{FrameContext, Stage};
use mien_stages::base::capacity::{HEADS, USERS};
use mien_stages::base::geometry::Point;
use mien_stages::base::second_core::SecondCore;
use mien_stages::base::time::Timestamp;
use mien_stages::expression::Expression;
use mien_stages::expression::units::Units;
use mien_stages::face_model::FaceModel;
use mien_stages::landmarks::face_search::FaceSearch;
use mien_stages::landmarks::{LandmarkStage, Scratch};
use mien_stages::pose::{PoseError, PoseTracker};
use mien_stages::segment::{HeadCloud, Segmenter};
use mien_stages::users::choice::{Candidate, Choice};
use mien_stages::users::matching::LastSeen;
use mien_stages::users::memory::Memory;
use mien_stages::users::{self, Presence, matching};

/// Frames until a head without a face is tried again.
const RETRY_FRAMES: u64 = 4;
/// Tries in consecutive frames of a head without a face while nobody else is present: two at each position searched.
const EAGER_TRIES: u64 = 24;
/// Largest movement of a rejected head between tries, metres.
const SAME_REJECTED_M: f32 = 0.06;
/// Distance from a user's head below which a segmented head is part of it, metres.
const SAME_HEAD_M: f32 = 0.12;
/// Interval of segmentation while all users are where expected, in frames.
const SEGMENT_STEP: u64 = 3;

/// A head without a face.
pub(super) struct RejectedHead {
    centre: Point,
    /// Value of [`People::frame_count`] from which it is tried again.
    retry_from: u64,
    tries: u64,
}

/// All people: tracked, candidate, or gone and remembered.
pub(super) struct People {
    /// One per slot, then the candidate's.
    pub(super) followers: Vec<Follower>,
    pub(super) settings: users::Settings,
    pub(super) memory: Memory,
    pub(super) choice: Choice,
    /// Heads without a face, latest first.
    pub(super) rejected: heapless::Vec<RejectedHead, HEADS>,
    /// Consecutive frames, up to the last, in which the candidate of the search without depth had the confidence of a new face.
    pub(super) candidate_sure_frames: u64,
    /// Score that the search gave it.
    pub(super) candidate_score: f32,
    /// Slots whose users were forgotten in this frame.
    pub(super) left: [bool; USERS],
    /// Index of the last frame, as numbered by the source.
    pub(super) frame: u64,
    /// Frames processed so far.
    pub(super) frame_count: u64,
    /// Time of the last frame.
    pub(super) at: Timestamp,
    /// Buffer for the points of the tracked head, one per thread.
    clouds: [Box<HeadCloud>; 2],
    /// The second thread and its buffers, if used.
    pub(super) second_core: Option<(SecondCore, Scratch)>,
}

/// A follower, the centre of its segmented head (sensor frame, metres), and the result of [`Follower::follow_expected`].
type Task<'a> = (&'a mut Follower, Option<Point>, &'a mut Option<bool>);

/// Index of the candidate's follower.
pub(super) const CANDIDATE: usize = USERS;

/// Why a pipeline cannot be created from these settings and this model.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The model's standard head is unusable.
    #[error(transparent)]
    Pose(#[from] PoseError),
    /// The model's appearance is unusable.
    #[error(transparent)]
    Landmarks(#[from] mien_stages::landmarks::LandmarkError),
}

/// Runs the stages of each task at the expected head pose.
fn follow_each_expected(
    tasks: &mut [Task<'_>],
    context: &mut FrameContext<'_>,
    cloud: &mut HeadCloud,
) {
    for (user, middle, found) in tasks {
        **found = user.follow_expected(context, cloud, *middle);
    }
}

/// A person's stages that depend on neither face model nor pose settings.
pub(super) fn expression_and_presence(
    settings: &Settings,
    units: &Arc<Units>,
) -> (Expression, Presence) {
    let users = &settings.users;
    (
        Expression::new(settings.learning, units.clone()),
        Presence::new(users.hold_s, users.forget_s),
    )
}

impl People {
    /// Builds every person's stages; all memory is allocated here.
    ///
    /// # Errors
    /// If the model lacks what a stage or the chosen method needs.
    pub(super) fn new(settings: &Settings, model: &FaceModel) -> Result<Self, PipelineError> {
        let pose = PoseTracker::new(settings.pose, &model.standard_head)?;
        let units = Arc::new(Units::shipped());
        let follower = |_| {
            let (expression, presence) = expression_and_presence(settings, &units);
            let landmarks = LandmarkStage::new(settings.landmarks, model)?;
            let pose = pose.for_another_head();
            Ok(Follower::new(pose, landmarks, expression, presence))
        };
        let followers = (0..=CANDIDATE).map(follower);
        let mut people = Self {
            followers: followers.collect::<Result<_, PipelineError>>()?,
            memory: Memory::default(),
            choice: Choice::new(settings.users.single),
            settings: settings.users.clone(),
            rejected: heapless::Vec::new(),
            candidate_sure_frames: 0,
            candidate_score: 0.0,
            left: [false; USERS],
            frame: 0,
            frame_count: 0,
            at: Timestamp::default(),
            clouds: Default::default(),
            second_core: None,
        };
        people.set_second_core(settings);
        Ok(people)
    }

    /// Runs everybody's stages; the frame is segmented unless all users are where expected.
    pub(super) fn follow(
        &mut self,
        context: &mut FrameContext<'_>,
        segmenter: &mut Segmenter,
        search: &mut FaceSearch,
    ) {
        let frame = context.frame;
        let since_s = frame.at.seconds_since(self.at);
        (self.frame, self.at) = (frame.index, frame.at);
        let poses = self.followers.iter_mut().map(|user| &mut user.pose);
        poses.for_each(|pose| pose.begin_frame(since_s));
        self.frame_count += 1;
        self.left = [false; USERS];
        self.memory
            .forget_older(frame.at, self.settings.remember_s.into());
        let ignores_depth = self.followers[CANDIDATE].pose.ignores_depth();
        if ignores_depth || !context.camera.measures(&*frame.depth) {
            return self.follow_in_image(context, search);
        }
        // Without users there is time for both halves of an initial pose search.
        let mut users = self.followers[..USERS].iter();
        let busy = users.any(|user| user.person.state.is_present());
        context.search_budget = if busy { 1 } else { 2 };
        let free = self.follow_users(context, segmenter);
        self.follow_candidate(context, segmenter.heads(), &free);
        self.update_choice();
    }

    /// Runs the users' stages on their heads; returns the unassigned heads.
    fn follow_users(
        &mut self,
        context: &mut FrameContext<'_>,
        segmenter: &mut Segmenter,
    ) -> heapless::Vec<usize, HEADS> {
        let at = context.frame.at;
        let mut found = [None; USERS];
        let mut heads: &[HeadCloud] = &[];
        let settled = !self.frame_count.is_multiple_of(SEGMENT_STEP) && self.all_settled();
        if !settled || !self.follow_expected(context, [None; USERS], &mut found) {
            segmenter.segment(context.frame, context.camera);
            (context.stage_done)(Stage::Segment);
            heads = segmenter.heads();
        }
        let heads = heads.iter();
        let centres: heapless::Vec<Point, HEADS> = heads.map(|head| head.centre).collect();
        let expected = core::array::from_fn(|slot| {
            let user = &self.followers[slot];
            let position = user.person.position.filter(|_| user.is_taken());
            position.map(|position| position.expected(at))
        });
        let theirs = matching::assign(&expected, &centres);
        let middles = theirs.map(|head| head.map(|head| centres[head]));
        self.follow_expected(context, middles, &mut found);
        // Rotates which lost user gets the search budget.
        for k in 0..USERS as u64 {
            let slot = ((k + self.frame_count) % USERS as u64) as usize;
            let user = &mut self.followers[slot];
            if !user.is_taken() {
                continue;
            }
            let mut follow = |head| user.follow_in_cloud(context, &segmenter.heads()[head]);
            let found = found[slot].unwrap_or_else(|| theirs[slot].is_some_and(&mut follow));
            if !found && !user.follow_beside_depth(context) {
                self.left[slot] |= user.miss(at);
            }
        }
        let people = self.followers[..USERS].iter().map(|user| &user.person);
        let seen = people.filter(|person| person.head_box.is_some());
        let seen = seen.filter_map(|person| Some(person.position?.centre()));
        let taken = |head: &usize| {
            let is_near = |centre: Point| (centres[*head] - centre).norm() < SAME_HEAD_M;
            theirs.contains(&Some(*head)) || seen.clone().any(is_near)
        };
        let heads = 0..centres.len();
        let free: heapless::Vec<usize, HEADS> = heads.filter(|head| !taken(head)).collect();
        self.update_slots();
        free
    }

    /// Forgets users who left in this frame, and compares recent newcomers again.
    fn update_slots(&mut self) {
        for slot in 0..USERS {
            if self.left[slot] {
                self.remember(slot);
                self.followers[slot].forget();
            } else if self.followers[slot].person.head_box.is_some() && self.is_recheck_due(slot) {
                self.recheck_identity(slot);
            }
        }
    }

    /// Whether there are users, all tracked without interruption, and no candidate.
    fn all_settled(&self) -> bool {
        let users = self.followers[..USERS].iter();
        let mut users = users.filter(|user| user.is_taken()).peekable();
        users.peek().is_some()
            && self.followers[CANDIDATE].person.position.is_none()
            && users.all(Follower::is_settled)
    }

    /// Runs the stages of all users without a result in `found` at their expected poses, half of them on the second core if
    /// there is one. Returns whether all heads were there.
    fn follow_expected(
        &mut self,
        context: &mut FrameContext<'_>,
        middles: [Option<Point>; USERS],
        found: &mut [Option<bool>; USERS],
    ) -> bool {
        let tasks = self.followers.iter_mut().zip(middles).zip(&mut *found);
        let tasks = tasks.map(|((user, middle), found)| (user, middle, found));
        let tasks = tasks.filter(|(user, _, found)| user.is_taken() && found.is_none());
        let mut tasks: heapless::Vec<Task<'_>, USERS> = tasks.collect();
        let [cloud, other] = &mut self.clouds;
        match &mut self.second_core {
            Some((core, scratch)) if tasks.len() > 1 => {
                let (frame, camera) = (context.frame, context.camera);
                let half = tasks.len() / 2;
                let (theirs, mine) = tasks.split_at_mut(half);
                core.join(|| follow_each_expected(mine, context, cloud), &mut || {
                    let mut context = FrameContext {
                        frame,
                        camera,
                        scratch,
                        search_budget: 0,
                        stage_done: &mut |_| {},
                    };
                    follow_each_expected(theirs, &mut context, other);
                });
            }
            _ => follow_each_expected(&mut tasks, context, cloud),
        }
        tasks.iter().all(|(.., found)| found.is_some())
    }

    /// Remembers the user of a slot.
    pub(super) fn remember(&mut self, slot: usize) {
        let user = &self.followers[slot];
        if self.settings.remember_s > 0.0 {
            self.memory.keep(user.gone(slot));
        }
    }

    /// Processes one unassigned head, which may become a user.
    fn follow_candidate(
        &mut self,
        context: &mut FrameContext<'_>,
        heads: &[HeadCloud],
        free: &[usize],
    ) {
        (self.candidate_sure_frames, self.candidate_score) = (0, 0.0);
        let present = (0..USERS).filter(|&slot| self.followers[slot].person.state.is_present());
        let present = present.count();
        if present >= self.settings.most as usize {
            self.followers[CANDIDATE].forget();
            return;
        }
        let head = match &self.followers[CANDIDATE].person.position {
            Some(position) => {
                let (expected, reach) = position.expected(context.frame.at);
                let distance = |head: usize| (heads[head].centre - expected).norm();
                let near = free.iter().copied().filter(|&head| distance(head) <= reach);
                near.min_by(|&a, &b| distance(a).total_cmp(&distance(b)))
            }
            None => {
                // New heads first, then the longest wait: a static object is rejected repeatedly.
                let retry_from = |head: usize| {
                    let index = self.rejected_index(&heads[head].centre);
                    index.map_or(0, |index| self.rejected[index].retry_from)
                };
                let due = free.iter().copied();
                let due = due.filter(|&head| retry_from(head) <= self.frame_count);
                due.min_by_key(|&head| retry_from(head))
            }
        };
        let candidate = &mut self.followers[CANDIDATE];
        let Some(head) = head else {
            if candidate.person.position.is_some() {
                candidate.forget();
            }
            return;
        };
        if context.search_budget == 0 && candidate.person.position.is_none() {
            return;
        }
        if !candidate.follow_in_cloud(context, &heads[head]) {
            if candidate.pose.is_searching() {
                let centre = heads[head].centre;
                candidate.person.position =
                    Some(LastSeen::new(centre, centre.coords, context.frame.at));
                return;
            }
            candidate.forget();
            let retry_at_once = present == 0 && candidate.landmarks.cascade().is_some();
            self.reject(heads[head].centre, retry_at_once);
            return;
        }
        if candidate.is_admissible() {
            self.admit();
        }
    }

    fn rejected_index(&self, centre: &Point) -> Option<usize> {
        let mut heads = self.rejected.iter();
        heads.position(|head| (head.centre - centre).norm() < SAME_REJECTED_M)
    }

    /// Delays the next try of a head without a face; `retry_at_once` allows its first tries in consecutive frames.
    fn reject(&mut self, centre: Point, retry_at_once: bool) {
        let index = self.rejected_index(&centre);
        let before = index.map(|index| self.rejected.remove(index));
        // An old rejection was of another head.
        let before = before.filter(|head| self.frame_count < head.retry_from + EAGER_TRIES);
        let tries = before.map_or(1, |head| head.tries + 1);
        let eager = retry_at_once && tries <= EAGER_TRIES;
        let retry_from = self.frame_count + if eager { 1 } else { RETRY_FRAMES };
        self.rejected.truncate(HEADS - 1);
        let head = RejectedHead {
            centre,
            retry_from,
            tries,
        };
        // Not full.
        let _ = self.rejected.insert(0, head);
    }

    /// Chooses the user for single-person outputs.
    pub(super) fn update_choice(&mut self) {
        let mut there: heapless::Vec<Candidate, USERS> = heapless::Vec::new();
        for (slot, user) in self.followers[..USERS].iter().enumerate() {
            let is_there = user.person.state.is_present();
            if let Some(position) = user.person.position.filter(|_| is_there) {
                // One per slot fits.
                let _ = there.push(Candidate {
                    slot,
                    since: user.person.first_seen,
                    place: position.centre(),
                });
            }
        }
        self.choice.update(&there, self.at);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rejected_head_is_retried_at_first_every_frame_then_every_fourth() {
        let mut people = People::new(&Settings::default(), &FaceModel::shipped()).expect("a model");
        let mut waits = |frames: core::ops::Range<u64>, retry_at_once| -> Vec<u64> {
            let tried = frames.map(|count| {
                people.frame_count = count;
                people.reject(
                    Point::new(0.0, 0.001 * (count % 9) as f32, 0.8),
                    retry_at_once,
                );
                people.rejected[0].retry_from - count
            });
            tried.collect()
        };
        let all = waits(0..100, true);
        assert!(all[..24].iter().all(|wait| *wait == 1) && all[24..].iter().all(|wait| *wait == 4));
        assert_eq!(waits(200..202, true), [1, 1]);
        // Consecutive tries cost too much while others are tracked, and gain nothing without a search.
        assert_eq!(waits(300..302, false), [4, 4]);
        // A head elsewhere is another one; the latest are kept.
        for head in 0..2 * HEADS {
            people.reject(Point::new(head as f32, 0.0, 2.0), false);
        }
        assert_eq!(people.rejected.len(), HEADS);
        assert_eq!(
            people.rejected_index(&Point::new(2.0 * HEADS as f32 - 1.0, 0.0, 2.0)),
            Some(0)
        );
        assert_eq!(people.rejected_index(&Point::new(0.0, 0.0, 2.0)), None);
    }
}
