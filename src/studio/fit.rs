//! `mien-studio fit`: the 68 landmarks of still pictures, without depth.
//!
//! A face box takes the depth pose's place: the mean face fills it, upright, at five guesses of yaw and pitch; each runs the
//! cold and the warm stages, the most believed end is fitted once more in a window cut where it lies, and the better
//! of the two is kept. Boxes come from the command line, a table, or the annotation, disturbed by a fixed seed. Errors are
//! per cent of the outer eye distance, as they are and with mean offsets per landmark (face axes) taken out.
//! One file: the command from pictures to table.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::base::capacity::LANDMARKS;
use crate::base::geometry::{Point, rotation_from_yaw_pitch_roll};
use crate::face_model::{FaceModel, MAX_MODES, ModelError};
use crate::landmarks::cascade::{FaceFit, Solver};
use crate::landmarks::features::OrientationMaps;
use crate::landmarks::view::View;
use crate::landmarks::window::{Picture, Placement, Region, WINDOW};
use crate::studio::atomic_write;
use crate::studio::fitted_picture::fitted_picture;
use crate::studio::progress::Progress;
use crate::studio::train::dataset::{DatasetError, Entry, load_grey, read_folder};
use crate::studio::train::evaluate::{Errors, differences, without};
use crate::studio::train::samples::STUDIO_INVERSE_DISTANCE;

/// Pictures are shrunk until a face is at most this many pixels wide: the window is 100.
const MOST_FACE_PX: f32 = 150.0;
/// Guesses of (yaw, pitch), degrees.
const GUESSES_DEG: [(f32, f32); 5] = [
    (0.0, 0.0),
    (22.0, 0.0),
    (-22.0, 0.0),
    (0.0, 14.0),
    (0.0, -14.0),
];

/// A box about the 68 points: left, top, width, height, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaceBox {
    /// Left edge.
    pub x: f32,
    /// Upper edge.
    pub y: f32,
    /// Width.
    pub width: f32,
    /// Height.
    pub height: f32,
}

impl FaceBox {
    /// The box of points.
    #[must_use]
    pub fn around(points: &[[f32; 2]; LANDMARKS]) -> Self {
        let [(left, right), (top, bottom)] = [0, 1].map(|axis| {
            let along = points.iter().map(|p| p[axis]);
            along.fold((f32::MAX, f32::MIN), |(low, high), v| {
                (low.min(v), high.max(v))
            })
        });
        Self {
            x: left,
            y: top,
            width: right - left,
            height: bottom - top,
        }
    }
}

/// What to fit.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct FitArgs {
    /// Folder of pictures, annotated or not
    #[arg(long)]
    pub images: PathBuf,
    /// Table of the points: file, confidence, x0, y0, ... in pixels of the file
    #[arg(long)]
    pub out: PathBuf,
    /// Face model [default: the built-in one]
    #[arg(long)]
    pub model: Option<PathBuf>,
    /// One face box x,y,w,h for all pictures [default: the annotation's, disturbed]
    #[arg(long = "box", value_parser = |text: &str| parse_box(text).ok_or("expected x,y,w,h in pixels"), conflicts_with = "boxes")]
    pub face_box: Option<FaceBox>,
    /// Table of face boxes: file, x, y, w, h
    #[arg(long)]
    pub boxes: Option<PathBuf>,
    /// Mean offset of each landmark, as train writes them, to take out of the error
    #[arg(long)]
    pub offsets: Option<PathBuf>,
    /// Folder for every picture with the points drawn in, numbered, the annotation's in white
    #[arg(long)]
    pub pictures: Option<PathBuf>,
}

/// Why pictures cannot be fitted.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// The pictures.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The model.
    #[error("{path}: {source}")]
    Model {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: ModelError,
    },
    /// A file cannot be read.
    #[error("cannot read {path}: {source}")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file cannot be written.
    #[error("cannot write {path}: {source}; give another place")]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A table is wrong.
    #[error("{path}, line {line}: expected {expected}, found {found:?}; correct the line")]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What should be there.
        expected: &'static str,
        /// What is there.
        found: String,
    },
    /// A picture without a box.
    #[error(
        "{file}: expected a face box, found none; give --box x,y,w,h or --boxes FILE.csv, or annotate the picture"
    )]
    NoBox {
        /// The picture.
        file: String,
    },
}

