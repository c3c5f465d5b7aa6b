//! Runs hot loops with the widest vector instructions of the processor.
//!
//! The x86-64 baseline has vectors of four floats; nearly all processors in use have AVX2, with eight. [`with_avx2`] compiles a
//! closure for both and chooses at run time. Only the width changes: no sum is reordered and no multiply-add fused, so the
//! results are bit-identical. Other architectures run the closure as compiled.
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

/// Runs `work`, compiled for AVX2 if the processor has it. Only inlined callees are compiled so.
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
