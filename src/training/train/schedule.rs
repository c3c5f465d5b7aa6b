//! The whole training in order, and the final figures.
//!
//! Shape modes from the head set; portraits of the people that [`Split`] assigns to training, each with its mirror
//! image and many disturbed starts; rendered faces with known truth; cold stages, warm stages, confidence; then the
//! test people. The model file is written at the end.

use std::path::{Path, PathBuf};
use std::time::Instant;

use rayon::prelude::*;

use super::args::TrainArgs;
use super::cascade::{Progress, advance, cold_starts, fit_cold, learn_stage};
use super::evaluate::{Differences, differences, mean_inner, mean_offsets, summary, without};
use super::paper_section;
use super::refine::{PEOPLE, learn_refinement};
use super::render::Renderer;
use super::samples::{COLD, Disturbance, NEAR, Sample, TruePicture, disturbed};
use super::{confidence, shape, standard_head};
use mien_baking::heads::ict::{Delta, IctHead};
use mien_baking::heads::reshape::read_shapes;
use mien_simulator::virtual_head::Site;
use mien_stages::face_model::{
    CascadeStage, ConfidenceModel, FaceModel, MAX_MODES, ShapeModel, file,
};
use mien_stages::landmarks::cascade::Solver;
use mien_workbench::atomic_write::{write_beside, write_out};
use mien_workbench::dataset::{read_folder, too_few};
use mien_workbench::fault::Fault;
use mien_workbench::people_split::Split;

impl TrainArgs {
    /// Whether people of this part are trained on.
    fn learns_from(&self, split: Split) -> bool {
        split == Split::Train || (split == Split::Dev && !self.hold_out_dev)
    }

    /// The part for figures, neither trained on nor reserved.
    fn strangers(&self) -> Split {
        match self.hold_out_dev {
            true => Split::Dev,
            false => Split::Test,
        }
    }

    /// Other head shapes.
    fn shapes(&self) -> Result<Vec<Delta>, Fault> {
        let folder = self.shapes.as_deref();
        folder.map_or_else(|| Ok(Vec::new()), read_shapes)
    }

    /// Renders faces of the people that `keep` accepts.
    fn drawn_faces(
        &self,
        count: usize,
        seed: u64,
        shape: &ShapeModel,
        keep: impl Fn(Split) -> bool,
    ) -> Result<Vec<TruePicture>, Fault> {
        let heads = 1 + count / FACES_A_HEAD;
        let renderer = Renderer::new(
            &self.data.data,
            |person| keep(Split::from_index(person)),
            heads,
            &self.shapes()?,
        )?;
        let camera = mien_sensors::kinect::geometry::nominal();
        let face = |sample| TruePicture::drawn(&sample, &camera, shape);
        let faces = renderer.each_sample(0..count as u64, seed, face);
        Ok(faces.into_iter().flatten().collect())
    }
}

/// Pictures by their use.
#[derive(Default)]
pub struct Pictures {
    /// For training, mirror images included.
    pub train: Vec<TruePicture>,
    /// For choosing settings.
    pub dev: Vec<TruePicture>,
    /// For reporting.
    pub test: Vec<TruePicture>,
}

