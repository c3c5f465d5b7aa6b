//! The file of a head: `MIENHEAD`, version, CRC-32 of the rest, then counts and arrays, little endian, quantised.
//!
//! Places in steps of 10 µm, offsets of an expression in 1/127 of its largest, the photograph in bytes. The truth
//! of a simulation comes from the head as read, so quantisation is no error. A file is believed only if its checksum is right,
//! and even then every count and index is checked: any bytes give a head or one sentence.

use crate::capacity::LANDMARKS;
use crate::checksum::crc32;
use crate::geometry::{Point, Vector};

use super::asset::{Expression, HeadAsset, Part, Site, Texture};

const MAGIC: &[u8; 8] = b"MIENHEAD";
const VERSION: u32 = 1;
const HEADER: usize = 16;
/// Metres per step of a place.
const STEP_M: f32 = 1e-5;
/// Pixels per step of a place in the photograph.
const STEP_PX: f32 = 1.0 / 32.0;

/// Why bytes are not a head.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HeadFileError {
    /// Something else.
    #[error(
        "expected a head file beginning with MIENHEAD version {VERSION}, found another kind of file; make one with mien-studio"
    )]
    NotAHead,
    /// Damaged.
    #[error(
        "head file damaged: expected checksum {expected:08x}, found {found:08x}; fetch or make it again"
    )]
    Checksum {
        /// In the file.
        expected: u32,
        /// Of the file.
        found: u32,
    },
    /// Cut short, or with something behind its end.
    #[error("head file has the wrong length at {what}; fetch or make it again")]
    Length {
        /// The array being read.
        what: &'static str,
    },
    /// A number that cannot be.
    #[error("head file has an impossible value in {what}; fetch or make it again")]
    Value {
        /// The array being read.
        what: &'static str,
    },
}

struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize, what: &'static str) -> Result<&'a [u8], HeadFileError> {
        let (taken, rest) = self
            .rest
            .split_at_checked(count)
            .ok_or(HeadFileError::Length { what })?;
        self.rest = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self, what: &'static str) -> Result<[u8; N], HeadFileError> {
        Ok(self.take(N, what)?.try_into().expect("taken that long"))
    }

    fn u16(&mut self, what: &'static str) -> Result<u16, HeadFileError> {
        Ok(u16::from_le_bytes(self.array(what)?))
    }

    fn f32(&mut self, what: &'static str) -> Result<f32, HeadFileError> {
        let value = f32::from_le_bytes(self.array(what)?);
        if value.is_finite() {
            Ok(value)
        } else {
            Err(HeadFileError::Value { what })
        }
    }
}

impl HeadAsset {
    /// The head built into the appliance.
    #[must_use]
    pub fn shipped() -> Self {
        Self::parse(include_bytes!("../../../config/simulated.head"))
            .expect("the shipped head is read by a test")
    }

    /// Reads a head.
    ///
    /// # Errors
    /// If the bytes are not a whole, undamaged head.
    pub fn parse(bytes: &[u8]) -> Result<Self, HeadFileError> {
        let (Some(head), Some(body)) = (bytes.get(..HEADER), bytes.get(HEADER..)) else {
            return Err(HeadFileError::NotAHead);
        };
        let word = |at: usize| u32::from_le_bytes(head[at..at + 4].try_into().expect("four bytes"));
        if &head[..8] != MAGIC || word(8) != VERSION {
            return Err(HeadFileError::NotAHead);
        }
        let (expected, found) = (word(12), crc32(body));
        if expected != found {
            return Err(HeadFileError::Checksum { expected, found });
        }
        let mut reader = Reader { rest: body };
        let what = "vertices";
        let n = usize::from(reader.u16(what)?);
        let mut asset = Self::default();
        let (mut photo, mut share, mut colour) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..n {
            let mut step = || Ok(f32::from(i16::from_le_bytes(reader.array(what)?)));
            asset.neutral.push(Point::new(
                step()? * STEP_M,
                step()? * STEP_M,
                step()? * STEP_M,
            ));
            photo.push([step()? * STEP_PX, step()? * STEP_PX]);
            let [s, r, g, b] = reader.array(what)?.map(f32::from);
            share.push(s / 255.0);
            colour.push([r, g, b]);
        }
        let what = "triangles";
        let index = |reader: &mut Reader, what| {
            let v = reader.u16(what)?;
            if usize::from(v) < n {
                Ok(u32::from(v))
            } else {
                Err(HeadFileError::Value { what })
            }
        };
        let (mut triangles, mut parts) = (Vec::new(), Vec::new());
        for _ in 0..reader.u16(what)? {
            triangles.push([
                index(&mut reader, what)?,
                index(&mut reader, what)?,
                index(&mut reader, what)?,
            ]);
            let [part] = reader.array(what)?;
            parts.push(Part::from_index(part).ok_or(HeadFileError::Value { what })?);
        }
        let what = "landmarks";
        let mut landmarks = Vec::new();
        for _ in 0..LANDMARKS {
            landmarks.push(Site {
                vertices: [
                    index(&mut reader, what)?,
                    index(&mut reader, what)?,
                    index(&mut reader, what)?,
                ],
                shares: [reader.f32(what)?, reader.f32(what)?, reader.f32(what)?],
            });
        }
        let what = "expressions";
        let mut expressions = Vec::new();
        for _ in 0..reader.u16(what)? {
            let [length] = reader.array(what)?;
            let name = std::str::from_utf8(reader.take(usize::from(length), what)?)
                .map_err(|_| HeadFileError::Value { what })?
                .to_owned();
            let step = reader.f32(what)?;
            let (mut vertices, mut offsets) = (Vec::new(), Vec::new());
            for _ in 0..reader.u16(what)? {
                vertices.push(index(&mut reader, what)?);
                let [x, y, z] = reader.array(what)?.map(|b: u8| f32::from(b as i8) * step);
                offsets.push(Vector::new(x, y, z));
            }
            expressions.push(Expression {
                name,
                vertices,
                offsets,
            });
        }
        let what = "photograph";
        let (width, height) = (
            usize::from(reader.u16(what)?),
            usize::from(reader.u16(what)?),
        );
        let rgb = reader.take(width * height * 3, what)?.to_vec();
        if !reader.rest.is_empty() {
            return Err(HeadFileError::Length { what });
        }
        asset.triangles = triangles.into();
        asset.parts = parts.into();
        asset.photo = photo.into();
        asset.photo_share = share.into();
        asset.colour = colour.into();
        asset.landmarks = landmarks.into();
        asset.expressions = expressions.into();
        asset.texture = Texture { width, height, rgb }.levels().into();
        Ok(asset)
    }

