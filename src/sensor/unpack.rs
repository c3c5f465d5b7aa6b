//! Packed 11-bit depth to 16-bit values and back.
//!
//! Pixel k occupies bits 11k … 11k+10 counted from the top bit of byte 0; eight pixels fill eleven bytes without a gap.
//! Method: two overlapping big-endian 64-bit loads per eleven bytes hold pixels 0–3 and 4–7; four pixels at a time are then
//! spread to 16 bits inside one word, so that they are stored at once. Reads 422 kB, writes 614 kB per picture, allocates
//! nothing.

use crate::capacity::PIXELS;

/// Bytes of a packed depth picture.
pub const PACKED_DEPTH: usize = PIXELS * 11 / 8;

/// Four pixels of 11 bits, the first one highest, in the low 44 bits of `packed`: each to its 16 bits.
#[inline(always)]
fn spread(packed: u64) -> [u16; 4] {
    const PAIR: u64 = (1 << 22) - 1;
    const LOW: u64 = 0x0000_07ff_0000_07ff;
    // Halves first: pixels 0 and 1 to the low word, 2 and 3 to the high one; then each half the same way.
    let halves = packed >> 22 & PAIR | (packed & PAIR) << 32;
    let pixels = halves >> 11 & LOW | (halves & LOW) << 16;
    [
        pixels as u16,
        (pixels >> 16) as u16,
        (pixels >> 32) as u16,
        (pixels >> 48) as u16,
    ]
}

/// Unpacks a depth picture.
// As for luma: inlined, the pictures could overlap for all the compiler knows.
#[inline(never)]
pub fn unpack_depth(packed: &[u8; PACKED_DEPTH], depth: &mut [u16; PIXELS]) {
    for (bytes, pixels) in packed
        .as_chunks::<11>()
        .0
        .iter()
        .zip(depth.as_chunks_mut::<8>().0)
    {
        // Fixed-size parts, so that each load is one instruction.
        let word = |at: usize| {
            let mut eight = [0; 8];
            eight.copy_from_slice(&bytes[at..at + 8]);
            u64::from_be_bytes(eight)
        };
        let [first, second] = [word(0) >> 20, word(3)].map(spread);
        *pixels = [
            first[0], first[1], first[2], first[3], second[0], second[1], second[2], second[3],
        ];
    }
}

/// Packs a depth picture; values are taken modulo 2048.
pub fn pack_depth(depth: &[u16; PIXELS], packed: &mut [u8; PACKED_DEPTH]) {
    for (pixels, bytes) in depth
        .as_chunks::<8>()
        .0
        .iter()
        .zip(packed.as_chunks_mut::<11>().0)
    {
        let word = pixels
            .iter()
            .fold(0u128, |word, &pixel| word << 11 | u128::from(pixel) & 0x7ff);
        bytes.copy_from_slice(&word.to_be_bytes()[5..]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn boxed<T: Clone, const N: usize>(value: T) -> Box<[T; N]> {
        vec![value; N].into_boxed_slice().try_into().ok().unwrap()
    }

    /// One bit at a time, straight from the definition.
    fn reference(packed: &[u8], k: usize) -> u16 {
        (11 * k..11 * k + 11).fold(0, |value, bit| {
            value << 1 | u16::from(packed[bit / 8] >> (7 - bit % 8) & 1)
        })
    }

    #[test]
    fn equals_the_definition_bit_by_bit() {
        let mut random = fastrand::Rng::with_seed(2);
        let mut packed = boxed::<u8, PACKED_DEPTH>(0);
        random.fill(packed.as_mut_slice());
        let mut depth = boxed::<u16, PIXELS>(0);
        unpack_depth(&packed, &mut depth);
        for k in 0..PIXELS {
            assert_eq!(depth[k], reference(packed.as_slice(), k), "pixel {k}");
        }
        let mut again = boxed::<u8, PACKED_DEPTH>(0);
        pack_depth(&depth, &mut again);
        assert!(again == packed);
    }

    #[test]
    fn known_group() {
        let mut depth = boxed::<u16, PIXELS>(0);
        depth[..8].copy_from_slice(&[2047, 0, 2047, 0, 1, 0x400, 0, 2047]);
        let mut packed = boxed::<u8, PACKED_DEPTH>(0xaa);
        pack_depth(&depth, &mut packed);
        assert_eq!(
            packed[..11],
            [
                0xff, 0xe0, 0x03, 0xff, 0x80, 0x00, 0x03, 0x00, 0x00, 0x07, 0xff
            ]
        );
        assert_eq!(packed[11], 0);
    }
}
