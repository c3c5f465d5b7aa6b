//! Frames that can be recognised: every pixel follows from the frame's number, so that one comparison tells whether a
//! frame is whole, wrong, or mixed from two.

use crate::sensor::kinect::frame::KinectFrame;
use crate::sensor::kinect::packet::TICKS_PER_PICTURE;

fn mixed(number: u64) -> u64 {
    // SplitMix64's output function: neighbours become unlike.
    let z = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ z >> 31
}

fn depth(number: u64, group: usize) -> [u16; 4] {
    let bits = mixed(number ^ (group as u64) << 32);
    [0, 16, 32, 48].map(|shift| (bits >> shift & 0x7ff) as u16)
}

fn bayer(number: u64, group: usize) -> [u8; 8] {
    mixed(!number ^ (group as u64) << 32).to_le_bytes()
}

/// Draws frame `number`: its number in the first four pixels, noise that depends on it behind.
pub fn draw(number: u64, frame: &mut KinectFrame) {
    for (group, pixels) in frame.depth.as_chunks_mut().0.iter_mut().enumerate() {
        *pixels = depth(number, group);
    }
    for (group, pixels) in frame
        .original
        .bayer
        .as_chunks_mut()
        .0
        .iter_mut()
        .enumerate()
    {
        *pixels = bayer(number, group);
    }
    for i in 0..4 {
        frame.depth[i] = (number >> (8 * i) & 0xff) as u16;
        frame.original.bayer[i] = (number >> (8 * i) & 0xff) as u8;
    }
    frame.original.ticks = (number as u32).wrapping_mul(TICKS_PER_PICTURE);
    frame.original.colour_ticks = frame.original.ticks.wrapping_add(60_000);
}

/// Numbers read from a frame's depth and colour picture, and the pixels that are not what those numbers demand.
#[must_use]
pub fn check(frame: &KinectFrame) -> ([u64; 2], usize) {
    let read = |value: &dyn Fn(usize) -> u64| (0..4).map(|i| value(i) << (8 * i)).sum::<u64>();
    let numbers = [
        read(&|i| u64::from(frame.depth[i]) & 0xff),
        read(&|i| u64::from(frame.original.bayer[i])),
    ];
    let mut wrong = 0;
    for (group, pixels) in frame.depth.as_chunks::<4>().0.iter().enumerate().skip(1) {
        let expected = depth(numbers[0], group);
        wrong += (0..4).filter(|&i| pixels[i] != expected[i]).count();
    }
    for (group, pixels) in frame
        .original
        .bayer
        .as_chunks::<8>()
        .0
        .iter()
        .enumerate()
        .skip(1)
    {
        let expected = bayer(numbers[1], group);
        wrong += (0..8).filter(|&i| pixels[i] != expected[i]).count();
    }
    (numbers, wrong)
}
