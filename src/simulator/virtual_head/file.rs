//! The file of a head: `MIENHEAD`, version, CRC-32 of the rest (little endian), then counts and arrays, quantised, as
//! numbers of an adaptive range coder (`range`): differences to the neighbour before, in contexts by array and axis.
//! Nothing is lost by the coding; the arrays themselves would be three times as long.
//!
//! Places in steps of 10 µm, offsets of an expression in 1/127 of its largest, the photograph in bytes. The truth
//! of a simulation comes from the head as read, so quantisation is no error. A file is believed only if its checksum is right,
//! and even then every count and index is checked: any bytes give a head or one sentence.
//! Reading and writing are the same lines, so that they cannot differ.

use std::ops::RangeInclusive;

use crate::base::capacity::LANDMARKS;
use crate::base::checksum::crc32;
use crate::base::geometry::{Point, Vector};

use super::asset::{Expression, HeadAsset, Part, Site, Texture};
#[cfg(any(test, feature = "studio"))]
use super::range::Encoder;
use super::range::{Coder, Decoder};

const MAGIC: &[u8; 8] = b"MIENHEAD";
const VERSION: u32 = 2;
const HEADER: usize = 16;
/// Metres per step of a place.
const STEP_M: f32 = 1e-5;
/// Pixels per step of a place in the photograph.
const STEP_PX: f32 = 1.0 / 32.0;

