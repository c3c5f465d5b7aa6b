//! The model file: parse and emit.
//!
//! ```text
//! "MIENFACE"  version u32  length of the whole file u64
//! sections:   tag [u8; 4]  length u32  payload          SHAP COLD WARM CONF HEAD PROV PAAM REFI
//! CRC-32 of everything before it
//! ```
//! Little-endian; floats are IEEE 32-bit, those of the stages' scales and priors their upper 16 bits. Sections may be in any order; unknown ones are skipped. The checksum is also the
//! model's id. Beyond length and checksum, every count is checked against the bytes left, so that parsing cannot panic or
//! allocate more than the file's length, and every number against its plausible range, so that stages built from a model cannot
//! either.

use alloc::borrow::Cow;

use crate::base::capacity::LANDMARKS;
use crate::base::checksum::crc32;
use crate::base::geometry::{Point, Vector};

use super::error::ModelError;
use super::model::{CascadeStage, ConfidenceModel, FaceModel, LEVELS_PER_BYTE, ShapeModel};
use super::reader::Reader;
use super::refinement::Refinement;
use super::sizes::{
    FACE_INPUTS, FEATURES, LANDMARK_INPUTS, MAX_MODES, MAX_STAGES, VIEW_PARAMETERS,
};
use crate::base::prelude::*;

/// First bytes of a model file.
pub const MAGIC: [u8; 8] = *b"MIENFACE";
/// Version of the written format.
pub const VERSION: u32 = 4;
/// Largest coordinate of a head, head frame, metres: limits memory that grows with its extent.
const HEAD_M: f32 = 0.3;
/// Most points of the standard head: three times the shipped one's.
const MAX_HEAD_POINTS: usize = 8192;
/// Largest coordinate of a unit vector, with rounding.
const UNIT: f32 = 1.001;
const HEADER: usize = 20;
const CHECKSUM: usize = 4;

/// Bytes of the built-in model file.
pub const SHIPPED: &[u8] = include_bytes!("../../../config/face.model");

impl FaceModel {
    /// Parses a model file.
    ///
    /// # Errors
    /// If it is not a model, of another version, damaged or inconsistent.
    pub fn read(bytes: &[u8]) -> Result<Self, ModelError> {
        let (sections, id) = checked(bytes, VERSION)?;
        parse(sections, id, |_| None)
    }

    /// The built-in model.
    pub fn shipped() -> Self {
        // The bytes are static, so large parts are borrowed. A test verifies the checksum: computing it here would page in unused
        // parts such as the paper's appearance model.
        let body = SHIPPED.len() - CHECKSUM;
        let model = parse(&SHIPPED[HEADER..body], u32_at(SHIPPED, body), Some);
        model.expect("the shipped model is read by a test")
    }
}

/// Extends a borrow of the file's bytes to `'static` where they are static.
type Lasting<'a> = fn(&'a [u8]) -> Option<&'static [u8]>;

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

/// Sections and checksum of a file, after checking magic, version, length and checksum.
///
/// # Errors
/// If one of them is wrong.
pub fn checked(bytes: &[u8], expected_version: u32) -> Result<(&[u8], u32), ModelError> {
    if !bytes.starts_with(&MAGIC) {
        let found = bytes[..bytes.len().min(MAGIC.len())].to_vec();
        return Err(ModelError::NotAModel(found));
    }
    let length = |expected| ModelError::Length(expected, bytes.len() as u64);
    if bytes.len() < HEADER + CHECKSUM {
        return Err(length((HEADER + CHECKSUM) as u64));
    }
    let version = u32_at(bytes, MAGIC.len());
    if version != expected_version {
        return Err(ModelError::Version(expected_version, version));
    }
    let stated = u64::from(u32_at(bytes, 12)) | u64::from(u32_at(bytes, 16)) << 32;
    if stated != bytes.len() as u64 {
        return Err(length(stated));
    }
    let body = bytes.len() - CHECKSUM;
    let (expected, found) = (u32_at(bytes, body), crc32(&bytes[..body]));
    if expected != found {
        return Err(ModelError::Damaged(expected, found));
    }
    Ok((&bytes[HEADER..body], found))
}

