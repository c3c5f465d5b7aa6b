//! Figures of shapes: structure from motion, and baking.

use image::RgbImage;
use nalgebra::{Matrix3, Rotation3, Vector3};

use super::error::FiguresError;
use super::pictures::title;
use super::subjects::Studio;
use crate::base::capacity::LANDMARKS;
use crate::simulator::virtual_head::COLOUR_FOCAL_PX;
use crate::studio::bake::benchmark::Truth;
use crate::studio::bake::head::Head;
use crate::studio::bake::recipe::Target;
use crate::studio::bake::render::{Outside, View, sheet};
use crate::studio::bake::rig::{self, Method};
use crate::studio::inspect::{canvas, face_lines};
use crate::studio::nrsfm::align::{centred, rotation_onto};
use crate::studio::nrsfm::{self, Tracks};
use crate::studio::train::paper_aam::acted;

/// Side of a picture, pixels.
const SIDE: u32 = 220;

/// Noise of a coordinate (standard deviation), and the share of points that are missing, in Fig. 2.
const NOISE_PX: f64 = 1.0;
const MISSING: f64 = 0.2;

/// Points with noise, and some of them missing.
fn disturbed(points: impl Iterator<Item = [f32; 2]>) -> Vec<[f64; 2]> {
    let mut random = fastrand::Rng::with_seed(2);
    let mut gauss = || (0..12).map(|_| random.f64()).sum::<f64>() - 6.0;
    let noisy: Vec<[f64; 2]> = points
        .map(|p| p.map(|v| f64::from(v) + NOISE_PX * gauss()))
        .collect();
    noisy
        .into_iter()
        .map(|p| {
            if random.f64() < MISSING {
                [f64::NAN; 2]
            } else {
                p
            }
        })
        .collect()
}

/// Fig. 2: one pixel of noise and a fifth of the points missing; what structure from motion makes of 150 frames of it, from in
/// front and from the side.
pub(super) fn shapes(studio: &Studio<'_>, say: &mut dyn FnMut(&str)) -> Result<(), FiguresError> {
    /// Frames of the 150 that are shown: at rest, smiling, jaw down, brows up, lips funnelled.
    const SHOWN: [usize; 5] = [1, 8, 14, 20, 37];
    let truths = acted(&studio.heads[0].asset, 1);
    let noisy = disturbed(truths.iter().flat_map(|truth| truth.landmarks_px));
    let tracks = Tracks::new(truths.len(), LANDMARKS, noisy.clone())?;
    let settings = nrsfm::Settings {
        rank: Some(10),
        ..nrsfm::Settings::default()
    };
    let found = nrsfm::nrsfm(&tracks, &settings).shapes;
    let true_points = |t: usize| {
        truths[t]
            .landmarks_head
            .map(|p| p.coords.cast::<f64>().into())
    };
    let true_shape = |t: usize| -> Vec<Vector3<f64>> { centred(&true_points(t)) };
    let laid = |t: usize, mirror: f64| -> (Vec<Vector3<f64>>, f64) {
        let mut have = centred(found.frame(t));
        have.iter_mut().for_each(|p| p.z *= mirror);
        let want = true_shape(t);
        let size =
            |points: &[Vector3<f64>]| points.iter().map(Vector3::norm_squared).sum::<f64>().sqrt();
        let scale = size(&want) / size(&have);
        let turn = rotation_onto(&have, &want) * scale;
        let have: Vec<_> = have.iter().map(|p| turn * p).collect();
        let off: Vec<_> = have.iter().zip(&want).map(|(a, b)| a - b).collect();
        let error = size(&off) / size(&want);
        (have, error)
    };
    let error = |mirror: f64| (0..truths.len()).map(|t| laid(t, mirror).1).sum::<f64>();
    let mirror = if error(1.0) <= error(-1.0) { 1.0 } else { -1.0 };
    say(&format!(
        "shapes: {NOISE_PX} px of noise, {:.0} % missing: the 3D shapes are off by {:.2} % of their size",
        100.0 * MISSING,
        100.0 * error(mirror) / truths.len() as f64
    ));
    let front = Matrix3::identity();
    let side = Rotation3::from_axis_angle(&Vector3::y_axis(), 0.8).into_inner();
    let mut rows: Vec<Vec<RgbImage>> = vec![Vec::new(); 3];
    for t in SHOWN {
        let points = &noisy[t * LANDMARKS..(t + 1) * LANDMARKS];
        let seen: Vec<[f64; 2]> = points
            .iter()
            .copied()
            .filter(|p| p[0].is_finite())
            .collect();
        let mean = [0, 1].map(|k| seen.iter().map(|p| p[k]).sum::<f64>() / seen.len() as f64);
        let depth_m = f64::from(truths[t].sensor_from_head.translation.z);
        let pixels_a_metre = f64::from(COLOUR_FOCAL_PX) / depth_m;
        let flat: Vec<Vector3<f64>> = points
            .iter()
            .map(|p| Vector3::new(p[0] - mean[0], p[1] - mean[1], 0.0) / pixels_a_metre)
            .collect();
        let (have, _) = laid(t, mirror);
        let want = true_shape(t);
        rows[0].push(wire("2D tracks", &flat, None, &front));
        rows[1].push(wire("3D, in front", &have, Some(&want), &front));
        rows[2].push(wire("3D, turned", &have, Some(&want), &side));
    }
    say(&studio.save("shapes", &sheet(&rows.concat(), SHOWN.len() as u32))?);
    Ok(())
}

