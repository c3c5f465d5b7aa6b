//! What the 3D active appearance model knows, and its bytes in the model file.
//!
//! ```text
//! magic "PAM1" · counts u16: shape modes n, appearance modes m, head modes k, triangles, pixels
//! f32: mean 2D shape 136 · n deviations · n x 136 modes · m deviations · noise · residual middle, width
//!      mean head 204 · k deviations · k x 204 modes · appearance mean (pixels)
//! u8 triangles 3 each · per appearance mode: f32 unit, i8 values
//! ```
//! Little endian. Everything is checked: counts, finiteness, indices, and that the pixels are those the shape gives.

use super::warp::{BasePixel, Shape2, base_pixels};
use crate::capacity::LANDMARKS;
use crate::geometry::{Point, Vector};
#[cfg(not(feature = "std"))]
use crate::prelude::*;

/// Most 2D shape modes.
pub const MOST_SHAPE_MODES: usize = 32;
/// Most appearance modes.
pub const MOST_APPEARANCE_MODES: usize = 64;
/// Most 3D shape modes.
pub const MOST_HEAD_MODES: usize = 24;

/// The model; window pixels, normalised grey values, metres.
#[derive(Clone, Debug)]
pub struct PaperAam {
    /// Mean 2D shape s0 (equation 1), window pixels.
    pub mean: Shape2,
    /// 2D shape modes s_i, orthonormal, free of similarities.
    pub modes: Vec<Shape2>,
    /// Their standard deviations, window pixels.
    pub deviations: Vec<f32>,
    /// Triangles of the mean.
    pub triangles: Vec<[u8; 3]>,
    /// Mean appearance A0 (equation 2), zero mean and unit variance.
    pub appearance: Vec<f32>,
    /// Appearance modes A_i, near orthonormal.
    pub appearance_modes: Vec<Vec<f32>>,
    /// Their standard deviations.
    pub appearance_deviations: Vec<f32>,
    /// Variance per pixel that the modes leave.
    pub noise: f32,
    /// Residual at which a fit is believed by half, and the step from doubt to belief.
    pub belief: [f32; 2],
    /// Mean 3D shape, head frame, metres.
    pub head: Vec<Point>,
    /// 3D shape bases, orthonormal.
    pub head_modes: Vec<Vec<Vector>>,
    /// Their standard deviations, metres.
    pub head_deviations: Vec<f32>,
    /// Pixels of the mean shape; not stored, they follow from mean and triangles.
    pub pixels: Vec<BasePixel>,
}

/// Why the bytes are no model.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum PaperAamError {
    /// Another beginning.
    #[error(
        "expected the paper's appearance model (PAM1), found other bytes; train the model again"
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
    /// A number that cannot be.
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
    /// Anything that is not exactly such a model.
    pub fn parse(bytes: &[u8]) -> Result<Self, PaperAamError> {
        let mut from = Reader(bytes);
        if from.take(4)? != b"PAM1" {
            return Err(PaperAamError::Magic);
        }
        let n = from.count("number of shape modes", 0, MOST_SHAPE_MODES)?;
        let m = from.count("number of appearance modes", 0, MOST_APPEARANCE_MODES)?;
        let k = from.count("number of head modes", 0, MOST_HEAD_MODES)?;
        let triangle_count = from.count("number of triangles", 1, 2 * LANDMARKS)?;
        let pixel_count = from.count("number of pixels", 100, 20_000)?;
        let mean = shape2(&from.floats(2 * LANDMARKS, "a point of the mean shape", 1e4)?);
        let deviations = from.positive(n, "a deviation of a shape mode")?;
        let mut modes = Vec::with_capacity(n);
        for _ in 0..n {
            modes.push(shape2(&from.floats(2 * LANDMARKS, "a shape mode", 2.0)?));
        }
        let appearance_deviations = from.positive(m, "a deviation of an appearance mode")?;
        let noise = from.positive(1, "the appearance noise")?[0];
        let belief = from.positive(2, "the belief")?;
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
        let appearance = from.floats(pixel_count, "the mean appearance", 100.0)?;
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
        let mut appearance_modes = Vec::with_capacity(m);
        for _ in 0..m {
            let unit = from.positive(1, "the unit of an appearance mode")?[0];
            let values = from.take(pixel_count)?;
            appearance_modes.push(values.iter().map(|v| f32::from(*v as i8) * unit).collect());
        }
        if !from.0.is_empty() {
            return Err(PaperAamError::Length {
                expected: 0,
                found: from.0.len(),
            });
        }
        let pixels = base_pixels(&mean, &triangles);
        if pixels.len() != pixel_count {
            let found = pixels.len() as f64;
            return Err(PaperAamError::Value {
                what: "number of pixels inside the shape",
                found,
                expected: "as stored",
            });
        }
        let belief = [belief[0], belief[1]];
        Ok(Self {
            mean,
            modes,
            deviations,
            triangles,
            appearance,
            appearance_modes,
            appearance_deviations,
            noise,
            belief,
            head,
            head_modes,
            head_deviations,
            pixels,
        })
    }

    /// The model as bytes; see the module header. Appearance modes are rounded to 8 bits.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = b"PAM1".to_vec();
        let counts = [
            self.modes.len(),
            self.appearance_modes.len(),
            self.head_modes.len(),
            self.triangles.len(),
            self.pixels.len(),
        ];
        counts
            .iter()
            .for_each(|c| out.extend((*c as u16).to_le_bytes()));
        let mut floats: Vec<f32> = self.mean.iter().flatten().copied().collect();
        floats.extend(&self.deviations);
        floats.extend(self.modes.iter().flatten().flatten());
        floats.extend(&self.appearance_deviations);
        floats.push(self.noise);
        floats.extend(self.belief);
        floats.extend(self.head.iter().flat_map(|p| [p.x, p.y, p.z]));
        floats.extend(&self.head_deviations);
        floats.extend(
            self.head_modes
                .iter()
                .flatten()
                .flat_map(|v| [v.x, v.y, v.z]),
        );
        floats.extend(&self.appearance);
        floats.iter().for_each(|v| out.extend(v.to_le_bytes()));
        out.extend(self.triangles.iter().flatten());
        for mode in &self.appearance_modes {
            let largest = mode.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
            let unit = (largest / 127.0).max(f32::MIN_POSITIVE);
            out.extend(unit.to_le_bytes());
            out.extend(mode.iter().map(|v| (v / unit).round() as i8 as u8));
        }
        out
    }
}
