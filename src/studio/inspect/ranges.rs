//! Learned ranges of people, from the file of remembered people ([`crate::users::saved`]) or the `status.json` of a running
//! `mien`, as a picture of each range next to the population's, and as a table.
//!
//! Units: inner-eye-corner distances. A picture has one row per measure: the population's range in grey, the person's in blue, a
//! mark at each rest; each row has its own scale. A unit of the status has the row of its measure.

use std::path::Path;
use std::time::SystemTime;

use image::{Rgb, RgbImage};
use serde_json::Value;

use super::album::{Album, name_of};
use super::canvas;
use super::error::InspectError;
use crate::expression::units::{Prior, Units};
use crate::expression::{Measure, Range};
use crate::users::saved;

/// Picture of ranges: a row's height, left margin for names, width of the scale, pixels.
const ROW: u32 = 22;
const LEFT: u32 = 230;
const WIDE: u32 = 620;
const POPULATION: [u8; 3] = [200, 200, 200];
const PERSON: [u8; 3] = [40, 110, 200];

/// Low, rest, high.
type Bounds = [f64; 3];

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

/// Rows of a name, the population's bounds if known, and the person's.
fn picture(rows: &[(String, Option<Bounds>, Bounds)]) -> RgbImage {
    let height = ROW * rows.len() as u32 + 8;
    let mut picture = RgbImage::from_pixel(LEFT + WIDE + 16, height, Rgb([255; 3]));
    for (k, (name, population, person)) in rows.iter().enumerate() {
        let top = 6 + ROW * k as u32;
        canvas::text(&mut picture, 6, top + 3, 2, name, [60; 3]);
        let all = || person.iter().chain(population.iter().flatten()).copied();
        let low = all().fold(f64::INFINITY, f64::min);
        let high = all().fold(f64::NEG_INFINITY, f64::max);
        let span = (high - low).max(1e-6);
        let x = |value: f64| (f64::from(LEFT) + (value - low) / span * f64::from(WIDE)) as f32;
        let mut bar = |bounds: &Bounds, from: u32, to: u32, colour: [u8; 3]| {
            for y in from..to {
                let y = (top + y) as f32;
                canvas::line(&mut picture, [x(bounds[0]), y], [x(bounds[2]), y], colour);
            }
            let mark = x(bounds[1]);
            for dx in [0.0, 1.0] {
                let ends = [
                    [mark + dx, (top + from) as f32 - 2.0],
                    [mark + dx, (top + to) as f32 + 1.0],
                ];
                canvas::line(&mut picture, ends[0], ends[1], [20; 3]);
            }
        };
        if let Some(population) = population {
            bar(population, 2, 7, POPULATION);
        }
        bar(person, 9, 15, PERSON);
    }
    picture
}

fn table(rows: &[(String, Option<Bounds>, Bounds)]) -> Vec<Vec<String>> {
    let header = [
        "",
        "low",
        "rest",
        "high",
        "population's low",
        "rest",
        "high",
    ];
    let mut table = vec![header.map(str::to_owned).to_vec()];
    for (name, population, person) in rows {
        let number = |value: f64| format!("{value:.4}");
        let mut cells = vec![name.clone()];
        cells.extend(person.map(number));
        cells.extend(population.map_or_else(|| vec![String::new(); 3], |p| p.map(number).to_vec()));
        table.push(cells);
    }
    table
}

/// Remembered people as they were saved.
pub(super) fn people(path: &Path, text: &str) -> Result<Album, InspectError> {
    let people = saved::read(text, SystemTime::now()).map_err(|source| InspectError::People {
        path: path.into(),
        source,
    })?;
    let mut album = Album {
        title: format!("People {}", name_of(path)),
        ..Album::default()
    };
    album.fact("people", people.len().to_string());
    let units = Units::shipped();
    for (number, person) in people.iter().enumerate() {
        let learned = &person.learned;
        let rows: Vec<_> = Measure::ALL
            .iter()
            .zip(&learned.ranges)
            .zip(&units.rows)
            .map(|((measure, range), unit)| {
                let Range { low, rest, high } = *range;
                let name = measure.name().trim_start_matches("m_").to_owned();
                (name, Some(prior(&unit.prior)), [low, rest, high])
            })
            .collect();
        let who = format!("person {number}");
        let eyes_mm = learned.eye_distance_m * 1e3;
        let gone = format!(
            "slot {}, gone for {:.0} s, interocular distance {eyes_mm:.1} mm",
            person.slot, person.before_s
        );
        album.fact(&who, gone);
        let caption = format!("{who}: population range grey, this person's blue; marks show rest");
        album.pictures.push((caption, picture(&rows)));
        let skip = usize::from(!album.table.is_empty());
        let cells = table(&rows).into_iter().enumerate().skip(skip);
        album.table.extend(cells.map(|(row, mut cells)| {
            if row > 0 {
                cells[0] = format!("{who} {}", cells[0]);
            }
            cells
        }));
    }
    Ok(album)
}

