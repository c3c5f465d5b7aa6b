//! Promise: shapes recovered from 2D tracks alone are nearer the truth than any rigid shape. Prints one table.
//! Needs data sets; left out without them.

#![cfg(feature = "studio")]

use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::Point;
use mien_stages::face_model::FaceModel;
use mien_training::nrsfm::{Settings, Shapes, Tracks, nrsfm, rigid_mean_shape, shape_error};
use nalgebra::{Rotation3, Vector3};
use std::path::Path;

use crate::common;
use crate::common::data::Set;

/// One row of the table; the share of the rigid mean shape's error that is left.
fn share(name: &str, tracks: &Tracks, truth: &Shapes) -> f64 {
    let start = std::time::Instant::now();
    let recovered = nrsfm(tracks, &Settings::default());
    let seconds = start.elapsed().as_secs_f64();
    let rigid = nrsfm(
        tracks,
        &Settings {
            rank: Some(0),
            ..Settings::default()
        },
    );
    let of = |shapes: &Shapes| shape_error(shapes, truth).expect("same size");
    let (ours, mean) = (of(&recovered.shapes), of(&rigid_mean_shape(truth)));
    println!(
        "{name:<28} {:>4}  {ours:.4}  {:.4}  {mean:.4}  {:.2}  {seconds:.1}",
        recovered.rank,
        of(&rigid.shapes),
        ours / mean
    );
    ours / mean
}

const HEADING: &str =
    "sequence                     rank  ours    rigid   mean    ours/mean  seconds";

#[test]
fn standard_sequences_beat_the_rigid_shape() {
    let Some(data) = common::data::folder(Set::NrsfmBench) else {
        return;
    };
    println!("{HEADING}");
    // Bounds are what the method reaches, with room for rounding; 1 is the rigid mean shape.
    for (name, bound) in [
        ("shark", 0.5),
        ("face1", 0.95),
        ("face37", 0.85),
        ("yoga", 0.75),
        ("pickup", 0.4),
    ] {
        let file = |what: &str| data.join(format!("{name}_{what}.csv"));
        let tracks = Tracks::read(&file("W")).unwrap();
        let truth = Shapes::read(&file("S")).unwrap();
        let share = share(name, &tracks, &truth);
        assert!(
            share < bound,
            "{name}: {share:.2} of the rigid mean shape's error, expected below {bound}"
        );
    }
}

#[test]
fn faces_before_a_turning_camera_beat_the_rigid_shape() {
    let Some(data) = common::data::folder(Set::FaceMocap41) else {
        return;
    };
    println!("{HEADING}");
    let mut shares = Vec::new();
    for (file, first) in [("jaw", 600), ("jaw", 1000), ("eyebrows", 300)] {
        let frames = captured(&data, file, first);
        let (tracks, truth) = seen_by_a_turning_camera(&frames, 0.2, 0.01);
        shares.push(share(
            &format!("{file} {first}, 20 % missing"),
            &tracks,
            &truth,
        ));
    }
    assert!(shares.iter().all(|s| *s < 0.95), "{shares:?}");
    assert!(
        shares.iter().sum::<f64>() / shares.len() as f64 <= 0.7,
        "{shares:?}"
    );
}

#[test]
fn the_landmarks_of_a_face_beat_the_rigid_shape() {
    let frames = acted_landmarks();
    let (tracks, truth) = seen_by_a_turning_camera(&frames, 0.2, 0.01);
    println!("{HEADING}");
    let share = share("68 landmarks, 20 % missing", &tracks, &truth);
    // .61 on the modes of the shipped face model.
    assert!(share < 0.65, "{share:.2}");
}

/// 150 frames of motion capture.
fn captured(set: &Path, file: &str, first: usize) -> Vec<Vec<[f64; 3]>> {
    let text = std::fs::read_to_string(set.join(format!("{file}.csv"))).unwrap();
    let lines = text.lines().skip(1 + first).take(150);
    lines
        .map(|line| {
            let fields = line.split(',').skip(1);
            let values: Vec<f64> = fields.map(|field| field.parse().unwrap()).collect();
            values.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect()
        })
        .collect()
}

