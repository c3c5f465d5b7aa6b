//! The whole reconstruction: initial cameras, a short EM from each, and a full fit of the likeliest.
//!
//! Method: EM with a low-rank Gaussian shape prior (Torresani, Hertzmann, Bregler 2008; `em.rs`), started from several
//! cameras (rigid factorisation, and the trajectory-space factorisation of Akhter et al. 2008; `cameras.rs`). Each start
//! gets a short EM, the likelihood picks one, and the modes are then fitted afresh from its cameras with the noise annealed.
//! EM alone from rigid cameras fails where the body deforms much and the camera turns fast (yoga 0.23, pickup 0.30).
//! The rank, when not given, is the smallest that explains the deformation, bounded by the Bayesian information criterion.
//!
//! Units: the tracks'. Missing points are allowed anywhere. Depth has the global mirror ambiguity of every orthographic
//! method. Seeded: results repeat. Limitations: orthographic (scale per frame, no perspective inside a frame);
//! a camera that hardly turns leaves depth to the prior; shapes of different frames share one object frame only up to
//! what modes and cameras can exchange, hence errors are stated with each frame rigidly aligned.

use super::cameras;
use super::em::Model;
use super::tracks::{Shapes, Tracks, mean_positions};
use mien_stages::base::defaults;
use nalgebra::Matrix3;
use rayon::prelude::*;
use std::ops::Range;

defaults! {
    /// Options.
    pub struct Settings {
        /// Number of shape modes; `None` chooses it from the tracks.
        pub rank: Option<usize> = None,
        /// Most sweeps of the final EM; at least those of a trial are done.
        pub sweeps: usize = 150,
    }
}

/// The result. Object frame: arbitrary rotation and possibly mirrored in depth as a whole, centroid at 0.
pub struct Reconstruction {
    /// F shapes of P points, in the object frame, in the tracks' unit (camera scales average 1).
    pub shapes: Shapes,
    /// Number of shape modes.
    pub rank: usize,
    /// Standard deviation of the image residual, in the tracks' unit.
    pub noise: f64,
    /// Correlation of the modes' coefficients from frame to frame, 0 to 1.
    pub smoothness: f64,
}

/// Recovers shapes from tracks. A rank of 0 is the rigid reconstruction.
pub fn nrsfm(tracks: &Tracks, settings: &Settings) -> Reconstruction {
    let size = spread(tracks);
    let unit = tracks.scaled(1.0 / size);
    let rigid_cameras = cameras::rigid_cameras(&cameras::filled(&unit, 3));
    let mut rigid = Model::rigid(&unit, rigid_cameras.clone());
    for _ in 0..RIGID_SWEEPS {
        rigid.sweep(&unit, NOISE_FLOOR);
    }
    let most = tracks.points().min(tracks.frames()) - 1;
    let largest = settings.rank.unwrap_or(LARGEST_RANK).min(most);
    if largest == 0 {
        return reconstruction(&rigid, size);
    }
    let trial_rank = TRIAL_RANK.min(largest);
    let mut trials: Vec<Model> = starts(&unit, rigid_cameras)
        .into_par_iter()
        .map(|start| fitted(&unit, start, trial_rank, FIRST_SWEEPS))
        .collect();
    trials.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
    trials.truncate(SECOND_STARTS);
    let go_on = |trial: &mut Model| sweep_on(&unit, trial, FIRST_SWEEPS..TRIAL_SWEEPS);
    trials.par_iter_mut().for_each(go_on);
    let likelier = |a: &Model, b: &Model| b.log_likelihood > a.log_likelihood;
    let best = trials
        .iter()
        .fold(&rigid, |a, b| if likelier(a, b) { b } else { a });
    // A trial of a rank is the beginning of its full fit.
    let start = best.rotation.clone();
    let mut model = match settings.rank {
        Some(_) => fitted(&unit, start, largest, TRIAL_SWEEPS),
        None => chosen(&unit, &rigid, &start, largest),
    };
    sweep_on(&unit, &mut model, TRIAL_SWEEPS..settings.sweeps);
    reconstruction(&model, size)
}

