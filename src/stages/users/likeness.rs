//! Features for re-identification: surface and size of the head, and lengths of the face.
//!
//! Computes the distance between two people from three independent measurements: the head's surface and size from depth
//! ([`crate::pose::signature`]), and [`LENGTHS`] lengths between eyes, brows, nose and jaw from the landmarks, each a mean
//! over the frames in which the face was seen. Each difference is divided by its usual spread between two sessions of the same
//! person, measured after ten frames on rendered heads of people used in no other table; the mean square is weighted by the
//! independent information of each. The distance is about 0.8 for the same person and 2.3 for another one. A face cannot be
//! reconstructed from these numbers.
//!
//! Metres. Memory: 48 bytes beside the signature. Cost: a few distances a frame. Degenerate: heads of which too little was seen
//! cannot be compared; without a face the head alone decides. Limitation: hats, glasses and thick hair change it; siblings
//! may share it.

use crate::base::capacity::LANDMARKS;
use crate::base::geometry::Point;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::pose::signature::{Difference, Signature, read_word, write_word};

/// Number of lengths of a face.
pub const LENGTHS: usize = 11;
/// Standard deviation of each length within one person, metres.
const SIGMA_M: [f32; LENGTHS] = [
    0.0009, 0.0017, 0.0007, 0.0005, 0.0006, 0.0007, 0.0007, 0.0009, 0.0014, 0.0007, 0.0027,
];
/// Weights in the mean square: of the surface, of the size, and of each length.
const WEIGHTS: [f32; 3] = [8.0, 2.0, 0.5];
/// Standard deviation of ln(size) within one person.
const SIZE_SIGMA: f32 = 0.02;
/// Length of a running mean, frames.
const MEMORY_FRAMES: f32 = 150.0;
/// Largest plausible length, metres.
const MAX_LENGTH_M: f32 = 0.5;

/// Mean lengths of one face; none before the first frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FaceLengths {
    mean: [f32; LENGTHS],
    frames: f32,
}

impl FaceLengths {
    /// Adds the landmarks of one frame, head frame, metres.
    pub fn add(&mut self, head: &[Point; LANDMARKS]) {
        self.frames = (self.frames + 1.0).min(MEMORY_FRAMES);
        for (mean, length) in self.mean.iter_mut().zip(lengths(head)) {
            *mean += (length - *mean) / self.frames;
        }
    }
}

/// Lengths, metres: between the inner and between the outer eye corners, mean width of an eye, depth of the outer eye corners; length
/// of the nose and of its ridge, height and depth of its base, depth of its root; height of the brows; width of the jaw.
fn lengths(head: &[Point; LANDMARKS]) -> [f32; LENGTHS] {
    let apart = |a: usize, b: usize| (head[a] - head[b]).norm();
    let between = |a: usize, b: usize| nalgebra::center(&head[a], &head[b]);
    let (outer, inner) = (between(36, 45), between(39, 42));
    let eyes = nalgebra::center(&outer, &inner);
    let base = head[33] - eyes;
    [
        apart(39, 42),
        apart(36, 45),
        (apart(36, 39) + apart(42, 45)) / 2.0,
        outer.z - inner.z,
        apart(27, 33),
        apart(27, 30),
        base.y,
        base.z,
        head[27].z - eyes.z,
        between(19, 24).y - eyes.y,
        apart(2, 14),
    ]
}

/// Re-identification features of one person.
#[derive(Clone, Debug, PartialEq)]
pub struct Likeness {
    /// Surface and size of the head.
    pub head: Signature,
    /// Mean lengths of the face.
    pub face: FaceLengths,
}

impl Likeness {
    /// Distance of two people, in standard deviations within one person; `heads`: difference of their heads.
    pub fn distance(&self, other: &Self, heads: Difference) -> f32 {
        let [surface, size, length] = WEIGHTS;
        let mut sum = surface * heads.surface + size * (heads.log_size / SIZE_SIGMA).powi(2);
        let mut weight = surface + size;
        if self.face.frames > 0.0 && other.face.frames > 0.0 {
            let pairs = self.face.mean.iter().zip(&other.face.mean);
            for ((one, other), sigma) in pairs.zip(SIGMA_M) {
                sum += length * ((one - other) / sigma).powi(2);
                weight += length;
            }
        }
        (sum / weight).sqrt()
    }

    /// Writes the numbers as words, each after a space; `-` for unseen ones.
    ///
    /// # Errors
    /// If the writer fails.
    pub fn write(&self, text: &mut impl core::fmt::Write) -> core::fmt::Result {
        self.head.write(text)?;
        let seen = |&mean: &f32| (self.face.frames > 0.0).then_some(mean);
        (self.face.mean.iter()).try_for_each(|mean| write_word(seen(mean), text))
    }

