//! Runs hot loops with the widest vector instructions of the processor.
//!
//! The x86-64 baseline has vectors of four floats; nearly all processors in use have AVX2, with eight. [`with_avx2`] compiles a
//! closure for both and chooses at run time. Only the width changes: no sum is reordered and no multiply-add fused, so the
//! results are bit-identical. Other architectures run the closure as compiled. [`two_bit_dots`] uses intrinsics: its sums are
//! of integers, so their order does not matter.
#![cfg_attr(
    all(target_arch = "x86_64", feature = "std"),
    expect(
        unsafe_code,
        reason = "code for a newer processor may only be called on one"
    )
)]

/// 1.5 · 2²³: added to a float of magnitude up to 2²¹, it rounds to the nearest integer, which is then in the low bits of the
/// sum. Unlike a conversion, an addition vectorises.
pub const NO_FRACTION: f32 = 12_582_912.0;

/// Runs `work`, compiled for AVX2 if the processor has it. `work` and the functions that it calls need `#[inline(always)]`: a function
/// that is not inlined stays compiled for the baseline.
#[inline(always)]
pub fn with_avx2<R>(work: impl FnOnce() -> R) -> R {
    #[cfg(all(target_arch = "x86_64", feature = "std"))]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: AVX2 was just detected.
        return unsafe { compiled_for_avx2(work) };
    }
    work()
}

#[cfg(all(target_arch = "x86_64", feature = "std"))]
#[target_feature(enable = "avx2")]
fn compiled_for_avx2<R>(work: impl FnOnce() -> R) -> R {
    work()
}

/// Rearranges factors of magnitude up to 2¹⁴, in place, as [`two_bit_dots`] reads them: with AVX2 the upper bytes of an item's 128
/// factors before their lower bytes, which then have a sign too; otherwise they stay as they are.
pub fn arrange_for_dots(factors: &mut [[i16; 128]]) {
    #[cfg(all(target_arch = "x86_64", feature = "std"))]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: AVX2 was just detected.
        unsafe { compiled_for_avx2(|| factors.iter_mut().for_each(split_bytes)) }
    }
    #[cfg(not(all(target_arch = "x86_64", feature = "std")))]
    let _ = factors;
}

/// Each factor is 256 × its upper byte + its lower one, both signed.
#[cfg(all(target_arch = "x86_64", feature = "std"))]
#[inline(always)]
fn split_bytes(factors: &mut [i16; 128]) {
    let upper = factors.map(|f| (f.wrapping_add(128) >> 8) as i8);
    let lower = factors.map(|f| f as i8);
    *factors = bytemuck::cast([upper, lower]);
}

/// The dot product of each item of `factors`, arranged by [`arrange_for_dots`], with 128 numbers 0…3, two bits each: bits 2k and
/// 2k + 1 of the bytes belong to the k-th quarter of the factors.
pub fn two_bit_dots(bytes: &[[u8; 32]], factors: &[[i16; 128]], dots: &mut [i32]) {
    #[cfg(all(target_arch = "x86_64", feature = "std"))]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: AVX2 was just detected.
        return unsafe { two_bit_dots_avx2(bytes, factors, dots) };
    }
    two_bit_dots_plain(bytes, factors, dots);
}

/// Integer sums vectorise; wrapping arithmetic lets them vectorise in every profile. The sums are at most 128 × 3 × 2¹⁵ and
/// cannot overflow. The function is not inlined, because callers compiled for AVX2 would contain it again.
#[inline(never)]
fn two_bit_dots_plain(bytes: &[[u8; 32]], factors: &[[i16; 128]], dots: &mut [i32]) {
    for ((dot, bytes), factors) in dots.iter_mut().zip(bytes).zip(factors) {
        let quarters = factors.as_chunks::<32>().0;
        let mut sum = 0_i32;
        // All quarters in one pass: a loop over them would be unrolled first and then not be vectorised.
        for (i, byte) in bytes.iter().enumerate() {
            let byte = i16::from(*byte);
            let number = |part: usize| i32::from(byte >> (2 * part) & 3);
            let product = |part: usize| number(part).wrapping_mul(quarters[part][i].into());
            sum = sum.wrapping_add(product(0)).wrapping_add(product(1));
            sum = sum.wrapping_add(product(2)).wrapping_add(product(3));
        }
        *dot = sum;
    }
}

