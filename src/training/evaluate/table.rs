//! Rendered sessions of people the face model has never seen, through the whole pipeline, against exact truth: one table.
//!
//! Each held-out person (portrait and head shape of the test split) acts the scene `acted` under different lighting:
//! all expressions one after the other and mixed, speech, blinks, yaw ±25°, pitch ±15°, 0.6 to 1.0 m. Pose: angle and
//! distance, also less one fixed offset per person, because the head frame's pose on a face is a convention.
//! Landmarks: mean distance in colour pixels / outer-eye distance. Weights: Pearson correlation and mean absolute
//! error against the truth ([`super::acted`]), and the matrix of every acted expression against every emitted weight.
//! All figures are over every frame with a face that is reported `warming` or `tracking`.

use std::fmt::{self, Display};

use super::played::{self, Played, Seen};
use super::sessions::{Spread, Trial, mean, mean_offset, median, pose_errors};
use mien_stages::base::geometry::{Rigid, yaw_pitch_roll};
use mien_stages::expression::measures::Measure;
use mien_stages::expression::units::Units;
use mien_workbench::correlation::correlation;
use mien_workbench::fault::Fault;

/// Number and mean of the person with the worst mean.
type Worst = Option<(usize, f64)>;

/// ` (person 7 2.10°)` after a figure; empty without people.
fn in_parentheses(worst: Worst, precision: usize, unit: &str) -> String {
    worst.map_or_else(String::new, |(person, mean)| {
        format!(" (person {person} {mean:.precision$}{unit})")
    })
}

/// Statistics of all people, and the worst person.
pub struct Figure {
    /// Of all values.
    pub spread: Spread,
    worst: Worst,
}

impl Figure {
    fn from_people(played: &[Played], values: impl Fn(&Played) -> Vec<f64>) -> Self {
        let each: Vec<Vec<f64>> = played.iter().map(values).collect();
        let means = played.iter().zip(&each);
        let means = means.map(|(one, values)| (one.person, mean(values)));
        let known = means.filter(|(_, mean)| !mean.is_nan());
        Self {
            worst: known.max_by(|a, b| a.1.total_cmp(&b.1)),
            spread: Spread::from_values(each.concat()),
        }
    }

    /// The figure with its unit, `of` (the whole of a share) and the worst person.
    fn text(&self, precision: usize, unit: &str, of: &str) -> String {
        let worst = in_parentheses(self.worst, precision, unit);
        format!("{:.precision$}{unit}{of}{worst}", self.spread)
    }
}

/// How a unit's weight follows the truth.
pub struct Following {
    /// Name of the unit.
    pub unit: String,
    /// The measure that drives it.
    pub measure: Measure,
    /// Pearson correlation of the measure with the true one, mean over people.
    pub measured: f64,
    /// Pearson correlation of the weight with the truth, mean over people.
    pub correlation: f64,
    /// Correlation of the worst person.
    pub worst: f64,
    /// Mean absolute error of the weight.
    pub error: f64,
    /// 95th percentile of the weight while nothing is acted.
    pub quiet: f64,
    /// Median weight while it is acted fully.
    pub reach: f64,
    /// Mean weight while only others are acted.
    pub crosstalk: f64,
}

/// The table.
pub struct Table {
    /// People played.
    pub people: usize,
    /// Frames with a person.
    pub frames: usize,
    /// Share of tracked frames.
    pub tracked: f64,
    /// The person with the least share of tracked frames, and that share.
    least_tracked: Worst,
    /// Rotation error, degrees: as it is, and less one offset per person.
    pub rotation_deg: [Figure; 2],
    /// Translation error, millimetres: as it is, and less one offset per person.
    translation_mm: [Figure; 2],
    /// Rotation error less the offset, and error of all points, with the head turned by 20° of yaw or 12° of pitch:
    /// the ends of the paper's range.
    turned: [Spread; 2],
    /// Error of all points, percent of the outer-eye distance.
    pub landmarks: Figure,
    /// Error of points 17–67, percent of the outer-eye distance.
    inner: Figure,
    /// Magnitude of the weights while nothing is acted.
    rest: Spread,
    /// Winks: weight of the shut eye, and of the open one.
    winks: [Spread; 2],
    /// Figures by unit.
    pub following: Vec<Following>,
    /// Mean weights by acted expression, as a table.
    matrix: String,
}

