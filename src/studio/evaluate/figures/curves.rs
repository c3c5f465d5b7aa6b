//! Figures of numbers over time and over conditions.

use super::error::FiguresError;
use super::subjects::Studio;
use crate::base::capacity::{LANDMARKS, USERS};
use crate::base::geometry::yaw_pitch_roll;
use crate::expression::units::Units;
use crate::pipeline::Pipeline;
use crate::sensor::kinect::frame::KinectFrame;
use crate::simulator::virtual_head::{Held, Light, Look, Scene, Simulator, Truth};
use crate::studio::chart::{Curve, Plot};
use crate::studio::evaluate::acted::Acted;
use crate::studio::frame_time::frame_time;
use crate::studio::inspect::album::Album;

/// Seconds of a session in which ranges are learnt and nothing is judged.
const LEARNS_S: f64 = 4.0;

/// Time of this thread's processor, milliseconds.
fn processor_ms() -> f64 {
    let now = nix::time::clock_gettime(nix::time::ClockId::CLOCK_THREAD_CPUTIME_ID);
    now.map_or(f64::NAN, |now| {
        now.tv_sec() as f64 * 1e3 + now.tv_nsec() as f64 * 1e-6
    })
}

/// Table 1 and Figs. 15 and 16: processor time of each frame while two users swap; for the table also of one and of four.
pub(super) fn time(studio: &Studio<'_>, say: &mut dyn FnMut(&str)) -> Result<(), FiguresError> {
    const FRAMES: usize = 1000;
    const SCENES: [(&str, Scene, usize); 3] = [
        ("one user", Scene::Acted, 300),
        ("four users", Scene::Four, 150),
        ("users who swap", Scene::Swap, FRAMES),
    ];
    let mut plots = Vec::new();
    for (words, scene, frames) in SCENES {
        let asset = studio.heads[0].asset.clone();
        let others = studio.heads.iter().skip(1).map(|head| head.asset.clone());
        let mut simulator = Simulator::new(asset, scene, 15).joined_by(others);
        let mut pipelines = studio.pipelines(&simulator)?;
        let mut times: Vec<Vec<f64>> = vec![Vec::new(); pipelines.len()];
        let mut there = vec![Vec::new(); USERS];
        let mut frame = KinectFrame::default();
        for n in 0..frames {
            simulator.draw(frame_time(n as i64), &mut frame);
            for (times, (_, pipeline)) in times.iter_mut().zip(&mut pipelines) {
                let before = processor_ms();
                pipeline.follow(&frame);
                times.push(processor_ms() - before);
            }
            for (slot, there) in there.iter_mut().enumerate() {
                let followed = |pipeline: &Pipeline| {
                    let reports = pipeline.reports();
                    let mut here = reports.iter().filter(|r| r.user == Some(slot));
                    here.any(|report| report.landmarks.is_some())
                };
                // Of the paper's system; the users one above the other.
                there.push(followed(&pipelines[0].1).then_some(slot as f64));
            }
        }
        for (times, (name, _)) in times.iter().zip(&pipelines) {
            let least = times.iter().copied().fold(f64::INFINITY, f64::min);
            let most = times.iter().copied().fold(0.0, f64::max);
            let mean = times.iter().sum::<f64>() / times.len() as f64;
            say(&format!(
                "{name}, {words}: {least:.1} / {mean:.1} / {most:.1} ms (min / mean / max of {} frames), {:.1} a second",
                times.len(),
                1e3 / mean
            ));
        }
        if scene == Scene::Swap {
            let x: Vec<f64> = (0..frames).map(|n| n as f64).collect();
            let curve = |name: &str, values: Vec<Option<f64>>| Curve {
                name: name.to_owned(),
                values,
            };
            for (times, (name, _)) in times.iter().zip(&pipelines) {
                plots.push(Plot {
                    title: format!("{name}: processor time of a frame, ms"),
                    x: x.clone(),
                    x_name: "frames".into(),
                    curves: vec![curve(name, times.iter().copied().map(Some).collect())],
                    at_least: Some((0.0, 1.0)),
                });
            }
            let users = there.into_iter().enumerate();
            plots.push(Plot {
                title: "users followed by the paper's system".into(),
                x,
                x_name: "frames".into(),
                curves: users
                    .map(|(slot, values)| curve(&format!("user {slot}"), values))
                    .collect(),
                at_least: Some((-0.5, USERS as f64 - 0.5)),
            });
        }
    }
    sheet(
        studio,
        "time",
        "1000 frames with two users who swap",
        plots,
        say,
    )
}

