//! How skin moves between and around the 68 landmarks, learned from sculpted shapes.
//!
//! The residual of the Laplacian solve (truth − solved) is predicted at a few hundred places of the face by kernel
//! ridge regression over the shapes: at each place a new shape is compared with every learned one by the motion
//! nearby, and adds that share of the learned shape's residual. Compared are the displacements of the landmarks near
//! the place, those of the skin around it as solved, and their difference from the skin's mean nearby (where it
//! folds). The comparison k is sharpened by the cosine, `k |cos|^(p−1)`, so that partly similar shapes count little;
//! opposite ones count negatively. It is homogeneous: twice the motion gives twice the residual.
//!
//! Frame: that of the face (left, up, out), origin between the inner eye corners, unit one eye distance. Stored is
//! the left half; the right half mirrors it, with the shapes of the other side. Memory: 2 MB unpacked. Cost: 2 ms a
//! shape. Learned by [`super::learn`], mapped onto a head by [`super::canonical`].

use std::sync::LazyLock;

use super::mesh::Vec3;
use super::names::LANDMARKS;
use mien_stages::base::vectors::with_avx2;

/// First bytes of the file, with its version.
const MAGIC: &[u8; 8] = b"mienskn1";
/// The prior in the program.
static SHIPPED: &[u8] = include_bytes!("../../../config/skin.prior");

/// Standard deviations of the comparisons of landmarks, skin and folds over distance, in eye distances.
const REACH: [f64; 3] = [0.5, 0.25, 0.25];
/// Weights of the comparisons of landmarks, skin and folds.
const KIND_WEIGHTS: [f64; 3] = [0.4, 0.2, 0.4];
/// Standard deviation of the mean that folds are compared with, in eye distances.
const FOLD: f64 = 0.15;
/// Power p of the cosine, less one.
const SHARPENING: i32 = 2;
/// Distance that a rotation of the normal by one radian equals, in eye distances: upper and lower lip touch but are
/// no neighbours.
const NORMAL_WEIGHT: f64 = 0.2;
/// Weight below which neighbours are left out.
const MIN_WEIGHT: f64 = 2e-3;

/// A point of the skin with its normal, in the face's frame.
#[derive(Clone, Copy, Debug)]
pub struct SkinPoint {
    /// Position, eye distances.
    pub at: Vec3,
    /// Unit normal.
    pub normal: Vec3,
}

impl SkinPoint {
    /// Distance along and across the skin, eye distances.
    pub fn far(&self, other: &Self) -> f64 {
        let turned = (self.normal - other.normal) * NORMAL_WEIGHT;
        ((self.at - other.at).norm_squared() + turned.norm_squared()).sqrt()
    }

    /// The point mirrored across the middle of the face.
    pub(super) fn mirrored(&self) -> Self {
        Self {
            at: flipped(&self.at),
            normal: flipped(&self.normal),
        }
    }

    /// The point in six dimensions, where [`Self::far`] is Euclidean.
    pub(super) fn point(&self) -> [f64; 6] {
        let (p, n) = (self.at, self.normal * NORMAL_WEIGHT);
        [p.x, p.y, p.z, n.x, n.y, n.z]
    }
}

/// A vector mirrored across the middle of the face.
pub(super) fn flipped(v: &Vec3) -> Vec3 {
    Vec3::new(-v.x, v.y, v.z)
}

/// Motion of one shape: landmarks, skin at the places, folds there. Eye distances.
#[derive(Clone)]
pub(super) struct Motion([Vec<Vec3>; 3]);

/// Weights of neighbours per place; a row sums to 1.
type Near = Vec<Vec<(u32, f32)>>;

fn near(places: usize, others: usize, sigma: f64, far: impl Fn(usize, usize) -> f64) -> Near {
    let row = |q: usize| {
        // Exponents first: most weights are below the bound.
        let exponent = |o: usize| -0.5 * (far(q, o) / sigma).powi(2);
        let mut row: Vec<(u32, f64)> = (0..others).map(|o| (o as u32, exponent(o))).collect();
        let most = row.iter().map(|n| n.1).fold(f64::NEG_INFINITY, f64::max);
        row.retain(|n| n.1 > most + MIN_WEIGHT.ln());
        row.iter_mut().for_each(|n| n.1 = n.1.exp());
        let sum = row.iter().map(|n| n.1).sum::<f64>().max(1e-300);
        let share = |(o, w)| (o, (w / sum) as f32);
        row.into_iter().map(share).collect()
    };
    (0..places).map(row).collect()
}

