//! An adaptive range coder for small whole numbers: what makes the file of a head a third of its arrays.
//!
//! Binary range coding with adaptive bits (Martin 1979; the carry-less form and the constants of LZMA, Pavlov 1998). A number
//! is mapped to 0, −1, 1, −2…, then written as its count of binary digits and the digits themselves, all but the last of a long
//! one by bits that learn, in a context that the caller names: alike numbers share a context.

/// Contexts that numbers may have.
pub(super) const CONTEXTS: usize = 48;
/// Most binary digits of a number.
const DIGITS: usize = 20;
/// Digits of a number, after its first, that are learnt.
const LEARNT: usize = 8;
/// Probabilities are in 1/2048; each bit moves its own by 1/32 of the rest.
const ONE_BITS: u32 = 11;
const RATE: u32 = 5;
const TOP: u32 = 1 << 24;
/// Learnt bits of a context: its count of digits, and the digits for each count.
const LENGTH_NODES: usize = 32;
const NODES: usize = LENGTH_NODES + (DIGITS + 1) * (1 << LEARNT);

/// Where every probability begins.
const HALF: u16 = 1 << (ONE_BITS - 1);

/// What has been learnt, the same on both sides: probabilities, exclusive or [`HALF`], so that memory that was never
/// touched is a bit of which nothing is known.
struct Bits(Vec<u16>);

impl Bits {
    fn new() -> Self {
        Self(vec![0; CONTEXTS * NODES])
    }
}

/// The walk through the bits of a number, `value` where it is known; `bit(node, bit)` codes one and returns it.
fn walk(context: usize, value: u32, mut bit: impl FnMut(usize, u32) -> u32) -> u32 {
    let start = context * NODES;
    let count = 32 - value.leading_zeros();
    let mut node = 1;
    for k in (0..5).rev() {
        node = 2 * node + bit(start + node, (count >> k) & 1) as usize;
    }
    let count = (node - LENGTH_NODES).min(DIGITS);
    let (mut number, mut node) = (u32::from(count > 0), 1);
    for k in (0..count.saturating_sub(1)).rev() {
        // What is beyond the learnt digits goes on as the last of them.
        let place = start + LENGTH_NODES + (count << LEARNT) + (node & ((1 << LEARNT) - 1));
        let digit = bit(place, (value >> k) & 1);
        number = 2 * number + digit;
        node = (2 * node + digit as usize).min((1 << LEARNT) - 1);
    }
    number
}

/// Reads numbers. Behind the end of the bytes it reads zeros, and says so.
pub(super) struct Decoder<'a> {
    bytes: &'a [u8],
    bits: Bits,
    range: u32,
    code: u32,
    /// Bytes read that were not there.
    missing: usize,
}

impl<'a> Decoder<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        let mut decoder = Self {
            bytes,
            bits: Bits::new(),
            range: u32::MAX,
            code: 0,
            missing: 0,
        };
        for _ in 0..5 {
            decoder.code = decoder.code << 8 | decoder.byte();
        }
        decoder
    }

    fn byte(&mut self) -> u32 {
        if let Some((&first, rest)) = self.bytes.split_first() {
            self.bytes = rest;
            u32::from(first)
        } else {
            self.missing += 1;
            0
        }
    }

    /// The next number of a context, −2¹⁹…2¹⁹.
    pub(super) fn number(&mut self, context: usize) -> i32 {
        let mut bits = std::mem::take(&mut self.bits.0);
        let folded = walk(context, 0, |node, _| {
            let mut p = bits[node] ^ HALF;
            let bound = (self.range >> ONE_BITS) * u32::from(p);
            let bit = u32::from(self.code >= bound);
            if bit == 0 {
                self.range = bound;
                p += ((1 << ONE_BITS) - p) >> RATE;
            } else {
                self.range -= bound;
                self.code -= bound;
                p -= p >> RATE;
            }
            bits[node] = p ^ HALF;
            if self.range < TOP {
                self.range <<= 8;
                self.code = self.code << 8 | self.byte();
            }
            bit
        });
        self.bits.0 = bits;
        (folded >> 1).cast_signed() ^ -(folded & 1).cast_signed()
    }

    /// Whether more was read than there is.
    pub(super) fn cut_short(&self) -> bool {
        self.missing > 0
    }

    /// Whether all was read.
    pub(super) fn finished(&self) -> bool {
        self.bytes.is_empty() && self.missing == 0
    }
}

/// Writes numbers.
#[cfg(any(test, feature = "studio"))]
pub(super) struct Encoder {
    bytes: Vec<u8>,
    bits: Bits,
    low: u64,
    range: u32,
    /// The last byte, which a carry may still change, and the 255s behind it.
    held: u8,
    pending: usize,
}

#[cfg(any(test, feature = "studio"))]
impl Encoder {
    pub(super) fn new() -> Self {
        Self {
            bytes: Vec::new(),
            bits: Bits::new(),
            low: 0,
            range: u32::MAX,
            held: 0,
            pending: 0,
        }
    }

    pub(super) fn number(&mut self, context: usize, value: i32) {
        let folded = ((value << 1) ^ (value >> 31)).cast_unsigned();
        let mut bits = std::mem::take(&mut self.bits.0);
        walk(context, folded, |node, bit| {
            let mut p = bits[node] ^ HALF;
            let bound = (self.range >> ONE_BITS) * u32::from(p);
            if bit == 0 {
                self.range = bound;
                p += ((1 << ONE_BITS) - p) >> RATE;
            } else {
                self.low += u64::from(bound);
                self.range -= bound;
                p -= p >> RATE;
            }
            bits[node] = p ^ HALF;
            if self.range < TOP {
                self.range <<= 8;
                self.shift();
            }
            bit
        });
        self.bits.0 = bits;
    }

    fn shift(&mut self) {
        if self.low < 0xff00_0000 || self.low > u64::from(u32::MAX) {
            let carry = (self.low >> 32) as u8;
            self.bytes.push(self.held.wrapping_add(carry));
            for _ in 0..self.pending {
                self.bytes.push(255u8.wrapping_add(carry));
            }
            self.pending = 0;
            self.held = (self.low >> 24) as u8;
        } else {
            self.pending += 1;
        }
        self.low = (self.low & 0x00ff_ffff) << 8;
    }

    pub(super) fn finish(mut self) -> Vec<u8> {
        for _ in 0..5 {
            self.shift();
        }
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_back_and_alike_ones_are_short() {
        let mut rng = fastrand::Rng::with_seed(1);
        let numbers: Vec<(usize, i32)> = (0..20_000)
            .map(|k| match k % 3 {
                0 => (0, rng.i32(-2..3)),
                1 => (7, rng.i32(-500_000..500_000)),
                _ => (CONTEXTS - 1, 40 + rng.i32(0..2)),
            })
            .collect();
        let mut encoder = Encoder::new();
        for &(context, number) in &numbers {
            encoder.number(context, number);
        }
        let bytes = encoder.finish();
        let mut decoder = Decoder::new(&bytes);
        for &(context, number) in &numbers {
            assert_eq!(decoder.number(context), number);
        }
        assert!(decoder.finished());
        // 20 digits for a third, a little more than 2.3 and 1 bit for the others.
        let most = numbers.len() / 3 * (20 + 4) / 8;
        assert!(bytes.len() < most, "{} of {most} bytes", bytes.len());
        let mut cut = Decoder::new(&bytes[..bytes.len() / 2]);
        for &(context, _) in &numbers {
            cut.number(context);
        }
        assert!(cut.cut_short());
    }
}