fn sheet(
    studio: &Studio<'_>,
    name: &str,
    title: &str,
    plots: Vec<Plot>,
    say: &mut dyn FnMut(&str),
) -> Result<(), FiguresError> {
    let album = Album {
        title: title.into(),
        plots,
        ..Album::default()
    };
    // Plots are one below the other, with nothing beside them.
    const WIDTH: u32 = 916;
    let sheet = album.sheet();
    let plots = image::imageops::crop_imm(&sheet, 0, 0, WIDTH, sheet.height());
    say(&studio.save(name, &plots.to_image())?);
    Ok(())
}

/// Weights over time against what is acted, of some units.
pub(super) fn weights(studio: &Studio<'_>, say: &mut dyn FnMut(&str)) -> Result<(), FiguresError> {
    const SHOWN: [&str; 6] = ["AU25", "AU26", "AU12L", "AU43L", "AU1L", "AU4L"];
    let asset = studio.heads[0].asset.clone();
    let acted = Acted::new(&asset);
    let mut simulator = Simulator::new(asset, Scene::Acted, 77);
    let mut pipelines = studio.pipelines(&simulator)?;
    let frames = (studio.seconds * 30.0) as usize;
    let mut curves: Vec<Vec<Vec<Option<f64>>>> = vec![vec![Vec::new(); 3]; SHOWN.len()];
    let mut frame = KinectFrame::default();
    for n in 0..frames {
        let truth = simulator.draw(frame_time(n as i64), &mut frame);
        for (unit, curves) in SHOWN.iter().zip(&mut curves) {
            curves[0].push(truth.as_ref().and_then(|truth| acted.of(unit, truth)));
        }
        for (k, (_, pipeline)) in pipelines.iter_mut().enumerate() {
            pipeline.follow(&frame);
            let report = pipeline.report();
            for (unit, curves) in SHOWN.iter().zip(&mut curves) {
                let column = pipeline.unit_names().iter().position(|name| name == unit);
                let weight = column.and_then(|column| report.weights.get(column));
                curves[k + 1].push(weight.map(|&w| f64::from(w).min(2.0)));
            }
        }
    }
    let x: Vec<f64> = (0..frames).map(|n| n as f64 / 30.0).collect();
    let plots = SHOWN.iter().zip(curves).map(|(unit, curves)| {
        let names = ["acted", "paper", "default"];
        Plot {
            title: (*unit).into(),
            x: x.clone(),
            x_name: "s".into(),
            curves: names
                .iter()
                .zip(curves)
                .map(|(name, values)| Curve {
                    name: (*name).into(),
                    values,
                })
                .collect(),
            at_least: Some((0.0, 1.0)),
        }
    });
    sheet(
        studio,
        "weights",
        "weights against what is acted",
        plots.collect(),
        say,
    )
}

/// Errors of the weights by some condition, in bins.
struct Bins {
    title: &'static str,
    x_name: &'static str,
    /// Upper ends; the last takes the rest.
    ends: &'static [f64],
    /// By system and bin: sum and count.
    sums: [Vec<[f64; 2]>; 2],
}

impl Bins {
    fn new(title: &'static str, x_name: &'static str, ends: &'static [f64]) -> Self {
        Self {
            title,
            x_name,
            ends,
            sums: [(); 2].map(|()| vec![[0.0; 2]; ends.len()]),
        }
    }

    fn add(&mut self, system: usize, x: f64, error: f64) {
        let last = self.ends.len() - 1;
        let bin = self.ends.iter().position(|end| x <= *end).unwrap_or(last);
        self.sums[system][bin][0] += error;
        self.sums[system][bin][1] += 1.0;
    }

    fn mean(&self, system: usize, bin: usize) -> Option<f64> {
        let [sum, count] = self.sums[system][bin];
        (count >= 20.0).then(|| sum / count)
    }

    fn plot(&self) -> Plot {
        let curve = |(system, name): (usize, &str)| Curve {
            name: name.into(),
            values: (0..self.ends.len())
                .map(|bin| self.mean(system, bin))
                .collect(),
        };
        Plot {
            title: self.title.into(),
            x: self.ends.to_vec(),
            x_name: self.x_name.into(),
            curves: ["paper", "default"]
                .into_iter()
                .enumerate()
                .map(curve)
                .collect(),
            at_least: Some((0.0, 0.2)),
        }
    }
}

