//! Admission of newcomers, and recognition of people who left.

use super::people::{CANDIDATE, People};
use mien_stages::base::capacity::USERS;
use mien_stages::users::TrackingState;
use mien_stages::users::likeness::Likeness;

/// Frames of the whole head before a newcomer is first compared with people who left.
pub const REID_MIN_FRAMES: u64 = 4;
/// Distance of two people ([`mien_stages::users::likeness`]) below which they match after [`REID_MIN_FRAMES`]. Over eight frames,
/// seven of ten returning people are nearer, and three of a thousand strangers.
pub const REID_EARLY_DISTANCE: f32 = 1.0;
/// Tracked frames after which a newcomer is admitted even if the image edge cuts off their head and prevents a comparison.
const REID_MAX_FRAMES: u64 = 40;
/// Interval at which a new user is compared again, in frames: a person walking in shows one side of the head first.
const RECHECK_STEP: u64 = 8;
/// Frames of the head after which a user is not compared again.
const RECHECK_MAX_FRAMES: u64 = 48;
/// Distance from everybody remembered beyond which a newcomer is a stranger before [`REID_FULL_FRAMES`].
const STRANGER_DISTANCE: f32 = 1.6;
/// Frames of the head after which the comparison of a newcomer ends; with detection, within ten frames.
pub const REID_FULL_FRAMES: u64 = 5;
/// Distance of two people below which they match after [`REID_FULL_FRAMES`]. Over ten frames, nine of ten returning people are
/// nearer, and two of a hundred strangers.
pub const REID_FULL_DISTANCE: f32 = 1.2;

impl People {
    /// Whether a user with this many frames of their head is compared again with people who left.
    pub(super) fn is_recheck_due(&self, slot: usize) -> bool {
        let learned = self.followers[slot].pose.learned_frames();
        learned > REID_FULL_FRAMES
            && learned <= RECHECK_MAX_FRAMES
            && learned.is_multiple_of(RECHECK_STEP)
    }

    /// Gives the candidate a slot once it is compared with the people who left.
    pub(super) fn admit(&mut self) {
        let anybody = !self.memory.gone().is_empty() || self.lost().next().is_some();
        let candidate = &self.followers[CANDIDATE];
        let learned = candidate.pose.learned_frames();
        let waited = candidate.tracked_frames() >= REID_MAX_FRAMES;
        if anybody && learned < REID_MIN_FRAMES && !waited {
            return;
        }
        let most = self.settings.most as usize;
        let sure = learned >= REID_FULL_FRAMES || waited;
        let max_distance = match sure {
            true => REID_FULL_DISTANCE,
            false => REID_EARLY_DISTANCE,
        };
        let known = self.recognise(CANDIDATE, max_distance);
        // A possible match is compared for longer, so that no slot is revoked.
        if known.is_none() && !sure && self.nearest_known(CANDIDATE, STRANGER_DISTANCE).is_some() {
            return;
        }
        let slot = known.filter(|&slot| slot < most);
        if let Some(slot) = slot.or_else(|| self.slot_for_newcomer()) {
            if known.is_some() {
                self.memory.forget_slot(slot);
                self.followers.swap(slot, CANDIDATE);
            } else {
                self.move_candidate(slot);
            }
        }
        self.followers[CANDIDATE].forget();
    }

    /// A free slot, else that of the user lost for longest.
    pub(super) fn slot_for_newcomer(&mut self) -> Option<usize> {
        if let Some(slot) = self.memory.slot_for_newcomer(&self.free_slots()) {
            self.memory.forget_slot(slot);
            return Some(slot);
        }
        let most = self.settings.most as usize;
        let lost = self.lost().filter(|&slot| slot < most);
        lost.min_by_key(|&slot| self.followers[slot].person.last_seen)
    }

    /// Makes the candidate the user of this slot; remembers the user who had it.
    pub(super) fn move_candidate(&mut self, slot: usize) {
        if self.followers[slot].is_taken() {
            self.remember(slot);
        }
        self.followers.swap(slot, CANDIDATE);
    }

    /// Compares a recent newcomer again with people who left, and moves them to their old slot if recognised.
    pub(super) fn recheck_identity(&mut self, slot: usize) {
        let known = self.recognise(slot, REID_FULL_DISTANCE);
        if let Some(theirs) = known.filter(|&theirs| theirs != slot) {
            self.memory.forget_slot(theirs);
            self.followers.swap(slot, theirs);
            self.followers[slot].forget();
            self.left[slot] = true;
        }
    }

    /// Slots of lost users.
    fn lost(&self) -> impl Iterator<Item = usize> {
        let users = self.followers[..USERS].iter().zip(0..);
        users.filter_map(|(user, slot)| (user.person.state == TrackingState::Lost).then_some(slot))
    }

    fn free_slots(&self) -> [bool; USERS] {
        let most = self.settings.most as usize;
        core::array::from_fn(|slot| slot < most && !self.followers[slot].is_taken())
    }

    /// Restores the ranges of the lost or remembered person nearest to a follower's person. Returns their slot if it is
    /// available; `None` also if nobody is nearer than `max_distance`.
    fn recognise(&mut self, index: usize, max_distance: f32) -> Option<usize> {
        let (slot, is_lost) = self.nearest_known(index, max_distance)?;
        if is_lost {
            // Old ranges, current pose.
            let [one, other] = self.followers.get_disjoint_mut([index, slot]).ok()?;
            core::mem::swap(&mut one.expression, &mut other.expression);
            one.person.first_seen = other.person.first_seen;
            return Some(slot);
        }
        let gone = self.memory.take(slot)?;
        self.followers[index].expression.restore(&gone.learned);
        (slot == index || self.free_slots()[slot]).then_some(slot)
    }

    /// The lost or remembered person nearest to a follower's: their slot, and whether they are lost.
    fn nearest_known(&self, index: usize, max_distance: f32) -> Option<(usize, bool)> {
        let one = &self.followers[index];
        let likeness = one.likeness();
        let lost = self.lost().filter(|&slot| slot != index);
        let lost = lost.map(|slot| (slot, true, self.followers[slot].likeness()));
        let gone = self.memory.gone().iter();
        let gone = gone.map(|gone| (gone.slot, false, gone.likeness.clone()));
        let near = lost.chain(gone).filter_map(|(slot, is_lost, other)| {
            let distance = self.identity_distance(&likeness, &other)?;
            (distance < max_distance).then_some((distance, slot, is_lost))
        });
        let (_, slot, is_lost) = near.min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((slot, is_lost))
    }

    /// Distance of two people's features, dimensionless; `None` if too little of a head was seen.
    pub(super) fn identity_distance(&self, one: &Likeness, other: &Likeness) -> Option<f32> {
        let pose = &self.followers[CANDIDATE].pose;
        Some(one.distance(other, pose.difference(&one.head, &other.head)?))
    }
}