/// True weight up to which a unit is idle.
pub(super) const IDLE: f64 = 0.05;
/// True weight from which a unit is acted.
pub(super) const ACTED: f64 = 0.5;
/// True weight from which an expression is full.
const FULL: f64 = 0.8;
/// True weight from which an eye is shut.
const SHUT: f64 = 0.95;
/// Yaw and pitch from which a head counts as turned, degrees.
const TURNED_DEG: [f32; 2] = [20.0, 12.0];
/// Largest true weight of other expressions while one counts as acted alone.
const ALONE: f32 = 0.3;

/// Plays the sessions and makes the table.
///
/// # Errors
/// If the data sets cannot be read or the model does not fit the settings.
pub fn play(trial: &Trial) -> Result<Table, Fault> {
    let played = trial.each("evaluate", |_, head, numbers| {
        played::play(head, trial, numbers)
    })?;
    Ok(table(&played))
}

/// Every frame with a found face, of everybody.
fn frames_seen(played: &[Played]) -> impl Iterator<Item = &Seen> {
    played.iter().flat_map(|one| &one.seen)
}

/// The figures of all sessions.
fn table(played: &[Played]) -> Table {
    let frames: usize = played.iter().map(|one| one.frames).sum();
    let seen = frames_seen(played).count();
    // Rotation (0) or translation (1), as it is (0) or less the person's offset (1).
    let pose = |axis: usize, out: usize| {
        Figure::from_people(played, |one| {
            let errors = errors_of_pose(one, out == 1);
            errors.iter().map(|error| error[axis]).collect()
        })
    };
    let points = |some: usize| {
        Figure::from_people(played, |one| {
            one.seen.iter().map(|seen| seen.error[some]).collect()
        })
    };
    let of_turned = played.iter().flat_map(|one| {
        let errors = one.seen.iter().zip(errors_of_pose(one, true));
        errors.filter(|(seen, _)| is_turned(seen))
    });
    let of_turned = of_turned.map(|(seen, [turn, _])| (turn, seen.error[0]));
    let (turned_deg, turned_points) = of_turned.unzip();
    let lost = Figure::from_people(played, |one| {
        vec![1.0 - one.seen.len() as f64 / one.frames.max(1) as f64]
    });
    let resting = frames_seen(played).filter(|seen| seen.acted.iter().all(|a| *a < IDLE));
    let rest = resting.flat_map(|seen| seen.weights.clone());
    Table {
        people: played.len(),
        frames,
        tracked: seen as f64 / frames.max(1) as f64,
        least_tracked: lost.worst.map(|(person, lost)| (person, 1.0 - lost)),
        rotation_deg: [0, 1].map(|out| pose(0, out)),
        translation_mm: [0, 1].map(|out| pose(1, out)),
        turned: [turned_deg, turned_points].map(Spread::from_values),
        landmarks: points(0),
        inner: points(1),
        rest: Spread::from_values(rest.collect()),
        winks: winks(played).map(Spread::from_values),
        following: following(played),
        matrix: matrix(played),
    }
}

/// Rotation (degrees) and translation (mm) errors of every frame of a person, with or without their mean removed.
pub(super) fn errors_of_pose(one: &Played, without_offset: bool) -> Vec<[f64; 2]> {
    let pairs = one.seen.iter().map(|seen| (seen.true_pose, seen.pose));
    let pairs: Vec<_> = pairs.collect();
    let offset = match without_offset {
        true => mean_offset(&pairs),
        false => Rigid::identity(),
    };
    pose_errors(&pairs, &offset)
}

