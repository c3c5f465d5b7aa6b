//! The file of a head: `MIENHEAD`, version, CRC-32 of the rest (little endian), then counts and quantised arrays, coded by an
//! adaptive range coder (`range`) as differences to the previous element, in contexts by array and axis. This takes a third of the
//! arrays' size.
//!
//! Resolution: positions 10 µm, offsets of an expression 1/127 of its largest, the photograph 8 bits. The truth of a simulation is
//! computed from the head as read, so quantisation causes no error. Heads are built in, so reading does not validate them. The same
//! code reads and writes, so that both agree.

use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::{Point, Vector};

use super::asset::{Expression, HeadAsset, Part, Site, Texture};
use super::range::Coder;

/// Bytes before the coded data.
const HEADER: usize = 16;
/// Resolution of positions, metres.
const STEP_M: f32 = 1e-5;
/// Resolution of positions in the photograph, pixels.
const STEP_PX: f32 = 1.0 / 32.0;

/// First contexts of the coder by array; arrays with several axes or classes use consecutive ones.
mod context {
    pub(super) const COUNT: usize = 0;
    /// Nine numbers of a vertex: position, position in the photograph, its share, colour.
    pub(super) const VERTEX: usize = 1;
    pub(super) const CORNER: usize = 10;
    pub(super) const PART: usize = 13;
    pub(super) const BYTE: usize = 14;
    pub(super) const SITE: usize = 15;
    pub(super) const GAP: usize = 16;
    /// By axis and roughness class.
    pub(super) const OFFSET: usize = 17;
    /// By channel and roughness class.
    pub(super) const PIXEL: usize = 29;
}
/// Number of roughness classes, each with a context.
const ROUGH: usize = 4;

/// Roughness class of a difference, by ascending thresholds.
fn rough(difference: i32, steps: [i32; ROUGH - 1]) -> usize {
    let size = difference.abs();
    steps.iter().filter(|&&step| size > step).count()
}

/// Prediction of a pixel's channel from the pixels left and above (LOCO-I; Weinberger, Seroussi & Sapiro 2000), and the roughness
/// class. Red and blue are predicted as differences to green.
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

/// Coding order of the channels: green first, because the others are relative to it.
const CHANNELS: [usize; 3] = [1, 0, 2];

