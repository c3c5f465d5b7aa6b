//! The model file: parse and emit.
//!
//! ```text
//! "MIENFACE"  version u32  length of the whole file u64
//! sections:   tag [u8; 4]  length u32  payload          SHAP COLD WARM CONF HEAD PROV PAAM REFI
//! CRC-32 of everything before it
//! ```
//! Little-endian throughout; floats are IEEE 32-bit. Sections may stand in any order, unknown ones are skipped. The
//! checksum is also the model's id. A file is believed only if length and checksum are right, and even then every count
//! is checked against the bytes that are there, so that parsing cannot panic or ask for more memory than the file is long.
//! One file: what is written and what is read stand side by side, section by section.

use alloc::borrow::Cow;

use crate::base::capacity::LANDMARKS;
use crate::base::checksum::crc32;
use crate::base::geometry::{Point, Vector};

use super::error::ModelError;
use super::model::{CascadeStage, ConfidenceModel, FaceModel, ShapeModel, StandardHead};
use super::refinement::Refinement;
use super::sizes::{
    FACE_SIGNS, FEATURES, FIRST_FACE_SIGNS, LANDMARK_SIGNS, MAX_MODES, MAX_STAGES, VIEW_PARAMETERS,
};
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// First bytes of a model file.
pub const MAGIC: [u8; 8] = *b"MIENFACE";
/// Version of the format that is written and read.
pub const VERSION: u32 = 3;
/// The oldest version that is read.
const OLDEST: u32 = 2;
const HEADER: usize = 20;
const CHECKSUM: usize = 4;

/// The model built into the binary, as a file.
pub const SHIPPED: &[u8] = include_bytes!("../../config/face.model");

impl FaceModel {
    /// Parses a model file.
    ///
    /// # Errors
    /// If it is no model, of another version, damaged or inconsistent; the text says what to do.
    pub fn read(bytes: &[u8]) -> Result<Self, ModelError> {
        parse(bytes)
    }

    /// The model built into the binary.
    #[must_use]
    pub fn shipped() -> Self {
        parse_in_place(SHIPPED).expect("the shipped model is read by a test")
    }
}

/// Reads little-endian values of one section.
struct Reader<'a> {
    section: &'static str,
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], ModelError> {
        if count > self.bytes.len() {
            return Err(ModelError::Malformed {
                section: self.section,
                expected: "more bytes",
                found: self.bytes.len() as u64,
            });
        }
        let (head, tail) = self.bytes.split_at(count);
        self.bytes = tail;
        Ok(head)
    }

    fn u32(&mut self) -> Result<u32, ModelError> {
        let bytes = self.take(4)?;
        Ok(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }

    /// A count that may be at most `most`.
    fn count(&mut self, most: usize, expected: &'static str) -> Result<usize, ModelError> {
        let found = self.u32()?;
        if found as usize > most {
            return Err(ModelError::Malformed {
                section: self.section,
                expected,
                found: found.into(),
            });
        }
        Ok(found as usize)
    }

    fn floats(&mut self, count: usize) -> Result<Vec<f32>, ModelError> {
        let bytes = self.take(count.saturating_mul(4))?;
        let values: Vec<f32> = bytes
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        match values.iter().position(|v| !v.is_finite()) {
            None => Ok(values),
            Some(at) => Err(ModelError::Malformed {
                section: self.section,
                expected: "finite numbers",
                found: at as u64,
            }),
        }
    }

    fn points(&mut self, count: usize) -> Result<Vec<Vector>, ModelError> {
        Ok(self
            .floats(count.saturating_mul(3))?
            .chunks_exact(3)
            .map(|c| Vector::new(c[0], c[1], c[2]))
            .collect())
    }

    fn end(&self) -> Result<(), ModelError> {
        if self.bytes.is_empty() {
            return Ok(());
        }
        Err(ModelError::Malformed {
            section: self.section,
            expected: "no bytes after its end",
            found: self.bytes.len() as u64,
        })
    }
}

/// Parses a model file; see [`FaceModel::read`].
///
/// # Errors
/// If it is no model, of another version, damaged or inconsistent.
pub fn parse(bytes: &[u8]) -> Result<FaceModel, ModelError> {
    parse_with(bytes, |_| None)
}

/// As [`parse`], for a file that stays in memory anyway: what is big is used where it lies.
pub(super) fn parse_in_place(bytes: &'static [u8]) -> Result<FaceModel, ModelError> {
    parse_with(bytes, Some)
}

