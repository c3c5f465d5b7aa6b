//! Pixel formats, the choice of a format and size, and the conversion of images to luma or depth.
//!
//! Chroma is not read. Images larger than a frame are reduced by an integer factor: luma is averaged, depth is subsampled.

use core::cmp::Reverse;
use std::io;
use std::path::Path;

use super::device::{Answer, CameraError, Device, FourCc, Sizes};
use crate::camera::Camera;
use crate::reduction::Reduction;
use mien_stages::base::capacity::{HEIGHT, PIXELS, WIDTH};

/// Smallest frame in which a face can be tracked, columns and rows.
const SMALLEST: [usize; 2] = [320, 240];
/// Largest reduction: image pixels per frame pixel along each side.
const MOST_REDUCED: usize = 4;
/// Maximum number of formats, and of sizes of each, that are listed: a faulty driver's list may not end.
const MOST_LISTED: u32 = 64;

/// A format whose luma or depth is read in place.
#[derive(Debug, PartialEq)]
pub(super) struct PixelFormat {
    pub(super) code: FourCc,
    /// Bytes from the start of a row to its first value, and from one value to the next.
    first: usize,
    step: usize,
    /// Whether planes of chroma with half as many rows follow.
    has_planes: bool,
}

const fn format(code: &FourCc, first: usize, step: usize, has_planes: bool) -> PixelFormat {
    PixelFormat {
        code: *code,
        first,
        step,
        has_planes,
    }
}

/// Supported image formats, preferred ones first: native formats of webcams come before those that a driver converts to.
static LUMA: [PixelFormat; 6] = [
    format(b"YUYV", 0, 2, false),
    format(b"UYVY", 1, 2, false),
    format(b"NV12", 0, 1, true),
    format(b"NV21", 0, 1, true),
    format(b"YU12", 0, 1, true),
    format(b"GREY", 0, 1, false),
];

/// 16-bit depth, little endian.
static DEPTH: [PixelFormat; 1] = [format(b"Z16 ", 0, 2, false)];

/// What is required of a device: one of these formats, preferred ones first, and a size, unless any size will do.
#[derive(Clone, Copy)]
pub(super) struct Want {
    formats: &'static [PixelFormat],
    size: Option<[usize; 2]>,
}

impl Want {
    const fn any_size(formats: &'static [PixelFormat]) -> Self {
        Self {
            formats,
            size: None,
        }
    }

    pub(super) const LUMA: Self = Self::any_size(&LUMA);
    /// Infrared images of a depth camera, from the same viewpoint as its depth.
    pub(super) const INFRARED: Self = Self::any_size(LUMA.split_at(5).1);
    pub(super) const DEPTH: Self = Self::any_size(&DEPTH);

    pub(super) fn of_size(self, size: Option<[usize; 2]>) -> Self {
        Self { size, ..self }
    }

    /// Whether one of these formats will do.
    pub(super) fn is_offered(&self, offered: &[FourCc]) -> bool {
        let mut codes = self.formats.iter().map(|known| known.code);
        codes.any(|code| offered.contains(&code))
    }

    fn rank(&self, choice: &Choice) -> Option<(bool, usize, Reverse<usize>)> {
        let will_do = self.size.is_none_or(|size| size == choice.size);
        choice.rank().filter(|_| will_do)
    }
}

fn name(code: FourCc) -> String {
    String::from_utf8_lossy(&code).trim().to_owned()
}

fn names(codes: impl IntoIterator<Item = FourCc>) -> String {
    let names: Vec<String> = codes.into_iter().map(name).collect();
    names.join(", ")
}

/// A format and one of its sizes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Choice {
    pub(super) format: &'static PixelFormat,
    /// Columns and rows.
    pub(super) size: [usize; 2],
}

