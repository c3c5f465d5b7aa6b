//! The data of the 3D active appearance model, and its bytes in the model file.
//!
//! ```text
//! magic "PAM2" · counts u16: appearance modes m, head modes k, triangles, pixels
//! f32: mean head 204 · k deviations · k x 204 modes · base shape 136 · noise · residual middle, width · m deviations
//! u8 triangles 3 each · per row (trust, mean appearance, m modes): f32 unit, i8 values
//! ```
//! Little-endian. Everything is validated: counts, finiteness, indices, and that the pixels match the shape.

use super::warp::{BasePixel, Shape2, base_pixels};
use crate::base::capacity::LANDMARKS;
use crate::base::geometry::{Point, Vector};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::face_model::ModelError;
use crate::face_model::reader::{Reader, vectors};

/// Most appearance modes.
pub const MOST_APPEARANCE_MODES: usize = 96;
/// Most shape modes.
pub const MOST_HEAD_MODES: usize = 40;

/// The model; metres, window pixels, normalised grey values.
#[derive(Clone, Debug)]
pub struct PaperAam {
    /// Base shape S0, head frame, metres; its projection is s0 of equation (1).
    pub head: Vec<Point>,
    /// Shape bases S_i, orthonormal; their projections are s_i of equation (1), so both share p_i.
    pub head_modes: Vec<Vec<Vector>>,
    /// Standard deviations of the shape bases, metres.
    pub head_deviations: Vec<f32>,
    /// Base shape for appearance, frontal with parted lips, window pixels.
    pub base: Shape2,
    /// Triangles of `base`, by landmark.
    pub triangles: Vec<[u8; 3]>,
    /// Weight of each pixel: the inverse of its residual deviation, scaled to mean square 1.
    pub trust: Vec<f32>,
    /// Mean appearance A0 (equation 2), of zero mean and unit variance before trust.
    pub appearance: Vec<f32>,
    /// Appearance modes A_i, near orthonormal, times trust.
    pub appearance_modes: Vec<Vec<f32>>,
    /// Standard deviations of the appearance modes.
    pub appearance_deviations: Vec<f32>,
    /// Residual variance per pixel.
    pub noise: f32,
    /// Residual at which the confidence is 0.5, and the width of the transition.
    pub confidence_curve: [f32; 2],
    /// Pixels of the base shape, derived from it and the triangles.
    pub pixels: Vec<BasePixel>,
}

impl PaperAam {
    /// Reads the bytes of [`PaperAam::to_bytes`].
    ///
    /// # Errors
    /// If the bytes are too few, too many, or any value is invalid.
    pub fn parse(bytes: &[u8]) -> Result<Self, ModelError> {
        let section = "PAAM";
        let mut from = Reader { section, bytes };
        if from.take(4)? != b"PAM2" {
            return Err(from.malformed("PAM2 as first bytes", 0.0));
        }
        let m = from.count(2, 0..=MOST_APPEARANCE_MODES, "at most 96 appearance modes")?;
        let k = from.count(2, 0..=MOST_HEAD_MODES, "at most 40 head modes")?;
        let triangles = from.count(2, 1..=2 * LANDMARKS, "1 to 136 triangles")?;
        let pixels = from.count(2, 100..=20_000, "100 to 20000 pixels")?;
        let head = from.floats_within(3 * LANDMARKS, 10.0, "a mean head within 10 m")?;
        let head_deviations = from.positive(k, "deviations of head modes above 0")?;
        let head_modes = from.floats_within(k * 3 * LANDMARKS, 2.0, "head modes within 2")?;
        let base = from.floats_within(2 * LANDMARKS, 1e4, "a base shape within 10000 px")?;
        let noise = from.positive(1, "appearance noise above 0")?[0];
        let confidence_curve = from.positive(2, "a belief above 0")?;
        let appearance_deviations = from.positive(m, "deviations of appearance above 0")?;
        let triangles = from.take(3 * triangles)?.as_chunks::<3>().0.to_vec();
        let corners = triangles.iter().flatten();
        if let Some(bad) = corners.copied().find(|v| usize::from(*v) >= LANDMARKS) {
            return Err(from.malformed("corners of triangles from 0 to 67", bad.into()));
        }
        let mut row = || -> Result<Vec<f32>, ModelError> {
            let unit = from.positive(1, "units of rows above 0")?[0];
            let values = from.take(pixels)?;
            Ok(values.iter().map(|v| f32::from(*v as i8) * unit).collect())
        };
        let (trust, appearance) = (row()?, row()?);
        let appearance_modes = (0..m).map(|_| row()).collect::<Result<Vec<_>, _>>()?;
        from.end()?;
        let base = core::array::from_fn(|i| [base[2 * i], base[2 * i + 1]]);
        let inside = base_pixels(&base, &triangles);
        if inside.len() != pixels {
            let expected = "as many pixels as lie inside the shape";
            return Err(from.malformed(expected, pixels as f64));
        }
        let modes = head_modes.chunks_exact(3 * LANDMARKS);
        Ok(Self {
            head: vectors(&head).into_iter().map(Point::from).collect(),
            head_modes: modes.map(vectors).collect(),
            head_deviations,
            base,
            triangles,
            trust,
            appearance,
            appearance_modes,
            appearance_deviations,
            noise,
            confidence_curve: [confidence_curve[0], confidence_curve[1]],
            pixels: inside,
        })
    }

    /// Bytes of the model, as in the module's description; appearance is rounded to 8 bits.
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
        let mut floats: Vec<f32> = self.head.iter().flat_map(|p| p.coords.data.0[0]).collect();
        floats.extend(&self.head_deviations);
        floats.extend(self.head_modes.iter().flatten().flatten());
        floats.extend(self.base.iter().flatten());
        floats.push(self.noise);
        floats.extend(self.confidence_curve);
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
        let message = PaperAam::parse(&other).unwrap_err().to_string();
        assert!(message.contains("PAM2"), "{message}");
        // The first deviation of a shape mode.
        let at = 4 + 8 + 4 * 3 * LANDMARKS;
        let mut other = bytes.to_vec();
        other[at..at + 4].copy_from_slice(&(-1.0_f32).to_le_bytes());
        let message = PaperAam::parse(&other).unwrap_err().to_string();
        assert!(message.contains("deviations of head modes above 0, found -1"));
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
