//! Known answers: a small model whose appearance is given by formula, so that pictures can be drawn from it exactly.

use super::*;
use crate::face_model::FaceModel;
use crate::geometry::{Rotation, Vector, rotation_from_yaw_pitch_roll};
use crate::landmarks::paper_aam::warp::{barycentric, base_pixels, triangulate};
use crate::landmarks::window::{ORIGIN, PIXELS_PER_METRE};

/// The functions of place, window pixels, that appearance is made of; the first is the constant.
const FUNCTIONS: [fn(f32, f32) -> f32; 4] = [
    |_, _| 1.0,
    |x, y| (x / 5.0).sin() + (y / 4.5 + 1.0).sin() + 0.7 * ((x + y) / 6.0).sin(),
    |x, y| ((x - y) / 7.0).sin(),
    |x, y| (x / 6.5).cos() * (y / 8.0).cos(),
];

/// A model, and appearance (mean, then modes) as coefficients of [`FUNCTIONS`].
struct Known {
    model: PaperAam,
    coefficients: [[f32; 4]; 3],
}

fn frontal() -> View {
    View {
        log_scale: PIXELS_PER_METRE.ln(),
        rotation: Rotation::identity(),
        shift: ORIGIN,
        inverse_distance: 1.4,
    }
}

fn less(a: &Shape2, b: &Shape2) -> Shape2 {
    core::array::from_fn(|i| [a[i][0] - b[i][0], a[i][1] - b[i][1]])
}

/// Mean distance of two shapes, window pixels.
fn apart(a: &Shape2, b: &Shape2) -> f32 {
    let d = less(a, b);
    d.iter().map(|d| d[0].hypot(d[1])).sum::<f32>() / LANDMARKS as f32
}

/// The shipped mean head with two modes, an open mouth and a wide one; 2D modes are what these and turns of the head show.
fn known() -> Known {
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
    let head_deviations = vec![0.02, 0.008];
    let view = frontal();
    let seen = |view: &View, offset: &dyn Fn(usize) -> Vector| -> Shape2 {
        core::array::from_fn(|i| view.project(&(head[i] + offset(i))))
    };
    let mean = seen(&view, &|_| Vector::zeros());
    let mut basis = similarity_modes(&mean).to_vec();
    let mut deviations = Vec::new();
    let turned = |yaw, pitch| View {
        rotation: rotation_from_yaw_pitch_roll(yaw, pitch, 0.0),
        ..view
    };
    for change in [
        seen(&turned(0.12, 0.0), &|_| Vector::zeros()),
        seen(&turned(0.0, 0.12), &|_| Vector::zeros()),
        seen(&view, &|i| head_modes[0][i] * head_deviations[0]),
        seen(&view, &|i| head_modes[1][i] * head_deviations[1]),
    ] {
        let mut mode = less(&change, &mean);
        for other in &basis {
            let along = dot(&mode, other);
            mode = less(&mode, &other.map(|p| p.map(|v| v * along)));
        }
        let size = dot(&mode, &mode).sqrt();
        deviations.push(size);
        basis.push(mode.map(|p| p.map(|v| v / size)));
    }
    let triangles = triangulate(&mean);
    let pixels = base_pixels(&mean, &triangles);
    // Gram-Schmidt over the pixels: the mean appearance of zero mean and unit variance, then unit modes.
    let values = |coefficients: &[f32; 4]| -> Vec<f32> {
        pixels
            .iter()
            .map(|pixel| {
                let p = pixel.place(&mean);
                appearance_at(coefficients, p)
            })
            .collect()
    };
    let mut orthonormal: Vec<[f32; 4]> = Vec::new();
    for k in 0..4 {
        let mut row = [0.0; 4];
        row[k] = 1.0;
        for other in orthonormal.clone() {
            let along: f32 = values(&row)
                .iter()
                .zip(values(&other))
                .map(|(a, b)| a * b)
                .sum();
            row = core::array::from_fn(|i| row[i] - along * other[i]);
        }
        let size = values(&row).iter().map(|v| v * v).sum::<f32>().sqrt();
        orthonormal.push(row.map(|v| v / size));
    }
    let root = (pixels.len() as f32).sqrt();
    let coefficients = [
        orthonormal[1].map(|v| v * root),
        orthonormal[2],
        orthonormal[3],
    ];
    let model = PaperAam {
        mean,
        modes: basis.split_off(SIMILARITY),
        deviations,
        appearance: values(&coefficients[0]),
        appearance_modes: coefficients[1..].iter().map(values).collect(),
        appearance_deviations: vec![0.2 * root; 2],
        noise: 1e-3,
        belief: [0.3, 0.05],
        head,
        head_modes,
        head_deviations,
        triangles,
        pixels,
    };
    Known {
        model,
        coefficients,
    }
}

fn appearance_at(coefficients: &[f32; 4], [x, y]: [f32; 2]) -> f32 {
    (0..4).map(|k| coefficients[k] * FUNCTIONS[k](x, y)).sum()
}

