//! A recording as images: depth in colours fitted to it, with every found head and its user's state; the colour
//! picture, if recorded, with landmarks and head axes; and pose, confidence, states and weights over time. All frames
//! go through the stages as in a run; some are drawn. Pose and weights are of the user whom single-person outputs
//! show.

use std::ops::Range;
use std::path::Path;

use image::RgbImage;

use super::album::{Album, Shown};
use super::depth_colours::DepthColours;
use super::run::{plot, weight_groups};
use crate::chart::{self, Plot};
use mien_appliance::pipeline::Pipeline;
use mien_appliance::settings::Settings;
use mien_appliance::source;
use mien_sensors::kinect::colour;
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::sensor::Sensor;
use mien_sensors::turned::upright;
use mien_stages::base::capacity::{HEIGHT, PIXELS, USERS, WIDTH};
use mien_stages::base::geometry::{Point, Rigid, yaw_pitch_roll};
use mien_stages::camera::Camera;
use mien_stages::face_model::FaceModel;
use mien_stages::segment::{HeadCloud, PixelRect, Segmenter};
use mien_stages::users::TrackingState;
use mien_workbench::canvas;
use mien_workbench::fault::Fault;
use mien_workbench::picture_files::jpeg;

/// Frames on the sheet.
const ON_SHEET: usize = 6;
/// Most frames in the page: some 17 MB.
const PLAYED: usize = 120;
/// Number of frames from which depth colours are fitted.
const FITTED: usize = 12;
const JPEG_QUALITY: u8 = 72;

fn draw_head(picture: &mut RgbImage, cloud: &HeadCloud, camera: &Camera, colour: [u8; 3]) {
    for point in &cloud.points {
        let [x, y] = camera.depth_pixel(point);
        canvas::dot(picture, x, y, colour);
    }
    let r = &cloud.rect;
    let [x0, y0, x1, y1] = [r.x0, r.y0, r.x1, r.y1].map(f32::from);
    for wider in [0.0, 1.0] {
        let low = [x0 - wider, y0 - wider];
        canvas::frame(picture, low, [x1 + wider - 1.0, y1 + wider - 1.0], colour);
    }
}

/// The colour picture.
pub(crate) fn colour_picture(bayer: &[u8; PIXELS]) -> RgbImage {
    let mut rgb = vec![0; 3 * PIXELS];
    colour::rgb_from_bayer(bayer, &mut rgb);
    RgbImage::from_raw(WIDTH as u32, HEIGHT as u32, rgb).expect("three bytes a pixel")
}

/// Draws axes of 5 cm: red x, green y, blue outwards (−z).
pub(crate) fn draw_axes(
    picture: &mut RgbImage,
    sensor_from_head: &Rigid,
    pixel: impl Fn(&Point) -> [f32; 2],
) {
    const LENGTH_M: f32 = 0.05;
    let origin = pixel(&(sensor_from_head * Point::origin()));
    for (tip, colour) in [
        (Point::new(LENGTH_M, 0.0, 0.0), [255, 40, 40]),
        (Point::new(0.0, LENGTH_M, 0.0), [40, 255, 40]),
        (Point::new(0.0, 0.0, -LENGTH_M), [60, 90, 255]),
    ] {
        let tip = pixel(&(sensor_from_head * tip));
        for aside in [0.0, 1.0] {
            let [from, to] = [origin, tip].map(|[x, y]| [x + aside, y]);
            canvas::line(picture, from, to, colour);
        }
    }
}

const CURVES: [&str; 8] = ["x", "y", "z", "yaw", "pitch", "roll", "confidence", "heads"];
/// Index of the first user's state among the curves.
const STATES: usize = CURVES.len();

/// Index of the first unit's weight among the curves.
const WEIGHTS: usize = STATES + USERS;

/// Values of the curves at a frame.
type Values = Vec<Option<f64>>;

/// The colour a head is drawn in.
fn state_colour(state: TrackingState) -> [u8; 3] {
    match state {
        TrackingState::Absent => [255; 3],
        TrackingState::Warming => [255, 220, 0],
        TrackingState::Tracking => [60, 255, 60],
        TrackingState::Held => [255, 150, 40],
        TrackingState::Lost => [255, 60, 60],
        TrackingState::Posed => [255, 90, 255],
    }
}

