//! One-way units (open mouth, closed eye): g_min and g_max from the samples, and their weight.
//!
//! Method: Jiang Na et al., section 2.5 and equation (8). From the left end samples are counted; where the gap to the next
//! one exceeds l % of the set's width, everything to the left is dropped and the count restarts; the scan ends when the count
//! reaches k % of all samples, or the samples scanned reach m %. Then the same from the right. The outermost remaining
//! samples are g_min and g_max. w = (g − g_min)/(g_max − g_min): under 0 invalid, above 1 exaggerated and kept.
//!
//! Interpretation: samples count by weight, since they merge; the width is that of the whole set before dropping; a unit whose
//! measure falls (closing an eye) uses the mirrored equation (8).
//! Units: those of the measure. No state. Cost: part of one pass. Degenerate: no samples, or all with the same value, give
//! no interval.
//! Limitation: g_min is the lower tail of the resting noise, so a still face reads 0.2 to 0.4, which the robust method avoids.

use super::samples::Sample;

/// l, k and m of section 2.5, percent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scan {
    /// Gap that cuts, percent of the set's width.
    pub gap: f64,
    /// Count that ends the scan, percent of all.
    pub count: f64,
    /// Scanned total that ends the scan, percent of all.
    pub scanned: f64,
    /// Share of the samples beyond the rest end, percent, because a face rests most of the time; 0: l, k and m as at the other end.
    pub rest: f64,
}

impl Scan {
    /// Best of a grid over simulated sessions: k decides (a larger one cuts expressions), l hardly matters with a small k, m not at
    /// all.
    pub const DEFAULT: Self = Self {
        gap: 3.0,
        count: 0.5,
        scanned: 10.0,
        rest: 0.0,
    };
}

/// Value of the outermost kept sample, scanning `samples` inwards.
fn outermost<'a>(
    samples: impl Iterator<Item = &'a Sample> + Clone,
    total: f64,
    width: f64,
    scan: Scan,
) -> Option<f64> {
    let mut outermost = samples.clone().next()?.value;
    let (mut count, mut scanned) = (0.0, 0.0);
    for (sample, next) in samples.clone().zip(samples.skip(1)) {
        count += sample.weight;
        scanned += sample.weight;
        if count >= 0.01 * scan.count * total || scanned >= 0.01 * scan.scanned * total {
            break;
        }
        if (next.value - sample.value).abs() > 0.01 * scan.gap * width {
            outermost = next.value;
            count = 0.0;
        }
    }
    Some(outermost)
}

/// (g_min, g_max) of ascending samples; `None` if they have no width.
#[inline(never)]
pub fn interval(samples: &[Sample], scan: Scan) -> Option<(f64, f64)> {
    let width = samples.last()?.value - samples.first()?.value;
    let total: f64 = samples.iter().map(|s| s.weight).sum();
    let g_min = outermost(samples.iter(), total, width, scan)?;
    let g_max = outermost(samples.iter().rev(), total, width, scan)?;
    (g_max > g_min).then_some((g_min, g_max))
}

/// Rest end by [`Scan::rest`]: the value with that share of the weight below it (`rising`) or above it. `None` without samples.
pub fn rest_end(samples: &[Sample], scan: Scan, rising: bool) -> Option<f64> {
    let share = if rising { scan.rest } else { 100.0 - scan.rest };
    let total: f64 = samples.iter().map(|s| s.weight).sum();
    let mut below = 0.0;
    let found = samples.iter().find(|sample| {
        below += sample.weight;
        below >= 0.01 * share * total
    });
    found.or(samples.last()).map(|sample| sample.value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(values: &[(f64, f64)]) -> Vec<Sample> {
        values
            .iter()
            .map(|&(value, weight)| Sample { value, weight })
            .collect()
    }

    const SCAN: Scan = Scan {
        gap: 10.0,
        count: 5.0,
        scanned: 10.0,
        rest: 0.0,
    };

    #[test]
    fn drops_lone_outliers_on_both_sides() {
        // Width 10; outliers of weight 1 at both ends, the body 98 of 100 between 4 and 6: gaps of 4 and 4 cut.
        let mut values = vec![(0.0, 1.0)];
        values.extend((0..=20).map(|i| (4.0 + 0.1 * f64::from(i), 98.0 / 21.0)));
        values.push((10.0, 1.0));
        let (low, high) = interval(&samples(&values), SCAN).unwrap();
        assert!(
            (low - 4.0).abs() < 1e-12 && (high - 6.0).abs() < 1e-12,
            "{low} {high}"
        );
    }

    #[test]
    fn keeps_an_end_with_enough_samples() {
        // Six per cent at the right end: count reaches k before the gap is looked at.
        let (low, high) =
            interval(&samples(&[(0.0, 47.0), (1.0, 47.0), (10.0, 6.0)]), SCAN).unwrap();
        assert_eq!((low, high), (0.0, 10.0));
    }

    #[test]
    fn scanned_total_ends_the_scan() {
        // Four outliers of 4 % each with gaps between them: the count restarts each time, but the third reaches m = 10 %.
        let values = [
            (0.0, 4.0),
            (2.0, 4.0),
            (4.0, 4.0),
            (6.0, 4.0),
            (8.0, 42.0),
            (8.5, 42.0),
        ];
        let (low, _) = interval(&samples(&values), SCAN).unwrap();
        assert_eq!(low, 4.0);
    }

    #[test]
    fn the_rest_end_has_its_share_of_the_samples_beyond_it() {
        let five = samples(&[(1.0, 1.0), (2.0, 2.0), (3.0, 4.0), (4.0, 2.0), (9.0, 1.0)]);
        let end = |rest: f64, rising: bool| rest_end(&five, Scan { rest, ..SCAN }, rising);
        for (rest, rising, expected) in [
            (10.0, true, 1.0),
            (11.0, true, 2.0),
            (50.0, true, 3.0),
            (50.0, false, 3.0),
            (25.0, false, 4.0),
            (100.0, true, 9.0),
            (100.0, false, 1.0),
        ] {
            assert_eq!(end(rest, rising), Some(expected), "{rest} {rising}");
        }
        assert_eq!(rest_end(&[], SCAN, true), None);
    }

    #[test]
    fn no_width_no_interval() {
        assert_eq!(interval(&[], SCAN), None);
        assert_eq!(interval(&samples(&[(2.0, 5.0)]), SCAN), None);
        assert_eq!(interval(&samples(&[(2.0, 5.0), (2.0, 5.0)]), SCAN), None);
    }

    #[test]
    fn a_scan_of_all_ends_with_the_last_sample_however_the_sum_rounds() {
        // From the right these add up to 0.6, from the left to a little more: all of it is never reached.
        let three = samples(&[(0.0, 0.1), (1.0, 0.2), (2.0, 0.3)]);
        let all = Scan {
            gap: 100.0,
            count: 100.0,
            scanned: 100.0,
            rest: 0.0,
        };
        let sum = |sum: f64, sample: &Sample| sum + sample.weight;
        assert!(three.iter().rev().fold(0.0, sum) < three.iter().fold(0.0, sum));
        assert_eq!(interval(&three, all), Some((0.0, 2.0)));
    }
}
