//! The calibration blocks stored in a Kinect: parse and emit.
//!
//! Four blocks: the optics (fixed parameters: four 32-bit floats at byte 94), the registration integers, the constant shift of raw
//! depth, the cropped lines. The distance between the cameras is replaced by 2.4 cm, as in every common driver: devices store
//! 2.3 cm, but their registration was computed with 2.4 cm.

use super::device::Model;
use super::registration::{Registration, ZeroPlane};
use mien_stages::base::prelude::*;

/// A block of [`super::command::Command::AlgorithmParameters`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Block {
    /// Constant shift of raw depth.
    ConstShift = 0x00,
    /// The 29 registration integers.
    Registration = 0x40,
    /// Numbers of cropped lines.
    Padding = 0x41,
}

impl Block {
    /// The block with this number.
    pub fn from_number(number: u16) -> Option<Self> {
        let all = [Self::ConstShift, Self::Registration, Self::Padding];
        all.into_iter().find(|block| *block as u16 == number)
    }

    const fn name(self) -> &'static str {
        match self {
            Self::ConstShift => "constant shift",
            Self::Registration => "registration",
            Self::Padding => "padding",
        }
    }

    /// Bytes of the block, without the status word before it.
    pub const fn size(self) -> usize {
        match self {
            Self::ConstShift => 2,
            Self::Registration => 4 * 29,
            Self::Padding => 6,
        }
    }
}

/// Byte offset of the optics in the fixed parameters.
const OPTICS_OFFSET: usize = 94;
/// Distance between the cameras, centimetres; used instead of the stored one.
const CAMERA_DISTANCE: f32 = 2.4;

/// A calibration block that no Kinect has.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("the Kinect's calibration {0}; unplug it and plug it in again")]
pub struct CalibrationError(String);

fn check_length(
    block: &'static str,
    bytes: &[u8],
    expected: usize,
) -> Result<(), CalibrationError> {
    let found = bytes.len();
    let problem = || format!("block {block} has {found} bytes, expected {expected}");
    (found == expected)
        .then_some(())
        .ok_or_else(|| CalibrationError(problem()))
}

/// Reads the optics from the fixed parameters.
///
/// # Errors
/// If the length is wrong for the model, or a value is more than about ten times off the usual one.
pub fn parse_fixed(block: &[u8], model: Model) -> Result<ZeroPlane, CalibrationError> {
    check_length("fixed parameters", block, model.fixed_parameters_len())?;
    let checked = |i: usize, name: &str, least: f32, most: f32| {
        let found = f32::from_le_bytes(block[OPTICS_OFFSET..].as_chunks().0[i]);
        let problem = || format!("says {name} is {found}, expected {least} to {most}");
        let fits = (least..=most).contains(&found);
        fits.then_some(found)
            .ok_or_else(|| CalibrationError(problem()))
    };
    Ok(ZeroPlane {
        dcmos_emitter_distance: checked(0, "the emitter's distance (cm)", 0.75, 75.0)?,
        dcmos_rcmos_distance: CAMERA_DISTANCE,
        reference_distance: checked(2, "the reference distance (cm)", 12.0, 1200.0)?,
        reference_pixel_size: checked(3, "the reference pixel size (cm)", 0.01, 1.0)?,
    })
}

/// Reads one algorithm block (without its status word) into `registration`.
///
/// # Errors
/// If the length is wrong.
pub fn parse_block(
    block: Block,
    bytes: &[u8],
    registration: &mut Registration,
) -> Result<(), CalibrationError> {
    check_length(block.name(), bytes, block.size())?;
    let short = |i: usize| u16::from_le_bytes([bytes[2 * i], bytes[2 * i + 1]]);
    match block {
        Block::ConstShift => registration.const_shift = short(0),
        Block::Padding => registration.padding = [0, 1, 2].map(short),
        Block::Registration => {
            for (integer, bytes) in registration.integers.iter_mut().zip(bytes.as_chunks().0) {
                *integer = i32::from_le_bytes(*bytes);
            }
        }
    }
    Ok(())
}

