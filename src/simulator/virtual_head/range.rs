//! An adaptive range coder for small integers, for the file of a head.
//!
//! Binary range coding with adaptive bits (Martin 1979; form and constants of LZMA, Pavlov 1998). An integer is mapped (0, −1, 1,
//! −2… to 0, 1, 2, 3…), then coded as its number of binary digits and the digits, with probabilities adapted per context; similar
//! numbers share a context. [`Coder::number`] both reads and writes, so that both adapt alike.

/// Number of contexts.
pub(super) const CONTEXTS: usize = 48;
/// Most binary digits of a number.
const DIGITS: usize = 20;
/// Digits after the first that have probabilities of their own.
const LEARNT: usize = 8;
/// Bits of a probability: unit 1/2048.
const ONE_BITS: u32 = 11;
/// Adaptation: each bit moves its probability by 1/2⁵ of the distance.
const RATE: u32 = 5;
/// Range below which a byte is shifted.
const TOP: u32 = 1 << 24;
/// Probabilities per context for the number of digits.
const LENGTH_NODES: usize = 32;
/// All probabilities per context: also for the digits, by their number.
const NODES: usize = LENGTH_NODES + (DIGITS + 1) * (1 << LEARNT);

/// Reads or writes numbers.
pub(super) struct Coder<'a> {
    mode: Mode<'a>,
    range: u32,
    /// Probabilities of a zero.
    learnt: Vec<u16>,
}

enum Mode<'a> {
    /// Remaining bytes, and the current code value.
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
    fn new(mode: Mode<'a>) -> Self {
        Self {
            mode,
            range: u32::MAX,
            learnt: vec![1 << (ONE_BITS - 1); CONTEXTS * NODES],
        }
    }

    /// A coder that reads the bytes of [`Self::finish`].
    pub(super) fn reading(bytes: &'a [u8]) -> Self {
        let mut coder = Self::new(Mode::Read { bytes, code: 0 });
        (0..5).for_each(|_| coder.shift());
        coder
    }

    pub(super) fn writing() -> Self {
        Self::new(Mode::Write {
            bytes: Vec::new(),
            low: 0,
            held: 0,
            pending: 0,
        })
    }

    /// The bytes written.
    pub(super) fn finish(mut self) -> Vec<u8> {
        (0..5).for_each(|_| self.shift());
        match self.mode {
            Mode::Read { .. } => Vec::new(),
            Mode::Write { bytes, .. } => bytes,
        }
    }

    /// Reads the next byte, or writes one.
    fn shift(&mut self) {
        match &mut self.mode {
            Mode::Read { bytes, code } => {
                let byte = bytes.split_off_first().expect("a whole head");
                *code = *code << 8 | u32::from(*byte);
            }
            Mode::Write {
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

    /// Writes `bit`, or ignores it and reads one, with the probability of `node`; returns the bit.
    fn bit(&mut self, node: usize, bit: u32) -> u32 {
        let p = self.learnt[node];
        let bound = (self.range >> ONE_BITS) * u32::from(p);
        let bit = match &mut self.mode {
            Mode::Read { code, .. } => {
                let bit = u32::from(*code >= bound);
                *code -= bit * bound;
                bit
            }
            Mode::Write { low, .. } => {
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

    /// Writes `value` (−2¹⁹…2¹⁹) in a context, or ignores it and reads one; returns the number.
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
            // Further digits share the last probabilities.
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
