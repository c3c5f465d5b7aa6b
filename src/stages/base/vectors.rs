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

/// The dot product of each item of `factors` with 128 numbers 0…3, two bits each: bits 2k and 2k + 1 of the bytes belong to the k-th
/// quarter of the factors. With AVX2 it uses `vpmaddwd` on vectors of 256 bits; the compiler generates it for 128 bits only.
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

#[cfg(all(target_arch = "x86_64", feature = "std"))]
#[target_feature(enable = "avx2")]
fn two_bit_dots_avx2(bytes: &[[u8; 32]], factors: &[[i16; 128]], dots: &mut [i32]) {
    use bytemuck::cast;
    use core::arch::x86_64::*;
    let lowest = _mm256_set1_epi16(3);
    for ((dot, bytes), factors) in dots.iter_mut().zip(bytes).zip(factors) {
        let (halves, eighths) = (bytes.as_chunks::<16>().0, factors.as_chunks::<16>().0);
        let mut sums = _mm256_setzero_si256();
        for half in 0..2 {
            let mut numbers = _mm256_cvtepu8_epi16(cast(halves[half]));
            for part in 0..4 {
                let factors = cast(eighths[2 * part + half]);
                let products = _mm256_madd_epi16(_mm256_and_si256(numbers, lowest), factors);
                sums = _mm256_add_epi32(sums, products);
                numbers = _mm256_srli_epi16::<2>(numbers);
            }
        }
        *dot = cast::<_, [i32; 8]>(sums).iter().sum();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dot_products_with_two_bit_numbers_are_as_defined() {
        let mut random = fastrand::Rng::with_seed(3);
        let bytes = [(); 3].map(|()| [(); 32].map(|()| random.u8(..)));
        let mut factors = [(); 3].map(|()| [(); 128].map(|()| random.i16(..)));
        factors[2] = [i16::MIN; 128];
        let expected: [i32; 3] = core::array::from_fn(|at| {
            let number = |i: usize| i32::from(bytes[at][i % 32] >> (i / 32 * 2) & 3);
            let product = |i: usize| number(i) * i32::from(factors[at][i]);
            (0..128).map(product).sum()
        });
        for work in [two_bit_dots, two_bit_dots_plain] {
            let mut dots = [0; 3];
            work(&bytes, &factors, &mut dots);
            assert_eq!(dots, expected);
        }
    }
}
