//! Training of the paper's 3D active appearance model (section 1.2): base shape and shape bases by non-rigid structure from
//! motion of 150 frames and PCA (equation 3), appearance by PCA of grey values (equation 2).
//!
//! Shape: two sequences of 150 frames. In one a single actor goes through every expression while turning, as in the
//! paper. Bases of one face do not fit others, so the other shows many people at rest, one view each; both are
//! recovered by structure from motion, and one PCA of all deviations from their means gives bases of expressions and
//! of people. Appearance: rendered people with open mouths, shut lids, beards, glasses and all lights, cut to head
//! windows at their true view and warped by the true points to the base shape, whose lips are parted so that the
//! mouth's inside has pixels. Brightness and contrast are normalised; every pixel is weighted by how well the modes
//! explain it. The trust in a residual is learnt from fits of people not trained on. Window pixels, metres. Seeded.
//! Cost: rendering, two runs of structure from motion, a subspace iteration. Limit: orthographic recovery of
//! perspective pictures.

use std::path::Path;

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::paper_aam_fits::{Known, Seen, belief, cut, figures, fits, reported_measures};
use super::render::{Renderer, TrainingSample};
use super::samples::TruePicture;
use crate::nrsfm::{self, ShapeBases, Tracks, shape_model_from_sequences};
use mien_sensors::Frame;
use mien_sensors::kinect::picture_clock::timestamp_from_ticks;
use mien_simulator::virtual_head::{HeadAsset, Scene, Simulator, Truth};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::base::geometry::{Point, Vector};
use mien_stages::camera::Camera;
use mien_stages::face_model::ShapeModel;
use mien_stages::face_model::scheme::STABLE;
use mien_stages::landmarks::paper_aam::warp::{Shape2, base_pixels, triangulate};
use mien_stages::landmarks::paper_aam::{PaperAam, normalised, sample};
use mien_stages::landmarks::view::View;
use mien_stages::landmarks::window::{ORIGIN, PIXELS_PER_METRE, WINDOW};
use mien_workbench::dataset::too_few;
use mien_workbench::fault::Fault;
use mien_workbench::people_split::Split;
use mien_workbench::progress::Progress;
use mien_workbench::strongest::strongest;

/// Frames of a sequence for the 3D shape, as in the paper.
pub const TRACK_FRAMES: usize = 150;
/// Seconds over which the actor's frames are spread: one pass through all expressions.
const ACT_S: f64 = 45.0;
/// Most modes of structure from motion in a sequence.
const RANK: usize = 14;
/// Sweeps of structure from motion.
const SWEEPS: usize = 120;
/// Gap between the lips of the base shape, metres.
const PARTED_M: f32 = 0.010;
/// Rounds of the subspace iteration for appearance.
const ROUNDS: usize = 12;
/// Ratio of residuals in another session to those between the frames of the training session.
const OTHER_SESSION: f32 = 2.2;
/// Least visible share of a face for training appearance.
const VISIBLE: f32 = 0.97;

/// Rendered pictures for appearance.
const PICTURES: u64 = 3000;
/// Rendered pictures of people not trained on, for belief and reported figures.
const STRANGERS: u64 = 300;
/// Kept modes of shape and of appearance.
const MODES: [usize; 2] = [26, 50];
/// Kept modes of shape and of appearance for the model of one person.
const MODES_OF_ONE: [usize; 2] = [14, 30];

