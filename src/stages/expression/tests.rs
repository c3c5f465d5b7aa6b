//! The stage as a whole, on a toy face; sessions with known truth are in `tests/it/learns_a_range.rs`.

mod known_answers;

use super::measures::tests::toy_face;
use super::*;
use crate::base::frames::SensorFromFace;
use crate::base::geometry::Point;
use crate::base::geometry::Rigid;

fn facing() -> SensorFromFace {
    SensorFromFace::assume_frames(Rigid::translation(0.0, 0.0, 0.7))
}

fn frame(n: u64) -> Timestamp {
    Timestamp::from_us(n * 33_333)
}

/// The toy face with its mouth corners drawn out, in mm.
fn grin(mm: f32) -> Landmarks {
    let mut head = toy_face();
    head[54].x += 0.5e-3 * mm;
    head[48].x -= 0.5e-3 * mm;
    Landmarks::certain(head)
}

fn column(expression: &Expression, name: &str) -> usize {
    expression
        .unit_names()
        .iter()
        .position(|n| n == name)
        .unwrap()
}

#[test]
fn one_person_fits_the_memory_budget() {
    assert!(
        size_of::<Expression>() <= 64 * 1024,
        "{} bytes",
        size_of::<Expression>()
    );
}

#[test]
fn a_two_way_measure_moves_one_column_at_a_time() {
    for method in [Method::Robust, Method::Paper] {
        let mut expression = Expression::new(
            Settings {
                method,
                ..Settings::default()
            },
            Units::shipped().by_measure(),
        );
        let (grins, pouts) = (column(&expression, "AU20"), column(&expression, "AU18"));
        let (mut most_grin, mut most_pout) = (0f32, 0f32);
        for n in 0..1200 {
            let mm = match n % 300 {
                200..230 => 12.0,
                250..280 => -8.0,
                _ => 0.0,
            };
            let weights = expression.observe(&grin(mm), &facing(), frame(n));
            let (grin, pout) = (weights.units()[grins], weights.units()[pouts]);
            assert!(grin == 0.0 || pout == 0.0);
            assert!(weights.units().iter().all(|w| w.is_finite() && *w >= 0.0));
            (most_grin, most_pout) = (most_grin.max(grin), most_pout.max(pout));
        }
        assert!(
            most_grin > 0.5 && most_pout > 0.5,
            "{method:?}: {most_grin} {most_pout}"
        );
    }
}

#[test]
fn a_smile_that_widens_the_mouth_is_no_stretch() {
    for method in [Method::Robust, Method::Paper] {
        let settings = Settings {
            method,
            ..Settings::default()
        };
        let mut expression = Expression::new(settings, Units::shipped().by_measure());
        let stretch = column(&expression, "AU20");
        let mut shown = |raised: f32, frames: core::ops::Range<u64>| {
            let mut last = 0.0;
            for n in frames {
                let acts = n % 300 >= 200;
                // A face is never quite still.
                let mut face = grin(if acts { 12.0 } else { 0.05 * (n % 3) as f32 });
                for corner in [48, 54] {
                    face.head[corner].y -= if acts { 1e-3 * raised } else { 0.0 };
                }
                last = expression.observe(&face, &facing(), frame(n)).units()[stretch];
            }
            last
        };
        let (stretched, smiled) = (shown(0.0, 0..230), shown(7.0, 230..520));
        assert!(
            stretched > 0.5 && smiled < 0.15,
            "{method:?}: {stretched}, {smiled}"
        );
    }
}

#[test]
fn the_response_rises_with_the_measure() {
    let mut expression = Expression::new(
        Settings {
            smoothing_hz: 0.0,
            ..Settings::default()
        },
        Units::shipped().by_measure(),
    );
    for n in 0..300 {
        expression.observe(&grin(0.0), &facing(), frame(n));
    }
    expression.freeze(true);
    let grins = column(&expression, "AU20");
    let mut last = 0.0;
    for n in 0..50 {
        let w = expression
            .observe(&grin(n as f32 * 0.5), &facing(), frame(300 + n))
            .units()[grins];
        assert!(w >= last);
        last = w;
    }
    assert!(last > 1.0, "exaggerated is kept: {last}");
}