/// How each unit's weight follows the truth.
fn following(played: &[Played]) -> Vec<Following> {
    let each = |pair: &dyn Fn(&Seen) -> [f64; 2]| -> Vec<f64> {
        let told = played.iter().filter(|one| one.seen.len() > 2);
        told.map(|one| correlation(one.seen.iter().map(pair)))
            .collect()
    };
    let columns = played.first().map_or(&[][..], |one| &one.columns);
    let all = |value: &dyn Fn(&Seen) -> f64| {
        Spread::from_values(frames_seen(played).map(value).collect())
    };
    let mut following = Vec::new();
    for (m, row) in Units::shipped().rows.iter().enumerate() {
        let measured = mean(&each(&|seen| seen.measures[m]));
        for unit in [&row.rises, &row.falls].into_iter().flatten() {
            let Some(k) = columns.iter().position(|name| name == unit.as_str()) else {
                continue;
            };
            let weights = each(&|seen: &Seen| [seen.weights[k], seen.acted[k]]);
            let where_so = |so: &dyn Fn(&Seen) -> bool| -> Vec<f64> {
                let frames = frames_seen(played).filter(|seen| so(seen));
                frames.map(|seen| seen.weights[k]).collect()
            };
            let most = |seen: &Seen| seen.acted.iter().copied().fold(0.0, f64::max);
            following.push(Following {
                unit: unit.as_str().to_owned(),
                measure: Measure::ALL[m],
                measured,
                correlation: mean(&weights),
                worst: weights.iter().copied().fold(f64::INFINITY, f64::min),
                error: all(&|seen| (seen.weights[k] - seen.acted[k]).abs()).mean,
                quiet: Spread::from_values(where_so(&|seen| most(seen) < IDLE)).p95,
                reach: median(&where_so(&|seen| seen.acted[k] > FULL)),
                crosstalk: mean(&where_so(&|seen| {
                    seen.acted[k] < IDLE && most(seen) > ACTED
                })),
            });
        }
    }
    following
}

/// Weights of the shut and of the open eye during winks.
fn winks(played: &[Played]) -> [Vec<f64>; 2] {
    let columns = played.first().map_or(&[][..], |one| &one.columns);
    let mut winks = [Vec::new(), Vec::new()];
    let lid = |name: &str| columns.iter().position(|column| column == name);
    if let (Some(left), Some(right)) = (lid("AU43L"), lid("AU43R")) {
        for (seen, [shut, open]) in
            frames_seen(played).flat_map(|seen| [(seen, [left, right]), (seen, [right, left])])
        {
            if seen.acted[shut] > SHUT && seen.acted[open] < IDLE {
                winks[0].push(seen.weights[shut]);
                winks[1].push(seen.weights[open]);
            }
        }
    }
    winks
}

/// Whether the head is near an end of the paper's range, ±25° of yaw and ±15° of pitch.
fn is_turned(seen: &Seen) -> bool {
    let (yaw, pitch, _) = yaw_pitch_roll(&seen.true_pose.rotation);
    yaw.abs() > TURNED_DEG[0].to_radians() || pitch.abs() > TURNED_DEG[1].to_radians()
}

