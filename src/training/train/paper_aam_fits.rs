//! Fits of the paper's active appearance model on pictures with known points: belief in residuals, and accuracy.

use rayon::prelude::*;

use super::samples::{NEAR, TruePicture};
use crate::train::evaluate::{differences, mean_percent};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::Point;
use mien_stages::expression::measures::{self, Measure};
use mien_stages::landmarks::paper_aam::warp::Shape2;
use mien_stages::landmarks::paper_aam::{AamFit, PaperAam, Solver};
use mien_stages::landmarks::view::View;
use mien_stages::landmarks::window::{Placement, Region, WINDOW};
use mien_workbench::correlation::correlation;
use mien_workbench::dataset;
use mien_workbench::progress::Progress;

/// A picture, and the reported measures of its points in the shape model's head frame.
#[derive(Clone)]
pub(super) struct Known {
    pub(super) picture: TruePicture,
    pub(super) measures: [f32; REPORTED_MEASURES.len()],
}

/// A training frame of a recording: the image around the face, and its points in colour pixels.
pub(super) struct Seen {
    pub(super) known: Known,
    pub(super) points: [[f64; 2]; LANDMARKS],
}

/// Measures whose correlation is reported.
pub(super) const REPORTED_MEASURES: [Measure; 6] = [
    Measure::LipGap,
    Measure::JawDrop,
    Measure::MouthWidth,
    Measure::BrowL,
    Measure::LidL,
    Measure::CornerL,
];

pub(super) fn reported_measures(head: &[Point; LANDMARKS]) -> [f32; REPORTED_MEASURES.len()] {
    let raw = measures::raw(head);
    REPORTED_MEASURES.map(|m| raw[m as usize] / raw[Measure::EyeDistance as usize])
}

/// Head window at a view of the picture, and the true points there.
pub(super) fn cut(picture: &TruePicture, view: &View) -> (Vec<f32>, Shape2, View) {
    let placement = Placement::from_view(view);
    let mut window = vec![0.0; WINDOW * WINDOW];
    placement.resample(
        &dataset::picture(&picture.grey),
        &Region::WHOLE,
        &mut window,
    );
    let points = picture.points.map(|p| placement.window_pixel(p));
    (window, points, placement.start)
}

/// A fit with the mean error of its points before and after, in outer-eye distances.
pub(super) struct Ended {
    fit: AamFit,
    errors: [f32; 2],
}

/// Fits from disturbed views.
pub(super) fn fits(model: &PaperAam, pictures: &[Known], seed: u64) -> Vec<Ended> {
    let progress = Progress::new("train: fits", pictures.len());
    let one = |solver: &mut Solver, (k, known): (usize, &Known)| {
        progress.step();
        let picture = &known.picture;
        let mut rng = fastrand::Rng::with_seed(seed ^ (k as u64 + 1).wrapping_mul(0x9e37_79b9));
        let view = NEAR.disturbed(&picture.truth.view, &mut rng);
        let (window, points, start) = cut(picture, &view);
        let first = solver.cold(&start);
        let started = first.shape;
        let fit = solver.run(&window, first, start, 20);
        let off = |shape| mean_percent(&differences(shape, &points)) / 100.0;
        let errors = [&started, &fit.shape].map(off);
        Ended { fit, errors }
    };
    let all = pictures.par_iter().enumerate();
    all.map_init(|| Solver::new(model.clone()), one).collect()
}

/// Residual at which a fit is half believed, and the slope of belief.
pub(super) fn belief(fits: &[Ended]) -> [f32; 2] {
    let good = fits.iter().filter(|fit| fit.errors[1] < 0.08);
    let mut residuals: Vec<f32> = good.map(|fit| fit.fit.residual).collect();
    residuals.sort_by(f32::total_cmp);
    let at = |share: f32| {
        let last = residuals.len().saturating_sub(1);
        let found = residuals.get((last as f32 * share) as usize);
        found.copied().unwrap_or(1.0)
    };
    // Half belief at the residual that one good fit in fifty exceeds.
    [at(0.98), ((at(0.98) - at(0.5)) / 4.0).max(0.01)]
}

/// Accuracy on pictures: errors in outer-eye distances, correlations of measures.
pub(super) fn figures(model: &PaperAam, fits: &[Ended], pictures: &[Known]) -> String {
    let solver = Solver::new(model.clone());
    let n = fits.len().max(1) as f32;
    let [start, [median, mean, failed]] = [0, 1].map(|end| {
        let mut errors: Vec<f32> = fits.iter().map(|e| 100.0 * e.errors[end]).collect();
        errors.sort_by(f32::total_cmp);
        let median = errors.get(errors.len() / 2).copied().unwrap_or(f32::NAN);
        let failed = errors.iter().filter(|e| **e > 10.0).count() as f32;
        [median, errors.iter().sum::<f32>() / n, 100.0 * failed / n]
    });
    let found = fits.iter().map(|e| reported_measures(&solver.head(&e.fit)));
    let found: Vec<_> = found.collect();
    let correlations = REPORTED_MEASURES.iter().enumerate().map(|(m, measure)| {
        let pairs = found.iter().zip(pictures);
        let r = correlation(pairs.map(|(a, b)| [a[m], b.measures[m]]));
        format!(", {} {r:.2}", measure.name())
    });
    let correlations: String = correlations.collect();
    format!(
        "from {:.2} % to {median:.2} % (mean {mean:.2} %) of the outer-eye distance, {failed:.1} % failed; correlation{correlations}",
        start[0]
    )
}