/// One function per array: passes each number to the coder and stores its result, which is the number read or written.
impl Coder<'_> {
    /// Codes a number as the difference to the previous one.
    fn next(&mut self, context: usize, number: i32, before: i32) -> i32 {
        before + self.number(context, number - before)
    }

    fn count(&mut self, count: usize) -> usize {
        self.number(context::COUNT, count as i32) as usize
    }

    fn vertex(&mut self, context: usize, vertex: &mut u32, before: i32) {
        let next = self.next(context, vertex.cast_signed(), before);
        *vertex = next.cast_unsigned();
    }

    fn byte(&mut self, byte: &mut u8) {
        *byte = self.number(context::BYTE, (*byte).into()) as u8;
    }

    fn f32(&mut self, value: &mut f32) {
        let mut bytes = value.to_le_bytes();
        bytes.iter_mut().for_each(|byte| self.byte(byte));
        *value = f32::from_le_bytes(bytes);
    }

    fn head(&mut self, asset: &mut HeadAsset) {
        self.vertices(asset);
        self.triangles(asset);
        self.landmarks(asset);
        self.expressions(asset);
        self.photograph(asset);
    }

    fn vertices(&mut self, asset: &mut HeadAsset) {
        let n = self.count(asset.neutral.len());
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
                *before = self.next(context::VERTEX + k, now, *before);
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
    }

    /// The triangles and their parts.
    fn triangles(&mut self, asset: &mut HeadAsset) {
        let (mut triangles, mut parts) = (asset.triangles.to_vec(), asset.parts.to_vec());
        let count = self.count(triangles.len());
        triangles.resize(count, [0; 3]);
        parts.resize(count, Part::Skin);
        let (mut first, mut kind) = (0, 0);
        for (corners, part) in triangles.iter_mut().zip(&mut parts) {
            let mut before = first;
            for (k, vertex) in corners.iter_mut().enumerate() {
                self.vertex(context::CORNER + k, vertex, before);
                before = vertex.cast_signed();
            }
            first = corners[0].cast_signed();
            kind = self.next(context::PART, *part as i32, kind);
            *part = Part::ALL[kind as usize];
        }
        asset.triangles = triangles.into();
        asset.parts = parts.into();
    }

    fn landmarks(&mut self, asset: &mut HeadAsset) {
        let mut landmarks = asset.landmarks.to_vec();
        landmarks.resize(LANDMARKS, Site::vertex(0));
        for site in &mut landmarks {
            for vertex in &mut site.vertices {
                self.vertex(context::SITE, vertex, 0);
            }
            for share in &mut site.shares {
                self.f32(share);
            }
        }
        asset.landmarks = landmarks.into();
    }

    fn expressions(&mut self, asset: &mut HeadAsset) {
        let mut expressions = asset.expressions.to_vec();
        expressions.resize_with(self.count(expressions.len()), Expression::default);
        for expression in &mut expressions {
            self.expression(expression);
        }
        asset.expressions = expressions.into();
    }

    fn expression(&mut self, expression: &mut Expression) {
        let mut name = std::mem::take(&mut expression.name).into_bytes();
        name.resize(self.count(name.len()), 0);
        name.iter_mut().for_each(|letter| self.byte(letter));
        expression.name = String::from_utf8(name).expect("letters");
        let largest = expression.offsets.iter().map(Vector::amax);
        let mut unit = largest.fold(1e-9, f32::max) / 127.0;
        self.f32(&mut unit);
        let steps = expression.vertices.iter().zip(&expression.offsets);
        let steps = steps.map(|(&v, o)| (v, [0, 1, 2].map(|k| (o[k] / unit).round() as i32)));
        let mut moved: Vec<(u32, [i32; 3])> = steps.filter(|(_, o)| *o != [0; 3]).collect();
        moved.resize(self.count(moved.len()), (0, [0; 3]));
        let (mut vertex, mut before, mut changes) = (-1, [0; 3], [0; 3]);
        for (v, offset) in &mut moved {
            self.vertex(context::GAP, v, vertex + 1);
            vertex = v.cast_signed();
            for k in 0..3 {
                let context = context::OFFSET + ROUGH * k + rough(changes[k], [0, 2, 8]);
                offset[k] = self.next(context, offset[k], before[k]);
                changes[k] = offset[k] - before[k];
            }
            before = *offset;
        }
        expression.vertices = moved.iter().map(|&(v, _)| v).collect();
        let offsets = moved.iter();
        let offsets = offsets.map(|(_, o)| Vector::from(o.map(|step| step as f32 * unit)));
        expression.offsets = offsets.collect();
    }

    /// The photograph, each grey level relative to its prediction.
    fn photograph(&mut self, asset: &mut HeadAsset) {
        let photograph = asset.texture.first().cloned().unwrap_or_default();
        let width = self.count(photograph.width);
        let height = self.count(photograph.height);
        let mut levels = vec![0; 3 * width * height];
        for at in 0..width * height {
            for channel in CHANNELS {
                let k = 3 * at + channel;
                let level = photograph.rgb.get(k).copied().unwrap_or_default();
                let (guess, rough) = predicted(&levels, width, at, channel);
                let base = if channel == 1 { 0 } else { levels[3 * at + 1] };
                let context = context::PIXEL + ROUGH * channel + rough;
                levels[k] = self.next(context, level.into(), base + guess);
            }
        }
        let rgb = levels.into_iter().map(|level| level as u8).collect();
        asset.texture = Texture { width, height, rgb }.levels().into();
    }
}

impl HeadAsset {
    /// The built-in head.
    pub fn shipped() -> Self {
        Self::parse(include_bytes!("../../../config/simulated.head"))
    }

    /// Reads a head that [`Self::emit`] wrote.
    pub fn parse(bytes: &[u8]) -> Self {
        let mut asset = Self::default();
        Coder::reading(&bytes[HEADER..]).head(&mut asset);
        asset
    }

    /// The bytes of the file; positions must be within ±0.32 m.
    pub fn emit(&self) -> Vec<u8> {
        let mut coder = Coder::writing();
        coder.head(&mut self.clone());
        let body = coder.finish();
        let mut bytes = b"MIENHEAD\x02\0\0\0".to_vec();
        bytes.extend(mien_stages::base::checksum::crc32(&body).to_le_bytes());
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
        let bytes = shipped.emit();
        assert!(bytes.starts_with(b"MIENHEAD\x02\0\0\0") && HeadAsset::parse(&bytes) == shipped);
    }
}
