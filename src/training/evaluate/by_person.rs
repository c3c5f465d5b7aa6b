//! Heads of every age, a row each, and faces with one weak side, against exact truth.
//!
//! Each held-out person has the texture of their portrait on a shape of [`Trial::shapes`] and acts the scene `acted` as in
//! [`super::table`]. In a second session the left side moves by a share of the right one only, a different share for each person
//! ([`WEAK`]). What a weak side is worth is read from the difference of both sides: its correlation with the true difference, and
//! the slope of a regression through the origin, over all people.

use std::fmt::Write as _;

use super::played::{self, Played};
use super::sessions::{Spread, Trial, mean};
use super::table::{ACTED, IDLE, errors_of_pose};
use mien_baking::heads::PersonHead;
use mien_workbench::correlation::correlation;
use mien_workbench::fault::Fault;

/// Shares of its strength with which the left side moves, by person in turn.
const WEAK: [f64; 4] = [0.0, 0.25, 0.5, 0.75];
/// True weight that a unit must reach to be judged.
const JUDGED: f64 = 0.3;
/// Frames after which a person's rest is known, and rest is judged.
const LEARNING: usize = 300;

/// Plays both sessions of each person; both tables.
///
/// # Errors
/// If the data sets cannot be read or the model does not fit the settings.
pub fn play(trial: &Trial) -> Result<String, Fault> {
    let name = |place: usize| &trial.shapes[place % trial.shapes.len()].name;
    let whole = trial.each("evaluate", |place, head, numbers| {
        let played = played::play(head, trial, numbers)?;
        eprintln!("{}", row(name(place), &played));
        Ok::<_, Fault>(played)
    })?;
    let weak = trial.each("weak side", |place, head, numbers| {
        let share = WEAK[place % WEAK.len()];
        let mut played = played::play(weakened(head, share as f32), trial, numbers)?;
        let left = |name: &String| name.ends_with('L');
        let left: Vec<bool> = played.columns.iter().map(left).collect();
        for seen in &mut played.seen {
            let sided = seen.acted.iter_mut().zip(&left).filter(|one| *one.1);
            sided.for_each(|(truth, _)| *truth *= share);
        }
        Ok::<_, Fault>(played)
    })?;
    let mut text = String::from(
        "| head | lost | rotation | landmarks | mean r | lowest r | loudest at rest |\n| --- | --- | --- | --- | --- | --- | --- |\n",
    );
    for (place, played) in whole.iter().enumerate() {
        let _ = writeln!(text, "{}", row(name(place), played));
    }
    Ok(text + "\n" + &sides(&weak))
}

/// The head with the expressions of its left side scaled.
fn weakened(mut head: PersonHead, share: f32) -> PersonHead {
    let mut expressions = head.asset.expressions.to_vec();
    for expression in expressions.iter_mut().filter(|e| e.name.ends_with("_L")) {
        expression
            .offsets
            .iter_mut()
            .for_each(|offset| *offset *= share);
    }
    head.asset.expressions = expressions.into();
    head
}

/// The figures of one person.
fn row(name: &str, played: &Played) -> String {
    let seen = &played.seen;
    let errors = errors_of_pose(played, true);
    let turn = Spread::from_values(errors.iter().map(|error| error[0]).collect());
    let points = Spread::from_values(seen.iter().map(|one| one.error[0]).collect());
    let units = played.columns.iter().enumerate();
    let judged = units
        .clone()
        .filter(|&(k, _)| seen.iter().any(|one| one.acted[k] > JUDGED));
    let follows = judged.map(|(k, unit)| {
        let r = correlation(seen.iter().map(|one| [one.weights[k], one.acted[k]]));
        // A weight that never moves follows nothing.
        (unit, if r.is_nan() { 0.0 } else { r })
    });
    let follows: Vec<_> = follows.collect();
    let still: Vec<_> = seen
        .iter()
        .skip(LEARNING)
        .filter(|one| one.acted.iter().all(|a| *a < IDLE))
        .collect();
    let rests = units.map(|(k, unit)| {
        let rest = Spread::from_values(still.iter().map(|one| one.weights[k]).collect());
        (unit, rest.p95)
    });
    let named = |one: Option<(&String, f64)>| {
        one.map_or_else(String::new, |(unit, value)| format!("{unit} {value:.2}"))
    };
    let r = mean(&follows.iter().map(|one| one.1).collect::<Vec<_>>());
    format!(
        "| {name} | {:.2} % | {turn:.2}° | {points:.2} % | {r:.3} | {} | {} |",
        100.0 * (1.0 - seen.len() as f64 / played.frames.max(1) as f64),
        named(follows.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1))),
        named(rests.max_by(|a, b| a.1.total_cmp(&b.1))),
    )
}

/// How the difference of both sides follows the true one, by unit.
fn sides(weak: &[Played]) -> String {
    let columns = weak.first().map_or(&[][..], |one| &one.columns);
    let mut text = String::from("| two-sided unit | r of right − left | slope |");
    for share in WEAK {
        let _ = write!(text, " read of {share} |");
    }
    text += "\n| --- | --- | --- | --- | --- | --- | --- |\n";
    for (left, name) in columns.iter().enumerate() {
        let Some(unit) = name.strip_suffix('L') else {
            continue;
        };
        let right = format!("{unit}R");
        let Some(right) = columns.iter().position(|column| *column == right) else {
            continue;
        };
        let frames = || weak.iter().flat_map(|one| &one.seen);
        if !frames().any(|one| one.acted[right] > JUDGED) {
            continue;
        }
        let pairs = || frames().map(|one| [&one.weights, &one.acted].map(|w| w[right] - w[left]));
        let sum = |of: &dyn Fn([f64; 2]) -> f64| pairs().map(of).sum::<f64>();
        let slope = sum(&|[read, truth]| read * truth) / sum(&|[_, truth]| truth * truth);
        let _ = write!(
            text,
            "| {unit} | {:.2} | {slope:.2} |",
            correlation(pairs())
        );
        for share in 0..WEAK.len() {
            let people = weak.iter().skip(share).step_by(WEAK.len());
            let acted = people
                .flat_map(|one| &one.seen)
                .filter(|one| one.acted[right] > ACTED);
            let [left, right] =
                [left, right].map(|k| acted.clone().map(|one| one.weights[k]).sum::<f64>());
            let _ = write!(text, " {:.2} |", left / right);
        }
        text.push('\n');
    }
    text
}
