//! Known answers: a small model whose appearance is given by formula, so that images can be drawn from it exactly; and what
//! the shipped shape bases can and cannot show.

use super::*;
use crate::base::geometry::{Rotation, Vector, rotation_from_yaw_pitch_roll};
use crate::face_model::FaceModel;
use crate::landmarks::paper_aam::warp::{barycentric, base_pixels, triangulate};
use crate::landmarks::window::{ORIGIN, PIXELS_PER_METRE};

fn frontal() -> View {
    View {
        log_scale: PIXELS_PER_METRE.ln(),
        rotation: Rotation::identity(),
        shift: ORIGIN,
        inverse_distance: 1.4,
    }
}

/// Mean distance of two shapes, window pixels.
fn apart(a: &Shape2, b: &Shape2) -> f32 {
    let d = a.iter().zip(b);
    d.map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]))
        .sum::<f32>()
        / LANDMARKS as f32
}

fn grey_at([x, y]: [f32; 2], second: f32) -> f32 {
    let first = (x / 3.0).sin() + (y / 2.7 + 1.0).sin() + 0.7 * ((x + y) / 3.7).sin();
    120.0 + 25.0 * (first + second * ((x - y) / 4.1).sin())
}

/// A window that shows the base's pattern in the shape: the inverse warp, in formula. Beyond the face it goes on unwarped.
fn drawn(model: &PaperAam, shape: &Shape2, second: f32) -> Vec<f32> {
    let place = |p: [f32; 2]| {
        model.triangles.iter().find_map(|t| {
            let weights = barycentric(t.map(|v| shape[usize::from(v)]), p)?;
            weights.iter().all(|w| *w >= -1e-4).then(|| {
                [0, 1].map(|axis| {
                    (0..3)
                        .map(|k| weights[k] * model.base[usize::from(t[k])][axis])
                        .sum()
                })
            })
        })
    };
    (0..WINDOW * WINDOW)
        .map(|at| {
            let p = [(at % WINDOW) as f32, (at / WINDOW) as f32];
            grey_at(place(p).unwrap_or(p), second)
        })
        .collect()
}

fn compared(window: &[f32]) -> Vec<f32> {
    let [mut plane, mut other, mut spare] = [(); 3].map(|()| vec![0.0; WINDOW * WINDOW]);
    grey::normalised(window, &mut plane, &mut other, &mut spare);
    plane
}

/// The shipped mean head with two modes, an open mouth and a wide one, and one appearance mode.
fn known() -> PaperAam {
    let head = FaceModel::shipped().shape.mean.to_vec();
    let mouth = |of: fn(usize) -> Vector| -> Vec<Vector> {
        let mode: Vec<Vector> = (0..LANDMARKS).map(of).collect();
        let size = mode.iter().map(Vector::norm_squared).sum::<f32>().sqrt();
        mode.iter().map(|v| v / size).collect()
    };
    let head_modes = vec![
        mouth(|i| match i {
            5..=11 | 55..=59 | 65..=67 => Vector::y(),
            _ => Vector::zeros(),
        }),
        mouth(|i| match i {
            48 | 60 => -Vector::x(),
            54 | 64 => Vector::x(),
            _ => Vector::zeros(),
        }),
    ];
    let base: Shape2 = core::array::from_fn(|i| frontal().project(&head[i]));
    let triangles = triangulate(&base);
    let pixels = base_pixels(&base, &triangles);
    let mut model = PaperAam {
        head,
        head_modes,
        head_deviations: vec![0.02, 0.008],
        base,
        triangles,
        trust: vec![1.0; pixels.len()],
        appearance: vec![0.0; pixels.len()],
        appearance_modes: Vec::new(),
        appearance_deviations: Vec::new(),
        noise: 1e-3,
        confidence_curve: [0.5, 0.05],
        pixels,
    };
    let read = |second: f32| {
        let mut values = vec![0.0; model.pixels.len()];
        let plane = compared(&drawn(&model, &model.base, second));
        sample(&model, &plane, &model.base, &mut values).expect("a pattern");
        values
    };
    let (mean, other) = (read(0.0), read(0.5));
    let mode: Vec<f32> = other.iter().zip(&mean).map(|(a, b)| a - b).collect();
    let size = mode.iter().map(|v| v * v).sum::<f32>().sqrt();
    model.appearance_modes = vec![mode.iter().map(|v| v / size).collect()];
    model.appearance_deviations = vec![size];
    model.appearance = mean;
    model
}

