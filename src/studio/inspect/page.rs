//! The page of an inspection, one self-contained file: pictures are embedded as base64 (RFC 4648), nothing is fetched.
//!
//! Albums with a time line (recordings, runs) become a player: picture and depth in one column, curves in the other,
//! with a common time that is played and scrubbed. Style, curves and names of units are the live page's
//! ([`preview::LOOK`], [`preview::UNITS`], [`preview::DRAWING`]). Others become pictures, figures and plots.
//!
//! Limits: curves longer than [`MAX_POINTS`] are thinned; each point shows the value of its interval farthest from
//! the curve's mean, so that a blink remains visible in an hour's curve. The page states this.

use std::fmt::Write as _;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde_json::{Value, json};

use super::album::Album;
use crate::chart::Plot;
use crate::preview;
use mien_stages::expression::unit_words;
use mien_workbench::picture_files::png;

/// Most points of a curve in the page.
const MAX_POINTS: usize = 4000;
const STYLE: &str = include_str!("page/player.css");
const SCRIPT: &str = include_str!("page/player.js");
const BODY: &str = include_str!("page/player.html");
/// Name of the axis of playable plots.
const SECONDS: &str = "s";

/// Escapes text for use between tags and in attributes.
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

fn data_uri(kind: &str, bytes: &[u8]) -> String {
    format!("data:image/{kind};base64,{}", STANDARD.encode(bytes))
}

/// A number with four decimals.
fn rounded(value: f64) -> Value {
    match value.is_finite() {
        true => json!((value * 1e4).round() / 1e4),
        false => Value::Null,
    }
}

/// A curve thinned to every `every`th point.
fn thinned(values: &[Option<f64>], every: usize) -> Vec<Value> {
    let known: Vec<f64> = values.iter().flatten().copied().collect();
    let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
    let far = |value: &f64| (value - mean).abs();
    let of = |run: &[Option<f64>]| {
        let run = run.iter().flatten().copied();
        let farthest = run.max_by(|a, b| far(a).total_cmp(&far(b)));
        farthest.map_or(Value::Null, rounded)
    };
    values.chunks(every).map(of).collect()
}

fn plot_json(plot: &Plot) -> Value {
    let every = plot.x.len().div_ceil(MAX_POINTS).max(1);
    let curves = plot.curves.iter().map(|curve| {
        let unit = curve.name.strip_prefix("w_");
        let named = unit.and_then(unit_words::plain);
        json!({
            "name": named.as_ref().map_or(&curve.name, |name| name),
            "unit": unit,
            "values": thinned(&curve.values, every),
        })
    });
    let x = plot.x.iter().step_by(every).map(|&x| rounded(x));
    json!({
        "title": plot.title,
        "x": x.collect::<Vec<_>>(),
        "least": plot.at_least,
        "every": every,
        "curves": curves.collect::<Vec<_>>(),
    })
}

impl Album {
    /// The page as HTML.
    pub fn html(&self) -> String {
        let title = escaped(&self.title);
        let mut html = format!(
            "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\">\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"><title>{title}</title>\
             <style>{}{STYLE}</style></head><body><header><b>{title}</b></header>",
            preview::LOOK
        );
        let plays = !self.plots.is_empty() && self.plots.iter().all(|plot| plot.x_name == SECONDS);
        let figures = self.facts_html() + &self.table_html();
        match plays {
            true => {
                html += &BODY.replace("<!-- figures -->", &figures);
                // Escaped so that no text ends the element.
                let data = self.timeline().to_string().replace("</", "<\\/");
                let _ = write!(
                    html,
                    "<script type=\"application/json\" id=\"data\">{data}</script>\
                     <script type=\"module\">{}{}{SCRIPT}</script>",
                    preview::UNITS,
                    preview::DRAWING
                );
            }
            false => {
                html += &format!("<main class=\"still\">{figures}<div class=\"pictures\">");
                for (caption, picture) in &self.pictures {
                    let (caption, source) = (escaped(caption), data_uri("png", &png(picture)));
                    let _ = write!(
                        html,
                        "<figure><img alt=\"{caption}\" src=\"{source}\"><figcaption>{caption}</figcaption></figure>"
                    );
                }
                html += "</div>";
                for plot in &self.plots {
                    let (title, svg) = (escaped(&plot.title), plot.svg());
                    let _ = write!(html, "<h2>{title}</h2><div class=\"paper\">{svg}</div>");
                }
                html += "</main>";
            }
        }
        html + "</body></html>\n"
    }

