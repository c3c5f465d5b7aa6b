//! People with hair, clothes and accessories, in rooms, before a sensor with a real one's faults; one row each.
//!
//! Each held-out person (portrait and head shape of the test split) wears [`Appearance::numbered`] of their index and
//! acts the scene `acted` before a sensor of their own ([`random_sensor`]: depth faults in full, a Kinect's or a stereo camera's, colour some
//! milliseconds late and a few pixels off, lens distortion, another white balance, a sensor above or below), some in
//! dim light or in front of a bright window. Lost is a frame without a live pose, `held` included, after the ten
//! frames of an arrival. Rotation and position are less one fixed offset per person. Landmarks are at their positions
//! in the late, distorted colour image.

use std::fmt::{self, Display, Write as _};
use std::path::Path;

use super::measure::{SceneRun, pose_spreads};
use crate::evaluate::sessions::{Spread, Trial, landmark_error, lighting, person_seed};
use crate::frame_time::frame_time;
use mien_appliance::pipeline::PipelineError;
use mien_baking::heads::PersonHead;
use mien_sensors::Frame;
use mien_sensors::kinect::frame::KinectFrame;
use mien_sensors::kinect::recording::Recorder;
use mien_simulator::simulated::Simulated;
use mien_simulator::virtual_head::{Appearance, Light, Scene, Sensor, Simulator};
use mien_stages::base::capacity::LANDMARKS;
use mien_workbench::atomic_write::write_out;
use mien_workbench::fault::Fault;

/// Length of a session without `--seconds`.
pub const SECONDS: f64 = 20.0;
/// Label of people in front of a window.
const BACKLIT: &str = "backlit";

/// One person's figures.
pub struct Row {
    /// Appearance and viewing conditions.
    pub who: String,
    /// Frames without a live pose, percent.
    pub lost: f64,
    /// Changes into or out of `held` per ten seconds.
    pub flips: f64,
    /// Rotation, degrees.
    pub rotation_deg: Spread,
    /// Position, millimetres.
    pub position_mm: Spread,
    /// All 68 points, percent of the outer-eye distance.
    pub landmarks: Spread,
}

/// A random sensor and light for a person: sensor, light, exposure, label. `stereo`: its depth has a stereo camera's noise.
fn random_sensor(
    number: usize,
    stereo: bool,
    random: &mut fastrand::Rng,
) -> (Sensor, Light, f32, &'static str) {
    let (mut light, exposure) = lighting(random);
    // The range of the sensor's automatic exposure.
    let mut exposure = 0.4 + 0.6 * exposure;
    let mut spread = |range: f32| (random.f32() * 2.0 - 1.0) * range;
    let (warm, tint) = (spread(0.16), spread(0.05));
    let mut sensor = Sensor {
        faults: 1.0,
        stereo,
        // Differences of a real sensor's time stamps: 7.7 to 13.5 ms.
        colour_late_s: 0.0106 + spread(0.003),
        colour_shift_px: [spread(2.1), spread(2.1)],
        distortion: [0.06 + spread(0.06), -0.10 + spread(0.05)],
        balance: [1.0 + warm, 1.0 + tint, 1.0 - warm],
        colour_sigma: 2.5,
        above: spread(20.0).to_radians(),
        turned: 0.0,
    };
    let mut said = "";
    match number % 8 {
        3 => {
            said = "dim";
            exposure *= 0.45;
            sensor.colour_sigma = 7.0;
        }
        6 => {
            said = BACKLIT;
            light.towards.z = 0.75;
            light.towards.y = -0.4;
            light.towards = light.towards.normalize();
            light.ambient = 0.5;
            exposure *= 0.75;
            sensor.colour_sigma = 4.5;
        }
        _ => {}
    }
    (sensor, light, exposure, said)
}

/// The simulator of one person, and a description.
fn simulator(head: PersonHead, number: usize, stereo: bool, seed: u64) -> (Simulator, String) {
    let seed = person_seed(seed, head.person);
    let look = Appearance::numbered(number, seed);
    let (sensor, light, exposure, said) =
        random_sensor(number, stereo, &mut fastrand::Rng::with_seed(seed));
    let mut who = look.to_string();
    if !said.is_empty() {
        who = format!("{who}, {said}");
    }
    who = format!("{who}, sensor {:+.0}°", sensor.above.to_degrees());
    // Before a bright window the room has its own light.
    let mut window = light;
    if said == BACKLIT {
        window.ambient = 1.0;
        window.tint = [1.8, 1.85, 1.95];
    }
    let simulator = Simulator::new(head.asset, Scene::Acted, seed)
        .with_sensor(sensor)
        .with_light(window, exposure)
        .dressed([look])
        .with_light(light, exposure);
    (simulator, who)
}