fn planted(solver: &Solver, view: &View, head: [f32; 2]) -> AamFit {
    let mut fit = solver.cold(view);
    fit.head[..2].copy_from_slice(&head);
    fit.shape = solver.projected(&fit);
    fit
}

#[test]
fn slopes_are_the_derivatives_of_what_is_compared() {
    let model = known();
    let mut solver = Solver::new(model.clone());
    let fit = planted(
        &solver,
        &frontal().moved(&[0.2, 0.5, -0.4, 0.2, 0.3, 0.1]),
        [0.5, 0.4],
    );
    solver.plane = compared(&drawn(&model, &fit.shape, 0.0));
    // A bilinear image has kinks between pixels, so a smoother one is read.
    grey::blur(&mut solver.plane, &mut solver.spare[0], 2);
    solver.compute_gradient();
    let factor = sample(
        &model,
        &solver.plane,
        &fit.shape,
        solver.values.as_mut_slice(),
    )
    .unwrap();
    solver.compute_derivatives(factor, &fit);
    for k in 0..solver.slopes.nrows() {
        const STEP: f32 = 0.02;
        let read = |by: f32| -> Vec<f32> {
            let mut fit = fit.clone();
            if k < VIEW_PARAMETERS {
                let mut step = [0.0; VIEW_PARAMETERS];
                step[k] = by;
                fit.view = fit.view.moved(&step);
            } else {
                fit.head[k - VIEW_PARAMETERS] += by;
            }
            let shape = solver.projected(&fit);
            let pixels = model.pixels.iter();
            pixels
                .map(|p| factor * value_at(&solver.plane, bilinear_weights(p.position(&shape))))
                .collect()
        };
        let (less, more) = (read(-STEP), read(STEP));
        let (mut wrong, mut size) = (0.0, 0.0);
        for ((slope, less), more) in solver.slopes.row(k).iter().zip(&less).zip(&more) {
            let numeric = (more - less) / (2.0 * STEP);
            wrong += (slope - numeric).powi(2);
            size += numeric.powi(2);
        }
        let share = (wrong / size).sqrt();
        assert!(share < 0.1, "parameter {k}: {share} of it is wrong");
    }
}

#[test]
fn a_planted_face_is_found_from_beside_it_and_nothing_where_there_is_none() {
    let model = known();
    let mut solver = Solver::new(model.clone());
    let mut random = fastrand::Rng::with_seed(8);
    for case in 0..6 {
        let mut about = |size: f32| size * (2.0 * random.f32() - 1.0);
        let truth = frontal().moved(&[0.3, 0.5, 0.6, 0.3, 0.4, 0.4].map(&mut about));
        let face = planted(&solver, &truth, [about(1.2), about(1.2)]);
        let window = drawn(&model, &face.shape, about(0.5));
        // 2 % of scale, 2 degrees, 3 pixels off.
        let depth = truth.moved(&[0.4, 0.3, -0.3, 0.3, 0.6, -0.6]);
        let first = solver.cold(&depth);
        let start = apart(&first.shape, &face.shape);
        let fit = solver.run(&window, first, depth, 30);
        let end = apart(&fit.shape, &face.shape);
        assert!(
            start > 2.0 && end < 0.15 * start,
            "case {case}: from {start} to {end} pixels"
        );
        for k in 0..2 {
            let off = fit.head[k] - face.head[k];
            assert!(off.abs() < 0.3, "case {case}: mode {k} off by {off}");
        }
        let nothing = solver.run(&vec![90.0; WINDOW * WINDOW], solver.cold(&depth), depth, 5);
        assert!(fit.confidence > 0.9 && nothing.confidence < 0.1);
    }
}

