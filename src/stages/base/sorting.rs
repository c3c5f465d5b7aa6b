//! Sorting of numbers. The standard library's generic sort adds 9 kB of code to each crate that calls it; this function is compiled once.

/// Sorts in ascending order; positive NaN come last.
#[inline(never)]
pub fn sort(values: &mut [f32]) {
    values.sort_unstable_by(f32::total_cmp);
}