/// What makes bytes of a file stay, if they do.
type Lasting<'a> = fn(&'a [u8]) -> Option<&'static [u8]>;

/// The sections of a file that is whole and of a version that is understood, and its checksum.
fn checked(bytes: &[u8]) -> Result<(&[u8], u32), ModelError> {
    let is_model = bytes.len() >= MAGIC.len() && bytes[..MAGIC.len()] == MAGIC;
    if !is_model {
        return Err(ModelError::NotAModel {
            found: bytes[..bytes.len().min(MAGIC.len())].to_vec(),
        });
    }
    let too_short = ModelError::Length {
        expected: (HEADER + CHECKSUM) as u64,
        found: bytes.len() as u64,
    };
    if bytes.len() < HEADER + CHECKSUM {
        return Err(too_short);
    }
    let u32_at =
        |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
    let version = u32_at(8);
    if !(OLDEST..=VERSION).contains(&version) {
        return Err(ModelError::Version {
            expected: VERSION,
            found: version,
        });
    }
    let stated = u64::from(u32_at(12)) | u64::from(u32_at(16)) << 32;
    if stated != bytes.len() as u64 {
        return Err(ModelError::Length {
            expected: stated,
            found: bytes.len() as u64,
        });
    }
    let body = bytes.len() - CHECKSUM;
    let (expected, found) = (u32_at(body), crc32(&bytes[..body]));
    if expected != found {
        return Err(ModelError::Damaged { expected, found });
    }
    Ok((&bytes[HEADER..body], found))
}

fn parse_with<'a>(bytes: &'a [u8], lasting: Lasting<'a>) -> Result<FaceModel, ModelError> {
    let (bytes, id) = checked(bytes)?;
    let mut model = FaceModel {
        id,
        ..FaceModel::default()
    };
    let (mut cold, mut warm, mut confidence, mut refinement) = (None, None, None, None);
    let mut sections = Reader {
        section: "header",
        bytes,
    };
    while !sections.bytes.is_empty() {
        let tag = sections.take(4)?;
        let length = sections.u32()? as usize;
        let payload = sections.take(length)?;
        let section = |section| Reader {
            section,
            bytes: payload,
        };
        match tag {
            b"PROV" => model.provenance = String::from_utf8_lossy(payload).into_owned(),
            b"PAAM" => {
                model.paper_aam = match lasting(payload) {
                    Some(payload) => Cow::Borrowed(payload),
                    None => Cow::Owned(payload.to_vec()),
                }
            }
            b"SHAP" => model.shape = parse_shape(section("SHAP"))?,
            b"HEAD" => model.standard_head = parse_head(section("HEAD"))?,
            b"COLD" => cold = Some(section("COLD")),
            b"WARM" => warm = Some(section("WARM")),
            b"CONF" => confidence = Some(section("CONF")),
            b"REFI" => refinement = Some(payload),
            _ => {}
        }
    }
    if model.shape.mean.is_empty() {
        return Err(ModelError::Missing { section: "SHAP" });
    }
    if model.standard_head.points.is_empty() {
        return Err(ModelError::Missing { section: "HEAD" });
    }
    let parameters = model.parameters();
    model.cold = parse_stages(
        cold.ok_or(ModelError::Missing { section: "COLD" })?,
        parameters,
        lasting,
    )?
    .into();
    model.warm = parse_stages(
        warm.ok_or(ModelError::Missing { section: "WARM" })?,
        parameters,
        lasting,
    )?
    .into();
    model.confidence =
        parse_confidence(confidence.ok_or(ModelError::Missing { section: "CONF" })?)?.into();
    let modes = model.shape.modes.len();
    model.refinement = refinement
        .map(|bytes| Refinement::parse(bytes, modes).map(Into::into))
        .transpose()?;
    Ok(model)
}

fn parse_shape(mut reader: Reader) -> Result<ShapeModel, ModelError> {
    let modes = reader.count(MAX_MODES, "at most 48 shape modes")?;
    let mean = reader
        .points(LANDMARKS)?
        .into_iter()
        .map(Point::from)
        .collect();
    let deviations = reader.floats(modes)?;
    if let Some(at) = deviations.iter().position(|d| *d <= 0.0) {
        return Err(ModelError::Malformed {
            section: "SHAP",
            expected: "deviations above 0",
            found: at as u64,
        });
    }
    let modes = reader.floats(modes * 3 * LANDMARKS)?;
    let modes = modes.as_chunks::<{ 3 * LANDMARKS }>().0.to_vec();
    reader.end()?;
    Ok(ShapeModel {
        mean,
        modes,
        deviations,
    })
}

