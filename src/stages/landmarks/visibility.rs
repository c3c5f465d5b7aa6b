//! Which regions of a face can be seen, by the picture around their landmarks.
//!
//! A region's evidence is the median discriminant of its landmarks ([`super::cascade::discriminants`]) in a fit that uses all
//! patches. It is 0.3 or more on most faces, down to -0.3 in backlight, from below and under a beard, and -0.5 to -2 under a mask,
//! dark glasses or a fringe. An eye as dark as no lid has none. Evidence is averaged over [`AVERAGED_S`]. A region becomes hidden
//! below [`HIDES`] and seen above [`SHOWS`], whatever is usual for the person: a mask worn from the start hides the mouth. A mouth
//! that loses much of what is usual for the person becomes hidden too, because white masks with folds look as much like a mouth as
//! bearded lips do. (Expressions lower the evidence of the other regions as much.)
//!
//! The patches of hidden eyes, of a hidden nose or mouth do not count in the fit, as long as this partial fit agrees with the visible
//! landmarks at least as well as a fit with all patches: thick rims or a dark beard hide a region, but still tell where it is. Both
//! fits are made and compared in one of [`PROBE_FRAMES`] frames, which gives the evidence too. Brows count even if hidden: a fringe
//! moves the fit less than their absence.
//!
//! Memory: some numbers per person. Cost: medians of 68 numbers; a second fit in one of [`PROBE_FRAMES`] frames of a covered face.

use core::ops::Range;

use super::window::WINDOW;
use crate::base::capacity::{LANDMARKS, REGIONS};
use crate::base::defaults;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::face_model::scheme::{LOWER_JAW, VISIBLE_REGIONS};

/// Averaging time of the evidence, seconds.
const AVERAGED_S: f32 = 0.25;
/// Averaging time of the chin's evidence, seconds: a beard stays.
const CHIN_S: f32 = 1.0;
/// Bounds of a frame's evidence.
const BOUNDS: [f32; 2] = [-2.0, 4.0];
/// Evidence below which a region becomes hidden.
const HIDES: f32 = -0.5;
/// Evidence above which a hidden region becomes visible again.
const SHOWS: f32 = 0.3;
/// Evidence below which a brow becomes hidden: strands of hair hide a part of it and lower its evidence.
const BROW_HIDES: f32 = -1.0;
/// Evidence above which a hidden brow becomes visible again.
const BROW_SHOWS: f32 = -0.5;
/// Additional evidence that a region needs beside a hidden one that is usually covered with it.
const BESIDE: f32 = 1.0;
/// Evidence of the tip of the chin below which there is a beard: two bearded people have -3, masks -1.8 or more.
const BEARD: f32 = -2.4;
/// Evidence of the chin and of the base of the nose below which there is a beard with a moustache: a mask leaves one of them alone.
const MOUSTACHE: [f32; 2] = [-1.2, 0.7];
/// Loss of the mouth's and the nose's evidence by a beard.
const BEARD_LOSS: f32 = 2.0;
/// Loss of a person's usual evidence, beyond the median region's loss, at which the mouth becomes hidden.
const LOSS_HIDES: f32 = 2.0;
/// The same, below which a hidden mouth becomes visible again.
const LOSS_SHOWS: f32 = 1.2;
/// Averaging time of the usual evidence, seconds.
const USUAL_S: f32 = 8.0;
/// Time after which it is known, seconds.
const KNOWN_S: f32 = 2.0;
/// Rotation from the line of sight beyond which the far side of any face has less evidence, radians.
const TURNED_RAD: f32 = 0.26;
/// Loss of evidence with rotation beyond that, per radian.
const PER_RADIAN: f32 = 4.0;
/// Distance beyond which any face has less evidence, because its patches are magnified, metres.
const FAR_M: f32 = 1.3;
/// Loss of evidence with distance beyond that, per metre.
const PER_METRE: f32 = 1.5;
/// Averaging time of the comparison of partial and full fits, seconds.
const COMPARED_S: f32 = 1.0;
/// Frames of a covered face from one comparison of both fits to the next.
pub const PROBE_FRAMES: u32 = 4;
/// Grey value of an eye's landmarks, relative to the bridge of the nose, below which dark glass covers it. Free eyes have 0.22 or
/// more, also with dark skin and light from the side.
const DARK: f32 = 0.16;
/// The bridge of the nose.
const BRIDGE: Range<usize> = 27..31;
/// Landmarks at the tip of the chin.
const CHIN_TIP: Range<usize> = 6..9;
/// Time in which a region's visibility goes from 0 to 1, seconds.
const FADE_S: f32 = 0.15;
/// Both brows come first among [`VISIBLE_REGIONS`].
const BROWS: usize = 2;
/// The nose among [`VISIBLE_REGIONS`].
pub const NOSE: usize = 4;
/// The mouth among [`VISIBLE_REGIONS`].
pub const MOUTH: usize = 5;
/// Both eyes among [`VISIBLE_REGIONS`].
pub const EYES: [usize; 2] = [2, 3];