/// Parses `x,y,w,h` of `--box`; `None` if it is not four finite numbers with a positive size.
#[must_use]
pub fn parse_box(text: &str) -> Option<FaceBox> {
    let v: Vec<f32> = text
        .split(',')
        .map(|w| w.trim().parse().ok().filter(|v: &f32| v.is_finite()))
        .collect::<Option<_>>()?;
    (v.len() == 4 && v[2] > 0.0 && v[3] > 0.0).then(|| FaceBox {
        x: v[0],
        y: v[1],
        width: v[2],
        height: v[3],
    })
}

fn read_text(path: &Path) -> Result<String, FitError> {
    crate::studio::text_files::read(path).map_err(|source| FitError::Unreadable {
        path: path.into(),
        source,
    })
}

fn read_boxes(path: &Path) -> Result<HashMap<String, FaceBox>, FitError> {
    let text = read_text(path)?;
    let mut boxes = HashMap::new();
    for (k, line) in text.lines().enumerate() {
        if line.trim().is_empty() || (k == 0 && line.starts_with("file")) {
            continue;
        }
        let parsed = line
            .split_once(',')
            .and_then(|(file, rest)| Some((file.trim().to_owned(), parse_box(rest)?)));
        let Some((file, face_box)) = parsed else {
            return Err(FitError::Malformed {
                path: path.into(),
                line: k + 1,
                expected: "file,x,y,w,h with a positive size",
                found: line.into(),
            });
        };
        boxes.insert(file, face_box);
    }
    Ok(boxes)
}

/// Reads offsets: CSV `landmark,dx,dy`, face axes, in outer eye distances.
fn read_offsets(path: &Path) -> Result<[[f32; 2]; LANDMARKS], FitError> {
    let text = read_text(path)?;
    let mut offsets = [[0.0; 2]; LANDMARKS];
    for (k, line) in text.lines().enumerate().skip(1) {
        let numbers: Vec<f32> = line
            .split(',')
            .filter_map(|w| w.trim().parse().ok())
            .collect();
        match numbers[..] {
            [i, x, y] if (0.0..LANDMARKS as f32).contains(&i) => offsets[i as usize] = [x, y],
            _ => {
                return Err(FitError::Malformed {
                    path: path.into(),
                    line: k + 1,
                    expected: "landmark,dx,dy",
                    found: line.into(),
                });
            }
        }
    }
    Ok(offsets)
}

/// Offsets as a file, see [`FitArgs::offsets`].
#[must_use]
pub fn emit_offsets(offsets: &[[f32; 2]; LANDMARKS]) -> String {
    let mut text = String::from("landmark,dx,dy\n");
    for (i, [x, y]) in offsets.iter().enumerate() {
        let _ = writeln!(text, "{i},{x:.5},{y:.5}");
    }
    text
}

/// Box of points, disturbed by ±10 % of the width in place and ±7 % in size; and a roll within ±8°.
pub(super) fn disturbed_box(points: &[[f32; 2]; LANDMARKS], seed: u64) -> (FaceBox, f32) {
    let mut random = fastrand::Rng::with_seed(seed);
    let mut about = |size: f32| size * (2.0 * random.f32() - 1.0);
    let mut low = [f32::MAX; 2];
    let mut high = [f32::MIN; 2];
    for p in points {
        for axis in 0..2 {
            low[axis] = low[axis].min(p[axis]);
            high[axis] = high[axis].max(p[axis]);
        }
    }
    let (w, h) = (high[0] - low[0], high[1] - low[1]);
    let (dx, dy, grow) = (about(0.10) * w, about(0.10) * w, 1.0 + about(0.07));
    let face_box = FaceBox {
        x: low[0] + dx - 0.5 * w * (grow - 1.0),
        y: low[1] + dy - 0.5 * h * (grow - 1.0),
        width: w * grow,
        height: h * grow,
    };
    (face_box, about(8f32.to_radians()))
}

/// One fitted face.
#[derive(Clone, Debug)]
pub struct FittedFace {
    /// The 68 points, picture pixels.
    pub points: [[f32; 2]; LANDMARKS],
    /// The 68 points in the head frame at the model's size, metres.
    pub head: [Point; LANDMARKS],
    /// 0…1.
    pub confidence: f32,
    /// View in picture pixels (of the picture as it was fitted).
    pub view: View,
}

