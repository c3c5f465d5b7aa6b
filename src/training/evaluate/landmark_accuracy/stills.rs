//! Photographs and a video: portraits of held-out people, video stills, one talking face.

use std::collections::BTreeMap;
use std::path::Path;

use rayon::prelude::*;

use super::tallies::Row;
use crate::evaluate::sessions::{Spread, Trial, median};
use crate::train::evaluate::{Differences, differences, mean_offsets, mean_percent, without};
use mien_stages::base::capacity::LANDMARKS;
use mien_stages::face_model::FaceModel;
use mien_workbench::dataset::{Entry, load_grey, read_folder};
use mien_workbench::fault::Fault;
use mien_workbench::people_split::Split;
use mien_workbench::still::{FaceBox, StillFitter, disturbed_box};
use mien_workbench::text_files::listed;

/// About the 68 points of the video's first picture.
const TALKING_BOX: FaceBox = FaceBox::new(128.0, 113.0, 128.0, 140.0);
/// Largest mean displacement of the points between two pictures of the video, percent of the outer-eye distance: more
/// is a jump.
const JUMP_PERCENT: f32 = 15.0;

/// Fitted minus annotated points, by person.
fn fitted(
    model: &FaceModel,
    entries: &[&Entry],
) -> Result<BTreeMap<String, Vec<Differences>>, Fault> {
    let fit = |fitter: &mut StillFitter<'_>, (k, entry): (usize, &&Entry)| {
        let Some(points) = &entry.points else {
            return Ok(None);
        };
        let (face_box, roll) = disturbed_box(points, k as u64 + 1);
        let face = fitter.fit_file(&entry.path, &face_box, roll)?;
        Ok(Some(differences(&face.points, points)))
    };
    let all = entries.par_iter().enumerate();
    let each = all.map_init(|| StillFitter::new(model), fit);
    let each: Vec<Option<Differences>> = each.collect::<Result<_, Fault>>()?;
    let mut by_person: BTreeMap<String, Vec<Differences>> = BTreeMap::new();
    for (entry, d) in entries.iter().zip(each) {
        by_person.entry(entry.person.clone()).or_default().extend(d);
    }
    Ok(by_person)
}

/// Errors, and errors less the mean offsets of the other people.
fn as_given_and_without_offsets(by_person: &BTreeMap<String, Vec<Differences>>) -> [Vec<f64>; 2] {
    let (mut given, mut clean) = (Vec::new(), Vec::new());
    for (person, own) in by_person {
        let others = by_person.iter().filter(|(other, _)| *other != person);
        let mut others: Vec<Differences> = others.flat_map(|(_, d)| d.clone()).collect();
        // Complete failures carry no information on offsets.
        others.retain(|d| mean_percent(d) < 10.0);
        let offsets = mean_offsets(&others);
        for d in own {
            given.push(mean_percent(d).into());
            clean.push(mean_percent(&without(d, &offsets)).into());
        }
    }
    [given, clean]
}

/// The rows of the table, without missing data sets.
pub(super) fn rows(trial: &Trial) -> Result<Vec<Row>, Fault> {
    let (data, model, split) = (trial.data, trial.model, trial.sessions.split);
    let mut rows = Vec::new();
    if let Ok(entries) = read_folder(&data.join("faces_frl189")) {
        let persons: Vec<_> = entries.iter().map(|e| (&*e.set, &*e.person)).collect();
        let splits = entries.iter().zip(Split::from_persons(&persons));
        let wanted = splits.filter(|(_, of)| *of == split);
        let wanted: Vec<&Entry> = wanted.map(|(entry, _)| entry).collect();
        let [given, clean] =
            as_given_and_without_offsets(&fitted(model, &wanted)?).map(Spread::from_values);
        rows.push(("portraits of held-out people", format!("{given}"), "2.8"));
        rows.push(("… offsets per landmark removed", format!("{clean}"), "2.1"));
    }
    if let Ok(entries) = read_folder(&data.join("faces_ytfaces68")) {
        // A quarter suffices for choosing settings; the table uses all.
        let step = if split == Split::Test { 1 } else { 4 };
        let wanted: Vec<&Entry> = entries.iter().step_by(step).collect();
        let [given, clean] = as_given_and_without_offsets(&fitted(model, &wanted)?);
        let failed = given.iter().filter(|e| **e > 10.0).count() as f64 / given.len().max(1) as f64;
        let middle = format!("{:.2}", median(&given));
        rows.push(("video stills, median", middle, "6"));
        rows.push(("… offsets removed", format!("{:.2}", median(&clean)), "4.3"));
        rows.push(("… beyond 10 %", format!("{:.1} %", 100.0 * failed), "5 %"));
    }
    if let Some(row) = talking(&data.join("video_talkingface/img"), model)? {
        rows.push(row);
    }
    Ok(rows)
}

/// Tracks the talking face through its pictures, by colour alone.
fn talking(folder: &Path, model: &FaceModel) -> Result<Option<Row>, Fault> {
    let Ok(paths) = listed(folder) else {
        return Ok(None);
    };
    let mut fitter = StillFitter::new(model);
    let (mut followed, mut last): (usize, Option<([[f32; 2]; LANDMARKS], _)>) = (0, None);
    let mut steps = Vec::new();
    for path in &paths {
        let grey = load_grey(path, 1.0)?;
        let picture = mien_workbench::dataset::picture(&grey);
        let face = match &last {
            None => fitter.fit(&picture, &TALKING_BOX, 0.0),
            Some((_, view)) => fitter.follow(&picture, view),
        };
        let step = last.as_ref().map_or(0.0, |(before, _)| {
            mean_percent(&differences(&face.points, before))
        });
        steps.push(f64::from(step));
        followed += usize::from(face.confidence >= 0.5 && step < JUMP_PERCENT);
        last = Some((face.points, face.view));
    }
    let steps = Spread::from_values(steps);
    let all = paths.len();
    let figure = format!("{followed} of {all}; moves by {steps} % per frame");
    Ok(Some(("talking face: frames tracked", figure, "all 600")))
}
