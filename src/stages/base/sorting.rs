//! Sorting of numbers. The library's generic sort is 9 kB in each crate that uses it; this function exists once.

/// Sorts ascending, NaN last.
#[inline(never)]
pub fn sort(values: &mut [f32]) {
    values.sort_unstable_by(f32::total_cmp);
}