#[test]
fn points_that_the_model_can_show_are_shown() {
    let solver = Solver::new(known());
    let depth = frontal();
    let truth = planted(
        &solver,
        &depth.moved(&[0.2, 0.3, -0.3, 0.2, 0.3, 0.3]),
        [1.0, -0.7],
    );
    let mut fit = solver.cold(&depth);
    solver.fit_points(&truth.shape, &mut fit, &depth);
    let left = apart(&fit.shape, &truth.shape);
    assert!(left < 0.1, "{left} pixels");
}

#[test]
fn every_step_lowers_the_whole_cost() {
    let model = known();
    let mut solver = Solver::new(model.clone());
    let truth = frontal().moved(&[0.2, 0.3, 0.5, 0.2, 0.3, 0.3]);
    let face = planted(&solver, &truth, [1.0, -1.0]);
    let depth = truth.moved(&[0.2, 0.2, -0.2, 0.2, 0.3, -0.3]);
    solver.plane = compared(&drawn(&model, &face.shape, 0.4));
    solver.compute_gradient();
    let mut fit = solver.cold(&depth);
    let mut costs = Vec::new();
    for _ in 0..8 {
        let factor = solver.sample_residual(&mut fit).expect("a pattern");
        // Grey values in units of the present residual, as in the first steps.
        let left = f64::from(solver.residual.dot(&solver.values));
        let unit = f64::from(model.noise * PIXELS_PER_OBSERVATION);
        let off = fit.view.step_from(&depth);
        let pose: f32 = (0..VIEW_PARAMETERS)
            .map(|k| (off[k] / POSE_SPREAD[k]).powi(2))
            .sum();
        let people: f32 = fit.head.iter().map(|p| p * p).sum();
        costs.push(left / unit + f64::from(pose + people));
        solver.step(factor, &mut fit, &depth.into());
    }
    for pair in costs.windows(2) {
        assert!(pair[1] < pair[0] * 1.01 + 0.1, "{costs:?}");
    }
    assert!(costs[7] < 0.1 * costs[0], "{costs:?}");
}

#[test]
fn what_a_turned_head_hides_is_its_far_side_and_is_not_read() {
    let model = PaperAam::parse(&FaceModel::shipped().paper_aam).expect("the shipped block");
    let mut solver = Solver::new(model);
    assert_eq!(solver.mask_unseen(&frontal()), 0);
    let [left, right] = [-50_f32, 50.0].map(|yaw| {
        let rotation = rotation_from_yaw_pitch_roll(yaw.to_radians(), 0.0, 0.0);
        solver.values.fill(1.0);
        let hidden = solver.mask_unseen(&View {
            rotation,
            ..frontal()
        }) as f32;
        assert_eq!(solver.values.sum(), solver.values.len() as f32 - hidden);
        let share = hidden / solver.values.len() as f32;
        assert!((0.25..0.45).contains(&share), "{share}");
        let pixels = solver.model.pixels.iter().zip(solver.seen.iter());
        let hidden_pixels = pixels.filter(|(_, seen)| **seen == 0.0);
        let beside =
            hidden_pixels.map(|(pixel, _)| solver.model.head[usize::from(pixel.corners[0])].x);
        beside.sum::<f32>() / hidden
    });
    assert!(
        left * right < 0.0 && left.abs().min(right.abs()) > 0.02,
        "{left} {right}"
    );
}