/// Trains the model and returns its bytes for the model file. `shape` gives the frame and the unit of the bases.
///
/// # Errors
/// The data sets cannot be read.
pub fn paper_aam_block(
    data: &Path,
    shape: &ShapeModel,
    tracks: Option<&Tracks>,
    seed: u64,
    say: &mut dyn FnMut(&str),
) -> Result<Vec<u8>, Fault> {
    let people = |split| {
        let keep = move |person| Split::from_index(person) == split;
        Renderer::new(data, keep, usize::MAX, &[])
    };
    let renderer = people(Split::Train)?;
    let drawn = renderer.samples(0..PICTURES, seed);
    let (faces, heads) = (drawn.len(), renderer.heads.len());
    say(&format!("{faces} rendered faces of {heads} people"));
    let camera = mien_sensors::kinect::geometry::nominal();
    let acted = match (tracks, renderer.heads.first()) {
        (Some(tracks), _) => tracks.clone(),
        (None, Some(actor)) => acted_tracks(&actor.asset, seed)?,
        (None, None) => return Err(too_few(1, 0)),
    };
    let bases = shape_bases(shape, &[acted, people_tracks(&drawn, &camera)?], MODES[0])?;
    say(&format!(
        "{} shape bases, deviations {:.1} to {:.1} mm per point",
        bases.modes.len(),
        per_point_mm(bases.deviations.first()),
        per_point_mm(bases.deviations.last())
    ));
    let mut model = unlearnt(&bases);
    let pictures = drawn.par_iter();
    let pictures = pictures.filter_map(|one| TruePicture::drawn(one, &camera, shape));
    let pictures: Vec<TruePicture> = pictures.collect();
    drop(drawn);
    learn_appearance(&mut model, &pictures, MODES[1], seed);
    drop(pictures);
    say(&format!(
        "{} pixels, {} appearance modes, {:.3} of the variance left",
        model.pixels.len(),
        model.appearance_modes.len(),
        model.noise
    ));
    // Parsed back, so that figures are of the written model.
    let mut model = PaperAam::parse(&model.to_bytes()).expect("just written");
    let strangers = people(Split::Dev)?.samples(0..STRANGERS, seed + 1);
    let strangers = strangers.par_iter().filter_map(|sample| {
        Some(Known {
            picture: TruePicture::drawn(sample, &camera, shape)?,
            measures: reported_measures(&sample.head),
        })
    });
    let strangers: Vec<Known> = strangers.collect();
    let fits = fits(&model, &strangers, seed);
    model.confidence_curve = belief(&fits);
    let figures = figures(&model, &fits, &strangers);
    say(&format!("strangers, drawn: {figures}"));
    Ok(model.to_bytes())
}

/// Bases of the shapes recovered from the tracks, in the frame and unit of `shape`.
fn shape_bases(shape: &ShapeModel, tracks: &[Tracks], modes: usize) -> Result<ShapeBases, Fault> {
    let reference: Vec<[f64; 3]> = shape.mean.iter().map(|p| p.map(f64::from).into()).collect();
    let settings = nrsfm::Settings {
        rank: Some(RANK),
        sweeps: SWEEPS,
    };
    shape_model_from_sequences(tracks, &reference, &STABLE, modes, &settings)
}

/// A model with these bases and no appearance yet.
fn unlearnt(bases: &ShapeBases) -> PaperAam {
    let head: Vec<Point> = bases.mean.iter().map(|p| point(*p)).collect();
    let base = parted(&head);
    let triangles = triangulate(&base);
    let pixels = base_pixels(&base, &triangles);
    let count = pixels.len();
    let mode = |m: &Vec<[f64; 3]>| m.iter().map(|v| point(*v).coords).collect();
    PaperAam {
        head_modes: bases.modes.iter().map(mode).collect(),
        head_deviations: bases.deviations.iter().map(|d| *d as f32).collect(),
        head,
        base,
        triangles,
        trust: vec![1.0; count],
        appearance: vec![0.0; count],
        appearance_modes: Vec::new(),
        appearance_deviations: Vec::new(),
        noise: 1.0,
        confidence_curve: [1.0, 0.1],
        pixels,
    }
}

fn per_point_mm(deviation: Option<&f64>) -> f64 {
    deviation.map_or(0.0, |d| d / (LANDMARKS as f64).sqrt() * 1e3)
}

fn point(p: [f64; 3]) -> Point {
    Point::from(Vector::new(p[0] as f32, p[1] as f32, p[2] as f32))
}

/// The frontal base shape, with lower lip and chin lowered, window pixels.
fn parted(head: &[Point]) -> Shape2 {
    let view = View {
        log_scale: PIXELS_PER_METRE.ln(),
        rotation: mien_stages::base::geometry::Rotation::identity(),
        shift: ORIGIN,
        inverse_distance: 1.0,
    };
    std::array::from_fn(|i| {
        let share = match i {
            6..=10 | 56..=58 | 65..=67 => 1.0,
            5 | 11 | 55 | 59 => 0.7,
            4 | 12 => 0.4,
            48 | 54 | 60 | 64 => 0.3,
            _ => 0.0,
        };
        view.project(&(head[i] + Vector::y() * (PARTED_M * share)))
    })
}