#[test]
fn a_still_face_is_neutral_from_the_first_frame_and_warms_up() {
    let mut expression = Expression::new(Settings::default(), Units::shipped().by_measure());
    let mut warm_after = None;
    for n in 0..300 {
        let weights = expression.observe(&grin(0.0), &facing(), frame(n));
        assert!(
            weights.units().iter().all(|&w| w < 0.1),
            "frame {n}: {:?}",
            weights.units()
        );
        if !weights.warming {
            warm_after.get_or_insert(n);
        }
    }
    assert!((30..200).contains(&warm_after.unwrap()), "{warm_after:?}");
}

#[test]
fn a_slow_camera_warms_up_in_the_same_time() {
    let warming_s = |frame_us: u64| {
        let mut expression = Expression::new(Settings::default(), Units::shipped());
        let mut times = (0..).map(|n| Timestamp::from_us(n * frame_us));
        let warm = times.find(|at| !expression.observe(&grin(0.0), &facing(), *at).warming);
        warm.expect("it ends").as_us() as f64 * 1e-6
    };
    let [usual, slow] = [33_333, 333_333].map(warming_s);
    assert!((usual - slow).abs() < 0.7, "{usual} and {slow} s");
}

#[test]
fn frozen_and_doubtful_frames_teach_nothing() {
    let mut expression = Expression::new(Settings::default(), Units::shipped().by_measure());
    let before = expression.ranges();
    let mut doubtful = grin(5.0);
    doubtful.confidence = 0.1;
    for n in 0..100 {
        expression.observe(&doubtful, &facing(), frame(n));
    }
    assert_eq!(expression.ranges(), before);
    // Part of a face.
    let mut hidden_mouth = grin(5.0);
    hidden_mouth.point_confidence[48..].fill(0.1);
    for n in 100..200 {
        expression.observe(&hidden_mouth, &facing(), frame(n));
    }
    let (seen, width) = (expression.ranges(), Measure::MouthWidth as usize);
    assert_eq!(seen[width], before[width]);
    assert_ne!(seen, before);
    let mut expression = Expression::new(Settings::default(), Units::shipped().by_measure());
    // Turned away: ω < 1/3.
    let away = SensorFromFace::from_parts(
        nalgebra::Translation3::new(0.0, 0.0, 0.7),
        crate::base::geometry::rotation_from_yaw_pitch_roll(1.5, 0.0, 0.0),
    );
    for n in 100..200 {
        expression.observe(&grin(5.0), &away, frame(n));
    }
    assert_eq!(expression.ranges(), before);
    expression.freeze(true);
    for n in 200..300 {
        assert!(expression.observe(&grin(5.0), &facing(), frame(n)).frozen);
    }
    assert_eq!(expression.ranges(), before);
}

#[test]
fn a_broken_frame_repeats_the_last_weights() {
    let mut expression = Expression::new(Settings::default(), Units::shipped().by_measure());
    for n in 0..100 {
        expression.observe(&grin(if n > 60 { 12.0 } else { 0.0 }), &facing(), frame(n));
    }
    let before = expression.weights().units().to_vec();
    let mut broken = grin(0.0);
    broken.head[48].x = f32::NAN;
    assert_eq!(
        expression.observe(&broken, &facing(), frame(100)).units(),
        before
    );
    assert!(before.iter().any(|&w| w > 0.3));
}

