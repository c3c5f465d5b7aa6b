//! The whole training: what is learnt from what, in which order, and the figures at the end.
//!
//! Shape modes from the head set; portraits of the people that [`Split`] gives to training, each with its mirror image and
//! many disturbed starts; drawn faces with known truth; cold stages, warm stages, confidence; then the test people.
//! The model file is written only at the end.
//! One file: the order of a training from pictures to figures; each step has its own file.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;

use super::cascade::{
    Progress, StageSettings, advance, cold_starts, fit_cold, inner_error_percent, learn_stage,
};
use super::dataset::{DatasetError, read_folder};
use super::error::TrainError;
use super::evaluate::{Errors, differences, mean_offsets};
use super::paper_aam::{PaperPractice, paper_aam_block};
use super::person::learn_session;
use super::refine::{Practice, learn_refinement};
use super::render::{Renderer, TrainingSample};
use super::samples::{COLD, Disturbance, Eye, NEAR, Sample, TruePicture, disturbed};
use super::{confidence, report, shape, standard_head};
use crate::base::capacity::LANDMARKS;
use crate::base::geometry::Point;
use crate::face_model::refinement::Refinement;
use crate::face_model::{
    CascadeStage, ConfidenceModel, FaceModel, MAX_MODES, ShapeModel, StandardHead, file,
};
use crate::landmarks::cascade::Solver;
use crate::sensor::camera::Camera;
use crate::simulator::virtual_head::Site;
use crate::studio::atomic_write;
use crate::studio::correlation::correlation;
use crate::studio::heads::ict::IctHead;
use crate::studio::nrsfm::Tracks;
use crate::studio::people_split::Split;

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
    /// Drawn pictures the paper's active appearance model is trained on; 0 leaves it out.
    pub paper_pictures: usize,
    /// Tracks of an actor for its 3D shape; without, one is drawn.
    pub tracks: Option<Tracks>,
    /// The paper's active appearance model of an earlier training, to be kept instead of learning it.
    pub paper_aam: Option<Cow<'static, [u8]>>,
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
            modes: 44,
            starts: 4,
            drawn: 18000,
            penalty: 0.5,
            paper_pictures: PaperPractice::default().pictures,
            tracks: None,
            paper_aam: None,
            hold_out_dev: false,
            seed: 1,
        }
    }
}

impl TrainArgs {
    /// Whether people of this part are trained on.
    fn learns_from(&self, split: Split) -> bool {
        split == Split::Train || (split == Split::Dev && !self.hold_out_dev)
    }

    /// People who are neither trained on nor kept for later: figures are of them.
    fn strangers(&self) -> Split {
        if self.hold_out_dev {
            Split::Dev
        } else {
            Split::Test
        }
    }

