//! A recording as pictures: depth in false colour with the head found in it, the colour picture with landmarks and the axes of
//! the head, and the pose, confidence and rates over time. All frames pass the stages; some are drawn.

use image::RgbImage;

use super::album::{Album, Curve, Plot};
use super::learning::Learning;
use super::{InspectError, canvas, face_lines};
use crate::capacity::{HEIGHT, PIXELS, WIDTH};
use crate::face_model::FaceModel;
use crate::geometry::{Point, Rigid, yaw_pitch_roll};
use crate::landmarks::{LandmarkFitter, Landmarks};
use crate::pose::PoseTracker;
use crate::segment::{HeadCloud, Segmenter};
use crate::sensor::camera::Camera;
use crate::sensor::recording::Recording;
use crate::sensor::{Frame, NO_DEPTH, colour};

/// Frames drawn of a recording.
const SHOWN: usize = 6;
/// Depth that is drawn red and blue, metres.
const NEAR_M: f32 = 0.4;
const FAR_M: f32 = 3.0;

/// Depth in false colour: near is red, far is blue, no measurement is black.
fn depth_picture(frame: &Frame, camera: &Camera) -> RgbImage {
    RgbImage::from_fn(WIDTH as u32, HEIGHT as u32, |x, y| {
        let raw = frame.depth[y as usize * WIDTH + x as usize];
        let z = camera.depth_m(raw);
        if raw == NO_DEPTH || z <= 0.0 {
            return image::Rgb([0; 3]);
        }
        // Even in 1/z, as the sensor's steps are.
        let share = (1.0 / z - 1.0 / FAR_M) / (1.0 / NEAR_M - 1.0 / FAR_M);
        image::Rgb(canvas::false_colour(share))
    })
}

fn draw_head(picture: &mut RgbImage, cloud: &HeadCloud, camera: &Camera) {
    for point in &cloud.points {
        let [x, y] = camera.depth_pixel(point);
        canvas::dot(picture, x, y, [255; 3]);
    }
    let r = &cloud.rect;
    let [x0, y0, x1, y1] = [r.x0, r.y0, r.x1, r.y1].map(f32::from);
    canvas::frame(picture, x0, y0, x1 - 1.0, y1 - 1.0, [255; 3]);
}

fn colour_picture(frame: &Frame) -> RgbImage {
    let mut rgb = vec![0; 3 * PIXELS];
    colour::rgb_from_bayer(&frame.bayer, &mut rgb);
    RgbImage::from_raw(WIDTH as u32, HEIGHT as u32, rgb).expect("three bytes a pixel")
}

fn draw_landmarks(picture: &mut RgbImage, landmarks: &Landmarks) {
    for [a, b] in face_lines() {
        canvas::line(
            picture,
            landmarks.pixels[a],
            landmarks.pixels[b],
            [0, 190, 255],
        );
    }
    for ([x, y], &confidence) in landmarks.pixels.iter().zip(&landmarks.point_confidence) {
        let strong = (confidence.clamp(0.0, 1.0) * 255.0) as u8;
        canvas::square(picture, *x, *y, 1, [255 - strong, strong, 0]);
    }
}

/// Red x, green y, blue outwards (−z), 5 cm each.
fn draw_axes(picture: &mut RgbImage, sensor_from_head: &Rigid, camera: &Camera) {
    const LENGTH_M: f32 = 0.05;
    let origin = camera.colour_pixel(&(sensor_from_head * Point::origin()));
    for (tip, colour) in [
        (Point::new(LENGTH_M, 0.0, 0.0), [255, 40, 40]),
        (Point::new(0.0, LENGTH_M, 0.0), [40, 255, 40]),
        (Point::new(0.0, 0.0, -LENGTH_M), [60, 90, 255]),
    ] {
        let tip = camera.colour_pixel(&(sensor_from_head * tip));
        canvas::line(picture, origin, tip, colour);
        canvas::line(
            picture,
            [origin[0] + 1.0, origin[1]],
            [tip[0] + 1.0, tip[1]],
            colour,
        );
    }
}

/// Curves that grow with the recording.
#[derive(Default)]
struct Curves {
    t: Vec<f64>,
    values: [Vec<Option<f64>>; 9],
}

const CURVE_NAMES: [&str; 9] = [
    "x", "y", "z", "yaw", "pitch", "roll", "pose", "face", "residual",
];

impl Curves {
    fn add(&mut self, t: f64, values: [Option<f64>; 9]) {
        self.t.push(t);
        for (curve, value) in self.values.iter_mut().zip(values) {
            curve.push(value);
        }
    }