/// One actor through all expressions, [`TRACK_FRAMES`] frames.
pub(crate) fn acted(actor: &HeadAsset, seed: u64) -> Vec<Truth> {
    let mut simulator = Simulator::new(actor.clone(), Scene::Acted, seed);
    let mut frame = Frame::default();
    let ticks = |k: usize| (k as f64 * ACT_S / TRACK_FRAMES as f64 * 60e6) as i64;
    (0..TRACK_FRAMES)
        .filter_map(|k| simulator.draw(timestamp_from_ticks(ticks(k)), &mut frame))
        .collect()
}

/// Their true points as tracks, colour pixels.
fn acted_tracks(actor: &HeadAsset, seed: u64) -> Result<Tracks, Fault> {
    let truths = acted(actor, seed);
    let points = truths.iter().flat_map(|truth| truth.landmarks_px);
    let positions = points.map(|p| p.map(f64::from)).collect();
    Tracks::new(truths.len(), LANDMARKS, positions)
}

/// Tracks of people at rest, one view each.
fn people_tracks(drawn: &[TrainingSample], camera: &Camera) -> Result<Tracks, Fault> {
    let few = &drawn[..drawn.len().min(TRACK_FRAMES)];
    let pixels = few.iter().flat_map(|sample| {
        let pixel = |p| camera.colour_pixel(&(sample.sensor_from_head * p));
        sample.neutral.map(|p| pixel(p).map(f64::from))
    });
    Tracks::new(few.len(), LANDMARKS, pixels.collect())
}

/// Grey values of the base shape's pixels, a column for each sufficiently visible face.
fn appearances(model: &PaperAam, pictures: &[TruePicture]) -> DMatrix<f32> {
    let count = model.trust.len();
    let progress = Progress::new("train: appearance", pictures.len());
    let read = |picture: &TruePicture| -> Option<Vec<f32>> {
        progress.step();
        let seen = picture.visible.iter().filter(|v| **v).count();
        if (seen as f32) < VISIBLE * LANDMARKS as f32 {
            return None;
        }
        let (window, points, _) = cut(picture, &picture.truth.view);
        let mut values = vec![0.0; count];
        let [mut plane, mut other, mut spare] = [(); 3].map(|()| vec![0.0; WINDOW * WINDOW]);
        normalised(&window, &mut plane, &mut other, &mut spare);
        sample(model, &plane, &points, &mut values)?;
        Some(values)
    };
    let read: Vec<Vec<f32>> = pictures.par_iter().filter_map(read).collect();
    DMatrix::from_fn(count, read.len(), |i, c| read[c][i])
}

/// Equation 2: mean, modes and deviations of appearance, trust and residual noise.
fn learn_appearance(model: &mut PaperAam, pictures: &[TruePicture], modes: usize, seed: u64) {
    let count = model.trust.len();
    let columns = appearances(model, pictures);
    let people = columns.ncols();
    let mean = columns.column_mean();
    // First without trust, to measure the residuals; then with it.
    let mut trust = vec![1.0_f32; count];
    for round in 0..2 {
        let weighted =
            |row: &DVector<f32>, trust: &[f32]| DVector::from_fn(count, |i, _| row[i] * trust[i]);
        let mean = weighted(&mean, &trust);
        let mut rest = columns.clone();
        for (i, t) in trust.iter().enumerate() {
            rest.row_mut(i).scale_mut(*t);
        }
        // Brightness and contrast are free parameters.
        let light = DVector::from_column_slice(&trust).normalize();
        let contrast = (&mean - &light * light.dot(&mean)).normalize();
        for direction in [&light, &contrast] {
            let along = rest.tr_mul(direction);
            rest.ger(-1.0, direction, &along, 1.0);
        }
        let total = rest.norm_squared() / (count * people.max(1)) as f32;
        let modes = leading(&rest, modes, seed);
        let along = modes.tr_mul(&rest);
        let explained = along.norm_squared() / (count * people.max(1)) as f32;
        if round == 0 {
            let left = &rest - &modes * &along;
            let inverse = deviations(&left, 0.05).map(|spread| 1.0 / spread);
            let inverse: Vec<f32> = inverse.collect();
            let size = (inverse.iter().map(|v| v * v).sum::<f32>() / count as f32).sqrt();
            trust = inverse.iter().map(|v| v / size).collect();
            continue;
        }
        model.noise = (total - explained).max(1e-3);
        model.appearance_deviations = deviations(&along, 1e-3).collect();
        let modes = modes.column_iter().map(|m| m.iter().copied().collect());
        model.appearance_modes = modes.collect();
        model.appearance = mean.as_slice().to_vec();
    }
    model.trust = trust;
}