    /// So many faces drawn of the people that `keep` accepts.
    fn drawn_faces(
        &self,
        count: usize,
        seed: u64,
        shape: &ShapeModel,
        keep: impl Fn(Split) -> bool,
    ) -> Result<Vec<TruePicture>, TrainError> {
        let renderer = Renderer::new(&self.data, |person| keep(Split::of(person)))?;
        let camera = crate::sensor::kinect::geometry::nominal();
        let samples = renderer.samples(0..count as u64, seed);
        let faces = samples
            .par_iter()
            .filter_map(|sample| TruePicture::drawn(sample, &camera, shape));
        Ok(faces.collect())
    }
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

/// Distance of neighbouring cells, window pixels, and shape modes moved by each stage. The view and the coarse shape come
/// first; lids and lips need the finer maps of the end.
const STAGES: [(f32, usize); 6] = [
    (6.5, 10),
    (5.5, 24),
    (5.0, MAX_MODES),
    (4.0, MAX_MODES),
    (3.2, MAX_MODES),
    (2.4, MAX_MODES),
];
/// How many of them are the model's cold ones.
const COLD_STAGES: usize = 2;
/// Cells of the patches that confidence looks at, window pixels.
const CONFIDENCE_CELL_PX: f32 = 4.0;
/// Starts in turn: mostly as near as the tracker's, some as far as a box about a still face.
const STARTS: [Disturbance; 3] = [NEAR, NEAR, COLD];
/// Starts that mostly fail.
const FAR: Disturbance = Disturbance {
    position: 0.35,
    angle: 0.5,
    scale: 0.3,
};
/// How much a wrong start, far or beside, counts against one as it is meant: there is one of each for two of those, so
/// that one fit in twenty starts wrong.
const WRONG_WEIGHT: f64 = 0.053;
/// Starts beside the face.
const BESIDE: Disturbance = Disturbance {
    position: 1.6,
    angle: 0.5,
    scale: 0.5,
};

/// The mean as a face.
fn reference_of(shape: &ShapeModel) -> shape::Face {
    std::array::from_fn(|i| shape.mean[i])
}

/// What the nearest shape of the model's first modes leaves of a face, seen from the front, in outer eye distances.
fn left_by(shape: &ShapeModel, face: &shape::Face, modes: usize) -> [[f32; 2]; LANDMARKS] {
    let mut coefficients = [0.0; MAX_MODES];
    shape.coefficients(face, &mut coefficients[..shape.modes.len()]);
    let mut nearest = [Point::origin(); LANDMARKS];
    shape.shape(&coefficients[..modes.min(MAX_MODES)], &mut nearest);
    differences(&nearest.map(|p| [p.x, p.y]), &face.map(|p| [p.x, p.y]))
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

fn write(path: &Path, bytes: &[u8]) -> Result<(), TrainError> {
    atomic_write::write(path, bytes).map_err(|source| TrainError::Unwritable {
        path: path.to_owned(),
        source,
    })
}

/// What is said while it goes on, and what the page tells of it at the end.
struct Log<'a> {
    began: Instant,
    say: &'a mut dyn FnMut(&str),
    told: Vec<(String, String)>,
}

impl Log<'_> {
    fn since(&self) -> String {
        format!("{:5.0} s", self.began.elapsed().as_secs_f32())
    }

    /// A step that is done.
    fn done(&mut self, what: &str) {
        let since = self.since();
        (self.say)(&format!("{since} {what}"));
    }

    /// A figure.
    fn figure(&mut self, what: &str) {
        (self.say)(&format!("  {what}"));
    }
}

/// Shape modes of a population that looks as the portraits show people, not as the head set alone.
fn learn_shape(
    args: &TrainArgs,
    ict: &IctHead,
    sites: &[Site],
    log: &mut Log,
) -> Result<ShapeModel, TrainError> {
    let mut faces = shape::population(ict, sites, 6000, args.seed);
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
    log.done(&format!(
        "shape model: {} modes from {} faces",
        shape.modes.len(),
        faces.len()
    ));
    let strange = shape::population(ict, sites, 300, args.seed + 1);
    for count in [10, 20, 30, modes] {
        let mut floor = Errors::default();
        for face in &strange {
            let face = shape::aligned(face, &reference_of(&shape));
            floor.add(&left_by(&shape, &face, count));
        }
        let line = floor.line();
        log.figure(&format!(
            "residual of {count} modes on rendered faces, frontal view: {line}"
        ));
        log.told
            .push((format!("residual of {count} modes on rendered faces"), line));
    }
    Ok(shape)
}

/// The portraits, with what the shape model leaves of those to test on.
fn read_portraits(
    args: &TrainArgs,
    shape: &ShapeModel,
    log: &mut Log,
) -> Result<Pictures, TrainError> {
    let pictures = portraits(args, shape)?;
    log.done(&format!(
        "portraits: {} to train on (with mirror images), {} to choose on, {} to test on",
        pictures.train.len(),
        pictures.dev.len(),
        pictures.test.len()
    ));
    let mut floor = Errors::default();
    let mut solver = Solver::default();
    for picture in &pictures.test {
        solver.project(shape, &picture.truth);
        floor.add(&differences(&solver.window, &picture.points));
    }
    log.figure(&format!(
        "residual of the shape model on the test portraits: {}",
        floor.line()
    ));
    Ok(pictures)
}

