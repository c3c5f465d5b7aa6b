//! Scenes of one and several heads, hands and rooms through the whole pipeline, against exact truth: one table.
//!
//! Heads are of people the face model has never seen (portrait and head shape), each under the default light; the scenes
//! are those of the simulated sensor ([`Scene`]), with `acted` stretched to 0.5 to 1.2 m. Pose errors are of the reported
//! pose, filter included, with one fixed offset per person out. Ids: the slot a person had first is theirs. Times: each frame
//! goes through three equal pipelines one after the other and the least counts, so that what else the machine does
//! hardly shows. The real Kinect frames (`kinect_v1_pcl`) are played where they are.
//!
//! Everything is seeded. Cost: some minutes; `--people` and `--seconds` shorten it.
//! One file: every scene of the table with its figure; how they are measured has its own.

mod covered;
mod measure;
pub mod wild;

use std::fmt::{self, Display};
use std::path::Path;
use std::time::Instant;

use rayon::prelude::*;

use super::sessions::{Sessions, SessionsError, Spread};
use crate::appliance::settings::Settings;
use crate::base::geometry::{Rigid, Rotation, Vector, rotation_from_yaw_pitch_roll};
use crate::base::time::Timestamp;
use crate::face_model::FaceModel;
use crate::pipeline::{
    FIRST_LOOK, FIRST_LOOK_APART, Pipeline, PipelineError, SECOND_LOOK, SECOND_LOOK_APART, Stage,
};
use crate::pose::PoseTracker;
use crate::segment::Segmenter;
use crate::sensor::camera::Camera;
use crate::sensor::{Frame, colour, timestamp_from_ticks};
use crate::simulator::virtual_head::{HeadAsset, Scene, Simulator};
use crate::studio::heads::{PersonHead, textured_heads};
use crate::studio::people_split::Split;
use crate::users::TrackingState;
use crate::users::likeness::Likeness;
use measure::{Film, Sight, pose_errors};

/// People without `--people`.
pub const PEOPLE: usize = 4;
/// Length of a scene without `--seconds`.
pub const SECONDS: f64 = 10.0;
/// Frames after which a newcomer is compared with those who left, and the distance up to which heads are one.
const LOOKS: [(usize, f32); 2] = [
    (FIRST_LOOK as usize, FIRST_LOOK_APART),
    (SECOND_LOOK as usize, SECOND_LOOK_APART),
];
/// Equal pipelines of which the fastest is timed.
const TIMED: usize = 3;

/// Names of the groups of rows.
pub const ROWS: [&str; 12] = [
    "acted", "wide", "fast", "still", "first", "several", "known", "hand", "mouth", "nobody",
    "pose", "times",
];

/// The table.
#[derive(Clone, Debug)]
pub struct Table {
    rows: Vec<(String, String, String)>,
}

fn at(frame: usize) -> Timestamp {
    timestamp_from_ticks(frame as i64 * 2_000_000)
}

/// Who plays, and before which pipeline.
struct Cast<'a> {
    heads: Vec<PersonHead>,
    model: &'a FaceModel,
    settings: &'a Settings,
    frames: usize,
    seed: u64,
}