impl Known {
    /// A window that shows the shape with appearance weights λ: equation 2 through the inverse warp, in formula.
    fn drawn(&self, shape: &Shape2, weights: [f32; 2]) -> Vec<f32> {
        let sum: [f32; 4] = core::array::from_fn(|i| {
            self.coefficients[0][i]
                + weights[0] * self.coefficients[1][i]
                + weights[1] * self.coefficients[2][i]
        });
        let place = |p: [f32; 2]| {
            self.model.triangles.iter().find_map(|t| {
                let weights = barycentric(t.map(|v| shape[usize::from(v)]), p)?;
                weights.iter().all(|w| *w >= -1e-4).then(|| {
                    [0, 1].map(|axis| {
                        (0..3)
                            .map(|k| weights[k] * self.model.mean[usize::from(t[k])][axis])
                            .sum()
                    })
                })
            })
        };
        (0..WINDOW * WINDOW)
            .map(|at| {
                let p = [(at % WINDOW) as f32, (at / WINDOW) as f32];
                // Beyond the face the pattern goes on unwarped, so that its edge is none.
                128.0 + 35.0 * appearance_at(&sum, place(p).unwrap_or(p))
            })
            .collect()
    }

    /// 3D shape and view planted, as the 2D model can show them.
    fn planted(&self, solver: &Solver, view: &View, head: [f32; 2]) -> Shape2 {
        let mut fit = solver.cold(view);
        fit.head[..2].copy_from_slice(&head);
        let seen = solver.head(&fit).map(|p| view.project(&p));
        solver.of_coefficients(&solver.coefficients(&seen))
    }
}

#[test]
fn steepest_descent_images_are_the_templates_derivative() {
    let known = known();
    let mut solver = Solver::new(known.model.clone());
    solver.render(&[0.0, 0.0]);
    solver.descend();
    let shapes = solver.basis.len();
    for (j, mode) in solver.basis.iter().enumerate() {
        const EPS: f32 = 0.2;
        let moved = |by: f32| -> Shape2 {
            core::array::from_fn(|i| [0, 1].map(|a| known.model.mean[i][a] + by * mode[i][a]))
        };
        let (ahead, behind) = (moved(EPS), moved(-EPS));
        let (mut wrong, mut size) = (0.0, 0.0);
        for (i, pixel) in known.model.pixels.iter().enumerate() {
            if pixel.neighbours.iter().any(|n| usize::from(*n) == i) {
                continue; // one-sided differences at the face's edge
            }
            let at = |shape| appearance_at(&known.coefficients[0], pixel.place(shape));
            let numeric = (at(&ahead) - at(&behind)) / (2.0 * EPS);
            wrong += (solver.descent[(i, j)] - numeric).powi(2);
            size += numeric.powi(2);
        }
        let share = (wrong / size).sqrt();
        assert!(share < 0.03, "shape parameter {j}: {share} of it is wrong");
    }
    for (k, mode) in known.model.appearance_modes.iter().enumerate() {
        assert_eq!(solver.descent.column(shapes + k).as_slice(), &mode[..]);
    }
}

#[test]
fn a_planted_face_is_found_from_beside_it() {
    let known = known();
    let mut solver = Solver::new(known.model.clone());
    let root = (known.model.pixels.len() as f32).sqrt();
    let mut random = fastrand::Rng::with_seed(8);
    for case in 0..6 {
        let mut about = |size: f32| size * (2.0 * random.f32() - 1.0);
        let truth = frontal().moved(&[0.3, 0.5, 0.6, 0.3, 0.4, 0.4].map(&mut about));
        let weights = [about(0.2 * root), about(0.2 * root)];
        let shape = known.planted(&solver, &truth, [about(1.5), about(1.5)]);
        let window = known.drawn(&shape, weights);
        // 2 % of scale, 2 degrees, 3 pixels off.
        let depth = truth.moved(&[0.4, 0.3, -0.3, 0.3, 0.6, -0.6]);
        let first = solver.cold(&depth);
        let start = apart(&first.shape, &shape);
        let fit = solver.run(&window, first, &depth, 30);
        let end = apart(&fit.shape, &shape);
        assert!(
            start > 2.0 && end < 0.1 * start,
            "case {case}: from {start} to {end} pixels"
        );
        assert!(fit.residual < 0.1, "case {case}: residual {}", fit.residual);
        for (found, planted) in fit.appearance.iter().zip(weights) {
            // Grey is brought to unit variance, which takes a share of every weight.
            let size = (1.0 + (weights[0].powi(2) + weights[1].powi(2)) / (root * root)).sqrt();
            let off = (found - planted / size).abs() / root;
            assert!(off < 0.03, "case {case}: {found} for {planted}");
        }
        // Nothing to believe where there is no such face.
        let nothing = solver.run(&vec![90.0; WINDOW * WINDOW], solver.cold(&depth), &depth, 5);
        assert!(fit.confidence > 0.9 && nothing.confidence < 0.1);
    }
}

