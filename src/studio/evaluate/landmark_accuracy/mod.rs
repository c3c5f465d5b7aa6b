//! The face model against its bars: one table of landmark errors on people, poses and light it has never seen.
//!
//! ```text
//! drawn    held-out people before the simulated sensor, under every condition
//! stills   photographs and a video
//! tallies  errors, and how far confidence is right
//! ```
//!
//! `drawn`: held-out people (portrait and head shape) acted before the simulated sensor and found by its depth, as in
//! [`super::sessions`], but only as far as the landmarks: tracked, from a cold start, beyond the common angles, with a
//! fifth of the points covered, in a quarter of the light, under a lamp that goes round, still, and from wrong starts.
//! `stills`: photographs and a video. Errors are mean distances over all 68 points / outer-eye distance in the picture;
//! offsets per landmark are measured on the other people. Seeded; the same on any number of threads but for the times.
//! Choose settings with `--split dev`; the test people are for the table.

mod drawn;
mod stills;
mod tallies;

use crate::studio::evaluate::sessions::Trial;
use crate::studio::fault::Fault;
use tallies::Condition::*;
use tallies::{Row, Seen, Share};

/// Measures and makes the table; `say` gets it row by row.
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

/// The rows of drawn people.
fn rows(seen: &Seen) -> Vec<Row> {
    let spreads = [
        (
            "tracked, yaw ±25°, pitch ±15°, all expressions",
            Tracked,
            "1.4 / 2.5",
        ),
        ("… of which one offset per person and point", Offset, ""),
        ("… the rest", Rest, ""),
        ("from a cold start", Cold, "1.8"),
        ("beyond, to yaw ±40°, pitch ±25°", Beyond, "2.5"),
        (
            "a fifth of the points covered: error of the others",
            Covered,
            "3",
        ),
    ];
    let spreads = spreads.map(|(what, of, bar)| (what, seen.spread(of).to_string(), bar));
    [spreads.to_vec(), disturbed(seen), believed(seen)].concat()
}

/// Those of disturbed pictures.
fn disturbed(seen: &Seen) -> Vec<Row> {
    let grown = |condition, than| {
        let [now, then] = [condition, than].map(|of| seen.spread(of).mean);
        format!("{:.0} %", 100.0 * (now / then - 1.0))
    };
    let squares = seen.errors(Jitter).iter().map(|jitter| jitter.powi(2));
    let jitter = (squares.sum::<f64>() / seen.people as f64).sqrt();
    vec![
        (
            "… covered ones flagged (confidence below 0.5), others not",
            two_percents(seen, [Share::Flagged, Share::Unflagged], 0),
            "",
        ),
        (
            "whole face hidden: frames reported lost; visible again: frames until it is tracked, mean, most",
            recovery(seen),
            "5",
        ),
        (
            "a quarter of the light: error grows by",
            grown(Dim, Tracked),
            "15 %",
        ),
        (
            "moving lamp: error grows by",
            grown(Lamp, SameAsLamp),
            "15 %",
        ),
        (
            "jitter of a still face, points 17–67",
            format!("{jitter:.2} %"),
            "0.25 %",
        ),
        (
            "fit time, median",
            format!("{:.2} ms", seen.median(Time)),
            "0.4 ms",
        ),
    ]
}

/// Those of what is said of the fits.
fn believed(seen: &Seen) -> Vec<Row> {
    vec![
        (
            "confidence → share of faces within 5 % (faces)",
            seen.faces.to_string(),
            "within 0.1",
        ),
        (
            "the same of single points, visible and within 5 %",
            seen.points.to_string(),
            "",
        ),
        (
            "lost although within 5 %, kept although beyond 10 %",
            two_percents(seen, [Share::Lost, Share::Kept], 1),
            "",
        ),
    ]
}

/// What comes of a face that was hidden.
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
