//! The whole training: what is learnt from what, in which order, and the figures at the end.
//!
//! Shape modes from the head set; portraits of the people that [`Split`] gives to training, each with its mirror image and
//! many disturbed starts; drawn faces with known truth; cold stages, warm stages, confidence; then the test people.
//! The model file is written only at the end.

use std::path::PathBuf;
use std::time::Instant;

use rayon::prelude::*;

use super::cascade::{Progress, StageSettings, advance, inner_error_percent, learn_stage};
use super::dataset::{DatasetError, read_folder};
use super::evaluate::{Errors, differences, mean_offsets};
use super::render::{Renderer, TrainingSample};
use super::samples::{COLD, Disturbance, Sample, TruePicture, sample, warm_start};
use super::{confidence, paper_aam, shape, standard_head};
use crate::capacity::LANDMARKS;
use crate::face_model::{CascadeStage, FaceModel, MAX_MODES, ShapeModel, StandardHead, file};
use crate::geometry::Point;
use crate::landmarks::cascade::{FaceFit, Solver};
use crate::landmarks::features::OrientationMaps;
use crate::landmarks::window::WINDOW;
use crate::sensor::camera::Camera;
use crate::studio::heads::HeadsError;
use crate::studio::ict::{IctError, IctHead};
use crate::studio::nrsfm::{self, Tracks};
use crate::studio::split::Split;

/// What to train from and where to write.
#[derive(Clone, Debug)]
pub struct TrainArgs {
    /// Folders of annotated portraits.
    pub images: Vec<PathBuf>,
    /// Folder of the data sets, for the head to draw (`ict_facekit`) and the photographs it wears (`faces_frl189`).
    pub data: PathBuf,
    /// Model file to write.
    pub out: PathBuf,
    /// Where to write the mean offsets per landmark.
    pub offsets: Option<PathBuf>,
    /// Shape modes.
    pub modes: usize,
    /// Disturbed starts per portrait and mirror image.
    pub starts: usize,
    /// Drawn faces.
    pub drawn: usize,
    /// Penalty of the regressions.
    pub penalty: f32,
    /// Pictures the paper's active appearance model is trained on; 0 leaves it out.
    pub paper_pictures: usize,
    /// Tracks for its 3D shape; without, they are made from the pictures.
    pub tracks: Option<Tracks>,
    /// Whether the people for choosing settings stay out, to measure on them.
    pub hold_out_dev: bool,
    /// Seed of everything random.
    pub seed: u64,
}

impl Default for TrainArgs {
    fn default() -> Self {
        Self {
            images: Vec::new(),
            data: PathBuf::new(),
            out: PathBuf::from("face.model"),
            offsets: None,
            modes: 40,
            starts: 4,
            drawn: 3600,
            penalty: 0.5,
            paper_pictures: 400,
            tracks: None,
            hold_out_dev: false,
            seed: 1,
        }
    }
}

