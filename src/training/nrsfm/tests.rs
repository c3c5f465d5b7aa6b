//! Planted solutions: a body with two modes before a turning orthographic camera.

use super::em::Model;
use super::*;
use crate::golden::equals_golden;
use nalgebra::{Rotation3, Vector3};

const FRAMES: usize = 60;
const POINTS: usize = 24;

/// Tracks W = c R S + d and their shapes S; `noise` as a share of the body's size.
fn planted(noise: f64) -> (Tracks, Shapes) {
    let mut rng = fastrand::Rng::with_seed(3);
    let mut body = |size: f64| -> Vec<Vector3<f64>> {
        (0..POINTS)
            .map(|_| Vector3::from_fn(|_, _| size * (2.0 * rng.f64() - 1.0)))
            .collect()
    };
    let (mean, modes) = (body(1.0), [body(0.25), body(0.2)]);
    let (mut image, mut positions) = (Vec::new(), Vec::new());
    for t in 0..FRAMES {
        let s = t as f64;
        let z = [(0.9 * s).sin(), (0.37 * s + 1.0).cos()];
        let camera = Rotation3::from_euler_angles(
            0.4 * (0.11 * s).sin(),
            0.9 * (0.07 * s).sin(),
            0.2 * (0.05 * s).cos(),
        );
        let shape: Vec<Vector3<f64>> = (0..POINTS)
            .map(|j| mean[j] + modes[0][j] * z[0] + modes[1][j] * z[1])
            .collect();
        let centre = shape.iter().sum::<Vector3<f64>>() / POINTS as f64;
        for p in shape {
            let seen = camera * (p - centre);
            let mut off = || noise * ((0..12).map(|_| rng.f64()).sum::<f64>() - 6.0);
            image.push([seen.x + 3.0 + off(), seen.y - 1.0 + off()]);
            positions.push((p - centre).into());
        }
    }
    (
        Tracks::new(FRAMES, POINTS, image).unwrap(),
        Shapes {
            points: POINTS,
            positions,
        },
    )
}

fn two_modes() -> Settings {
    Settings {
        rank: Some(2),
        ..Settings::default()
    }
}

#[test]
fn planted_shapes_come_back() {
    let (tracks, truth) = planted(0.002);
    let found = nrsfm(&tracks, &two_modes());
    let error = shape_error(&found.shapes, &truth).unwrap();
    let rigid = shape_error(&rigid_mean_shape(&truth), &truth).unwrap();
    assert!(rigid > 0.1 && error < 0.1 * rigid, "{error} beside {rigid}");
    assert!((found.noise - 0.002).abs() < 0.001, "noise {}", found.noise);
}

#[test]
fn a_rigid_body_is_recovered_without_modes_and_gaps_are_filled() {
    // One shape in all frames, with its own camera.
    let rigid = rigid_mean_shape(&planted(0.0).1);
    let mut rng = fastrand::Rng::with_seed(9);
    let seen: Vec<[f64; 2]> = (0..FRAMES)
        .flat_map(|t| {
            let s = t as f64;
            let camera = Rotation3::from_euler_angles(0.5 * (0.11 * s).sin(), 0.02 * s, 0.0);
            let rigid = &rigid;
            (0..POINTS).map(move |j| {
                let p = camera * Vector3::from(rigid.positions[j]);
                [p.x, p.y]
            })
        })
        .map(|w| if rng.f64() < 0.2 { [f64::NAN; 2] } else { w })
        .collect();
    let gappy = Tracks::new(FRAMES, POINTS, seen).unwrap();
    let settings = Settings {
        rank: Some(0),
        ..Settings::default()
    };
    let found = nrsfm(&gappy, &settings);
    let error = shape_error(&found.shapes, &rigid).unwrap();
    assert!(error < 1e-3, "{error}");
    assert_eq!(found.rank, 0);
}

#[test]
fn the_same_seed_gives_the_same_shapes() {
    let (tracks, _) = planted(0.01);
    let again = || nrsfm(&tracks, &two_modes()).shapes.positions;
    assert_eq!(again(), again());
}

/// Later sweeps correct a wrong step, only more slowly: so each of the first is compared, in thousandths.
#[test]
fn every_sweep_equals_the_golden_one() {
    let tracks = planted(0.01).0;
    let cameras = cameras::rigid_cameras(&cameras::filled(&tracks, 3));
    let mut model = Model::rigid(&tracks, cameras);
    model.grow(&tracks, 2, &mut fastrand::Rng::with_seed(3));
    let mut lines = Vec::new();
    for _ in 0..6 {
        model.sweep(&tracks, 1e-4);
        let mut numbers = vec![
            model.log_likelihood / 1e3,
            model.alpha,
            model.noise_variance.sqrt(),
        ];
        for t in (0..FRAMES).step_by(13) {
            numbers.push(model.scale[t]);
            numbers.extend(model.shift[t].iter().chain(model.mean[t].iter()));
            numbers.extend(model.rotation[t].iter().chain(model.covariance[t].iter()));
            numbers.extend(model.point(t, 5).iter());
        }
        let thousandths = numbers.iter().map(|x| (x.abs() * 1e3).round().to_string());
        lines.push(thousandths.collect::<Vec<_>>().join(" "));
    }
    equals_golden("nrsfm/sweeps", &lines);
}
