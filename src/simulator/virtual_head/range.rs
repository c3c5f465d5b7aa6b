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

/// Reads numbers, or writes them.
pub(super) struct Coder<'a> {
    way: Way<'a>,
    range: u32,
    /// Probabilities of a zero.
    learnt: Vec<u16>,
}

enum Way<'a> {
    /// What is still to be read.
    Read { bytes: &'a [u8], code: u32 },
    Write {
        bytes: Vec<u8>,
        low: u64,
        /// The last byte, which a carry may still change, and the 255s behind it.
        held: u8,
        pending: usize,
    },
}

impl<'a> Coder<'a> {
    fn new(way: Way<'a>) -> Self {
        Self {
            way,
            range: u32::MAX,
            learnt: vec![1 << (ONE_BITS - 1); CONTEXTS * NODES],
        }
    }

    /// Reads what [`Self::finish`] gave.
    pub(super) fn reading(bytes: &'a [u8]) -> Self {
        let mut coder = Self::new(Way::Read { bytes, code: 0 });
        (0..5).for_each(|_| coder.shift());
        coder
    }

    pub(super) fn writing() -> Self {
        Self::new(Way::Write {
            bytes: Vec::new(),
            low: 0,
            held: 0,
            pending: 0,
        })
    }

    /// All that was written.
    pub(super) fn finish(mut self) -> Vec<u8> {
        (0..5).for_each(|_| self.shift());
        match self.way {
            Way::Read { .. } => Vec::new(),
            Way::Write { bytes, .. } => bytes,
        }
    }

    /// Takes the next byte, or gives one away.
    fn shift(&mut self) {
        match &mut self.way {
            Way::Read { bytes, code } => {
                let byte = bytes.split_off_first().expect("a whole head");
                *code = *code << 8 | u32::from(*byte);
            }
            Way::Write {
                bytes,
                low,
                held,
                pending,
            } => {
                if *low < 0xff00_0000 || *low > u64::from(u32::MAX) {
                    let carry = (*low >> 32) as u8;
                    bytes.push(held.wrapping_add(carry));
                    bytes.extend(std::iter::repeat_n(255u8.wrapping_add(carry), *pending));
                    *pending = 0;
                    *held = (*low >> 24) as u8;
                } else {
                    *pending += 1;
                }
                *low = (*low & 0x00ff_ffff) << 8;
            }
        }
    }

    /// Writes `bit`, or ignores it and reads one, by the probability learnt at `node`. What it was.
    fn bit(&mut self, node: usize, bit: u32) -> u32 {
        let p = self.learnt[node];
        let bound = (self.range >> ONE_BITS) * u32::from(p);
        let bit = match &mut self.way {
            Way::Read { code, .. } => {
                let bit = u32::from(*code >= bound);
                *code -= bit * bound;
                bit
            }
            Way::Write { low, .. } => {
                *low += u64::from(bit * bound);
                bit
            }
        };
        (self.range, self.learnt[node]) = match bit {
            0 => (bound, p + (((1 << ONE_BITS) - p) >> RATE)),
            _ => (self.range - bound, p - (p >> RATE)),
        };
        if self.range < TOP {
            self.range <<= 8;
            self.shift();
        }
        bit
    }

    /// Writes a number of a context, −2¹⁹…2¹⁹, or ignores `value` and reads one. What it was.
    pub(super) fn number(&mut self, context: usize, value: i32) -> i32 {
        let value = ((value << 1) ^ (value >> 31)).cast_unsigned();
        let start = context * NODES;
        let count = 32 - value.leading_zeros();
        let mut node = 1;
        for k in (0..5).rev() {
            node = 2 * node + self.bit(start + node, (count >> k) & 1) as usize;
        }
        let count = (node - LENGTH_NODES).min(DIGITS);
        let (mut number, mut node) = (u32::from(count > 0), 1);
        for k in (0..count.saturating_sub(1)).rev() {
            // What is beyond the learnt digits goes on as the last of them.
            let place = start + LENGTH_NODES + (count << LEARNT) + (node & ((1 << LEARNT) - 1));
            let digit = self.bit(place, (value >> k) & 1);
            number = 2 * number + digit;
            node = (2 * node + digit as usize).min((1 << LEARNT) - 1);
        }
        (number >> 1).cast_signed() ^ -(number & 1).cast_signed()
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
        let mut encoder = Coder::writing();
        for &(context, number) in &numbers {
            encoder.number(context, number);
        }
        let bytes = encoder.finish();
        let mut decoder = Coder::reading(&bytes);
        for &(context, number) in &numbers {
            assert_eq!(decoder.number(context, 0), number);
        }
        // 20 digits for a third, a little more than 2.3 and 1 bit for the others.
        let most = numbers.len() / 3 * (20 + 4) / 8;
        assert!(bytes.len() < most, "{} of {most} bytes", bytes.len());
    }
}
