//! Descriptors of a USB Video Class camera, and its answer to the negotiation of a format.
//!
//! Each function has a VideoControl interface (2n) with a camera and an output terminal, and a VideoStreaming interface (2n + 1) with one
//! uncompressed format, two sizes of frames, and a bulk endpoint.

/// An uncompressed format: the four characters of its GUID, and the bits of a pixel.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) struct Format(pub(crate) [u8; 4], u8);

pub(crate) const YUYV: Format = Format(*b"YUY2", 16);
pub(crate) const DEPTH: Format = Format(*b"Z16 ", 16);
pub(crate) const INFRARED: Format = Format(*b"Y8  ", 8);

impl Format {
    /// Bytes of an image.
    pub(crate) fn bytes(self, size: [u16; 2]) -> usize {
        let pixels = usize::from(size[0]) * usize::from(size[1]);
        pixels * usize::from(self.1) / 8
    }
}

/// Frame sizes of a format: columns and rows, the default first.
pub(crate) const SIZES: [[u16; 2]; 2] = [[640, 480], [320, 240]];
/// Largest payload, with its header: a transfer of the kernel's driver.
pub(crate) const PAYLOAD: usize = 16 * 1024;
/// 30 frames a second, in units of 100 ns.
const INTERVAL: u32 = 333_333;
/// The end of the GUID of every format that has a code of four characters.
const GUID_END: [u8; 12] = [0, 0, 16, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71];
/// Type of the descriptors that the class defines.
const CLASS_SPECIFIC: u8 = 0x24;

/// Address of the endpoint of a function.
pub(crate) fn endpoint(function: usize) -> u8 {
    0x81 + function as u8
}

/// A descriptor: its length, then `fields`.
fn descriptor(fields: &[&[u8]]) -> Vec<u8> {
    let fields = fields.concat();
    [&[fields.len() as u8 + 1], &fields[..]].concat()
}

fn frame(format: Format, number: usize, size: [u16; 2]) -> Vec<u8> {
    let bytes = format.bytes(size) as u32;
    descriptor(&[
        &[CLASS_SPECIFIC, 5, number as u8 + 1, 0],
        size.map(u16::to_le_bytes).as_flattened(),
        // Bits per second at least and at most, bytes of an image, time between images: the default, and a list of one.
        [bytes * 240, bytes * 240, bytes, INTERVAL]
            .map(u32::to_le_bytes)
            .as_flattened(),
        &[1],
        &INTERVAL.to_le_bytes(),
    ])
}

fn function(number: usize, format: Format) -> Vec<u8> {
    let control = 2 * number as u8;
    let streaming = control + 1;
    let frames = SIZES.iter().enumerate();
    let frames: Vec<u8> = frames
        .flat_map(|(i, size)| frame(format, i, *size))
        .collect();
    let format = descriptor(&[
        &[CLASS_SPECIFIC, 4, 1, SIZES.len() as u8],
        &format.0,
        &GUID_END,
        &[format.1, 1, 0, 0, 0, 0],
    ]);
    let [total, more] = (14 + (format.len() + frames.len()) as u16).to_le_bytes();
    [
        // Interface association descriptor of both interfaces, class video.
        descriptor(&[&[11, control, 2, 14, 3, 0, 0]]),
        descriptor(&[&[4, control, 0, 0, 14, 1, 0, 0]]),
        // Version 1.10 of the class; 40 bytes of header and terminals.
        descriptor(&[&[CLASS_SPECIFIC, 1, 0x10, 1, 40, 0, 0, 0, 0, 0, 1, streaming]]),
        // Terminal 1 is a camera without controls; terminal 2 is the USB output.
        descriptor(&[&[CLASS_SPECIFIC, 2, 1, 1, 2], &[0; 8], &[3, 0, 0, 0]]),
        descriptor(&[&[CLASS_SPECIFIC, 3, 2, 1, 1, 0, 1, 0]]),
        descriptor(&[&[4, streaming, 0, 1, 14, 2, 0, 0]]),
        descriptor(&[
            &[CLASS_SPECIFIC, 1, 1, total, more, endpoint(number)],
            &[0, 2, 0, 0, 0, 1, 0],
        ]),
        format,
        frames,
        descriptor(&[&[5, endpoint(number), 2, 0, 2, 0]]),
    ]
    .concat()
}

/// The configuration of a camera with one function for each format.
pub(crate) fn configuration(formats: impl ExactSizeIterator<Item = Format>) -> Vec<u8> {
    let interfaces = 2 * formats.len() as u8;
    let functions = formats.enumerate();
    let body: Vec<u8> = functions
        .flat_map(|(i, format)| function(i, format))
        .collect();
    let [low, high] = (9 + body.len() as u16).to_le_bytes();
    let head = descriptor(&[&[2, low, high, interfaces, 1, 0, 0x80, 250]]);
    [head, body].concat()
}

/// What a camera will stream: the frame with this number of its format, in payloads of at most so many bytes.
pub(crate) fn negotiated(format: Format, frame: usize, payload: usize) -> Vec<u8> {
    let bytes = format.bytes(SIZES[frame]) as u32;
    [
        &[0, 0, 1, frame as u8 + 1],
        &INTERVAL.to_le_bytes()[..],
        &[0; 10],
        &bytes.to_le_bytes(),
        &(payload as u32).to_le_bytes(),
        // The clock, and framing by both bits of the header.
        &[0; 4],
        &[3, 0, 0, 0],
    ]
    .concat()
}
