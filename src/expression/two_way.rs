//! Two-way units (pout and grin): g_min, g_rest and g_max from the samples, and their weight.
//!
//! Method: Jiang Na et al., section 2.6 and equation (9). Nearest neighbours are merged, equations (6) and (7), until three
//! samples are left: g_min, g_rest, g_max. w = (g − g_rest)/(g_max − g_rest) for g ≥ g_rest, (g − g_rest)/(g_rest − g_min)
//! below; −1…1, beyond is exaggerated.
//! Units: those of the measure. No state; N² steps on a copy of the set, so twice a second is enough.
//! Degenerate: fewer than three distinct samples give no nodes.
//! Limitation: two outliers can end as {outlier, everything, outlier}, the nodes jump when the order of the last merges
//! changes, and the middle one need not be rest. The robust method avoids all three.

use super::samples::SampleSet;

/// The three nodes of a two-way unit, ascending.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nodes {
    /// Strongest falling expression.
    pub g_min: f64,
    /// Rest.
    pub g_rest: f64,
    /// Strongest rising expression.
    pub g_max: f64,
}

/// Merges a copy of the set down to three.
#[must_use]
pub fn nodes<const N: usize>(set: &SampleSet<N>) -> Option<Nodes> {
    let mut set = set.clone();
    set.merge_down_to(3);
    let [low, rest, high] = set.samples() else {
        return None;
    };
    let nodes = Nodes {
        g_min: low.value,
        g_rest: rest.value,
        g_max: high.value,
    };
    (nodes.g_min < nodes.g_rest && nodes.g_rest < nodes.g_max).then_some(nodes)
}

/// Equation (9): signed weight. `g_min < g_rest < g_max`.
#[must_use]
pub fn weight(g: f64, nodes: Nodes) -> f64 {
    let side = if g >= nodes.g_rest {
        nodes.g_max - nodes.g_rest
    } else {
        nodes.g_rest - nodes.g_min
    };
    (g - nodes.g_rest) / side
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expression::samples::tests::set;

    #[test]
    fn equation_9() {
        let nodes = Nodes {
            g_min: 0.0,
            g_rest: 2.0,
            g_max: 6.0,
        };
        for (g, expected) in [
            (2.0, 0.0),
            (4.0, 0.5),
            (8.0, 1.5),
            (1.0, -0.5),
            (0.0, -1.0),
            (-1.0, -1.5),
        ] {
            assert_eq!(weight(g, nodes), expected, "{g}");
        }
    }

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
        assert!((nodes.g_min - 0.1).abs() < 1e-12);
        assert!((nodes.g_rest - 1.05).abs() < 1e-12);
        assert!((nodes.g_max - 2.15).abs() < 1e-12);
    }

    #[test]
    fn the_known_failure_is_the_papers_own() {
        // One outlier each side swallows neither rest nor smile: {outlier, everything, outlier}.
        let set = set::<8>(&[(-9.0, 1.0), (0.0, 50.0), (1.0, 5.0), (9.0, 1.0)]);
        let nodes = nodes(&set).unwrap();
        assert_eq!((nodes.g_min, nodes.g_max), (-9.0, 9.0));
        assert!((nodes.g_rest - 5.0 / 55.0).abs() < 1e-12);
    }

    #[test]
    fn fewer_than_three_places_give_no_nodes() {
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