/// The fixed parameters as sent by `model`; zero except for the optics.
pub fn emit_fixed(registration: &Registration, model: Model) -> Vec<u8> {
    let plane = &registration.zero_plane;
    let mut block = vec![0; model.fixed_parameters_len()];
    let optics = [
        plane.dcmos_emitter_distance,
        // The stored distance; see the module's header.
        2.3,
        plane.reference_distance,
        plane.reference_pixel_size,
    ];
    for (i, value) in optics.iter().enumerate() {
        block[OPTICS_OFFSET + 4 * i..][..4].copy_from_slice(&value.to_le_bytes());
    }
    block
}

/// One algorithm block, without its status word.
pub fn emit_block(block: Block, registration: &Registration) -> Vec<u8> {
    let bytes = |shorts: &[u16]| {
        let bytes = shorts.iter().flat_map(|short| short.to_le_bytes());
        bytes.collect()
    };
    match block {
        Block::ConstShift => bytes(&[registration.const_shift]),
        Block::Padding => bytes(&registration.padding),
        Block::Registration => {
            let integers = registration.integers.iter();
            integers.flat_map(|integer| integer.to_le_bytes()).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODELS: [Model; 3] = [Model::Xbox1414, Model::Xbox1473, Model::Windows1517];
    const BLOCKS: [Block; 3] = [Block::ConstShift, Block::Registration, Block::Padding];

    #[test]
    fn parse_inverts_emit() {
        let mut random = fastrand::Rng::with_seed(4);
        for round in 0..2000 {
            let mut sent = Registration::default();
            sent.integers = sent.integers.map(|_| random.i32(..));
            sent.const_shift = random.u16(..);
            sent.padding[1] = random.u16(..);
            sent.zero_plane.reference_distance = 100.0 + round as f32 * 0.01;
            let mut found = Registration {
                zero_plane: parse_fixed(&emit_fixed(&sent, MODELS[round % 3]), MODELS[round % 3])
                    .unwrap(),
                ..Registration::default()
            };
            for block in BLOCKS {
                parse_block(block, &emit_block(block, &sent), &mut found).unwrap();
            }
            assert_eq!(found, sent);
        }
    }

    #[test]
    fn what_no_kinect_has_is_refused() {
        let good = emit_fixed(&Registration::default(), Model::Xbox1414);
        assert!(parse_fixed(&good, Model::Windows1517).is_err());
        for value in [f32::NAN, f32::INFINITY, 0.0, -7.5, 1e9] {
            let mut bad = good.clone();
            bad[94..98].copy_from_slice(&value.to_le_bytes());
            assert!(parse_fixed(&bad, Model::Xbox1414).is_err(), "{value}");
        }
    }

    #[test]
    fn any_bytes_are_survived_and_what_is_accepted_gives_a_usable_camera() {
        let mut random = fastrand::Rng::with_seed(6);
        let mut bytes = [0; 340];
        for round in 0..100_000 {
            random.fill(&mut bytes);
            let n = if random.bool() {
                random.usize(..=bytes.len())
            } else {
                [2, 6, 116, 322, 334][round % 5]
            };
            let mut registration = Registration::default();
            for block in BLOCKS {
                assert_eq!(
                    parse_block(block, &bytes[..n], &mut registration).is_ok(),
                    n == block.size()
                );
            }
            for model in MODELS {
                if let Ok(plane) = parse_fixed(&bytes[..n], model) {
                    assert!(plane.dcmos_emitter_distance > 0.0 && plane.reference_pixel_size > 0.0);
                }
            }
            if round % 1000 == 0 {
                let camera = registration.camera();
                assert!((0..2048).all(|raw| camera.depth_m(raw).is_finite()));
            }
        }
    }
}
