//! Correlation of two series.

/// Pearson's correlation of pairs, −1 to 1; 0 without pairs or variance.
pub fn correlation<N: Into<f64>>(pairs: impl IntoIterator<Item = [N; 2]>) -> f64 {
    let pairs: Vec<[f64; 2]> = pairs.into_iter().map(|pair| pair.map(Into::into)).collect();
    let n = pairs.len().max(1) as f64;
    let mean = [0, 1].map(|k| pairs.iter().map(|p| p[k]).sum::<f64>() / n);
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for p in &pairs {
        let [a, b] = [p[0] - mean[0], p[1] - mean[1]];
        ab += a * b;
        aa += a * a;
        bb += b * b;
    }
    let size: f64 = aa * bb;
    if size > 0.0 { ab / size.sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::correlation;

    #[test]
    fn correlation_is_one_minus_one_and_zero_for_equal_opposite_and_constant_series() {
        let line = |slope: f64| (0..9).map(move |k| [f64::from(k), 3.0 + slope * f64::from(k)]);
        assert!((correlation(line(0.1)) - 1.0).abs() < 1e-12);
        assert!((correlation(line(-7.0)) + 1.0).abs() < 1e-12);
        assert_eq!(correlation(line(0.0)), 0.0);
        assert_eq!(correlation([[0.0f32; 2]; 0]), 0.0);
        // By hand: sums of squares 2 and 26/3, of products 3.
        let few = [[1.0f32, 2.0], [2.0, 6.0], [3.0, 5.0]];
        assert!((correlation(few) - 3.0 / (2.0f64 * 26.0 / 3.0).sqrt()).abs() < 1e-12);
    }
}
