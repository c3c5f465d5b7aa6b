//! Little-endian values of one section of a model file, each checked as it is taken.

use super::error::ModelError;
use crate::base::geometry::Vector;
use crate::base::prelude::*;

/// Largest magnitude of any number in a model.
const LARGEST: f32 = 1e6;

/// The unread bytes of a section.
#[derive(Clone)]
pub(crate) struct Reader<'a> {
    pub(crate) section: &'static str,
    pub(crate) bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    pub(crate) fn malformed(&self, expected: &'static str, found: f64) -> ModelError {
        ModelError::Malformed(self.section, expected, found)
    }

    pub(crate) fn take(&mut self, count: usize) -> Result<&'a [u8], ModelError> {
        let split = self.bytes.split_at_checked(count);
        let left = self.bytes.len() as f64;
        let (head, tail) = split.ok_or_else(|| self.malformed("more bytes", left))?;
        self.bytes = tail;
        Ok(head)
    }

    /// An unsigned number of `bytes` bytes, at most four.
    pub(crate) fn number(&mut self, bytes: usize) -> Result<usize, ModelError> {
        let digits = self.take(bytes)?.iter().rev();
        Ok(digits.fold(0, |number, &byte| number << 8 | usize::from(byte)))
    }

    /// An unsigned number of `bytes` bytes within limits.
    pub(crate) fn count(
        &mut self,
        bytes: usize,
        limits: core::ops::RangeInclusive<usize>,
        expected: &'static str,
    ) -> Result<usize, ModelError> {
        let found = self.number(bytes)?;
        let fits = limits.contains(&found).then_some(found);
        fits.ok_or_else(|| self.malformed(expected, found as f64))
    }

    fn floats_that(
        &mut self,
        count: usize,
        expected: &'static str,
        fits: impl Fn(f32) -> bool,
    ) -> Result<Vec<f32>, ModelError> {
        let bytes = self.take(count.saturating_mul(4))?.as_chunks().0;
        let values: Vec<f32> = bytes.iter().map(|b| f32::from_le_bytes(*b)).collect();
        match values.iter().find(|value| !fits(**value)) {
            None => Ok(values),
            Some(bad) => Err(self.malformed(expected, f64::from(*bad))),
        }
    }

    /// Floats of magnitude up to [`LARGEST`], so that sums stay finite.
    pub(crate) fn floats(&mut self, count: usize) -> Result<Vec<f32>, ModelError> {
        self.floats_within(count, LARGEST, "finite numbers within a million")
    }

    /// The same, of 16 bits: see [`Short`].
    pub(crate) fn shorts(&mut self, count: usize) -> Result<Vec<Short>, ModelError> {
        let bytes = self.take(count.saturating_mul(2))?.as_chunks().0.iter();
        let values: Vec<Short> = bytes
            .map(|bytes| Short(u16::from_le_bytes(*bytes)))
            .collect();
        let mut floats = values.iter().map(|value| f32::from(*value));
        let bad = floats.find(|value| value.is_nan() || value.abs() > LARGEST);
        match bad {
            None => Ok(values),
            Some(bad) => Err(self.malformed("finite numbers within a million", f64::from(bad))),
        }
    }

    /// Floats of magnitude up to `most`.
    pub(crate) fn floats_within(
        &mut self,
        count: usize,
        most: f32,
        expected: &'static str,
    ) -> Result<Vec<f32>, ModelError> {
        self.floats_that(count, expected, |value| value.abs() <= most)
    }

    /// Floats above 0, up to [`LARGEST`].
    pub(crate) fn positive(
        &mut self,
        count: usize,
        expected: &'static str,
    ) -> Result<Vec<f32>, ModelError> {
        self.positive_up_to(count, LARGEST, expected)
    }

    /// Floats above 0, up to `most`.
    pub(crate) fn positive_up_to(
        &mut self,
        count: usize,
        most: f32,
        expected: &'static str,
    ) -> Result<Vec<f32>, ModelError> {
        self.floats_that(count, expected, |value| value > 0.0 && value <= most)
    }

    /// Vectors with coordinates of magnitude up to `most`.
    pub(crate) fn vectors_within(
        &mut self,
        count: usize,
        most: f32,
        expected: &'static str,
    ) -> Result<Vec<Vector>, ModelError> {
        let coordinates = self.floats_within(count.saturating_mul(3), most, expected)?;
        Ok(vectors(&coordinates))
    }

    /// Distance of neighbouring cells of a patch, pixels.
    pub(crate) fn cell_px(&mut self) -> Result<f32, ModelError> {
        let expected = "cells 0.1 to 64 pixels apart";
        let cell = self.floats_that(1, expected, |cell| (0.1..=64.0).contains(&cell))?;
        Ok(cell[0])
    }

    /// Checks that no bytes are left.
    pub(crate) fn end(&self) -> Result<(), ModelError> {
        if self.bytes.is_empty() {
            return Ok(());
        }
        Err(self.malformed("no bytes after its end", self.bytes.len() as f64))
    }
}

/// A number stated by the upper 16 bits of a float (bfloat16).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Short(pub(crate) u16);

impl From<f32> for Short {
    /// The nearest one, to half a per cent.
    fn from(value: f32) -> Self {
        Self(((value.to_bits() + 0x8000) >> 16) as u16)
    }
}

impl From<Short> for f32 {
    #[inline(always)]
    fn from(short: Short) -> Self {
        Self::from_bits(u32::from(short.0) << 16)
    }
}

/// Groups values into vectors.
pub(crate) fn vectors(values: &[f32]) -> Vec<Vector> {
    let threes = values.as_chunks::<3>().0.iter();
    threes.map(|three| Vector::from(*three)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_a_tenth_to_sixty_four_pixels_apart() {
        for (cell, fits) in [
            (0.1, true),
            (64.0, true),
            (0.09, false),
            (64.1, false),
            (f32::NAN, false),
        ] {
            let bytes = f32::to_le_bytes(cell);
            let mut reader = Reader {
                section: "CELL",
                bytes: &bytes,
            };
            assert_eq!(reader.cell_px().is_ok(), fits, "{cell}");
        }
    }
}