/// The status file of a running `mien`.
pub(super) fn status(path: &Path, text: &str) -> Result<Album, InspectError> {
    let not = || InspectError::NotAStatus { path: path.into() };
    let json: Value = serde_json::from_str(text).map_err(|_| not())?;
    let users = json["users"].as_array().ok_or_else(not)?;
    let mut album = Album {
        title: format!("Status {}", name_of(path)),
        ..Album::default()
    };
    let plain = |value: &Value| match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    for key in ["version", "source", "uptime_s", "frames", "tracking_lost"] {
        if !json[key].is_null() {
            album.fact(key, plain(&json[key]));
        }
    }
    let latency = &json["latency_ms"];
    if let (Some(median), Some(p99)) = (latency["median"].as_f64(), latency["p99"].as_f64()) {
        album.fact("latency", format!("median {median:.1} ms, p99 {p99:.1} ms"));
    }
    for output in json["outputs"].as_array().into_iter().flatten() {
        let [sent, dropped] = ["sent", "dropped"].map(|key| plain(&output[key]));
        let away = if output["connected"] == false {
            ", not connected"
        } else {
            ""
        };
        let text = format!("{sent} sent, {dropped} dropped{away}");
        album.fact(&format!("output {}", plain(&output["name"])), text);
    }
    for user in users {
        let slot = plain(&user["slot"]);
        let confidence = user["confidence"].as_f64().unwrap_or(0.0);
        let frozen = if user["frozen"] == true {
            ", ranges frozen"
        } else {
            ""
        };
        let text = format!(
            "{}, confidence {confidence:.2}{frozen}",
            plain(&user["state"])
        );
        album.fact(&format!("user {slot}"), text);
        let units = user["units"].as_object().ok_or_else(not)?;
        let bounds = |unit: &Value| {
            let [low, rest, high] = ["low", "rest", "high"].map(|key| unit[key].as_f64());
            Some([low?, rest?, high?])
        };
        let rows: Option<Vec<_>> = units
            .iter()
            .map(|(name, unit)| Some((name.clone(), population(name), bounds(unit)?)))
            .collect();
        let rows = rows.ok_or_else(not)?;
        let caption = format!(
            "User {slot}, the measure behind each unit: population grey, this person blue; marks show rest"
        );
        album.pictures.push((caption, picture(&rows)));
        let mut cells = table(&rows);
        for (row, unit) in cells.iter_mut().skip(1).zip(units.values()) {
            row.truncate(4);
            let ready = unit["readiness"].as_f64();
            row.push(ready.map_or(String::new(), |ready| format!("{ready:.2}")));
            row[0] = format!("user {slot} {}", row[0]);
            row.push(format!("{:.3}", unit["weight"].as_f64().unwrap_or(0.0)));
        }
        let skip = usize::from(!album.table.is_empty());
        cells[0].truncate(4);
        cells[0].extend(["ready".to_owned(), "weight".to_owned()]);
        album.table.extend(cells.into_iter().skip(skip));
    }
    Ok(album)
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
        let album = people(Path::new("people"), &text).unwrap();
        assert_eq!(album.table.len(), 1 + 2 * units.rows.len());
        // The same as the population, to the digits of the file.
        assert!(album.table[1..].iter().all(|row| row[1..4] == row[4..7]));
        let person = |p: &&Rgb<u8>| p.0 == PERSON;
        assert!(album.pictures[1].1.pixels().filter(person).count() > 5000);
        assert!(people(Path::new("x"), &text.replace("person 2", "person 1")).is_err());
    }

    #[test]
    fn a_status_shows_its_users_and_anything_else_is_refused() {
        let text = r#"{"version": "0.1.0", "source": "kinect", "outputs": [{"name": "osc", "connected": true, "sent": 5, "dropped": 1}],
            "users": [{"slot": 1, "state": "tracking", "confidence": 0.9, "frozen": true,
                       "units": {"AU26": {"weight": 0.25, "low": 0.1, "rest": 0.2, "high": 0.3}}}]}"#;
        let album = status(Path::new("status.json"), text).unwrap();
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
            assert!(status(Path::new("x.json"), bad).is_err(), "{bad}");
        }
    }
}
