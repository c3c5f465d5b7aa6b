//! `mien-studio fit`: the 68 landmarks of still pictures, without depth ([`mien_workbench::still`]).
//!
//! Face boxes come from the command line, a table, or the annotation, disturbed by a fixed seed. Errors are percent
//! of the outer eye distance, as they are and less mean offsets per landmark (face axes).

use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::train::evaluate::{Differences, differences, summary, without};
use mien_appliance::service;
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::face_model::FaceModel;
use mien_workbench::atomic_write::write_out;
use mien_workbench::dataset::{Entry, malformed, read, read_folder};
use mien_workbench::fault::Fault;
use mien_workbench::progress::Progress;
use mien_workbench::still::{FaceBox, FittedFace, StillFitter, disturbed_box};

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
    /// Mean offset of each landmark, as written by train, to remove from the error
    #[arg(long)]
    pub offsets: Option<PathBuf>,
}

/// An error: a picture without a box.
fn no_box(file: &str) -> Fault {
    Fault::new(format!(
        "{file}: expected a face box, found none; give --box x,y,w,h or --boxes FILE.csv, or annotate the picture"
    ))
}

/// Parses `x,y,w,h` of `--box`; `None` if it is not four finite numbers with a positive size.
pub fn parse_box(text: &str) -> Option<FaceBox> {
    let numbers = text.split(',').map(|word| word.trim().parse().ok());
    let numbers: Vec<f32> = numbers.collect::<Option<_>>()?;
    let [x, y, width, height] = numbers[..] else {
        return None;
    };
    let good = numbers.iter().all(|v| v.is_finite()) && width > 0.0 && height > 0.0;
    good.then_some(FaceBox::new(x, y, width, height))
}

/// Parses the lines of a table; a line that begins with `header` is skipped.
fn rows<T, C: FromIterator<T>>(
    path: &Path,
    header: &str,
    expected: &str,
    row: impl Fn(&str) -> Option<T>,
) -> Result<C, Fault> {
    let text = read(path)?;
    let lines = (1..).zip(text.lines());
    lines
        .filter(|(line, text)| {
            let is_header = *line == 1 && text.starts_with(header);
            !is_header && !text.trim().is_empty()
        })
        .map(|(line, text)| row(text).ok_or_else(|| malformed(path, line, expected, text)))
        .collect()
}

/// Reads the faces' boxes by file.
fn read_boxes(path: &Path) -> Result<HashMap<String, FaceBox>, Fault> {
    rows(path, "file", "file,x,y,w,h with a positive size", |line| {
        let (file, face_box) = line.split_once(',')?;
        Some((file.trim().to_owned(), parse_box(face_box)?))
    })
}

/// Reads offsets: CSV `landmark,dx,dy`, face axes, in outer eye distances.
fn read_offsets(path: &Path) -> Result<Differences, Fault> {
    let given: Vec<(usize, [f32; 2])> = rows(path, "landmark", "landmark,dx,dy", |line| {
        let numbers = line.split(',').map(|word| word.trim().parse().ok());
        match numbers.collect::<Option<Vec<f32>>>()?[..] {
            [i, x, y] if (0.0..LANDMARKS as f32).contains(&i) => Some((i as usize, [x, y])),
            _ => None,
        }
    })?;
    let mut offsets = [[0.0; 2]; LANDMARKS];
    for (landmark, offset) in given {
        offsets[landmark] = offset;
    }
    Ok(offsets)
}

/// Formats offsets as a file, see [`FitArgs::offsets`].
pub fn emit_offsets(offsets: &Differences) -> String {
    let mut text = String::from("landmark,dx,dy\n");
    for (i, [x, y]) in offsets.iter().enumerate() {
        let _ = writeln!(text, "{i},{x:.5},{y:.5}");
    }
    text
}

/// A picture with its index in the folder, which seeds the disturbance.
type Numbered<'a> = (usize, &'a Entry);

/// Fits all pictures of a folder and writes the CSV; `say` prints the figures.
///
/// # Errors
/// If something cannot be read, a picture has no box, or the CSV cannot be written.
pub fn fit(args: &FitArgs, say: &mut dyn FnMut(&str)) -> Result<(), Fault> {
    let model = service::model(args.model.as_deref())?;
    let offsets = args.offsets.as_deref().map(read_offsets).transpose()?;
    let boxes = args.boxes.as_deref().map(read_boxes).transpose()?;
    let entries = read_folder(&args.images)?;
    let given = |entry: &Entry| match &boxes {
        Some(boxes) => boxes.get(&entry.file).copied(),
        None => args.face_box,
    };
    // With a table of boxes, other pictures are left out; without, only annotated ones can be fitted.
    let has_box = |(_, e): &Numbered| given(e).is_some() || boxes.is_none() && e.points.is_some();
    let wanted: Vec<Numbered> = entries.iter().enumerate().filter(has_box).collect();
    if wanted.is_empty() {
        return Err(no_box(entries.first().map_or("", |e| &e.file)));
    }
    if wanted.len() < entries.len() {
        say(&format!(
            "{} of {} pictures have no box and are skipped",
            entries.len() - wanted.len(),
            entries.len()
        ));
    }
    let faces = fitted(&model, &wanted, given)?;
    write_out(&args.out, table(&wanted, &faces))?;
    let annotated = wanted.iter().zip(&faces);
    let raw = annotated
        .filter_map(|((_, entry), face)| Some(differences(&face.points, entry.points.as_ref()?)));
    let raw: Vec<Differences> = raw.collect();
    if !raw.is_empty() {
        say(&format!("raw error: {}", summary(&raw)));
    }
    if let Some(offsets) = offsets.filter(|_| !raw.is_empty()) {
        let clean: Vec<_> = raw.iter().map(|d| without(d, &offsets)).collect();
        say(&format!("error with offsets removed: {}", summary(&clean)));
    }
    Ok(())
}

/// Fits each face from its box, or from the disturbed one of its points.
fn fitted(
    model: &FaceModel,
    wanted: &[Numbered],
    given: impl Fn(&Entry) -> Option<FaceBox> + Sync,
) -> Result<Vec<FittedFace>, Fault> {
    let progress = Progress::new("fit", wanted.len());
    wanted
        .par_iter()
        .map_init(
            || StillFitter::new(model),
            |fitter, (k, entry)| {
                let from_points = || Some(disturbed_box(entry.points.as_ref()?, *k as u64 + 1));
                let given = given(entry).map(|face_box| (face_box, 0.0));
                let found = given.or_else(from_points);
                let (face_box, roll) = found.ok_or_else(|| no_box(&entry.file))?;
                let face = fitter.fit_file(&entry.path, &face_box, roll)?;
                progress.step();
                Ok(face)
            },
        )
        .collect()
}

/// The points as CSV.
fn table(wanted: &[Numbered], faces: &[FittedFace]) -> String {
    let mut csv = String::from("file,confidence");
    for i in 0..LANDMARKS {
        let _ = write!(csv, ",x{i},y{i}");
    }
    csv.push('\n');
    for ((_, entry), face) in wanted.iter().zip(faces) {
        let _ = write!(csv, "{},{:.3}", entry.file, face.confidence);
        for [x, y] in face.points {
            let _ = write!(csv, ",{x:.2},{y:.2}");
        }
        csv.push('\n');
    }
    csv
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
}