/// Text on black, above a head's box or, at the image's edge, inside it.
fn label(picture: &mut RgbImage, rect: &PixelRect, words: &str, colour: [u8; 3]) {
    const SIZE: u32 = 13;
    let high = SIZE + 3;
    let x = u32::from(rect.x0) + 1;
    let y = (u32::from(rect.y0) + 2).saturating_sub(high + 2).max(1);
    let wide = chart::text_width(SIZE, words) + 2;
    let corners = [[x - 1, y - 1], [x + wide, y + high - 2]].map(|corner| corner.map(|c| c as f32));
    canvas::fill(picture, corners[0], corners[1], [0; 3]);
    chart::text(picture, [x, y], SIZE, words, colour);
}

/// Depth with every segmented head and its state.
fn draw_depth(
    frame: &KinectFrame,
    colours: &DepthColours,
    pipeline: &Pipeline,
    heads: &[HeadCloud],
) -> RgbImage {
    let camera = pipeline.camera();
    let mut picture = colours.picture(&frame.depth, camera);
    let reports = pipeline.reports();
    let heads = heads.iter().map(|cloud| {
        let [x, y] = camera.depth_pixel(&cloud.centre);
        let is_in = |rect: PixelRect| {
            let [x0, y0, x1, y1] = [rect.x0, rect.y0, rect.x1, rect.y1].map(f32::from);
            (x0..x1).contains(&x) && (y0..y1).contains(&y)
        };
        let whose = reports.iter().find(|one| one.head_box.is_some_and(is_in));
        let state = whose.map_or(TrackingState::Absent, |one| one.state);
        let words = match whose.and_then(|one| one.user) {
            Some(user) => format!("person {} {}", user + 1, state.name()),
            None => "nobody".to_owned(),
        };
        (cloud, words, state_colour(state))
    });
    let heads: Vec<_> = heads.collect();
    for (cloud, _, colour) in &heads {
        draw_head(&mut picture, cloud, camera, *colour);
    }
    for report in reports.iter().filter(|report| report.state.is_present()) {
        if let Some(pose) = report.sensor_from_face {
            draw_axes(&mut picture, pose, |point| camera.depth_pixel(point));
        }
    }
    // Labels last, so that no other head covers them.
    for (cloud, words, colour) in &heads {
        label(&mut picture, &cloud.rect, words, *colour);
    }
    picture
}

/// Frame counts of a recording.
#[derive(Default)]
struct Counts {
    frames: usize,
    coloured: usize,
    heads: usize,
    posed: usize,
    faces: usize,
    /// For every user, by the code of the state.
    in_state: [usize; TrackingState::ALL.len()],
}

impl Counts {
    fn add(&mut self, frame: &KinectFrame, pipeline: &Pipeline, heads: &[HeadCloud]) {
        let report = pipeline.report();
        let posed = report.sensor_from_face.is_some();
        self.frames += 1;
        self.coloured += usize::from(frame.has_colour);
        self.heads += usize::from(!heads.is_empty());
        self.posed += usize::from(posed);
        self.faces += usize::from(posed && report.landmarks.is_some());
        for report in pipeline.reports() {
            self.in_state[usize::from(report.state.code())] += 1;
        }
    }

    fn add_facts(&self, album: &mut Album, skipped: u64, duration: f64) {
        let share = |n: usize| {
            let percent = 100.0 * n as f64 / self.frames.max(1) as f64;
            format!("{n} ({percent:.1} %)")
        };
        let states = TrackingState::ALL.iter().zip(self.in_state);
        let states = states.filter(|(_, count)| *count > 0);
        let states = states.map(|(state, count)| format!("{} {count}", state.name()));
        let states = states.collect::<Vec<_>>().join(", ");
        let frames = self.frames;
        let frames = format!("{frames} whole, {skipped} skipped as damaged or missing");
        album.fact("frames", frames);
        album.fact("frames with colour", share(self.coloured));
        album.fact("duration", format!("{duration:.2} s"));
        album.fact("frames with a head", share(self.heads));
        album.fact("frames with a pose", share(self.posed));
        album.fact("frames with a face", share(self.faces));
        album.fact("states of people, frames", states);
    }
}

