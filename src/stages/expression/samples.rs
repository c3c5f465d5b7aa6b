//! Bounded, sorted set of weighted samples of one measure that merges when full.
//!
//! Method: Jiang Na et al., section 2.4. While there is room a sample is kept as it is. When the set is full, a new sample
//! s1 is merged with its nearest neighbour s2: v3 = (v1 ω1 + v2 ω2)/(ω1 + ω2) (6), ω3 = ω1 + ω2 (7), and s3 replaces s2.
//! The count does not change; the total weight and the mean are those of everything ever pushed.
//!
//! Weights grow as long as the appliance runs: 30 Hz for a year is 10⁹, where f32 would stop adding within days, so values and
//! weights are f64. To forget, [`SampleSet::decay`] scales all weights down, which also bounds them. Merging depends on weight
//! ratios only, so decaying everything equals increasing the weight of new samples.
//!
//! Units: those of the measure. Memory: 16 N + 8 bytes. Cost of a push: a binary search and a shift.
//! Policy when full: merge. Degenerate: non-finite values and weights ≤ 0 are ignored.
//! Limitation: an expression first shown after the set is full is merged into the topmost resting sample. The robust method's
//! store (`nodes`) merges the cheapest pair instead.

/// One weighted value.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Sample {
    /// Value, in the unit of the measure.
    pub value: f64,
    /// ω, or a sum of them after merging.
    pub weight: f64,
}

impl Sample {
    /// Equations (6) and (7).
    #[must_use]
    pub fn merged(self, other: Self) -> Self {
        let weight = self.weight + other.weight;
        Self {
            value: (self.value * self.weight + other.value * other.weight) / weight,
            weight,
        }
    }
}

/// Samples below this weight are dropped, which also prevents underflow.
const FORGOTTEN: f64 = 1e-3;

/// At most `N` samples, ascending by value.
#[derive(Clone, Debug, Default)]
pub struct SampleSet<const N: usize> {
    samples: heapless::Vec<Sample, N>,
}

impl<const N: usize> SampleSet<N> {
    /// Samples, ascending by value.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Adds a sample; when full it is merged with its nearest neighbour (the lower of two equally near). Ignores non-finite values and
    /// weights ≤ 0.
    pub fn push(&mut self, sample: Sample) {
        if !sample.value.is_finite() || !sample.weight.is_finite() || sample.weight <= 0.0 {
            return;
        }
        let place = self.samples.partition_point(|s| s.value < sample.value);
        if self.samples.insert(place, sample).is_ok() {
            return;
        }
        let gap = |i: usize| (self.samples[i].value - sample.value).abs();
        let beside = place.saturating_sub(1)..(place + 1).min(self.samples.len());
        let nearest = beside.min_by(|&a, &b| gap(a).total_cmp(&gap(b)));
        // Only a set of capacity 0 has neither neighbour.
        let Some(nearest) = nearest else { return };
        // The merged value lies between two neighbours' values, so the order holds.
        self.samples[nearest] = self.samples[nearest].merged(sample);
    }

    /// Multiplies all weights by `factor`, 0 < factor ≤ 1, and drops samples below 0.001.
    pub fn decay(&mut self, factor: f64) {
        for sample in &mut self.samples {
            sample.weight *= factor;
        }
        self.samples.retain(|sample| sample.weight >= FORGOTTEN);
    }

    /// Drops samples outside an interval.
    pub fn keep(&mut self, values: core::ops::RangeInclusive<f64>) {
        self.samples.retain(|sample| values.contains(&sample.value));
    }

