//! Rest of a measure: the mode of its history, regularised by the population.
//!
//! Rest is the value to which a person returns. Unlike mean, median and quantiles, the mode does not follow a long smile.
//! score(v) = [W within v ± h + 0.3 s × the prior's mass there] × exp(−½ ((v − r0)/(2 s0))²): W in seconds (a held pose
//! counts less the longer it lasts), N(r0, s0²) rest over people. The best node is refined by mean shift (Fukunaga &
//! Hostetler 1975). Rest moves by more than 2.5 h only to a node that scores 1.3 times as high.
//! Units of the measure. Memory: none. Cost: a few passes, run twice a second. Degenerate: an empty store gives r0.
//! Limitation: an expression held from the first frame on is taken for rest until it ends; nothing distinguishes the two.

use super::nodes::Node;
use super::units::Prior;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Weight of the population's mass, seconds.
const PRIOR_S: f64 = 0.3;
/// Least ratio of scores for a jump.
const HYSTERESIS: f64 = 1.3;
/// Least distance of a jump, half-widths of the window.
const FAR: f64 = 2.5;
/// Steps of mean shift: enough to converge within a window.
const SHIFTS: usize = 6;

/// Rest and the seconds of evidence within its window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    /// Rest, in the unit of the measure.
    pub value: f64,
    /// Evidence W within the window, seconds.
    pub seconds: f64,
}

/// Mode of `nodes` (weights divided by `growth` are seconds) with window half-width `h`, from the present rest. Ties go to the
/// population's rest, then to the lower node.
pub fn mode(nodes: &[Node], growth: f64, h: f64, prior: &Prior, present: f64) -> Mode {
    let weight_within = |v: f64| {
        let first = nodes.partition_point(|node| node.value < v - h);
        nodes[first..]
            .iter()
            .take_while(|node| node.value <= v + h)
            .map(|node| node.rest)
            .sum::<f64>()
            / growth
    };
    // The prior's mass within a window at its rest.
    let densest = 2.0 * h / (prior.rest_sd * (2.0 * core::f64::consts::PI).sqrt());
    let score = |v: f64, weight: f64| {
        let z = (v - prior.rest) / prior.rest_sd;
        let near = (-0.125 * z * z).exp();
        (weight + PRIOR_S * (densest * near.powi(4)).min(1.0)) * near
    };
    let shifted = |mut v: f64| {
        for _ in 0..SHIFTS {
            let (mut sum, mut weight) = (0.0, 0.0);
            for node in nodes.iter().filter(|node| (node.value - v).abs() <= h) {
                sum += node.value * node.rest;
                weight += node.rest;
            }
            if weight <= 0.0 {
                break;
            }
            let last = core::mem::replace(&mut v, sum / weight);
            if v == last {
                break;
            }
        }
        v
    };
    let mut best = (prior.rest, score(prior.rest, weight_within(prior.rest)));
    for (v, weight) in windows(nodes, h) {
        let weight = weight / growth;
        // Skip nodes whose upper bound is not better.
        if weight + PRIOR_S * densest.min(1.0) <= best.1 {
            continue;
        }
        let score = score(v, weight);
        if score > best.1 {
            best = (v, score);
        }
    }
    let here = shifted(present);
    let stays = (best.0 - present).abs() > FAR * h
        && best.1 < HYSTERESIS * score(here, weight_within(here));
    let value = if stays { here } else { shifted(best.0) };
    Mode {
        value,
        seconds: weight_within(value),
    }
}