#[test]
fn somebody_else_after_a_loss_starts_from_the_population() {
    let mut expression = Expression::new(Settings::default(), Units::shipped().by_measure());
    for n in 0..900 {
        expression.observe(&grin(0.0), &facing(), frame(n));
    }
    let learned = expression.learned();
    // Everything but the eyes drawn out by a fifth.
    let other = Landmarks::certain(toy_face().map(|p| Point::new(p.x, p.y * 1.2, p.z)));
    for n in 1000..1200 {
        expression.observe(&other, &facing(), frame(n));
    }
    assert_eq!(expression.resets(), 1);
    let jaw = Measure::JawDrop as usize;
    assert!((expression.ranges()[jaw].rest - 1.2 * learned.ranges[jaw].rest).abs() < 0.02);

    let mut same = Expression::new(Settings::default(), Units::shipped().by_measure());
    same.restore(&learned);
    for (restored, learned) in same.ranges().iter().zip(&learned.ranges) {
        assert!((restored.rest - learned.rest).abs() < 1e-9);
    }
    for n in 0..300 {
        let weights = same.observe(&grin(0.0), &facing(), frame(n));
        assert!(weights.units().iter().all(|&w| w < 0.05));
    }
    assert_eq!(same.resets(), 0);
}

/// Somebody who grins every ten seconds, after a minute.
fn grinning() -> Expression {
    let mut expression = Expression::new(Settings::default(), Units::shipped());
    let mut random = fastrand::Rng::with_seed(5);
    for n in 0..1800 {
        let mm = if n % 300 >= 240 {
            9.0
        } else {
            0.3 * random.f32()
        };
        expression.observe(&grin(mm), &facing(), frame(n));
    }
    expression
}

/// The toy face with chin and lower lip 8 mm lower.
fn open_mouth() -> Landmarks {
    let mut face = grin(0.0);
    for i in [6, 7, 8, 9, 10, 55, 56, 57, 58, 59, 65, 66, 67] {
        face.head[i].y += 8e-3;
    }
    face
}

fn restored(learned: &Learned) -> Expression {
    let mut expression = Expression::new(Settings::default(), Units::shipped());
    expression.restore(learned);
    expression
}

#[test]
fn a_restart_keeps_the_ranges_that_weights_are_computed_with() {
    let before = grinning();
    let mut text = alloc::string::String::new();
    before.learned().write(&mut text).unwrap();
    let learned = Learned::read(&text).unwrap();
    let furthest = |learned: &Learned| {
        let (before, after) = (before.unit_ranges(), restored(learned).unit_ranges());
        let apart =
            |(a, b): (&UnitRange, &UnitRange)| (a.high - b.high).abs().max((a.rest - b.rest).abs());
        before.iter().zip(&after).map(apart).fold(0.0, f32::max)
    };
    assert!(furthest(&learned) < 1e-5, "{}", furthest(&learned));
    // Version 1 had no more than what follows from the measures.
    let (features, readings) = Default::default();
    let old = Learned {
        features,
        readings,
        ..learned
    };
    assert!(furthest(&old) > 0.05, "{}", furthest(&old));
}

#[test]
fn a_weight_is_a_share_of_the_range_that_is_reported() {
    let mut learned = grinning().learned();
    let shown = |learned: &Learned| {
        let mut expression = restored(learned);
        for n in 0..150 {
            let face = if n < 130 { grin(0.0) } else { open_mouth() };
            expression.observe(&face, &facing(), frame(n));
        }
        let ranges = expression.unit_ranges();
        (expression.weights().units().to_vec(), ranges)
    };
    let (narrow, ranges) = shown(&learned);
    for (_, range) in &mut learned.readings {
        range.high *= 1.5;
    }
    let (wide, wider) = shown(&learned);
    let mut compared = 0;
    for (k, (narrow, wide)) in narrow.iter().zip(&wide).enumerate() {
        let (range, wider) = [ranges[k], wider[k]]
            .map(|range| range.high - range.rest)
            .into();
        if *wide > 0.3 && wider > 1.2 * range {
            compared += 1;
            let shares = narrow / wide * range / wider;
            assert!(
                (shares - 1.0).abs() < 0.1,
                "{k}: {narrow} of {range}, {wide} of {wider}"
            );
        }
    }
    assert!(compared > 0, "{narrow:?} {wide:?}");
}