/// Reads and splits the portraits.
fn portraits(args: &TrainArgs, shape: &ShapeModel) -> Result<Pictures, Fault> {
    let mut entries = Vec::new();
    for folder in &args.images {
        entries.extend(read_folder(folder)?);
    }
    let persons: Vec<_> = entries.iter().map(|e| (&*e.set, &*e.person)).collect();
    let splits = Split::from_persons(&persons);
    let loaded = entries.par_iter().map(|e| TruePicture::portrait(e, shape));
    let loaded: Vec<Option<TruePicture>> = loaded.collect::<Result<_, Fault>>()?;
    let mut pictures = Pictures::default();
    for (picture, split) in loaded.into_iter().zip(splits) {
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
    if pictures.train.len() < MIN_PICTURES {
        return Err(too_few(MIN_PICTURES, pictures.train.len()));
    }
    Ok(pictures)
}

/// Least number of training pictures, mirror images included.
const MIN_PICTURES: usize = 20;
/// Shape modes.
const MODES: usize = 44;
/// Spacing of neighbouring cells, window pixels, and shape modes moved by each stage. The view and the coarse shape
/// come first; lids and lips need the finer maps of the end.
const STAGES: [(f32, usize); 6] = [
    (6.5, 10),
    (5.5, 24),
    (5.0, MAX_MODES),
    (4.0, MAX_MODES),
    (3.2, MAX_MODES),
    (2.4, MAX_MODES),
];
/// Number of cold stages among them.
const COLD_STAGES: usize = 2;
/// Spacing of the cells of confidence patches, window pixels.
const CONFIDENCE_CELL_PX: f32 = 4.0;
/// Disturbances of starts in turn: mostly a tracker's, some a still picture's box.
const STARTS: [Disturbance; 3] = [NEAR, NEAR, COLD];
/// Disturbance of starts that mostly fail.
const FAR: Disturbance = Disturbance([0.35, 0.5, 0.3]);
/// Weight of a wrong start, far or beside, against a regular one: there is one of each for two of those, so that one
/// fit in twenty starts wrong.
const WRONG_WEIGHT: f64 = 0.053;
/// Rendered faces per head, which scales small trainings down.
const FACES_A_HEAD: usize = 8;
/// Rendered faces per person for the depth correction.
const FACES_A_PERSON: usize = 500;
/// Disturbance of starts beside the face.
const BESIDE: Disturbance = Disturbance([1.6, 0.5, 0.5]);

fn measured(samples: &[Sample], ends: &[Progress], shape: &ShapeModel) -> Vec<Differences> {
    let mut solver = Solver::default();
    let error = |end: &Progress| {
        solver.project(shape, &end.fit);
        differences(&solver.window, &samples[end.sample].points)
    };
    ends.iter().map(error).collect()
}

/// Receives a line for each finished step.
type Log<'a> = &'a mut dyn FnMut(&str);

/// Shape modes of a population like the portraits' people, not only the head set's.
fn learn_shape(
    args: &TrainArgs,
    ict: &IctHead,
    sites: &[Site],
    log: Log,
) -> Result<ShapeModel, Fault> {
    let mut faces = shape::population(ict, sites, &args.shapes()?, 6000, args.seed);
    let reference: shape::Face = std::array::from_fn(|i| sites[i].position(&ict.neutral));
    let rough = shape::principal_components(&faces, &reference, MODES);
    let habit = |p: &TruePicture| shape::left_over(&rough, &p.truth, &p.points);
    let habits: Vec<_> = portraits(args, &rough)?.train.iter().map(habit).collect();
    let mut random = fastrand::Rng::with_seed(args.seed ^ 0x4841_4249);
    for face in &mut faces {
        let habit = &habits[random.usize(..habits.len())];
        for (p, off) in face.iter_mut().zip(habit) {
            *p += *off;
        }
    }
    let shape = shape::principal_components(&faces, &reference, MODES);
    let (modes, count) = (shape.modes.len(), faces.len());
    log(&format!("shape model: {modes} modes from {count} faces"));
    Ok(shape)
}

/// The portraits; also prints the shape model's residual on the test part.
fn read_portraits(args: &TrainArgs, shape: &ShapeModel, log: Log) -> Result<Pictures, Fault> {
    let pictures = portraits(args, shape)?;
    log(&format!(
        "portraits: {} to train on (with mirror images), {} to choose on, {} to test on",
        pictures.train.len(),
        pictures.dev.len(),
        pictures.test.len()
    ));
    let mut solver = Solver::default();
    let floor = pictures.test.iter().map(|picture| {
        solver.project(shape, &picture.truth);
        differences(&solver.window, &picture.points)
    });
    let floor = summary(&floor.collect::<Vec<_>>());
    log(&format!(
        "residual of the shape model on the test portraits: {floor}"
    ));
    Ok(pictures)
}

/// Starts at portraits and rendered faces.
fn starts(
    args: &TrainArgs,
    shape: &ShapeModel,
    pictures: &Pictures,
    log: Log,
) -> Result<Vec<Sample>, Fault> {
    let drawn = args.drawn_faces(args.drawn, args.seed, shape, |s| args.learns_from(s))?;
    log(&format!("{} rendered faces", drawn.len()));
    let mut samples = disturbed(&pictures.train, args.starts, &[COLD], true, args.seed);
    samples.extend(disturbed(&drawn, 1, &STARTS, false, args.seed + 3));
    log(&format!("{} starts", samples.len()));
    Ok(samples)
}

/// The starts that a model of this shape is trained on.
///
/// # Errors
/// If the data cannot be read or are too few.
pub fn training_starts(
    args: &TrainArgs,
    shape: &ShapeModel,
    log: Log,
) -> Result<Vec<Sample>, Fault> {
    starts(args, shape, &portraits(args, shape)?, log)
}

/// Trains the cold and warm stages on portraits and rendered faces.
fn learn_stages(
    args: &TrainArgs,
    shape: &ShapeModel,
    pictures: &Pictures,
    log: Log,
) -> Result<[Vec<CascadeStage>; 2], Fault> {
    let samples = starts(args, shape, pictures, log)?;

    // People not trained on go through the stages as well, to measure generalisation.
    let strangers = args.strangers();
    let watched = args.drawn_faces(args.drawn / 15, args.seed + 5, shape, |s| s == strangers)?;
    let watched = disturbed(&watched, 1, &[NEAR], false, args.seed + 5);
    let mut watched_progress = cold_starts(&watched);
    let mut progress = cold_starts(&samples);
    let (mut cold, mut warm) = (Vec::new(), Vec::new());
    for (k, settings) in STAGES.into_iter().enumerate() {
        let stage = learn_stage(&samples, &mut progress, shape, settings);
        let this = std::slice::from_ref(&stage);
        advance(&watched, &mut watched_progress, shape, this);
        log(&format!(
            "stage {}: {:.2} % on the training starts, {:.2} % on held-out people (points 17–67)",
            k + 1,
            mean_inner(&measured(&samples, &progress, shape)),
            mean_inner(&measured(&watched, &watched_progress, shape))
        ));
        if k < COLD_STAGES {
            cold.push(stage);
        } else {
            warm.push(stage);
        }
    }
    let strangers = summary(&measured(&watched, &watched_progress, shape));
    log(&format!("strangers: {strangers}"));
    Ok([cold, warm])
}

/// Prints errors on portraits of people not trained on.
fn tell_portraits(args: &TrainArgs, model: &FaceModel, pictures: &Pictures, log: Log) {
    for (name, pictures) in [("dev", &pictures.dev), ("test", &pictures.test)] {
        if pictures.is_empty() {
            continue;
        }
        let samples = disturbed(pictures, 10, &[COLD], false, args.seed + 7);
        let ends = fit_cold(&samples, model);
        let all = measured(&samples, &ends, &model.shape);
        let errors = summary(&all);
        log(&format!("{name} people, portraits, cold: {errors}"));
        let offsets = mean_offsets(&all);
        let clean: Vec<_> = all.iter().map(|d| without(d, &offsets)).collect();
        log(&format!("with mean offsets removed: {}", summary(&clean)));
    }
}

/// Writes mean offsets per landmark, of people with the same annotation outside the test split.
fn write_offsets(
    args: &TrainArgs,
    model: &FaceModel,
    pictures: &Pictures,
    path: &Path,
) -> Result<PathBuf, Fault> {
    let few = &pictures.train[..pictures.train.len().min(150)];
    let samples = disturbed(few, 4, &[COLD], false, args.seed + 13);
    let ends = fit_cold(&samples, model);
    let offsets = mean_offsets(&measured(&samples, &ends, &model.shape));
    let text = crate::fit::emit_offsets(&offsets);
    write_beside(path, text.as_bytes(), false)
}

/// Trains a model and writes it; `say` prints one line per step.
///
/// # Errors
/// If the data cannot be read, is too little, or the result cannot be written.
pub fn train(args: &TrainArgs, say: &mut dyn FnMut(&str)) -> Result<(), Fault> {
    let paper = paper_section::Source::read(args)?;
    let began = Instant::now();
    let log: Log = &mut |what| say(&format!("{:5.0} s {what}", began.elapsed().as_secs_f32()));
    let ict = IctHead::read(&args.data.data.join("ict_facekit"))?;
    let mut model = learn_fits(args, &ict, log)?;
    // Written before the paper's model as well, which takes longest, so that earlier work is not lost.
    write_out(&args.out, file::emit(&model))?;
    model.paper_aam = paper.section(args, &model.shape, log)?;
    if args.drawn > 0 {
        let keep = |person| args.learns_from(Split::from_index(person));
        let people = PEOPLE.min(1 + args.drawn / FACES_A_PERSON);
        let shapes = args.shapes()?;
        let seed = args.seed + 17;
        let learnt = learn_refinement(&args.data.data, &model, keep, people, &shapes, seed)?;
        model.refinement = learnt.map(Into::into);
        log("what depth adds");
    }
    let bytes = file::emit(&model);
    let [.., a, b, c, d] = bytes[..] else {
        unreachable!("a model ends with its checksum");
    };
    write_out(&args.out, &bytes)?;
    log(&format!(
        "wrote {}: {} bytes, id {:08x}",
        args.out.display(),
        bytes.len(),
        u32::from_le_bytes([a, b, c, d])
    ));
    Ok(())
}

/// Trains shape, stages and confidence, and prints errors on people not trained on.
fn learn_fits(args: &TrainArgs, ict: &IctHead, log: Log) -> Result<FaceModel, Fault> {
    let sites = mien_baking::heads::plain_head(ict).landmarks;
    let shape = learn_shape(args, ict, &sites, log)?;
    let pictures = read_portraits(args, &shape, log)?;
    let [cold, warm] = learn_stages(args, &shape, &pictures, log)?;
    let mut model = FaceModel {
        provenance: format!(
            "shape: ICT FaceKit (MIT){}; pictures: Face Research Lab London Set and Young Adult White Faces, DeBruine and \
             Jones 2017 (CC BY 4.0); written by mien-studio train",
            args.shapes
                .as_ref()
                .map_or("", |_| ", other ages: MakeHuman (CC0)")
        ),
        shape,
        cold: cold.into(),
        warm: warm.into(),
        standard_head: standard_head::standard_head(ict),
        ..FaceModel::default()
    };
    model.confidence = learn_confidence(args, &pictures.train, &model)?.into();
    log("confidence");
    tell_portraits(args, &model, &pictures, log);
    if let Some(path) = &args.offsets {
        let path = write_offsets(args, &model, &pictures, path)?;
        log(&format!("wrote {}", path.display()));
    }
    Ok(model)
}

/// Trains confidence on fits of unseen pictures: from regular starts, from far starts, and in windows beside the
/// face.
fn learn_confidence(
    args: &TrainArgs,
    portraits: &[TruePicture],
    model: &FaceModel,
) -> Result<ConfidenceModel, Fault> {
    let (seed, shape) = (args.seed, &model.shape);
    let mut fresh = args.drawn_faces(args.drawn / 6, seed + 17, shape, |s| args.learns_from(s))?;
    fresh.extend(portraits.iter().take(150).cloned());
    let mut samples = disturbed(&fresh, 2, &STARTS, true, seed + 1);
    let first_wrong = samples.len();
    samples.extend(disturbed(&fresh, 1, &[FAR], true, seed + 1));
    let first_beside = samples.len();
    samples.extend(disturbed(&fresh, 1, &[BESIDE], true, seed + 2));
    let ends = fit_cold(&samples, model);
    // A window beside the face that contains none of it.
    let faceless = |k: usize| {
        let [x, y] = samples[k].truth.view.shift;
        k >= first_beside && (x - 92.0).abs().max((y - 66.0).abs()) > 60.0
    };
    let weight = |k: usize| if k < first_wrong { 1.0 } else { WRONG_WEIGHT };
    let cell_px = CONFIDENCE_CELL_PX;
    Ok(confidence::learn(
        &samples, &ends, &faceless, &weight, shape, cell_px,
    ))
}