fn parse<'a>(bytes: &'a [u8], id: u32, lasting: Lasting<'a>) -> Result<FaceModel, ModelError> {
    let mut rest = Reader {
        section: "header",
        bytes,
    };
    let mut sections = Vec::new();
    while !rest.bytes.is_empty() {
        sections.push(next_section(&mut rest)?);
    }
    let optional = |section: &'static str| {
        let mut sections = sections.iter().rev();
        let (_, bytes) = *sections.find(|(tag, _)| *tag == section.as_bytes())?;
        Some(Reader { section, bytes })
    };
    let needed = |section| optional(section).ok_or(ModelError::Missing(section));
    let shape = parse_shape(needed("SHAP")?)?;
    let modes = shape.modes.len();
    let stages = |section| parse_stages(needed(section)?, VIEW_PARAMETERS + modes, lasting);
    let refinement = optional("REFI").map(|section| Refinement::parse(section.bytes, modes));
    let paper_aam = optional("PAAM").map(|section| match lasting(section.bytes) {
        Some(bytes) => Cow::Borrowed(bytes),
        None => Cow::Owned(section.bytes.to_vec()),
    });
    let provenance = optional("PROV").map_or(&[][..], |section| section.bytes);
    Ok(FaceModel {
        id,
        provenance: String::from_utf8_lossy(provenance).into_owned(),
        cold: stages("COLD")?.into(),
        warm: stages("WARM")?.into(),
        confidence: parse_confidence(needed("CONF")?)?.into(),
        refinement: refinement.transpose()?.map(Into::into),
        standard_head: parse_head(needed("HEAD")?)?,
        paper_aam: paper_aam.unwrap_or_default(),
        shape,
    })
}

/// Tag and bytes of the next section.
fn next_section<'a>(rest: &mut Reader<'a>) -> Result<(&'a [u8], &'a [u8]), ModelError> {
    let tag = rest.take(4)?;
    let length = rest.number(4)?;
    Ok((tag, rest.take(length)?))
}

fn parse_shape(mut reader: Reader) -> Result<ShapeModel, ModelError> {
    let modes = reader.count(4, 0..=MAX_MODES, "at most 48 shape modes")?;
    let mean = reader.vectors_within(LANDMARKS, HEAD_M, "points of a head, within 0.3 m")?;
    let deviations = reader.positive_up_to(modes, 1.0, "deviations above 0, up to 1 m")?;
    let expected = "modes of length 1";
    let modes = reader.floats_within(modes * 3 * LANDMARKS, UNIT, expected)?;
    reader.end()?;
    Ok(ShapeModel {
        mean: mean.into_iter().map(Point::from).collect(),
        modes: modes.as_chunks::<{ 3 * LANDMARKS }>().0.to_vec(),
        deviations,
    })
}

fn parse_head(mut reader: Reader) -> Result<Vec<(Point, Vector)>, ModelError> {
    let count = reader.count(4, 1..=MAX_HEAD_POINTS, "1 to 8192 points")?;
    let points = reader.vectors_within(count, HEAD_M, "points of a head, within 0.3 m")?;
    let normals = reader.vectors_within(count, UNIT, "normals of length 1")?;
    reader.end()?;
    let points = points.into_iter().map(Point::from);
    Ok(points.zip(normals).collect())
}

fn parse_stages<'a>(
    mut reader: Reader<'a>,
    parameters: usize,
    lasting: Lasting<'a>,
) -> Result<Vec<CascadeStage>, ModelError> {
    let count = reader.count(4, 0..=MAX_STAGES, "at most 8 stages")?;
    let mut stages = Vec::with_capacity(count);
    for _ in 0..count {
        let rows = reader.count(
            4,
            VIEW_PARAMETERS..=parameters,
            "a row for each parameter of the view and at most one for each shape mode",
        )?;
        let mut bytes = |count| {
            let bytes = reader.take(count)?;
            Ok(lasting(bytes).map_or_else(|| Cow::Owned(bytes.to_vec()), Cow::Borrowed))
        };
        stages.push(CascadeStage {
            mean: bytes(FEATURES)?,
            levels: bytes(rows * FEATURES / LEVELS_PER_BYTE)?,
            cell_px: reader.cell_px()?,
            scales: reader.shorts(rows * LANDMARKS)?,
            prior: reader.shorts(rows * rows)?,
            bias: reader.floats(rows)?,
        });
    }
    reader.end()?;
    Ok(stages)
}

fn parse_confidence(mut reader: Reader) -> Result<ConfidenceModel, ModelError> {
    let model = ConfidenceModel {
        cell_px: reader.cell_px()?,
        mean: reader.take(FEATURES)?.to_vec(),
        weights: bytemuck::cast_slice(reader.take(FEATURES)?).to_vec(),
        scales: reader.floats(LANDMARKS)?,
        landmark: reader.floats(LANDMARK_INPUTS * LANDMARKS)?,
        face: {
            let slopes = reader.floats(FACE_INPUTS)?;
            core::array::from_fn(|k| slopes[k])
        },
    };
    reader.end()?;
    Ok(model)
}

