//! The result of an inspection, as one self-contained HTML page or one PNG contact sheet.
//!
//! The page embeds its pictures as base64 (RFC 4648) PNG and its curves as SVG; no network and no script.

use std::fmt::Write;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use image::RgbImage;

use crate::studio::chart::{self, Plot};
use crate::studio::picture_files::png;

/// All of it.
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
}

/// Text safe between tags and in attributes.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

fn cells<'a>(tag: &str, texts: impl IntoIterator<Item = &'a String>) -> String {
    let texts = texts.into_iter();
    let cells = texts.map(|text| format!("<{tag}>{}</{tag}>", escaped(text)));
    cells.collect()
}

impl Album {
    /// With a heading, and nothing else yet.
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

    /// Begins the table with the names of its columns.
    pub fn header<const N: usize>(&mut self, columns: [&str; N]) {
        self.table.push(columns.map(str::to_owned).to_vec());
    }

    /// The page.
    pub fn html(&self) -> String {
        let title = escaped(&self.title);
        let mut html = format!(
            "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title><style>\
             body{{font:14px/1.45 system-ui,sans-serif;margin:24px auto;max-width:1340px;padding:0 16px;color:#222;background:#fff}}\
             h1{{font-size:22px}}h2{{font-size:15px;margin:18px 0 2px}}table{{border-collapse:collapse}}\
             td,th{{padding:2px 14px 2px 0;text-align:left;vertical-align:top}}th{{font-weight:600;color:#555}}\
             figure{{display:inline-block;margin:0 14px 18px 0;vertical-align:top}}figcaption{{color:#555}}\
             img{{max-width:100%;display:block}}svg{{width:900px;max-width:100%;height:auto}}</style></head><body><h1>{title}</h1>"
        );
        html += "<table>";
        for (name, value) in &self.facts {
            html = html + "<tr>" + &cells("th", [name]) + &cells("td", [value]) + "</tr>";
        }
        html += "</table>";
        if let Some((header, rows)) = self.table.split_first() {
            html = html + "<h2>Values</h2><table><tr>" + &cells("th", header) + "</tr>";
            for row in rows {
                html = html + "<tr>" + &cells("td", row) + "</tr>";
            }
            html += "</table>";
        }
        for (caption, picture) in &self.pictures {
            let caption = escaped(caption);
            let _ = write!(
                html,
                "<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{}\"><figcaption>{caption}</figcaption></figure>",
                STANDARD.encode(png(picture))
            );
        }
        for plot in &self.plots {
            let _ = write!(html, "<h2>{}</h2>{}", escaped(&plot.title), plot.svg());
        }
        html + "</body></html>\n"
    }

    /// The contact sheet: pictures side by side as long as they fit, each under its caption, then the plots.
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
    use crate::studio::chart::Curve;

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
    fn the_page_stands_alone_and_escapes() {
        let html = album().html();
        assert!(
            html.contains("a &lt;b&gt; &amp; c") && html.contains("data:image/png;base64,iVBOR")
        );
        assert!(
            !html
                .replace("http://www.w3.org/2000/svg", "")
                .contains("http")
                && !html.contains("<script")
        );
    }

    #[test]
    fn the_sheet_holds_all_tiles() {
        let sheet = album().sheet();
        assert!(sheet.width() >= 900 && sheet.height() >= 170 + 20);
        let empty = Album::default().sheet();
        assert!(empty.height() > 0);
    }
}