/// Root mean square of each row, at least `least`.
fn deviations(rows: &DMatrix<f32>, least: f32) -> impl Iterator<Item = f32> {
    let count = rows.ncols().max(1) as f32;
    rows.row_iter()
        .map(move |row| (row.norm_squared() / count).sqrt().max(least))
}

/// Leading principal directions by subspace iteration, strongest first.
fn leading(columns: &DMatrix<f32>, most: usize, seed: u64) -> DMatrix<f32> {
    let mut random = fastrand::Rng::with_seed(seed);
    let wide = (most + 10).min(columns.ncols()).min(columns.nrows());
    let mut basis = DMatrix::from_fn(columns.nrows(), wide, |_, _| random.f32() - 0.5);
    let across = columns.transpose();
    for _ in 0..ROUNDS {
        let q = basis.qr().q();
        basis = columns * (&across * q);
    }
    let q = basis.qr().q();
    let small = &across * &q;
    let (_, turn) = strongest(small.tr_mul(&small).cast(), most);
    q * turn.cast::<f32>()
}

/// The model of one person from tracked frames: bases from `tracks`, appearance from every second picture, belief
/// from the others. Returns its bytes for the model file.
///
/// # Errors
/// If the tracks do not suffice.
pub(super) fn person_block(
    shape: &ShapeModel,
    tracks: Tracks,
    seen: &[&Seen],
    seed: u64,
    say: &mut dyn FnMut(&str),
) -> Result<Vec<u8>, Fault> {
    let bases = shape_bases(shape, &[tracks], MODES_OF_ONE[0])?;
    let mut model = unlearnt(&bases);
    let of = |odd: usize| seen.iter().skip(odd).step_by(2).map(|seen| &seen.known);
    let pictures: Vec<TruePicture> = of(0).map(|known| known.picture.clone()).collect();
    learn_appearance(&mut model, &pictures, MODES_OF_ONE[1], seed);
    let mut model = PaperAam::parse(&model.to_bytes()).expect("just written");
    let others: Vec<Known> = of(1).cloned().collect();
    let fits = fits(&model, &others, seed);
    // The other frames are of the same session; another one differs in light and viewpoint.
    model.confidence_curve = belief(&fits).map(|of| OTHER_SESSION * of);
    let figures = figures(&model, &fits, &others);
    say(&format!(
        "{} shape and {} appearance modes; frames in between, against the default's points: {figures}",
        model.head_modes.len(),
        model.appearance_modes.len()
    ));
    Ok(model.to_bytes())
}

#[cfg(test)]
mod tests {
    use super::super::paper_aam_fits::REPORTED_MEASURES;
    use super::*;
    use crate::data::{Set, only};
    use mien_baking::heads::textured_heads;
    use mien_stages::face_model::FaceModel;
    use mien_stages::face_model::scheme::OUTER_EYE_CORNERS;
    use mien_stages::landmarks::paper_aam::Solver;
    use mien_stages::landmarks::window::Placement;
    use mien_workbench::correlation::correlation;

