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

use std::path::Path;

use crate::appliance::settings::Settings;
use crate::face_model::FaceModel;
use crate::studio::evaluate::sessions::{Sessions, SessionsError, Spread};
use tallies::Errors;

/// Measures and makes the table; `say` gets it row by row.
///
/// Long because it is the table: every row with its words, its figure and its bar.
///
/// # Errors
/// If the data sets cannot be read or the model does not fit the settings.
pub fn measure(
    data: &Path,
    model: &FaceModel,
    settings: &Settings,
    sessions: &Sessions,
    say: &mut dyn FnMut(&str),
) -> Result<(), SessionsError> {
    let seen = drawn::play(data, model, settings, sessions)?;
    let percent = |errors: &Errors| Spread::of(errors.clone());
    let mean = |errors: &Errors| percent(errors).mean;
    say(&format!(
        "{} people never trained on; errors are mean / 95th percentile, % of the outer-eye distance",
        seen.people
    ));
    say("| what | figure | bar |\n| --- | --- | --- |");
    let mut row =
        |what: &str, figure: String, bar: &str| say(&format!("| {what} | {figure} | {bar} |"));
    row(
        "tracked, yaw ±25°, pitch ±15°, all expressions",
        format!("{}", percent(&seen.tracked)),
        "1.4 / 2.5",
    );
    row(
        "… of which one offset per person and point",
        format!("{}", percent(&seen.offset)),
        "",
    );
    row("… the rest", format!("{}", percent(&seen.rest)), "");
    row(
        "from a cold start",
        format!("{}", percent(&seen.cold)),
        "1.8",
    );
    row(
        "beyond, to yaw ±40°, pitch ±25°",
        format!("{}", percent(&seen.beyond)),
        "2.5",
    );
    row(
        "a fifth of the points covered: error of the others",
        format!("{}", percent(&seen.covered)),
        "3",
    );
    row(
        "… covered ones flagged (confidence below 0.5), others not",
        format!(
            "{:.0} %, {:.0} %",
            seen.flagged[0].percent(),
            seen.flagged[1].percent()
        ),
        "",
    );
    let most = seen
        .recovered
        .iter()
        .fold(0.0, |most: f64, frames| most.max(*frames));
    row(
        "whole face hidden: frames reported lost; visible again: frames until it is tracked, mean, most",
        format!(
            "{:.0} %; {:.1}, {most:.0}",
            seen.unseen.percent(),
            mean(&seen.recovered)
        ),
        "5",
    );
    let grown = |errors: &Errors, than: &Errors| 100.0 * (mean(errors) / mean(than) - 1.0);
    row(
        "a quarter of the light: error grows by",
        format!("{:.0} %", grown(&seen.dim, &seen.tracked)),
        "15 %",
    );
    row(
        "moving lamp: error grows by",
        format!("{:.0} %", grown(&seen.lamp, &seen.same_as_lamp)),
        "15 %",
    );
    row(
        "jitter of a still face, points 17–67",
        format!("{:.2} %", seen.jitter_percent),
        "0.25 %",
    );
    row(
        "fit time, median",
        format!("{:.2} ms", seen.median_ms),
        "0.4 ms",
    );
    row(
        "confidence → share of faces within 5 % (faces)",
        seen.faces.to_string(),
        "within 0.1",
    );
    row(
        "the same of single points, visible and within 5 %",
        seen.points.to_string(),
        "",
    );
    row(
        "lost although within 5 %, kept although beyond 10 %",
        format!("{:.1} %, {:.1} %", seen.lost.percent(), seen.kept.percent()),
        "",
    );
    for (what, figure, bar) in stills::rows(data, model, sessions.split)? {
        row(what, figure, bar);
    }
    Ok(())
}
