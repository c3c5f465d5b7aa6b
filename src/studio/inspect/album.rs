//! The result of an inspection, output as a page ([`super::page`]) or a PNG contact sheet.

use image::RgbImage;

use crate::chart::{self, Plot};

/// The contents of an inspection.
#[derive(Default)]
pub struct Album {
    /// Heading of the page.
    pub title: String,
    /// Name and value, shown as a table.
    pub facts: Vec<(String, String)>,
    /// A table with a header row.
    pub table: Vec<Vec<String>>,
    /// Caption and picture.
    pub pictures: Vec<(String, RgbImage)>,
    /// Curves.
    pub plots: Vec<Plot>,
    /// Frames of the player, in order of time.
    pub frames: Vec<Shown>,
    /// Depths at which the depth colours are 0, 1/4, 2/4, 3/4, 1 of the way from far to near, metres.
    pub depth_key: Option<[f32; 5]>,
    /// Seconds, user and points x, y, x, y, … of faces that the player draws where there are no pictures.
    pub faces: Vec<(f64, usize, Vec<i32>)>,
}

/// A frame of the player: JPEGs.
pub struct Shown {
    /// Capture time, seconds.
    pub seconds: f64,
    /// Its number in the recording.
    pub number: u64,
    /// Picture with landmarks, if available.
    pub colour: Option<Vec<u8>>,
    /// Depth with heads.
    pub depth: Vec<u8>,
}

impl Album {
    /// An album with only a heading.
    pub fn new(title: impl Into<String>) -> Self {
        Self {
            title: title.into(),
            ..Self::default()
        }
    }

    /// Adds a fact.
    pub fn fact(&mut self, name: &str, value: impl Into<String>) {
        self.facts.push((name.into(), value.into()));
    }

    /// Starts the table with the names of its columns.
    pub fn header<const N: usize>(&mut self, columns: [&str; N]) {
        self.table.push(columns.map(str::to_owned).to_vec());
    }

    /// The contact sheet: pictures side by side, wrapped, each under its caption, then the plots.
    pub fn sheet(&self) -> RgbImage {
        const WIDTH: u32 = 1312;
        const GAP: u32 = 8;
        const CAPTION: u32 = 18;
        let plots = self.plots.iter();
        let plots = plots.map(|plot| (plot.title.clone(), plot.picture()));
        let tiles: Vec<_> = self.pictures.iter().cloned().chain(plots).collect();
        let widest = tiles.iter().map(|(_, tile)| tile.width() + 2 * GAP).max();
        let width = widest.unwrap_or(0).max(WIDTH);
        let (mut x, mut y, mut shelf) = (GAP, GAP + CAPTION, 0);
        let mut places = Vec::new();
        for (_, tile) in &tiles {
            if x > GAP && x + tile.width() + GAP > WIDTH {
                (x, y, shelf) = (GAP, y + shelf, 0);
            }
            places.push([x, y]);
            x += tile.width() + GAP;
            shelf = shelf.max(tile.height() + CAPTION + GAP);
        }
        let mut sheet = RgbImage::from_pixel(width, y + shelf + GAP, image::Rgb([245; 3]));
        chart::text(&mut sheet, [GAP, 4], 16, &self.title, [20; 3]);
        for ((caption, tile), [x, y]) in tiles.iter().zip(places) {
            chart::text(&mut sheet, [x, y + 3], 12, caption, [40; 3]);
            image::imageops::replace(&mut sheet, tile, x.into(), (y + CAPTION).into());
        }
        sheet
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::Curve;

    fn album() -> Album {
        Album {
            title: "a <b> & c".into(),
            plots: vec![Plot {
                title: "one".into(),
                x: (0..5000).map(f64::from).collect(),
                x_name: "s".into(),
                curves: vec![Curve {
                    name: "v".into(),
                    values: (0..5000)
                        .map(|i| (i % 1000 != 0).then_some(f64::from(i % 7)))
                        .collect(),
                }],
                at_least: None,
            }],
            pictures: vec![("p".into(), RgbImage::new(20, 10))],
            ..Album::default()
        }
    }

    #[test]
    fn the_sheet_holds_all_tiles() {
        let sheet = album().sheet();
        assert!(sheet.width() >= 900 && sheet.height() >= 170 + 20);
        let empty = Album::default().sheet();
        assert!(empty.height() > 0);
    }
}