    /// Fig. 2: 150 frames of an actor with a pixel of noise and a fifth of the points missing; the error is a share
    /// of the shapes' size, less scale.
    #[test]
    fn shapes_survive_noise_and_gaps() {
        let Some(data) = only([Set::FacesFrl189, Set::IctFacekit]) else {
            return;
        };
        let heads = textured_heads(data.path(), |person| person == 30, 1).unwrap();
        let truths = acted(&heads.first().expect("person 30").asset, 1);
        let mut random = fastrand::Rng::with_seed(2);
        let mut noise = || (0..12).map(|_| random.f64()).sum::<f64>() - 6.0;
        let seen = truths.iter().flat_map(|truth| truth.landmarks_px);
        let mut seen: Vec<[f64; 2]> = seen.map(|p| p.map(|v| f64::from(v) + noise())).collect();
        for p in &mut seen {
            if random.f64() < 0.2 {
                *p = [f64::NAN; 2];
            }
        }
        let tracks = Tracks::new(truths.len(), LANDMARKS, seen).unwrap();
        let settings = nrsfm::Settings {
            rank: Some(10),
            ..nrsfm::Settings::default()
        };
        let mut found = nrsfm::nrsfm(&tracks, &settings).shapes;
        let head = truths.iter().flat_map(|truth| truth.landmarks_head);
        let truth = nrsfm::Shapes {
            points: LANDMARKS,
            positions: head.map(|p| p.coords.cast::<f64>().into()).collect(),
        };
        let size = |shapes: &nrsfm::Shapes, t| {
            let (_, points) = nrsfm::align::centred(shapes.frame(t));
            points.iter().map(|p| p.norm_squared()).sum::<f64>().sqrt()
        };
        for t in 0..truths.len() {
            let scale = size(&truth, t) / size(&found, t);
            let frame = &mut found.positions[t * LANDMARKS..(t + 1) * LANDMARKS];
            frame.iter_mut().flatten().for_each(|v| *v *= scale);
        }
        let error = nrsfm::shape_error(&found, &truth).unwrap();
        println!("off by {:.2} % of their size", 100.0 * error);
        assert!(error < 0.07, "{error}");
    }

    /// The shipped block's bases on an unseen person: how well they represent every acted expression when fitted to
    /// the true points. The earlier block could not open its mouth.
    #[test]
    fn shape_bases_span_the_measures_of_a_stranger() {
        let Some(data) = only([Set::FacesFrl189, Set::IctFacekit]) else {
            return;
        };
        // Every fifth person is a test person; preparing a head takes longer than rendering it.
        let heads = textured_heads(data.path(), |person| person == 30, 1).unwrap();
        let asset = heads.first().expect("person 30").asset.clone();
        let mut simulator = Simulator::new(asset, Scene::Acted, 3);
        let camera = simulator.camera().clone();
        let model = PaperAam::parse(&FaceModel::shipped().paper_aam).unwrap();
        let solver = Solver::new(model);
        let mut frame = Frame::default();
        let mut pairs: [Vec<[f32; 2]>; REPORTED_MEASURES.len()] = Default::default();
        let mut off = 0.0;
        for k in 0..TRACK_FRAMES {
            let ticks = (k as f64 * ACT_S / TRACK_FRAMES as f64 * 60e6) as i64;
            let truth = simulator
                .draw(timestamp_from_ticks(ticks), &mut frame)
                .unwrap();
            let placement = Placement::from_pose(&camera, &truth.sensor_from_head).unwrap();
            let points = truth.landmarks_px.map(|p| placement.window_pixel(p));
            let mut fit = solver.cold(&placement.start);
            solver.fit_points(&points, &mut fit, &placement.start);
            let eyes = OUTER_EYE_CORNERS.map(|i| points[i]);
            let size = (eyes[0][0] - eyes[1][0]).hypot(eyes[0][1] - eyes[1][1]);
            let apart = points.iter().zip(&fit.shape);
            let sum: f32 = apart.map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).sum();
            off += 100.0 * sum / (LANDMARKS * TRACK_FRAMES) as f32 / size;
            let both = [
                reported_measures(&solver.head(&fit)),
                reported_measures(&truth.landmarks_head),
            ];
            for (m, pairs) in pairs.iter_mut().enumerate() {
                pairs.push(both.map(|b| b[m]));
            }
        }
        let follows = pairs
            .each_ref()
            .map(|pairs| correlation(pairs.iter().copied()));
        println!(
            "left {off:.2} % of the outer-eye distance; correlation of {REPORTED_MEASURES:?} {follows:.3?}"
        );
        assert!(off < 2.0, "{off}");
        // The jaw's drop is half a stranger's chin.
        let least = follows.iter().fold(1.0, |least: f64, r| least.min(*r));
        assert!(least > 0.65, "{follows:?}");
    }
}