/// Fits still pictures with one model.
pub struct StillFitter<'a> {
    model: &'a FaceModel,
    window: Vec<f32>,
    maps: OrientationMaps,
    solver: Solver,
}

impl<'a> StillFitter<'a> {
    /// A fitter.
    #[must_use]
    pub fn new(model: &'a FaceModel) -> Self {
        Self {
            model,
            window: vec![0.0; WINDOW * WINDOW],
            maps: OrientationMaps::default(),
            solver: Solver::default(),
        }
    }

    /// The view in which the mean face fills a box, turned by yaw, pitch and roll (radians).
    fn view_in_box(&self, face_box: &FaceBox, yaw: f32, pitch: f32, roll: f32) -> View {
        let mut view = View {
            log_scale: 0.0,
            rotation: rotation_from_yaw_pitch_roll(yaw, pitch, 0.0),
            shift: [0.0, 0.0],
            inverse_distance: STUDIO_INVERSE_DISTANCE,
        };
        let mut low = [f32::MAX; 2];
        let mut high = [f32::MIN; 2];
        for p in &self.model.shape.mean {
            let p = view.project(p);
            for axis in 0..2 {
                low[axis] = low[axis].min(p[axis]);
                high[axis] = high[axis].max(p[axis]);
            }
        }
        let scale =
            (face_box.width * face_box.height / ((high[0] - low[0]) * (high[1] - low[1]))).sqrt();
        view.log_scale = scale.ln();
        let off = [0, 1].map(|axis| 0.5 * (low[axis] + high[axis]) * scale);
        let (sin, cos) = roll.sin_cos();
        view.shift = [
            face_box.x + 0.5 * face_box.width - (off[0] * cos - off[1] * sin),
            face_box.y + 0.5 * face_box.height - (off[0] * sin + off[1] * cos),
        ];
        view.rotation = crate::base::geometry::Rotation::from_axis_angle(
            &crate::base::geometry::Vector::z_axis(),
            roll,
        ) * view.rotation;
        view
    }

    /// Cold and warm stages in a window cut where the view says; log odds, fit in the window, placement.
    fn run(&mut self, picture: &Picture, view: &View) -> (f32, FaceFit, Placement) {
        let placement = Placement::of_view(view);
        placement.resample(picture, &Region::WHOLE, &mut self.window);
        self.maps.compute(&self.window, &Region::WHOLE);
        let shape = &self.model.shape;
        let start = FaceFit {
            view: placement.start,
            shape: [0.0; MAX_MODES],
        };
        let cold = self
            .solver
            .run(&self.model.cold, shape, &self.maps, &start, &start.view);
        let fit = self
            .solver
            .run(&self.model.warm, shape, &self.maps, &cold, &start.view);
        let belief = self
            .solver
            .belief(&self.model.confidence, shape, &self.maps, &fit);
        (belief.log_odds, fit, placement)
    }

    /// The view of a fit in picture pixels.
    fn in_picture(fit: &FaceFit, placement: &Placement) -> View {
        let map = &placement.picture_from_window;
        View {
            log_scale: fit.view.log_scale + map[(0, 0)].hypot(map[(1, 0)]).ln(),
            rotation: crate::base::geometry::Rotation::from_axis_angle(
                &crate::base::geometry::Vector::z_axis(),
                placement.roll,
            ) * fit.view.rotation,
            shift: placement.picture_pixel(fit.view.shift),
            inverse_distance: fit.view.inverse_distance,
        }
    }

    fn face(&self, log_odds: f32, fit: &FaceFit, placement: &Placement) -> FittedFace {
        let mut head = [Point::origin(); LANDMARKS];
        self.model.shape.shape(&fit.shape, &mut head);
        FittedFace {
            points: head.map(|p| placement.picture_pixel(fit.view.project(&p))),
            head,
            confidence: crate::landmarks::cascade::logistic(log_odds),
            view: Self::in_picture(fit, placement),
        }
    }