    /// Reads exactly the words of [`Self::write`]; `None` if there are too few or too many, or one is implausible.
    pub fn read<'a>(mut words: impl Iterator<Item = &'a str>) -> Option<Self> {
        let head = Signature::read(&mut words)?;
        let mut face = FaceLengths::default();
        for mean in &mut face.mean {
            if let Some(length) = read_word(words.next()?, MAX_LENGTH_M)? {
                // A saved mean counts as a full one.
                (*mean, face.frames) = (length, MEMORY_FRAMES);
            }
        }
        words.next().is_none().then_some(Self { head, face })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::face_model::FaceModel;

    fn face(size: f32) -> FaceLengths {
        let mean = FaceModel::shipped().shape.mean;
        let mut face = FaceLengths::default();
        face.add(&core::array::from_fn(|i| mean[i] * size));
        face
    }

    fn nothing_seen() -> Signature {
        let mut words = core::iter::once("0").chain(core::iter::repeat("-"));
        Signature::read(&mut words).expect("a head of which nothing was seen")
    }

    #[test]
    fn a_face_of_another_size_is_farther_than_the_same_one() {
        let alike = Difference {
            surface: 0.5,
            log_size: 0.0,
        };
        let person = |size| Likeness {
            head: nothing_seen(),
            face: face(size),
        };
        let same = person(1.0).distance(&person(1.0), alike);
        let other = person(1.0).distance(&person(1.06), alike);
        assert!(same < 0.6 && other > 1.2 * same, "{same} {other}");
        let unlike = Difference {
            surface: 9.0,
            log_size: 0.03,
        };
        assert!(person(1.0).distance(&person(1.0), unlike) > 2.0);
    }

    #[test]
    fn reads_exactly_the_written_words() {
        let person = Likeness {
            head: nothing_seen(),
            face: face(1.1),
        };
        let mut text = String::new();
        person.write(&mut text).expect("a String takes everything");
        let mut again = String::new();
        let read = Likeness::read(text.split_ascii_whitespace()).expect("just written");
        read.write(&mut again).expect("a String takes everything");
        assert_eq!(text, again);
        assert!(Likeness::read(format!("{text} 1").split_ascii_whitespace()).is_none());
        let (short, _) = text.rsplit_once(' ').expect("words");
        assert!(Likeness::read(short.split_ascii_whitespace()).is_none());
        assert!(Likeness::read(format!("{short} 7").split_ascii_whitespace()).is_none());
        assert!(Likeness::read(format!("{short} NaN").split_ascii_whitespace()).is_none());
    }

    #[test]
    fn lengths_and_distances_are_as_specified() {
        let mut head = [Point::origin(); LANDMARKS];
        for (i, x, y, z) in [
            (36, -0.05, 0.0, 0.02),
            (39, -0.02, 0.0, 0.0),
            (42, 0.02, 0.0, 0.0),
            (45, 0.05, 0.0, 0.02),
            (27, 0.0, 0.0, -0.01),
            (30, 0.0, 0.03, -0.01),
            (33, 0.0, 0.04, 0.0),
            (19, -0.04, -0.02, 0.0),
            (24, 0.04, -0.02, 0.0),
            (2, -0.07, 0.0, 0.05),
            (14, 0.07, 0.0, 0.05),
        ] {
            head[i] = Point::new(x, y, z);
        }
        let eye = f32::hypot(0.03, 0.02);
        let ridge = f32::hypot(0.04, 0.01);
        let expected = [
            0.04, 0.1, eye, 0.02, ridge, 0.03, 0.04, -0.01, -0.02, -0.02, 0.14,
        ];
        for (k, (found, expected)) in lengths(&head).into_iter().zip(expected).enumerate() {
            assert!((found - expected).abs() < 1e-6, "length {k}: {found}");
        }
        // A mean of two frames, then of many.
        let mut face = FaceLengths::default();
        face.add(&head);
        face.add(&head.map(|p| p * 1.5));
        assert!((face.mean[1] - 0.125).abs() < 1e-6 && face.frames == 2.0);
        for _ in 0..400 {
            face.add(&head);
        }
        assert!(face.frames == 150.0 && (face.mean[1] - 0.1).abs() < 2e-3);
        // One spread of the size, one of the first length, and a surface of one: the root of the weighted mean.
        let person = |first: f32| {
            let mut face = face;
            face.mean[0] += first;
            Likeness {
                head: nothing_seen(),
                face,
            }
        };
        let heads = Difference {
            surface: 1.0,
            log_size: -0.02,
        };
        let found = person(0.0).distance(&person(SIGMA_M[0]), heads);
        assert!((found - f32::sqrt((8.0 + 2.0 + 0.5) / (10.0 + 5.5))).abs() < 1e-4);
        let unseen = Likeness {
            head: nothing_seen(),
            face: FaceLengths::default(),
        };
        assert!((person(0.0).distance(&unseen, heads) - 1.0).abs() < 1e-6);
    }
}
