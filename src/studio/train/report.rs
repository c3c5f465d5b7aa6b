//! The page about a training: errors of people not trained on by region, pose, expression, light and cover, and pictures of
//! the worst and the best fits.
//!
//! Faces are drawn ([`super::render`]) and fitted from starts as near as the tracker's. Per cent of the outer eye distance.
//! Light is told by the face's mean grey; a face counts as covered if something stands before one of its inner points.

use image::RgbImage;

use super::cascade::fit_cold;
use super::evaluate::differences;
use super::render::TrainingSample;
use super::samples::{NEAR, TruePicture, disturbed};
use crate::base::capacity::LANDMARKS;
use crate::base::geometry::yaw_pitch_roll;
use crate::face_model::{FaceModel, scheme};
use crate::landmarks::cascade::Solver;
use crate::studio::evaluate::sessions::Spread;
use crate::studio::inspect::album::Album;
use crate::studio::inspect::canvas;

/// Pictures of each kind.
const SHOWN: usize = 12;
/// Side of a picture, pixels.
const SIDE: u32 = 240;

/// One fitted face.
struct Fitted<'a> {
    sample: &'a TrainingSample,
    strongest: &'a str,
    /// Distance per point, per cent.
    errors: [f64; LANDMARKS],
    confidence: f32,
    picture: RgbImage,
}

impl Fitted<'_> {
    fn error(&self) -> f64 {
        self.errors.iter().sum::<f64>() / LANDMARKS as f64
    }

    fn grey(&self) -> f32 {
        let of = |[x, y]: [f32; 2]| {
            let column = (x.max(0.0) as usize).min(self.sample.width - 1);
            let row = (y.max(0.0) as usize).min(self.sample.height - 1);
            f32::from(self.sample.luma[row * self.sample.width + column])
        };
        self.sample.points.iter().map(|&p| of(p)).sum::<f32>() / LANDMARKS as f32
    }

    fn turned_deg(&self) -> (f32, f32) {
        let (yaw, pitch, _) = yaw_pitch_roll(&self.sample.sensor_from_head.rotation);
        (yaw.to_degrees().abs(), pitch.to_degrees().abs())
    }

    fn is_covered(&self) -> bool {
        self.sample.visible[scheme::INNER].iter().any(|v| !v)
    }
}

fn draw(picture: &TruePicture, fitted: &[[f32; 2]; LANDMARKS]) -> RgbImage {
    let (width, height) = (picture.grey.width as u32, picture.grey.height as u32);
    let (left, top) = (
        width.saturating_sub(SIDE) / 2,
        height.saturating_sub(SIDE) / 2,
    );
    let mut image = RgbImage::from_fn(SIDE.min(width), SIDE.min(height), |x, y| {
        let grey = picture.grey.luma[((y + top) * width + x + left) as usize];
        image::Rgb([grey; 3])
    });
    let place = |[x, y]: [f32; 2]| [x - left as f32, y - top as f32];
    for (truth, found) in picture.points.iter().zip(fitted) {
        let (truth, found) = (place(*truth), place(*found));
        canvas::line(&mut image, truth, found, [255, 255, 0]);
        canvas::dot(&mut image, truth[0], truth[1], [0, 220, 0]);
        canvas::dot(&mut image, found[0], found[1], [255, 40, 40]);
    }
    image
}

fn row(name: &str, faces: &[&Fitted]) -> Option<Vec<String>> {
    if faces.is_empty() {
        return None;
    }
    let spread = Spread::of(faces.iter().map(|f| f.error()).collect());
    let n = faces.len() as f64;
    let mut row = vec![
        name.to_owned(),
        faces.len().to_string(),
        format!("{spread}"),
    ];
    for (_, range) in scheme::REGIONS {
        let count = n * range.len() as f64;
        let sum: f64 = faces.iter().flat_map(|f| &f.errors[range.clone()]).sum();
        row.push(format!("{:.2}", sum / count));
    }
    let confidence = faces.iter().map(|f| f64::from(f.confidence)).sum::<f64>() / n;
    row.push(format!("{confidence:.2}"));
    Some(row)
}