/// The stages, cold and warm, from portraits and drawn faces; the drawn ones join what is trained on.
fn learn_stages(
    args: &TrainArgs,
    shape: &ShapeModel,
    pictures: &mut Pictures,
    log: &mut Log,
) -> Result<[Vec<CascadeStage>; 2], TrainError> {
    let drawn = args.drawn_faces(args.drawn, args.seed, shape, |s| args.learns_from(s))?;
    log.done(&format!("{} rendered faces", drawn.len()));
    let mut samples = disturbed(&pictures.train, args.starts, &[COLD], true, args.seed);
    samples.extend(disturbed(&drawn, 1, &STARTS, false, args.seed + 3));
    pictures.train.extend(drawn);
    log.done(&format!("{} starts", samples.len()));

    // People not trained on are taken along from stage to stage: what the stages are worth beyond the training people.
    let strangers = args.strangers();
    let watched = args.drawn_faces(args.drawn / 15, args.seed + 5, shape, |s| s == strangers)?;
    let watched = disturbed(&watched, 1, &[NEAR], false, args.seed + 5);
    let mut watched_progress = cold_starts(&watched);
    let mut progress = cold_starts(&samples);
    let (mut cold, mut warm) = (Vec::new(), Vec::new());
    for (k, (cell_px, modes)) in STAGES.into_iter().enumerate() {
        let settings = StageSettings {
            cell_px,
            modes,
            penalty: args.penalty,
        };
        let stage = learn_stage(&samples, &mut progress, shape, settings);
        let this = std::slice::from_ref(&stage);
        advance(&watched, &mut watched_progress, shape, this);
        let figure = format!(
            "{:.2} % on the training starts, {:.2} % on held-out people (points 17–67)",
            inner_error_percent(&samples, &progress, shape),
            inner_error_percent(&watched, &watched_progress, shape)
        );
        log.done(&format!("stage {}: {figure}", k + 1));
        log.told.push((format!("after stage {}", k + 1), figure));
        if k < COLD_STAGES {
            cold.push(stage);
        } else {
            warm.push(stage);
        }
    }
    log.figure(&format!(
        "strangers: {}",
        measured(&watched, &watched_progress, shape).0.line()
    ));
    Ok([cold, warm])
}

/// Errors on portraits of people not trained on.
fn tell_portraits(args: &TrainArgs, model: &FaceModel, pictures: &Pictures, log: &mut Log) {
    for (name, pictures) in [("dev", &pictures.dev), ("test", &pictures.test)] {
        if pictures.is_empty() {
            continue;
        }
        let samples = disturbed(pictures, 10, &[COLD], false, args.seed + 7);
        let ends = fit_cold(&samples, &model.shape, &model.cold, &model.warm);
        let (errors, all) = measured(&samples, &ends, &model.shape);
        log.done(&format!(
            "{name} people, portraits, cold: {}",
            errors.line()
        ));
        let offsets = mean_offsets(&all);
        let mut clean = Errors::default();
        for d in &all {
            clean.add(&super::evaluate::without(d, &offsets));
        }
        log.figure(&format!("with mean offsets removed: {}", clean.line()));
        log.figure(&calibration(model, &samples, &ends));
    }
}

/// Mean offsets per landmark, of people of the same annotation who are not the test people.
fn write_offsets(
    args: &TrainArgs,
    model: &FaceModel,
    pictures: &Pictures,
    path: &Path,
) -> Result<(), TrainError> {
    let samples = disturbed(
        &pictures.train[..pictures.train.len().min(150)],
        4,
        &[COLD],
        false,
        args.seed + 13,
    );
    let ends = fit_cold(&samples, &model.shape, &model.cold, &model.warm);
    let offsets = mean_offsets(&measured(&samples, &ends, &model.shape).1);
    write(path, crate::studio::fit::emit_offsets(&offsets).as_bytes())
}