/// Mean weights while an expression, both sides together, is fully acted and no other is.
fn matrix(played: &[Played]) -> String {
    let Some(first) = played.first() else {
        return "| acted alone |  |\n| --- |\n".to_owned();
    };
    fn stem(name: &str) -> &str {
        let left = name.strip_suffix("_L");
        left.or(name.strip_suffix("_R")).unwrap_or(name)
    }
    let mut stems: Vec<&str> = first.expressions.iter().map(|name| stem(name)).collect();
    stems.dedup();
    let row = |of: &&str| {
        let mut sum = vec![0.0; first.columns.len()];
        let mut count = 0.0;
        for (one, seen) in played
            .iter()
            .flat_map(|one| one.seen.iter().map(move |s| (one, s)))
        {
            let (mut own, mut other) = (f32::INFINITY, 0.0f32);
            for (name, &weight) in one.expressions.iter().zip(&seen.expressions) {
                if stem(name) == *of {
                    own = own.min(weight);
                } else {
                    other = other.max(weight);
                }
            }
            if f64::from(own) > FULL && other < ALONE {
                count += 1.0;
                for (sum, weight) in sum.iter_mut().zip(&seen.weights) {
                    *sum += weight;
                }
            }
        }
        // Negligible means are left blank.
        let cell = |sum: &f64| match sum / count {
            weight if weight < 0.05 => " |".to_owned(),
            weight => format!(" {weight:.2} |"),
        };
        let cells: String = sum.iter().map(cell).collect();
        (count > 0.0).then(|| format!("| `{of}` |{cells}\n"))
    };
    let columns = &first.columns;
    let rows: String = stems.iter().filter_map(row).collect();
    let (names, line) = (columns.join(" | "), " --- |".repeat(columns.len() + 1));
    format!("| acted alone | {names} |\n|{line}\n{rows}")
}

impl Table {
    /// Name, figure and worst person.
    fn rows(&self) -> [String; 10] {
        let percent = |(person, share)| (person, 100.0 * share);
        let least = self.least_tracked.map(percent);
        let [turn, turn_rest] = self.rotation_deg.each_ref().map(|of| of.text(2, "°", ""));
        let shifts = self.translation_mm.each_ref();
        let [shift, shift_rest] = shifts.map(|of| of.text(1, " mm", ""));
        let [end_turn, end_points] = self.turned;
        let [shut, open] = self.winks;
        let out = "… after removing one offset per person";
        let points = self.landmarks.text(2, " %", " of the outer-eye distance");
        let inner = self.inner.text(2, " %", "");
        let [yaw, pitch] = TURNED_DEG;
        [
            format!(
                "tracked | {:.2} % of frames{}",
                100.0 * self.tracked,
                in_parentheses(least, 2, " %")
            ),
            format!("head rotation | {turn}"),
            format!("{out} | {turn_rest}"),
            format!("head position | {shift}"),
            format!("{out} | {shift_rest}"),
            format!("landmarks, all 68 | {points}"),
            format!("landmarks without the jaw | {inner}"),
            format!(
                "head turned by over {yaw}° or nodding by over {pitch}°: rotation after removing the offset, landmarks | {end_turn:.2}°, {end_points:.2} %"
            ),
            format!("weights while nothing is acted | {:.3}", self.rest),
            format!(
                "winks: weight of the closed eye, of the open one | {:.2}, {open:.2}",
                shut.mean
            ),
        ]
    }

    fn fmt_units(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "\n| unit | correlation of weight and act (worst person) | error of the weight | 95th percentile while nothing is acted | median while fully acted | mean while others are acted | measure | its correlation |\n| --- | --- | --- | --- | --- | --- | --- | --- |"
        )?;
        for one in &self.following {
            writeln!(
                f,
                "| `{}` | {:.3} ({:.3}) | {:.3} | {:.3} | {:.2} | {:.3} | `m_{}` | {:.3} |",
                one.unit,
                one.correlation,
                one.worst,
                one.error,
                one.quiet,
                one.reach,
                one.crosstalk,
                one.measure.name(),
                one.measured
            )?;
        }
        Ok(())
    }
}

impl Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} people never trained on, {} frames; errors are mean / 95th percentile, with the worst person's mean in parentheses\n| what | figure (worst person) |\n| --- | --- |",
            self.people, self.frames
        )?;
        for row in self.rows() {
            writeln!(f, "| {row} |")?;
        }
        self.fmt_units(f)?;
        let all: Vec<f64> = self.following.iter().map(|one| one.correlation).collect();
        let mean = all.iter().sum::<f64>() / all.len().max(1) as f64;
        let (count, matrix) = (all.len(), &self.matrix);
        writeln!(
            f,
            "\nmean correlation of {count} units {mean:.3}\n\n{matrix}"
        )
    }
}
