//! Signature of a head: a few dozen numbers that identify a returning person.
//!
//! It holds the learned surface offsets ([`super::shape`]) averaged over [`PATCHES`] patches of forehead, nose and cheeks, and
//! the head's size. Before comparison, rigid motion and scale are removed from the difference: the motion is a convention of
//! pose, and the scale is added to the size, because a head seen for only a few frames has part of its size (3 %, as much as
//! people differ) in the offsets. The remainder is divided by its spread within one person. A face cannot be reconstructed from
//! these numbers: they have no texture, no detail below 2 cm, and not the mouth.
//!
//! Head frame, metres. Memory: [`PATCHES`] numbers and as many counts. Cost: one pass over the anchor. Degenerate: too few
//! common patches give `None`. Limitation: hats, glasses and thick hair change it; siblings may share it.

use nalgebra::{SMatrix, SVector};

use super::anchor::Anchor;
pub use super::anchor::PATCHES;
use super::shape::HeadShape;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Index of the scale among the motions.
const SCALE: usize = 6;
/// Least number of patches in common for a comparison.
const MIN_COMMON_PATCHES: usize = 14;
/// Standard deviation of a patch's offset between sessions of one person, metres.
const PATCH_SIGMA_M: f32 = 0.0003;

/// Largest plausible offset, metres.
const MAX_OFFSET_M: f32 = 0.1;
/// Largest plausible |ln(size)|.
const MAX_LOG_SIZE: f64 = 0.7;

/// Signature of one head.
#[derive(Clone, Debug, PartialEq)]
pub struct Signature {
    log_size: f64,
    /// Mean offset of each patch, metres; `None` if too few of its points were seen.
    patches: [Option<f32>; PATCHES],
}

/// Difference of two heads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Mean square difference of the patches, in variances within one person.
    pub surface: f32,
    /// Natural logarithm of the ratio of their sizes.
    pub log_size: f32,
}

/// Writes a space and a number; `-` for `None`.
pub(crate) fn write_word(number: Option<f32>, to: &mut impl core::fmt::Write) -> core::fmt::Result {
    match number {
        Some(number) => write!(to, " {number:.6}"),
        None => write!(to, " -"),
    }
}

/// Parses a word of [`write_word`]; `None` unless it is `-` or a number of magnitude below `most`.
pub(crate) fn read_word(word: &str, most: f32) -> Option<Option<f32>> {
    match word {
        "-" => Some(None),
        word => word.parse().ok().filter(|n: &f32| n.abs() < most).map(Some),
    }
}

impl Signature {
    /// Signature of the shape learned so far.
    pub(crate) fn from_shape(anchor: &Anchor, shape: &HeadShape) -> Self {
        let (mut sums, mut counts) = ([0.0f32; PATCHES], [0u32; PATCHES]);
        let mut all = [0u32; PATCHES];
        for (i, &k) in anchor.patches.patch_of_point.iter().enumerate() {
            let k = usize::from(k);
            if k < PATCHES {
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

    /// Writes the numbers as words, each after a space; `-` for unseen patches.
    ///
    /// # Errors
    /// If the writer fails.
    pub fn write(&self, text: &mut impl core::fmt::Write) -> core::fmt::Result {
        write!(text, " {:.6}", self.log_size)?;
        (self.patches.iter()).try_for_each(|&patch| write_word(patch, text))
    }

    /// Reads exactly the words of [`Self::write`]; `None` if there are too few or one is implausible.
    pub fn read<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<Self> {
        let log_size: f64 = words.next()?.parse().ok()?;
        let mut patches = [None; PATCHES];
        for patch in &mut patches {
            *patch = read_word(words.next()?, MAX_OFFSET_M)?;
        }
        (log_size.abs() < MAX_LOG_SIZE).then_some(Self { log_size, patches })
    }

    /// Difference from another head; `None` with under [`MIN_COMMON_PATCHES`] common patches.
    pub(crate) fn difference(&self, other: &Self, anchor: &Anchor) -> Option<Difference> {
        let rows = &anchor.patches.rows;
        let common = || {
            (0..PATCHES).filter_map(|k| Some((k, f64::from(self.patches[k]? - other.patches[k]?))))
        };
        let count = common().count();
        if count < MIN_COMMON_PATCHES {
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
            log_size: (self.log_size - other.log_size + motion[SCALE]) as f32,
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
        let pattern: [f32; PATCHES] = core::array::from_fn(|_| 1e-3 * (rng.f32() - 0.5));
        let head = |times: f32| Signature {
            log_size: 0.0,
            patches: pattern.map(|offset| Some(times * offset)),
        };
        let apart = |times: f32| {
            head(times)
                .difference(&head(0.0), &anchor)
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