    /// Fits the next picture of a video from where the face was in the last one ([`FittedFace::view`]).
    pub fn follow(&mut self, picture: &Picture, last: &View) -> FittedFace {
        let (log_odds, fit, placement) = self.run(picture, last);
        self.face(log_odds, &fit, &placement)
    }

    /// A short look at a box: one guess, upright and from in front, in a sixth of the time of [`Self::fit`].
    pub fn glance(&mut self, picture: &Picture, face_box: &FaceBox) -> FittedFace {
        self.follow(picture, &self.view_in_box(face_box, 0.0, 0.0, 0.0))
    }

    /// Fits the face in a box; `roll` in radians, clockwise in the picture.
    pub fn fit(&mut self, picture: &Picture, face_box: &FaceBox, roll: f32) -> FittedFace {
        let mut best: Option<(f32, FaceFit, Placement)> = None;
        for (yaw, pitch) in GUESSES_DEG {
            let view = self.view_in_box(face_box, yaw.to_radians(), pitch.to_radians(), roll);
            let end = self.run(picture, &view);
            if best.as_ref().is_none_or(|b| end.0 > b.0) {
                best = Some(end);
            }
        }
        let (mut log_odds, mut fit, mut placement) = best.expect("there are guesses");
        // Once more where it lies: the second window is centred and upright.
        let again = Self::in_picture(&fit, &placement);
        let second = self.run(picture, &again);
        if second.0 > log_odds {
            (log_odds, fit, placement) = second;
        }
        self.face(log_odds, &fit, &placement)
    }

    /// Loads a picture of a data set and fits it; pixels are those of the file.
    ///
    /// # Errors
    /// If the picture does not decode.
    pub fn fit_file(
        &mut self,
        path: &Path,
        face_box: &FaceBox,
        roll: f32,
    ) -> Result<FittedFace, DatasetError> {
        let scale = (MOST_FACE_PX / face_box.width.max(face_box.height * 0.9)).min(1.0);
        let grey = load_grey(path, scale)?;
        let small = FaceBox {
            x: (face_box.x + 0.5) * scale - 0.5,
            y: (face_box.y + 0.5) * scale - 0.5,
            width: face_box.width * scale,
            height: face_box.height * scale,
        };
        let picture = Picture {
            luma: &grey.luma,
            width: grey.width,
            height: grey.height,
        };
        let mut face = self.fit(&picture, &small, roll);
        for p in face.points.iter_mut().flatten() {
            *p = (*p + 0.5) / scale - 0.5;
        }
        Ok(face)
    }
}

/// Writes a picture with its points.
fn draw(folder: &Path, entry: &Entry, face: &FittedFace) -> Result<(), FitError> {
    let picture = image::open(&entry.path).map_err(|source| DatasetError::Picture {
        path: entry.path.clone(),
        source,
    })?;
    let truth = entry.points.as_ref();
    let drawn = fitted_picture(&picture.to_rgb8(), &face.points, truth, face.confidence);
    let path = folder.join(format!("{}.png", entry.file.replace(['/', '\\'], "_")));
    let mut png = std::io::Cursor::new(Vec::new());
    let written = drawn
        .write_to(&mut png, image::ImageFormat::Png)
        .map_err(std::io::Error::other)
        .and_then(|()| atomic_write::write(&path, png.get_ref()));
    written.map_err(|source| FitError::Unwritable { path, source })
}

