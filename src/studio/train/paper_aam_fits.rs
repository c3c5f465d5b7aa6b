//! Fits of the paper's active appearance model on pictures with known points: how far they are believed, and what they reach.

use rayon::prelude::*;

use super::samples::{Disturbance, TruePicture};
use crate::base::capacity::LANDMARKS;
use crate::base::geometry::Point;
use crate::expression::measures::{self, Measure};
use crate::face_model::scheme::OUTER_EYE_CORNERS;
use crate::landmarks::paper_aam::warp::Shape2;
use crate::landmarks::paper_aam::{AamFit, PaperAam, Solver};
use crate::landmarks::view::View;
use crate::landmarks::window::{Placement, Region, WINDOW};
use crate::studio::correlation::correlation;
use crate::studio::progress::Progress;

/// A picture, and what its points in the head frame of the shape model measure.
#[derive(Clone)]
pub(super) struct Known {
    pub(super) picture: TruePicture,
    pub(super) measures: [f32; TOLD.len()],
}

/// A frame of a recording that teaches: its surroundings of the face, and its points in colour pixels.
pub(super) struct Seen {
    pub(super) known: Known,
    pub(super) points: [[f64; 2]; LANDMARKS],
}

/// Measures whose correlation is reported.
pub(super) const TOLD: [Measure; 6] = [
    Measure::LipGap,
    Measure::JawDrop,
    Measure::MouthWidth,
    Measure::BrowL,
    Measure::LidL,
    Measure::CornerL,
];

pub(super) fn told(head: &[Point; LANDMARKS]) -> [f32; TOLD.len()] {
    let raw = measures::raw(head);
    TOLD.map(|m| raw[m as usize] / raw[Measure::EyeDistance as usize])
}

/// Head window of a view of the picture, and the true points there.
pub(super) fn cut(picture: &TruePicture, view: &View) -> (Vec<f32>, Shape2, View) {
    let placement = Placement::of_view(view);
    let mut window = vec![0.0; WINDOW * WINDOW];
    placement.resample(&picture.grey.picture(), &Region::WHOLE, &mut window);
    let points = picture.points.map(|p| placement.window_pixel(p));
    (window, points, placement.start)
}

/// A fit with the mean distance of its points from the truth at its start and its end, in outer-eye distances.
pub(super) struct Ended {
    fit: AamFit,
    errors: [f32; 2],
}

/// Fits from disturbed views.
pub(super) fn fits(
    model: &PaperAam,
    pictures: &[Known],
    range: Disturbance,
    seed: u64,
) -> Vec<Ended> {
    let progress = Progress::new("train: fits", pictures.len());
    let one = |solver: &mut Solver, (k, known): (usize, &Known)| {
        progress.step();
        let picture = &known.picture;
        let mut rng = fastrand::Rng::with_seed(seed ^ (k as u64 + 1).wrapping_mul(0x9e37_79b9));
        let view = range.of(&picture.truth.view, &mut rng);
        let (window, points, start) = cut(picture, &view);
        let first = solver.cold(&start);
        let started = first.shape;
        let fit = solver.run(&window, first, start, 20);
        let eyes = OUTER_EYE_CORNERS.map(|i| points[i]);
        let size = (eyes[0][0] - eyes[1][0]).hypot(eyes[0][1] - eyes[1][1]);
        let off = |shape: &Shape2| {
            let apart = points.iter().zip(shape);
            let sum: f32 = apart.map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).sum();
            sum / LANDMARKS as f32 / size
        };
        let errors = [off(&started), off(&fit.shape)];
        Ended { fit, errors }
    };
    pictures
        .par_iter()
        .enumerate()
        .map_init(|| Solver::new(model.clone()), one)
        .collect()
}

/// Where half a fit is believed, and how fast belief falls.
pub(super) fn belief(fits: &[Ended]) -> [f32; 2] {
    let good = fits.iter().filter(|fit| fit.errors[1] < 0.08);
    let mut residuals: Vec<f32> = good.map(|fit| fit.fit.residual).collect();
    residuals.sort_by(f32::total_cmp);
    let at = |share: f32| {
        let last = residuals.len().saturating_sub(1);
        *residuals
            .get((last as f32 * share) as usize)
            .unwrap_or(&1.0)
    };
    // Half believed at the residual that one good fit in fifty exceeds.
    [at(0.98), ((at(0.98) - at(0.5)) / 4.0).max(0.01)]
}

/// What a model reaches on pictures: errors in outer-eye distances.
pub(super) struct Figures {
    start: f32,
    mean: f32,
    median: f32,
    failed: f32,
    correlations: [f32; TOLD.len()],
}

impl std::fmt::Display for Figures {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "from {:.2} % to {:.2} % (mean {:.2} %) of the outer-eye distance, {:.1} % failed; correlation",
            100.0 * self.start,
            100.0 * self.median,
            100.0 * self.mean,
            100.0 * self.failed
        )?;
        for (measure, r) in TOLD.iter().zip(self.correlations) {
            write!(f, ", {} {r:.2}", measure.name())?;
        }
        Ok(())
    }
}

impl Figures {
    pub(super) fn of(model: &PaperAam, fits: &[Ended], pictures: &[Known]) -> Self {
        let solver = Solver::new(model.clone());
        let n = fits.len().max(1) as f32;
        let [starts, errors] = [0, 1].map(|end| {
            let mut errors: Vec<f32> = fits.iter().map(|e| e.errors[end]).collect();
            errors.sort_by(f32::total_cmp);
            errors
        });
        let median = |sorted: &[f32]| sorted.get(sorted.len() / 2).copied().unwrap_or(f32::NAN);
        let found: Vec<_> = fits.iter().map(|e| told(&solver.head(&e.fit))).collect();
        let correlations = std::array::from_fn(|m| {
            let pairs = found.iter().zip(pictures);
            correlation(pairs.map(|(a, b)| [a[m], b.measures[m]])) as f32
        });
        Self {
            mean: errors.iter().sum::<f32>() / n,
            start: median(&starts),
            median: median(&errors),
            failed: errors.iter().filter(|e| **e > 0.1).count() as f32 / n,
            correlations,
        }
    }
}
