//! Local normalisation of the grey values compared by the fit.
//!
//! The paper compares pixel values. Side light and another person's skin change them over whole cheeks by more than an eyelid
//! does, and a model not trained on the person moves its points to compensate. So every value is reduced by the mean of its
//! surroundings and divided by their standard deviation.
//! Window pixels. Cost: ten passes over the window. Degenerate: where all pixels are equal the values are 0.

#[cfg(not(feature = "std"))]
use crate::base::prelude::*;
use crate::base::vectors::with_avx2;
use crate::landmarks::window::WINDOW;

/// Half the side of the surroundings' square, averaged twice, window pixels.
const AROUND: usize = 6;
/// Half the side of the square averaged against sensor noise, window pixels.
const SMOOTH: usize = 1;
/// Variance of noise, squared grey values.
const NOISE: f32 = 9.0;

/// Box blur of the window in place, `2 radius + 1` pixels wide; the edge is repeated. `spare` is scratch.
pub(crate) fn blur(plane: &mut [f32], spare: &mut [f32], radius: usize) {
    let share = 1.0 / (2 * radius + 1) as f32;
    let last = WINDOW - 1;
    for (line, out) in plane
        .chunks_exact(WINDOW)
        .zip(spare.chunks_exact_mut(WINDOW))
    {
        let mut sum = line[0] * radius as f32 + line[..=radius].iter().sum::<f32>();
        for (x, out) in out.iter_mut().enumerate() {
            *out = sum * share;
            sum += line[(x + radius + 1).min(last)] - line[x.saturating_sub(radius)];
        }
    }
    let mut sums = [0.0_f32; WINDOW];
    for (x, sum) in sums.iter_mut().enumerate() {
        let below = (0..=radius).map(|y| spare[y * WINDOW + x]);
        *sum = spare[x] * radius as f32 + below.sum::<f32>();
    }
    for (y, line) in plane.chunks_exact_mut(WINDOW).enumerate() {
        let ahead = &spare[(y + radius + 1).min(last) * WINDOW..][..WINDOW];
        let behind = &spare[y.saturating_sub(radius) * WINDOW..][..WINDOW];
        with_avx2(|| {
            for (((out, sum), ahead), behind) in
                line.iter_mut().zip(&mut sums).zip(ahead).zip(behind)
            {
                *out = *sum * share;
                *sum += ahead - behind;
            }
        });
    }
}

/// Writes the window's normalised grey values to `plane`; `other` and `spare` are scratch. All [`WINDOW`]² values.
pub fn normalised(window: &[f32], plane: &mut [f32], other: &mut [f32], spare: &mut [f32]) {
    plane.copy_from_slice(window);
    blur(plane, spare, SMOOTH);
    other.copy_from_slice(plane);
    blur(other, spare, AROUND);
    blur(other, spare, AROUND);
    for (value, mean) in plane.iter_mut().zip(other.iter_mut()) {
        *value -= *mean;
        *mean = *value * *value;
    }
    blur(other, spare, AROUND);
    blur(other, spare, AROUND);
    for (value, variance) in plane.iter_mut().zip(other.iter()) {
        *value /= (variance + NOISE).sqrt();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn normalised_plane(window: &[f32]) -> Vec<f32> {
        let room = || vec![0.0; WINDOW * WINDOW];
        let (mut plane, mut other, mut spare) = (room(), room(), room());
        normalised(window, &mut plane, &mut other, &mut spare);
        plane
    }

    fn pattern(light: impl Fn(f32, f32) -> [f32; 2]) -> Vec<f32> {
        let at = |k: usize| {
            let (x, y) = ((k % WINDOW) as f32, (k / WINDOW) as f32);
            let [gain, offset] = light(x, y);
            offset + gain * ((x / 4.0).sin() + (y / 5.0).cos())
        };
        (0..WINDOW * WINDOW).map(at).collect()
    }

    #[test]
    fn box_blur_is_a_mean_with_repeated_edges() {
        let mut plane = vec![0.0; WINDOW * WINDOW];
        plane[0] = 9.0;
        plane[50 * WINDOW + 60] = 9.0;
        let mut spare = plane.clone();
        blur(&mut plane, &mut spare, 1);
        assert!(
            (plane[51 * WINDOW + 59] - 1.0).abs() < 1e-5 && plane[52 * WINDOW + 60].abs() < 1e-5
        );
        // The corner counts four times: itself, two edge repetitions and one of the corner.
        assert!((plane[0] - 4.0).abs() < 1e-5);
    }

    #[test]
    fn side_light_changes_little_and_a_flat_image_is_zero() {
        let even = normalised_plane(&pattern(|_, _| [40.0, 120.0]));
        let side = normalised_plane(&pattern(|x, _| {
            let gain = 0.4 + x / 184.0;
            [40.0 * gain, 120.0 * gain]
        }));
        let off: f32 = even.iter().zip(&side).map(|(a, b)| (a - b).powi(2)).sum();
        let size: f32 = even.iter().map(|a| a * a).sum();
        assert!((off / size).sqrt() < 0.1, "{}", (off / size).sqrt());
        assert!(
            normalised_plane(&vec![77.0; WINDOW * WINDOW])
                .iter()
                .all(|v| v.abs() < 1e-4)
        );
    }
}
