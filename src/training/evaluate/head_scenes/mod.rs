//! Scenes of one and several heads, hands and rooms through the whole pipeline, against exact truth: one table.
//!
//! Heads are of people the face model has never seen (portrait and head shape), each under the default light; the
//! scenes are those of the simulated sensor ([`Scene`]), with `acted` stretched to 0.5 to 1.2 m. Pose errors are of
//! the reported pose, filter included, less one fixed offset per person. Ids: a person's first slot is correct. The
//! real Kinect frames (`kinect_v1_pcl`) are played if present.
//!
//! ```text
//! cast      people, pipeline, and playing of scenes
//! covered   a hand over the mouth
//! measure   figures of a scene
//! wild      people in rooms, with random appearance and disturbances
//! ```
//!
//! Everything is seeded. Cost: some minutes; `--people` and `--seconds` shorten it.

mod cast;
mod covered;
mod measure;
pub mod wild;

use std::fmt::Write as _;

use super::sessions::Trial;
use cast::Cast;
use measure::{SceneRun, Sight, pose_spreads};
use mien_appliance::pipeline::PipelineError;
use mien_simulator::virtual_head::Scene;
use mien_stages::users::TrackingState;
use mien_workbench::fault::Fault;

/// Number of people without `--people`.
pub const PEOPLE: usize = 4;
/// Length of a scene without `--seconds`.
pub const SECONDS: f64 = 10.0;

/// Names of the groups of rows.
pub const ROWS: [&str; 10] = [
    "acted", "wide", "fast", "still", "first", "several", "known", "hand", "mouth", "nobody",
];

/// Name, description and bar of each row; the group of rows `several` has three.
const TEXTS: &str = include_str!("rows.txt");