/// Seed of the disturbed starts and of new modes.
const SEED: u64 = 1;
/// Largest rank that is tried.
const LARGEST_RANK: usize = 8;
/// Sweeps of the rigid model; it converges in a few.
const RIGID_SWEEPS: usize = 15;
/// Modes of the short runs that compare the starts.
const TRIAL_RANK: usize = 3;
/// Sweeps of the short runs that compare the starts.
const TRIAL_SWEEPS: usize = 40;
/// Sweeps after which only the best starts continue.
const FIRST_SWEEPS: usize = 16;
/// Number of starts that continue.
const SECOND_STARTS: usize = 3;
/// Least noise variance, relative to the tracks' spread squared: keeps exact data finite.
const NOISE_FLOOR: f64 = 1e-10;
/// Initial floor of the noise variance, and its factor per sweep.
const ANNEAL: (f64, f64) = (1e-2, 0.8);
/// Relative change of the log-likelihood that ends the sweeps.
const CONVERGED: f64 = 1e-5;
/// Share of the rigid model's residual at which modes suffice; more only model the remainder of a real deformation
/// as depth.
const LEFT_OVER: f64 = 0.12;
/// Rank and disturbance of the trajectory-space starts; which one leads to the right cameras differs from sequence to
/// sequence, and the likelihood after a short EM tells.
const TRAJECTORY_STARTS: [(usize, f64); 7] = [
    (2, 0.0),
    (3, 0.0),
    (4, 0.0),
    (5, 0.1),
    (6, 0.1),
    (7, 0.1),
    (8, 0.1),
];

/// Initial cameras: rigid factorisation, then trajectory-space factorisations of growing rank.
fn starts(unit: &Tracks, rigid: Vec<Matrix3<f64>>) -> Vec<Vec<Matrix3<f64>>> {
    let mut rng = fastrand::Rng::with_seed(SEED);
    let mut starts = vec![rigid];
    let wide = cameras::filled(unit, 9);
    for (k, disturbance) in TRAJECTORY_STARTS {
        if 3 * k < unit.points().min(2 * unit.frames()) {
            starts.push(cameras::trajectory_cameras(&wide, k, disturbance, &mut rng));
        }
    }
    starts
}

/// The first sweeps of the smallest rank that leaves little residual ([`LEFT_OVER`]), or after which one more mode is
/// not worth its parameters (Bayesian information criterion, Schwarz 1978).
fn chosen(unit: &Tracks, rigid: &Model, start: &[Matrix3<f64>], largest: usize) -> Model {
    let cost = 1.5 * unit.points() as f64 * (2.0 * unit.sightings() as f64).ln();
    let tried = |rank| fitted(unit, start.to_vec(), rank, TRIAL_SWEEPS);
    let mut model = tried(1);
    for rank in 2..=largest {
        if model.noise_variance < LEFT_OVER * LEFT_OVER * rigid.noise_variance {
            break;
        }
        let richer = tried(rank);
        if richer.log_likelihood - model.log_likelihood < cost {
            break;
        }
        model = richer;
    }
    model
}

/// Annealed EM from given cameras.
fn fitted(unit: &Tracks, cameras: Vec<Matrix3<f64>>, rank: usize, sweeps: usize) -> Model {
    let mut rng = fastrand::Rng::with_seed(SEED);
    // Cameras are fixed until there are modes: rigid sweeps would bend them towards a rigid explanation.
    let mut model = Model::rigid(unit, cameras);
    model.grow(unit, rank, &mut rng);
    sweep_on(unit, &mut model, 0..sweeps);
    model
}

/// Runs these sweeps until convergence.
fn sweep_on(unit: &Tracks, model: &mut Model, sweeps: Range<usize>) {
    let (first, factor) = ANNEAL;
    for sweep in sweeps {
        let floor = f64::max(first * factor.powi(sweep as i32 + 1), NOISE_FLOOR);
        let before = model.log_likelihood;
        model.sweep(unit, floor);
        let settled = (model.log_likelihood - before).abs() < CONVERGED * before.abs();
        if settled && (model.noise_variance > floor || floor <= NOISE_FLOOR) {
            break;
        }
    }
}

fn reconstruction(model: &Model, size: f64) -> Reconstruction {
    let points = model.basis.ncols();
    let mut positions = Vec::with_capacity(points * model.rotation.len());
    for t in 0..model.rotation.len() {
        positions.extend((0..points).map(|j| <[f64; 3]>::from(model.point(t, j) * size)));
    }
    Reconstruction {
        shapes: Shapes { points, positions },
        rank: model.rank,
        noise: model.noise_variance.sqrt() * size,
        smoothness: model.alpha,
    }
}

/// Root-mean-square coordinate of the tracks about each frame's mean.
fn spread(tracks: &Tracks) -> f64 {
    let means = mean_positions(tracks);
    let mut sum = 0.0;
    for t in 0..tracks.frames() {
        for (_, w) in tracks.seen_in(t) {
            sum += (w - means[t]).norm_squared();
        }
    }
    let mean = sum / (2 * tracks.sightings()) as f64;
    mean.sqrt().max(f64::MIN_POSITIVE)
}