#[test]
fn a_side_that_always_moves_little_has_the_range_of_the_other() {
    let mut learned = grinning().learned();
    for (unit, range) in &mut learned.readings {
        match unit.as_str() {
            "AU12L" => range.high = range.rest + 0.4,
            "AU12R" => range.high = range.rest + 1.1,
            _ => {}
        }
    }
    let expression = restored(&learned);
    let ranges = expression.unit_ranges();
    for unit in ["AU12L", "AU12R"] {
        let range = ranges[column(&expression, unit)];
        assert!(
            (range.high - range.rest - 1.1).abs() < 1e-6,
            "{unit}: {range:?}"
        );
    }
}

#[test]
fn the_present_face_can_be_declared_neutral() {
    let mut expression = Expression::new(Settings::default(), Units::shipped().by_measure());
    for n in 0..100 {
        expression.observe(&grin(0.0), &facing(), frame(n));
    }
    let grins = column(&expression, "AU20");
    for n in 100..130 {
        expression.observe(&grin(6.0), &facing(), frame(n));
    }
    assert!(expression.weights().units()[grins] > 0.2);
    expression.take_neutral();
    assert!(
        expression
            .observe(&grin(6.0), &facing(), frame(130))
            .units()[grins]
            < 0.05
    );
}

#[test]
fn every_column_answers_to_its_own_movement() {
    // One measure after another is moved by its whole prior range, up and down; only its columns must answer.
    let mut expression = Expression::new(Settings::default(), Units::shipped().by_measure());
    let mut n = 0;
    let mut play = |expression: &mut Expression, face: &Landmarks, frames: u64| {
        for _ in 0..frames {
            expression.observe(face, &facing(), frame(n));
            n += 1;
        }
    };
    play(&mut expression, &grin(0.0), 150);
    for (points, axis, sign, name) in [
        (&[65, 66, 67][..], 1, 1.0, "AU25"),
        (&[56, 57, 58], 0, 1.0, "AU30L"),
        (&[56, 57, 58], 0, -1.0, "AU30R"),
        (&[56, 57, 58], 2, -1.0, "AU29"),
        (&[22, 23, 24, 25, 26], 1, -1.0, "AU2L"),
        (&[22, 23, 24, 25, 26], 1, 1.0, "AU4L"),
        (&[17, 18, 19, 20, 21], 1, -1.0, "AU2R"),
        (&[17, 18, 19, 20, 21], 1, 1.0, "AU4R"),
        (&[43, 44], 1, -1.0, "AU5L"),
        (&[43, 44], 1, 1.0, "AU43L"),
        (&[37, 38], 1, 1.0, "AU43R"),
        (&[34, 35], 1, -1.0, "AU9L"),
        (&[31, 32], 1, -1.0, "AU9R"),
        (&[7, 8, 9], 1, 1.0, "AU26"),
    ] {
        let mut face = grin(0.0);
        for &i in points {
            face.head[i][axis] += sign * 4e-3;
        }
        play(&mut expression, &face, 12);
        let weights = expression.weights().units();
        let own = column(&expression, name);
        assert!(weights[own] > 0.1, "{name}: {weights:?}");
        for (other, &w) in weights.iter().enumerate().filter(|&(i, _)| i != own) {
            // The lips' middle moves with the lower lip, and an open jaw's expected pull on the lips does not come.
            // A rising brow raises its inner end too.
            let related = ["AU2", "AU12", "AU1L", "AU1R"];
            let other_name = &expression.unit_names()[other];
            let related = related.iter().any(|name| other_name.starts_with(name));
            assert!(
                w < 0.3 * weights[own].max(0.5) || related,
                "{name} and {}: {weights:?}",
                expression.unit_names()[other]
            );
        }
        play(&mut expression, &grin(0.0), 60);
    }
}

