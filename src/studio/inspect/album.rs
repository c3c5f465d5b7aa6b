//! The result of an inspection, as one self-contained HTML page or one PNG contact sheet.
//!
//! The page embeds its pictures as base64 (RFC 4648) PNG and its curves as SVG; no network, and no script but
//! the film's.
//! One file: both forms share their parts.

use std::fmt::Write;
use std::io::Cursor;
use std::path::Path;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use image::{ImageFormat, RgbImage};

use super::canvas::{self, CURVES, LETTER_HEIGHT};
use super::film::Film;

/// One curve; a gap where there is no value.
pub struct Curve {
    /// Legend.
    pub name: String,
    /// One value per place on the plot's x axis.
    pub values: Vec<Option<f64>>,
}

/// Curves over a common axis.
pub struct Plot {
    /// Heading.
    pub title: String,
    /// Places on the x axis, ascending, with what they are.
    pub x: Vec<f64>,
    /// Name and unit of the x axis.
    pub x_name: String,
    /// Curves.
    pub curves: Vec<Curve>,
    /// Lowest and highest value shown at least.
    pub at_least: Option<(f64, f64)>,
}

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
    /// Pictures that play; not on the contact sheet.
    pub film: Film,
    /// Curves.
    pub plots: Vec<Plot>,
}

/// Size of a plot, pixels.
const PLOT: (u32, u32) = (900, 170);
/// Left margin of a plot for its labels.
const LEFT: f64 = 70.0;
/// Lower and upper margin.
const BELOW: f64 = 18.0;
const ABOVE: f64 = 16.0;
/// Places on the x axis that a plot resolves; longer curves are drawn by their extremes.
const MOST_PLACES: usize = 1600;

/// Text safe between tags and in attributes.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// A number in as few digits as its size needs.
fn short(value: f64) -> String {
    let decimals = match value.abs() {
        v if v >= 100.0 => 0,
        v if v >= 10.0 => 1,
        v if v >= 1.0 => 2,
        _ => 3,
    };
    format!("{value:.decimals$}")
}

impl Plot {
    /// Lowest and highest value, never equal.
    fn span(&self) -> (f64, f64) {
        let values = self
            .curves
            .iter()
            .flat_map(|curve| curve.values.iter().flatten());
        let finite = values.copied().filter(|v| v.is_finite());
        let start = self.at_least.unwrap_or((f64::INFINITY, f64::NEG_INFINITY));
        let (low, high) = finite.fold(start, |(low, high), v| (low.min(v), high.max(v)));
        match (low, high) {
            (low, high) if low < high => (low, high),
            (low, high) if low == high => (low - 0.5, high + 0.5),
            _ => (0.0, 1.0),
        }
    }

    /// Runs of connected points of a curve, in plot pixels.
    fn runs(&self, curve: &Curve) -> Vec<Vec<[f32; 2]>> {
        let (low, high) = self.span();
        let (first, last) = (
            self.x.first().copied().unwrap_or(0.0),
            self.x.last().copied().unwrap_or(1.0),
        );
        let width = (last - first).max(1e-9);
        let place = |x: f64, v: f64| {
            [
                (LEFT + (x - first) / width * (f64::from(PLOT.0) - LEFT - 8.0)) as f32,
                (ABOVE + (high - v) / (high - low) * (f64::from(PLOT.1) - ABOVE - BELOW)) as f32,
            ]
        };
        let mut runs = vec![Vec::new()];
        let bucket = self.x.len().div_ceil(MOST_PLACES).max(1);
        for (xs, values) in self.x.chunks(bucket).zip(curve.values.chunks(bucket)) {
            let known: Vec<f64> = values
                .iter()
                .flatten()
                .copied()
                .filter(|v| v.is_finite())
                .collect();
            let run = runs.last_mut().expect("never empty");
            if known.len() < values.len() {
                if !run.is_empty() {
                    runs.push(Vec::new());
                }
                continue;
            }
            if known.is_empty() {
                continue;
            }
            let run = runs.last_mut().expect("never empty");
            // Both extremes, so that a blink of one frame is seen in an hour's curve.
            let low = known.iter().copied().fold(f64::INFINITY, f64::min);
            let high = known.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            run.push(place(xs[0], low));
            if high > low {
                run.push(place(xs[0], high));
            }
        }
        runs.retain(|run| !run.is_empty());
        runs
    }