/// Points as a face, metres about their middle; the truth in grey behind them. What is not finite is left out.
fn wire(
    words: &str,
    points: &[Vector3<f64>],
    truth: Option<&[Vector3<f64>]>,
    turn: &Matrix3<f64>,
) -> RgbImage {
    const PIXELS_PER_METRE: f64 = 1050.0;
    let mut picture = RgbImage::from_pixel(SIDE, SIDE, image::Rgb([255; 3]));
    let place = |p: &Vector3<f64>| {
        let p = turn * p;
        [p.x, p.y].map(|v| (v * PIXELS_PER_METRE + f64::from(SIDE) / 2.0 + 6.0) as f32)
    };
    let mut lines = |points: &[Vector3<f64>], colour: [u8; 3], dots: bool| {
        for [a, b] in face_lines() {
            let ends = [place(&points[a]), place(&points[b])];
            if ends.as_flattened().iter().all(|v| v.is_finite()) {
                canvas::line(&mut picture, ends[0], ends[1], colour);
            }
        }
        for [x, y] in points
            .iter()
            .map(place)
            .filter(|p| dots && p[0].is_finite())
        {
            canvas::square(&mut picture, x, y, 1, colour);
        }
    };
    if let Some(truth) = truth {
        lines(truth, [185; 3], false);
    }
    lines(points, [0, 90, 170], true);
    title(&mut picture, words);
    picture
}

/// Fig. 17: what sculptors made, and what each method makes of the motion of 68 points.
pub(super) fn influence(
    studio: &Studio<'_>,
    say: &mut dyn FnMut(&str),
) -> Result<(), FiguresError> {
    const SHOWN: [&str; 4] = ["mouthSmile_L", "jawOpen", "eyeBlink_L", "mouthFunnel"];
    const METHODS: [(&str, Method); 3] = [
        ("plain Laplacian", Method::Laplacian),
        ("Procedure 1", Method::Paper),
        ("AOI", Method::Aoi),
    ];
    let truth = Truth::read(&studio.data.join("ict_facekit"))?;
    let shown: Vec<usize> = SHOWN
        .iter()
        .filter_map(|name| truth.shapes.iter().position(|(shape, _)| shape == name))
        .collect();
    let landmarks: Vec<u64> = truth.landmarks.iter().map(|&v| u64::from(v)).collect();
    let head = Head::new(truth.mesh.clone(), &landmarks)?;
    let targets: Vec<Target> = shown.iter().map(|&s| truth.target(s)).collect();
    let view = View::face(&head);
    let mut rows: Vec<Vec<RgbImage>> = Vec::new();
    let picture = |words: &str, d: &[_]| {
        let mut picture = Outside::plain(&head).draw(&head, d, &view, SIDE);
        title(&mut picture, words);
        picture
    };
    rows.push(
        shown
            .iter()
            .map(|&s| {
                picture(
                    &format!("sculpted {}", truth.shapes[s].0),
                    &truth.shapes[s].1,
                )
            })
            .collect(),
    );
    for (name, method) in METHODS {
        let shapes = rig::bake(&head, &targets, method, &|_| ())?;
        let row = shapes.iter().zip(&shown).map(|(shape, &s)| {
            let error = truth.error(s, &shape.displacement);
            say(&format!("{name}, {}: error {error:.3}", shape.name));
            picture(&format!("{name}: {error:.2}"), &shape.displacement)
        });
        rows.push(row.collect());
    }
    say(&studio.save("influence", &sheet(&rows.concat(), SHOWN.len() as u32))?);
    Ok(())
}
