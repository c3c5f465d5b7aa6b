//! The face model against its bounds: landmark errors on people, poses and light it has never seen.
//!
//! ```text
//! drawn    held-out people before the simulated sensor, under every condition
//! stills   photographs and a video
//! tallies  errors and calibration of confidence
//! ```
//!
//! `drawn`: held-out people (portrait and head shape) acted before the simulated sensor and found by its depth, as in
//! [`super::sessions`], but only as far as the landmarks: tracked, from a cold start, beyond the common angles, with a
//! fifth of the points covered, in a quarter of the light, under a circling lamp, motionless, and from wrong starts.
//! `stills`: photographs and a video. Errors are mean distances over all 68 points / outer-eye distance in the picture;
//! offsets per landmark are measured on the other people. Seeded; the same on any number of threads but for the times.
//! Choose settings with `--split dev`; the test people are for the table.

mod drawn;
mod stills;
mod tallies;

use crate::evaluate::sessions::Trial;
use mien_workbench::fault::Fault;
use tallies::Condition::*;
use tallies::{Row, Seen, Share};

/// Measures the table; `say` receives it row by row.
///
/// # Errors
/// If the data sets cannot be read or the model does not fit the settings.
pub fn measure(trial: &Trial, say: &mut dyn FnMut(&str)) -> Result<(), Fault> {
    let seen = drawn::play(trial)?;
    say(&format!(
        "{} people never trained on; errors are mean / 95th percentile, % of the outer-eye distance",
        seen.people
    ));
    say("| what | figure | bar |\n| --- | --- | --- |");
    let stills = stills::rows(trial)?;
    for (what, figure, bar) in rows(&seen).into_iter().chain(stills) {
        say(&format!("| {what} | {figure} | {bar} |"));
    }
    Ok(())
}

/// The rows of drawn people: each line of `drawn.txt` (what, bar) with its figure, in the same order.
fn rows(seen: &Seen) -> Vec<Row> {
    let spread = |of| seen.spread(of).to_string();
    let grown = |condition, than| {
        let [now, then] = [condition, than].map(|of| seen.spread(of).mean);
        format!("{:.0} %", 100.0 * (now / then - 1.0))
    };
    let squares = seen.errors(Jitter).iter().map(|jitter| jitter.powi(2));
    let jitter = (squares.sum::<f64>() / seen.people as f64).sqrt();
    let figures = [
        spread(Tracked),
        spread(Offset),
        spread(Rest),
        spread(Cold),
        spread(Beyond),
        spread(Covered),
        two_percents(seen, [Share::Flagged, Share::Unflagged], 0),
        recovery(seen),
        grown(Dim, Tracked),
        grown(Lamp, SameAsLamp),
        format!("{jitter:.2} %"),
        format!("{:.2} ms", seen.median(Time)),
        seen.faces.to_string(),
        seen.points.to_string(),
        two_percents(seen, [Share::Lost, Share::Kept], 1),
    ];
    let texts: Vec<&str> = include_str!("drawn.txt").lines().collect();
    assert_eq!(texts.len(), figures.len(), "a line for each figure");
    let rows = texts.into_iter().zip(figures).map(|(line, figure)| {
        let (what, bar) = line.split_once(" | ").unwrap_or((line, ""));
        (what, figure, bar)
    });
    rows.collect()
}

/// Recovery of a hidden face.
fn recovery(seen: &Seen) -> String {
    let waits = seen.errors(Recovered).iter();
    let most = waits.copied().fold(0.0, f64::max);
    let (lost, mean) = (seen.percent(Share::Unseen), seen.spread(Recovered).mean);
    format!("{lost:.0} %; {mean:.1}, {most:.0}")
}

fn two_percents(seen: &Seen, of: [Share; 2], digits: usize) -> String {
    let [a, b] = of.map(|of| seen.percent(of));
    format!("{a:.digits$} %, {b:.digits$} %")
}