/// Why bytes are not a head: in what of the file they go wrong.
#[derive(Debug, PartialEq, thiserror::Error)]
#[error(
    "not a whole head file of MIENHEAD version {VERSION}: wrong {0}; make it again with mien-studio"
)]
pub struct HeadFileError(&'static str);

/// Contexts of the coder; those of several axes take as many.
mod context {
    pub(super) const COUNT: usize = 0;
    /// Of a vertex: place, place in the photograph, share of it, colour.
    pub(super) const VERTEX: usize = 1;
    pub(super) const CORNER: usize = 10;
    pub(super) const PART: usize = 13;
    pub(super) const BYTE: usize = 14;
    pub(super) const SITE: usize = 15;
    pub(super) const GAP: usize = 16;
    /// By axis, and by how much the offset before differed from its own.
    pub(super) const OFFSET: usize = 17;
    /// By channel, and by how rough the photograph is around.
    pub(super) const PIXEL: usize = 29;
}
/// Steps of roughness that have a context of their own.
const ROUGH: usize = 4;
/// Most vertices and triangles.
const SHORT: i32 = u16::MAX as i32;
/// Most pixels of a photograph in one direction.
const LARGEST: i32 = 4096;
/// Most expressions, and letters of a name.
const MOST: i32 = 255;
/// Values of a byte.
const BYTE: RangeInclusive<i32> = 0..=255;

fn rough(difference: i32, steps: [i32; ROUGH - 1]) -> usize {
    let size = difference.abs();
    steps.iter().filter(|&&step| size > step).count()
}

/// What the neighbours before and above say of a pixel's channel (LOCO-I; Weinberger, Seroussi & Sapiro 2000), and how
/// rough it is there. Green as it is, red and blue as differences to it.
fn predicted(rgb: &[i32], width: usize, at: usize, channel: usize) -> (i32, usize) {
    let (row, col) = (at / width, at % width);
    let value = |at: usize| {
        let (value, green) = (rgb[3 * at + channel], rgb[3 * at + 1]);
        if channel == 1 { green } else { value - green }
    };
    let left = if col > 0 { value(at - 1) } else { 0 };
    let above = if row > 0 { value(at - width) } else { left };
    let corner = if row > 0 && col > 0 {
        value(at - width - 1)
    } else {
        above
    };
    let left = if col > 0 { left } else { above };
    let guess = (left + above - corner).clamp(left.min(above), left.max(above));
    let around = (left - corner).abs() + (above - corner).abs();
    (guess, rough(around, [2, 6, 16]))
}

/// Order of the channels: green first, since the others lean on it.
const CHANNELS: [usize; 3] = [1, 0, 2];

/// A file being read or written: each array is a function that hands every number of the head on to the coder, and keeps what
/// the coder gives back.
struct File<C> {
    coder: C,
    /// The array in work, for messages.
    what: &'static str,
}

impl<C: Coder> File<C> {
    /// A number that differs from the one before, and must be in a range.
    fn next(
        &mut self,
        context: usize,
        number: i32,
        before: i32,
        range: RangeInclusive<i32>,
    ) -> Result<i32, HeadFileError> {
        let what = self.what;
        let number = before + self.coder.number(context, number - before);
        let fits = range.contains(&number) && !self.coder.is_cut_short();
        fits.then_some(number).ok_or(HeadFileError(what))
    }

    fn count(&mut self, count: usize, most: i32) -> Result<usize, HeadFileError> {
        let count = i32::try_from(count).unwrap_or(i32::MAX);
        Ok(self.next(context::COUNT, count, 0, 0..=most)? as usize)
    }

    /// A vertex of `n`, by its number.
    fn vertex(
        &mut self,
        context: usize,
        vertex: &mut u32,
        before: i32,
        n: usize,
    ) -> Result<(), HeadFileError> {
        let number = self.next(context, vertex.cast_signed(), before, 0..=n as i32 - 1)?;
        *vertex = number.cast_unsigned();
        Ok(())
    }

    fn f32(&mut self, value: &mut f32) -> Result<(), HeadFileError> {
        let mut bytes = value.to_le_bytes();
        for byte in &mut bytes {
            *byte = self.next(context::BYTE, (*byte).into(), 0, BYTE)? as u8;
        }
        *value = f32::from_le_bytes(bytes);
        let what = self.what;
        let fits = value.is_finite();
        fits.then_some(()).ok_or(HeadFileError(what))
    }

    fn head(&mut self, asset: &mut HeadAsset) -> Result<(), HeadFileError> {
        let n = self.vertices(asset)?;
        self.triangles(n, asset)?;
        self.landmarks(n, asset)?;
        self.expressions(n, asset)?;
        self.photograph(asset)
    }

    /// The vertices; how many.
    fn vertices(&mut self, asset: &mut HeadAsset) -> Result<usize, HeadFileError> {
        self.what = "vertices";
        let n = self.count(asset.neutral.len(), SHORT)?;
        let (mut photo, mut share) = (asset.photo.to_vec(), asset.photo_share.to_vec());
        let mut colour = asset.colour.to_vec();
        asset.neutral.resize(n, Point::origin());
        photo.resize(n, [0.0; 2]);
        share.resize(n, 0.0);
        colour.resize(n, [0.0; 3]);
        let step = |value: f32| value.round().clamp(-32768.0, 32767.0) as i32;
        let byte = |value: f32| i32::from((value + 0.5).clamp(0.0, 255.0) as u8);
        let mut before = [0; 9];
        for v in 0..n {
            let [x, y, z] = asset.neutral[v].coords.map(|c| step(c / STEP_M)).into();
            let [left, top] = photo[v].map(|c| step(c / STEP_PX));
            let [r, g, b] = colour[v].map(byte);
            let now = [x, y, z, left, top, byte(share[v] * 255.0), r, g, b];
            for (k, (before, now)) in before.iter_mut().zip(now).enumerate() {
                let range = if k < 5 { -32768..=32767 } else { BYTE };
                *before = self.next(context::VERTEX + k, now, *before, range)?;
            }
            let [x, y, z, left, top, s, r, g, b] = before.map(|step| step as f32);
            asset.neutral[v] = Point::new(x * STEP_M, y * STEP_M, z * STEP_M);
            photo[v] = [left * STEP_PX, top * STEP_PX];
            share[v] = s / 255.0;
            colour[v] = [r, g, b];
        }
        asset.photo = photo.into();
        asset.photo_share = share.into();
        asset.colour = colour.into();
        Ok(n)
    }

    /// Triangles of `n` vertices, and what each is part of.
    fn triangles(&mut self, n: usize, asset: &mut HeadAsset) -> Result<(), HeadFileError> {
        self.what = "triangles";
        let (mut triangles, mut parts) = (asset.triangles.to_vec(), asset.parts.to_vec());
        let count = self.count(triangles.len(), SHORT)?;
        triangles.resize(count, [0; 3]);
        parts.resize(count, Part::Skin);
        let (mut first, mut kind) = (0, 0);
        for (corners, part) in triangles.iter_mut().zip(&mut parts) {
            let mut before = first;
            for (k, vertex) in corners.iter_mut().enumerate() {
                self.vertex(context::CORNER + k, vertex, before, n)?;
                before = vertex.cast_signed();
            }
            first = corners[0].cast_signed();
            kind = self.next(context::PART, *part as i32, kind, BYTE)?;
            let known = Part::ALL.get(kind as usize).copied();
            *part = known.ok_or(HeadFileError(self.what))?;
        }
        asset.triangles = triangles.into();
        asset.parts = parts.into();
        Ok(())
    }

    /// Where the landmarks are on `n` vertices.
    fn landmarks(&mut self, n: usize, asset: &mut HeadAsset) -> Result<(), HeadFileError> {
        self.what = "landmarks";
        let mut landmarks = asset.landmarks.to_vec();
        landmarks.resize(LANDMARKS, Site::vertex(0));
        for site in &mut landmarks {
            for vertex in &mut site.vertices {
                self.vertex(context::SITE, vertex, 0, n)?;
            }
            for share in &mut site.shares {
                self.f32(share)?;
            }
        }
        asset.landmarks = landmarks.into();
        Ok(())
    }

    /// How expressions move some of `n` vertices.
    fn expressions(&mut self, n: usize, asset: &mut HeadAsset) -> Result<(), HeadFileError> {
        self.what = "expressions";
        let mut expressions = asset.expressions.to_vec();
        let none = || Expression {
            name: String::new(),
            vertices: Vec::new(),
            offsets: Vec::new(),
        };
        expressions.resize_with(self.count(expressions.len(), MOST)?, none);
        for expression in &mut expressions {
            self.expression(n, expression)?;
        }
        asset.expressions = expressions.into();
        Ok(())
    }

    fn expression(&mut self, n: usize, expression: &mut Expression) -> Result<(), HeadFileError> {
        let mut name = std::mem::take(&mut expression.name).into_bytes();
        name.resize(self.count(name.len(), MOST)?, 0);
        for letter in &mut name {
            *letter = self.next(context::BYTE, (*letter).into(), 0, BYTE)? as u8;
        }
        let what = self.what;
        expression.name = String::from_utf8(name).map_err(|_| HeadFileError(what))?;
        let largest = expression.offsets.iter().map(Vector::amax);
        let mut unit = largest.fold(1e-9, f32::max) / 127.0;
        self.f32(&mut unit)?;
        let steps = expression.vertices.iter().zip(&expression.offsets);
        let steps = steps.map(|(&v, o)| (v, [0, 1, 2].map(|k| (o[k] / unit).round() as i32)));
        let mut moved: Vec<(u32, [i32; 3])> = steps.filter(|(_, o)| *o != [0; 3]).collect();
        moved.resize(self.count(moved.len(), n as i32)?, (0, [0; 3]));
        let (mut vertex, mut before, mut changes) = (-1, [0; 3], [0; 3]);
        for (v, offset) in &mut moved {
            self.vertex(context::GAP, v, vertex + 1, n)?;
            vertex = v.cast_signed();
            for k in 0..3 {
                let context = context::OFFSET + ROUGH * k + rough(changes[k], [0, 2, 8]);
                offset[k] = self.next(context, offset[k], before[k], -128..=127)?;
                changes[k] = offset[k] - before[k];
            }
            before = *offset;
        }
        expression.vertices = moved.iter().map(|&(v, _)| v).collect();
        let offsets = moved.iter();
        let offsets = offsets.map(|(_, o)| Vector::from(o.map(|step| step as f32 * unit)));
        expression.offsets = offsets.collect();
        Ok(())
    }

    /// The photograph, level by level from what is left of and above it.
    fn photograph(&mut self, asset: &mut HeadAsset) -> Result<(), HeadFileError> {
        self.what = "photograph";
        let photograph = asset.texture.first().cloned().unwrap_or_default();
        let width = self.count(photograph.width, LARGEST)?;
        let height = self.count(photograph.height, LARGEST)?;
        let mut levels: Vec<i32> = Vec::new();
        for at in 0..width * height {
            // Grown as it is read, so that a false size is found out before it costs memory.
            levels.resize(3 * (at + 1), 0);
            for channel in CHANNELS {
                let k = 3 * at + channel;
                let level = photograph.rgb.get(k).copied().unwrap_or_default();
                let (guess, rough) = predicted(&levels, width, at, channel);
                let base = if channel == 1 { 0 } else { levels[3 * at + 1] };
                let context = context::PIXEL + ROUGH * channel + rough;
                levels[k] = self.next(context, level.into(), base + guess, BYTE)?;
            }
        }
        let rgb = levels.into_iter().map(|level| level as u8).collect();
        asset.texture = Texture { width, height, rgb }.levels().into();
        Ok(())
    }
}

/// What follows the header, if it is whole.
fn checked(bytes: &[u8]) -> Result<&[u8], HeadFileError> {
    let (head, body) = bytes
        .split_at_checked(HEADER)
        .ok_or(HeadFileError("length"))?;
    let word = |at: usize| u32::from_le_bytes(head[at..at + 4].try_into().expect("four bytes"));
    if &head[..8] != MAGIC || word(8) != VERSION {
        return Err(HeadFileError("beginning"));
    }
    let intact = word(12) == crc32(body);
    intact.then_some(body).ok_or(HeadFileError("checksum"))
}

impl HeadAsset {
    /// The head built into the appliance.
    pub fn shipped() -> Self {
        Self::parse(include_bytes!("../../../config/simulated.head"))
            .expect("the shipped head is read by a test")
    }

    /// Reads a head.
    ///
    /// # Errors
    /// If the bytes are not a whole, undamaged head.
    pub fn parse(bytes: &[u8]) -> Result<Self, HeadFileError> {
        let mut file = File {
            coder: Decoder::new(checked(bytes)?),
            what: "header",
        };
        let mut asset = Self::default();
        file.head(&mut asset)?;
        let whole = file.coder.is_finished();
        let what = file.what;
        whole.then_some(asset).ok_or(HeadFileError(what))
    }

    /// The bytes of the file, quantised; places within ±0.32 m.
    ///
    /// # Panics
    /// With more than 65 535 vertices or triangles, 255 expressions or 4096 columns or rows of the photograph.
    #[cfg(any(test, feature = "studio"))]
    pub fn emit(&self) -> Vec<u8> {
        let mut file = File {
            coder: Encoder::new(),
            what: "header",
        };
        let written = file.head(&mut self.clone());
        written.expect("a head that the file has room for");
        let body = file.coder.finish();
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
            assert!(bad == bytes || HeadAsset::parse(&bad) == Err(HeadFileError("checksum")));
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