fn parse_head(mut reader: Reader) -> Result<StandardHead, ModelError> {
    let count = reader.count(1_000_000, "at most a million points")?;
    let points = reader.points(count)?.into_iter().map(Point::from).collect();
    let normals = reader.points(count)?;
    reader.end()?;
    Ok(StandardHead { points, normals })
}

fn parse_stages<'a>(
    mut reader: Reader<'a>,
    parameters: usize,
    lasting: Lasting<'a>,
) -> Result<Vec<CascadeStage>, ModelError> {
    let count = reader.count(MAX_STAGES, "at most 8 stages")?;
    let mut stages = Vec::with_capacity(count);
    for _ in 0..count {
        let rows = reader.u32()? as usize;
        if !(VIEW_PARAMETERS..=parameters).contains(&rows) {
            return Err(ModelError::Malformed {
                section: reader.section,
                expected: "a row for each parameter of the view and at most one for each shape mode",
                found: rows as u64,
            });
        }
        stages.push(CascadeStage {
            cell_px: reader.floats(1)?[0],
            mean: reader.floats(FEATURES)?,
            weights: {
                let weights = reader.take(rows * FEATURES)?;
                match lasting(weights) {
                    Some(weights) => Cow::Borrowed(bytemuck::cast_slice(weights)),
                    None => Cow::Owned(bytemuck::cast_slice(weights).to_vec()),
                }
            },
            scales: reader.floats(rows * LANDMARKS)?,
            prior: reader.floats(rows * rows)?,
            bias: reader.floats(rows)?,
        });
    }
    reader.end()?;
    Ok(stages)
}

fn parse_confidence(mut reader: Reader) -> Result<ConfidenceModel, ModelError> {
    let model = ConfidenceModel {
        cell_px: reader.floats(1)?[0],
        mean: reader.floats(FEATURES)?,
        weights: reader.floats(FEATURES)?,
        landmark: reader.floats(LANDMARK_SIGNS * LANDMARKS)?,
        face: {
            // Version 2 has the first signs only.
            let count = if reader.bytes.len() == 4 * FIRST_FACE_SIGNS {
                FIRST_FACE_SIGNS
            } else {
                FACE_SIGNS
            };
            let slopes = reader.floats(count)?;
            core::array::from_fn(|k| slopes.get(k).copied().unwrap_or(0.0))
        },
    };
    reader.end()?;
    Ok(model)
}

fn put_floats(out: &mut Vec<u8>, values: impl IntoIterator<Item = f32>) {
    for value in values {
        out.extend_from_slice(&value.to_le_bytes());
    }
}

fn put_count(out: &mut Vec<u8>, count: usize) {
    let count = u32::try_from(count).expect("counts of a model fit 32 bits");
    out.extend_from_slice(&count.to_le_bytes());
}

fn put_stages(stages: &[CascadeStage]) -> Vec<u8> {
    let mut out = Vec::new();
    put_count(&mut out, stages.len());
    for stage in stages {
        put_count(&mut out, stage.bias.len());
        put_floats(&mut out, [stage.cell_px]);
        put_floats(&mut out, stage.mean.iter().copied());
        out.extend(stage.weights.iter().map(|w| w.to_le_bytes()[0]));
        put_floats(&mut out, stage.scales.iter().copied());
        put_floats(&mut out, stage.prior.iter().copied());
        put_floats(&mut out, stage.bias.iter().copied());
    }
    out
}

/// Tags and bytes of the sections of a model file, in order.
///
/// # Errors
/// If the bytes are no model.
#[cfg(feature = "studio")]
pub(crate) fn sections(
    bytes: &[u8],
) -> Result<impl Iterator<Item = (&[u8], &[u8])> + Clone, ModelError> {
    parse(bytes)?;
    let mut rest = &bytes[HEADER..bytes.len() - CHECKSUM];
    Ok(core::iter::from_fn(move || {
        let (tag, after) = rest.split_at_checked(4)?;
        let (length, after) = after.split_first_chunk::<4>()?;
        let (payload, after) = after.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        rest = after;
        Some((tag, payload))
    }))
}

