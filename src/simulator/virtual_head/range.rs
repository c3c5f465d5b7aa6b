//! An adaptive range coder for small whole numbers: what makes the file of a head a third of its arrays.
//!
//! Binary range coding with adaptive bits (Martin 1979; the carry-less form and the constants of LZMA, Pavlov 1998). A number
//! is mapped to 0, −1, 1, −2…, then written as its count of binary digits and the digits themselves, all but the last of a long
//! one by bits that learn, in a context that the caller names: alike numbers share a context. Reading and writing are the same
//! lines, [`Coder::number`], so that both learn the same.

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

/// What has been learnt: probabilities, exclusive or [`HALF`], so that memory that was never touched is a bit of which
/// nothing is known.
type Learnt = Vec<u16>;

/// One direction: reading, or writing.
pub(super) trait Coder {
    /// Codes a bit whose probability to be 0 is `zero`/2048: writes `bit`, or ignores it and reads one. What it was.
    fn bit(&mut self, zero: u32, bit: u32) -> u32;

    fn learnt(&mut self) -> &mut Learnt;

    /// Whether more was read than there is.
    fn is_cut_short(&self) -> bool;

    /// Writes a number of a context, −2¹⁹…2¹⁹, or ignores `value` and reads one. What it was.
    fn number(&mut self, context: usize, value: i32) -> i32 {
        let value = ((value << 1) ^ (value >> 31)).cast_unsigned();
        let mut learnt = std::mem::take(self.learnt());
        let mut learn = |node: usize, bit: u32| {
            let p = learnt[node] ^ HALF;
            let bit = self.bit(p.into(), bit);
            let p = match bit {
                0 => p + (((1 << ONE_BITS) - p) >> RATE),
                _ => p - (p >> RATE),
            };
            learnt[node] = p ^ HALF;
            bit
        };
        let start = context * NODES;
        let count = 32 - value.leading_zeros();
        let mut node = 1;
        for k in (0..5).rev() {
            node = 2 * node + learn(start + node, (count >> k) & 1) as usize;
        }
        let count = (node - LENGTH_NODES).min(DIGITS);
        let (mut number, mut node) = (u32::from(count > 0), 1);
        for k in (0..count.saturating_sub(1)).rev() {
            // What is beyond the learnt digits goes on as the last of them.
            let place = start + LENGTH_NODES + (count << LEARNT) + (node & ((1 << LEARNT) - 1));
            let digit = learn(place, (value >> k) & 1);
            number = 2 * number + digit;
            node = (2 * node + digit as usize).min((1 << LEARNT) - 1);
        }
        *self.learnt() = learnt;
        (number >> 1).cast_signed() ^ -(number & 1).cast_signed()
    }
}

/// Reads numbers. Behind the end of the bytes it reads zeros, and says so.
pub(super) struct Decoder<'a> {
    bytes: &'a [u8],
    learnt: Learnt,
    range: u32,
    code: u32,
    is_cut_short: bool,
}

impl<'a> Decoder<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        let mut decoder = Self {
            bytes,
            learnt: vec![0; CONTEXTS * NODES],
            range: u32::MAX,
            code: 0,
            is_cut_short: false,
        };
        for _ in 0..5 {
            decoder.shift();
        }
        decoder
    }

    fn shift(&mut self) {
        let byte = self.bytes.split_off_first();
        self.is_cut_short |= byte.is_none();
        self.code = self.code << 8 | u32::from(*byte.unwrap_or(&0));
    }

    /// Whether all was read.
    pub(super) fn is_finished(&self) -> bool {
        self.bytes.is_empty() && !self.is_cut_short
    }
}

impl Coder for Decoder<'_> {
    fn bit(&mut self, zero: u32, _: u32) -> u32 {
        let bound = (self.range >> ONE_BITS) * zero;
        let bit = u32::from(self.code >= bound);
        if bit == 0 {
            self.range = bound;
        } else {
            self.range -= bound;
            self.code -= bound;
        }
        if self.range < TOP {
            self.range <<= 8;
            self.shift();
        }
        bit
    }

    fn learnt(&mut self) -> &mut Learnt {
        &mut self.learnt
    }

    fn is_cut_short(&self) -> bool {
        self.is_cut_short
    }
}

/// Writes numbers.
#[cfg(any(test, feature = "studio"))]
pub(super) struct Encoder {
    bytes: Vec<u8>,
    learnt: Learnt,
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
            learnt: vec![0; CONTEXTS * NODES],
            low: 0,
            range: u32::MAX,
            held: 0,
            pending: 0,
        }
    }

    fn shift(&mut self) {
        if self.low < 0xff00_0000 || self.low > u64::from(u32::MAX) {
            let carry = (self.low >> 32) as u8;
            self.bytes.push(self.held.wrapping_add(carry));
            let pending = std::iter::repeat_n(255u8.wrapping_add(carry), self.pending);
            self.bytes.extend(pending);
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

#[cfg(any(test, feature = "studio"))]
impl Coder for Encoder {
    fn bit(&mut self, zero: u32, bit: u32) -> u32 {
        let bound = (self.range >> ONE_BITS) * zero;
        if bit == 0 {
            self.range = bound;
        } else {
            self.low += u64::from(bound);
            self.range -= bound;
        }
        if self.range < TOP {
            self.range <<= 8;
            self.shift();
        }
        bit
    }

    fn learnt(&mut self) -> &mut Learnt {
        &mut self.learnt
    }

    fn is_cut_short(&self) -> bool {
        false
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
            assert_eq!(decoder.number(context, 0), number);
        }
        assert!(decoder.is_finished());
        // 20 digits for a third, a little more than 2.3 and 1 bit for the others.
        let most = numbers.len() / 3 * (20 + 4) / 8;
        assert!(bytes.len() < most, "{} of {most} bytes", bytes.len());
        let mut cut = Decoder::new(&bytes[..bytes.len() / 2]);
        for &(context, _) in &numbers {
            cut.number(context, 0);
        }
        assert!(cut.is_cut_short());
    }
}
