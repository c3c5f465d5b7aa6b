//! Known answers: edges of a window, the first weights shown.

use super::super::estimator::is_warming;
use super::super::measures::tests::toy_face;
use super::super::nodes::Nodes;
use super::super::units::{Kind, Prior};
use super::super::{Expression, Settings, Units, rest_mode};
use crate::base::capacity::LEARNT_MEASURES;
use crate::base::frames::SensorFromFace;
use crate::base::geometry::Rigid;
use crate::base::time::Timestamp;
use crate::landmarks::Landmarks;

#[test]
fn rest_is_the_mean_within_the_closed_window() {
    let prior = Prior {
        kind: Kind::TwoWay,
        rest: 1.0,
        rest_sd: 0.2,
        up: 0.5,
        down: 0.2,
    };
    // All of it exact in binary: the second is just within a quarter of the first.
    let mut nodes: Nodes<64> = Nodes::default();
    nodes.push(1.0, 2.0, 2.0);
    nodes.push(1.25, 2.0, 2.0);
    let mode = rest_mode::mode(nodes.as_slice(), nodes.growth(), 0.25, &prior, 1.0);
    assert_eq!((mode.value, mode.seconds), (1.125, 4.0));
}

#[test]
fn filters_restart_when_weights_fade_in() {
    // Frozen, so that it is not learned from either.
    let shown_after = |first_mm: f32| {
        let mut expression = Expression::new(Settings::default(), Units::shipped().by_measure());
        expression.freeze(true);
        let mut shown = Vec::new();
        for k in 0..60_u64 {
            let hidden = expression
                .weights()
                .units
                .iter()
                .all(|&weight| weight == 0.0);
            let mut head = toy_face();
            let mm = if k < 6 { first_mm } else { 8.0 };
            head[54].x += 0.5e-3 * mm;
            head[48].x -= 0.5e-3 * mm;
            let landmarks = Landmarks::certain(head);
            let at = Timestamp::from_us(k * 33_333);
            let facing = SensorFromFace::assume_frames(Rigid::translation(0.0, 0.0, 0.7));
            expression.observe(&landmarks, &facing, at);
            assert!(k > 6 || hidden, "frame {k} is shown");
            shown.push(expression.weights().units);
        }
        shown
    };
    let (grinning, calm) = (shown_after(40.0), shown_after(8.0));
    assert!(
        calm[59].iter().any(|&weight| weight > 0.05),
        "{:?}",
        calm[59]
    );
    assert_eq!(grinning, calm);
    // Faded in after six tenths of a second, and the same from then on.
    for (early, late) in calm[20].iter().zip(&calm[59]) {
        assert!((early - late).abs() < 0.02, "{early} {late}");
    }
}

#[test]
fn warming_ends_with_half_of_the_rests_known_by_half() {
    // Every other rest is unknown: as many as there may be.
    let known = |readiness: f64| -> [f64; LEARNT_MEASURES] {
        core::array::from_fn(|m| if m % 2 == 1 { 0.0 } else { readiness })
    };
    assert!(!is_warming(known(0.5).into_iter()));
    assert!(is_warming(known(0.5_f64.next_down()).into_iter()));
    let mut too_few = known(1.0);
    too_few[0] = 0.0;
    assert!(is_warming(too_few.into_iter()));
}
