//! Pictures as JPEG files in memory.

use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;

/// The bytes of the file; `quality` from 1 to 100.
#[must_use]
pub fn jpeg(picture: &RgbImage, quality: u8) -> Vec<u8> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality)
        .encode_image(picture)
        .expect("memory takes all, and pictures are below 65,536 pixels a side");
    bytes
}