    /// The bytes of the file, quantised. At most 65 535 vertices and triangles are written, places within ±0.32 m.
    #[must_use]
    pub fn emit(&self) -> Vec<u8> {
        let mut body = Vec::new();
        let short = |body: &mut Vec<u8>, value: usize| {
            body.extend((value.min(usize::from(u16::MAX)) as u16).to_le_bytes());
        };
        let step = |body: &mut Vec<u8>, value: f32| {
            body.extend((value.round().clamp(-32768.0, 32767.0) as i16).to_le_bytes());
        };
        let byte = |value: f32| (value + 0.5).clamp(0.0, 255.0) as u8;
        short(&mut body, self.neutral.len());
        for v in 0..self.neutral.len() {
            for k in 0..3 {
                step(&mut body, self.neutral[v][k] / STEP_M);
            }
            for k in 0..2 {
                step(&mut body, self.photo[v][k] / STEP_PX);
            }
            body.push(byte(self.photo_share[v] * 255.0));
            body.extend(self.colour[v].map(byte));
        }
        short(&mut body, self.triangles.len());
        for (triangle, &part) in self.triangles.iter().zip(self.parts.iter()) {
            for &v in triangle {
                short(&mut body, v as usize);
            }
            body.push(part as u8);
        }
        for site in self.landmarks.iter() {
            for v in site.vertices {
                short(&mut body, v as usize);
            }
            for share in site.shares {
                body.extend(share.to_le_bytes());
            }
        }
        short(&mut body, self.expressions.len());
        for expression in self.expressions.iter() {
            body.push(expression.name.len().min(255) as u8);
            body.extend(expression.name.bytes().take(255));
            let largest = expression
                .offsets
                .iter()
                .map(Vector::amax)
                .fold(1e-9, f32::max);
            let unit = largest / 127.0;
            body.extend(unit.to_le_bytes());
            let moved: Vec<(u32, [i8; 3])> = expression
                .vertices
                .iter()
                .zip(&expression.offsets)
                .map(|(&v, o)| (v, [0, 1, 2].map(|k| (o[k] / unit).round() as i8)))
                .filter(|(_, o)| *o != [0; 3])
                .collect();
            short(&mut body, moved.len());
            for (v, offset) in moved {
                short(&mut body, v as usize);
                body.extend(offset.map(|o| o as u8));
            }
        }
        let empty = Texture::default();
        let photograph = self.texture.first().unwrap_or(&empty);
        short(&mut body, photograph.width);
        short(&mut body, photograph.height);
        body.extend(&photograph.rgb);
        let mut bytes = MAGIC.to_vec();
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend(crc32(&body).to_le_bytes());
        bytes.extend(body);
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_again() {
        let shipped = HeadAsset::shipped();
        assert!(shipped.landmarks.len() == LANDMARKS && shipped.neutral.len() > 1000);
        assert_eq!(HeadAsset::parse(&shipped.emit()), Ok(shipped));
    }

    #[test]
    fn no_bytes_cause_a_panic() {
        let bytes = HeadAsset::shipped().emit();
        for length in [0, 5, 15, 16, 17, 18, 40, 5000, bytes.len() - 1] {
            assert!(HeadAsset::parse(&bytes[..length]).is_err());
        }
        let mut rng = fastrand::Rng::with_seed(3);
        for _ in 0..300 {
            let mut bad = bytes.clone();
            for _ in 0..1 + rng.usize(..4) {
                let at = 16 + rng.usize(..bad.len() - 16).min(rng.usize(..bad.len() - 16));
                bad[at] = rng.u8(..);
            }
            // The checksum says so; with a checksum to match, the counts and indices must.
            assert!(
                bad == bytes
                    || matches!(HeadAsset::parse(&bad), Err(HeadFileError::Checksum { .. }))
            );
            let sum = crc32(&bad[HEADER..]);
            bad[12..16].copy_from_slice(&sum.to_le_bytes());
            if let Ok(head) = HeadAsset::parse(&bad) {
                let n = head.neutral.len() as u32;
                assert!(head.triangles.iter().flatten().all(|&v| v < n));
                assert!(
                    head.expressions
                        .iter()
                        .flat_map(|e| &e.vertices)
                        .all(|&v| v < n)
                );
            }
        }
    }
}
