//! The people in front of the sensor: which head is whose, and who they are.
//!
//! Heads are assigned to the users they belong to ([`mien_stages::users::matching`]); each user has their own stages
//! ([`super::follower`]). An unassigned head goes to the candidate's follower, one at a time: it becomes a user once a face
//! is found on it (or, without colour, once depth has tracked it for a while) and, if there are people who left, after a few
//! more frames that show whether it is one of them ([`mien_stages::users::memory`]). A head without a face is ignored for a few
//! frames, but while nobody else is there only after its first tries. While everybody is followed where expected, the picture is
//! segmented for others in every third frame only. A frame does at most half of a search for an initial pose, so that none
//! costs much more than tracking.
//!
//! When all slots are in use, a newcomer has to wait until a user is forgotten.

use std::sync::Arc;

use super::follower::Follower;
use super::settings::Settings;
use super::stage::{Now, Stage};
use mien_stages::base::capacity::{HEADS, USERS};
use mien_stages::base::geometry::Point;
use mien_stages::base::second_core::SecondCore;
use mien_stages::base::time::Timestamp;
use mien_stages::expression::Expression;
use mien_stages::expression::units::Units;
use mien_stages::face_model::FaceModel;
use mien_stages::landmarks::{LandmarkStage, Scratch};
use mien_stages::pose::{PoseError, PoseTracker};
use mien_stages::segment::{HeadCloud, Segmenter};
use mien_stages::users::choice::{Candidate, Choice};
use mien_stages::users::likeness::Likeness;
use mien_stages::users::matching::LastSeen;
use mien_stages::users::memory::Memory;
use mien_stages::users::{self, Presence, TrackingState, matching};

/// Frames for which a newcomer's whole head is compared before deciding whether they were here before, if anybody was,
pub const FIRST_LOOK: u64 = 4;
/// and the distance of two people ([`mien_stages::users::likeness`]) up to which they are the same: over eight frames, seven of
/// ten returning people are nearer, and three of a thousand strangers.
pub const FIRST_LOOK_APART: f32 = 1.0;
/// A head cut off by the picture's edge is inconclusive; it is waited for this many frames.
const LONGEST_LOOK: u64 = 40;
/// At this interval, in frames, a new user is compared again until the last look: a person walking in shows one side first,
/// and returns to their old slot if recognised.
const LOOK_STEP: u64 = 8;
const LAST_LOOK: u64 = 48;
/// Beyond this distance from all of them a newcomer is a stranger at once; in between, comparison continues
const STRANGER_APART: f32 = 1.6;
/// for this many frames: with those needed to be detected at all, a newcomer has a slot within ten,
pub const SECOND_LOOK: u64 = 5;
/// with this distance: over ten frames, nine of ten returning people are nearer, and two of a hundred strangers.
pub const SECOND_LOOK_APART: f32 = 1.2;
/// A head without a face is tried again after this many frames,
const REFUSED_FRAMES: u64 = 4;
/// but in the very next one for its first tries, two for each place that is searched for its face, if nobody else is there.
const EAGER: u64 = 24;
/// A refused head that has moved less than this is the same one, metres.
const REFUSED_M: f32 = 0.06;
/// A cut-out this near to a user's head is part of it, metres.
const SAME_M: f32 = 0.12;
/// While everybody is followed where expected, the picture is segmented for others once in so many frames.
const WATCH_STEP: u64 = 3;

/// All people: tracked, candidate, or gone and remembered.
pub(super) struct People {
    /// By slot, and last the candidate's.
    pub(super) followers: Vec<Follower>,
    pub(super) settings: users::Settings,
    pub(super) memory: Memory,
    pub(super) choice: Choice,
    /// Heads without a face, the last first: where, the frame from which they are tried again, and how often they were.
    pub(super) refused: heapless::Vec<(Point, u64, u64), HEADS>,
    /// Slots whose users were forgotten in this frame.
    pub(super) left: [bool; USERS],
    pub(super) frame: u64,
    /// Frames processed so far.
    count: u64,
    pub(super) at: Timestamp,
    /// Of the head that is followed, one for each thread.
    clouds: [Box<HeadCloud>; 2],
    pub(super) second: Option<(SecondCore, Scratch)>,
}

