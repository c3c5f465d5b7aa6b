//! The data of the 3D active appearance model, and its bytes in the model file.
//!
//! ```text
//! magic "PAM2" · counts u16: appearance modes m, head modes k, triangles, pixels
//! f32: mean head 204 · k deviations · k x 204 modes · base shape 136 · noise · residual middle, width · m deviations
//! u8 triangles 3 each · per row (trust, mean appearance, m modes): f32 unit, i8 values
//! ```
//! Little endian. Everything is validated: counts, finiteness, indices, and that the pixels match the shape.

use super::warp::{BasePixel, Shape2, base_pixels};
use crate::base::capacity::LANDMARKS;
use crate::base::geometry::{Point, Vector};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Most appearance modes.
pub const MOST_APPEARANCE_MODES: usize = 96;
/// Most shape modes.
pub const MOST_HEAD_MODES: usize = 40;

/// The model; metres, window pixels, normalised grey values.
#[derive(Clone, Debug)]
pub struct PaperAam {
    /// Base shape S0, head frame, metres; its projection is s0 of equation (1).
    pub head: Vec<Point>,
    /// Shape bases S_i, orthonormal; their projections are s_i of equation (1), so that p_i is the same for both.
    pub head_modes: Vec<Vec<Vector>>,
    /// Their standard deviations, metres.
    pub head_deviations: Vec<f32>,
    /// Where appearance is compared: the base shape from the front with its lips parted, window pixels.
    pub base: Shape2,
    /// Its triangles.
    pub triangles: Vec<[u8; 3]>,
    /// Weight of each pixel: the inverse of the residual deviation there, scaled to mean square 1.
    pub trust: Vec<f32>,
    /// Mean appearance A0 (equation 2), of zero mean and unit variance before trust.
    pub appearance: Vec<f32>,
    /// Appearance modes A_i, near orthonormal, times trust.
    pub appearance_modes: Vec<Vec<f32>>,
    /// Their standard deviations.
    pub appearance_deviations: Vec<f32>,
    /// Residual variance per pixel.
    pub noise: f32,
    /// Residual at which the confidence is 0.5, and the width of the transition.
    pub belief: [f32; 2],
    /// Pixels of the base shape; not stored, they follow from it and the triangles.
    pub pixels: Vec<BasePixel>,
}

/// Why the bytes are not a valid model.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum PaperAamError {
    /// Another beginning.
    #[error(
        "expected the paper's appearance model (PAM2), found other bytes; train the model again"
    )]
    Magic,
    /// Too short or too long.
    #[error(
        "the paper's appearance model: expected {expected} bytes more, found {found}; train the model again"
    )]
    Length {
        /// Bytes wanted.
        expected: usize,
        /// Bytes there.
        found: usize,
    },
    /// An invalid number.
    #[error(
        "the paper's appearance model: {what} is {found}, expected {expected}; train the model again"
    )]
    Value {
        /// What it is.
        what: &'static str,
        /// What is there.
        found: f64,
        /// What should be there.
        expected: &'static str,
    },
}

struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take(&mut self, count: usize) -> Result<&[u8], PaperAamError> {
        let found = self.0.len();
        let (head, tail) = self
            .0
            .split_at_checked(count)
            .ok_or(PaperAamError::Length {
                expected: count,
                found,
            })?;
        self.0 = tail;
        Ok(head)
    }

    fn count(
        &mut self,
        what: &'static str,
        least: usize,
        most: usize,
    ) -> Result<usize, PaperAamError> {
        let bytes = self.take(2)?;
        let found = usize::from(u16::from_le_bytes([bytes[0], bytes[1]]));
        if (least..=most).contains(&found) {
            Ok(found)
        } else {
            Err(PaperAamError::Value {
                what,
                found: found as f64,
                expected: "within the model's limits",
            })
        }
    }

    fn floats(
        &mut self,
        count: usize,
        what: &'static str,
        most: f32,
    ) -> Result<Vec<f32>, PaperAamError> {
        let bytes = self.take(4 * count)?;
        let values: Vec<f32> = bytes
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        match values.iter().find(|v| !v.is_finite() || v.abs() > most) {
            Some(bad) => Err(PaperAamError::Value {
                what,
                found: f64::from(*bad),
                expected: "a moderate finite number",
            }),
            None => Ok(values),
        }
    }

    fn positive(&mut self, count: usize, what: &'static str) -> Result<Vec<f32>, PaperAamError> {
        let values = self.floats(count, what, 1e6)?;
        match values.iter().find(|v| **v <= 0.0) {
            Some(bad) => Err(PaperAamError::Value {
                what,
                found: f64::from(*bad),
                expected: "above 0",
            }),
            None => Ok(values),
        }
    }
}

fn shape2(values: &[f32]) -> Shape2 {
    core::array::from_fn(|i| [values[2 * i], values[2 * i + 1]])
}

