//! Learned ranges of people, from the file of remembered people ([`crate::users::saved`]) or the `status.json` of a running
//! `mien`, as a picture of each range next to the population's, and as a table.
//!
//! Units: inner-eye-corner distances. A picture has one row per measure: the population's range in grey, the person's in blue, a
//! mark at each rest; each row has its own scale. A unit of the status has the row of its measure.

use std::time::SystemTime;

use image::{Rgb, RgbImage};
use serde_json::Value;

use super::album::Album;
use super::canvas;
use crate::expression::units::{Prior, Units};
use crate::expression::{Measure, Range};
use crate::studio::chart;
use crate::studio::fault::Fault;
use crate::users::saved;

/// Picture of ranges: a row's height, left margin for names, width of the scale, pixels.
const ROW: u32 = 22;
const LEFT: u32 = 160;
const WIDE: u32 = 620;
const POPULATION: [u8; 3] = [200, 200, 200];
const PERSON: [u8; 3] = [40, 110, 200];

/// Low, rest, high.
type Bounds = [f64; 3];

/// What is shown of a measure or unit.
struct Row {
    name: String,
    population: Option<Bounds>,
    person: Bounds,
    /// Cells that end its row of the table.
    more: Vec<String>,
}

fn prior(prior: &Prior) -> Bounds {
    [prior.rest - prior.down, prior.rest, prior.rest + prior.up]
}

/// What the shipped table has of the measure behind a unit.
fn population(unit: &str) -> Option<Bounds> {
    let units = Units::shipped();
    let row = units.rows.iter().find(|row| {
        let mut names = row.rises.iter().chain(&row.falls);
        names.any(|name| name == unit)
    })?;
    Some(prior(&row.prior))
}

fn picture(rows: &[Row]) -> RgbImage {
    let height = ROW * rows.len() as u32 + 8;
    let mut picture = RgbImage::from_pixel(LEFT + WIDE + 16, height, Rgb([255; 3]));
    for (k, row) in (0..).zip(rows) {
        let top = 6 + ROW * k;
        chart::text(&mut picture, [6, top], 13, &row.name, [60; 3]);
        let all = row.person.iter().chain(row.population.iter().flatten());
        let (low, high) = chart::span(all.copied());
        let x = |v: f64| (f64::from(LEFT) + (v - low) / (high - low) * f64::from(WIDE)) as f32;
        let mut bar = |[low, rest, high]: Bounds, from: u32, to: u32, colour| {
            let [from, to] = [top + from, top + to].map(|y| y as f32);
            canvas::fill(&mut picture, [x(low), from], [x(high), to], colour);
            let mark = [[x(rest), from - 2.0], [x(rest) + 1.0, to + 2.0]];
            canvas::fill(&mut picture, mark[0], mark[1], [20; 3]);
        };
        if let Some(population) = row.population {
            bar(population, 2, 6, POPULATION);
        }
        bar(row.person, 9, 14, PERSON);
    }
    picture
}

/// Adds the picture and the rows of somebody.
fn show(album: &mut Album, who: &str, rows: &[Row]) {
    let caption = format!("{who}: population's range grey, this person's blue; marks show rest");
    album.pictures.push((caption, picture(rows)));
    album.table.extend(rows.iter().map(|row| {
        let mut cells = vec![format!("{who} {}", row.name)];
        cells.extend(row.person.map(digits));
        cells.extend(row.more.iter().cloned());
        cells
    }));
}

fn digits(value: f64) -> String {
    format!("{value:.4}")
}

/// Remembered people as they were saved.
pub(super) fn people(name: &str, text: &str) -> Result<Album, Fault> {
    let advice = "; mien moves such a file aside and starts over";
    let people = saved::read(text, SystemTime::now())
        .map_err(|error| Fault::new(format!("{error}{advice}")))?;
    let mut album = Album::new(format!("People {name}"));
    album.fact("people", people.len().to_string());
    let low = "population's low";
    album.header(["", "low", "rest", "high", low, "rest", "high"]);
    let units = Units::shipped();
    for (number, person) in people.iter().enumerate() {
        let learned = &person.learned;
        let measures = Measure::ALL.iter().zip(&learned.ranges).zip(&units.rows);
        let rows = measures.map(|((measure, &Range { low, rest, high }), unit)| {
            let population = prior(&unit.prior);
            Row {
                name: measure.name().trim_start_matches("m_").to_owned(),
                population: Some(population),
                person: [low, rest, high],
                more: population.map(digits).to_vec(),
            }
        });
        let who = format!("person {number}");
        let known = format!(
            "slot {}, gone for {:.0} s, interocular distance {:.1} mm",
            person.slot,
            person.before_s,
            learned.eye_distance_m * 1e3
        );
        album.fact(&who, known);
        show(&mut album, &who, &rows.collect::<Vec<_>>());
    }
    Ok(album)
}

fn plain(value: &Value) -> String {
    let text = value.as_str().map(str::to_owned);
    text.unwrap_or_else(|| value.to_string())
}

