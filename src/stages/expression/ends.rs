//! Range of one side of a measure: the population's, adapted to the person's expressions.
//!
//! The end is the value beyond which the measure spent T_e = max(0.25 s, 0.3 % of all time), less the noise: long enough to
//! ignore glitches, short enough to keep rare expressions. Evidence n is the time well beyond rest, in half seconds. The range
//! is U ← exp((κ ln U0 + n ln max(reach, 0.3 U0))/(κ + n)): an unseen side keeps its prior, and rest alone never shrinks a
//! range. Units of the measure, weights in seconds. Memory: none. Cost: one pass, run twice a second.

use super::nodes::Node;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Least time beyond an end, seconds.
const BEYOND_S: f64 = 0.25;
/// Least time beyond an end, as a share of all time.
const BEYOND_SHARE: f64 = 0.003;
/// Seconds of expression that count as one piece of evidence.
const PIECE_S: f64 = 0.5;
/// Cap on the evidence, so that the prior keeps some weight.
const MAX_EVIDENCE: f64 = 20.0;
/// Smallest range, as a share of the prior.
const LEAST_SHARE: f64 = 0.3;

/// One side's range and its evidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Side {
    /// Distance from rest to the full expression, in the unit of the measure.
    pub range: f64,
    /// Evidence n, half seconds of expression.
    pub evidence: f64,
}

