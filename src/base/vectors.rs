//! The widest vectors this processor has, for loops that are worth it.
//!
//! Programs for x86-64 are built for its oldest processors, whose vectors hold four numbers; nearly all that run them have
//! AVX2, with eight. [`wide`] compiles a piece of work for both and chooses while running. Nothing but the width changes: no
//! sum is taken in another order, no product fused into it, so the results are the same to the last bit. Elsewhere (aarch64
//! has its vectors always) the work simply runs.
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