    /// Merges the two nearest neighbours repeatedly until `count` samples are left (the lower pair of two equally near).
    pub fn merge_down_to(&mut self, count: usize) {
        while self.samples.len() > count.max(1) {
            let pairs = self
                .samples
                .windows(2)
                .map(|pair| pair[1].value - pair[0].value);
            let cheapest = pairs.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
            let Some((nearest, _)) = cheapest else { return };
            self.samples[nearest] = self.samples[nearest].merged(self.samples[nearest + 1]);
            self.samples.remove(nearest + 1);
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    impl<const N: usize> SampleSet<N> {
        /// Sum of all weights.
        pub(crate) fn total_weight(&self) -> f64 {
            self.samples.iter().map(|s| s.weight).sum()
        }

        /// Weighted mean, if there is any sample.
        pub(crate) fn mean(&self) -> Option<f64> {
            let total = self.total_weight();
            (total > 0.0)
                .then(|| self.samples.iter().map(|s| s.value * s.weight).sum::<f64>() / total)
        }
    }

    pub(crate) fn set<const N: usize>(samples: &[(f64, f64)]) -> SampleSet<N> {
        let mut set = SampleSet::default();
        for &(value, weight) in samples {
            set.push(Sample { value, weight });
        }
        set
    }

    #[test]
    fn equations_6_and_7() {
        // Full at two; 2.0 is nearer to 3.0: (2·1 + 3·3)/4 = 2.75, weight 4.
        let set = set::<2>(&[(0.0, 1.0), (3.0, 3.0), (2.0, 1.0)]);
        assert_eq!(
            set.samples(),
            &[
                Sample {
                    value: 0.0,
                    weight: 1.0
                },
                Sample {
                    value: 2.75,
                    weight: 4.0
                }
            ]
        );
    }

    #[test]
    fn samples_below_a_thousandth_are_dropped() {
        let mut set = set::<4>(&[(1.0, 0.0022), (2.0, 0.0018), (3.0, 1.0)]);
        set.decay(0.5);
        let left: Vec<_> = set.samples().iter().map(|s| (s.value, s.weight)).collect();
        assert_eq!(left, [(1.0, 0.0011), (3.0, 0.5)]);
    }

    #[test]
    fn merging_preserves_total_weight_mean_and_order() {
        let mut random = fastrand::Rng::with_seed(7);
        let mut set = SampleSet::<16>::default();
        let (mut total, mut sum) = (0.0, 0.0);
        for _ in 0..20_000 {
            let sample = Sample {
                value: random.f64() * random.f64() - 0.3,
                weight: 0.4 + 0.6 * random.f64(),
            };
            set.push(sample);
            total += sample.weight;
            sum += sample.weight * sample.value;
        }
        assert_eq!(set.samples().len(), 16);
        assert!(set.samples().windows(2).all(|p| p[0].value <= p[1].value));
        assert!((set.total_weight() - total).abs() < 1e-9 * total);
        assert!((set.mean().unwrap() - sum / total).abs() < 1e-12);
        let mean = set.mean().unwrap();
        set.merge_down_to(3);
        assert_eq!(set.samples().len(), 3);
        assert!(
            (set.mean().unwrap() - mean).abs() < 1e-12
                && (set.total_weight() - total).abs() < 1e-9 * total
        );
    }

    #[test]
    fn a_year_of_samples_still_adds_exactly() {
        // A year at 30 Hz on one sample, then one more sample 0.1 away must still move it by its exact share.
        let year = 30.0 * 86_400.0 * 365.0;
        let mut set = set::<1>(&[(0.5, year)]);
        let before = set.samples()[0];
        for _ in 0..30_000 {
            set.push(Sample {
                value: 0.6,
                weight: 0.95,
            });
        }
        let after = set.samples()[0];
        let added = 30_000.0 * 0.95;
        assert!(
            (after.weight - before.weight - added).abs() < 1e-6 * added,
            "{}",
            after.weight - before.weight
        );
        let expected = 0.1 * added / (year + added);
        let moved = after.value - before.value;
        assert!(
            (moved - expected).abs() < 1e-3 * expected,
            "{moved} for {expected}"
        );
    }

    #[test]
    fn decay_keeps_values_and_bounds_weights() {
        let mut set = SampleSet::<4>::default();
        // Half-life of 1000 pushes: the total never passes 1000/ln 2.
        let factor = 0.5f64.powf(1e-3);
        for i in 0..100_000 {
            set.decay(factor);
            set.push(Sample {
                value: f64::from(i % 7),
                weight: 1.0,
            });
        }
        assert!(set.total_weight() < 1001.0 / 2f64.ln());
    }

    #[test]
    fn refuses_invalid_samples() {
        let set = set::<4>(&[
            (f64::NAN, 1.0),
            (1.0, 0.0),
            (1.0, -1.0),
            (1.0, f64::NAN),
            (f64::INFINITY, 1.0),
        ]);
        assert!(set.samples().is_empty() && set.mean().is_none());
    }
}