    fn svg(&self) -> String {
        let (low, high) = self.span();
        let (w, h) = (f64::from(PLOT.0), f64::from(PLOT.1));
        let mut svg =
            format!("<svg viewBox=\"0 0 {w} {h}\" width=\"{w}\" height=\"{h}\" role=\"img\">");
        let _ = write!(
            svg,
            "<rect x=\"{LEFT}\" y=\"{ABOVE}\" width=\"{}\" height=\"{}\" class=\"box\"/>",
            w - LEFT - 8.0,
            h - ABOVE - BELOW
        );
        for (value, y) in [(high, ABOVE + 8.0), (low, h - BELOW)] {
            let _ = write!(
                svg,
                "<text x=\"{}\" y=\"{y}\" text-anchor=\"end\">{}</text>",
                LEFT - 5.0,
                short(value)
            );
        }
        let (first, last) = (
            self.x.first().copied().unwrap_or(0.0),
            self.x.last().copied().unwrap_or(1.0),
        );
        let _ = write!(
            svg,
            "<text x=\"{LEFT}\" y=\"{}\">{}</text>",
            h - 4.0,
            short(first)
        );
        let _ = write!(
            svg,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{} {}</text>",
            w - 8.0,
            h - 4.0,
            short(last),
            escaped(&self.x_name)
        );
        let mut legend = LEFT;
        for (k, curve) in self.curves.iter().enumerate() {
            let [r, g, b] = CURVES[k % CURVES.len()];
            for run in self.runs(curve) {
                let points: String = run.iter().map(|[x, y]| format!("{x:.1},{y:.1} ")).collect();
                let _ = write!(
                    svg,
                    "<polyline points=\"{points}\" stroke=\"rgb({r},{g},{b})\"/>"
                );
            }
            let _ = write!(
                svg,
                "<text x=\"{legend:.0}\" y=\"11\" fill=\"rgb({r},{g},{b})\">{}</text>",
                escaped(&curve.name)
            );
            legend += 12.0 + 7.2 * curve.name.chars().count() as f64;
        }
        svg.push_str("</svg>");
        svg
    }

    fn draw(&self) -> RgbImage {
        let mut picture = RgbImage::from_pixel(PLOT.0, PLOT.1, image::Rgb([255; 3]));
        let (w, h) = (PLOT.0 as f32, PLOT.1 as f32);
        let (left, above, below) = (LEFT as f32, ABOVE as f32, BELOW as f32);
        canvas::frame(&mut picture, left, above, w - 8.0, h - below, [190; 3]);
        let (low, high) = self.span();
        canvas::text(&mut picture, 4, ABOVE as u32, 2, &short(high), [60; 3]);
        canvas::text(
            &mut picture,
            4,
            PLOT.1 - BELOW as u32 - 10,
            2,
            &short(low),
            [60; 3],
        );
        let last = self.x.last().copied().unwrap_or(1.0);
        let axis = format!(
            "0 - {} {}",
            short(last - self.x.first().copied().unwrap_or(0.0)),
            self.x_name
        );
        canvas::text(&mut picture, LEFT as u32, PLOT.1 - 13, 2, &axis, [60; 3]);
        let mut legend = LEFT as u32;
        for (k, curve) in self.curves.iter().enumerate() {
            let colour = CURVES[k % CURVES.len()];
            for run in self.runs(curve) {
                for pair in run.windows(2) {
                    canvas::line(&mut picture, pair[0], pair[1], colour);
                }
            }
            canvas::text(&mut picture, legend, 3, 2, &curve.name, colour);
            legend += 8 * (curve.name.chars().count() as u32 + 2);
        }
        picture
    }
}

impl Album {
    /// Adds a fact.
    pub fn fact(&mut self, name: &str, value: impl Into<String>) {
        self.facts.push((name.into(), value.into()));
    }

