//! Which regions of a face can be seen, by the picture around their landmarks.
//!
//! A region's evidence is the median discriminant of its landmarks ([`super::cascade::discriminants`]) in a fit that uses all
//! patches. On faces of the training set's kind it is 0.3 or more, in backlight, from below and under a beard down to -0.3; under
//! a mask or dark glasses its median is -0.5 to -2. Evidence is averaged over [`AVERAGED_S`]; a region becomes hidden below
//! [`HIDES`] and seen above [`SHOWS`]. What is usual for a person is no evidence: a mask worn from the start hides the mouth.
//!
//! The patches of a hidden region do not count in the fit. Such a fit moves away from the mask, which makes the region's
//! discriminants lower still; a free region has [`SHOWS_UNUSED`] or more in both kinds of fit. Therefore a fit with all patches is
//! made now and then ([`PROBE_FRAMES`]) while a region is hidden.
//!
//! Memory: some numbers per person. Cost: medians of 68 numbers; a second fit in one of [`PROBE_FRAMES`] frames with a hidden region.

use crate::base::capacity::{LANDMARKS, REGIONS};
use crate::base::defaults;
use crate::face_model::scheme::{LOWER_JAW, VISIBLE_REGIONS};

/// Averaging time of the evidence, seconds.
const AVERAGED_S: f32 = 0.25;
/// Bounds of a frame's evidence, so that a change takes the same time on every face.
const BOUNDS: [f32; 2] = [-2.0, 1.0];
/// Evidence below which a region becomes hidden.
const HIDES: f32 = -0.5;
/// Rotation from the line of sight beyond which the far side of any face has less evidence, radians.
const TURNED_RAD: f32 = 0.26;
/// Loss of evidence with rotation beyond that.
const PER_RADIAN: f32 = 4.0;
/// Evidence above which a hidden region becomes visible again.
const SHOWS: f32 = 0.0;
/// Evidence in fits without its patches above which a hidden region becomes visible again.
const SHOWS_UNUSED: f32 = -1.2;
/// Frames with a hidden region from one fit with all patches to the next.
pub const PROBE_FRAMES: u32 = 4;
/// Time in which a region's visibility goes from 0 to 1, seconds.
const FADE_S: f32 = 0.15;
/// The mouth among [`VISIBLE_REGIONS`].
pub const MOUTH: usize = 5;
/// Both eyes among [`VISIBLE_REGIONS`].
pub const EYES: [usize; 2] = [2, 3];

/// Evidence of every region: the median discriminant of its landmarks.
pub fn evidence(discriminants: &[f32; LANDMARKS]) -> [f32; REGIONS] {
    core::array::from_fn(|region| {
        let mut values = *discriminants;
        let values = &mut values[VISIBLE_REGIONS[region].1.clone()];
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f32::total_cmp).1
    })
}

defaults! {
    /// Visibility of the regions of one person's face.
    #[derive(Clone, Debug)]
    pub struct Visibility {
        /// Mean evidence in fits with all patches; `None` before the first.
        all: Option<[f32; REGIONS]> = None,
        /// Mean evidence in fits without hidden patches.
        unused: [f32; REGIONS] = [0.0; REGIONS],
        hidden: [bool; REGIONS] = [false; REGIONS],
        seen: [f32; REGIONS] = [1.0; REGIONS],
        frames: u32 = 0,
    }
}

fn average(mean: &mut [f32; REGIONS], evidence: &[f32; REGIONS], dt: f32) {
    let share = 1.0 - (-dt / AVERAGED_S).exp();
    for (mean, evidence) in mean.iter_mut().zip(evidence) {
        *mean += (evidence.clamp(BOUNDS[0], BOUNDS[1]) - *mean) * share;
    }
}

impl Visibility {
    /// Adds a fit with all patches of a face `turned` from the line of sight (radians), `dt` seconds after the last such fit; whether a
    /// region became hidden.
    pub fn observe(&mut self, evidence: &[f32; REGIONS], turned: f32, dt: f32) -> bool {
        let hides = HIDES - PER_RADIAN * (turned - TURNED_RAD).max(0.0);
        let first = evidence.map(|value| value.clamp(BOUNDS[0], BOUNDS[1]));
        let all = self.all.get_or_insert(first);
        average(all, evidence, dt);
        let mut is_news = false;
        for (region, hidden) in self.hidden.iter_mut().enumerate() {
            let was = *hidden;
            *hidden = if was {
                all[region] < SHOWS || self.unused[region] < SHOWS_UNUSED
            } else {
                all[region] < hides
            };
            if *hidden && !was {
                is_news = true;
                self.unused[region] = all[region];
            }
        }
        is_news
    }

    /// Adds a frame's fit without the hidden patches; whether a fit with all patches is due.
    pub fn observe_unused(&mut self, evidence: &[f32; REGIONS], dt: f32) -> bool {
        average(&mut self.unused, evidence, dt);
        self.frames += 1;
        self.frames.is_multiple_of(PROBE_FRAMES)
    }

