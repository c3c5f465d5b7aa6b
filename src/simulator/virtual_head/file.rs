//! The file of a head: `MIENHEAD`, version, CRC-32 of the rest (little endian), then counts and arrays, quantised, as
//! numbers of an adaptive range coder (`range`): differences to the neighbour before, in contexts by array and axis.
//! Nothing is lost by the coding; the arrays themselves would be three times as long.
//!
//! Places in steps of 10 µm, offsets of an expression in 1/127 of its largest, the photograph in bytes. The truth
//! of a simulation comes from the head as read, so quantisation is no error. A file is believed only if its checksum is right,
//! and even then every count and index is checked: any bytes give a head or one sentence.
//! One file: what is written is read by the lines beside it.

use crate::base::capacity::LANDMARKS;
use crate::base::checksum::crc32;
use crate::base::geometry::{Point, Vector};

use super::asset::{Expression, HeadAsset, Part, Site, Texture};
use super::range::Decoder;
#[cfg(any(test, feature = "studio"))]
use super::range::Encoder;

const MAGIC: &[u8; 8] = b"MIENHEAD";
const VERSION: u32 = 2;
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

fn rough(difference: i32, steps: [i32; ROUGH - 1]) -> usize {
    steps
        .iter()
        .filter(|&&step| difference.abs() > step)
        .count()
}

/// What the neighbours before and above say of a pixel's channel (LOCO-I; Weinberger, Seroussi & Sapiro 2000), and how
/// rough it is there. Green as it is, red and blue as differences to it.
fn predicted(rgb: &[i32], width: usize, at: usize, channel: usize) -> (i32, usize) {
    let (row, col) = (at / width, at % width);
    let value = |at: usize| {
        let green = rgb[3 * at + 1];
        if channel == 1 {
            green
        } else {
            rgb[3 * at + channel] - green
        }
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
    (
        guess,
        rough((left - corner).abs() + (above - corner).abs(), [2, 6, 16]),
    )
}

/// Order of the channels: green first, since the others lean on it.
const CHANNELS: [usize; 3] = [1, 0, 2];

struct Reader<'a> {
    numbers: Decoder<'a>,
}

