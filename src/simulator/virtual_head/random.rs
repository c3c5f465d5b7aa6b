//! Random numbers as a function of seed and index, without state, so that a frame is a pure function.

/// Hash of seed and index (finaliser of SplitMix64; Steele, Lea & Flood 2014).
pub(crate) fn hash(seed: u64, index: u64) -> u64 {
    let mut z = seed ^ index.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Uniform random number in −1…1 for each seed and index.
pub(crate) fn uniform(seed: u64, index: u64) -> f32 {
    (hash(seed, index) >> 40) as f32 / (1u64 << 23) as f32 - 1.0
}