fn play_one(
    trial: &Trial,
    number: usize,
    stereo: bool,
    head: PersonHead,
    frames: &mut dyn Iterator<Item = usize>,
) -> Result<Row, PipelineError> {
    let (mut simulator, who) = simulator(head, number, stereo, trial.sessions.seed);
    let mut pipeline = trial.pipeline(simulator.camera())?;
    let (mut frame, mut run) = (Frame::default(), SceneRun::default());
    let mut landmarks = Vec::new();
    for n in frames {
        let Some(truth) = simulator.draw(frame_time(n), &mut frame) else {
            continue;
        };
        pipeline.follow(&frame);
        run.add(&[Some(&truth)], &pipeline);
        let slot = run.frames.last().and_then(|frame| frame[0]?.slot);
        for report in &pipeline.reports() {
            if let (Some(found), true) = (report.landmarks, report.user == slot && slot.is_some()) {
                landmarks.push(landmark_error(&found.pixels, &truth)[0]);
            }
        }
    }
    let [missing, all] = run.missing();
    let flips = run.flips();
    let [rotation_deg, position_mm] = pose_spreads(&[run]);
    let row = Row {
        who,
        lost: 100.0 * missing as f64 / all.max(1) as f64,
        flips,
        rotation_deg,
        position_mm,
        landmarks: Spread::from_values(landmarks),
    };
    eprintln!("{number}: {row}");
    Ok(row)
}

/// Records one person's session into a folder, with `truth.csv`: the 68 points in colour pixels, and the acted
/// weights.
fn record_one(
    out: &Path,
    simulator: Simulator,
    frames: &mut dyn Iterator<Item = usize>,
) -> Result<(), Fault> {
    let mut sensor = Simulated::from(simulator);
    let mut recorder = Recorder::create(out, sensor.registration(), 0.0)?;
    let mut truths = String::from("frame");
    for i in 0..LANDMARKS {
        let _ = write!(truths, ",u{i},v{i}");
    }
    for expression in sensor.simulator().asset().expressions.iter() {
        let _ = write!(truths, ",{}", expression.name);
    }
    let mut frame = KinectFrame::default();
    for n in frames {
        sensor.next_frame(&mut frame);
        recorder.write(&frame)?;
        if let Some(truth) = sensor.truth() {
            let _ = write!(truths, "\n{n}");
            for [u, v] in truth.landmarks_px {
                let _ = write!(truths, ",{u:.2},{v:.2}");
            }
            for weight in &truth.activations {
                let _ = write!(truths, ",{weight:.3}");
            }
        }
    }
    write_out(&out.join("truth.csv"), truths + "\n")
}

/// Records each person's session into a folder named by number, for other programs.
///
/// # Errors
/// If the data sets cannot be read or a folder holds a recording or cannot be written.
pub fn record(trial: &Trial, stereo: bool, out: &Path) -> Result<(), Fault> {
    let done = trial.each("record", |number, head, frames| {
        let (simulator, _) = simulator(head, number, stereo, trial.sessions.seed);
        record_one(&out.join(number.to_string()), simulator, frames)
    });
    done.map(drop)
}

/// Plays the sessions and makes the table.
///
/// # Errors
/// If the data sets cannot be read or the model does not fit the settings.
pub fn play(trial: &Trial, stereo: bool) -> Result<String, Fault> {
    let play = |number, head, frames: &mut dyn Iterator<Item = usize>| {
        play_one(trial, number, stereo, head, frames)
    };
    Ok(table(&trial.each("evaluate", play)?))
}

impl Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} | {:.2} | {:.1} | {:.2}° | {:.1} mm | {:.2} %",
            self.who, self.lost, self.flips, self.rotation_deg, self.position_mm, self.landmarks
        )
    }
}

fn table(rows: &[Row]) -> String {
    let mut table = format!(
        "{} people never trained on; errors are mean / 95th percentile, after removing one offset per person\n\
         | person | wears, conditions | lost, % | into or out of held, per 10 s | rotation | position | landmarks |\n\
         | --- | --- | --- | --- | --- | --- | --- |\n",
        rows.len()
    );
    for (number, row) in rows.iter().enumerate() {
        table += &format!("| {number} | {row} |\n");
    }
    table += "\n| what | mean of people | worst person |\n| --- | --- | --- |\n";
    type Figure<'a> = (&'a str, &'a str, usize, &'a dyn Fn(&Row) -> f64);
    let figures: [Figure; 5] = [
        ("lost", " %", 2, &|row| row.lost),
        ("into or out of held, per 10 s", "", 1, &|row| row.flips),
        ("rotation", "°", 2, &|row| row.rotation_deg.mean),
        ("position", " mm", 1, &|row| row.position_mm.mean),
        ("landmarks", " %", 2, &|row| row.landmarks.mean),
    ];
    for (what, unit, digits, value) in figures {
        let mut known: Vec<f64> = rows.iter().map(value).collect();
        // A person who is never found ranks worst.
        let rank = |v: f64| if v.is_finite() { v } else { f64::INFINITY };
        let all = known.iter().copied().enumerate();
        let worst = all.max_by(|a, b| rank(a.1).total_cmp(&rank(b.1)));
        let (number, most) = worst.unwrap_or((0, f64::NAN));
        known.retain(|v| v.is_finite());
        let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
        table += &format!(
            "| {what} | {mean:.digits$}{unit} | {most:.digits$}{unit} (person {number}) |\n"
        );
    }
    table
}