fn put_floats<'a>(out: &mut Vec<u8>, values: impl IntoIterator<Item = &'a f32>) {
    out.extend(values.into_iter().flat_map(|value| value.to_le_bytes()));
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
        out.extend_from_slice(&stage.mean);
        out.extend_from_slice(&stage.levels);
        put_floats(&mut out, [&stage.cell_px]);
        for value in stage.scales.iter().chain(&stage.prior) {
            out.extend_from_slice(&value.0.to_le_bytes());
        }
        put_floats(&mut out, &stage.bias);
    }
    out
}

/// Bytes of the section CONF.
pub fn put_confidence(model: &ConfidenceModel) -> Vec<u8> {
    let mut out = Vec::new();
    put_floats(&mut out, [&model.cell_px]);
    out.extend_from_slice(&model.mean);
    out.extend_from_slice(bytemuck::cast_slice(&model.weights));
    for values in [&model.scales[..], &model.landmark, &model.face] {
        put_floats(&mut out, values);
    }
    out
}

/// A file of sections (tag, bytes), with length and checksum.
pub fn framed<'a>(sections: impl Iterator<Item = (&'a [u8], &'a [u8])>) -> Vec<u8> {
    let mut out = MAGIC.to_vec();
    out.extend(VERSION.to_le_bytes());
    out.extend([0; 8]);
    for (tag, payload) in sections {
        out.extend(tag);
        put_count(&mut out, payload.len());
        out.extend(payload);
    }
    let length = (out.len() + CHECKSUM) as u64;
    out[12..HEADER].copy_from_slice(&length.to_le_bytes());
    let checksum = crc32(&out);
    out.extend(checksum.to_le_bytes());
    out
}

/// Tags and bytes of the sections of a model file, in order.
///
/// # Errors
/// As [`FaceModel::read`].
#[cfg(feature = "studio")]
pub fn sections(bytes: &[u8]) -> Result<impl Iterator<Item = (&[u8], &[u8])> + Clone, ModelError> {
    FaceModel::read(bytes)?;
    let mut rest = Reader {
        section: "header",
        bytes: &bytes[HEADER..bytes.len() - CHECKSUM],
    };
    Ok(core::iter::from_fn(move || next_section(&mut rest).ok()))
}

/// Replaces the payload of a section; the others stay identical.
///
/// # Errors
/// If the bytes are not a model, before or after the replacement.
#[cfg(feature = "studio")]
pub fn with_section(bytes: &[u8], tag: [u8; 4], payload: &[u8]) -> Result<Vec<u8>, ModelError> {
    let sections = sections(bytes)?;
    let replaced = sections.map(|(other, kept)| (other, if other == tag { payload } else { kept }));
    let out = framed(replaced);
    FaceModel::read(&out)?;
    Ok(out)
}