impl Cast<'_> {
    fn asset(&self, k: usize) -> HeadAsset {
        self.heads[k % self.heads.len()].asset.clone()
    }

    fn simulator(&self, scene: Scene, k: usize) -> Simulator {
        let others = [1, 2].map(|next| self.asset(k + next));
        Simulator::new(self.asset(k), scene, self.seed ^ (k as u64 + 1) << 8).joined_by(others)
    }

    fn pipeline(&self, simulator: &Simulator) -> Result<Pipeline, PipelineError> {
        Pipeline::new(
            &self.settings.stages(),
            simulator.camera().registration(),
            self.model,
        )
    }

    /// A scene with the cast that begins with person `k`.
    fn film(&self, scene: Scene, k: usize, frames: usize) -> Result<Film, PipelineError> {
        let mut simulator = self.simulator(scene, k);
        let mut pipeline = self.pipeline(&simulator)?;
        let (mut frame, mut film) = (Frame::default(), Film::default());
        for n in 0..frames {
            simulator.draw(at(n), &mut frame);
            pipeline.follow(&frame);
            let truths: Vec<_> = simulator.truths().collect();
            film.add(&truths, &pipeline);
        }
        Ok(film)
    }

    fn films(&self, scene: Scene, frames: usize) -> Result<Vec<Film>, PipelineError> {
        (0..self.heads.len())
            .into_par_iter()
            .map(|k| self.film(scene, k, frames))
            .collect()
    }

    /// `acted`, from 0.5 to 1.2 m.
    fn near_and_far(&self, k: usize) -> Result<Film, PipelineError> {
        let mut simulator = self.simulator(Scene::Acted, k);
        let mut pipeline = self.pipeline(&simulator)?;
        let (mut frame, mut film) = (Frame::default(), Film::default());
        let asset = self.asset(k);
        for n in 0..self.frames {
            let mut weights = vec![0.0f32; asset.expressions.len()];
            let t = (at(n).as_us() as f64 * 1e-6) as f32;
            let instant = Scene::Acted.play(self.seed + k as u64, t, |name, weight| {
                if let Some(slot) = asset.expression(name) {
                    weights[slot] = weights[slot].max(weight);
                }
            });
            let mut pose = instant.expect("somebody acts").sensor_from_head;
            pose.translation.vector.z = 0.85 + (pose.translation.vector.z - 0.8) * 1.75;
            let truth = simulator.draw_pose(&pose, &weights, at(n), &mut frame);
            pipeline.follow(&frame);
            film.add(&[Some(&truth)], &pipeline);
        }
        Ok(film)
    }

    /// Rotation error (degrees) after two frames from each direction, infinite where there is no pose, the offset of the
    /// frontal pose taken out; and the time of each first frame's search, milliseconds.
    fn first_poses(&self, k: usize) -> Result<(Vec<f64>, Vec<f64>), PipelineError> {
        let mut simulator = self.simulator(Scene::Still, k);
        let anchor = self.model.standard_head.oriented();
        let mut tracker = PoseTracker::new(self.settings.pose, &anchor)?;
        let mut segmenter = Segmenter::new(self.settings.segment);
        let mut frame = Frame::default();
        let (mut turns, mut searches, mut frontal) = (Vec::new(), Vec::new(), None);
        for yaw in [-60.0f32, -30.0, 0.0, 30.0, 60.0] {
            for pitch in [-40.0f32, -20.0, 0.0, 20.0, 40.0] {
                let turn = rotation_from_yaw_pitch_roll(yaw.to_radians(), pitch.to_radians(), 0.0);
                let truth = Rigid::from_parts(Vector::new(0.0, -0.02, 0.8).into(), turn);
                segmenter.reset();
                tracker.reset();
                let mut found = None;
                for n in 0..2 {
                    simulator.draw_pose(&truth, &[], at(n), &mut frame);
                    let cloud = segmenter.segment(&frame, simulator.camera());
                    let start = Instant::now();
                    found = cloud.and_then(|cloud| tracker.track(cloud, at(n)));
                    if n == 0 {
                        searches.push(start.elapsed().as_secs_f64() * 1e3);
                    }
                }
                let off = found.map(|found| turn.inverse() * found.sensor_from_head.rotation);
                if yaw == 0.0 && pitch == 0.0 {
                    frontal = off;
                }
                turns.push(off);
            }
        }
        let offset = frontal.unwrap_or_default();
        let error = |off: Option<Rotation>| {
            off.map_or(f64::INFINITY, |off| {
                f64::from(off.angle_to(&offset)).to_degrees()
            })
        };
        Ok((turns.into_iter().map(error).collect(), searches))
    }

    /// Whether a head is known again in another session, and how many others are taken for it.
    fn known_again(&self) -> Result<String, PipelineError> {
        let judge = self.pipeline(&self.simulator(Scene::Acted, 0))?;
        let session = |k: usize, seed: u64, frames: &[usize]| {
            let mut simulator = Simulator::new(self.asset(k), Scene::Acted, seed);
            let mut pipeline = self.pipeline(&simulator)?;
            let (mut frame, mut seen) = (Frame::default(), Vec::new());
            // From the midst of a movement.
            for n in 0..*frames.last().unwrap_or(&0) {
                simulator.draw(at(100 + n), &mut frame);
                pipeline.follow(&frame);
                if frames.contains(&(n + 1)) {
                    seen.push(pipeline.likeness(0));
                }
            }
            Ok(seen)
        };
        let people = self.heads.len();
        let learned: Vec<Likeness> = (0..people)
            .into_par_iter()
            .map(|k| Ok(session(k, self.seed, &[90])?.remove(0)))
            .collect::<Result<_, PipelineError>>()?;
        let looks: Vec<Vec<Likeness>> = (0..people)
            .into_par_iter()
            .map(|k| session(k, self.seed + 99, &LOOKS.map(|(frames, _)| frames)))
            .collect::<Result<_, PipelineError>>()?;
        let text = LOOKS.iter().enumerate().map(|(look, &(frames, most))| {
            let (mut same, mut other) = ([0; 2], [0; 2]);
            for (k, seen) in looks.iter().enumerate() {
                for (n, known) in learned.iter().enumerate() {
                    let apart = judge.apart(&seen[look], known);
                    let count = if n == k { &mut same } else { &mut other };
                    count[0] += usize::from(apart.is_some_and(|apart| apart < most));
                    count[1] += 1;
                }
            }
            format!(
                "after {frames} frames {} of {} known, {} of {} taken for another",
                same[0], same[1], other[0], other[1]
            )
        });
        Ok(text.collect::<Vec<_>>().join("; "))
    }

    /// Milliseconds of each frame, and of the pose in it, the least of several equal pipelines.
    fn times(&self, scene: Scene, frames: usize) -> Result<(Vec<f64>, Vec<f64>), PipelineError> {
        let mut simulator = self.simulator(scene, 0);
        let mut pipelines = (0..TIMED)
            .map(|_| self.pipeline(&simulator))
            .collect::<Result<Vec<_>, _>>()?;
        let (mut whole, mut poses) = (Vec::new(), Vec::new());
        let mut frame = Frame::default();
        for n in 0..frames {
            simulator.draw(at(n), &mut frame);
            let (mut least, mut least_pose) = (f64::INFINITY, f64::INFINITY);
            for pipeline in &mut pipelines {
                let (start, mut pose) = (Instant::now(), 0.0);
                let mut last = start;
                pipeline.follow_by_stage(&frame, |stage| {
                    let now = Instant::now();
                    if stage == Stage::Pose {
                        pose += (now - last).as_secs_f64() * 1e3;
                    }
                    last = now;
                });
                least = least.min(start.elapsed().as_secs_f64() * 1e3);
                least_pose = least_pose.min(pose);
            }
            whole.push(least);
            poses.push(least_pose);
        }
        Ok((whole, poses))
    }

    /// Frames with a face among real ones without.
    fn real_faces(&self, data: &Path) -> Result<Option<[usize; 2]>, PipelineError> {
        let camera = Camera::nominal();
        let mut pipeline =
            Pipeline::new(&self.settings.stages(), camera.registration(), self.model)?;
        let mut frame = Frame::default();
        let (mut faces, mut count) = (0, 0);
        for name in ["five_people", "desk_000", "desk_001"] {
            let open = |kind: &str| {
                image::open(data.join(format!("kinect_v1_pcl/{name}_{kind}.png"))).ok()
            };
            let (Some(depth), Some(rgb)) = (open("depth"), open("rgb")) else {
                return Ok(None);
            };
            for (raw, &z_mm) in frame.depth.iter_mut().zip(depth.into_luma16().iter()) {
                let z = f32::from(z_mm) * 1e-3;
                *raw = if z_mm > 0 {
                    camera.raw_from_m(z).round() as u16
                } else {
                    crate::sensor::NO_DEPTH
                };
            }
            colour::bayer_from_rgb(&rgb.into_rgb8(), &mut frame.bayer);
            colour::luma_from_bayer(&frame.bayer, &mut frame.luma);
            for _ in 0..15 {
                (frame.index, frame.at) = (count as u64, at(count));
                pipeline.follow(&frame);
                count += 1;
                let reports = pipeline.reports();
                faces += usize::from(reports.iter().any(|report| report.landmarks.is_some()));
            }
        }
        Ok(Some([faces, count]))
    }
}