/// One person to follow: their follower, the middle of their cut-out head, and whether they were found.
type Task<'a> = (&'a mut Follower, Option<Point>, &'a mut Option<bool>);

/// The follower of the candidate, who may become a user.
pub(super) const CANDIDATE: usize = USERS;

/// Why a pipeline cannot be created from these settings and this model.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The model's standard head.
    #[error(transparent)]
    Pose(#[from] PoseError),
    /// The model's appearance.
    #[error(transparent)]
    Landmarks(#[from] mien_stages::landmarks::LandmarkError),
}

/// Runs the stages of each where their heads are expected.
fn each_expected(tasks: &mut [Task<'_>], now: &mut Now<'_>, cloud: &mut HeadCloud) {
    for (user, middle, found) in tasks {
        **found = user.follow_expected(now, cloud, *middle);
    }
}

/// What of one person's stages depends on neither model nor pose.
pub(super) fn learning(settings: &Settings, units: &Arc<Units>) -> (Expression, Presence) {
    let users = &settings.users;
    (
        Expression::new(settings.learning, units.clone()),
        Presence::new(users.hold_s, users.forget_s),
    )
}

/// Whether a user is compared again after this many frames of learning their head.
fn is_looked_at(learned: u64) -> bool {
    learned > SECOND_LOOK && learned <= LAST_LOOK && learned.is_multiple_of(LOOK_STEP)
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
            let (expression, presence) = learning(settings, &units);
            let landmarks = LandmarkStage::new(settings.landmarks, model)?;
            Ok(Follower::new(
                pose.for_another_head(),
                landmarks,
                expression,
                presence,
            ))
        };
        let mut people = Self {
            followers: (0..=CANDIDATE)
                .map(follower)
                .collect::<Result<_, PipelineError>>()?,
            memory: Memory::default(),
            choice: Choice::new(settings.users.single),
            settings: settings.users.clone(),
            refused: heapless::Vec::new(),
            left: [false; USERS],
            frame: 0,
            count: 0,
            at: Timestamp::default(),
            clouds: Default::default(),
            second: None,
        };
        people.share(settings);
        Ok(people)
    }

    /// Runs everybody's stages, on the heads of the segmented frame where they are needed.
    pub(super) fn follow(&mut self, now: &mut Now<'_>, segmenter: &mut Segmenter) {
        let frame = now.frame;
        (self.frame, self.at) = (frame.index, frame.at);
        self.count += 1;
        self.left = [false; USERS];
        self.memory
            .forget_older(frame.at, self.settings.remember_s.into());
        // With nobody to follow there is time for both halves of a search.
        let mut users = self.followers[..USERS].iter();
        let busy = users.any(|user| user.person.state.is_present());
        now.searches = if busy { 1 } else { 2 };
        let free = self.follow_users(now, segmenter);
        self.follow_candidate(now, segmenter.heads(), &free);
        self.choose();
    }

    /// Runs the users' stages on their heads; returns the unassigned heads.
    fn follow_users(
        &mut self,
        now: &mut Now<'_>,
        segmenter: &mut Segmenter,
    ) -> heapless::Vec<usize, HEADS> {
        let at = now.frame.at;
        let mut found = [None; USERS];
        let mut heads: &[HeadCloud] = &[];
        let settled = !self.count.is_multiple_of(WATCH_STEP) && self.all_settled();
        if !settled || !self.follow_expected(now, [None; USERS], &mut found) {
            segmenter.segment(now.frame, now.camera);
            (now.after)(Stage::Segment);
            heads = segmenter.heads();
        }
        let heads = heads.iter();
        let centres: heapless::Vec<Point, HEADS> = heads.map(|head| head.centre).collect();
        let expected = core::array::from_fn(|slot| {
            let user = &self.followers[slot];
            let place = user.person.place.filter(|_| user.is_taken());
            place.map(|place| place.expected(at))
        });
        let theirs = matching::assign(&expected, &centres);
        let middles = theirs.map(|head| head.map(|head| centres[head]));
        self.follow_expected(now, middles, &mut found);
        // Who is served first when several are lost changes from frame to frame.
        for k in 0..USERS as u64 {
            let slot = ((k + self.count) % USERS as u64) as usize;
            let user = &mut self.followers[slot];
            if !user.is_taken() {
                continue;
            }
            let found = found[slot].unwrap_or_else(|| {
                theirs[slot].is_some_and(|head| user.follow_in(now, &segmenter.heads()[head]))
            });
            if !found {
                let before = user.person.state;
                user.miss(at);
                if user.person.state == TrackingState::Absent && before != TrackingState::Absent {
                    self.left[slot] = true;
                }
            }
        }
        let users = &self.followers[..USERS];
        let taken = |head: &usize| {
            theirs.contains(&Some(*head))
                || users.iter().any(|user| {
                    let place = user.person.place.filter(|_| user.person.rect.is_some());
                    place.is_some_and(|place| (centres[*head] - place.centre()).norm() < SAME_M)
                })
        };
        let heads = 0..centres.len();
        let free: heapless::Vec<usize, HEADS> = heads.filter(|head| !taken(head)).collect();
        self.update_slots();
        free
    }

    /// Forgets who left in this frame, and compares newcomers again with people who left before.
    fn update_slots(&mut self) {
        for slot in 0..USERS {
            if self.left[slot] {
                self.remember(slot);
                self.followers[slot].forget();
            } else if self.followers[slot].person.rect.is_some()
                && is_looked_at(self.followers[slot].pose.learned_frames())
            {
                self.look_again(slot);
            }
        }
    }

    /// Whether all who are there are followed without interruption and nobody else is being looked at.
    fn all_settled(&self) -> bool {
        let users = self.followers[..USERS].iter();
        let mut users = users.filter(|user| user.is_taken()).peekable();
        users.peek().is_some()
            && self.followers[CANDIDATE].person.place.is_none()
            && users.all(Follower::is_settled)
    }

    /// Runs the stages of all users not yet in `found` where their heads are expected, half of them on the second core if
    /// there is one. Whether all are where they were expected.
    fn follow_expected(
        &mut self,
        now: &mut Now<'_>,
        middles: [Option<Point>; USERS],
        found: &mut [Option<bool>; USERS],
    ) -> bool {
        let tasks = self.followers.iter_mut().zip(middles).zip(&mut *found);
        let tasks = tasks.map(|((user, middle), found)| (user, middle, found));
        let tasks = tasks.filter(|(user, _, found)| user.is_taken() && found.is_none());
        let mut tasks: heapless::Vec<Task<'_>, USERS> = tasks.collect();
        let [cloud, other] = &mut self.clouds;
        match &mut self.second {
            Some((core, scratch)) if tasks.len() > 1 => {
                let (frame, camera) = (now.frame, now.camera);
                let half = tasks.len() / 2;
                let (theirs, mine) = tasks.split_at_mut(half);
                core.join(|| each_expected(mine, now, cloud), &mut || {
                    let mut now = Now {
                        frame,
                        camera,
                        scratch,
                        searches: 0,
                        after: &mut |_| {},
                    };
                    each_expected(theirs, &mut now, other);
                });
            }
            _ => each_expected(&mut tasks, now, cloud),
        }
        tasks.iter().all(|(.., found)| found.is_some())
    }

    /// Remembers the user of a slot.
    fn remember(&mut self, slot: usize) {
        let user = &self.followers[slot];
        if self.settings.remember_s > 0.0 {
            self.memory.keep(user.gone(slot));
        }
    }

    /// Processes one unassigned head, which may become a user.
    fn follow_candidate(&mut self, now: &mut Now<'_>, heads: &[HeadCloud], free: &[usize]) {
        let present = (0..USERS).filter(|&slot| self.followers[slot].person.state.is_present());
        let present = present.count();
        if present >= self.settings.most as usize {
            self.followers[CANDIDATE].forget();
            return;
        }
        let head = match &self.followers[CANDIDATE].person.place {
            Some(place) => {
                let (place, reach) = place.expected(now.frame.at);
                let apart = |head: usize| (heads[head].centre - place).norm();
                let near = free.iter().copied().filter(|&head| apart(head) <= reach);
                near.min_by(|&a, &b| apart(a).total_cmp(&apart(b)))
            }
            None => {
                // Heads never refused come first, then who has waited longest: a static object is refused again and again.
                let refused = |head: usize| {
                    let at = self.refused_at(&heads[head].centre);
                    at.map_or(0, |at| self.refused[at].1)
                };
                let free = free.iter().copied();
                free.filter(|&head| refused(head) <= self.count)
                    .min_by_key(|&head| refused(head))
            }
        };
        let candidate = &mut self.followers[CANDIDATE];
        let Some(head) = head else {
            if candidate.person.place.is_some() {
                candidate.forget();
            }
            return;
        };
        if now.searches == 0 && candidate.person.place.is_none() {
            return;
        }
        if !candidate.follow_in(now, &heads[head]) {
            if candidate.pose.is_searching() {
                let centre = heads[head].centre;
                candidate.person.place = Some(LastSeen::new(centre, centre.coords, now.frame.at));
                return;
            }
            candidate.forget();
            let at_once = present == 0 && candidate.landmarks.cascade().is_some();
            self.refuse(heads[head].centre, at_once);
            return;
        }
        if candidate.is_somebody() {
            self.admit();
        }
    }

    fn refused_at(&self, place: &Point) -> Option<usize> {
        let mut places = self.refused.iter().map(|refused| refused.0);
        places.position(|other| (other - place).norm() < REFUSED_M)
    }

    /// A head without a face waits before it is tried again; with `at_once` its first tries follow each other.
    fn refuse(&mut self, place: Point, at_once: bool) {
        let before = self.refused_at(&place).map(|at| self.refused.remove(at));
        // Another one, if nothing was there for a while.
        let before = before.filter(|(_, until, _)| self.count < until + EAGER);
        let times = before.map_or(1, |(.., times)| times + 1);
        let eager = at_once && times <= EAGER;
        let until = self.count + if eager { 1 } else { REFUSED_FRAMES };
        self.refused.truncate(HEADS - 1);
        // Not full.
        let _ = self.refused.insert(0, (place, until, times));
    }

    /// Gives the candidate a slot, once identified.
    fn admit(&mut self) {
        let lost = |slot: usize| self.followers[slot].person.state == TrackingState::Lost;
        let anybody = !self.memory.gone().is_empty() || (0..USERS).any(lost);
        let candidate = &self.followers[CANDIDATE];
        let (learned, waited) = (
            candidate.pose.learned_frames(),
            candidate.followed() >= LONGEST_LOOK,
        );
        if anybody && learned < FIRST_LOOK && !waited {
            return;
        }
        let most = self.settings.most as usize;
        let sure = learned >= SECOND_LOOK || waited;
        let apart = if sure {
            SECOND_LOOK_APART
        } else {
            FIRST_LOOK_APART
        };
        let known = self.recognise(CANDIDATE, apart);
        // Who may be one of them is looked at for longer: a slot is not to be taken back.
        if known.is_none() && !sure && self.most_like(CANDIDATE, STRANGER_APART).is_some() {
            return;
        }
        let slot = known.filter(|&slot| slot < most);
        // Else a free slot; with none, who is lost longest makes room.
        let slot = slot.or_else(|| {
            let slot = self.memory.slot_for_newcomer(&self.free_slots())?;
            self.memory.forget_slot(slot);
            Some(slot)
        });
        let slot = slot.or_else(|| {
            let lost =
                (0..most).filter(|&slot| self.followers[slot].person.state == TrackingState::Lost);
            lost.min_by_key(|&slot| self.followers[slot].person.last_seen)
        });
        if let Some(slot) = slot {
            if known.is_some() {
                self.memory.forget_slot(slot);
            } else if self.followers[slot].is_taken() {
                self.remember(slot);
            }
            self.followers.swap(slot, CANDIDATE);
        }
        self.followers[CANDIDATE].forget();
    }

    /// Compares a recent newcomer again with people who left; if recognised, they move back to their slot.
    fn look_again(&mut self, slot: usize) {
        let known = self.recognise(slot, SECOND_LOOK_APART);
        if let Some(theirs) = known.filter(|&theirs| theirs != slot) {
            self.memory.forget_slot(theirs);
            self.followers.swap(slot, theirs);
            self.followers[slot].forget();
            self.left[slot] = true;
        }
    }

    fn free_slots(&self) -> [bool; USERS] {
        let most = self.settings.most as usize;
        core::array::from_fn(|slot| slot < most && !self.followers[slot].is_taken())
    }

    /// Recognises a follower's person as one who is lost or left and restores their ranges. Returns their slot, if it is
    /// available.
    fn recognise(&mut self, of: usize, most_apart: f32) -> Option<usize> {
        let (slot, is_lost) = self.most_like(of, most_apart)?;
        if is_lost {
            // The ranges of then, the pose of now.
            let [one, other] = self.followers.get_disjoint_mut([of, slot]).ok()?;
            core::mem::swap(&mut one.expression, &mut other.expression);
            one.person.since = other.person.since;
            return Some(slot);
        }
        let gone = self.memory.take(slot)?;
        self.followers[of].expression.restore(&gone.learned);
        (slot == of || self.free_slots()[slot]).then_some(slot)
    }

    /// The lost or remembered person most like a follower's: their slot, and whether they are lost.
    fn most_like(&self, of: usize, most_apart: f32) -> Option<(usize, bool)> {
        let one = &self.followers[of];
        let likeness = one.likeness();
        let lost = (0..USERS)
            .filter(|&slot| slot != of && self.followers[slot].person.state == TrackingState::Lost);
        let lost = lost.map(|slot| (slot, true, self.followers[slot].likeness()));
        let gone = self.memory.gone().iter();
        let gone = gone.map(|gone| (gone.slot, false, gone.likeness.clone()));
        let apart = lost.chain(gone).filter_map(|(slot, is_lost, other)| {
            let apart = self.apart(&likeness, &other)?;
            (apart < most_apart).then_some((apart, slot, is_lost))
        });
        let (_, slot, is_lost) = apart.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((slot, is_lost))
    }

    /// How far apart two people are; `None` when too little was seen to tell.
    pub(super) fn apart(&self, one: &Likeness, other: &Likeness) -> Option<f32> {
        let pose = &self.followers[CANDIDATE].pose;
        Some(one.distance(other, pose.difference(&one.head, &other.head)?))
    }

    /// The user that single-person outputs show.
    fn choose(&mut self) {
        let mut there: heapless::Vec<Candidate, USERS> = heapless::Vec::new();
        for (slot, user) in self.followers[..USERS].iter().enumerate() {
            if let Some(place) = user.person.place.filter(|_| user.person.state.is_present()) {
                // As many as slots.
                let _ = there.push(Candidate {
                    slot,
                    since: user.person.since,
                    place: place.centre(),
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
    fn a_head_without_a_face_is_tried_in_every_frame_for_a_while_then_in_every_fourth_and_anew_after_a_gap()
     {
        let mut people = People::new(&Settings::default(), &FaceModel::shipped()).expect("a model");
        let mut waits = |frames: core::ops::Range<u64>, at_once| -> Vec<u64> {
            let tried = frames.map(|count| {
                people.count = count;
                people.refuse(Point::new(0.0, 0.001 * (count % 9) as f32, 0.8), at_once);
                people.refused[0].1 - count
            });
            tried.collect()
        };
        let all = waits(0..100, true);
        assert!(all[..24].iter().all(|wait| *wait == 1) && all[24..].iter().all(|wait| *wait == 4));
        assert_eq!(waits(200..202, true), [1, 1]);
        // While others are followed, at once is too dear; without a search, there is nothing to gain.
        assert_eq!(waits(300..302, false), [4, 4]);
        // Somewhere else is another head; of many, the last are known.
        for head in 0..2 * HEADS {
            people.refuse(Point::new(head as f32, 0.0, 2.0), false);
        }
        assert_eq!(people.refused.len(), HEADS);
        assert_eq!(
            people.refused_at(&Point::new(2.0 * HEADS as f32 - 1.0, 0.0, 2.0)),
            Some(0)
        );
        assert_eq!(people.refused_at(&Point::new(0.0, 0.0, 2.0)), None);
    }
}
