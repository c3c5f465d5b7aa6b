//! Code shared by all kinds of recordings: reading picture files, errors, and the count of skipped frames. Formats: PGM (P5) and PPM
//! (P6) of 8 or 16 bit; with the feature `studio` also PNG and JPEG.

use std::io::Read;
use std::path::{Path, PathBuf};

use super::reduction::Reduction;
use mien_stages::base::bounded_read::{self, reason};
use mien_stages::base::capacity::PIXELS;

/// Most bytes of a file besides its pixels.
const HEADER_MAX: usize = 4096;
/// Number of skipped frames that are all logged; after that only at powers of two.
const WARNINGS_IN_FULL: u64 = 10;

/// Why a recording cannot be opened or written: the file and the problem.
#[derive(Debug, thiserror::Error)]
#[error("{}: {}", .0.display(), .1)]
pub struct RecordingError(pub(super) PathBuf, pub(super) String);

impl RecordingError {
    /// The error for a file that cannot be read or written.
    pub(super) fn from_io(path: &Path, problem: &std::io::Error) -> Self {
        let advice = "check the path, its permissions and the free space";
        Self(path.to_owned(), format!("{}; {advice}", reason(problem)))
    }
}

/// Index of the entry nearest to `time` in a list sorted by time; of two equally near the earlier.
pub(super) fn nearest<T>(list: &[T], time: i64, time_of: impl Fn(&T) -> i64) -> Option<usize> {
    let after = list.partition_point(|one| time_of(one) < time);
    let near = after.saturating_sub(1)..list.len().min(after + 1);
    near.min_by_key(|&at| time_of(&list[at]).abs_diff(time))
}