/// Every node's value and the weight within `h` of it, by a sliding window over ascending nodes.
fn windows(nodes: &[Node], h: f64) -> impl Iterator<Item = (f64, f64)> {
    let (mut first, mut end, mut within) = (0, 0, 0.0);
    nodes.iter().map(move |&Node { value: v, .. }| {
        while let Some(next) = nodes.get(end).filter(|next| next.value <= v + h) {
            within += next.rest;
            end += 1;
        }
        while nodes[first].value < v - h {
            within -= nodes[first].rest;
            first += 1;
        }
        (v, within)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expression::nodes::Nodes;
    use crate::expression::units::Kind;

    const PRIOR: Prior = Prior {
        kind: Kind::TwoWay,
        rest: 1.0,
        rest_sd: 0.2,
        up: 0.5,
        down: 0.2,
    };
    const H: f64 = 0.05;

    fn find(nodes: &Nodes<64>, present: f64) -> Mode {
        mode(nodes.as_slice(), nodes.growth(), H, &PRIOR, present)
    }

    #[test]
    fn without_data_it_is_the_population() {
        assert_eq!(
            find(&Nodes::default(), 1.0),
            Mode {
                value: 1.0,
                seconds: 0.0
            }
        );
    }

    #[test]
    fn the_mode_wins_over_tails_and_prior() {
        let mut nodes = Nodes::default();
        for i in 0..100 {
            nodes.push(1.2 + 0.0004 * f64::from(i % 11) - 0.002, 0.03, 0.03);
            nodes.push(1.3 + 0.005 * f64::from(i), 0.01, 0.03);
        }
        let mode = find(&nodes, 1.0);
        assert!((mode.value - 1.2).abs() < 0.002, "{mode:?}");
        assert!((mode.seconds - 3.0).abs() < 0.1);
    }

    #[test]
    fn the_prior_weighs_three_tenths_of_a_second() {
        // Within h of r0 lie 2 h/(s0 √2π) = 0.199 47 of the people, worth 0.059 84 s; one s0 off lie 0.120 98 of them, 0.036 30 s,
        // and all counts 0.882 50 there. So a node there wins with more than 0.031 51 s of its own. Neither is far from 1.1.
        for (seconds, rest) in [(0.030, 1.0), (0.033, 1.2)] {
            let mut nodes = Nodes::default();
            nodes.push(1.2, seconds, seconds);
            assert_eq!(find(&nodes, 1.1).value, rest, "{seconds} s");
        }
    }

    #[test]
    fn a_far_mode_needs_a_clearly_higher_score() {
        let mut nodes = Nodes::default();
        nodes.push(0.9, 10.0, 10.0);
        // Same distance from the population's mean, so the prior is neutral.
        nodes.push(1.1, 12.0, 12.0);
        nodes.push(1.3, 0.1, 0.1);
        assert!((find(&nodes, 0.9).value - 0.9).abs() < 1e-9);
        nodes.push(1.1, 2.0, 2.0);
        assert!((find(&nodes, 0.9).value - 1.1).abs() < 1e-9);
    }

    #[test]
    fn the_prior_decides_ties() {
        let mut nodes = Nodes::default();
        nodes.push(1.1, 5.0, 5.0);
        nodes.push(1.6, 6.0, 6.0);
        assert!(
            (find(&nodes, 1.35).value - 1.1).abs() < 1e-9,
            "1.6 is three deviations away"
        );
    }

    #[test]
    fn a_window_has_both_its_ends() {
        // All of it exact in binary: ends at 0.75 and 1.25 about 1.
        let mut nodes: Nodes<64> = Nodes::default();
        for value in [0.75, 1.0, 1.25] {
            nodes.push(value, 2.0, 2.0);
        }
        let mode = mode(nodes.as_slice(), nodes.growth(), 0.25, &PRIOR, 1.0);
        assert_eq!(
            mode,
            Mode {
                value: 1.0,
                seconds: 6.0
            }
        );
    }

    #[test]
    fn the_lower_of_equal_modes_is_rest() {
        // All of it exact in binary: a quarter below and above what people have, so that their scores are the same.
        let mut nodes: Nodes<64> = Nodes::default();
        nodes.push(0.75, 2.0, 2.0);
        nodes.push(1.25, 2.0, 2.0);
        let mode = mode(nodes.as_slice(), nodes.growth(), 0.125, &PRIOR, 1.0);
        assert_eq!((mode.value, mode.seconds), (0.75, 2.0));
    }
}