impl PaperAam {
    /// Reads the bytes of [`PaperAam::to_bytes`].
    ///
    /// # Errors
    /// If the bytes are not exactly such a model.
    pub fn parse(bytes: &[u8]) -> Result<Self, PaperAamError> {
        let mut from = Reader(bytes);
        if from.take(4)? != b"PAM2" {
            return Err(PaperAamError::Magic);
        }
        let m = from.count("number of appearance modes", 0, MOST_APPEARANCE_MODES)?;
        let k = from.count("number of head modes", 0, MOST_HEAD_MODES)?;
        let triangle_count = from.count("number of triangles", 1, 2 * LANDMARKS)?;
        let pixel_count = from.count("number of pixels", 100, 20_000)?;
        let points = |v: &[f32]| {
            v.chunks_exact(3)
                .map(|p| Point::new(p[0], p[1], p[2]))
                .collect::<Vec<_>>()
        };
        let head = points(&from.floats(3 * LANDMARKS, "a point of the mean head", 10.0)?);
        let head_deviations = from.positive(k, "a deviation of a head mode")?;
        let mut head_modes = Vec::with_capacity(k);
        for _ in 0..k {
            let mode = from.floats(3 * LANDMARKS, "a head mode", 2.0)?;
            head_modes.push(points(&mode).iter().map(|p| p.coords).collect());
        }
        let base = shape2(&from.floats(2 * LANDMARKS, "a point of the base shape", 1e4)?);
        let noise = from.positive(1, "the appearance noise")?[0];
        let belief = from.positive(2, "the belief")?;
        let belief = [belief[0], belief[1]];
        let appearance_deviations = from.positive(m, "a deviation of an appearance mode")?;
        let triangles: Vec<[u8; 3]> = from
            .take(3 * triangle_count)?
            .chunks_exact(3)
            .map(|t| [t[0], t[1], t[2]])
            .collect();
        if let Some(bad) = triangles
            .iter()
            .flatten()
            .find(|v| usize::from(**v) >= LANDMARKS)
        {
            let found = f64::from(*bad);
            return Err(PaperAamError::Value {
                what: "a corner",
                found,
                expected: "0 to 67",
            });
        }
        let mut row = || -> Result<Vec<f32>, PaperAamError> {
            let unit = from.positive(1, "the unit of an appearance mode")?[0];
            let values = from.take(pixel_count)?;
            Ok(values.iter().map(|v| f32::from(*v as i8) * unit).collect())
        };
        let (trust, appearance) = (row()?, row()?);
        let appearance_modes = (0..m).map(|_| row()).collect::<Result<Vec<_>, _>>()?;
        if !from.0.is_empty() {
            return Err(PaperAamError::Length {
                expected: 0,
                found: from.0.len(),
            });
        }
        let pixels = base_pixels(&base, &triangles);
        if pixels.len() != pixel_count {
            let found = pixels.len() as f64;
            return Err(PaperAamError::Value {
                what: "number of pixels inside the shape",
                found,
                expected: "as stored",
            });
        }
        Ok(Self {
            head,
            head_modes,
            head_deviations,
            base,
            triangles,
            trust,
            appearance,
            appearance_modes,
            appearance_deviations,
            noise,
            belief,
            pixels,
        })
    }

    /// The model as bytes; see the module header. Appearance is rounded to 8 bits.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = b"PAM2".to_vec();
        let counts = [
            self.appearance_modes.len(),
            self.head_modes.len(),
            self.triangles.len(),
            self.pixels.len(),
        ];
        counts
            .iter()
            .for_each(|c| out.extend((*c as u16).to_le_bytes()));
        let mut floats: Vec<f32> = self.head.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
        floats.extend(&self.head_deviations);
        floats.extend(
            self.head_modes
                .iter()
                .flatten()
                .flat_map(|v| [v.x, v.y, v.z]),
        );
        floats.extend(self.base.iter().flatten());
        floats.push(self.noise);
        floats.extend(self.belief);
        floats.extend(&self.appearance_deviations);
        floats.iter().for_each(|v| out.extend(v.to_le_bytes()));
        out.extend(self.triangles.iter().flatten());
        for row in [&self.trust, &self.appearance]
            .into_iter()
            .chain(&self.appearance_modes)
        {
            let largest = row.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
            let unit = (largest / 127.0).max(f32::MIN_POSITIVE);
            out.extend(unit.to_le_bytes());
            out.extend(row.iter().map(|v| (v / unit).round() as i8 as u8));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::face_model::FaceModel;

    #[test]
    fn the_shipped_block_reads_back_and_a_cut_or_spoilt_one_is_refused() {
        let bytes = FaceModel::shipped().paper_aam;
        let model = PaperAam::parse(&bytes).unwrap();
        assert_eq!(model.to_bytes(), bytes.as_ref());
        for cut in [0, 3, 4, 20, bytes.len() - 1] {
            assert!(PaperAam::parse(&bytes[..cut]).is_err());
        }
        let mut other = bytes.to_vec();
        other[3] = b'1';
        assert_eq!(PaperAam::parse(&other).unwrap_err(), PaperAamError::Magic);
        // The first deviation of a shape mode.
        let at = 4 + 8 + 4 * 3 * LANDMARKS;
        let mut other = bytes.to_vec();
        other[at..at + 4].copy_from_slice(&(-1.0_f32).to_le_bytes());
        let message = PaperAam::parse(&other).unwrap_err().to_string();
        assert!(message.contains("a deviation of a head mode is -1, expected above 0"));
    }

    #[test]
    fn shape_bases_are_orthonormal() {
        let model = PaperAam::parse(&FaceModel::shipped().paper_aam).unwrap();
        for (k, mode) in model.head_modes.iter().enumerate() {
            for (l, other) in model.head_modes.iter().enumerate() {
                let product: f32 = mode.iter().zip(other).map(|(a, b)| a.dot(b)).sum();
                let expected = f32::from(u8::from(k == l));
                assert!((product - expected).abs() < 1e-3, "modes {k}, {l}");
            }
        }
    }
}