/// Four dots at a time, whose partial sums are added together. Products are of 8 bits, twice as many a vector as of 16.
#[cfg(all(target_arch = "x86_64", feature = "std"))]
#[target_feature(enable = "avx2")]
fn two_bit_dots_avx2(bytes: &[[u8; 32]], factors: &[[i16; 128]], dots: &mut [i32]) {
    use bytemuck::cast;
    use core::arch::x86_64::*;
    let lowest = _mm256_set1_epi8(3);
    let weights = [256, 1].map(|weight| _mm256_set1_epi16(weight));
    // Eight partial sums of one dot. Sums of 16 bits hold 4 × 2 products of up to 3 × 128.
    let partial = |bytes: &[u8; 32], factors: &[i16; 128]| {
        let (quarters, _) = bytemuck::cast_ref::<_, [u8; 256]>(factors).as_chunks::<32>();
        let mut numbers = cast::<_, __m256i>(*bytes);
        let mut sums = [_mm256_setzero_si256(); 2];
        for quarter in 0..4 {
            let number = _mm256_and_si256(numbers, lowest);
            for (half, sum) in sums.iter_mut().enumerate() {
                let products = _mm256_maddubs_epi16(number, cast(quarters[4 * half + quarter]));
                *sum = _mm256_add_epi16(*sum, products);
            }
            numbers = _mm256_srli_epi16::<2>(numbers);
        }
        let [upper, lower] = [0, 1].map(|half| _mm256_madd_epi16(sums[half], weights[half]));
        _mm256_add_epi32(upper, lower)
    };
    let (fours, rest) = dots.as_chunks_mut::<4>();
    let items = bytes
        .as_chunks::<4>()
        .0
        .iter()
        .zip(factors.as_chunks::<4>().0);
    for (dots, (bytes, factors)) in fours.iter_mut().zip(items) {
        let [a, b, c, d] = core::array::from_fn(|k| partial(&bytes[k], &factors[k]));
        let sums = _mm256_hadd_epi32(_mm256_hadd_epi32(a, b), _mm256_hadd_epi32(c, d));
        let halves = cast::<_, [__m128i; 2]>(sums);
        *dots = cast(_mm_add_epi32(halves[0], halves[1]));
    }
    let done = 4 * fours.len();
    for (dot, (bytes, factors)) in rest
        .iter_mut()
        .zip(bytes[done..].iter().zip(&factors[done..]))
    {
        *dot = cast::<_, [i32; 8]>(partial(bytes, factors)).iter().sum();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dot_products_with_two_bit_numbers_are_as_defined() {
        let mut random = fastrand::Rng::with_seed(3);
        let bytes = [(); 7].map(|()| [(); 32].map(|()| random.u8(..)));
        let most = 1 << 14;
        let mut factors = [(); 7].map(|()| [(); 128].map(|()| random.i16(-most..=most)));
        (factors[2], factors[5]) = ([-most; 128], [most - 1; 128]);
        let expected: [i32; 7] = core::array::from_fn(|at| {
            let number = |i: usize| i32::from(bytes[at][i % 32] >> (i / 32 * 2) & 3);
            let product = |i: usize| number(i) * i32::from(factors[at][i]);
            (0..128).map(product).sum()
        });
        let mut dots = [0; 7];
        two_bit_dots_plain(&bytes, &factors, &mut dots);
        assert_eq!(dots, expected);
        arrange_for_dots(&mut factors);
        two_bit_dots(&bytes, &factors, &mut dots);
        assert_eq!(dots, expected);
    }
}