/// Bytes of a model file. The `id` is not written: it is the checksum of the bytes.
pub fn emit(model: &FaceModel) -> Vec<u8> {
    let mut shape = Vec::new();
    put_count(&mut shape, model.shape.modes.len());
    put_floats(&mut shape, model.shape.mean.iter().flat_map(|p| &p.coords));
    put_floats(&mut shape, &model.shape.deviations);
    put_floats(&mut shape, model.shape.modes.iter().flatten());
    let mut head = Vec::new();
    put_count(&mut head, model.standard_head.len());
    put_floats(
        &mut head,
        model.standard_head.iter().flat_map(|(p, _)| &p.coords),
    );
    put_floats(&mut head, model.standard_head.iter().flat_map(|(_, n)| n));
    let confidence = put_confidence(&model.confidence);
    let (cold, warm) = (put_stages(&model.cold), put_stages(&model.warm));
    let refinement = model.refinement.as_ref().map(|r| r.emit());
    let sections = [
        ("PROV", model.provenance.as_bytes()),
        ("SHAP", &shape),
        ("HEAD", &head),
        ("COLD", &cold),
        ("WARM", &warm),
        ("CONF", &confidence),
        ("PAAM", &model.paper_aam),
    ];
    let refinement = refinement.iter().map(|bytes| ("REFI", bytes.as_slice()));
    let sections = sections.into_iter().chain(refinement);
    let sections = sections.map(|(tag, payload)| (tag.as_bytes(), payload));
    framed(sections)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::face_model::Short;

    fn example() -> FaceModel {
        let mut random = fastrand::Rng::with_seed(7);
        let mut floats =
            |count: usize| -> Vec<f32> { (0..count).map(|_| random.f32() - 0.5).collect() };
        let bytes = |count: usize| -> Vec<u8> { (0..count).map(|k| (k * k / 7) as u8).collect() };
        let vectors = |f: Vec<f32>| -> Vec<Vector> {
            f.chunks_exact(3)
                .map(|c| Vector::new(c[0], c[1], c[2]))
                .collect()
        };
        let shape = ShapeModel {
            mean: vectors(floats(3 * LANDMARKS))
                .into_iter()
                .map(|v| Point::from(v * 0.5))
                .collect(),
            modes: floats(2 * 3 * LANDMARKS).as_chunks().0.to_vec(),
            deviations: vec![0.2, 0.1],
        };
        let rows = VIEW_PARAMETERS + 2;
        let mut stage = || CascadeStage {
            cell_px: 5.5,
            mean: bytes(FEATURES).into(),
            levels: bytes(rows * FEATURES / LEVELS_PER_BYTE).into(),
            scales: floats(rows * LANDMARKS)
                .into_iter()
                .map(Short::from)
                .collect(),
            prior: floats(rows * rows).into_iter().map(Short::from).collect(),
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
            mean: bytes(FEATURES),
            weights: bytes(FEATURES).iter().map(|b| b.cast_signed()).collect(),
            scales: floats(LANDMARKS),
            landmark: floats(LANDMARK_INPUTS * LANDMARKS),
            face: [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0],
        }
        .into();
        let points = vectors(floats(30))
            .into_iter()
            .map(|v| Point::from(v * 0.5));
        model.standard_head = points.zip(vectors(floats(30))).collect();
        model.paper_aam = vec![1, 2, 3].into();
        model
    }

    #[cfg(feature = "studio")]
    #[test]
    fn one_section_is_replaced_and_the_others_stay_byte_for_byte() {
        let bytes = include_bytes!("../../../config/face.model");
        let grafted = with_section(bytes, *b"PAAM", &[7; 33]).unwrap();
        assert_eq!(
            FaceModel::read(&grafted).unwrap().paper_aam.as_ref(),
            [7; 33]
        );
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
        let own = FaceModel::read(bytes).unwrap().paper_aam;
        assert_eq!(with_section(bytes, *b"PAAM", &own).unwrap(), bytes);
        assert!(with_section(&bytes[..100], *b"PAAM", &[]).is_err());
    }

    #[test]
    fn what_is_written_is_read() {
        let model = example();
        let bytes = emit(&model);
        let mut read = FaceModel::read(&bytes).expect("valid");
        assert_eq!(emit(&read), bytes);
        read.id = 0;
        assert!(read == model);
    }

    #[test]
    fn every_damage_has_its_error() {
        let bytes = emit(&example());
        assert!(matches!(
            FaceModel::read(b""),
            Err(ModelError::NotAModel(_))
        ));
        assert!(matches!(
            FaceModel::read(b"P5 640 480 255 pixels"),
            Err(ModelError::NotAModel(_))
        ));
        let mut other = bytes.clone();
        other[8] = 9;
        assert_eq!(
            FaceModel::read(&other),
            Err(ModelError::Version(VERSION, 9))
        );
        for length in [8, 19, 23, 100, bytes.len() - 1] {
            assert!(
                matches!(
                    FaceModel::read(&bytes[..length]),
                    Err(ModelError::Length(..))
                ),
                "{length}"
            );
        }
        for at in [30, 1000, bytes.len() - 2] {
            let mut flipped = bytes.clone();
            flipped[at] ^= 1;
            assert!(
                matches!(FaceModel::read(&flipped), Err(ModelError::Damaged(..))),
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
            let _ = FaceModel::read(&bad);
        }
        // A head that is none, behind a right checksum.
        for (odd, part) in [(1e6, "within 0.3 m"), (1e3, "0.3 m"), (f32::NAN, "0.3 m")] {
            let mut model = example();
            model.standard_head[3].0.x = odd;
            let told = FaceModel::read(&emit(&model)).unwrap_err().to_string();
            assert!(told.contains(part), "{told}");
            let mut model = example();
            model.shape.deviations[0] = odd;
            assert!(FaceModel::read(&emit(&model)).is_err());
        }
    }

    #[test]
    fn the_shipped_model_reads() {
        let model = FaceModel::read(SHIPPED).expect("valid");
        assert_eq!(FaceModel::shipped().id, model.id);
        assert_eq!(model.shape.mean.len(), LANDMARKS);
        assert!(SHIPPED.len() <= 1_000_000);
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