/// Why training cannot be done.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The pictures.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The head set.
    #[error(transparent)]
    Head(#[from] IctError),
    /// The drawn heads.
    #[error(transparent)]
    Drawn(#[from] HeadsError),
    /// The 3D shape of the paper's model.
    #[error(transparent)]
    Nrsfm(#[from] nrsfm::Error),
    /// Too little to learn from.
    #[error(
        "expected at least {expected} annotated pictures to train on, found {found}; give more folders with --images"
    )]
    TooFew {
        /// Least number.
        expected: usize,
        /// Number there.
        found: usize,
    },
    /// A file cannot be written.
    #[error("cannot write {path}: {source}; give another place with --out")]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

/// Pictures by what they may be used for.
#[derive(Default)]
pub struct Pictures {
    /// To train on, mirror images included.
    pub train: Vec<TruePicture>,
    /// To choose settings on.
    pub dev: Vec<TruePicture>,
    /// To report on.
    pub test: Vec<TruePicture>,
}

/// Reads and splits the portraits.
fn portraits(args: &TrainArgs, shape: &ShapeModel) -> Result<Pictures, TrainError> {
    let mut entries = Vec::new();
    for folder in &args.images {
        entries.extend(read_folder(folder)?);
    }
    let persons: Vec<(&str, &str)> = entries
        .iter()
        .map(|e| (e.set.as_str(), e.person.as_str()))
        .collect();
    let splits = Split::of_persons(&persons);
    let loaded: Vec<(Split, Option<TruePicture>)> = entries
        .par_iter()
        .zip(splits)
        .map(|(entry, split)| Ok((split, TruePicture::portrait(entry, shape)?)))
        .collect::<Result<_, DatasetError>>()?;
    let mut pictures = Pictures::default();
    for (split, picture) in loaded {
        let Some(picture) = picture else { continue };
        match split {
            Split::Test => pictures.test.push(picture),
            Split::Dev if args.hold_out_dev => pictures.dev.push(picture),
            _ => {
                pictures.train.push(picture.mirrored(shape));
                pictures.train.push(picture);
            }
        }
    }
    let least = 20;
    if pictures.train.len() < least {
        return Err(TrainError::TooFew {
            expected: least,
            found: pictures.train.len(),
        });
    }
    Ok(pictures)
}

/// `starts` disturbed starts at each picture.
#[must_use]
pub fn disturbed(
    pictures: &[TruePicture],
    starts: usize,
    disturbance: &Disturbance,
    spoiled: bool,
    seed: u64,
) -> Vec<Sample> {
    (0..pictures.len() * starts)
        .into_par_iter()
        .map_init(
            || (vec![0.0; WINDOW * WINDOW], OrientationMaps::default()),
            |(window, maps), k| {
                let seed = seed.wrapping_mul(1_000_003).wrapping_add(k as u64);
                sample(
                    &pictures[k / starts],
                    disturbance,
                    spoiled,
                    seed,
                    window,
                    maps,
                )
            },
        )
        .collect()
}

/// Cold starts of samples: mean shape at the depth pose.
#[must_use]
pub fn cold_starts(samples: &[Sample]) -> Vec<Progress> {
    samples
        .iter()
        .enumerate()
        .map(|(k, s)| Progress {
            sample: k,
            fit: FaceFit {
                view: s.depth,
                shape: [0.0; MAX_MODES],
            },
            anchor: s.depth,
        })
        .collect()
}

/// Cold and warm stages in the order of the appliance.
pub fn fit_cold(
    samples: &[Sample],
    shape: &ShapeModel,
    cold: &[CascadeStage],
    warm: &[CascadeStage],
) -> Vec<Progress> {
    let mut progress = cold_starts(samples);
    advance(samples, &mut progress, shape, cold);
    for p in &mut progress {
        p.anchor = p.fit.view;
    }
    advance(samples, &mut progress, shape, warm);
    progress
}

fn measured(
    samples: &[Sample],
    ends: &[Progress],
    shape: &ShapeModel,
) -> (Errors, Vec<[[f32; 2]; LANDMARKS]>) {
    let mut solver = Solver::default();
    let mut errors = Errors::default();
    let mut all = Vec::new();
    for end in ends {
        solver.project(shape, &end.fit);
        let d = differences(&solver.window, &samples[end.sample].points);
        errors.add(&d);
        all.push(d);
    }
    (errors, all)
}

fn write(path: &PathBuf, bytes: &[u8]) -> Result<(), TrainError> {
    std::fs::write(path, bytes).map_err(|source| TrainError::Unwritable {
        path: path.clone(),
        source,
    })
}

/// Trains a model and writes it; `say` gets one line per step.
///
/// # Errors
/// If the data cannot be read, is too little, or the result cannot be written.
pub fn train(args: &TrainArgs, say: &mut dyn FnMut(&str)) -> Result<FaceModel, TrainError> {
    let began = Instant::now();
    let since = |began: &Instant| format!("{:5.0} s", began.elapsed().as_secs_f32());
    let mut ict = IctHead::read(&args.data.join("ict_facekit"))?;
    crate::studio::heads::expressions::complete(&mut ict);
    let sites = crate::studio::heads::plain_head(&ict).landmarks;
    let mut faces = shape::population(&ict, &sites, 6000, args.seed);
    let reference: shape::Face = std::array::from_fn(|i| sites[i].on(&ict.neutral));
    let modes = args.modes.min(MAX_MODES);
    let rough = shape::principal_components(&faces, &reference, modes);
    let habits: Vec<_> = portraits(args, &rough)?
        .train
        .iter()
        .map(|p| shape::left_over(&rough, &p.truth, &p.points))
        .collect();
    let mut random = fastrand::Rng::with_seed(args.seed ^ 0x4841_4249);
    for face in &mut faces {
        let habit = &habits[random.usize(..habits.len())];
        for (p, off) in face.iter_mut().zip(habit) {
            *p += *off;
        }
    }
    let shape = shape::principal_components(&faces, &reference, modes);
    say(&format!(
        "{} shape model: {} modes from {} faces",
        since(&began),
        shape.modes.len(),
        faces.len()
    ));

    let mut pictures = portraits(args, &shape)?;
    say(&format!(
        "{} portraits: {} to train on (with mirror images), {} to choose on, {} to test on",
        since(&began),
        pictures.train.len(),
        pictures.dev.len(),
        pictures.test.len()
    ));
    let mut floor = Errors::default();
    let mut solver = Solver::default();
    for picture in &pictures.test {
        solver.project(&shape, &picture.truth);
        floor.add(&differences(&solver.window, &picture.points));
    }
    say(&format!(
        "  what the shape model leaves of the test portraits: {}",
        floor.line()
    ));
    let camera = Camera::nominal();
    let draw = |keep: &dyn Fn(Split) -> bool, count: usize, seed: u64| {
        let renderer = Renderer::new(&args.data, |person| keep(Split::of(person)))?;
        Ok::<_, TrainError>(renderer.samples(0..count as u64, seed))
    };
    let as_pictures = |drawn: &[TrainingSample]| -> Vec<TruePicture> {
        drawn
            .par_iter()
            .filter_map(|sample| TruePicture::drawn(sample, &camera, &shape))
            .collect()
    };
    let used = |split| split == Split::Train || (split == Split::Dev && !args.hold_out_dev);
    let drawn = as_pictures(&draw(&used, args.drawn, args.seed)?);
    say(&format!("{} {} drawn faces", since(&began), drawn.len()));
    let mut samples = disturbed(&pictures.train, args.starts, &COLD, true, args.seed);
    samples.extend(disturbed(&drawn, 2, &COLD, false, args.seed + 3));
    pictures.train.extend(drawn);
    say(&format!("{} {} starts", since(&began), samples.len()));

    let mut progress = cold_starts(&samples);
    let mut cold = Vec::new();
    for (k, cell_px) in [6.5, 5.5, 4.7].into_iter().enumerate() {
        let settings = StageSettings {
            cell_px,
            penalty: args.penalty,
        };
        cold.push(learn_stage(&samples, &mut progress, &shape, settings));
        say(&format!(
            "{} cold stage {}: {:.2} % on the training starts",
            since(&began),
            k + 1,
            inner_error_percent(&samples, &progress, &shape)
        ));
    }
    for p in &mut progress {
        p.anchor = p.fit.view;
    }
    let mut warm = Vec::new();
    for (k, cell_px) in [5.0, 4.0].into_iter().enumerate() {
        let settings = StageSettings {
            cell_px,
            penalty: args.penalty,
        };
        warm.push(learn_stage(&samples, &mut progress, &shape, settings));
        say(&format!(
            "{} warm stage {}: {:.2} % on the training starts",
            since(&began),
            k + 1,
            inner_error_percent(&samples, &progress, &shape)
        ));
    }

    // Ends of fits that fail: far starts, and windows beside the face.
    let far = Disturbance {
        position: 0.35,
        angle: 0.5,
        scale: 0.3,
        shape: 0.0,
    };
    let beside = Disturbance {
        position: 1.6,
        angle: 0.5,
        scale: 0.5,
        shape: 0.0,
    };
    let good = samples.len();
    pictures.train.truncate(500);
    samples.extend(disturbed(&pictures.train, 3, &far, true, args.seed + 1));
    let first_beside = samples.len();
    samples.extend(disturbed(&pictures.train, 3, &beside, true, args.seed + 2));
    let mut ends = fit_cold(&samples[good..], &shape, &cold, &warm);
    for end in &mut ends {
        end.sample += good;
    }
    // As many good ends as there are far ones are enough.
    let every = (progress.len() / 2500).max(1);
    ends.extend(progress.iter().step_by(every));
    let faceless = |k: usize| {
        // A window beside the face whose face lies outside it.
        k >= first_beside && {
            let s = &samples[k].truth.view.shift;
            let off = (s[0] - 92.0).abs().max((s[1] - 66.0).abs());
            off > 60.0
        }
    };
    let cell_px = warm.last().map_or(5.0, |s: &CascadeStage| s.cell_px);
    let confidence = confidence::learn(&samples, &ends, &faceless, &shape, cell_px);
    say(&format!("{} confidence", since(&began)));

    let (points, normals) = standard_head::standard_head(&ict).into_iter().unzip();
    let mut model = FaceModel {
        provenance: "shape: ICT FaceKit (MIT); pictures: Face Research Lab London Set and Young Adult White Faces, \
                     DeBruine and Jones 2017 (CC BY 4.0); written by mien-studio train"
            .into(),
        shape,
        cold: cold.into(),
        warm: warm.into(),
        confidence: confidence.into(),
        standard_head: StandardHead { points, normals },
        ..FaceModel::default()
    };
    drop(samples);

    for (name, pictures) in [("dev", &pictures.dev), ("test", &pictures.test)] {
        if pictures.is_empty() {
            continue;
        }
        let samples = disturbed(pictures, 10, &COLD, false, args.seed + 7);
        let ends = fit_cold(&samples, &model.shape, &model.cold, &model.warm);
        let (errors, all) = measured(&samples, &ends, &model.shape);
        say(&format!(
            "{} {name} people, portraits, cold: {}",
            since(&began),
            errors.line()
        ));
        let offsets = mean_offsets(&all);
        let mut clean = Errors::default();
        for d in &all {
            clean.add(&super::evaluate::without(d, &offsets));
        }
        say(&format!("  with mean offsets taken out: {}", clean.line()));
        let mut solver = Solver::default();
        let beliefs: f32 = ends
            .iter()
            .map(|end| {
                solver
                    .belief(
                        &model.confidence,
                        &model.shape,
                        &samples[end.sample].maps,
                        &end.fit,
                    )
                    .face
            })
            .sum();
        say(&format!(
            "  mean confidence {:.3}",
            beliefs / ends.len() as f32
        ));
    }
    if args.drawn > 0 {
        let drawn = draw(&|split| split == Split::Test, 400, args.seed + 11)?;
        report_drawn(&model, &drawn, &camera, args.seed, say);
    }
    if let Some(path) = &args.offsets {
        // People of the same annotation who are not the test people.
        let samples = disturbed(
            &pictures.train[..pictures.train.len().min(150)],
            4,
            &COLD,
            false,
            args.seed + 13,
        );
        let ends = fit_cold(&samples, &model.shape, &model.cold, &model.warm);
        let offsets = mean_offsets(&measured(&samples, &ends, &model.shape).1);
        write(path, crate::studio::fit::emit_offsets(&offsets).as_bytes())?;
    }
    // Written before the paper's model as well, which takes longest: what is done is not lost.
    write(&args.out, &file::emit(&model))?;
    if let Some(every) = pictures.train.len().checked_div(args.paper_pictures) {
        let every = every.max(1);
        let few: Vec<TruePicture> = pictures.train.iter().step_by(every).cloned().collect();
        model.paper_aam =
            paper_aam::paper_aam_block(&few, &model.shape, args.tracks.as_ref(), args.seed)?;
        say(&format!(
            "{} the paper's active appearance model: {} bytes",
            since(&began),
            model.paper_aam.len()
        ));
    }
    let bytes = file::emit(&model);
    model.id = u32::from_le_bytes([
        bytes[bytes.len() - 4],
        bytes[bytes.len() - 3],
        bytes[bytes.len() - 2],
        bytes[bytes.len() - 1],
    ]);
    write(&args.out, &bytes)?;
    say(&format!(
        "{} wrote {}: {} bytes, id {:08x}",
        since(&began),
        args.out.display(),
        bytes.len(),
        model.id
    ));
    Ok(model)
}

/// Heights and widths that expressions change, in metres of the head frame: brow and lid per side, mouth width, lip gap.
fn measures(head: &[Point; LANDMARKS]) -> [(&'static str, f32); 6] {
    let mean =
        |points: &[usize]| points.iter().map(|&i| head[i].y).sum::<f32>() / points.len() as f32;
    [
        ("brow R", mean(&[36, 39]) - mean(&[17, 18, 19, 20, 21])),
        ("brow L", mean(&[42, 45]) - mean(&[22, 23, 24, 25, 26])),
        ("lid R", mean(&[40, 41]) - mean(&[37, 38])),
        ("lid L", mean(&[46, 47]) - mean(&[43, 44])),
        ("mouth width", (head[48] - head[54]).norm()),
        ("lip gap", mean(&[65, 66, 67]) - mean(&[61, 62, 63])),
    ]
}

fn correlation(pairs: &[(f32, f32)]) -> f32 {
    let n = pairs.len().max(1) as f32;
    let mean = pairs
        .iter()
        .fold((0.0, 0.0), |s, p| (s.0 + p.0 / n, s.1 + p.1 / n));
    let (mut ab, mut aa, mut bb) = (0.0, 1e-20, 1e-20);
    for p in pairs {
        let (a, b) = (p.0 - mean.0, p.1 - mean.1);
        ab += a * b;
        aa += a * a;
        bb += b * b;
    }
    ab / (aa * bb).sqrt()
}

/// Errors on drawn test people, cold and warm, and how well measures follow the truth.
fn report_drawn(
    model: &FaceModel,
    drawn: &[TrainingSample],
    camera: &Camera,
    seed: u64,
    say: &mut dyn FnMut(&str),
) {
    let kept: Vec<(&TrainingSample, TruePicture)> = drawn
        .iter()
        .filter_map(|d| Some((d, TruePicture::drawn(d, camera, &model.shape)?)))
        .collect();
    let pictures: Vec<TruePicture> = kept.iter().map(|(_, p)| p.clone()).collect();
    let samples = disturbed(&pictures, 2, &COLD, false, seed + 7);
    let ends = fit_cold(&samples, &model.shape, &model.cold, &model.warm);
    say(&format!(
        "test people, drawn, cold: {}",
        measured(&samples, &ends, &model.shape).0.line()
    ));
    let mut random = fastrand::Rng::with_seed(seed);
    let mut warm = cold_starts(&samples);
    for p in &mut warm {
        p.fit = warm_start(&samples[p.sample], model.shape.modes.len(), &mut random);
        p.anchor = p.fit.view;
    }
    advance(&samples, &mut warm, &model.shape, &model.warm);
    say(&format!(
        "test people, drawn, warm: {}",
        measured(&samples, &warm, &model.shape).0.line()
    ));
    let mean: shape::Face = std::array::from_fn(|i| model.shape.mean[i]);
    let mut pairs: [Vec<(f32, f32)>; 6] = Default::default();
    let mut names = [""; 6];
    let mut head = mean;
    for end in &ends {
        let truth = shape::aligned(&kept[end.sample / 2].0.head, &mean);
        model.shape.shape(&end.fit.shape, &mut head);
        for (k, (a, b)) in measures(&truth)
            .into_iter()
            .zip(measures(&head))
            .enumerate()
        {
            pairs[k].push((a.1, b.1));
            names[k] = a.0;
        }
    }
    let line: Vec<String> = names
        .iter()
        .zip(&pairs)
        .map(|(name, pairs)| format!("{name} {:.3}", correlation(pairs)))
        .collect();
    say(&format!(
        "  correlation with the truth, cold: {}",
        line.join(", ")
    ));
}