    fn plot(
        &self,
        title: &str,
        range: std::ops::Range<usize>,
        at_least: Option<(f64, f64)>,
    ) -> Plot {
        let curves = range
            .map(|k| Curve {
                name: CURVE_NAMES[k].into(),
                values: self.values[k].clone(),
            })
            .collect();
        Plot {
            title: title.into(),
            x: self.t.clone(),
            x_name: "s".into(),
            curves,
            at_least,
        }
    }
}

/// Plays the recording through the stages and draws it.
pub(super) fn inspect(
    name: &str,
    mut recording: Recording,
    model: &FaceModel,
) -> Result<Album, InspectError> {
    let camera = Camera::new(recording.registration());
    let mut segmenter = Segmenter::new(crate::segment::Settings::default());
    let mut tracker = PoseTracker::new(
        crate::pose::Settings::default(),
        &model.standard_head.oriented(),
    )
    .map_err(InspectError::Pose)?;
    let mut fitter = LandmarkFitter::new(crate::landmarks::Settings::default(), model);
    let mut album = Album {
        title: format!("Recording {name}"),
        ..Album::default()
    };
    let mut curves = Curves::default();
    let mut learning = Learning::new();
    let mut frame = Frame::default();
    let every = recording.len().div_ceil(SHOWN).max(1) as u64;
    let (mut frames, mut heads, mut faces, mut next) = (0usize, 0usize, 0usize, every / 2);
    while recording.next_frame(&mut frame) {
        let shown = frame.index >= next;
        let mut pictures = shown.then(|| (depth_picture(&frame, &camera), colour_picture(&frame)));
        let mut values = [None; 9];
        let mut face = None;
        let cloud = segmenter.segment(&frame, &camera);
        if let (Some((depth, _)), Some(cloud)) = (&mut pictures, cloud) {
            draw_head(depth, cloud, &camera);
        }
        heads += usize::from(cloud.is_some());
        if let Some(pose) = cloud.and_then(|cloud| tracker.track(cloud, frame.at)) {
            let t = pose.sensor_from_head.translation.vector;
            let (yaw, pitch, roll) = yaw_pitch_roll(&pose.sensor_from_head.rotation);
            let pose_values = [
                t.x,
                t.y,
                t.z,
                yaw.to_degrees(),
                pitch.to_degrees(),
                roll.to_degrees(),
                pose.confidence,
            ];
            for (value, found) in values.iter_mut().zip(pose_values) {
                *value = Some(f64::from(found));
            }
            values[8] = Some(f64::from(pose.residual) * 1e3);
            if let Some(landmarks) = fitter.fit(&frame.luma, &frame.depth, &camera, &pose, frame.at)
            {
                faces += 1;
                values[7] = Some(f64::from(landmarks.confidence));
                if let Some((_, picture)) = &mut pictures {
                    draw_landmarks(picture, landmarks);
                }
                face = Some((landmarks, pose.sensor_from_head));
            }
            if let Some((_, picture)) = &mut pictures {
                draw_axes(picture, &pose.sensor_from_head, &camera);
            }
        }
        frames += 1;
        learning.observe(
            frame.at,
            face.as_ref().map(|(landmarks, pose)| (*landmarks, pose)),
        );
        curves.add(frame.at.as_us() as f64 * 1e-6, values);
        if let Some((depth, picture)) = pictures {
            next += every;
            let caption = format!(
                "frame {}, {:.2} s",
                frame.index,
                frame.at.as_us() as f64 * 1e-6
            );
            album.pictures.push((
                format!("{caption}: depth, {NEAR_M} m red to {FAR_M} m blue; white: the head"),
                depth,
            ));
            album.pictures.push((
                format!("{caption}: colour, landmarks, axes of the head"),
                picture,
            ));
        }
    }
    let duration = match (curves.t.first(), curves.t.last()) {
        (Some(first), Some(last)) => last - first,
        _ => 0.0,
    };
    let share = |n: usize| format!("{n} ({:.1} %)", 100.0 * n as f64 / frames.max(1) as f64);
    album.fact(
        "frames",
        format!(
            "{frames} whole, {} skipped as damaged or missing",
            recording.skipped()
        ),
    );
    album.fact("duration", format!("{duration:.2} s"));
    album.fact("frames with a head", share(heads));
    album.fact("frames with a face", share(faces));
    album.plots.push(curves.plot(
        "Position of the head, metres in the sensor frame",
        0..3,
        None,
    ));
    album
        .plots
        .push(curves.plot("Rotation of the head, degrees", 3..6, Some((-10.0, 10.0))));
    album
        .plots
        .push(curves.plot("Confidence of pose and face", 6..8, Some((0.0, 1.0))));
    album
        .plots
        .push(curves.plot("Residual of the pose, mm", 8..9, Some((0.0, 1.0))));
    if faces > 0 {
        learning.show(&mut album);
    }
    Ok(album)
}