/// Region with which each region is usually covered, if any.
const COVERED_WITH: [Option<usize>; REGIONS] =
    [None, None, Some(EYES[1]), Some(EYES[0]), None, Some(NOSE)];

/// Median of at most one value for each landmark.
fn median(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: heapless::Vec<f32, LANDMARKS> = values.collect();
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// Evidence of one fit with all patches.
#[derive(Clone, Copy, Debug)]
pub struct Evidence {
    /// Of each region.
    pub regions: [f32; REGIONS],
    /// Of the tip of the chin.
    pub chin: f32,
}

impl Evidence {
    /// The median discriminant of each region's landmarks; an eye as dark as no lid is hidden. `grey`: the grey value of a window pixel;
    /// `points`: the landmarks, window pixels.
    pub fn new(
        discriminants: &[f32; LANDMARKS],
        grey: impl Fn([f32; 2]) -> f32,
        points: &[[f32; 2]; LANDMARKS],
    ) -> Self {
        let discriminant =
            |landmarks: Range<usize>| median(discriminants[landmarks].iter().copied());
        let mut regions: [f32; REGIONS] =
            core::array::from_fn(|k| discriminant(VISIBLE_REGIONS[k].1.clone()));
        let pixel = |v: f32| v.round().clamp(0.0, (WINDOW - 1) as f32);
        let grey = |landmarks: Range<usize>| {
            let points = points[landmarks].iter();
            median(points.map(|point| grey(point.map(pixel))))
        };
        let bridge = grey(BRIDGE);
        for eye in EYES {
            if grey(VISIBLE_REGIONS[eye].1.clone()) < DARK * bridge {
                regions[eye] = BOUNDS[0];
            }
        }
        Self {
            regions,
            chin: discriminant(CHIN_TIP),
        }
    }
}

defaults! {
    /// Visibility of the regions of one person's face.
    #[derive(Clone, Debug)]
    pub struct Visibility {
        /// Mean evidence.
        mean: [f32; REGIONS] = [0.0; REGIONS],
        /// Mean evidence of the chin, and the seconds averaged.
        chin: f32 = 0.0,
        chin_s: f32 = 0.0,
        /// Usual evidence of the person's regions while they are seen, and the seconds averaged.
        usual: [f32; REGIONS] = [0.0; REGIONS],
        usual_s: f32 = 0.0,
        hidden: [bool; REGIONS] = [false; REGIONS],
        seen: [f32; REGIONS] = [1.0; REGIONS],
        /// Mean discriminant of the visible landmarks in partial fits minus that in full ones.
        advantage: f32 = 0.0,
        frames: u32 = 0,
    }
}

impl Visibility {
    /// Adds a fit with all patches of a face `turned` from the line of sight (radians) at `distance_m`, `dt` seconds after the last
    /// such fit; whether a region became hidden whose patches should not count.
    pub fn observe(
        &mut self,
        evidence: &Evidence,
        [turned, distance_m]: [f32; 2],
        dt: f32,
    ) -> bool {
        let unused = self.covered_landmarks();
        let less =
            PER_RADIAN * (turned - TURNED_RAD).max(0.0) + PER_METRE * (distance_m - FAR_M).max(0.0);
        let share = 1.0 - (-dt / AVERAGED_S).exp();
        for (mean, evidence) in self.mean.iter_mut().zip(evidence.regions) {
            *mean += (evidence.clamp(BOUNDS[0], BOUNDS[1]) - *mean) * share;
        }
        self.chin_s = (self.chin_s + dt).min(CHIN_S);
        self.chin += (evidence.chin - self.chin) * (dt / self.chin_s);
        let mean = self.without_beard();
        // Light, blur and distance lower all regions.
        let losses: [f32; REGIONS] = core::array::from_fn(|k| self.usual[k] - mean[k]);
        let mut sorted = losses;
        crate::base::sorting::sort(&mut sorted);
        let common = sorted[REGIONS / 2].max(0.0) + less;
        let before = self.hidden;
        for (k, hidden) in self.hidden.iter_mut().enumerate() {
            let [hides, shows] = if k < BROWS {
                [BROW_HIDES, BROW_SHOWS]
            } else {
                [HIDES, SHOWS]
            };
            let (mut least, most_lost) = if *hidden {
                (shows, LOSS_SHOWS)
            } else {
                (hides, LOSS_HIDES)
            };
            // Glasses cover both eyes; what covers the nose covers the mouth.
            if COVERED_WITH[k].is_some_and(|other| before[other]) {
                least += BESIDE;
            }
            let is_known = k == MOUTH && self.usual_s >= KNOWN_S;
            let is_lost = is_known && losses[k] - common > most_lost;
            *hidden = mean[k] < least - less || is_lost;
        }
        self.usual_s = (self.usual_s + dt).min(USUAL_S);
        let visible = self.hidden.iter().zip(&mean).zip(&mut self.usual);
        for ((_, mean), usual) in visible.filter(|((hidden, _), _)| !**hidden) {
            *usual += (mean - *usual) * (dt / self.usual_s);
        }
        let now = self.covered_landmarks();
        if now != unused {
            self.advantage = 0.0;
        }
        now.iter().zip(unused).any(|(now, before)| *now && !before)
    }

    /// Mean evidence without the effect of a beard.
    fn without_beard(&self) -> [f32; REGIONS] {
        let mut mean = self.mean;
        let has_moustache = self.chin < MOUSTACHE[0] && mean[NOSE] < MOUSTACHE[1];
        if self.chin < BEARD || has_moustache {
            mean[NOSE] += BEARD_LOSS;
            mean[MOUTH] += BEARD_LOSS;
        }
        mean
    }

    /// Counts a frame of a covered face; whether both fits are due.
    pub fn is_probe_due(&mut self) -> bool {
        self.frames += 1;
        self.frames.is_multiple_of(PROBE_FRAMES)
    }

    /// Compares the discriminants of a partial and a full fit of the same frame, `dt` seconds after the last comparison.
    pub fn compare(&mut self, partial: &[f32; LANDMARKS], full: &[f32; LANDMARKS], dt: f32) {
        let covered = self.covered_landmarks();
        let (mut sum, mut count) = (0.0, 0.0);
        for ((partial, full), _) in (partial.iter().zip(full).zip(covered)).filter(|pair| !pair.1) {
            (sum, count) = (sum + partial - full, count + 1.0);
        }
        if count > 0.0 {
            self.advantage += (sum / count - self.advantage) * (1.0 - (-dt / COMPARED_S).exp());
        }
    }

    /// A frame without a face: the fits before it may have been beside the face.
    pub fn interrupt(&mut self) {
        let clean = self.without_beard();
        for k in (0..REGIONS).filter(|&k| !self.hidden[k]) {
            self.mean[k] += (self.usual[k] - clean[k]).max(0.0);
        }
    }

    /// Hides some regions, because a face was found only without them.
    pub fn hide(&mut self, regions: &[usize]) {
        for &region in regions {
            (self.hidden[region], self.mean[region]) = (true, HIDES);
        }
    }

    /// Whether a region is hidden whose patches may not count.
    pub fn is_covered(&self) -> bool {
        self.covered_landmarks().contains(&true)
    }

    /// Whether the patches of some region do not count.
    pub fn is_partial(&self) -> bool {
        self.is_covered() && self.advantage >= 0.0
    }

    /// Whether both eyes are hidden.
    pub fn hides_eyes(&self) -> bool {
        EYES.iter().all(|&eye| self.hidden[eye])
    }

    /// Whether too little is left: neither an eye nor the mouth.
    pub fn hides_face(&self) -> bool {
        self.hides_eyes() && self.hidden[MOUTH]
    }

    /// Landmarks of hidden regions, without the brows.
    pub fn covered_landmarks(&self) -> [bool; LANDMARKS] {
        let mut landmarks = [false; LANDMARKS];
        let regions = VISIBLE_REGIONS.into_iter().enumerate();
        for (region, (_, points)) in regions.skip(BROWS) {
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
    /// A frontal face.
    const NEAR: [f32; 2] = [0.0, 0.7];
    const FREE: [f32; REGIONS] = [2.0; REGIONS];

    fn evidence(regions: [f32; REGIONS]) -> Evidence {
        Evidence { regions, chin: 0.0 }
    }

    fn masked(mouth: f32) -> Evidence {
        let mut all = FREE;
        all[MOUTH] = mouth;
        evidence(all)
    }

    /// Plays `seconds` of fits with this evidence of the mouth, as the fitter makes them.
    fn play(visibility: &mut Visibility, seconds: f32, mouth: f32) -> [f32; REGIONS] {
        let mut seen = [0.0; REGIONS];
        for _ in 0..(seconds / DT).round() as usize {
            if !visibility.is_covered() {
                visibility.observe(&masked(mouth), NEAR, DT);
            } else if visibility.is_probe_due() {
                visibility.observe(&masked(mouth), NEAR, DT * PROBE_FRAMES as f32);
            }
            seen = visibility.fade(DT);
        }
        seen
    }

    #[test]
    fn a_mask_worn_from_the_start_hides_the_mouth_and_nothing_else() {
        let mut visibility = Visibility::default();
        let seen = play(&mut visibility, 0.3, -1.2);
        assert_eq!(seen, [1.0, 1.0, 1.0, 1.0, 1.0, 0.0]);
        let hidden = visibility.covered_landmarks();
        assert!(hidden[48] && hidden[67] && hidden[8] && !hidden[47] && !hidden[33]);
        // It stays hidden for as long as it is worn.
        assert_eq!(play(&mut visibility, 600.0, -1.2), seen);
    }

    #[test]
    fn a_mask_is_noticed_within_half_a_second_and_the_mouth_is_back_within_one() {
        let mut visibility = Visibility::default();
        assert_eq!(play(&mut visibility, 60.0, 3.0), [1.0; REGIONS]);
        assert_eq!(play(&mut visibility, 0.5, -1.2)[MOUTH], 0.0);
        play(&mut visibility, 60.0, -1.2);
        assert_eq!(play(&mut visibility, 1.0, 3.0)[MOUTH], 1.0);
    }

    #[test]
    fn a_beard_or_a_moment_hides_nothing() {
        let mut visibility = Visibility::default();
        assert_eq!(play(&mut visibility, 60.0, -0.2), [1.0; REGIONS]);
        assert_eq!(play(&mut visibility, 0.03, -2.0), [1.0; REGIONS]);
        assert_eq!(play(&mut visibility, 60.0, 0.3), [1.0; REGIONS]);
    }

    #[test]
    fn a_mask_that_looks_like_another_persons_mouth_is_noticed() {
        let mut visibility = Visibility::default();
        assert_eq!(play(&mut visibility, 60.0, 0.4), [1.0; REGIONS]);
        let mut visibility = Visibility::default();
        play(&mut visibility, 60.0, 3.2);
        assert_eq!(play(&mut visibility, 0.6, 0.4)[MOUTH], 0.0);
        assert_eq!(play(&mut visibility, 60.0, 0.4)[MOUTH], 0.0);
        assert_eq!(play(&mut visibility, 1.0, 3.2)[MOUTH], 1.0);
    }

    #[test]
    fn light_that_changes_hides_nothing() {
        let mut visibility = Visibility::default();
        for n in 0..600 {
            let level = if n < 300 { 3.5 } else { 0.4 };
            visibility.observe(&evidence([level; REGIONS]), NEAR, DT);
            assert_eq!(visibility.fade(DT), [1.0; REGIONS]);
        }
    }

    #[test]
    fn a_turned_face_needs_less_evidence() {
        for (turned, is_hidden) in [(0.2, true), (0.6, false)] {
            let mut visibility = Visibility::default();
            for _ in 0..30 {
                visibility.observe(&masked(-1.2), [turned, 0.7], DT);
            }
            assert_eq!(visibility.is_covered(), is_hidden, "{turned} rad");
        }
    }

    #[test]
    fn a_distant_face_needs_less_evidence() {
        for (far, is_hidden) in [(1.2, true), (1.8, false)] {
            let mut visibility = Visibility::default();
            for _ in 0..30 {
                visibility.observe(&masked(-1.0), [0.0, far], DT);
            }
            assert_eq!(visibility.is_covered(), is_hidden, "{far} m");
        }
    }

    #[test]
    fn hidden_brows_stay_in_the_fit() {
        let mut visibility = Visibility::default();
        let mut fringe = FREE;
        fringe[..BROWS].fill(-1.5);
        assert!(!visibility.observe(&evidence(fringe), NEAR, 1.0) && !visibility.is_covered());
        assert_eq!(visibility.fade(1.0), [0.0, 0.0, 1.0, 1.0, 1.0, 1.0]);
    }

    #[test]
    fn neither_eyes_nor_mouth_is_no_face() {
        let mut visibility = Visibility::default();
        visibility.hide(&EYES);
        assert!(!visibility.hides_face());
        visibility.hide(&[MOUTH]);
        assert!(visibility.hides_face());
    }

    #[test]
    fn evidence_is_a_median_but_for_dark_glass() {
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
        // The landmarks are in a row of the window.
        let points = core::array::from_fn(|k| [k as f32, 3.0]);
        let light = |_: [f32; 2]| 100.0;
        let found = Evidence::new(&discriminants, light, &points);
        assert_eq!(found.regions[EYES[0]], 2.0);
        assert_eq!(found.regions[EYES[1]], 0.0);
        discriminants[6..9].fill(-3.0);
        assert_eq!(Evidence::new(&discriminants, light, &points).chin, -3.0);
        // Dark glass before the left eye.
        let glass = |[x, _]: [f32; 2]| if x > 41.5 && x < 47.5 { 10.0 } else { 100.0 };
        let found = Evidence::new(&discriminants, glass, &points).regions;
        assert_eq!([found[EYES[0]], found[EYES[1]]], [BOUNDS[0], 0.0]);
    }

    #[test]
    fn a_beard_is_no_mask() {
        let bearded = Evidence {
            chin: BEARD - 0.1,
            ..masked(-1.2)
        };
        let mut visibility = Visibility::default();
        for _ in 0..60 {
            visibility.observe(&bearded, NEAR, DT);
        }
        assert!(!visibility.is_covered());
        // A mask whose chin looks like a beard for a moment.
        let mut visibility = Visibility::default();
        for n in 0..300 {
            let frame = if n % 30 < 5 { bearded } else { masked(-1.2) };
            visibility.observe(&frame, NEAR, DT);
            assert!(n < 30 || visibility.is_covered(), "frame {n}");
        }
    }

    #[test]
    fn a_full_fit_that_agrees_better_is_used() {
        let mut visibility = Visibility::default();
        play(&mut visibility, 1.0, -1.2);
        assert!(visibility.is_partial());
        let (mut better, full) = ([0.0; LANDMARKS], [1.0; LANDMARKS]);
        // What is hidden does not count.
        better[48..].fill(9.0);
        visibility.compare(&better, &full, 0.1);
        assert!(visibility.is_covered() && !visibility.is_partial());
        visibility.compare(&full, &[0.0; LANDMARKS], 2.0);
        assert!(visibility.is_partial());
    }
}