/// Most frames from the hand's leaving the face to renewed tracking, and the states under the hand.
fn uncovered(run: &SceneRun) -> (usize, String) {
    let mut worst = 0;
    let mut states = Vec::new();
    for (turn, stays) in [0.3, 0.9, 1.8].into_iter().enumerate() {
        let seconds = |s: f64| ((s + 5.0 * turn as f64) * 30.0).round() as usize;
        // Halfway down, the hand is below the chin.
        let (covered, free) = (seconds(2.0), seconds(2.0 + stays + 0.125));
        if free + 60 > run.frames.len() {
            break;
        }
        let state = |n: usize| run.frames[n][0].map_or(TrackingState::Absent, |s| s.state);
        let found = |n: usize| run.frames[n][0].is_some_and(|s| s.found.is_some());
        worst = worst.max((free..free + 60).position(found).unwrap_or(60));
        let mut seen: Vec<&str> = (covered..free)
            .map(|n| match state(n) {
                // A lost face has no pose and no report here.
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
pub fn play(trial: &Trial, only: &[String]) -> Result<String, Fault> {
    let cast = Cast {
        heads: trial.held_out()?,
        trial,
        frames: (trial.sessions.seconds * 30.0) as usize,
    };
    let mut table = "| scene | bar | figure |\n| --- | --- | --- |\n".to_owned();
    for (name, text) in TEXTS.lines().filter_map(|line| line.split_once(" | ")) {
        let group = match name {
            "two" | "crossing" | "swap" => "several",
            _ => name,
        };
        if !(only.is_empty() || only.iter().any(|one| one == group)) {
            continue;
        }
        let figure = match name {
            "acted" => tracked(&cast.each(|k| cast.near_and_far(k))?),
            "wide" => tracked(&cast.runs(Scene::Wide, cast.frames)?),
            "fast" => tracked(&cast.runs(Scene::Fast, cast.short())?),
            "still" => jitter_and_lag(&cast)?,
            "first" => first_poses(&cast)?,
            "two" => two_people(&cast, Scene::Two, 15.0)?,
            "crossing" => two_people(&cast, Scene::Crossing, 20.0)?,
            "swap" => two_people(&cast, Scene::Swap, 40.0)?,
            "known" => cast.known_again()?,
            "hand" => hand_before_the_face(&cast)?,
            "mouth" => covered::figure(&cast.each(|k| covered::play(&cast, k))?),
            _ => nobody(&cast)?,
        };
        let scene = text.split(" | ").next().unwrap_or_default();
        eprintln!("{scene}: {figure}");
        let _ = writeln!(table, "| {text} | {figure} |");
    }
    Ok(table)
}

/// The ratio of two counts over all runs, percent.
fn percent(runs: &[SceneRun], count: impl Fn(&SceneRun) -> [usize; 2]) -> f64 {
    let counts: Vec<[usize; 2]> = runs.iter().map(count).collect();
    let [part, all] = [0, 1].map(|k| counts.iter().map(|one| one[k]).sum::<usize>());
    100.0 * part as f64 / all.max(1) as f64
}

/// The tracking figures of runs.
fn tracked(runs: &[SceneRun]) -> String {
    let [turn, shift] = pose_spreads(runs);
    let lost = percent(runs, SceneRun::missing);
    format!("{turn:.2}°, {shift:.1} mm, lost {lost:.2} % of frames")
}

fn jitter_and_lag(cast: &Cast) -> Result<String, PipelineError> {
    let mean = |values: &dyn Fn(&SceneRun) -> f64, runs: &[SceneRun]| {
        runs.iter().map(values).sum::<f64>() / runs.len() as f64
    };
    let still = cast.runs(Scene::Still, cast.short())?;
    let [turning, fast] = [Scene::Turning, Scene::Fast].map(|scene| cast.runs(scene, cast.short()));
    let [angle, shift] = [0, 1].map(|k| mean(&|run| run.jitter()[k], &still));
    let (slow, fast) = (
        mean(&SceneRun::lag, &turning?),
        mean(&SceneRun::lag, &fast?),
    );
    Ok(format!(
        "{angle:.3}°, {shift:.2} mm; {slow:.2} and {fast:.2} frames"
    ))
}

fn first_poses(cast: &Cast) -> Result<String, PipelineError> {
    let firsts = cast.each(|k| cast.first_poses(k))?.concat();
    let within =
        |most: f64| firsts.iter().filter(|&&error| error < most).count() * 100 / firsts.len();
    let [near, far] = [5.0, 15.0].map(within);
    Ok(format!("{near} % within 5°, {far} % within 15°"))
}

/// Figures of a scene of two people, at most `seconds` long.
fn two_people(cast: &Cast, scene: Scene, seconds: f64) -> Result<String, PipelineError> {
    let frames = 30.0 * f64::min(seconds, 2.0 * cast.trial.sessions.seconds);
    let runs = cast.runs(scene, frames as usize)?;
    let ids = 100.0 - percent(&runs, SceneRun::wrong_ids);
    let lost = percent(&runs, SceneRun::missing);
    let arrivals: Vec<usize> = runs.iter().flat_map(SceneRun::arrivals).collect();
    let late = arrivals.iter().max().copied().unwrap_or(0);
    let ghosts: usize = runs.iter().map(|run| run.ghosts).sum();
    Ok(format!(
        "ids correct in {ids:.2} %, new user within {late} frames, lost {lost:.2} %, {ghosts} frames with a ghost"
    ))
}

fn hand_before_the_face(cast: &Cast) -> Result<String, PipelineError> {
    let hands = cast.runs(Scene::Hand, 480)?;
    let worst = hands.iter().map(|run| uncovered(run).0).max();
    let (worst, states) = (worst.unwrap_or(0), uncovered(&hands[0]).1);
    Ok(format!("{states}; back within {worst} frames"))
}

fn nobody(cast: &Cast) -> Result<String, PipelineError> {
    let mut ghosts = Vec::new();
    for (name, scene) in [
        ("empty", Scene::Empty),
        ("furnished", Scene::Furnished),
        ("behind", Scene::Behind),
    ] {
        let runs: Vec<SceneRun> = cast.runs(scene, 90)?;
        let found = |s: &Option<Sight>| s.is_some_and(|s| s.found.is_some());
        let frames = runs.iter().flat_map(|run| &run.frames);
        let frames = frames.filter(|frame| frame.iter().any(found)).count();
        let faces = frames + runs.iter().map(|run| run.ghosts).sum::<usize>();
        ghosts.push(format!("{name} {faces} of {}", 90 * runs.len()));
    }
    ghosts.push(match cast.real_faces()? {
        Some([faces, count]) => format!("kinect_v1_pcl {faces} of {count}"),
        None => "kinect_v1_pcl is not there".to_owned(),
    });
    Ok(ghosts.join(", "))
}