impl Reader<'_> {
    fn number(&mut self, context: usize, what: &'static str) -> Result<i32, HeadFileError> {
        let number = self.numbers.number(context);
        if self.numbers.cut_short() {
            Err(HeadFileError::Length { what })
        } else {
            Ok(number)
        }
    }

    /// A number that differs from the one before, and must be in a range.
    fn next(
        &mut self,
        context: usize,
        before: i32,
        range: std::ops::RangeInclusive<i32>,
        what: &'static str,
    ) -> Result<i32, HeadFileError> {
        let number = before + self.number(context, what)?;
        if range.contains(&number) {
            Ok(number)
        } else {
            Err(HeadFileError::Value { what })
        }
    }

    fn f32(&mut self, what: &'static str) -> Result<f32, HeadFileError> {
        let mut bytes = [0; 4];
        for byte in &mut bytes {
            *byte = self.next(context::BYTE, 0, 0..=255, what)? as u8;
        }
        let value = f32::from_le_bytes(bytes);
        if value.is_finite() {
            Ok(value)
        } else {
            Err(HeadFileError::Value { what })
        }
    }

    /// The vertices; how many.
    fn vertices(&mut self, asset: &mut HeadAsset) -> Result<i32, HeadFileError> {
        let what = "vertices";
        let n = self.next(context::COUNT, 0, 0..=SHORT, what)?;
        let (mut photo, mut share, mut colour) = (Vec::new(), Vec::new(), Vec::new());
        let mut before = [0; 9];
        for _ in 0..n {
            for (k, slot) in before.iter_mut().enumerate() {
                let range = if k < 5 { -32768..=32767 } else { 0..=255 };
                *slot = self.next(context::VERTEX + k, *slot, range, what)?;
            }
            let [x, y, z, u, v, s, r, g, b] = before.map(|step| step as f32);
            asset
                .neutral
                .push(Point::new(x * STEP_M, y * STEP_M, z * STEP_M));
            photo.push([u * STEP_PX, v * STEP_PX]);
            share.push(s / 255.0);
            colour.push([r, g, b]);
        }
        asset.photo = photo.into();
        asset.photo_share = share.into();
        asset.colour = colour.into();
        Ok(n)
    }

    /// Triangles of `n` vertices, and what each is part of.
    fn triangles(&mut self, n: i32, asset: &mut HeadAsset) -> Result<(), HeadFileError> {
        let what = "triangles";
        let (mut triangles, mut parts) = (Vec::new(), Vec::new());
        let (mut corner, mut part) = (0, 0);
        for _ in 0..self.next(context::COUNT, 0, 0..=SHORT, what)? {
            let mut corners = [0; 3];
            let mut before = corner;
            for (k, slot) in corners.iter_mut().enumerate() {
                before = self.next(context::CORNER + k, before, 0..=n - 1, what)?;
                *slot = before.cast_unsigned();
            }
            corner = corners[0].cast_signed();
            triangles.push(corners);
            part = self.next(context::PART, part, 0..=255, what)?;
            parts.push(Part::from_index(part as u8).ok_or(HeadFileError::Value { what })?);
        }
        asset.triangles = triangles.into();
        asset.parts = parts.into();
        Ok(())
    }

    /// Where the landmarks are on `n` vertices.
    fn landmarks(&mut self, n: i32) -> Result<Vec<Site>, HeadFileError> {
        let what = "landmarks";
        let mut landmarks = Vec::new();
        for _ in 0..LANDMARKS {
            let mut site = Site::vertex(0);
            for v in &mut site.vertices {
                *v = self
                    .next(context::SITE, 0, 0..=n - 1, what)?
                    .cast_unsigned();
            }
            for share in &mut site.shares {
                *share = self.f32(what)?;
            }
            landmarks.push(site);
        }
        Ok(landmarks)
    }

    /// How expressions move some of `n` vertices.
    fn expressions(&mut self, n: i32) -> Result<Vec<Expression>, HeadFileError> {
        let what = "expressions";
        let mut expressions = Vec::new();
        for _ in 0..self.next(context::COUNT, 0, 0..=MOST, what)? {
            let mut name = Vec::new();
            for _ in 0..self.next(context::COUNT, 0, 0..=MOST, what)? {
                name.push(self.next(context::BYTE, 0, 0..=255, what)? as u8);
            }
            let name = String::from_utf8(name).map_err(|_| HeadFileError::Value { what })?;
            let step = self.f32(what)?;
            let (mut vertices, mut offsets) = (Vec::new(), Vec::new());
            let (mut vertex, mut offset, mut changes) = (-1, [0; 3], [0; 3]);
            for _ in 0..self.next(context::COUNT, 0, 0..=n, what)? {
                vertex = self.next(context::GAP, vertex + 1, 0..=n - 1, what)?;
                vertices.push(vertex.cast_unsigned());
                for (k, slot) in offset.iter_mut().enumerate() {
                    let context = context::OFFSET + ROUGH * k + rough(changes[k], [0, 2, 8]);
                    let next = self.next(context, *slot, -128..=127, what)?;
                    changes[k] = next - *slot;
                    *slot = next;
                }
                let [x, y, z] = offset.map(|o| o as f32 * step);
                offsets.push(Vector::new(x, y, z));
            }
            expressions.push(Expression {
                name,
                vertices,
                offsets,
            });
        }
        Ok(expressions)
    }

    /// The photograph, level by level from what is left of and above it.
    fn photograph(&mut self) -> Result<Texture, HeadFileError> {
        let what = "photograph";
        let width = self.next(context::COUNT, 0, 0..=LARGEST, what)? as usize;
        let height = self.next(context::COUNT, 0, 0..=LARGEST, what)? as usize;
        let mut levels = Vec::new();
        for at in 0..width * height {
            // Grown as it is read, so that a false size is found out before it costs memory.
            levels.resize(3 * (at + 1), 0);
            for channel in CHANNELS {
                let (guess, rough) = predicted(&levels, width, at, channel);
                let base = if channel == 1 { 0 } else { levels[3 * at + 1] };
                let context = context::PIXEL + ROUGH * channel + rough;
                levels[3 * at + channel] = self.next(context, base + guess, 0..=255, what)?;
            }
        }
        let rgb = levels.into_iter().map(|level| level as u8).collect();
        Ok(Texture { width, height, rgb })
    }
}