#[test]
fn what_no_mode_knows_of_a_person_is_part_of_the_mean_but_shut_eyes_are_not() {
    for shut in [false, true] {
        let mut model = known();
        if shut {
            for (upper, lower) in [(37, 41), (38, 40), (43, 47), (44, 46)] {
                let gap = model.head[lower].y - model.head[upper].y;
                model.head_modes[0][upper].y = gap / model.head_deviations[0];
            }
        }
        let mut solver = Solver::new(model.clone());
        let mut fit = planted(&solver, &frontal(), [1.0, -1.0]);
        let mut window = drawn(&model, &fit.shape, 0.4);
        for (k, grey) in window.iter_mut().enumerate() {
            *grey += 15.0 * (k as f32 / 2.3).sin();
        }
        solver.plane = compared(&window);
        let mut left = || {
            solver.sample_residual(&mut fit).expect("a pattern");
            let mut sums = [0.0; 2];
            for (left, pixel) in solver.residual.iter().zip(&solver.model.pixels) {
                let eye = pixel.corners.iter().any(|i| (36..48).contains(i));
                sums[usize::from(eye)] += left * left;
            }
            solver.learn(1.0);
            sums
        };
        let [[face, eyes], [known_face, known_eyes]] = [left(), left()];
        assert!(known_face < 0.1 * face, "{known_face} of {face}");
        let learned = known_eyes < 0.1 * eyes;
        assert!(learned != shut, "{known_eyes} of {eyes}");
    }
}

/// Why separate 2D bases, tied one to one to the 3D ones, will not do: a shape s0 + Σ p_i s_i of what is seen from the
/// front, moved, turned in the image and scaled at will, against what a turned head shows of S0 + Σ p_i S_i.
#[test]
fn tied_2d_bases_cannot_show_a_turned_head() {
    let model = PaperAam::parse(&FaceModel::shipped().paper_aam).expect("the shipped block");
    let solver = Solver::new(model);
    let mut random = fastrand::Rng::with_seed(4);
    let mut worst = [0.0_f32; 2];
    for (yaw, pitch) in [
        (0.0, 0.0),
        (25.0, 0.0),
        (-25.0, 0.0),
        (0.0, 15.0),
        (0.0, -15.0),
    ] {
        let (mut sum, mut count) = (0.0, 0.0);
        for _ in 0..20 {
            let mut fit = solver.cold(&frontal());
            let modes = solver.model.head_modes.len();
            fit.head[..modes]
                .iter_mut()
                .for_each(|p| *p = 2.0 * random.f32() - 1.0);
            let front = solver.projected(&fit);
            fit.view.rotation =
                rotation_from_yaw_pitch_roll(f32::to_radians(yaw), f32::to_radians(pitch), 0.0);
            let turned = solver.projected(&fit);
            let eyes = (turned[36][0] - turned[45][0]).hypot(turned[36][1] - turned[45][1]);
            sum += 100.0 * left_by_similarity(&front, &turned) / eyes;
            count += 1.0;
        }
        let percent: f32 = sum / count;
        println!("yaw {yaw}°, pitch {pitch}°: {percent:.1} % of the outer-eye distance");
        let which = usize::from(yaw != 0.0 || pitch != 0.0);
        worst[which] = worst[which].max(percent);
    }
    // Alike from the front; turned as far as the paper's range, further off than a landmark may be (3.5 %).
    assert!(worst[0] < 0.01 && worst[1] > 3.5, "{worst:?}");
}

/// Mean distance left by the best similarity transform.
fn left_by_similarity(from: &Shape2, onto: &Shape2) -> f32 {
    let middle =
        |s: &Shape2| [0, 1].map(|a| s.iter().map(|p| p[a]).sum::<f32>() / LANDMARKS as f32);
    let (a, b) = (middle(from), middle(onto));
    let (mut along, mut across, mut size) = (0.0, 0.0, 0.0);
    for (p, q) in from.iter().zip(onto) {
        let (p, q) = ([p[0] - a[0], p[1] - a[1]], [q[0] - b[0], q[1] - b[1]]);
        along += p[0] * q[0] + p[1] * q[1];
        across += p[0] * q[1] - p[1] * q[0];
        size += p[0] * p[0] + p[1] * p[1];
    }
    let (c, s) = (along / size, across / size);
    let moved = from.map(|p| {
        let p = [p[0] - a[0], p[1] - a[1]];
        [b[0] + c * p[0] - s * p[1], b[1] + s * p[0] + c * p[1]]
    });
    apart(&moved, onto)
}