    /// Hides some regions, because a face was found only without them.
    pub fn hide(&mut self, regions: &[usize]) {
        let all = self.all.get_or_insert([BOUNDS[1]; REGIONS]);
        for &region in regions {
            self.hidden[region] = true;
            (all[region], self.unused[region]) = (BOUNDS[0], BOUNDS[0]);
        }
    }

    /// Whether a region is hidden.
    pub fn is_partial(&self) -> bool {
        self.hidden.contains(&true)
    }

    /// Whether both eyes are hidden.
    pub fn hides_eyes(&self) -> bool {
        EYES.iter().all(|&eye| self.hidden[eye])
    }

    /// Whether too little is left: neither an eye nor the mouth.
    pub fn hides_face(&self) -> bool {
        self.hides_eyes() && self.hidden[MOUTH]
    }

    /// Landmarks of the hidden regions.
    pub fn hidden_landmarks(&self) -> [bool; LANDMARKS] {
        let mut landmarks = [false; LANDMARKS];
        for (region, (_, points)) in VISIBLE_REGIONS.into_iter().enumerate() {
            landmarks[points].fill(self.hidden[region]);
        }
        landmarks[LOWER_JAW].fill(self.hidden[MOUTH]);
        landmarks
    }

    /// How far each region can be seen, 0 to 1, `dt` seconds after the last call: a hidden region fades.
    pub fn fade(&mut self, dt: f32) -> [f32; REGIONS] {
        for (seen, hidden) in self.seen.iter_mut().zip(self.hidden) {
            let target = if hidden { 0.0 } else { 1.0 };
            let step = dt / FADE_S;
            *seen += (target - *seen).clamp(-step, step);
        }
        self.seen
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f32 = 1.0 / 30.0;
    const FREE: [f32; REGIONS] = [2.0; REGIONS];

    fn masked(evidence: f32) -> [f32; REGIONS] {
        let mut all = FREE;
        all[MOUTH] = evidence;
        all
    }

    /// Plays `seconds` of fits as the fitter makes them: `all` with all patches, `unused` without the hidden ones.
    fn play(visibility: &mut Visibility, seconds: f32, all: f32, unused: f32) -> [f32; REGIONS] {
        let mut seen = [0.0; REGIONS];
        for _ in 0..(seconds / DT).round() as usize {
            if !visibility.is_partial() {
                visibility.observe(&masked(all), 0.0, DT);
            } else if visibility.observe_unused(&masked(unused), DT) {
                visibility.observe(&masked(all), 0.0, DT * PROBE_FRAMES as f32);
            }
            seen = visibility.fade(DT);
        }
        seen
    }

    #[test]
    fn a_mask_worn_from_the_start_hides_the_mouth_and_nothing_else() {
        let mut visibility = Visibility::default();
        let seen = play(&mut visibility, 0.3, -1.2, -1.6);
        assert_eq!(seen, [1.0, 1.0, 1.0, 1.0, 1.0, 0.0]);
        let hidden = visibility.hidden_landmarks();
        assert!(hidden[48] && hidden[67] && hidden[8] && !hidden[47] && !hidden[33]);
        // It stays hidden for as long as it is worn.
        assert_eq!(play(&mut visibility, 600.0, -1.2, -1.6), seen);
    }

    #[test]
    fn a_mask_is_noticed_within_half_a_second_and_the_mouth_is_back_within_one() {
        let mut visibility = Visibility::default();
        assert_eq!(play(&mut visibility, 60.0, 3.0, 3.0), [1.0; REGIONS]);
        assert_eq!(play(&mut visibility, 0.6, -1.2, -1.6)[MOUTH], 0.0);
        play(&mut visibility, 60.0, -1.2, -1.6);
        assert_eq!(play(&mut visibility, 1.0, 3.0, 1.0)[MOUTH], 1.0);
    }

    #[test]
    fn a_beard_or_a_moment_hides_nothing() {
        let mut visibility = Visibility::default();
        assert_eq!(play(&mut visibility, 60.0, -0.3, -0.6), [1.0; REGIONS]);
        assert_eq!(play(&mut visibility, 0.1, -2.0, -2.0), [1.0; REGIONS]);
        assert_eq!(play(&mut visibility, 60.0, 0.3, -0.1), [1.0; REGIONS]);
    }

    #[test]
    fn a_mask_that_looks_like_a_mouth_stays_hidden_by_the_fit_without_it() {
        let mut visibility = Visibility::default();
        play(&mut visibility, 1.0, -1.2, -2.0);
        assert_eq!(play(&mut visibility, 30.0, 0.5, -2.0)[MOUTH], 0.0);
    }

    #[test]
    fn evidence_is_the_median_of_a_regions_landmarks() {
        let mut discriminants = [0.0; LANDMARKS];
        for (k, value) in [
            (42, 5.0),
            (43, -9.0),
            (44, 1.0),
            (45, 2.0),
            (46, 3.0),
            (47, 1.5),
        ] {
            discriminants[k] = value;
        }
        let found = evidence(&discriminants);
        assert_eq!(found[EYES[0]], 2.0);
        assert_eq!(found[EYES[1]], 0.0);
    }
}
