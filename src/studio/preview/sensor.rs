//! A source tracked by the pipeline in this process: a recording, a sensor or the simulated one, so that images,
//! landmarks, ranges and readiness can be shown.
//!
//! A recording is processed as fast as possible and every frame is kept; its images are read again on request. A live
//! source is processed in real time.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::Instant;

use super::hub::{Hub, Seen};
use crate::inspect::{DepthColours, colour_picture};
use mien_appliance::pipeline::Pipeline;
use mien_appliance::source::{self, Pacer};
use mien_outputs::gesture::Gestures;
use mien_outputs::received::{Receive as _, Sample};
use mien_outputs::{Command, Report, numbers};
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::sensor::Sensor;
use mien_sensors::turned::upright;
use mien_stages::camera::Camera;
use mien_stages::turn::Turn;
use mien_workbench::picture_files::jpeg;

/// Interval of sending ranges, seconds of the stream.
const RANGES_EVERY_S: f64 = 0.5;
const JPEG_QUALITY: u8 = 80;

fn sample(report: &Report, latency_ms: Option<f32>) -> Sample {
    let present = report.state.is_present();
    let landmarks = report.landmarks.filter(|_| present);
    let points = landmarks.map(|landmarks| landmarks.pixels.to_vec());
    Sample {
        user: report.user,
        number: report.frame,
        seconds: report.at.as_us() as f64 * 1e-6,
        state: report.state,
        confidence: report.confidence,
        latency_ms,
        frozen: report.frozen,
        pose: report.sensor_from_face.filter(|_| present).map(numbers),
        head_box: report.head_box.map(|r| [r.x0, r.y0, r.x1, r.y1]),
        seen: report.seen(),
        weights: report.weights.to_vec(),
        points: points.unwrap_or_default(),
    }
}

/// Tracks a source until it ends.
pub fn follow(
    source: &mut dyn Sensor,
    (pipeline, gestures): (&mut Pipeline, &mut Gestures),
    hub: &Hub,
    commands: &Receiver<Command>,
) {
    let (state, live) = (source.state(), source.state().frames == 0);
    let (mut frame, mut camera) = (KinectFrame::default(), Arc::new(source.camera().clone()));
    let mut pacer = Pacer::default();
    let mut ranges_sent_s = f64::NEG_INFINITY;
    let units = pipeline.unit_names().into_iter().map(str::to_owned);
    hub.schema(&units.collect::<Vec<_>>());
    loop {
        let next = source.next_frame(&mut frame);
        while let Ok(command) = commands.try_recv() {
            pipeline.execute(command);
            gestures.execute(command);
        }
        if !matches!(next, Ok(true)) {
            gestures.release();
            gestures.for_each_switch(|one| hub.gesture(&one.gesture.name, one.user, one.is_on));
        }
        match next {
            Ok(true) => {}
            Ok(false) => return,
            Err(problem) => {
                hub.note(&format!("waiting for the sensor: {problem}"));
                continue;
            }
        }
        if live && !state.is_live {
            pacer.wait(frame.at);
        }
        hub.note("");
        let arrived = source.state().arrived.unwrap_or_else(Instant::now);
        if source.camera() != pipeline.camera() {
            pipeline.set_camera(source.camera());
            camera = Arc::new(source.camera().clone());
        }
        pipeline.follow(&frame);
        if live {
            hub.show((frame.index, seen(&frame, &camera)));
        }
        let latency = live.then(|| arrived.elapsed().as_secs_f32() * 1e3);
        let now = frame.at.as_us() as f64 * 1e-6;
        let mut reports = pipeline.reports();
        gestures.observe(&mut reports);
        // The pictures of a recording are shown later than its frames are tracked.
        if live {
            gestures.for_each_switch(|one| hub.gesture(&one.gesture.name, one.user, one.is_on));
            gestures.for_each_set_up(|one| hub.set_up(one.name, &one.facts));
        }
        for report in &reports {
            hub.sample(&sample(report, latency));
        }
        if now - ranges_sent_s >= RANGES_EVERY_S {
            ranges_sent_s = now;
            reports.iter().for_each(|report| send_ranges(report, hub));
        }
        hub.count(1, 0);
    }
}

fn send_ranges(report: &Report<'_>, hub: &Hub) {
    if let Some(slot) = report.user.filter(|_| !report.ranges.is_empty()) {
        let ranges = report.ranges.iter();
        let ranges = ranges.map(|r| Some(([r.low, r.rest, r.high], Some(r.readiness))));
        hub.ranges(slot, &ranges.collect::<Vec<_>>());
    }
}

fn seen(frame: &KinectFrame, camera: &Arc<Camera>) -> Seen {
    let bayer = || frame.original.bayer.as_slice().into();
    Seen {
        colour: frame.has_colour.then(bayer),
        depth: frame.depth.as_slice().into(),
        camera: camera.clone(),
    }
}

/// A frame as JPEG, and whether it shows depth, in colours fitted to it: as requested if available.
pub fn picture(seen: &Seen, wants_depth: bool) -> Option<(bool, Vec<u8>)> {
    let picture = match seen.colour.as_ref().filter(|_| !wants_depth) {
        Some(bayer) => (false, colour_picture((&**bayer).try_into().ok()?)),
        None => {
            let depth = (&*seen.depth).try_into().ok()?;
            let mut colours = DepthColours::default();
            colours.add(depth, &seen.camera);
            (true, colours.fitted().picture(depth, &seen.camera))
        }
    };
    Some((picture.0, jpeg(&picture.1, JPEG_QUALITY)))
}

/// The image of frame `number` of a recording, as [`picture()`]; `None` if damaged or missing.
pub fn recorded(
    directory: &Path,
    turn: Option<Turn>,
    number: u64,
    wants_depth: bool,
) -> Option<(bool, Vec<u8>)> {
    let mut recording = upright(source::recording(directory).ok()?, turn);
    let mut frame = KinectFrame::default();
    recording.seek(usize::try_from(number).ok()?);
    let found = recording.next_frame(&mut frame).ok()? && frame.index == number;
    let camera = Arc::new(recording.camera().clone());
    found.then(|| picture(&seen(&frame, &camera), wants_depth))?
}
