//! Runs hot loops with the widest vectors the processor has.
//!
//! Programs for x86-64 target its oldest processors, whose vectors hold four numbers; nearly all processors in use have
//! AVX2, with eight. [`wide`] compiles a piece of work for both and chooses at run time. Only the width changes: no sum is
//! reordered and no multiply-add fused, so the results are bit-identical. On other architectures (aarch64 always has its
//! vectors) the work runs as it is.
#![cfg_attr(
    all(target_arch = "x86_64", feature = "std"),
    expect(
        unsafe_code,
        reason = "code for a newer processor may only be called on one"
    )
)]

/// Added to a float of at most 2²¹ it leaves no bit for a fraction: the sum is rounded, its last bits are the whole number.
/// Unlike a conversion this becomes a vector instruction.
pub const NO_FRACTION: f32 = 12_582_912.0;

/// Does `work`, with eight-wide vectors if there are any. What it calls takes part only where it is inlined.
#[inline(always)]
pub fn wide<R>(work: impl FnOnce() -> R) -> R {
    #[cfg(all(target_arch = "x86_64", feature = "std"))]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the one thing `with_avx2` asks for has just been found.
        return unsafe { with_avx2(work) };
    }
    work()
}

#[cfg(all(target_arch = "x86_64", feature = "std"))]
#[target_feature(enable = "avx2")]
fn with_avx2<R>(work: impl FnOnce() -> R) -> R {
    work()
}