    /// The page.
    ///
    /// # Errors
    /// If a picture cannot be encoded.
    pub fn html(&self) -> Result<String, image::ImageError> {
        let title = escaped(&self.title);
        let mut html = format!(
            "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title><style>\
             body{{font:14px/1.45 system-ui,sans-serif;margin:24px auto;max-width:1340px;padding:0 16px;color:#222;background:#fff}}\
             h1{{font-size:22px}}h2{{font-size:15px;margin:18px 0 2px}}table{{border-collapse:collapse}}\
             td,th{{padding:2px 14px 2px 0;text-align:left;vertical-align:top}}th{{font-weight:600;color:#555}}\
             figure{{display:inline-block;margin:0 14px 18px 0;vertical-align:top}}figcaption{{color:#555}}\
             img{{max-width:100%;display:block}}svg{{max-width:100%;height:auto}}svg text{{font-size:11px}}\
             polyline{{fill:none;stroke-width:1.2}}.box{{fill:#fafafa;stroke:#ccc}}</style></head><body><h1>{title}</h1>"
        );
        if !self.facts.is_empty() {
            html.push_str("<table>");
            for (name, value) in &self.facts {
                let _ = write!(
                    html,
                    "<tr><th>{}</th><td>{}</td></tr>",
                    escaped(name),
                    escaped(value)
                );
            }
            html.push_str("</table>");
        }
        if let Some((header, rows)) = self.table.split_first() {
            html.push_str("<h2>Values</h2><table><tr>");
            header
                .iter()
                .for_each(|cell| html.push_str(&format!("<th>{}</th>", escaped(cell))));
            for row in rows {
                html.push_str("</tr><tr>");
                row.iter()
                    .for_each(|cell| html.push_str(&format!("<td>{}</td>", escaped(cell))));
            }
            html.push_str("</tr></table>");
        }
        html.push_str(&self.film.html());
        for (caption, picture) in &self.pictures {
            let mut png = Cursor::new(Vec::new());
            picture.write_to(&mut png, ImageFormat::Png)?;
            let caption = escaped(caption);
            let _ = write!(
                html,
                "<figure><img alt=\"{caption}\" src=\"data:image/png;base64,{}\"><figcaption>{caption}</figcaption></figure>",
                STANDARD.encode(png.get_ref())
            );
        }
        for plot in &self.plots {
            let _ = write!(html, "<h2>{}</h2>{}", escaped(&plot.title), plot.svg());
        }
        html.push_str("</body></html>\n");
        Ok(html)
    }

    /// The contact sheet: pictures in two columns with their captions, then the plots, halved if there are many.
    #[must_use]
    pub fn sheet(&self) -> RgbImage {
        const WIDTH: u32 = 1312;
        const GAP: u32 = 8;
        let mut tiles: Vec<(String, RgbImage)> = Vec::new();
        for (caption, picture) in &self.pictures {
            tiles.push((caption.clone(), picture.clone()));
        }
        for plot in &self.plots {
            tiles.push((plot.title.clone(), plot.draw()));
        }
        let caption_height = 2 * LETTER_HEIGHT + 4;
        // Shelves: tiles side by side as long as they fit.
        let (mut x, mut y, mut shelf) = (GAP, GAP + caption_height, 0);
        let mut places = Vec::new();
        for (_, tile) in &tiles {
            if x > GAP && x + tile.width() + GAP > WIDTH {
                (x, y, shelf) = (GAP, y + shelf, 0);
            }
            places.push((x, y));
            x += tile.width() + GAP;
            shelf = shelf.max(tile.height() + caption_height + GAP);
        }
        let width = tiles
            .iter()
            .map(|(_, tile)| tile.width() + 2 * GAP)
            .max()
            .unwrap_or(0)
            .max(WIDTH);
        let mut sheet = RgbImage::from_pixel(width, y + shelf + GAP, image::Rgb([245; 3]));
        canvas::text(&mut sheet, GAP, 5, 2, &self.title, [20; 3]);
        for ((caption, tile), (x, y)) in tiles.iter().zip(places) {
            canvas::text(&mut sheet, x, y + 4, 2, caption, [40; 3]);
            image::imageops::replace(
                &mut sheet,
                tile,
                i64::from(x),
                i64::from(y + caption_height),
            );
        }
        sheet
    }
}

/// Last part of a path: the title of its album.
pub(super) fn name_of(path: &Path) -> String {
    path.file_name()
        .unwrap_or(path.as_os_str())
        .to_string_lossy()
        .into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let html = album().html().unwrap();
        assert!(
            html.contains("a &lt;b&gt; &amp; c") && html.contains("data:image/png;base64,iVBOR")
        );
        assert!(!html.contains("http") && !html.contains("<script"));
    }

    #[test]
    fn the_sheet_holds_all_tiles() {
        let sheet = album().sheet();
        assert!(sheet.width() >= 900 && sheet.height() >= 170 + 20);
        let empty = Album::default().sheet();
        assert!(empty.height() > 0);
    }
}
