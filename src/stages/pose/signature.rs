//! A head's signature: a few dozen numbers by which a returning person is recognised.
//!
//! The learned offsets of the head's surface ([`super::shape`]) averaged over [`PLACES`] patches of forehead, nose and
//! cheeks, and the head's size. Before two are compared, any rigid motion or scale is removed from their
//! difference: the motion depends on the pose convention, and the scale is size. A head seen for only a few frames still has
//! part of its size in the offsets (3 % of it, as much as people differ), so only the sum of both is informative. The
//! remainder is divided by its usual spread within one person. A face cannot be reconstructed from these numbers: they
//! contain no texture, nothing finer than a patch of 2 to 3 cm, and not the mouth.
//!
//! Head frame, metres. Memory: [`PLACES`] numbers and as many counts. Cost: one pass over the anchor. Degenerate: too few
//! patches in common cannot be compared. Limitation: hats, glasses and thick hair change it; siblings may share it.

use nalgebra::{SMatrix, SVector};

use super::anchor::Anchor;
pub use super::anchor::PLACES;
use super::shape::HeadShape;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Index of the scale among the motions.
const GROWTH: usize = 6;
/// Least number of patches in common for a comparison.
const MIN_COMMON: usize = 14;
/// Spread of a patch within one person from one session to the next, metres.
const PATCH_SIGMA_M: f32 = 0.0003;

/// Largest plausible offset from the anchor, metres, and logarithm of the size.
const MOST_OFFSET_M: f32 = 0.1;
const MOST_LOG_SIZE: f64 = 0.7;

/// One head's numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Signature {
    log_size: f64,
    /// Mean offset of each patch, metres; `None` where too little was seen.
    patches: [Option<f32>; PLACES],
}

/// How two heads differ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Mean square over the patches, in units of their spread within one person.
    pub surface: f32,
    /// Logarithm of the ratio of their sizes.
    pub log_size: f32,
}

/// Writes a blank and a word for a number; `-` for what was not seen.
pub(crate) fn write_word(number: Option<f32>, to: &mut impl core::fmt::Write) -> core::fmt::Result {
    match number {
        Some(number) => write!(to, " {number:.6}"),
        None => write!(to, " -"),
    }
}

/// What such a word says; `None` if it is no number whose size is below `most`.
pub(crate) fn read_word(word: &str, most: f32) -> Option<Option<f32>> {
    match word {
        "-" => Some(None),
        word => word.parse().ok().filter(|n: &f32| n.abs() < most).map(Some),
    }
}

impl Signature {
    /// The signature of what has been learned so far.
    pub(crate) fn of(anchor: &Anchor, shape: &HeadShape) -> Self {
        let (mut sums, mut counts) = ([0.0f32; PLACES], [0u32; PLACES]);
        let mut all = [0u32; PLACES];
        for (i, &k) in anchor.patches.of.iter().enumerate() {
            let k = usize::from(k);
            if k < PLACES {
                all[k] += 1;
                if let Some(offset) = shape.measured(i) {
                    sums[k] += offset;
                    counts[k] += 1;
                }
            }
        }
        Self {
            log_size: shape.log_scale,
            patches: core::array::from_fn(|k| {
                (counts[k] * 2 > all[k] && all[k] > 3).then(|| sums[k] / counts[k] as f32)
            }),
        }
    }

    /// Writes a word for each number, each after a blank; `-` for what was not seen.
    ///
    /// # Errors
    /// If the writer fails.
    pub fn write(&self, text: &mut impl core::fmt::Write) -> core::fmt::Result {
        write!(text, " {:.6}", self.log_size)?;
        (self.patches.iter()).try_for_each(|&patch| write_word(patch, text))
    }

    /// Parses the words that [`Self::write`] wrote and no more; `None` if they are too few or implausible.
    pub fn read<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<Self> {
        let log_size: f64 = words.next()?.parse().ok()?;
        let mut patches = [None; PLACES];
        for patch in &mut patches {
            *patch = read_word(words.next()?, MOST_OFFSET_M)?;
        }
        (log_size.abs() < MOST_LOG_SIZE).then_some(Self { log_size, patches })
    }

    /// How this head differs from another one. `None` when too little of both was seen.
    pub(crate) fn differ(&self, other: &Self, anchor: &Anchor) -> Option<Difference> {
        let rows = &anchor.patches.rows;
        let common = || {
            (0..PLACES).filter_map(|k| Some((k, f64::from(self.patches[k]? - other.patches[k]?))))
        };
        let count = common().count();
        if count < MIN_COMMON {
            return None;
        }
        let mut h = SMatrix::<f64, 7, 7>::zeros();
        let mut g = SVector::<f64, 7>::zeros();
        for (k, d) in common() {
            let row = SVector::from(rows[k]);
            g += row * d;
            h += row * row.transpose();
        }
        for k in 0..7 {
            h[(k, k)] = h[(k, k)] * (1.0 + 1e-3) + 1e-9;
        }
        let motion = h.cholesky()?.solve(&g);
        let sigma = f64::from(PATCH_SIGMA_M);
        let squares: f64 = common()
            .map(|(k, d)| {
                let moved: f64 = (0..7).map(|a| rows[k][a] * motion[a]).sum();
                ((d - moved) / sigma).powi(2)
            })
            .sum();
        Some(Difference {
            surface: (squares / count as f64) as f32,
            log_size: (self.log_size - other.log_size + motion[GROWTH]) as f32,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::anchor::tests::half_egg;

    #[test]
    fn twice_as_far_apart_is_four_times_the_square() {
        let anchor = Anchor::new(&half_egg()).expect("a head");
        let mut rng = fastrand::Rng::with_seed(2);
        let pattern: [f32; PLACES] = core::array::from_fn(|_| 1e-3 * (rng.f32() - 0.5));
        let head = |times: f32| Signature {
            log_size: 0.0,
            patches: pattern.map(|offset| Some(times * offset)),
        };
        let apart = |times: f32| {
            head(times)
                .differ(&head(0.0), &anchor)
                .expect("enough")
                .surface
        };
        let (once, twice) = (apart(1.0), apart(2.0));
        assert!(
            once > 0.1 && (twice / once - 4.0).abs() < 0.01,
            "{once} {twice}"
        );
    }
}