/// Fits all pictures of a folder and writes the CSV; `say` gets the figures.
/// Long because it is the command from its files to its report.
///
/// # Errors
/// If something cannot be read, a picture has no box, or the CSV cannot be written.
pub fn fit(args: &FitArgs, say: &mut dyn FnMut(&str)) -> Result<(), FitError> {
    let model = match &args.model {
        None => FaceModel::shipped(),
        Some(path) => {
            let bytes = std::fs::read(path).map_err(|source| FitError::Unreadable {
                path: path.clone(),
                source,
            })?;
            FaceModel::read(&bytes).map_err(|source| FitError::Model {
                path: path.clone(),
                source,
            })?
        }
    };
    let offsets = args.offsets.as_deref().map(read_offsets).transpose()?;
    let boxes = args.boxes.as_deref().map(read_boxes).transpose()?;
    let entries = read_folder(&args.images)?;
    // With boxes given, pictures outside the table are not asked for; without, only annotated ones can be fitted.
    let wanted: Vec<(usize, &Entry)> = entries
        .iter()
        .enumerate()
        .filter(|(_, e)| match (&boxes, args.face_box) {
            (Some(boxes), _) => boxes.contains_key(&e.file),
            (None, Some(_)) => true,
            (None, None) => e.points.is_some(),
        })
        .collect();
    if wanted.is_empty() {
        return Err(FitError::NoBox {
            file: entries.first().map_or(String::new(), |e| e.file.clone()),
        });
    }
    if wanted.len() < entries.len() {
        say(&format!(
            "{} of {} pictures have no box and are skipped",
            entries.len() - wanted.len(),
            entries.len()
        ));
    }
    if let Some(folder) = &args.pictures {
        std::fs::create_dir_all(folder).map_err(|source| FitError::Unwritable {
            path: folder.clone(),
            source,
        })?;
    }
    let progress = Progress::new("fit", wanted.len());
    let faces: Vec<FittedFace> = wanted
        .par_iter()
        .map_init(
            || StillFitter::new(&model),
            |fitter, (k, entry)| {
                let given = boxes
                    .as_ref()
                    .and_then(|boxes| boxes.get(&entry.file).copied())
                    .or(args.face_box)
                    .map(|b| (b, 0.0));
                let from_points = || {
                    entry
                        .points
                        .as_ref()
                        .map(|p| disturbed_box(p, *k as u64 + 1))
                };
                let (face_box, roll) =
                    given.or_else(from_points).ok_or_else(|| FitError::NoBox {
                        file: entry.file.clone(),
                    })?;
                let face = fitter.fit_file(&entry.path, &face_box, roll)?;
                if let Some(folder) = &args.pictures {
                    draw(folder, entry, &face)?;
                }
                progress.step();
                Ok(face)
            },
        )
        .collect::<Result<_, FitError>>()?;
    drop(progress);

    let mut csv = String::from("file,confidence");
    for i in 0..LANDMARKS {
        let _ = write!(csv, ",x{i},y{i}");
    }
    csv.push('\n');
    let (mut as_given, mut cleaned) = (Errors::default(), Errors::default());
    for ((_, entry), face) in wanted.iter().zip(&faces) {
        let _ = write!(csv, "{},{:.3}", entry.file, face.confidence);
        for [x, y] in face.points {
            let _ = write!(csv, ",{x:.2},{y:.2}");
        }
        csv.push('\n');
        if let Some(points) = &entry.points {
            let d = differences(&face.points, points);
            as_given.add(&d);
            if let Some(offsets) = &offsets {
                cleaned.add(&without(&d, offsets));
            }
        }
    }
    atomic_write::write(&args.out, csv).map_err(|source| FitError::Unwritable {
        path: args.out.clone(),
        source,
    })?;
    if !as_given.faces.is_empty() {
        say(&format!("raw error: {}", as_given.line()));
        if offsets.is_some() {
            say(&format!("error with offsets removed: {}", cleaned.line()));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_are_four_numbers_with_a_size() {
        assert_eq!(
            parse_box("1, 2,30,40"),
            Some(FaceBox {
                x: 1.0,
                y: 2.0,
                width: 30.0,
                height: 40.0
            })
        );
        for bad in ["", "1,2,3", "1,2,0,4", "1,2,nan,4", "a,b,c,d"] {
            assert_eq!(parse_box(bad), None, "{bad}");
        }
    }

    #[test]
    fn the_mean_face_fills_its_box() {
        let model = FaceModel::shipped();
        let fitter = StillFitter::new(&model);
        let face_box = FaceBox {
            x: 100.0,
            y: 50.0,
            width: 120.0,
            height: 130.0,
        };
        let view = fitter.view_in_box(&face_box, 0.0, 0.0, 0.0);
        let points: Vec<[f32; 2]> = model.shape.mean.iter().map(|p| view.project(p)).collect();
        let middle = |axis: usize| {
            let low = points.iter().map(|p| p[axis]).fold(f32::MAX, f32::min);
            let high = points.iter().map(|p| p[axis]).fold(f32::MIN, f32::max);
            0.5 * (low + high)
        };
        assert!((middle(0) - 160.0).abs() < 0.1 && (middle(1) - 115.0).abs() < 0.1);
    }
}