/// Frames from the hand's leaving the face to the face's being followed again, the worst; and the states under it.
fn uncovered(film: &Film) -> (usize, String) {
    let mut worst = 0;
    let mut states = Vec::new();
    for (turn, stays) in [0.3, 0.9, 1.8].into_iter().enumerate() {
        let seconds = |s: f64| ((s + 5.0 * turn as f64) * 30.0).round() as usize;
        // Halfway down the hand is below the chin.
        let (covered, free) = (seconds(2.0), seconds(2.0 + stays + 0.125));
        if free + 60 > film.frames.len() {
            break;
        }
        let state = |n: usize| film.frames[n][0].map_or(TrackingState::Absent, |s| s.state);
        let found = |n: usize| film.frames[n][0].is_some_and(|s| s.found.is_some());
        worst = worst.max((free..free + 60).position(found).unwrap_or(60));
        let mut seen: Vec<&str> = (covered..free)
            .map(|n| match state(n) {
                // A lost face has no pose and so no report here.
                TrackingState::Absent => "lost",
                state => state.name(),
            })
            .collect();
        seen.dedup();
        states.push(seen.join("-"));
    }
    (worst, states.join(", "))
}

/// Plays all scenes and makes the table.
///
/// `only`: the rows that are played, by the names of [`ROWS`]; all if empty.
///
/// # Errors
/// If the data sets cannot be read or the model does not fit the settings.
pub fn play(
    data: &Path,
    model: &FaceModel,
    settings: &Settings,
    sessions: &Sessions,
    only: &[String],
) -> Result<Table, SessionsError> {
    let wanted = |name: &str| only.is_empty() || only.iter().any(|one| one == name);
    let mut heads = textured_heads(data, |person| Split::of(person) == sessions.split)?;
    heads.truncate(sessions.people);
    if heads.is_empty() {
        return Err(SessionsError::Nobody(data.display().to_string()));
    }
    let cast = Cast {
        heads,
        model,
        settings,
        frames: (sessions.seconds * 30.0) as usize,
        seed: sessions.seed,
    };
    let median = |times: &[f64]| {
        let mut sorted = times.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    };
    let mut rows = Vec::new();
    let mut row = |scene: &str, bar: &str, figure: String| {
        say(scene, &figure);
        rows.push((scene.to_owned(), bar.to_owned(), figure));
    };
    let share = |[part, all]: [usize; 2]| 100.0 * part as f64 / all.max(1) as f64;
    let sum = |films: &[Film], count: &dyn Fn(&Film) -> [usize; 2]| {
        films
            .iter()
            .map(count)
            .fold([0; 2], |sum, one| [sum[0] + one[0], sum[1] + one[1]])
    };
    let followed = |films: &[Film]| {
        let [turn, shift] = pose_errors(films);
        let lost = share(sum(films, &Film::missing));
        format!("{turn:.2}°, {shift:.1} mm, lost {lost:.2} % of frames")
    };

    let people = 0..cast.heads.len();
    if wanted("acted") {
        let near: Vec<Film> = people
            .clone()
            .into_par_iter()
            .map(|k| cast.near_and_far(k))
            .collect::<Result<_, _>>()?;
        row(
            "acted, 0.5–1.2 m, yaw ±25°, pitch ±15°",
            "0.7 / 1.5°, 3 / 6 mm",
            followed(&near),
        );
    }
    if wanted("wide") {
        let wide = cast.films(Scene::Wide, cast.frames)?;
        row(
            "yaw ±45°, pitch ±30°",
            "1.5 / 4°, never lost",
            followed(&wide),
        );
    }
    let short = cast.frames.min(300);
    if wanted("fast") {
        let fast = cast.films(Scene::Fast, short)?;
        row("turns at 200°/s", "2 / 5°, lost ≤ 1 %", followed(&fast));
    }
    let mean = |values: &dyn Fn(&Film) -> f64, films: &[Film]| {
        films.iter().map(values).sum::<f64>() / films.len() as f64
    };
    if wanted("still") {
        let still = cast.films(Scene::Still, short)?;
        let [turning, fast] = [Scene::Turning, Scene::Fast].map(|scene| cast.films(scene, short));
        row(
            "still head: jitter; lag in slow and in fast turns",
            "0.05°, 0.3 mm; 1 frame",
            format!(
                "{:.3}°, {:.2} mm; {:.2} and {:.2} frames",
                mean(&|film| film.jitter()[0], &still),
                mean(&|film| film.jitter()[1], &still),
                mean(&Film::lag, &turning?),
                mean(&Film::lag, &fast?)
            ),
        );
    }
    if wanted("first") {
        let (firsts, searches): (Vec<_>, Vec<_>) = people
            .clone()
            .into_par_iter()
            .map(|k| cast.first_poses(k))
            .collect::<Result<Vec<_>, _>>()?
            .into_iter()
            .unzip();
        let (firsts, searches) = (firsts.concat(), searches.concat());
        let within =
            |most: f64| firsts.iter().filter(|&&error| error < most).count() * 100 / firsts.len();
        row(
            "first pose, yaw ±60°, pitch ±40°, after 2 frames",
            "found",
            format!(
                "{} % within 5°, {} % within 15°; a search takes {:.1} ms (median)",
                within(5.0),
                within(15.0),
                median(&searches)
            ),
        );
    }
    if wanted("several") {
        for (name, scene, seconds) in [
            ("two side by side", Scene::Two, 15.0),
            ("two crossing", Scene::Crossing, 20.0),
            ("user swap", Scene::Swap, 40.0),
        ] {
            let films = cast.films(
                scene,
                (30.0 * f64::min(seconds, 2.0 * sessions.seconds)) as usize,
            )?;
            let ids = 100.0 - share(sum(&films, &Film::wrong_ids));
            let lost = share(sum(&films, &Film::missing));
            let arrivals: Vec<usize> = films.iter().flat_map(Film::arrivals).collect();
            let late = arrivals.iter().max().copied().unwrap_or(0);
            let ghosts: usize = films.iter().map(|film| film.ghosts).sum();
            row(
                name,
                "ids 99 %, new user in 10 frames",
                format!(
                    "ids right {ids:.2} %, new user in {late} frames at most, lost {lost:.2} %, {ghosts} frames with a ghost"
                ),
            );
        }
    }
    if wanted("known") {
        row(
            "people who left, known again by the head",
            "right",
            cast.known_again()?,
        );
    }
    if wanted("hand") {
        let hands = cast.films(Scene::Hand, 480)?;
        let worst = hands
            .iter()
            .map(|film| uncovered(film).0)
            .max()
            .unwrap_or(0);
        row(
            "hand before the face",
            "held, lost, back in 5 frames",
            format!("{}; back in {worst} frames at most", uncovered(&hands[0]).1),
        );
    }
    if wanted("mouth") {
        let films: Vec<covered::Errors> = people
            .clone()
            .into_par_iter()
            .map(|k| covered::play(&cast, k))
            .collect::<Result<_, _>>()?;
        row(
            "hand over the mouth for 1 s: error of its units against holding's",
            "half",
            covered::figure(&films),
        );
    }
    if wanted("nobody") {
        let mut ghosts = Vec::new();
        for (name, scene) in [
            ("empty", Scene::Empty),
            ("furnished", Scene::Furnished),
            ("behind", Scene::Behind),
        ] {
            let films: Vec<Film> = cast.films(scene, 90)?;
            let count = films.iter().flat_map(|film| {
                let back = |s: &Option<Sight>| s.is_some_and(|s| s.found.is_some());
                film.frames
                    .iter()
                    .filter(move |frame| frame.iter().any(back))
            });
            let faces = count.count() + films.iter().map(|film| film.ghosts).sum::<usize>();
            ghosts.push(format!("{name} {faces} of {}", 90 * films.len()));
        }
        ghosts.push(match cast.real_faces(data)? {
            Some([faces, count]) => format!("kinect_v1_pcl {faces} of {count}"),
            None => "kinect_v1_pcl is not there".to_owned(),
        });
        row(
            "frames with a face where there is none",
            "0",
            ghosts.join(", "),
        );
    }
    let (one, pose) = if wanted("pose") || wanted("times") {
        cast.times(Scene::Acted, 240)?
    } else {
        (vec![1.0], vec![1.0])
    };
    if wanted("pose") {
        row(
            "pose time, one head",
            "0.4 ms",
            format!(
                "median {:.2} ms, 95th percentile {:.2} ms",
                median(&pose),
                Spread::of(pose.clone()).p95
            ),
        );
    }
    if wanted("times") {
        for (name, scene, heads) in [
            ("two side by side", Scene::Two, 2.0),
            ("crossing", Scene::Crossing, 2.0),
            ("swap", Scene::Swap, 1.0),
        ] {
            let (times, _) = cast.times(scene, 480)?;
            let largest = times[5..].iter().copied().fold(0.0, f64::max);
            row(
                &format!("largest frame time per head over the median of one head, {name}"),
                "2",
                format!(
                    "{:.2} ({largest:.2} ms, median {:.2} ms; one head {:.2} ms)",
                    largest / heads / median(&one),
                    median(&times),
                    median(&one)
                ),
            );
        }
    }
    Ok(Table { rows })
}

/// Long work says where it is.
#[expect(clippy::print_stderr, reason = "progress of a command of minutes")]
fn say(scene: &str, figure: &str) {
    eprintln!("{scene}: {figure}");
}

impl Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "| scene | bar | figure |\n| --- | --- | --- |")?;
        for (scene, bar, figure) in &self.rows {
            writeln!(f, "| {scene} | {bar} | {figure} |")?;
        }
        Ok(())
    }
}
