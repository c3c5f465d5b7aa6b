//! Learned ranges of people, from the file of remembered people ([`mien_stages::users::saved`]): each range next to
//! the population's, as an image and a table.
//!
//! Units: inner-eye-corner distances. The image has one row per measure, with its own scale: the population's range
//! in grey, the person's in blue, a mark at each rest.

use std::time::SystemTime;

use image::{Rgb, RgbImage};

use super::album::Album;
use crate::chart;
use mien_stages::expression::units::{Prior, Units};
use mien_stages::expression::{Measure, Range};
use mien_stages::users::saved;
use mien_workbench::canvas;
use mien_workbench::fault::Fault;

/// Height of a row, pixels.
const ROW: u32 = 22;
/// Left margin for names, pixels.
const LEFT: u32 = 160;
/// Width of the scale, pixels.
const WIDE: u32 = 620;
const POPULATION: [u8; 3] = [200, 200, 200];
const PERSON: [u8; 3] = [40, 110, 200];

/// Low end, rest, high end.
type Bounds = [f64; 3];

/// Ranges of one measure.
struct Row {
    name: &'static str,
    population: Bounds,
    person: Bounds,
}

fn prior(prior: &Prior) -> Bounds {
    [prior.rest - prior.down, prior.rest, prior.rest + prior.up]
}

fn picture(rows: &[Row]) -> RgbImage {
    let height = ROW * rows.len() as u32 + 8;
    let mut picture = RgbImage::from_pixel(LEFT + WIDE + 16, height, Rgb([255; 3]));
    for (k, row) in (0..).zip(rows) {
        let top = 6 + ROW * k;
        chart::text(&mut picture, [6, top], 13, row.name, [60; 3]);
        let all = row.person.iter().chain(&row.population);
        let (low, high) = chart::span(all.copied());
        let x = |v: f64| (f64::from(LEFT) + (v - low) / (high - low) * f64::from(WIDE)) as f32;
        let mut bar = |[low, rest, high]: Bounds, from: u32, to: u32, colour| {
            let [from, to] = [top + from, top + to].map(|y| y as f32);
            canvas::fill(&mut picture, [x(low), from], [x(high), to], colour);
            let mark = [[x(rest), from - 2.0], [x(rest) + 1.0, to + 2.0]];
            canvas::fill(&mut picture, mark[0], mark[1], [20; 3]);
        };
        bar(row.population, 2, 6, POPULATION);
        bar(row.person, 9, 14, PERSON);
    }
    picture
}

/// The album of saved people.
pub(super) fn people(name: &str, text: &str) -> Result<Album, Fault> {
    let advice = "; mien renames such a file and starts over";
    let people = saved::read(text, SystemTime::now());
    let people = people.map_err(|error| Fault::new(format!("{error}{advice}")))?;
    let mut album = Album::new(format!("People {name}"));
    album.fact("people", people.len().to_string());
    let low = "population's low";
    album.header(["", "low", "rest", "high", low, "rest", "high"]);
    let units = Units::shipped();
    for (number, person) in people.iter().enumerate() {
        let learned = &person.learned;
        let measures = Measure::ALL.iter().zip(&learned.ranges).zip(&units.rows);
        let rows = measures.map(|((measure, &Range { low, rest, high }), unit)| Row {
            name: measure.name().trim_start_matches("m_"),
            population: prior(&unit.prior),
            person: [low, rest, high],
        });
        let rows: Vec<Row> = rows.collect();
        let who = format!("person {number}");
        let (slot, gone_s, apart_mm) = (person.slot, person.before_s, learned.eye_distance_m * 1e3);
        let known =
            format!("slot {slot}, gone for {gone_s:.0} s, interocular distance {apart_mm:.1} mm");
        album.fact(&who, known);
        let caption = format!(
            "{who}: the population's range in grey, this person's in blue; marks show rest"
        );
        album.pictures.push((caption, picture(&rows)));
        album.table.extend(rows.iter().map(|row| {
            let bounds = row.person.iter().chain(&row.population);
            let mut cells = vec![format!("{who} {}", row.name)];
            cells.extend(bounds.map(|value| format!("{value:.4}")));
            cells
        }));
    }
    Ok(album)
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::base::time::Timestamp;
    use mien_stages::expression::Learned;
    use mien_stages::users::likeness::Likeness;
    use mien_stages::users::memory::Gone;

    #[test]
    fn remembered_people_stand_beside_the_population() {
        let units = Units::shipped();
        let ranges = std::array::from_fn(|m| {
            let [low, rest, high] = prior(&units.rows[m].prior);
            Range { low, rest, high }
        });
        // A head of which no cell was seen, for any number of cells.
        let unseen = |n| Likeness::read(std::iter::once("0").chain(std::iter::repeat_n("-", n)));
        let gone = Gone {
            slot: 2,
            likeness: (0..10_000).find_map(unseen).unwrap(),
            learned: Learned {
                eye_distance_m: 0.034,
                ranges,
                features: heapless::Vec::new(),
                readings: heapless::Vec::new(),
            },
            last_seen: Timestamp::default(),
            before_s: 0.0,
        };
        let mut text = String::new();
        let now = (Timestamp::default(), SystemTime::now());
        saved::write([gone.clone(), gone].into_iter(), now, &mut text).unwrap();
        let album = people("people", &text).unwrap();
        assert_eq!(album.table.len(), 1 + 2 * units.rows.len());
        // Equal to the population, to the precision of the file.
        assert!(album.table[1..].iter().all(|row| row[1..4] == row[4..7]));
        let person = |p: &&Rgb<u8>| p.0 == PERSON;
        assert!(album.pictures[1].1.pixels().filter(person).count() > 5000);
        assert!(people("x", &text.replace("person 2", "person 1")).is_err());
    }
}