/// The page; `names` are those of the samples' expression weights, `facts` what else is to be told.
#[must_use]
pub fn page(
    model: &FaceModel,
    samples: &[TrainingSample],
    names: &[String],
    facts: Vec<(String, String)>,
    seed: u64,
) -> Album {
    let kept = drawn(model, samples);
    let fitted = fitted(model, &kept, names, seed);
    let mut header: Vec<String> = ["faces", "number", "mean / 95th percentile, %"]
        .map(String::from)
        .to_vec();
    header.extend(scheme::REGIONS.map(|(name, _)| name.to_owned()));
    header.push("mean confidence".into());
    let mut album = Album {
        title: "The face model on held-out people".into(),
        facts,
        table: vec![header],
        ..Album::default()
    };
    add_groups(&fitted, &mut album.table);
    for (which, faces) in [
        ("worst", fitted.iter().rev().take(SHOWN).collect::<Vec<_>>()),
        ("best", fitted.iter().take(SHOWN).collect()),
    ] {
        for face in faces {
            let caption = format!(
                "{which}: {:.2} %, confidence {:.2}, {}; true green, found red",
                face.error(),
                face.confidence,
                face.strongest
            );
            album.pictures.push((caption, face.picture.clone()));
        }
    }
    album
}

/// The samples that can be drawn.
fn drawn<'a>(
    model: &FaceModel,
    samples: &'a [TrainingSample],
) -> Vec<(&'a TrainingSample, TruePicture)> {
    let camera = crate::sensor::kinect::geometry::nominal();
    samples
        .iter()
        .filter_map(|s| Some((s, TruePicture::drawn(s, &camera, &model.shape)?)))
        .collect()
}

/// All faces as the model fits them from a disturbed start, the best first.
fn fitted<'a>(
    model: &FaceModel,
    kept: &[(&'a TrainingSample, TruePicture)],
    names: &'a [String],
    seed: u64,
) -> Vec<Fitted<'a>> {
    let pictures: Vec<TruePicture> = kept.iter().map(|(_, p)| p.clone()).collect();
    let starts = disturbed(&pictures, 1, &[NEAR], false, seed);
    let ends = fit_cold(&starts, &model.shape, &model.cold, &model.warm);
    let mut solver = Solver::default();
    let mut eye = super::samples::Eye::default();
    let mut fitted: Vec<Fitted> = ends
        .iter()
        .map(|end| {
            let start = &starts[end.sample];
            let (sample, picture) = &kept[end.sample];
            let belief = {
                let maps = eye.look(start);
                solver.belief(&model.confidence, &model.shape, maps, &end.fit)
            };
            solver.project(&model.shape, &end.fit);
            let d = differences(&solver.window, &start.points);
            let found = solver.window.map(|p| start.in_picture(p));
            let strongest = (0..names.len().min(sample.weights.len()))
                .max_by(|&a, &b| sample.weights[a].total_cmp(&sample.weights[b]))
                .filter(|&k| sample.weights[k] > 0.15)
                .map_or("neutral", |k| {
                    names[k].trim_end_matches("_L").trim_end_matches("_R")
                });
            Fitted {
                sample,
                strongest,
                errors: d.map(|d| f64::from(100.0 * d[0].hypot(d[1]))),
                confidence: belief.face,
                picture: draw(picture, &found),
            }
        })
        .collect();
    fitted.sort_by(|a, b| a.error().total_cmp(&b.error()));
    fitted
}

/// A row of the table for each way to be turned, lit, covered and moved.
fn add_groups(fitted: &[Fitted], table: &mut Vec<Vec<String>>) {
    let mut group = |name: &str, of: &dyn Fn(&Fitted) -> bool| {
        let members: Vec<&Fitted> = fitted.iter().filter(|f| of(f)).collect();
        table.extend(row(name, &members));
    };
    group("all", &|_| true);
    group("yaw to 10°", &|f| f.turned_deg().0 <= 10.0);
    group("yaw 10 to 25°", &|f| {
        (10.0..=25.0).contains(&f.turned_deg().0)
    });
    group("yaw beyond 25°", &|f| f.turned_deg().0 > 25.0);
    group("pitch to 8°", &|f| f.turned_deg().1 <= 8.0);
    group("pitch 8 to 15°", &|f| {
        (8.0..=15.0).contains(&f.turned_deg().1)
    });
    group("pitch beyond 15°", &|f| f.turned_deg().1 > 15.0);
    group("dark", &|f| f.grey() < 60.0);
    group("medium brightness", &|f| (60.0..=140.0).contains(&f.grey()));
    group("bright", &|f| f.grey() > 140.0);
    group("uncovered", &|f| !f.is_covered());
    group("partly covered", &|f| f.is_covered());
    let mut strongest: Vec<&str> = fitted.iter().map(|f| f.strongest).collect();
    strongest.sort_unstable();
    strongest.dedup();
    for name in strongest {
        group(name, &|f| f.strongest == name);
    }
}