/// What follows the header, if it is whole.
fn checked(bytes: &[u8]) -> Result<&[u8], HeadFileError> {
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
    Ok(body)
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
        let mut reader = Reader {
            numbers: Decoder::new(checked(bytes)?),
        };
        let mut asset = Self::default();
        let n = reader.vertices(&mut asset)?;
        reader.triangles(n, &mut asset)?;
        asset.landmarks = reader.landmarks(n)?.into();
        asset.expressions = reader.expressions(n)?.into();
        let photograph = reader.photograph()?;
        if !reader.numbers.finished() {
            return Err(HeadFileError::Length { what: "photograph" });
        }
        asset.texture = photograph.levels().into();
        Ok(asset)
    }

    /// The bytes of the file, quantised. At most 65 535 vertices and triangles are written, places within ±0.32 m.
    #[cfg(any(test, feature = "studio"))]
    #[must_use]
    pub fn emit(&self) -> Vec<u8> {
        let mut out = Encoder::new();
        self.emit_vertices(&mut out);
        self.emit_triangles(&mut out);
        for site in self.landmarks.iter() {
            for v in site.vertices {
                out.number(context::SITE, short(v as usize));
            }
            for share in site.shares {
                float(&mut out, share);
            }
        }
        out.number(context::COUNT, short(self.expressions.len()));
        for expression in self.expressions.iter() {
            emit_expression(expression, &mut out);
        }
        self.emit_photograph(&mut out);
        let body = out.finish();
        let mut bytes = MAGIC.to_vec();
        bytes.extend(VERSION.to_le_bytes());
        bytes.extend(crc32(&body).to_le_bytes());
        bytes.extend(body);
        bytes
    }

    #[cfg(any(test, feature = "studio"))]
    fn emit_vertices(&self, out: &mut Encoder) {
        let step = |value: f32| value.round().clamp(-32768.0, 32767.0) as i32;
        let byte = |value: f32| i32::from((value + 0.5).clamp(0.0, 255.0) as u8);
        out.number(context::COUNT, short(self.neutral.len()));
        let mut before = [0; 9];
        for (v, p) in self.neutral.iter().enumerate() {
            let [place, photo] = [
                [p.x, p.y, p.z].map(|c| step(c / STEP_M)),
                [self.photo[v][0], self.photo[v][1], 0.0].map(|c| step(c / STEP_PX)),
            ];
            let [r, g, b] = self.colour[v].map(byte);
            let share = byte(self.photo_share[v] * 255.0);
            let now = [
                place[0], place[1], place[2], photo[0], photo[1], share, r, g, b,
            ];
            for (k, (now, before)) in now.iter().zip(before).enumerate() {
                out.number(context::VERTEX + k, now - before);
            }
            before = now;
        }
    }

    #[cfg(any(test, feature = "studio"))]
    fn emit_triangles(&self, out: &mut Encoder) {
        out.number(context::COUNT, short(self.triangles.len()));
        let (mut corner, mut kind) = (0, 0);
        for (triangle, &part) in self.triangles.iter().zip(self.parts.iter()) {
            let mut before = corner;
            for (k, &v) in triangle.iter().enumerate() {
                out.number(context::CORNER + k, short(v as usize) - before);
                before = short(v as usize);
            }
            corner = short(triangle[0] as usize);
            out.number(context::PART, part as i32 - kind);
            kind = part as i32;
        }
    }

    #[cfg(any(test, feature = "studio"))]
    fn emit_photograph(&self, out: &mut Encoder) {
        let empty = Texture::default();
        let photograph = self.texture.first().unwrap_or(&empty);
        out.number(context::COUNT, photograph.width as i32);
        out.number(context::COUNT, photograph.height as i32);
        let levels: Vec<i32> = photograph.rgb.iter().map(|&level| level.into()).collect();
        for at in 0..photograph.width * photograph.height {
            for channel in CHANNELS {
                let (guess, rough) = predicted(&levels, photograph.width, at, channel);
                let base = if channel == 1 { 0 } else { levels[3 * at + 1] };
                let context = context::PIXEL + ROUGH * channel + rough;
                out.number(context, levels[3 * at + channel] - base - guess);
            }
        }
    }
}

/// A count or an index, of as many as can be written.
#[cfg(any(test, feature = "studio"))]
fn short(value: usize) -> i32 {
    value.min(usize::from(u16::MAX)) as i32
}

#[cfg(any(test, feature = "studio"))]
fn float(out: &mut Encoder, value: f32) {
    for byte in value.to_le_bytes() {
        out.number(context::BYTE, byte.into());
    }
}

#[cfg(any(test, feature = "studio"))]
fn emit_expression(expression: &Expression, out: &mut Encoder) {
    let name: Vec<u8> = expression.name.bytes().take(MOST as usize).collect();
    out.number(context::COUNT, short(name.len()));
    for letter in name {
        out.number(context::BYTE, letter.into());
    }
    let largest = expression
        .offsets
        .iter()
        .map(Vector::amax)
        .fold(1e-9, f32::max);
    let unit = largest / 127.0;
    float(out, unit);
    let moved: Vec<(i32, [i32; 3])> = expression
        .vertices
        .iter()
        .zip(&expression.offsets)
        .map(|(&v, o)| (v as i32, [0, 1, 2].map(|k| (o[k] / unit).round() as i32)))
        .filter(|(_, o)| *o != [0; 3])
        .collect();
    out.number(context::COUNT, short(moved.len()));
    let (mut vertex, mut before, mut changes) = (-1, [0; 3], [0; 3]);
    for (v, offset) in moved {
        out.number(context::GAP, v - (vertex + 1));
        vertex = v;
        for k in 0..3 {
            let context = context::OFFSET + ROUGH * k + rough(changes[k], [0, 2, 8]);
            changes[k] = offset[k] - before[k];
            out.number(context, changes[k]);
        }
        before = offset;
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