/// Values of the curves at one frame.
fn values(pipeline: &Pipeline, heads: &[HeadCloud]) -> Values {
    let mut values = vec![None; WEIGHTS];
    let report = pipeline.report();
    values.extend(report.weights.iter().map(|&weight| Some(f64::from(weight))));
    values.resize(WEIGHTS + pipeline.unit_names().len(), None);
    if let Some(pose) = report.sensor_from_face {
        let t = pose.translation.vector;
        let (yaw, pitch, roll) = yaw_pitch_roll(&pose.rotation);
        let turn = [yaw, pitch, roll].map(f32::to_degrees);
        let pose_values = t.iter().chain(&turn).chain([&report.confidence]);
        for (value, pose_value) in values.iter_mut().zip(pose_values) {
            *value = Some(f64::from(*pose_value));
        }
    }
    values[STATES - 1] = Some(heads.len() as f64);
    for report in pipeline.reports() {
        if let Some(user) = report.user {
            values[STATES + user] = Some(f64::from(report.state.code()));
        }
    }
    values
}

/// Colour with the landmarks and axes of all users.
fn draw_colour(frame: &KinectFrame, pipeline: &Pipeline) -> RgbImage {
    let mut picture = colour_picture(&frame.original.bayer);
    for report in pipeline.reports() {
        if let Some(landmarks) = report.landmarks {
            canvas::landmarks(&mut picture, &landmarks.pixels, &landmarks.point_confidence);
        }
        if let Some(pose) = report.sensor_from_face {
            let camera = pipeline.camera();
            draw_axes(&mut picture, pose, |point| camera.colour_pixel(point));
        }
    }
    picture
}

/// Fits the depth colours of a recording.
fn fitted(recording: &mut dyn Sensor) -> Result<DepthColours, Fault> {
    let (camera, mut colours) = (recording.camera().clone(), DepthColours::default());
    let mut frame = KinectFrame::default();
    let frames = recording.state().frames;
    for number in (0..frames).step_by(frames.div_ceil(FITTED).max(1)) {
        recording.seek(number);
        if recording.next_frame(&mut frame)? {
            colours.add(&frame.depth, &camera);
        }
    }
    Ok(colours.fitted())
}

/// The album of a recording, and the frames selected for it.
struct Drawn {
    album: Album,
    colours: DepthColours,
    /// For the page and for the sheet: period, and next frame.
    page: (usize, usize),
    sheet: (usize, usize),
}

impl Drawn {
    fn new(name: &str, colours: DepthColours, frames: usize) -> Self {
        let every = |most: usize| frames.div_ceil(most).max(1);
        let mut album = Album::new(format!("Recording {name}"));
        album.depth_key = Some(colours.key_m());
        Self {
            album,
            colours,
            page: (every(PLAYED), 0),
            sheet: (every(ON_SHEET), every(ON_SHEET) / 2),
        }
    }

    /// Adds the `k`th undamaged frame if it is selected.
    fn add(&mut self, k: usize, frame: &KinectFrame, pipeline: &Pipeline, heads: &[HeadCloud]) {
        let is_next = |(every, next): &mut (usize, usize)| {
            let is_next = k >= *next;
            *next += if is_next { *every } else { 0 };
            is_next
        };
        let (page, sheet) = (is_next(&mut self.page), is_next(&mut self.sheet));
        if !page && !sheet {
            return;
        }
        let seconds = frame.at.as_us() as f64 * 1e-6;
        let depth = draw_depth(frame, &self.colours, pipeline, heads);
        let colour = frame.has_colour.then(|| draw_colour(frame, pipeline));
        if page {
            self.album.frames.push(Shown {
                seconds,
                number: frame.index,
                colour: colour.as_ref().map(|picture| jpeg(picture, JPEG_QUALITY)),
                depth: jpeg(&depth, JPEG_QUALITY),
            });
        }
        if sheet {
            let at = format!("frame {}, {seconds:.2} s", frame.index);
            let [far, .., near] = self.colours.key_m();
            let none = if frame.has_colour { "" } else { ", no colour" };
            let caption = format!("{at}: depth, {near:.1} m light to {far:.1} m dark{none}");
            let pictures = &mut self.album.pictures;
            // Without depth there is nothing to see.
            if pipeline.camera().measures(&*frame.depth) || !frame.has_colour {
                pictures.push((caption, depth));
            }
            let caption = format!("{at}: colour, landmarks, axes of the head");
            pictures.extend(colour.map(|colour| (caption, colour)));
        }
    }
}

