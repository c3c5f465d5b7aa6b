//! Two-way units (pout and grin): g_min, g_rest and g_max from the samples, and their weight.
//!
//! Method: Jiang Na et al., section 2.6 and equation (9). Nearest neighbours are merged, equations (6) and (7), until three
//! samples are left: g_min, g_rest, g_max. w = (g − g_rest)/(g_max − g_rest) for g ≥ g_rest, (g − g_rest)/(g_rest − g_min)
//! below; beyond −1…1 is exaggerated.
//!
//! The paper assumes enough samples, most of them near rest, and few exaggerated. Until that holds, our interpretation: samples
//! dropped by the scan of section 2.5 are outliers here too, and the heaviest of the three is rest. If it is an outer one, that
//! side is unseen. docs/paper.md has the results without this.
//! Units: those of the measure. No state; N² steps on a copy of the set, so twice a second is enough.
//! Degenerate: fewer than three distinct samples give no nodes.
//! Limitation: the nodes jump when the order of the last merges changes. The robust method avoids it.

use super::one_way::{self, Scan};
use super::range::Range;
use super::samples::{Sample, SampleSet};

/// Merges a copy of the set to three samples: g_min, g_rest and g_max, ascending; `None` with fewer than three distinct values.
pub fn nodes<const N: usize>(set: &SampleSet<N>) -> Option<[Sample; 3]> {
    let mut set = set.clone();
    set.merge_down_to(3);
    let nodes: [Sample; 3] = set.samples().try_into().ok()?;
    nodes
        .is_sorted_by(|a, b| a.value < b.value)
        .then_some(nodes)
}

/// Range of the samples; on an unseen side the node equals rest. `None` as [`nodes`].
pub fn range<const N: usize>(set: &SampleSet<N>, scan: Scan) -> Option<Range> {
    let (low, high) = one_way::interval(set.samples(), scan)?;
    let mut set = set.clone();
    set.keep(low..=high);
    let nodes = nodes(&set)?;
    let heaviest = nodes.iter().max_by(|a, b| a.weight.total_cmp(&b.weight));
    Some(Range {
        low: nodes[0].value,
        rest: heaviest?.value,
        high: nodes[2].value,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expression::samples::tests::set;

    #[test]
    fn three_groups_become_the_three_nodes() {
        let set = set::<8>(&[
            (0.0, 1.0),
            (0.2, 1.0),
            (1.0, 8.0),
            (1.1, 8.0),
            (2.0, 1.0),
            (2.2, 3.0),
        ]);
        let nodes = nodes(&set).unwrap();
        for (node, expected) in nodes.iter().zip([0.1, 1.05, 2.15]) {
            assert!((node.value - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn the_papers_known_failure() {
        // One outlier each side swallows neither rest nor smile: {outlier, everything, outlier}.
        let set = set::<8>(&[(-9.0, 1.0), (0.0, 50.0), (1.0, 5.0), (9.0, 1.0)]);
        let [low, rest, high] = nodes(&set).unwrap();
        assert_eq!((low.value, high.value), (-9.0, 9.0));
        assert!((rest.value - 5.0 / 55.0).abs() < 1e-12);
    }

    #[test]
    fn outliers_are_dropped_and_the_heaviest_sample_is_rest() {
        let scan = Scan {
            gap: 10.0,
            count: 3.0,
            scanned: 50.0,
            rest: 0.0,
        };
        let outliers = set::<8>(&[
            (-9.0, 1.0),
            (-0.5, 5.0),
            (0.0, 50.0),
            (1.0, 5.0),
            (9.0, 1.0),
        ]);
        let found = range(&outliers, scan).unwrap();
        assert_eq!((found.low, found.rest, found.high), (-0.5, 0.0, 1.0));
        // Nothing was shown below rest: that side has no width.
        let grins = set::<8>(&[(0.0, 50.0), (1.0, 5.0), (1.3, 5.0)]);
        let found = range(&grins, scan).unwrap();
        assert_eq!((found.low, found.rest, found.high), (0.0, 0.0, 1.3));
    }

    #[test]
    fn fewer_than_three_values_give_no_nodes() {
        assert_eq!(nodes(&set::<4>(&[(0.0, 1.0), (1.0, 1.0)])), None);
        assert_eq!(
            nodes(&set::<4>(&[(1.0, 1.0), (1.0, 1.0), (1.0, 1.0)])),
            None
        );
    }

    #[test]
    fn a_side_without_a_width_is_none() {
        assert!(nodes(&set::<3>(&[(1.0, 1.0), (2.0, 1.0), (3.0, 1.0)])).is_some());
        assert_eq!(
            nodes(&set::<3>(&[(1.0, 1.0), (1.0, 1.0), (3.0, 1.0)])),
            None
        );
        assert_eq!(
            nodes(&set::<3>(&[(1.0, 1.0), (3.0, 1.0), (3.0, 1.0)])),
            None
        );
    }
}