/// Why one frame was skipped.
#[derive(Debug, thiserror::Error)]
pub(super) enum Damage {
    #[error("{0}")]
    Listed(&'static str),
    #[error("cannot be read ({})", reason(.0))]
    Unreadable(#[from] std::io::Error),
    #[error("is not a complete PGM, PPM, PNG or JPEG file")]
    Format,
    #[error("has {} x {} pixels, expected {} x {}", .1[0], .1[1], .0[0], .0[1])]
    Size([usize; 2], [usize; 2]),
    #[error("ends before its last pixel")]
    Short,
    #[error("expected {0}")]
    Kind(&'static str),
    #[error("contains the depth value {0}, expected little-endian raw values of at most 2047")]
    Value(u16),
}

/// Counts skipped frames.
#[derive(Default)]
pub(super) struct Skipped(pub(super) u64);

impl Skipped {
    /// Counts a frame skipped because of `file`, and logs it.
    pub(super) fn add(&mut self, frame: usize, file: &Path, damage: &Damage) {
        self.0 += 1;
        let Self(skipped) = self;
        if *skipped <= WARNINGS_IN_FULL || skipped.is_power_of_two() {
            let file = file.display();
            tracing::warn!("frame {frame} skipped: {file}: {damage} ({skipped} skipped so far)");
        }
    }
}

/// Reused buffers for reading picture files.
pub(super) struct PictureFile {
    bytes: Vec<u8>,
    #[cfg(feature = "studio")]
    decoded: Vec<u8>,
}

/// The pixels of a picture.
pub(super) struct Pixels<'a> {
    columns: usize,
    /// 1 = grey, 3 = RGB.
    pub(super) channels: usize,
    /// Whether values have 16 bits, big endian, instead of 8.
    pub(super) is_16_bit: bool,
    pub(super) body: &'a [u8],
}

impl<'a> Pixels<'a> {
    /// Grey pixels of 8 bits.
    pub(super) fn grey(columns: usize, body: &'a [u8]) -> Self {
        Self {
            columns,
            channels: 1,
            is_16_bit: false,
            body,
        }
    }

    /// The 16-bit value at index `at`.
    pub(super) fn u16_at(&self, at: usize) -> u16 {
        u16::from_be_bytes([self.body[2 * at], self.body[2 * at + 1]])
    }

    /// Luma of one pixel, 0…255; `white`: 16-bit value that becomes 255.
    fn luma(&self, pixel: usize, white: u32) -> u32 {
        let at = pixel * self.channels;
        let value = |at: usize| match self.is_16_bit {
            true => (u32::from(self.u16_at(at)) * 255 / white).min(255),
            false => self.body[at].into(),
        };
        match self.channels {
            1 => value(at),
            // BT.601, as in `kinect::colour`.
            _ => (77 * value(at) + 150 * value(at + 1) + 29 * value(at + 2) + 128) >> 8,
        }
    }

    /// Luma averaged over the blocks of a reduction; the border is repeated beyond its columns and rows.
    pub(super) fn brightness(&self, by: &Reduction, white: u32, luma: &mut [u8; PIXELS]) {
        by.average(luma, |col, row| self.luma(row * self.columns + col, white));
    }
}

impl PictureFile {
    /// Buffers for pictures of up to `bytes` bytes.
    pub(super) fn new(bytes: usize) -> Self {
        Self {
            bytes: Vec::with_capacity(bytes + HEADER_MAX),
            #[cfg(feature = "studio")]
            decoded: Vec::new(),
        }
    }

    /// Reads a picture of `size` columns and rows. Bytes after the last pixel are ignored, as in fakenect.
    ///
    /// # Errors
    /// If the file cannot be read, is damaged, or has another size.
    pub(super) fn read(&mut self, path: &Path, size: [usize; 2]) -> Result<Pixels<'_>, Damage> {
        self.bytes.clear();
        let most = self.bytes.capacity() as u64;
        let file = bounded_read::open_regular(path)?;
        file.take(most).read_to_end(&mut self.bytes)?;
        #[cfg(feature = "studio")]
        if let Ok(format) = image::guess_format(&self.bytes)
            && format != image::ImageFormat::Pnm
        {
            return self.decode(format, size);
        }
        let (header, start) = netpbm(&self.bytes).ok_or(Damage::Format)?;
        let ([channels, columns, rows, most], body) = (header, &self.bytes[start..]);
        pixels(body, channels, most > 255, [columns, rows], size)
    }

    #[cfg(feature = "studio")]
    fn decode(
        &mut self,
        format: image::ImageFormat,
        size: [usize; 2],
    ) -> Result<Pixels<'_>, Damage> {
        use image::{DynamicImage, ImageReader, Limits};
        let bytes = std::io::Cursor::new(&self.bytes);
        let mut reader = ImageReader::with_format(bytes, format);
        let mut limits = Limits::default();
        limits.max_alloc = Some(self.bytes.capacity() as u64 * 2);
        reader.limits(limits);
        let picture = reader.decode().map_err(|_| Damage::Format)?;
        let found = [picture.width(), picture.height()].map(|n| n as usize);
        self.decoded.clear();
        let (channels, is_16_bit) = match picture {
            _ if picture.color().has_color() => {
                self.decoded.extend_from_slice(&picture.into_rgb8());
                (3, false)
            }
            DynamicImage::ImageLuma16(_) | DynamicImage::ImageLumaA16(_) => {
                let values = picture.into_luma16();
                let values = values.iter().flat_map(|value| value.to_be_bytes());
                self.decoded.extend(values);
                (1, true)
            }
            _ => {
                self.decoded.extend_from_slice(&picture.into_luma8());
                (1, false)
            }
        };
        pixels(&self.decoded, channels, is_16_bit, found, size)
    }
}

/// Columns and rows of a picture of unknown size.
///
/// # Errors
/// If the file cannot be read or its header is damaged.
pub(super) fn size_of(path: &Path) -> Result<[usize; 2], Damage> {
    let mut bytes = Vec::new();
    let file = bounded_read::open_regular(path)?;
    file.take(HEADER_MAX as u64).read_to_end(&mut bytes)?;
    if let Some(([_, columns, rows, _], _)) = netpbm(&bytes) {
        return Ok([columns, rows]);
    }
    #[cfg(feature = "studio")]
    {
        let reader = image::ImageReader::open(path)?.with_guessed_format()?;
        let size = reader.into_dimensions().map_err(|_| Damage::Format)?;
        Ok([size.0, size.1].map(|n| n as usize))
    }
    #[cfg(not(feature = "studio"))]
    Err(Damage::Format)
}