/// The part of the cost that a 3D shape and view have: reprojection, depth pose, population.
fn head_cost(solver: &Solver, fit: &AamFit, depth: &View) -> f64 {
    let seen = solver.head(fit).map(|p| fit.view.project(&p));
    let wrong = less(&fit.shape, &seen);
    let reprojection = f64::from(dot(&wrong, &wrong)) / f64::from(REPROJECTION_PX).powi(2);
    let off = fit.view.step_from(depth);
    let pose: f64 = (0..VIEW_PARAMETERS)
        .map(|k| (f64::from(off[k]) / POSE_SPREAD[k]).powi(2))
        .sum();
    let people: f64 = fit.head.iter().map(|q| f64::from(*q).powi(2)).sum();
    reprojection + pose + people
}

#[test]
fn view_and_3d_shape_end_where_their_cost_is_least() {
    let known = known();
    let solver = Solver::new(known.model.clone());
    let truth = frontal().moved(&[0.2, 0.4, -0.7, 0.2, 0.5, 0.3]);
    let depth = truth.moved(&[0.3, -0.3, 0.3, 0.2, -0.5, 0.5]);
    let mut planted = solver.cold(&truth);
    planted.head[..2].copy_from_slice(&[1.2, -0.8]);
    let mut fit = solver.cold(&depth);
    fit.shape = solver.head(&planted).map(|p| truth.project(&p));
    let first = head_cost(&solver, &fit, &depth);
    for _ in 0..10 {
        solver.fit_head(&mut fit, &depth);
    }
    let least = head_cost(&solver, &fit, &depth);
    assert!(least < 0.1 * first, "from {first} to {least}");
    let modes = known.model.head_modes.len();
    for k in 0..VIEW_PARAMETERS + modes {
        let moved = |by: f32| {
            let mut fit = fit.clone();
            if k < VIEW_PARAMETERS {
                let mut step = [0.0; VIEW_PARAMETERS];
                step[k] = by;
                fit.view = fit.view.moved(&step);
            } else {
                fit.head[k - VIEW_PARAMETERS] += by;
            }
            head_cost(&solver, &fit, &depth)
        };
        let (less, more) = (moved(-0.05), moved(0.05));
        assert!(
            less > least && more > least,
            "parameter {k}: {less} {least} {more}"
        );
        // The slope at the end, against the curvature: less than a tenth of the step tried.
        assert!((more - less).abs() < 0.1 * (more + less - 2.0 * least));
    }
    // The 2D points outweigh both priors: what was planted comes back, a little towards the depth pose.
    let seen = solver.head(&fit).map(|p| fit.view.project(&p));
    assert!(apart(&seen, &fit.shape) < 0.3);
    assert!((fit.head[0] - 1.2).abs() < 0.2 && (fit.head[1] + 0.8).abs() < 0.2);
}

/// The whole cost of the module header at a fit; grey in units of the noise, as in a step.
fn whole_cost(solver: &mut Solver, window: &[f32], fit: &AamFit, depth: &View) -> f64 {
    sample(&solver.model, window, &fit.shape, &mut solver.values);
    let residual = f64::from(solver.render(&fit.appearance));
    let unit = f64::from(solver.model.noise * PIXELS_PER_OBSERVATION);
    let image = residual.powi(2) * solver.values.len() as f64 / unit;
    let p = solver.coefficients(&fit.shape);
    let ratio = |v: f32, deviation: f32| f64::from(v / deviation).powi(2);
    let shape: f64 = p[SIMILARITY..]
        .iter()
        .zip(&solver.model.deviations)
        .map(|(v, d)| ratio(*v, *d))
        .sum();
    let appearance: f64 = fit
        .appearance
        .iter()
        .zip(&solver.model.appearance_deviations)
        .map(|(v, d)| ratio(*v, *d))
        .sum();
    image + shape + appearance + head_cost(solver, fit, depth)
}

#[test]
fn every_step_lowers_the_whole_cost() {
    let mut known = known();
    // So much noise that it, not the residual, sets the unit of grey in every step.
    known.model.noise = 0.5;
    let mut solver = Solver::new(known.model.clone());
    let truth = frontal().moved(&[0.2, 0.3, 0.5, 0.2, 0.3, 0.3]);
    let shape = known.planted(&solver, &truth, [1.0, -1.0]);
    let window = known.drawn(&shape, [6.0, -5.0]);
    let depth = truth.moved(&[0.3, 0.3, -0.3, 0.2, 0.5, -0.5]);
    let mut fit = solver.cold(&depth);
    let mut costs = vec![whole_cost(&mut solver, &window, &fit, &depth)];
    for _ in 0..8 {
        solver.fit_head(&mut fit, &depth);
        sample(&solver.model, &window, &fit.shape, &mut solver.values);
        fit.residual = solver.render(&fit.appearance);
        solver.step(&mut fit);
        costs.push(whole_cost(&mut solver, &window, &fit, &depth));
    }
    println!("{costs:.1?}");
    for pair in costs.windows(2) {
        assert!(pair[1] < pair[0] * 1.01 + 0.1, "{costs:?}");
    }
    assert!(costs[8] < 0.2 * costs[0], "{costs:?}");
}