/// The geometry of the comparison: landmarks and places.
pub(super) struct Comparison {
    /// The 68, eye distances.
    pub(super) landmarks: Vec<Vec3>,
    /// The learned places.
    pub(super) places: Vec<SkinPoint>,
    near: [Near; 3],
    nearby: Near,
}

impl Comparison {
    pub(super) fn new(landmarks: Vec<Vec3>, places: Vec<SkinPoint>) -> Self {
        let n = places.len();
        let skin = |sigma| near(n, n, sigma, |a, b| places[a].far(&places[b]));
        let to = |q: usize, l: usize| (places[q].at - landmarks[l]).norm();
        Self {
            near: [
                near(n, landmarks.len(), REACH[0], to),
                skin(REACH[1]),
                skin(REACH[2]),
            ],
            nearby: skin(FOLD),
            landmarks,
            places,
        }
    }

    /// The motion of a shape, from displacements of landmarks and places.
    pub(super) fn motion(&self, controls: Vec<Vec3>, skin: Vec<Vec3>) -> Motion {
        let fold = |(row, d): (&Vec<(u32, f32)>, &Vec3)| {
            let mean = row.iter().map(|&(o, w)| skin[o as usize] * f64::from(w));
            d - mean.sum::<Vec3>()
        };
        let folds = self.nearby.iter().zip(&skin).map(fold).collect();
        Motion([controls, skin, folds])
    }

    /// k of one motion with several, before sharpening, per place and shape; `scale` is per place and kind.
    fn alike(&self, one: &Motion, several: &[Motion], scale: &[[f32; 3]]) -> Vec<f32> {
        let mut out = vec![0.0; self.places.len() * several.len()];
        for kind in 0..3 {
            self.add_alike(kind, one, several, |q| scale[q][kind], &mut out);
        }
        out
    }

    /// Adds the share of one kind to k.
    fn add_alike(
        &self,
        kind: usize,
        one: &Motion,
        several: &[Motion],
        scale: impl Fn(usize) -> f32,
        out: &mut [f32],
    ) {
        with_avx2(
            #[inline(always)]
            || {
                let count = several.len();
                let mut products = vec![0.0_f32; one.0[kind].len() * count];
                for (j, d) in one.0[kind].iter().enumerate() {
                    if *d != Vec3::zeros() {
                        for (s, other) in several.iter().enumerate() {
                            products[j * count + s] = d.dot(&other.0[kind][j]) as f32;
                        }
                    }
                }
                for (q, row) in self.near[kind].iter().enumerate() {
                    let sum = &mut out[q * count..(q + 1) * count];
                    let scale = scale(q);
                    for &(j, w) in row {
                        let w = w * scale;
                        let products = &products[j as usize * count..(j as usize + 1) * count];
                        for (sum, product) in sum.iter_mut().zip(products) {
                            *sum += w * product;
                        }
                    }
                }
            },
        );
    }
}

/// The learned prior.
pub struct Prior {
    pub(super) comparison: Comparison,
    /// The learned shapes, normalised to an RMS motion of 1.
    pub(super) learned: Vec<Motion>,
    /// Number of each shape's mirror image.
    pub(super) mirror: Vec<u8>,
    /// Residual of a shape per unit of k, per place and shape.
    pub(super) adds: Vec<Vec3>,
    scale: Vec<[f32; 3]>,
    /// √k of each learned shape with itself, per place and shape.
    size: Vec<f32>,
}

impl Prior {
    /// Prepares the comparison; `adds` may still be empty.
    pub(super) fn new(
        comparison: Comparison,
        learned: Vec<Motion>,
        mirror: Vec<u8>,
        adds: Vec<Vec3>,
    ) -> Self {
        let (places, count) = (comparison.places.len(), learned.len());
        let mut scale = vec![[0.0; 3]; places];
        let mut square = vec![0.0_f32; places * count];
        for kind in 0..3 {
            // k of every learned shape with itself, by one kind alone.
            let own = learned.iter().map(|shape| {
                let mut own = vec![0.0_f32; places];
                let itself = std::slice::from_ref(shape);
                comparison.add_alike(kind, shape, itself, |_| 1.0, &mut own);
                own
            });
            let own: Vec<Vec<f32>> = own.collect();
            // Normalised, so that kinds count by their weights regardless of their size.
            for q in 0..places {
                let mean = own.iter().map(|own| own[q]).sum::<f32>() / count as f32;
                scale[q][kind] = KIND_WEIGHTS[kind] as f32 / mean.max(1e-20);
                for (s, own) in own.iter().enumerate() {
                    square[q * count + s] += scale[q][kind] * own[q];
                }
            }
        }
        let size = square.into_iter().map(|k| k.max(0.0).sqrt()).collect();
        Self {
            comparison,
            learned,
            mirror,
            adds,
            scale,
            size,
        }
    }

