//! Bounded, sorted store of one measure's history that merges its cheapest adjacent pair.
//!
//! Each node has a value and two weights in seconds of presence: `rest`, which counts a held expression less the longer it
//! lasts, and `range`, plain time. A new value is always inserted; then the adjacent pair with the lowest merging cost
//! d² c1 c2/(c1 + c2) is merged (Ward, *Hierarchical grouping to optimize an objective function*, 1963, in one dimension).
//! Unlike merging a new value with its nearest neighbour, this keeps rare expressions apart from the many values at rest.
//!
//! Forgetting: new weights grow by 2^(t/H) ([`Nodes::advance`]) and everything is divided when the factor passes 10⁶, so
//! old weights need not be touched every frame and the sums stay below H/ln 2 seconds, within any float's precision.
//! Memory: 32 bytes a node. Cost of a push: one search, one shift, one pass over the costs; two costs are recomputed.
//! Policy when full: merge; total weights and the mean are preserved. The caller passes finite values only.

#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// A value and its weights in seconds times [`Nodes::growth`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Node {
    /// Value, in the unit of the measure.
    pub value: f64,
    /// Weight for finding rest.
    pub rest: f64,
    /// Weight for finding the ends.
    pub range: f64,
    /// Cost of merging with the next node.
    cost: f64,
}

impl Node {
    fn merged(self, other: Self) -> Self {
        let range = self.range + other.range;
        // Both may have decayed to 0.
        let share = if range > 0.0 {
            other.range / range
        } else {
            0.5
        };
        Self {
            value: self.value + (other.value - self.value) * share,
            rest: self.rest + other.rest,
            range,
            cost: f64::INFINITY,
        }
    }

    fn cost_with(self, other: Self) -> f64 {
        let d = other.value - self.value;
        let range = self.range + other.range;
        if range > 0.0 {
            d * d * self.range * other.range / range
        } else {
            0.0
        }
    }
}

/// Growth at which all weights are rescaled.
const GROWTH_LIMIT: f64 = 1e6;
/// Weight for the ends of a sample that counts for rest only, seconds: enough to survive merging, negligible for the ends.
const LEAST_RANGE_WEIGHT: f64 = 1e-6;

/// At most `N` nodes, ascending by value.
#[derive(Clone, Debug)]
pub struct Nodes<const N: usize> {
    nodes: heapless::Vec<Node, N>,
    growth: f64,
}

impl<const N: usize> Default for Nodes<N> {
    fn default() -> Self {
        Self {
            nodes: heapless::Vec::new(),
            growth: 1.0,
        }
    }
}

impl<const N: usize> Nodes<N> {
    /// Nodes, ascending by value; weights divided by [`Self::growth`] are seconds.
    pub fn as_slice(&self) -> &[Node] {
        &self.nodes
    }

    /// Weight of one second now.
    pub const fn growth(&self) -> f64 {
        self.growth
    }

    /// Advances time by `dt` seconds: older weights are halved every `half_life_s` (0: never).
    pub fn advance(&mut self, dt: f64, half_life_s: f64) {
        if half_life_s <= 0.0 {
            return;
        }
        self.growth *= (dt / half_life_s).exp2();
        if self.growth > GROWTH_LIMIT {
            let shrink = 1.0 / self.growth;
            for node in &mut self.nodes {
                node.rest *= shrink;
                node.range *= shrink;
                node.cost *= shrink;
            }
            self.growth = 1.0;
        }
    }

    /// Inserts a finite value with its weights in seconds; merges the cheapest pair when full.
    pub fn push(&mut self, value: f64, rest_s: f64, range_s: f64) {
        // Merge first, so that the new value always gets its own node.
        if self.nodes.is_full() {
            self.merge_cheapest();
        }
        let index = self.nodes.partition_point(|node| node.value < value);
        let node = Node {
            value,
            rest: rest_s * self.growth,
            range: range_s.max(LEAST_RANGE_WEIGHT) * self.growth,
            cost: f64::INFINITY,
        };
        if self.nodes.insert(index, node).is_ok() {
            self.update_cost(index);
            if let Some(below) = index.checked_sub(1) {
                self.update_cost(below);
            }
        }
    }

    fn update_cost(&mut self, i: usize) {
        self.nodes[i].cost = match self.nodes.get(i + 1) {
            Some(&next) => self.nodes[i].cost_with(next),
            None => f64::INFINITY,
        };
    }