impl core::fmt::Display for Choice {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let [columns, rows] = self.size;
        write!(f, "{} {columns} x {rows}", name(self.format.code))?;
        let Reduction { factor, .. } = self.reduction();
        if factor > 1 {
            let [columns, rows] = self.reduction().frame_size();
            write!(f, " reduced by {factor} to {columns} x {rows}")?;
        }
        Ok(())
    }
}

impl Choice {
    fn reduction(&self) -> Reduction {
        Reduction::new(self.size)
    }

    pub(super) fn is_depth(&self) -> bool {
        *self.format == DEPTH[0]
    }

    /// Greater is better. Unreduced sizes come first, then larger frames, then smaller reductions; `None` if the size cannot be used.
    fn rank(&self) -> Option<(bool, usize, Reverse<usize>)> {
        let (reduced, [columns, rows]) = (self.reduction().factor, self.reduction().frame_size());
        let is_usable = columns >= SMALLEST[0] && rows >= SMALLEST[1] && reduced <= MOST_REDUCED;
        is_usable.then_some((reduced == 1, columns * rows, Reverse(reduced)))
    }
}

impl Default for Choice {
    fn default() -> Self {
        Self {
            format: &LUMA[0],
            size: [WIDTH, HEIGHT],
        }
    }
}

/// The largest offered size that is not larger than the one wanted, or else the smallest offered.
fn nearest(wanted: [usize; 2], sizes: Sizes) -> [usize; 2] {
    [0, 1].map(|side| {
        let (least, step) = (sizes.least[side], sizes.step[side].max(1));
        let up_to = wanted[side].min(sizes.most[side] as usize);
        let steps = up_to.saturating_sub(least as usize) / step as usize;
        least as usize + steps * step as usize
    })
}

/// Lists items by index, until an error.
fn all<T>(at: impl Fn(u32) -> io::Result<T>) -> impl Iterator<Item = T> {
    (0..MOST_LISTED).map_while(move |index| at(index).ok())
}

/// The formats of a device.
pub(super) fn formats(device: &impl Device) -> Vec<FourCc> {
    all(|index| device.format(index)).collect()
}

/// The best format and size of a device.
pub(super) fn choose(device: &impl Device, node: &Path, want: Want) -> Result<Choice, CameraError> {
    let offered = formats(device);
    let known = want
        .formats
        .iter()
        .filter(|known| offered.contains(&known.code));
    let known: Vec<&PixelFormat> = known.collect();
    if known.is_empty() {
        let found = match offered.is_empty() {
            true => "no format".to_owned(),
            false => format!("only {}", names(offered)),
        };
        let known = names(want.formats.iter().map(|known| known.code));
        return Err(CameraError::Format(node.to_owned(), found, known));
    }
    let size = want.size.unwrap_or([WIDTH, HEIGHT]);
    let choices = known.iter().rev().flat_map(|&format| {
        let sizes: Vec<Sizes> = all(|index| device.sizes(format.code, index)).collect();
        // A driver that lists no sizes is asked for the one wanted.
        let unlisted = sizes.is_empty().then_some(size);
        let sizes = sizes
            .into_iter()
            .map(move |sizes| nearest(size, sizes))
            .chain(unlisted);
        sizes.map(move |size| Choice { format, size })
    });
    let choices = choices.filter(|choice| want.rank(choice).is_some());
    // Among equal ones the last is taken, which has the preferred format.
    let best = choices.max_by_key(Choice::rank);
    let node = || node.to_owned();
    best.ok_or_else(|| match want.size {
        None => CameraError::Size(node()),
        Some(size) => CameraError::OtherSize(node(), size),
    })
}

/// Where luma or depth lies in a buffer, according to the driver's answer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Layout {
    pub(super) choice: Choice,
    stride: usize,
    /// Bytes of a whole image.
    pub(super) bytes: usize,
}