/// Mean absolute error of the weights by light, share of the points covered, yaw and pitch.
pub(super) fn errors(studio: &Studio<'_>, say: &mut dyn FnMut(&str)) -> Result<(), FiguresError> {
    const EXPOSURES: [f32; 5] = [0.15, 0.3, 0.6, 1.0, 1.8];
    let mut bins = [
        Bins::new(
            "weight error by exposure, 1 = as photographed",
            "exposure",
            &[0.15, 0.3, 0.6, 1.0, 1.8],
        ),
        Bins::new(
            "weight error by points covered by a hand, %",
            "%",
            &[0.0, 15.0, 30.0, 45.0, 60.0],
        ),
        Bins::new(
            "weight error by yaw, degrees to either side",
            "deg",
            &[5.0, 10.0, 15.0, 20.0, 25.0, 35.0, 45.0],
        ),
        Bins::new(
            "weight error by pitch, degrees up or down",
            "deg",
            &[5.0, 10.0, 15.0, 20.0, 30.0],
        ),
    ];
    for head in &studio.heads {
        let asset = || head.asset.clone();
        let wide = Simulator::new(asset(), Scene::Wide, 18);
        play(studio, wide, 2.0, |system, _, truth, error| {
            let (yaw, pitch, _) = yaw_pitch_roll(&truth.sensor_from_head.rotation);
            bins[2].add(system, f64::from(yaw.to_degrees().abs()), error);
            bins[3].add(system, f64::from(pitch.to_degrees().abs()), error);
        })?;
        let look = Look {
            held: Held::Mouth,
            ..Look::demonstration()
        };
        let covered = Simulator::new(asset(), Scene::Acted, 14).dressed([look]);
        play(studio, covered, 2.0, |system, seconds, truth, error| {
            bins[1].add(system, 100.0 * covered_share(seconds, truth), error);
        })?;
        for exposure in EXPOSURES {
            let light = Light::default();
            let lit = Simulator::new(asset(), Scene::Acted, 21).lit(light, exposure);
            play(studio, lit, 0.7, |system, _, _, error| {
                bins[0].add(system, f64::from(exposure), error);
            })?;
        }
    }
    for one in &bins {
        for (system, name) in ["paper", "default"].iter().enumerate() {
            let means = one.ends.iter().enumerate().map(|(bin, end)| {
                let mean = one.mean(system, bin);
                mean.map_or_else(|| format!("{end}: -"), |mean| format!("{end}: {mean:.3}"))
            });
            say(&format!(
                "{}, {name}: {}",
                one.title,
                means.collect::<Vec<_>>().join(", ")
            ));
        }
    }
    let plots = bins.iter().map(Bins::plot).collect();
    sheet(
        studio,
        "errors",
        "mean absolute error of the weights",
        plots,
        say,
    )
}

/// Plays a scene for a share of a session; `each` gets the system, the time in seconds, the truth and the frame's error.
fn play(
    studio: &Studio<'_>,
    mut simulator: Simulator,
    share: f64,
    mut each: impl FnMut(usize, f64, &Truth, f64),
) -> Result<(), FiguresError> {
    let acted = Acted::new(simulator.asset());
    let mut pipelines = studio.pipelines(&simulator)?;
    let mut frame = KinectFrame::default();
    // Units that both systems have.
    let units = Units::shipped().columns(true);
    for n in 0..((LEARNS_S + studio.seconds * share) * 30.0) as i64 {
        let Some(truth) = simulator.draw(frame_time(n), &mut frame) else {
            continue;
        };
        for (system, (_, pipeline)) in pipelines.iter_mut().enumerate() {
            pipeline.follow(&frame);
            let report = pipeline.report();
            if n as f64 / 30.0 < LEARNS_S || report.weights.is_empty() {
                continue;
            }
            let mut sum = [0.0; 2];
            for unit in &units {
                let column = pipeline.unit_names().iter().position(|name| name == unit);
                let weight = column.and_then(|column| report.weights.get(column));
                if let (Some(&weight), Some(truth)) = (weight, acted.of(unit, &truth)) {
                    sum[0] += (f64::from(weight) - truth).abs();
                    sum[1] += 1.0;
                }
            }
            each(
                system,
                n as f64 / 30.0,
                &truth,
                sum[0] / f64::max(sum[1], 1.0),
            );
        }
    }
    Ok(())
}

/// Share of the points that the hand over the mouth covers: those within the outline of its palm and fingers.
fn covered_share(seconds: f64, truth: &Truth) -> f64 {
    const HALF_M: [f32; 2] = [0.065, 0.040];
    let Some(place) = Held::Mouth.at(seconds as f32) else {
        return 0.0;
    };
    let inside = truth.landmarks_head.iter().filter(|p| {
        let (x, y) = ((p.x - place.x) / HALF_M[0], (p.y - place.y) / HALF_M[1]);
        x * x + y * y < 1.0
    });
    inside.count() as f64 / LANDMARKS as f64
}