    /// The sharpened comparison of a motion with every learned shape, per place and shape.
    pub(super) fn compared(&self, one: &Motion) -> Vec<f32> {
        let count = self.learned.len();
        let mut k = self.comparison.alike(one, &self.learned, &self.scale);
        let itself = std::slice::from_ref(one);
        let own = self.comparison.alike(one, itself, &self.scale);
        for (q, own) in own.into_iter().enumerate() {
            let own = own.max(0.0).sqrt();
            for s in 0..count {
                let k = &mut k[q * count + s];
                let cos = *k / (own * self.size[q * count + s]).max(1e-20);
                *k *= cos.min(1.0).powi(SHARPENING);
            }
        }
        k
    }

    /// Residual of the solve at every place.
    pub(super) fn residual(&self, controls: Vec<Vec3>, skin: Vec<Vec3>) -> Vec<Vec3> {
        let k = self.compared(&self.comparison.motion(controls, skin));
        let count = self.learned.len();
        let rows = k.chunks(count).zip(self.adds.chunks(count));
        let added = |(k, add): (&f32, &Vec3)| add * f64::from(*k);
        rows.map(|(k, adds)| k.iter().zip(adds).map(added).sum())
            .collect()
    }

    /// The prior in the program.
    ///
    /// # Panics
    /// If the program was built with a damaged file, which a test rules out.
    pub fn shipped() -> &'static Self {
        static PARSED: LazyLock<Prior> =
            LazyLock::new(|| Prior::parse(SHIPPED).expect("the built-in file is whole"));
        &PARSED
    }

    /// The bytes of the file: little-endian, motions as 16-bit fractions of the largest of their shape.
    pub fn emit(&self) -> Vec<u8> {
        let places = &self.comparison.places;
        let half = places.iter().take_while(|p| p.at.x >= 0.0).count();
        let count = self.learned.len();
        let mut out = MAGIC.to_vec();
        for n in [half, count] {
            out.extend((n as u32).to_le_bytes());
        }
        out.extend(&self.mirror);
        let of_places = places[..half].iter().flat_map(|p| [p.at, p.normal]);
        for v in self.comparison.landmarks.iter().copied().chain(of_places) {
            out.extend(v.iter().flat_map(|x| (*x as f32).to_le_bytes()));
        }
        for s in 0..count {
            let adds: Vec<Vec3> = (0..half).map(|q| self.adds[q * count + s]).collect();
            let [controls, skin, _] = &self.learned[s].0;
            for block in [&controls[..], &skin[..half], &adds] {
                let most = block.iter().map(Vec3::amax).fold(1e-9, f64::max);
                let step = (most / f64::from(i16::MAX)) as f32;
                out.extend(step.to_le_bytes());
                let part = |x: &f64| ((x / f64::from(step)).round() as i16).to_le_bytes();
                out.extend(block.iter().flat_map(|v| v.iter()).flat_map(part));
            }
        }
        out
    }

    /// Parses the bytes of [`Prior::emit`]; `None` if they are damaged.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let mut rest = Rest(bytes.strip_prefix(MAGIC)?);
        let [half, count] = [rest.number()?, rest.number()?];
        if !(1..=4096).contains(&half) || !(1..=255).contains(&count) {
            return None;
        }
        let mirror = rest.take(count)?.to_vec();
        if mirror.iter().any(|&m| usize::from(m) >= count) {
            return None;
        }
        let landmarks = rest.singles(LANDMARKS)?;
        let places = rest.singles(2 * half)?;
        let pairs = places.as_chunks::<2>().0.iter();
        let mut places: Vec<SkinPoint> = pairs
            .map(|&[at, normal]| SkinPoint { at, normal })
            .collect();
        let mut block = || Some([rest.block(LANDMARKS)?, rest.block(half)?, rest.block(half)?]);
        let blocks: Vec<[Vec<Vec3>; 3]> = (0..count).map(|_| block()).collect::<Option<_>>()?;
        if !rest.0.is_empty() {
            return None;
        }
        // Places of the left half come first, then the mirror images of those off the middle.
        let twice: Vec<usize> = (0..half).filter(|&q| places[q].at.x != 0.0).collect();
        let right: Vec<SkinPoint> = twice.iter().map(|&q| places[q].mirrored()).collect();
        places.extend(right);
        let comparison = Comparison::new(landmarks, places);
        let whole = |s: usize, kind: usize| {
            let other = &blocks[usize::from(mirror[s])][kind];
            let right = twice.iter().map(|&q| flipped(&other[q]));
            let left = blocks[s][kind].iter().copied();
            left.chain(right).collect::<Vec<_>>()
        };
        let learned = (0..count)
            .map(|s| comparison.motion(blocks[s][0].clone(), whole(s, 1)))
            .collect();
        let adds: Vec<Vec<Vec3>> = (0..count).map(|s| whole(s, 2)).collect();
        let at = |q: usize| adds.iter().map(move |adds| adds[q]);
        let adds = (0..comparison.places.len()).flat_map(at).collect();
        Some(Self::new(comparison, learned, mirror, adds))
    }
}