/// Trains a model and writes it; `say` gets one line per step.
///
/// # Errors
/// If the data cannot be read, is too little, or the result cannot be written.
pub fn train(args: &TrainArgs, say: &mut dyn FnMut(&str)) -> Result<FaceModel, TrainError> {
    let log = &mut Log {
        began: Instant::now(),
        say,
        told: Vec::new(),
    };
    let ict = IctHead::read(&args.data.join("ict_facekit"))?;
    let sites = crate::studio::heads::plain_head(&ict).landmarks;
    let shape = learn_shape(args, &ict, &sites, log)?;
    let mut pictures = read_portraits(args, &shape, log)?;
    let portraits_read = pictures.train.len();
    let [cold, warm] = learn_stages(args, &shape, &mut pictures, log)?;
    let photographs = &pictures.train[..portraits_read];
    let confidence = learn_confidence(args, photographs, &shape, &cold, &warm)?;
    log.done("confidence");

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
    tell_portraits(args, &model, &pictures, log);
    let strangers = args.strangers();
    let renderer = Renderer::new(&args.data, |person| Split::of(person) == strangers)?;
    let drawn = renderer.samples(0..400, args.seed + 11);
    report_drawn(
        &model,
        &drawn,
        &crate::sensor::kinect::geometry::nominal(),
        args.seed,
        log.say,
    );
    let names: Vec<String> = renderer
        .expression_names()
        .into_iter()
        .map(String::from)
        .collect();
    if let Some(path) = &args.offsets {
        write_offsets(args, &model, &pictures, path)?;
    }
    // Written before the paper's model as well, which takes longest: what is done is not lost.
    write(&args.out, &file::emit(&model))?;
    if let Some(kept) = &args.paper_aam {
        model.paper_aam = kept.clone();
    } else if args.paper_pictures > 0 {
        model.paper_aam = learn_paper(args, &model.shape, log.say)?.into();
    }
    if args.drawn > 0 {
        model.refinement = learn_depth(args, &model)?;
        log.done("what depth adds");
    }
    let bytes = file::emit(&model);
    let [.., a, b, c, d] = bytes[..] else {
        unreachable!("a model ends with its checksum");
    };
    model.id = u32::from_le_bytes([a, b, c, d]);
    write(&args.out, &bytes)?;
    let size = format!("{} bytes, id {:08x}", bytes.len(), model.id);
    log.told.push(("model".into(), size.clone()));
    log.told.push(("time".into(), log.since()));
    let page = args.out.with_extension("html");
    let told = std::mem::take(&mut log.told);
    let album = report::page(&model, &drawn, &names, told, args.seed + 19);
    write(&page, album.html()?.as_bytes())?;
    log.done(&format!("wrote {}", page.display()));
    log.done(&format!("wrote {}: {size}", args.out.display()));
    Ok(model)
}

/// What comes after the stages learnt anew for a model, and written: what its fits look like, and what depth adds.
///
/// # Errors
/// If the data cannot be read or are too little, or the result cannot be written.
pub fn finish(
    args: &TrainArgs,
    mut model: FaceModel,
    say: &mut dyn FnMut(&str),
) -> Result<(), TrainError> {
    let portraits = portraits(args, &model.shape)?.train;
    let confidence = learn_confidence(args, &portraits, &model.shape, &model.cold, &model.warm)?;
    model.confidence = confidence.into();
    if let Some(kept) = &args.paper_aam {
        model.paper_aam = kept.clone();
    }
    model.refinement = learn_depth(args, &model)?;
    write(&args.out, &file::emit(&model))?;
    say(&format!("wrote {}", args.out.display()));
    Ok(())
}