    fn facts_html(&self) -> String {
        let row = |(name, value): &(String, String)| {
            let (name, value) = (escaped(name), escaped(value));
            format!("<div><dt>{name}</dt><dd>{value}</dd></div>")
        };
        let rows: String = self.facts.iter().map(row).collect();
        format!("<dl>{rows}</dl>")
    }

    fn table_html(&self) -> String {
        let Some((header, rows)) = self.table.split_first() else {
            return String::new();
        };
        let row = |row: &Vec<String>| format!("<tr>{}</tr>", cells("td", row));
        let (header, rows) = (cells("th", header), rows.iter().map(row));
        let rows: String = rows.collect();
        format!("<h2>Values</h2><div class=\"wide\"><table><tr>{header}</tr>{rows}</table></div>")
    }

    /// The contents of the player, as JSON.
    fn timeline(&self) -> Value {
        let frames = self.frames.iter().map(|frame| {
            json!({
                "t": rounded(frame.seconds),
                "n": frame.number,
                "colour": frame.colour.as_ref().map(|bytes| data_uri("jpeg", bytes)),
                "depth": data_uri("jpeg", &frame.depth),
            })
        });
        let colours = mien_workbench::canvas::DEPTHS.map(|[r, g, b]| format!("rgb({r}, {g}, {b})"));
        json!({
            "frames": frames.collect::<Vec<_>>(),
            "faces": self.faces,
            "key": self.depth_key,
            "colours": colours,
            "plots": self.plots.iter().map(plot_json).collect::<Vec<_>>(),
        })
    }
}

#[cfg(test)]
mod tests {
    use image::RgbImage;

    use super::*;
    use crate::chart::Curve;

    fn album(x_name: &str) -> Album {
        let blink = |i: usize| Some(if i == 7001 { 1.0 } else { 0.1 });
        Album {
            title: "a <b> & c</script>".into(),
            plots: vec![Plot {
                title: "one</script>".into(),
                x: (0..10_000).map(f64::from).collect(),
                x_name: x_name.into(),
                curves: vec![Curve {
                    name: "w_AU43L".into(),
                    values: (0..10_000).map(blink).collect(),
                }],
                at_least: None,
            }],
            pictures: vec![("p".into(), RgbImage::new(20, 10))],
            ..Album::default()
        }
    }

    #[test]
    fn the_page_stands_alone_and_escapes() {
        for (x_name, scripts) in [("s", 2), ("mode", 0)] {
            let html = album(x_name).html();
            assert!(html.contains("a &lt;b&gt; &amp; c&lt;/script&gt;"));
            let without = html.replace("http://www.w3.org/2000/svg", "");
            assert!(!without.contains("http:") && !without.contains("https:"));
            assert_eq!(html.matches("</script>").count(), scripts, "{x_name}");
            let still = html.contains("data:image/png;base64,iVBOR");
            assert_eq!(still, scripts == 0, "{x_name}");
        }
    }

    #[test]
    fn a_blink_of_one_frame_is_seen_in_a_long_curve() {
        let plot = plot_json(&album("s").plots[0]);
        let curve = &plot["curves"][0];
        let values = curve["values"].as_array().unwrap();
        assert_eq!((values.len(), &plot["every"]), (3334, &json!(3)));
        assert_eq!(plot["x"].as_array().unwrap().len(), values.len());
        let ones = values.iter().filter(|value| value.as_f64() == Some(1.0));
        assert_eq!(ones.count(), 1);
        assert_eq!(
            (&curve["name"], &curve["unit"]),
            (&json!("blink left"), &json!("AU43L"))
        );
    }
}
