//! Curves over a common axis, as SVG or as a picture, and words on pictures.
//!
//! Drawn by `plotters` with DejaVu Sans from its crate, so that no font of the system is needed and pictures are the same
//! everywhere.

use std::sync::Once;

use image::{Rgb, RgbImage};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::register_font;

/// One curve, with gaps where values are missing.
pub struct Curve {
    /// Legend.
    pub name: String,
    /// One value per x coordinate of the plot.
    pub values: Vec<Option<f64>>,
}

/// Curves over a common axis.
pub struct Plot {
    /// Heading; not drawn.
    pub title: String,
    /// X coordinates, ascending.
    pub x: Vec<f64>,
    /// Name and unit of the x axis.
    pub x_name: String,
    /// Curves.
    pub curves: Vec<Curve>,
    /// Lowest and highest value shown at least.
    pub at_least: Option<(f64, f64)>,
}

/// Colours of curves, distinguishable by the colour-blind (Okabe & Ito 2008).
const CURVES: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(90, 90, 90),
];

/// Size of a plot, pixels.
const PLOT: (u32, u32) = (900, 190);
/// Most points that a plot resolves; longer curves are drawn by their extremes.
const MAX_POINTS: usize = 1600;
/// Oversampling of an SVG, whose backend rounds to whole pixels.
const FINER: u32 = 4;

/// A text style of a height in pixels.
fn letters(size: u32, colour: RGBColor) -> TextStyle<'static> {
    static FONT: Once = Once::new();
    FONT.call_once(|| {
        let font = register_font("sans-serif", FontStyle::Normal, dejavu::sans::regular());
        assert!(font.is_ok(), "the font is compiled in");
    });
    ("sans-serif", size).into_font().color(&colour)
}

/// Writes a line of text with its top left corner at `x`, `y`, clipped to the picture.
pub fn text(picture: &mut RgbImage, [x, y]: [u32; 2], size: u32, words: &str, colour: [u8; 3]) {
    let [r, g, b] = colour;
    let pixels = picture.dimensions();
    let mut backend = BitMapBackend::with_buffer(picture, pixels);
    let style = letters(size, RGBColor(r, g, b));
    let drawn = backend.draw_text(words, &style, (x as i32, y as i32));
    drawn.expect("memory takes every pixel");
}

/// Width of a line of text, pixels.
pub fn text_width(size: u32, words: &str) -> u32 {
    let measured = letters(size, BLACK).font.box_size(words);
    measured.expect("the font is compiled in").0
}

/// Smallest and largest of finite values.
fn extremes(values: impl IntoIterator<Item = f64>) -> Option<(f64, f64)> {
    let values = values.into_iter().filter(|v| v.is_finite());
    let pairs = values.map(|v| (v, v));
    pairs.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

/// Limits of an axis that shows these values, never equal.
pub(crate) fn span(values: impl IntoIterator<Item = f64>) -> (f64, f64) {
    match extremes(values) {
        Some((low, high)) if low < high => (low, high),
        Some((low, _)) => (low - 0.5, low + 0.5),
        None => (0.0, 1.0),
    }
}

impl Plot {
    /// Runs of connected points of a curve.
    fn runs(&self, curve: &Curve) -> Vec<Vec<(f64, f64)>> {
        let bucket = self.x.len().div_ceil(MAX_POINTS).max(1);
        let mut runs = vec![Vec::new()];
        for (xs, values) in self.x.chunks(bucket).zip(curve.values.chunks(bucket)) {
            let whole = values.iter().flatten().all(|v| v.is_finite());
            let known = extremes(values.iter().copied().flatten());
            match known.filter(|_| whole && values.iter().all(Option::is_some)) {
                // Both extremes, so that a blink of one frame remains visible in an hour's curve.
                Some((low, high)) => {
                    let run = runs.last_mut().expect("never empty");
                    run.push((xs[0], low));
                    if high > low {
                        run.push((xs[0], high));
                    }
                }
                None => runs.push(Vec::new()),
            }
        }
        runs
    }

    fn draw<B: DrawingBackend>(
        &self,
        root: DrawingArea<B, Shift>,
        scale: u32,
    ) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
        let grey = RGBColor(90, 90, 90);
        let shown = self.curves.iter().flat_map(|curve| &curve.values).flatten();
        let least = self.at_least.map(|(low, high)| [low, high]);
        let (low, high) = span(shown.copied().chain(least.into_iter().flatten()));
        let (first, last) = span(self.x.iter().copied());
        root.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&root)
            .margin_top(18 * scale)
            .margin_right(10 * scale)
            .x_label_area_size(30 * scale)
            .y_label_area_size(56 * scale)
            .build_cartesian_2d(first..last, low..high)?;
        chart
            .configure_mesh()
            .y_labels(5)
            .max_light_lines(0)
            .bold_line_style(BLACK.mix(0.1).stroke_width(scale))
            .axis_style(grey.mix(0.6).stroke_width(scale))
            .label_style(letters(11 * scale, grey))
            .axis_desc_style(letters(11 * scale, grey))
            .x_desc(&self.x_name)
            .draw()?;
        let mut left = 60 * scale;
        for (curve, colour) in self.curves.iter().zip(CURVES.iter().cycle()) {
            let line = colour.stroke_width(scale);
            for run in self.runs(curve) {
                chart.draw_series(LineSeries::new(run, line))?;
            }
            let style = letters(12 * scale, *colour);
            root.draw_text(&curve.name, &style, (left as i32, 2 * scale as i32))?;
            left += root.estimate_text_size(&curve.name, &style)?.0 + 14 * scale;
        }
        root.present()
    }

    /// An SVG, to be shown [`FINER`] times smaller.
    pub(crate) fn svg(&self) -> String {
        let mut svg = String::new();
        let size = (FINER * PLOT.0, FINER * PLOT.1);
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        self.draw(root, FINER).expect("memory takes every line");
        svg
    }

    /// A picture of [`PLOT`].
    pub(crate) fn picture(&self) -> RgbImage {
        let mut picture = RgbImage::from_pixel(PLOT.0, PLOT.1, Rgb([255; 3]));
        let root = BitMapBackend::with_buffer(&mut picture, PLOT).into_drawing_area();
        self.draw(root, 1).expect("memory takes every pixel");
        picture
    }
}