/// The paper's active appearance model.
fn learn_paper(
    args: &TrainArgs,
    shape: &ShapeModel,
    say: &mut dyn FnMut(&str),
) -> Result<Vec<u8>, TrainError> {
    let practice = PaperPractice {
        pictures: args.paper_pictures,
        seed: args.seed,
        ..PaperPractice::default()
    };
    let block = paper_aam_block(&args.data, shape, args.tracks.as_ref(), &practice, say)?;
    say(&format!(
        "the paper's active appearance model: {} bytes",
        block.len()
    ));
    Ok(block)
}

/// Trains the paper's active appearance model alone and puts it into a model file, where nothing else changes.
///
/// # Errors
/// If the model or the data cannot be read, or the result cannot be written.
pub fn train_paper_into(
    args: &TrainArgs,
    path: &PathBuf,
    say: &mut dyn FnMut(&str),
) -> Result<(), TrainError> {
    let bytes = model_bytes(path)?;
    let model = file::parse(&bytes)?;
    let block = learn_paper(args, &model.shape, say)?;
    write_paper(&args.out, &bytes, &block, say)
}

/// As [`train_paper_into`], for the one person of a recording, whom the default pipeline with the model of `path` follows.
///
/// # Errors
/// If the model or the recording cannot be read, the recording shows too little, or the result cannot be written.
pub fn train_person(
    args: &TrainArgs,
    session: &Path,
    path: Option<&PathBuf>,
    say: &mut dyn FnMut(&str),
) -> Result<(), TrainError> {
    let bytes = match path {
        Some(path) => model_bytes(path)?,
        None => crate::face_model::SHIPPED.to_vec(),
    };
    let model = file::parse(&bytes)?;
    let block = learn_session(session, &model, args.seed, say)?;
    write_paper(&args.out, &bytes, &block, say)
}

fn model_bytes(path: &PathBuf) -> Result<Vec<u8>, TrainError> {
    std::fs::read(path).map_err(|source| TrainError::Unreadable {
        path: path.clone(),
        source,
    })
}

/// Writes a model file with this section instead of its own.
fn write_paper(
    out: &Path,
    bytes: &[u8],
    block: &[u8],
    say: &mut dyn FnMut(&str),
) -> Result<(), TrainError> {
    let grafted = file::with_section(bytes, *b"PAAM", block)?;
    write(out, &grafted)?;
    let kept = file::sections(bytes)?
        .zip(file::sections(&grafted)?)
        .filter(|(before, after)| before == after)
        .count();
    say(&format!(
        "wrote {}: {} bytes; {kept} other sections unchanged, byte for byte",
        out.display(),
        grafted.len()
    ));
    Ok(())
}

/// What depth adds to a model's fits.
fn learn_depth(args: &TrainArgs, model: &FaceModel) -> Result<Option<Arc<Refinement>>, TrainError> {
    let practice = Practice {
        seed: args.seed + 17,
        ..Practice::default()
    };
    let keep = |person| args.learns_from(Split::of(person));
    Ok(learn_refinement(&args.data, model, keep, &practice)?.map(Into::into))
}