/// 150 frames of the shipped face model's mean shape and first four modes, each at a pace of its own.
fn acted_landmarks() -> Vec<Vec<[f64; 3]>> {
    let shape = FaceModel::shipped().shape;
    let mut head = [Point::origin(); LANDMARKS];
    (0..150)
        .map(|t| {
            let seconds = t as f32 / 30.0;
            let b = [1.1, 1.7, 2.9, 4.1].map(|pace| 2.0 * (pace * seconds).sin());
            shape.shape(&b, &mut head);
            head.iter()
                .map(|p| [p.x, p.y, p.z].map(f64::from))
                .collect()
        })
        .collect()
}

/// Frames under yaw ±25°, pitch ±15°; noise as a share of the largest coordinate.
fn seen_by_a_turning_camera(
    frames: &[Vec<[f64; 3]>],
    missing: f64,
    noise: f64,
) -> (Tracks, Shapes) {
    let mut rng = fastrand::Rng::with_seed(7);
    let (a, b) = (6.0 * rng.f64(), 6.0 * rng.f64());
    let (mut image, mut positions) = (Vec::new(), Vec::new());
    for (t, points) in frames.iter().enumerate() {
        let centre = points
            .iter()
            .fold(Vector3::zeros(), |s, p| s + Vector3::from(*p))
            / points.len() as f64;
        let seconds = t as f64 / 30.0;
        let yaw = 25_f64.to_radians() * (1.9 * seconds + a).sin();
        let pitch = 15_f64.to_radians() * (1.3 * seconds + b).sin();
        let camera = Rotation3::from_axis_angle(&Vector3::y_axis(), yaw)
            * Rotation3::from_axis_angle(&Vector3::x_axis(), pitch);
        let largest = points
            .iter()
            .map(|p| (Vector3::from(*p) - centre).amax())
            .fold(0.0, f64::max);
        let mut normal = || noise * largest * ((0..12).map(|_| rng.f64()).sum::<f64>() - 6.0);
        let seen: Vec<[f64; 2]> = points
            .iter()
            .map(|p| {
                let q = camera * (Vector3::from(*p) - centre);
                [q.x + normal(), q.y + normal()]
            })
            .collect();
        image.extend(seen.into_iter().map(|w| {
            if rng.f64() < missing {
                [f64::NAN; 2]
            } else {
                w
            }
        }));
        positions.extend(points.iter().copied());
    }
    let points = frames[0].len();
    let tracks = Tracks::new(frames.len(), points, image).unwrap();
    (tracks, Shapes { points, positions })
}

#[test]
fn what_is_stopped_says_what_is_kept() {
    use crate::common::{signal, studio};
    use std::fmt::Write;
    use std::io::BufRead;
    use std::os::unix::process::ExitStatusExt;
    use std::process::Stdio;
    let folder = tempfile::tempdir().unwrap();
    // Far more than is recovered before the signal comes.
    let mut text = String::new();
    let mut random = fastrand::Rng::with_seed(1);
    for _ in 0..2 * 2000 {
        let row: Vec<String> = (0..300).map(|_| random.f64().to_string()).collect();
        writeln!(text, "{}", row.join(",")).unwrap();
    }
    let tracks = folder.path().join("tracks.csv");
    std::fs::write(&tracks, text).unwrap();
    let out = folder.path().join("shapes.csv");
    let mut child = studio("nrsfm --rank 20 --tracks")
        .arg(&tracks)
        .arg("--out")
        .arg(&out)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut first = String::new();
    let mut stdout = std::io::BufReader::new(child.stdout.take().unwrap());
    stdout.read_line(&mut first).unwrap();
    assert!(first.starts_with("tracks: 2000 frames"), "{first}");
    signal(&child, "-INT");
    let ended = child.wait_with_output().unwrap();
    let said = String::from_utf8(ended.stderr).unwrap();
    assert_eq!(ended.status.signal(), Some(2), "{said}");
    let expected = format!("mien-studio: stopped; {} was not written\n", out.display());
    assert_eq!(said, expected);
    assert!(!out.exists());
}
