//! Frames that can be recognised: every pixel follows from the frame's number, so that one comparison tells whether a
//! frame is whole, wrong, or mixed from two.

#![allow(dead_code, reason = "each test program uses some of it")]

use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::packet::TICKS_PER_PICTURE;

/// Least depth of a pattern in millimetres, in which 0 would be no depth.
pub(crate) const NEAREST_MM: u16 = 500;

/// Mixes a number thoroughly (the finaliser of SplitMix64).
fn hash(seed: u64, index: u64) -> u64 {
    let mut z = seed ^ index.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

fn depth(number: u64, group: usize) -> [u16; 4] {
    let bits = hash(number, group as u64);
    [0, 16, 32, 48].map(|shift| (bits >> shift & 0x7ff) as u16)
}

fn bayer(number: u64, group: usize) -> [u8; 8] {
    hash(!number, group as u64).to_le_bytes()
}

/// Draws frame `number`: its number in the first four pixels, noise that depends on it behind.
pub(crate) fn draw(number: u64, frame: &mut KinectFrame) {
    draw_depth(number, 0, &mut frame.depth[..]);
    draw_luma(number, &mut frame.original.bayer[..]);
    let original = &mut frame.original;
    original.ticks = (number as u32).wrapping_mul(TICKS_PER_PICTURE);
    original.colour_ticks = original.ticks.wrapping_add(60_000);
}

/// Depth of frame `number` in an image of any size; the values are `nearest` and above.
pub(crate) fn draw_depth(number: u64, nearest: u16, image: &mut [u16]) {
    for (group, pixels) in image.as_chunks_mut().0.iter_mut().enumerate() {
        *pixels = depth(number, group).map(|value| nearest + value);
    }
    for (pixel, byte) in image.iter_mut().zip((number as u32).to_le_bytes()) {
        *pixel = nearest + u16::from(byte);
    }
}

/// Grey levels of frame `number` in an image of any size.
pub(crate) fn draw_luma(number: u64, image: &mut [u8]) {
    for (group, pixels) in image.as_chunks_mut().0.iter_mut().enumerate() {
        *pixels = bayer(number, group);
    }
    image[..4].copy_from_slice(&(number as u32).to_le_bytes());
}

/// Numbers read from a frame's depth and colour picture, and the pixels that are not what those numbers demand.
pub(crate) fn check(frame: &KinectFrame) -> ([u64; 2], usize) {
    let read = |value: &dyn Fn(usize) -> u64| (0..4).map(|i| value(i) << (8 * i)).sum::<u64>();
    let of_depth = read(&|i| u64::from(frame.depth[i]) & 0xff);
    let of_colour = read(&|i| u64::from(frame.original.bayer[i]));
    let wrong = wrong(&frame.depth[..], |group| depth(of_depth, group))
        + wrong(&frame.original.bayer[..], |group| bayer(of_colour, group));
    ([of_depth, of_colour], wrong)
}

/// Pixels behind the first group that are not as expected.
fn wrong<T: PartialEq, const N: usize>(pixels: &[T], expected: impl Fn(usize) -> [T; N]) -> usize {
    let groups = pixels.as_chunks::<N>().0.iter().enumerate().skip(1);
    let wrong = groups.map(|(group, pixels)| {
        let pairs = pixels.iter().zip(expected(group));
        pairs.filter(|(found, expected)| *found != expected).count()
    });
    wrong.sum()
}