/// Plays the recording through the stages and fills the album.
pub(super) fn inspect(
    name: &str,
    path: &Path,
    model: &FaceModel,
    settings: &Settings,
) -> Result<Album, Fault> {
    let open = || Ok::<_, Fault>(upright(source::recording(path)?, settings.sensor.turned));
    let mut recording = open()?;
    let mut pipeline = Pipeline::new(&settings.stages, recording.camera(), model)?;
    // Separate, as the pipeline skips frames.
    let mut segmenter = Segmenter::new(settings.stages.segment);
    let colours = fitted(&mut *open()?)?;
    let mut drawn = Drawn::new(name, colours, recording.state().frames);
    let mut all: Vec<(f64, Values)> = Vec::new();
    let mut frame = KinectFrame::default();
    let mut counts = Counts::default();
    while recording.next_frame(&mut frame)? {
        pipeline.follow(&frame);
        segmenter.segment(&frame, pipeline.camera());
        let heads = segmenter.heads();
        drawn.add(counts.frames, &frame, &pipeline, heads);
        counts.add(&frame, &pipeline, heads);
        let seconds = frame.at.as_us() as f64 * 1e-6;
        all.push((seconds, values(&pipeline, heads)));
    }
    let mut album = drawn.album;
    let ends = all.first().zip(all.last());
    let duration = ends.map_or(0.0, |(first, last)| last.0 - first.0);
    counts.add_facts(&mut album, recording.state().skipped, duration);
    let played = format!("{} of {}", album.frames.len(), counts.frames);
    album.fact("frames in this page", played);
    album.plots = plots(&all, &pipeline.unit_names());
    Ok(album)
}

/// Plots of the curves that have any value.
fn plots(all: &[(f64, Values)], units: &[&str]) -> Vec<Plot> {
    let mut names = CURVES.map(str::to_owned).to_vec();
    names.extend((1..=USERS).map(|user| format!("person {user}")));
    names.extend(units.iter().map(|unit| format!("w_{unit}")));
    let mut groups = weight_groups(&names);
    groups.extend(PLOTS.map(|(title, curves, least)| (title.to_owned(), curves.collect(), least)));
    let is_known = |k: usize| all.iter().any(|(_, values)| values[k].is_some());
    for (_, curves, _) in &mut groups {
        curves.retain(|&k| is_known(k));
    }
    groups.retain(|(_, curves, _)| !curves.is_empty());
    let places = all.iter().map(|(seconds, values)| (*seconds, &values[..]));
    let places: Vec<_> = places.collect();
    let groups = groups.into_iter();
    groups.map(|group| plot(&names, &places, group)).collect()
}

/// Title, curves and least span of a plot.
type PlotSpec = (&'static str, Range<usize>, Option<(f64, f64)>);

const POSITION: &str = "Position of the head, metres in the sensor frame";
const CONFIDENCE: &str = "Confidence of the face, or of the pose without one";
const PLOTS: [PlotSpec; 5] = [
    (POSITION, 0..3, None),
    ("Rotation of the head, degrees", 3..6, Some((-10.0, 10.0))),
    (CONFIDENCE, 6..7, Some((0.0, 1.0))),
    ("Heads found in depth", 7..8, Some((0.0, 2.0))),
    (
        "State of each person: 1 warming, 2 tracking, 3 held, 4 lost, 5 posed",
        STATES..STATES + USERS,
        Some((0.0, 5.0)),
    ),
];