impl Layout {
    /// Checks a driver's answer to `asked`; the size may differ if any will do.
    ///
    /// # Errors
    /// A sentence that says how the driver contradicts itself.
    pub(super) fn new(want: Want, asked: Choice, answer: Answer) -> Result<Self, &'static str> {
        let format = asked.format;
        let choice = Choice {
            format,
            size: answer.size.map(|pixels| pixels as usize),
        };
        let row = choice.size[0] * format.step;
        let stride = match answer.stride as usize {
            0 => row,
            stride => stride,
        };
        if answer.code != format.code || !answer.whole || want.rank(&choice).is_none() {
            return Err("sets another format or size than those it offers");
        }
        if stride < row {
            return Err("states rows that are shorter than their pixels");
        }
        let rows = choice.size[1];
        let rows = rows + if format.has_planes { rows / 2 } else { 0 };
        // The last row needs no padding.
        let bytes = stride.saturating_mul(rows - 1).saturating_add(row);
        Ok(Self {
            choice,
            stride,
            bytes,
        })
    }

    /// Reads luma from an image of at least [`Self::bytes`] bytes; the rest of a larger frame repeats the image's border.
    pub(super) fn luma(&self, bytes: &[u8], luma: &mut [u8; PIXELS]) {
        let PixelFormat { first, step, .. } = *self.choice.format;
        let pixel = |col, row| u32::from(bytes[row * self.stride + first + col * step]);
        self.choice.reduction().average(luma, pixel);
    }

    /// Reads depth from an image of at least [`Self::bytes`] bytes; 0 means no depth.
    pub(super) fn depth(&self, bytes: &[u8], camera: &Camera, depth: &mut [u16; PIXELS]) {
        let at = |col, row| row * self.stride + col * 2;
        let raw = |col, row| u16::from_le_bytes([bytes[at(col, row)], bytes[at(col, row) + 1]]);
        self.choice.reduction().pick(depth, camera, raw);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v4l2::scripted::{Script, size};

    /// The choice from these formats, or the error message.
    fn chosen(formats: &[(&FourCc, &[Sizes])]) -> String {
        let formats = formats.iter().map(|(code, sizes)| (**code, sizes.to_vec()));
        let script = Script {
            formats: formats.collect(),
            ..Script::honest()
        };
        match choose(&script, Path::new("/dev/video0"), Want::LUMA) {
            Ok(choice) => choice.to_string(),
            Err(problem) => problem.to_string(),
        }
    }

    #[test]
    fn the_size_of_a_frame_is_preferred_then_smaller_ones_then_larger_ones_reduced() {
        let any = Sizes {
            least: [2, 2],
            most: [3840, 2160],
            step: [2, 2],
        };
        let large = Sizes {
            least: [1280, 960],
            ..any
        };
        let webcam = [size(320, 240), size(1280, 720), size(640, 480)];
        for (sizes, expected) in [
            (&webcam[..], "YUYV 640 x 480"),
            (&webcam[..2], "YUYV 320 x 240"),
            (&[size(640, 360), size(352, 288)], "YUYV 640 x 360"),
            (
                &[size(1920, 1080)],
                "YUYV 1920 x 1080 reduced by 3 to 640 x 360",
            ),
            (
                &[size(1280, 720), size(1280, 960)],
                "YUYV 1280 x 960 reduced by 2 to 640 x 480",
            ),
            (&[any], "YUYV 640 x 480"),
            (&[large], "YUYV 1280 x 960 reduced by 2 to 640 x 480"),
            (&[], "YUYV 640 x 480"),
            (
                &[
                    size(160, 120),
                    size(4096, 3072),
                    size(0, 0),
                    size(u32::MAX, 1),
                ],
                "the camera /dev/video0 gives no usable size, expected 320 x 240 to 2560 x 1920; use another camera",
            ),
        ] {
            assert_eq!(chosen(&[(b"YUYV", sizes)]), expected);
        }
    }

    #[test]
    fn the_size_counts_before_the_format_and_a_compressed_one_is_refused() {
        let [small, frame] = [[size(320, 240)], [size(640, 480)]];
        for (formats, expected) in [
            (
                &[(b"NV12", &frame[..]), (b"YUYV", &small)][..],
                "NV12 640 x 480",
            ),
            (&[(b"GREY", &frame), (b"YUYV", &frame)], "YUYV 640 x 480"),
            (
                &[(b"MJPG", &frame), (b"H264", &frame)],
                "the camera /dev/video0 gives only MJPG, H264, expected an uncompressed format (YUYV, UYVY, NV12, NV21, YU12, GREY); use another camera",
            ),
            (
                &[],
                "the camera /dev/video0 gives no format, expected an uncompressed format (YUYV, UYVY, NV12, NV21, YU12, GREY); use another camera",
            ),
        ] {
            assert_eq!(chosen(formats), expected);
        }
    }

    #[test]
    fn luma_is_read_from_every_format_and_rows_may_have_gaps() {
        // Luma of four pixels in a row, and the bytes around it.
        let rows: [(&FourCc, &[u8]); 4] = [
            (b"YUYV", &[10, 1, 20, 2, 30, 1, 40, 2]),
            (b"UYVY", &[1, 10, 2, 20, 1, 30, 2, 40]),
            (b"NV12", &[10, 20, 30, 40]),
            (b"GREY", &[10, 20, 30, 40]),
        ];
        for (code, pixels) in rows {
            let format = LUMA.iter().find(|known| known.code == *code).unwrap();
            for (columns, rows, reduced) in [(640, 480, 1), (320, 240, 1), (1280, 960, 2)] {
                let choice = Choice {
                    format,
                    size: [columns, rows],
                };
                let mut row = pixels.repeat(columns / 4);
                row.resize(row.len() + 32, 99);
                let answer = Answer {
                    code: *code,
                    size: [columns as u32, rows as u32],
                    stride: row.len() as u32,
                    whole: true,
                };
                let layout = Layout::new(Want::LUMA, choice, answer).unwrap();
                let chroma = if format.has_planes { rows / 2 } else { 0 };
                assert_eq!(layout.bytes, row.len() * (rows + chroma) - 32);
                let mut bytes = row.repeat(rows);
                bytes.resize(layout.bytes, 77);
                let mut luma = crate::Frame::default().luma;
                layout.luma(&bytes, &mut luma);
                let expected = [&[10, 20, 30, 40], &[15, 35, 15, 35]][reduced - 1];
                for row in luma.chunks(WIDTH) {
                    assert_eq!(row[..4], *expected);
                    // The border is repeated.
                    assert_eq!(row[639], expected[3]);
                }
            }
        }
    }

    #[test]
    fn a_driver_that_contradicts_itself_is_found_out() {
        let honest = Answer {
            code: *b"YUYV",
            size: [640, 480],
            stride: 1280,
            whole: true,
        };
        let asked = Choice::default();
        assert_eq!(
            Layout::new(Want::LUMA, asked, honest).unwrap().bytes,
            640 * 480 * 2
        );
        let another_size = Answer {
            size: [352, 288],
            ..honest
        };
        let taken = Layout::new(Want::LUMA, asked, another_size).unwrap().choice;
        assert_eq!(taken.to_string(), "YUYV 352 x 288");
        for (answer, how) in [
            (
                Answer {
                    code: *b"MJPG",
                    ..honest
                },
                "sets another format or size than those it offers",
            ),
            (
                Answer {
                    size: [0, 0],
                    ..honest
                },
                "sets another format or size than those it offers",
            ),
            (
                Answer {
                    size: [u32::MAX; 2],
                    ..honest
                },
                "sets another format or size than those it offers",
            ),
            (
                Answer {
                    stride: 1279,
                    ..honest
                },
                "states rows that are shorter than their pixels",
            ),
            (
                Answer {
                    whole: false,
                    ..honest
                },
                "sets another format or size than those it offers",
            ),
        ] {
            assert_eq!(Layout::new(Want::LUMA, asked, answer).unwrap_err(), how);
        }
    }
}