    fn merge_cheapest(&mut self) {
        let (mut cheapest, mut cost) = (0, f64::INFINITY);
        for (i, node) in self.nodes.iter().enumerate() {
            if node.cost < cost {
                (cheapest, cost) = (i, node.cost);
            }
        }
        if cheapest + 1 >= self.nodes.len() {
            return;
        }
        self.nodes[cheapest] = self.nodes[cheapest].merged(self.nodes[cheapest + 1]);
        self.nodes.remove(cheapest + 1);
        self.update_cost(cheapest);
        if let Some(below) = cheapest.checked_sub(1) {
            self.update_cost(below);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl<const N: usize> Nodes<N> {
        /// Totals of both weights, in current seconds: (rest, range).
        fn totals(&self) -> (f64, f64) {
            let (rest, range) = self
                .nodes
                .iter()
                .fold((0.0, 0.0), |(w, c), node| (w + node.rest, c + node.range));
            (rest / self.growth, range / self.growth)
        }
    }

    #[test]
    fn merging_preserves_totals_mean_and_order() {
        let mut random = fastrand::Rng::with_seed(5);
        let mut nodes = Nodes::<16>::default();
        let (mut rest, mut range, mut sum) = (0.0, 0.0, 0.0);
        for _ in 0..10_000 {
            let (value, w, c) = (random.f64(), random.f64(), 0.1 + random.f64());
            nodes.push(value, w, c);
            rest += w;
            range += c;
            sum += value * c;
        }
        let (found_rest, found_range) = nodes.totals();
        assert!(
            (found_rest - rest).abs() < 1e-9 * rest && (found_range - range).abs() < 1e-9 * range
        );
        let mean = nodes
            .as_slice()
            .iter()
            .map(|n| n.value * n.range)
            .sum::<f64>()
            / found_range;
        assert!((mean - sum / range).abs() < 1e-9);
        assert!(
            nodes
                .as_slice()
                .windows(2)
                .all(|p| p[0].value <= p[1].value)
        );
        for pair in nodes.as_slice().windows(2) {
            let fresh = pair[0].cost_with(pair[1]);
            assert!(
                (pair[0].cost - fresh).abs() <= 1e-9 * fresh,
                "cached costs are true"
            );
        }
    }

    #[test]
    fn a_late_smile_keeps_its_node() {
        // Nearest-neighbour merging would average it into the resting crowd.
        let mut random = fastrand::Rng::with_seed(6);
        let mut nodes = Nodes::<16>::default();
        for _ in 0..3000 {
            nodes.push(0.05 * random.f64(), 0.03, 0.03);
        }
        for _ in 0..10 {
            nodes.push(1.0, 0.03, 0.03);
        }
        for _ in 0..3000 {
            nodes.push(0.05 * random.f64(), 0.03, 0.03);
        }
        let top = nodes.as_slice().last().unwrap();
        assert!((top.value - 1.0).abs() < 1e-9 && (top.range - 0.3).abs() < 1e-9);
    }

    #[test]
    fn forgetting_bounds_the_sums_over_a_year() {
        // A year in steps of ten seconds, half-life 300 s: the total is 1/(1 − 2^(−10/300)).
        let mut nodes = Nodes::<8>::default();
        for i in 0..3_153_600u32 {
            nodes.advance(10.0, 300.0);
            nodes.push(f64::from(i % 5), 1.0, 1.0);
        }
        let expected = 1.0 / (1.0 - 0.5f64.powf(10.0 / 300.0));
        let (rest, range) = nodes.totals();
        assert!(
            (rest - expected).abs() < 1e-6 * expected && (range - expected).abs() < 1e-6 * expected
        );
        assert!(nodes.growth() <= GROWTH_LIMIT);
    }

    #[test]
    fn weights_are_halved_after_the_half_life() {
        let mut nodes = Nodes::<8>::default();
        nodes.push(1.0, 2.0, 4.0);
        nodes.advance(300.0, 300.0);
        let (rest, range) = nodes.totals();
        assert!((rest - 1.0).abs() < 1e-12 && (range - 2.0).abs() < 1e-12);
        nodes.advance(1e9, 0.0);
        assert!(
            (nodes.totals().0 - 1.0).abs() < 1e-12,
            "half-life 0 never forgets"
        );
    }

    #[test]
    fn weights_are_rescaled_above_the_growth_limit() {
        // The next power of two is more than a million, and divides exactly.
        for (grown, left) in [(1e6, 1e6), (1_048_576.0, 1.0)] {
            let mut nodes = Nodes::<8> {
                growth: grown,
                ..Nodes::default()
            };
            nodes.push(1.0, 2.0, 4.0);
            nodes.advance(0.0, 300.0);
            let node = nodes.as_slice()[0];
            assert_eq!((node.rest, node.range), (2.0 * left, 4.0 * left));
            assert_eq!((nodes.growth(), nodes.totals()), (left, (2.0, 4.0)));
        }
    }
}
