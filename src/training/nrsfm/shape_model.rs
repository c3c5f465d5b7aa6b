//! 3D base shape and shape bases from 2D tracks: NRSFM, then PCA of the recovered shapes (paper section 1.2).
//!
//! The recovered shapes are aligned to a reference shape frame by frame, by the similarity of the points that no
//! expression moves, with the better of both depth mirrors: this fixes unit and frame, which orthographic tracks
//! cannot. Then PCA. Cost: one eigenproblem with as many rows as frames.

use super::align::{centred, rotation_onto};
use super::reconstruction::{Settings, nrsfm};
use super::tracks::{Shapes, Tracks};
use mien_workbench::fault::Fault;
use mien_workbench::strongest::strongest;
use nalgebra::{DMatrix, Vector3};

/// A linear 3D shape model in the reference's frame and unit: `S = mean + Σ q_i mode_i`.
pub struct ShapeBases {
    /// Base shape, P points.
    pub mean: Vec<[f64; 3]>,
    /// Orthonormal modes (over all 3P coordinates), strongest first.
    pub modes: Vec<Vec<[f64; 3]>>,
    /// Standard deviation of each mode's coefficient, in the reference's unit.
    pub deviations: Vec<f64>,
}

/// Base shape and at most `modes` bases from several sequences of tracks of the reference's points: the base shape is
/// the mean of the last sequence, the bases span the deviations of every sequence from its own mean. Frames are
/// aligned to the reference, including scale, by the points `rigid`, which no expression moves.
///
/// # Errors
/// If the tracks have another number of points than the reference.
pub fn shape_model_from_sequences(
    sequences: &[Tracks],
    reference: &[[f64; 3]],
    rigid: &[usize],
    modes: usize,
    settings: &Settings,
) -> Result<ShapeBases, Fault> {
    let points = reference.len();
    if let Some(other) = sequences.iter().find(|tracks| tracks.points() != points) {
        return Err(Fault::new(format!(
            "expected tracks of the reference's {points} points, found {}; track the same landmarks",
            other.points()
        )));
    }
    let mut mean = vec![Vector3::zeros(); points];
    let mut departures: Vec<Vec<Vector3<f64>>> = Vec::new();
    for tracks in sequences {
        let shapes = nrsfm(tracks, settings).shapes;
        let frames = [1.0, -1.0]
            .map(|mirror| laid_on(&shapes, mirror, reference, rigid))
            .into_iter()
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map_or(Vec::new(), |(frames, _)| frames);
        let count = frames.len().max(1) as f64;
        mean = vec![Vector3::zeros(); points];
        for frame in &frames {
            for (m, p) in mean.iter_mut().zip(frame) {
                *m += p / count;
            }
        }
        departures.extend(frames.into_iter().map(|frame| {
            let apart = frame.iter().zip(&mean).map(|(p, m)| (p - m) / count.sqrt());
            apart.collect()
        }));
    }
    let columns = DMatrix::from_fn(3 * points, departures.len(), |i, t| {
        departures[t][i / 3][i % 3]
    });
    let (modes, deviations) = principal(&columns, modes);
    let mean = mean.into_iter().map(<[f64; 3]>::from).collect();
    Ok(ShapeBases {
        mean,
        modes,
        deviations,
    })
}

/// Frames of recovered shapes, optionally mirrored in depth, aligned to the reference by similarities of its rigid
/// points, and the squared residual of those.
fn laid_on(
    shapes: &Shapes,
    mirror: f64,
    reference: &[[f64; 3]],
    rigid: &[usize],
) -> (Vec<Vec<Vector3<f64>>>, f64) {
    let few: Vec<[f64; 3]> = rigid.iter().map(|&i| reference[i]).collect();
    let (there, onto) = centred(&few);
    let mut wrong = 0.0;
    let frames = (0..shapes.frames()).map(|t| {
        let flipped = shapes.frame(t).iter().map(|p| [p[0], p[1], mirror * p[2]]);
        let frame: Vec<[f64; 3]> = flipped.collect();
        let few: Vec<[f64; 3]> = rigid.iter().map(|&i| frame[i]).collect();
        let (here, from) = centred(&few);
        let turn = rotation_onto(&from, &onto);
        let (mut along, mut size) = (0.0, f64::MIN_POSITIVE);
        for (p, q) in from.iter().zip(&onto) {
            along += (turn * p).dot(q);
            size += p.norm_squared();
        }
        let scale = along / size;
        for (p, q) in from.iter().zip(&onto) {
            wrong += (turn * p * scale - q).norm_squared();
        }
        let laid = |p: &[f64; 3]| turn * (Vector3::from(*p) - here) * scale + there;
        frame.iter().map(laid).collect()
    });
    let frames = frames.collect();
    (frames, wrong)
}

/// Principal directions of the columns and the square roots of their eigenvalues, strongest first.
fn principal(columns: &DMatrix<f64>, modes: usize) -> (Vec<Vec<[f64; 3]>>, Vec<f64>) {
    let (values, vectors) = strongest(columns.tr_mul(columns), modes);
    let largest = values[0].max(f64::MIN_POSITIVE);
    let axes = values.iter().zip(vectors.column_iter());
    axes.filter(|(value, _)| **value > 1e-9 * largest)
        .map(|(value, axis)| {
            let mode = columns * axis / value.sqrt();
            let points = mode.as_slice().chunks_exact(3);
            (points.map(|p| [p[0], p[1], p[2]]).collect(), value.sqrt())
        })
        .unzip()
}