/// Range and evidence of the upper (`up`) or lower side of `nodes` about `rest`. `growth`: weight of a second in `nodes`; `sigma`:
/// noise; `prior`: U0 > 0; `present`: range in use; `kappa`: weight of the prior in pieces of evidence.
pub fn side(
    nodes: &[Node],
    growth: f64,
    up: bool,
    rest: f64,
    sigma: f64,
    prior: f64,
    present: f64,
    kappa: f64,
) -> Side {
    let total = nodes.iter().map(|node| node.range).sum::<f64>() / growth;
    let enough = (BEYOND_SHARE * total).max(BEYOND_S);
    let departed = (0.4 * present).max(3.0 * sigma);
    let (mut beyond, mut reach, mut expressed) = (0.0, None, 0.0);
    let mut take = |node: &Node| {
        let excursion = if up {
            node.value - rest
        } else {
            rest - node.value
        };
        beyond += node.range / growth;
        if reach.is_none() && beyond >= enough {
            reach = Some(excursion - sigma);
        }
        let is_expression = excursion > departed;
        if is_expression {
            expressed += node.range / growth;
        }
        // Inner nodes are irrelevant once the end is found.
        is_expression || reach.is_none()
    };
    if up {
        nodes.iter().rev().all(&mut take);
    } else {
        nodes.iter().all(&mut take);
    }
    let mut evidence = (expressed / PIECE_S).min(MAX_EVIDENCE);
    let Some(reach) = reach else {
        return Side {
            range: prior,
            evidence: 0.0,
        };
    };
    if reach > present {
        evidence *= 2.0;
    }
    let shown = reach.max(LEAST_SHARE * prior);
    let range = ((kappa * prior.ln() + evidence * shown.ln()) / (kappa + evidence)).exp();
    Side { range, evidence }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expression::nodes::Nodes;

    fn upper(nodes: &Nodes<64>, present: f64) -> Side {
        side(
            nodes.as_slice(),
            nodes.growth(),
            true,
            1.0,
            0.0,
            0.5,
            present,
            8.0,
        )
    }

    fn rested(seconds: f64) -> Nodes<64> {
        let mut nodes = Nodes::default();
        nodes.push(1.0, seconds, seconds);
        nodes
    }

    #[test]
    fn rest_alone_keeps_the_prior() {
        let side = upper(&rested(400.0), 0.5);
        assert!((side.range - 0.5).abs() < 1e-12 && side.evidence == 0.0);
    }

    #[test]
    fn evidence_blends_in_the_logarithm() {
        let mut nodes = rested(10.0);
        nodes.push(1.3, 2.0, 2.0);
        // 2 s at 0.3, n = 4: exp((8 ln 0.5 + 4 ln 0.3)/12).
        let expected = ((8.0 * 0.5f64.ln() + 4.0 * 0.3f64.ln()) / 12.0).exp();
        let side = upper(&nodes, 0.5);
        assert!((side.range - expected).abs() < 1e-12 && (side.evidence - 4.0).abs() < 1e-12);
    }

    #[test]
    fn exceeding_the_range_counts_twice() {
        let mut nodes = rested(10.0);
        nodes.push(1.8, 2.0, 2.0);
        assert!((upper(&nodes, 0.5).evidence - 8.0).abs() < 1e-12);
        assert!((upper(&nodes, 0.9).evidence - 4.0).abs() < 1e-12);
    }

    #[test]
    fn glitches_do_not_extend_the_range() {
        let mut nodes = rested(50.0);
        nodes.push(9.0, 0.1, 0.1);
        let side = upper(&nodes, 0.5);
        assert!(side.range <= 0.5 + 1e-12, "{side:?}");
    }

    #[test]
    fn the_lower_side_is_the_mirror() {
        let mut nodes = rested(10.0);
        nodes.push(0.7, 2.0, 2.0);
        let mut mirrored = rested(10.0);
        mirrored.push(1.3, 2.0, 2.0);
        let low = side(nodes.as_slice(), 1.0, false, 1.0, 0.0, 0.5, 0.5, 8.0);
        assert!((low.range - upper(&mirrored, 0.5).range).abs() < 1e-12);
    }

    #[test]
    fn evidence_needs_two_fifths_of_the_range_and_three_sigma() {
        let evidence = |excursion: f64, sigma: f64| {
            let mut nodes = rested(10.0);
            nodes.push(1.0 + excursion, 2.0, 2.0);
            let (nodes, growth) = (nodes.as_slice(), nodes.growth());
            side(nodes, growth, true, 1.0, sigma, 0.5, 0.5, 8.0).evidence
        };
        for (excursion, sigma, expected) in [
            (0.19, 0.0, 0.0),
            (0.21, 0.0, 4.0),
            (0.29, 0.1, 0.0),
            (0.31, 0.1, 4.0),
        ] {
            let found = evidence(excursion, sigma);
            assert!(
                (found - expected).abs() < 1e-9,
                "{excursion} {sigma}: {found}"
            );
        }
    }

    #[test]
    fn ends_subtract_the_noise_and_ranges_and_evidence_are_bounded() {
        // Everything at 0.4 with noise of 0.05: reach 0.35, a thousand seconds count as 20.
        let mut nodes = rested(10.0);
        nodes.push(1.4, 1000.0, 1000.0);
        let found = side(
            nodes.as_slice(),
            nodes.growth(),
            true,
            1.0,
            0.05,
            0.5,
            0.5,
            8.0,
        );
        let expected = ((8.0 * 0.5f64.ln() + 20.0 * 0.35f64.ln()) / 28.0).exp();
        assert!((found.range - expected).abs() < 1e-12 && found.evidence == 20.0);
        // A range in use of 0.01 takes 0.02 for an expression: twice the evidence, but three tenths of the prior.
        let mut nodes = rested(10.0);
        nodes.push(1.02, 2.0, 2.0);
        let found = upper(&nodes, 0.01);
        let expected = ((8.0 * 0.5f64.ln() + 8.0 * 0.15f64.ln()) / 16.0).exp();
        assert!((found.range - expected).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn an_end_has_the_least_time_beyond_it() {
        // In 1000 s the end is where the last 3 s begin.
        let mut nodes = rested(995.0);
        nodes.push(1.3, 2.5, 2.5);
        nodes.push(1.4, 2.5, 2.5);
        let found = upper(&nodes, 0.5);
        let expected = ((8.0 * 0.5f64.ln() + 10.0 * 0.3f64.ln()) / 18.0).exp();
        assert!((found.range - expected).abs() < 1e-9, "{found:?}");
        // In 20 s it is a quarter of a second: 0.2 s at 1.6 are none, with 0.1 s at 1.5 the end is there.
        let mut nodes = rested(20.0);
        nodes.push(1.5, 0.1, 0.1);
        nodes.push(1.6, 0.2, 0.2);
        let found = upper(&nodes, 0.6);
        let expected = ((8.0 * 0.5f64.ln() + 0.6 * 0.5f64.ln()) / 8.6).exp();
        assert!((found.range - expected).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn growth_scales_evidence() {
        // A growth of 4: every second of a node is a quarter of one now.
        let nodes = |each: f64| {
            let mut nodes = rested(40.0 * each);
            nodes.push(1.3, 0.4 * each, 0.4 * each);
            nodes.push(1.4, 0.1 * each, 0.1 * each);
            nodes
        };
        let (now, later) = (nodes(1.0), nodes(4.0));
        let found = side(later.as_slice(), 4.0, true, 1.0, 0.0, 0.5, 0.5, 8.0);
        assert_eq!(found, upper(&now, 0.5));
        assert!((found.evidence - 1.0).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn exactly_two_fifths_of_the_range_are_no_expression() {
        // 0.4 of 0.625 is a quarter, to the last bit.
        let mut nodes = rested(10.0);
        nodes.push(1.25, 2.0, 2.0);
        assert_eq!(upper(&nodes, 0.625).evidence, 0.0);
        assert!(upper(&nodes, 0.6).evidence > 3.9);
    }
}