/// JSON of something else.
fn no_status() -> Fault {
    Fault::new("not a status file: expected the file that `mien run` writes to status.path")
}

/// The status file of a running `mien`.
pub(super) fn status(name: &str, text: &str) -> Result<Album, Fault> {
    let json: Value = serde_json::from_str(text).map_err(|_| no_status())?;
    let users = json["users"].as_array().ok_or_else(no_status)?;
    let mut album = Album::new(format!("Status {name}"));
    for key in ["version", "source", "uptime_s", "frames", "tracking_lost"] {
        if !json[key].is_null() {
            album.fact(key, plain(&json[key]));
        }
    }
    let latency = ["median", "p99"].map(|key| json["latency_ms"][key].as_f64());
    if let [Some(median), Some(p99)] = latency {
        album.fact("latency", format!("median {median:.1} ms, p99 {p99:.1} ms"));
    }
    for output in json["outputs"].as_array().into_iter().flatten() {
        let [name, sent, dropped] = ["name", "sent", "dropped"].map(|key| plain(&output[key]));
        let connected = output["connected"] != false;
        let away = if connected { "" } else { ", not connected" };
        let text = format!("{sent} sent, {dropped} dropped{away}");
        album.fact(&format!("output {name}"), text);
    }
    album.header(["", "low", "rest", "high", "ready", "weight"]);
    for user in users {
        let who = format!("user {}", plain(&user["slot"]));
        let confidence = user["confidence"].as_f64().unwrap_or(0.0);
        let learning = user["frozen"] != true;
        let frozen = if learning { "" } else { ", ranges frozen" };
        let state = plain(&user["state"]);
        album.fact(&who, format!("{state}, confidence {confidence:.2}{frozen}"));
        let units = user["units"].as_object().ok_or_else(no_status)?;
        let rows = units.iter().map(|(name, unit)| of_unit(name, unit));
        let rows: Option<Vec<Row>> = rows.collect();
        show(&mut album, &who, &rows.ok_or_else(no_status)?);
    }
    Ok(album)
}

/// A unit of a user's status: its bounds are those of its measure.
fn of_unit(name: &str, unit: &Value) -> Option<Row> {
    let [low, rest, high] = ["low", "rest", "high"].map(|key| unit[key].as_f64());
    let ready = unit["readiness"].as_f64();
    let weight = unit["weight"].as_f64().unwrap_or(0.0);
    Some(Row {
        name: name.to_owned(),
        population: population(name),
        person: [low?, rest?, high?],
        more: vec![
            ready.map_or(String::new(), |ready| format!("{ready:.2}")),
            format!("{weight:.3}"),
        ],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::time::Timestamp;
    use crate::expression::Learned;
    use crate::users::likeness::Likeness;
    use crate::users::memory::Gone;

    #[test]
    fn remembered_people_stand_beside_the_population() {
        let units = Units::shipped();
        let ranges = std::array::from_fn(|m| {
            let [low, rest, high] = prior(&units.rows[m].prior);
            Range { low, rest, high }
        });
        // A head of which no place was seen, whatever the number of places.
        let unseen = |n| Likeness::read(std::iter::once("0").chain(std::iter::repeat_n("-", n)));
        let gone = Gone {
            slot: 2,
            likeness: (0..10_000).find_map(unseen).unwrap(),
            learned: Learned {
                eye_distance_m: 0.034,
                ranges,
            },
            last_seen: Timestamp::default(),
            before_s: 0.0,
        };
        let mut text = String::new();
        let now = (Timestamp::default(), SystemTime::now());
        saved::write([&gone, &gone].into_iter(), now, &mut text).unwrap();
        let album = people("people", &text).unwrap();
        assert_eq!(album.table.len(), 1 + 2 * units.rows.len());
        // The same as the population, to the digits of the file.
        assert!(album.table[1..].iter().all(|row| row[1..4] == row[4..7]));
        let person = |p: &&Rgb<u8>| p.0 == PERSON;
        assert!(album.pictures[1].1.pixels().filter(person).count() > 5000);
        assert!(people("x", &text.replace("person 2", "person 1")).is_err());
    }

    #[test]
    fn a_status_shows_its_users_and_anything_else_is_refused() {
        let text = r#"{"version": "0.1.0", "source": "kinect", "outputs": [{"name": "osc", "connected": true, "sent": 5, "dropped": 1}],
            "users": [{"slot": 1, "state": "tracking", "confidence": 0.9, "frozen": true,
                       "units": {"AU26": {"weight": 0.25, "low": 0.1, "rest": 0.2, "high": 0.3}}}]}"#;
        let album = status("status.json", text).unwrap();
        assert_eq!(
            album.table[1],
            ["user 1 AU26", "0.1000", "0.2000", "0.3000", "", "0.250"]
        );
        assert!(
            album
                .facts
                .iter()
                .any(|(name, value)| name == "user 1" && value.contains("frozen"))
        );
        for bad in ["{", "[]", "{\"users\": [{\"slot\": 0}]}"] {
            assert!(status("x.json", bad).is_err(), "{bad}");
        }
    }
}