/// From ends of fits on pictures not learnt from: as they are meant, from far starts, and in windows beside the face.
fn learn_confidence(
    args: &TrainArgs,
    portraits: &[TruePicture],
    shape: &ShapeModel,
    cold: &[CascadeStage],
    warm: &[CascadeStage],
) -> Result<ConfidenceModel, TrainError> {
    let seed = args.seed;
    let mut fresh = args.drawn_faces(args.drawn / 6, seed + 17, shape, |s| args.learns_from(s))?;
    fresh.extend(portraits.iter().take(150).cloned());
    let mut samples = disturbed(&fresh, 2, &STARTS, true, seed + 1);
    let first_wrong = samples.len();
    samples.extend(disturbed(&fresh, 1, &[FAR], true, seed + 1));
    let first_beside = samples.len();
    samples.extend(disturbed(&fresh, 1, &[BESIDE], true, seed + 2));
    let ends = fit_cold(&samples, shape, cold, warm);
    let faceless = |k: usize| {
        // A window beside the face whose face lies outside it.
        k >= first_beside && {
            let s = &samples[k].truth.view.shift;
            let off = (s[0] - 92.0).abs().max((s[1] - 66.0).abs());
            off > 60.0
        }
    };
    let weight = |k: usize| if k < first_wrong { 1.0 } else { WRONG_WEIGHT };
    let cell_px = CONFIDENCE_CELL_PX;
    Ok(confidence::learn(
        &samples, &ends, &faceless, &weight, shape, cell_px,
    ))
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

/// How often a face is within 5 % where its confidence says so: share of the faces, their mean confidence, share within.
fn calibration(model: &FaceModel, samples: &[Sample], ends: &[Progress]) -> String {
    let told: Vec<(f32, bool)> = ends
        .par_iter()
        .map_init(<(Solver, Eye)>::default, |(solver, eye), end| {
            let sample = &samples[end.sample];
            let maps = eye.look(sample);
            let belief = solver.belief(&model.confidence, &model.shape, maps, &end.fit);
            solver.project(&model.shape, &end.fit);
            let d = differences(&solver.window, &sample.points);
            let error = d.iter().map(|d| d[0].hypot(d[1])).sum::<f32>() / LANDMARKS as f32;
            (belief.face, error <= 0.05)
        })
        .collect();
    let line: Vec<String> = (0..5)
        .filter_map(|bin| {
            let of = told.iter().filter(|t| ((t.0 * 5.0) as usize).min(4) == bin);
            let (count, sum, good) = of.fold((0usize, 0.0, 0usize), |s, t| {
                (s.0 + 1, s.1 + t.0, s.2 + usize::from(t.1))
            });
            let n = count as f32;
            (count > 0).then(|| format!("{count}: {:.2} → {:.2}", sum / n, good as f32 / n))
        })
        .collect();
    format!("confidence → share within 5 %: {}", line.join(", "))
}

/// Errors on drawn strangers, and how well measures follow the truth.
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
    let samples = disturbed(&pictures, 2, &[COLD], false, seed + 7);
    let ends = fit_cold(&samples, &model.shape, &model.cold, &model.warm);
    say(&format!(
        "strangers, drawn, from far: {}",
        measured(&samples, &ends, &model.shape).0.line()
    ));
    say(&format!("  {}", calibration(model, &samples, &ends)));
    let samples = disturbed(&pictures, 2, &[NEAR], false, seed + 7);
    let ends = fit_cold(&samples, &model.shape, &model.cold, &model.warm);
    say(&format!(
        "strangers, drawn, from near: {}",
        measured(&samples, &ends, &model.shape).0.line()
    ));
    let mean = reference_of(&model.shape);
    let mut pairs: [Vec<[f32; 2]>; 6] = Default::default();
    let mut floors: [Vec<[f32; 2]>; 6] = Default::default();
    let mut names = [""; 6];
    let mut head = mean;
    for end in &ends {
        let truth = shape::aligned(&kept[end.sample / 2].0.head, &mean);
        let mut best = end.fit.shape;
        model
            .shape
            .coefficients(&truth, &mut best[..model.shape.modes.len()]);
        model.shape.shape(&best, &mut head);
        for (k, (a, b)) in measures(&truth)
            .into_iter()
            .zip(measures(&head))
            .enumerate()
        {
            floors[k].push([a.1, b.1]);
        }
        model.shape.shape(&end.fit.shape, &mut head);
        for (k, (a, b)) in measures(&truth)
            .into_iter()
            .zip(measures(&head))
            .enumerate()
        {
            pairs[k].push([a.1, b.1]);
            names[k] = a.0;
        }
    }
    let line: Vec<String> = names
        .iter()
        .zip(pairs.iter().zip(&floors))
        .map(|(name, (pairs, floors))| {
            format!(
                "{name} {:.3} of {:.3}",
                correlation(pairs.iter().copied()),
                correlation(floors.iter().copied())
            )
        })
        .collect();
    say(&format!(
        "  correlation with the truth, and what the shape model allows: {}",
        line.join(", ")
    ));
}