fn pixels(
    body: &[u8],
    channels: usize,
    is_16_bit: bool,
    found: [usize; 2],
    expected: [usize; 2],
) -> Result<Pixels<'_>, Damage> {
    if found != expected {
        return Err(Damage::Size(expected, found));
    }
    let columns = found[0];
    let bytes = columns * found[1] * channels * (1 + usize::from(is_16_bit));
    let body = body.get(..bytes).ok_or(Damage::Short)?;
    Ok(Pixels {
        columns,
        channels,
        is_16_bit,
        body,
    })
}

/// Channels, columns, rows and largest value of a PGM or PPM, and the offset of its pixels.
fn netpbm(bytes: &[u8]) -> Option<([usize; 4], usize)> {
    let channels = match bytes.get(..2)? {
        b"P5" => 1,
        b"P6" => 3,
        _ => return None,
    };
    let (mut at, mut header) = (2, [channels, 0, 0, 0]);
    for number in &mut header[1..] {
        while bytes.get(at)?.is_ascii_whitespace() || bytes[at] == b'#' {
            if bytes[at] == b'#' {
                at += bytes[at..].iter().position(|byte| *byte == b'\n')?;
            }
            at += 1;
        }
        let digits = bytes[at..].iter().take_while(|byte| byte.is_ascii_digit());
        let digits = digits.take(6).count();
        let text = std::str::from_utf8(&bytes[at..at + digits]);
        *number = text.ok()?.parse().ok()?;
        at += digits;
    }
    let is_header = bytes.get(at)?.is_ascii_whitespace() && (1..=65535).contains(&header[3]);
    // One whitespace byte ends a header; libfreenect's recorder writes a blank before it.
    let end = 1 + usize::from(bytes[at..].starts_with(b" \n"));
    is_header.then_some((header, at + end))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Frame;
    use mien_stages::base::capacity::WIDTH;

    #[test]
    fn a_header_is_read_however_it_is_spaced_and_anything_else_is_refused() {
        let header = |text: &str| netpbm(text.as_bytes());
        assert_eq!(
            header("P5 640 480 65535\nx"),
            Some(([1, 640, 480, 65535], 17))
        );
        assert_eq!(header("P6\n# by\n4 3\n255\nx"), Some(([3, 4, 3, 255], 16)));
        assert_eq!(header("P6 4 3 255 \nx"), Some(([3, 4, 3, 255], 12)));
        for odd in [
            "",
            "P5",
            "P4 1 1 1\n",
            "P5 1 1 0\n",
            "P5 1 1 99999\n",
            "P5 1 1 255",
            "P5 1 x 255\n",
            "P5 #",
        ] {
            assert_eq!(header(odd), None, "{odd}");
        }
    }

    #[test]
    fn pixels_are_averaged_and_the_border_goes_on() {
        let body: Vec<u8> = (0..16)
            .flat_map(|k| (k as u16 * 1000).to_be_bytes())
            .collect();
        let picture = pixels(&body, 1, true, [4, 4], [4, 4]).unwrap();
        let mut luma = Frame::default().luma;
        let by = |factor| Reduction {
            size: [4, 4],
            factor,
        };
        picture.brightness(&by(2), 15_000, &mut luma);
        // Means of 0 1 4 5 and of 2 3 6 7, each times 17.
        assert_eq!(luma[..4], [42, 76, 76, 76]);
        assert_eq!(luma[WIDTH * 2..][..2], luma[WIDTH..][..2]);
        let colours: Vec<u8> = (0..48).map(|k| if k % 3 == 1 { 200 } else { k }).collect();
        let coloured = pixels(&colours, 3, false, [4, 4], [4, 4]).unwrap();
        coloured.brightness(&by(1), 255, &mut luma);
        // (77 r + 150 · 200 + 29 b) / 256 of r = 0, 3, 6, 9 and b = r + 2.
        assert_eq!(luma[..4], [117, 119, 120, 121]);
        assert!(pixels(&body[1..], 1, true, [4, 4], [4, 4]).is_err());
        assert!(pixels(&body, 1, true, [4, 4], [4, 5]).is_err());
    }
}