/// Unread bytes of a file.
struct Rest<'a>(&'a [u8]);

impl<'a> Rest<'a> {
    fn take(&mut self, bytes: usize) -> Option<&'a [u8]> {
        self.0.split_off(..bytes)
    }

    fn number(&mut self) -> Option<usize> {
        Some(u32::from_le_bytes(*self.take(4)?.first_chunk()?) as usize)
    }

    fn singles(&mut self, vectors: usize) -> Option<Vec<Vec3>> {
        let numbers = self.take(vectors * 12)?.as_chunks().0.iter();
        let single = |b: &[u8; 4]| f64::from(f32::from_le_bytes(*b));
        Some(in_threes(numbers.map(single)))
    }

    /// Vectors as multiples of a step that precedes them.
    fn block(&mut self, vectors: usize) -> Option<Vec<Vec3>> {
        let step = f64::from(f32::from_le_bytes(*self.take(4)?.first_chunk()?));
        let parts = self.take(vectors * 6)?.as_chunks().0.iter();
        let part = |b: &[u8; 2]| f64::from(i16::from_le_bytes(*b)) * step;
        Some(in_threes(parts.map(part)))
    }
}

fn in_threes(numbers: impl Iterator<Item = f64>) -> Vec<Vec3> {
    let numbers: Vec<f64> = numbers.collect();
    let threes = numbers.as_chunks::<3>().0.iter();
    threes.map(|&v| Vec3::from(v)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::names::mirrored;
    use super::*;

    #[test]
    fn the_shipped_file_survives_being_written_and_a_damaged_one_is_refused() {
        let prior = Prior::parse(SHIPPED).unwrap();
        assert!(Prior::parse(&prior.emit()).is_some());
        for cut in [0, 7, 12, 40, 900, SHIPPED.len() - 1] {
            assert!(Prior::parse(&SHIPPED[..cut]).is_none());
        }
        let mut longer = SHIPPED.to_vec();
        longer.push(0);
        assert!(Prior::parse(&longer).is_none());
    }

    #[test]
    fn twice_the_motion_gives_twice_the_answer_and_the_opposite_its_opposite() {
        let prior = Prior::shipped();
        let motion = |s: usize, k: f64| {
            let [controls, skin, _] = &prior.learned[s].0;
            let scaled = |d: &Vec<Vec3>| d.iter().map(|d| d * k).collect::<Vec<_>>();
            prior.residual(scaled(controls), scaled(skin))
        };
        let (one, two, back) = (motion(3, 0.1), motion(3, 0.2), motion(3, -0.1));
        let most = one.iter().map(Vec3::norm).fold(0.0, f64::max);
        assert!(most > 0.0);
        for ((one, two), back) in one.iter().zip(&two).zip(&back) {
            assert!((two - one * 2.0).norm() < 1e-4 * most);
            assert!((back + one).norm() < 1e-4 * most);
        }
    }

    #[test]
    fn the_other_side_moves_as_in_a_mirror() {
        let prior = Prior::shipped();
        let s = (0..prior.mirror.len())
            .find(|&s| usize::from(prior.mirror[s]) != s)
            .unwrap();
        let half = prior
            .comparison
            .places
            .iter()
            .take_while(|p| p.at.x >= 0.0)
            .count();
        let [controls, skin, _] = prior.learned[s].0.clone();
        let partner = prior.learned[usize::from(prior.mirror[s])].0[1].clone();
        let mirror = (0..LANDMARKS)
            .map(|k| flipped(&controls[mirrored(k)]))
            .collect();
        let here = prior.residual(controls, skin);
        let there = prior.residual(mirror, partner);
        let most = here.iter().map(Vec3::norm).fold(0.0, f64::max);
        let twice: Vec<usize> = (0..half)
            .filter(|&q| prior.comparison.places[q].at.x != 0.0)
            .collect();
        for (k, &q) in twice.iter().enumerate() {
            assert!((flipped(&here[q]) - there[half + k]).norm() < 0.05 * most);
        }
    }
}