/// A face of its own for each frame, everything moved by up to 4 mm.
fn restless(random: &mut fastrand::Rng) -> Landmarks {
    let mut head = toy_face();
    for point in &mut head {
        for axis in 0..3 {
            point[axis] += 8e-3 * (random.f32() - 0.5);
        }
    }
    Landmarks::certain(head)
}

#[test]
fn who_is_forgotten_is_met_as_if_never_seen() {
    let new = || Expression::new(Settings::default(), Units::shipped());
    let (mut met, mut new) = (new(), new());
    let mut random = fastrand::Rng::with_seed(4);
    for n in 0..300 {
        met.observe(&restless(&mut random), &facing(), frame(n));
    }
    assert_ne!(met.ranges(), new.ranges());
    met.reset();
    assert_eq!(met.ranges(), new.ranges());
    assert!(met.weights().warming);
    // The time since the last frame does not affect the person.
    new.last_at = met.last_at;
    for n in 300..600 {
        let face = restless(&mut random);
        let [was, is] =
            [&mut met, &mut new].map(|one| one.observe(&face, &facing(), frame(n)).clone());
        assert_eq!(was.units(), is.units(), "frame {n}");
        assert_eq!(was.readiness(), is.readiness(), "frame {n}");
        assert_eq!(was.warming, is.warming, "frame {n}");
    }
}

#[test]
fn after_a_gap_nothing_is_smoothed_into_what_was_before() {
    for units in [Units::shipped(), Units::shipped().by_measure()] {
        let mut smooth = Expression::new(Settings::default(), units.clone());
        let mut raw = Expression::new(
            Settings {
                smoothing_hz: 0.0,
                ..Settings::default()
            },
            units,
        );
        let faces = |n: u64| {
            let noise = if n & 1 == 0 { 1.0 } else { -1.0 };
            let mut head = grin(noise + if n % 60 < 30 { 0.0 } else { 6.0 });
            head.head[8].y += if n % 60 < 30 { 0.0 } else { 0.01 };
            head
        };
        let mut apart = |n: u64, at: u64| {
            let [smooth, raw] = [&mut smooth, &mut raw].map(|one| {
                let weights = one.observe(&faces(n), &facing(), frame(at));
                weights.units().to_vec()
            });
            let apart = smooth.iter().zip(&raw).map(|(a, b)| (a - b).abs());
            apart.fold(0.0, f32::max)
        };
        for n in 0..330 {
            apart(n, n);
        }
        // Noise from frame to frame is smoothed, a step over half a second without frames is not.
        let (noise, gap) = (apart(330, 330), apart(360, 346));
        assert!(noise > 0.01 && gap < 1e-6, "{noise} and {gap}");
    }
}

#[test]
fn what_measures_are_divided_by_is_as_told() {
    let larger = Landmarks::certain(toy_face().map(|p| Point::from(p.coords * 1.2)));
    for (scale, method, per_frame) in [
        (Scale::Frame, Method::Robust, true),
        (Scale::Learnt, Method::Robust, false),
        (Scale::ByMethod, Method::Robust, false),
        (Scale::ByMethod, Method::Paper, true),
        (Scale::Learnt, Method::Paper, false),
    ] {
        let settings = Settings {
            method,
            scale,
            ..Settings::default()
        };
        let mut expression = Expression::new(settings, Units::shipped());
        for n in 0..300 {
            expression.observe(&grin(0.0), &facing(), frame(n));
        }
        let jaw = Measure::JawDrop as usize;
        let before = expression
            .observe(&grin(0.0), &facing(), frame(300))
            .measures[jaw];
        let after = expression.observe(&larger, &facing(), frame(301)).measures[jaw];
        let expected = if per_frame { 1.0 } else { 1.2 };
        assert!((before - 3.0).abs() < 0.01, "{scale:?}: {before}");
        assert!(
            (after / before - expected).abs() < 0.01,
            "{scale:?} {method:?}: {before} {after}"
        );
    }
}
