//! 3D base shape and shape bases from 2D tracks: NRSFM, then PCA of the recovered shapes (paper section 1.2).
//!
//! The recovered shapes are rigidly aligned to their mean frame by frame (generalised Procrustes), and the mean is brought
//! onto a reference shape by the similarity that fits best, with the depth mirror that fits better: this gives the unit
//! and the frame, which orthographic tracks cannot. Then PCA. Cost: one F x F eigenproblem.

use super::align::{centred, rotation_onto};
use super::{Error, Settings, Tracks, nrsfm};
use nalgebra::{DMatrix, Vector3};

/// A linear 3D shape model in the reference's frame and unit: `S = mean + Σ q_i mode_i`.
#[derive(Clone, Debug)]
pub struct ShapeBases {
    /// Base shape, P points.
    pub mean: Vec<[f64; 3]>,
    /// Orthonormal modes (over all 3P coordinates), strongest first.
    pub modes: Vec<Vec<[f64; 3]>>,
    /// Standard deviation of each mode's coefficient, in the reference's unit.
    pub deviations: Vec<f64>,
}

/// Base shape and at most `modes` bases from tracks of the reference's points.
///
/// # Errors
/// The tracks have another number of points than the reference.
pub fn shape_model_from_tracks(
    tracks: &Tracks,
    reference: &[[f64; 3]],
    modes: usize,
    settings: &Settings,
) -> Result<ShapeBases, Error> {
    let points = tracks.points();
    if reference.len() != points {
        return Err(Error::PointCount {
            expected: reference.len(),
            found: points,
        });
    }
    let shapes = nrsfm(tracks, settings).shapes;
    let origin = reference
        .iter()
        .fold(Vector3::zeros(), |s, p| s + Vector3::from(*p))
        / points as f64;
    let reference = centred(reference);
    let (mut best, mut least) = (Vec::new(), f64::INFINITY);
    for mirror in [1.0, -1.0] {
        let frames: Vec<Vec<Vector3<f64>>> = (0..shapes.frames())
            .map(|t| {
                let mut frame = centred(shapes.frame(t));
                frame.iter_mut().for_each(|p| p.z *= mirror);
                frame
            })
            .collect();
        let (aligned, wrong) = onto_reference(frames, &reference);
        if wrong < least {
            (best, least) = (aligned, wrong);
        }
    }
    let frames = best.len();
    let mut mean = vec![Vector3::zeros(); points];
    for frame in &best {
        for (m, p) in mean.iter_mut().zip(frame) {
            *m += p / frames as f64;
        }
    }
    let deviation = DMatrix::from_fn(3 * points, frames, |i, t| {
        best[t][i / 3][i % 3] - mean[i / 3][i % 3]
    });
    let eigen = deviation.tr_mul(&deviation).symmetric_eigen();
    let mut order: Vec<usize> = (0..frames).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let largest = eigen.eigenvalues.max().max(f64::MIN_POSITIVE);
    let (mut bases, mut deviations) = (Vec::new(), Vec::new());
    for i in order
        .into_iter()
        .take(modes)
        .filter(|i| eigen.eigenvalues[*i] > 1e-9 * largest)
    {
        let mode = &deviation * eigen.eigenvectors.column(i) / eigen.eigenvalues[i].sqrt();
        bases.push(
            (0..points)
                .map(|j| [mode[3 * j], mode[3 * j + 1], mode[3 * j + 2]])
                .collect(),
        );
        deviations.push((eigen.eigenvalues[i] / frames as f64).sqrt());
    }
    let mean = mean.iter().map(|p| <[f64; 3]>::from(p + origin)).collect();
    Ok(ShapeBases {
        mean,
        modes: bases,
        deviations,
    })
}

/// Frames turned onto the reference and multiplied by one common scale; and the squared distance that remains.
fn onto_reference(
    mut frames: Vec<Vec<Vector3<f64>>>,
    reference: &[Vector3<f64>],
) -> (Vec<Vec<Vector3<f64>>>, f64) {
    let (mut along, mut size) = (0.0, 0.0);
    for frame in &mut frames {
        let r = rotation_onto(frame, reference);
        for (p, q) in frame.iter_mut().zip(reference) {
            *p = r * *p;
            along += p.dot(q);
            size += p.norm_squared();
        }
    }
    let scale = if size > 0.0 { along / size } else { 1.0 };
    let mut wrong = 0.0;
    for frame in &mut frames {
        for (p, q) in frame.iter_mut().zip(reference) {
            *p *= scale;
            wrong += (*p - q).norm_squared();
        }
    }
    (frames, wrong)
}