/// The same file with the section of this tag replaced; all others stay the same, byte for byte.
///
/// # Errors
/// If the bytes are no model, or no longer one with it.
#[cfg(feature = "studio")]
pub(crate) fn with_section(
    bytes: &[u8],
    tag: [u8; 4],
    payload: &[u8],
) -> Result<Vec<u8>, ModelError> {
    let mut out = Vec::with_capacity(bytes.len() + payload.len());
    out.extend_from_slice(&bytes[..HEADER]);
    for (other, kept) in sections(bytes)? {
        let payload = if other == tag { payload } else { kept };
        out.extend_from_slice(other);
        put_count(&mut out, payload.len());
        out.extend_from_slice(payload);
    }
    let length = (out.len() + CHECKSUM) as u64;
    out[12..20].copy_from_slice(&length.to_le_bytes());
    let checksum = crc32(&out);
    out.extend_from_slice(&checksum.to_le_bytes());
    parse(&out)?;
    Ok(out)
}

/// Writes a model; its `id` is not written, it follows from the bytes.
#[must_use]
pub fn emit(model: &FaceModel) -> Vec<u8> {
    let mut shape = Vec::new();
    put_count(&mut shape, model.shape.modes.len());
    put_floats(
        &mut shape,
        model.shape.mean.iter().flat_map(|p| [p.x, p.y, p.z]),
    );
    put_floats(&mut shape, model.shape.deviations.iter().copied());
    for mode in &model.shape.modes {
        put_floats(&mut shape, mode.iter().copied());
    }
    let mut head = Vec::new();
    put_count(&mut head, model.standard_head.points.len());
    put_floats(
        &mut head,
        model
            .standard_head
            .points
            .iter()
            .flat_map(|p| [p.x, p.y, p.z]),
    );
    put_floats(
        &mut head,
        model
            .standard_head
            .normals
            .iter()
            .flat_map(|v| [v.x, v.y, v.z]),
    );
    let mut confidence = Vec::new();
    put_floats(&mut confidence, [model.confidence.cell_px]);
    put_floats(&mut confidence, model.confidence.mean.iter().copied());
    put_floats(&mut confidence, model.confidence.weights.iter().copied());
    put_floats(&mut confidence, model.confidence.landmark.iter().copied());
    put_floats(&mut confidence, model.confidence.face);

    let refinement = model.refinement.as_ref().map_or(Vec::new(), |r| r.emit());

    let mut out = Vec::new();
    out.extend_from_slice(&MAGIC);
    out.extend_from_slice(&VERSION.to_le_bytes());
    out.extend_from_slice(&[0; 8]);
    for (tag, payload) in [
        (b"PROV", model.provenance.as_bytes()),
        (b"SHAP", &shape),
        (b"HEAD", &head),
        (b"COLD", &put_stages(&model.cold)),
        (b"WARM", &put_stages(&model.warm)),
        (b"CONF", &confidence),
        (b"PAAM", &model.paper_aam),
        (b"REFI", &refinement),
    ] {
        if tag == b"REFI" && payload.is_empty() {
            continue;
        }
        out.extend_from_slice(tag);
        put_count(&mut out, payload.len());
        out.extend_from_slice(payload);
    }
    let length = (out.len() + CHECKSUM) as u64;
    out[12..20].copy_from_slice(&length.to_le_bytes());
    let checksum = crc32(&out);
    out.extend_from_slice(&checksum.to_le_bytes());
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> FaceModel {
        let mut random = fastrand::Rng::with_seed(7);
        let mut floats =
            |count: usize| -> Vec<f32> { (0..count).map(|_| random.f32() - 0.5).collect() };
        let vectors = |f: Vec<f32>| -> Vec<Vector> {
            f.chunks_exact(3)
                .map(|c| Vector::new(c[0], c[1], c[2]))
                .collect()
        };
        let shape = ShapeModel {
            mean: vectors(floats(3 * LANDMARKS))
                .into_iter()
                .map(Point::from)
                .collect(),
            modes: floats(2 * 3 * LANDMARKS).as_chunks().0.to_vec(),
            deviations: vec![0.2, 0.1],
        };
        let rows = VIEW_PARAMETERS + 2;
        let mut stage = || CascadeStage {
            cell_px: 5.5,
            mean: floats(FEATURES),
            weights: floats(rows * FEATURES)
                .iter()
                .map(|f| (f * 250.0) as i8)
                .collect(),
            scales: floats(rows * LANDMARKS),
            prior: floats(rows * rows),
            bias: floats(rows),
        };
        let mut model = FaceModel {
            provenance: "a test".into(),
            shape,
            cold: vec![stage(), stage()].into(),
            warm: vec![stage()].into(),
            ..FaceModel::default()
        };
        model.confidence = ConfidenceModel {
            cell_px: 5.0,
            mean: floats(FEATURES),
            weights: floats(FEATURES),
            landmark: floats(LANDMARK_SIGNS * LANDMARKS),
            face: [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0],
        }
        .into();
        model.standard_head = StandardHead {
            points: vectors(floats(30)).into_iter().map(Point::from).collect(),
            normals: vectors(floats(30)),
        };
        model.paper_aam = vec![1, 2, 3].into();
        model
    }

    #[cfg(feature = "studio")]
    #[test]
    fn one_section_is_replaced_and_the_others_stay_byte_for_byte() {
        let bytes = include_bytes!("../../config/face.model");
        let grafted = with_section(bytes, *b"PAAM", &[7; 33]).unwrap();
        assert_eq!(parse(&grafted).unwrap().paper_aam.as_ref(), [7; 33]);
        let (mut same, mut other) = (0, 0);
        for (before, after) in sections(bytes).unwrap().zip(sections(&grafted).unwrap()) {
            assert_eq!(before.0, after.0);
            if before.0 == b"PAAM" {
                other += 1;
            } else {
                assert_eq!(before.1, after.1);
                same += 1;
            }
        }
        assert_eq!((same, other), (7, 1));
        // With its own bytes it is the file it was.
        let own = parse(bytes).unwrap().paper_aam;
        assert_eq!(with_section(bytes, *b"PAAM", &own).unwrap(), bytes);
        assert!(with_section(&bytes[..100], *b"PAAM", &[]).is_err());
    }

    #[test]
    fn what_is_written_is_read() {
        let model = example();
        let bytes = emit(&model);
        let mut read = parse(&bytes).expect("valid");
        assert_eq!(emit(&read), bytes);
        read.id = 0;
        assert!(read == model);
    }

    #[test]
    fn every_damage_is_named() {
        let bytes = emit(&example());
        assert!(matches!(parse(b""), Err(ModelError::NotAModel { .. })));
        assert!(matches!(
            parse(b"P5 640 480 255 pixels"),
            Err(ModelError::NotAModel { .. })
        ));
        let mut other = bytes.clone();
        other[8] = 9;
        assert_eq!(
            parse(&other),
            Err(ModelError::Version {
                expected: VERSION,
                found: 9
            })
        );
        for length in [8, 19, 23, 100, bytes.len() - 1] {
            assert!(
                matches!(parse(&bytes[..length]), Err(ModelError::Length { .. })),
                "{length}"
            );
        }
        for at in [30, 1000, bytes.len() - 2] {
            let mut flipped = bytes.clone();
            flipped[at] ^= 1;
            assert!(
                matches!(parse(&flipped), Err(ModelError::Damaged { .. })),
                "{at}"
            );
        }
    }

    #[test]
    fn wrong_counts_behind_a_right_checksum_do_not_panic() {
        let bytes = emit(&example());
        let mut random = fastrand::Rng::with_seed(11);
        for _ in 0..60 {
            let mut bad = bytes.clone();
            let at = HEADER + random.usize(..4000);
            bad[at] ^= 1 << random.u32(..8);
            let body = bad.len() - CHECKSUM;
            let checksum = crc32(&bad[..body]);
            bad[body..].copy_from_slice(&checksum.to_le_bytes());
            let _ = parse(&bad);
        }
    }

    #[test]
    fn the_shipped_model_reads() {
        let model = FaceModel::read(SHIPPED).expect("valid");
        assert_eq!(model.shape.mean.len(), LANDMARKS);
        assert!(SHIPPED.len() <= 3_000_000);
        let eyes = nalgebra::center(&model.shape.mean[39], &model.shape.mean[42]);
        assert!(eyes.coords.norm() < 0.01, "origin off by {eyes}");
    }

    #[test]
    fn coefficients_invert_shape() {
        let model = FaceModel::shipped();
        let planted: Vec<f32> = (0..model.shape.modes.len())
            .map(|i| (i as f32 * 0.7).sin())
            .collect();
        let mut shape = [Point::origin(); LANDMARKS];
        model.shape.shape(&planted, &mut shape);
        let mut found = vec![0.0; planted.len()];
        model.shape.coefficients(&shape, &mut found);
        for (a, b) in planted.iter().zip(&found) {
            assert!((a - b).abs() < 1e-2, "{a} {b}");
        }
    }
}
