//! How a person's ranges were learned in a recording: each measure's value with low, rest and high over time, and the final
//! contents of its store: one line per node, its height the square root of its time, so that rare ends are visible.
//!
//! Units: inner-eye-corner distances, seconds.

use image::{Rgb, RgbImage};

use super::album::{Album, Curve, Plot};
use super::canvas;
use crate::base::capacity::LEARNT_MEASURES;
use crate::base::frames::SensorFromFace;
use crate::base::geometry::Rigid;
use crate::base::time::Timestamp;
use crate::expression::{Expression, Measure, Settings, Units};
use crate::landmarks::Landmarks;

/// Picture of a store: height of a row, left margin for names, width of the scale, pixels.
const ROW: u32 = 44;
const LEFT: u32 = 230;
const WIDE: u32 = 620;
const REST: [u8; 3] = [40, 110, 200];
const ENDS: [u8; 3] = [200, 90, 40];

/// Names of a measure's curves.
const CURVES: [&str; 4] = ["value", "low", "rest", "high"];

/// Learns along with the stages and keeps what it is shown.
pub(super) struct Learning {
    expression: Expression,
    t: Vec<f64>,
    curves: Vec<[Vec<Option<f64>>; 4]>,
}

impl Learning {
    pub(super) fn new(settings: Settings) -> Self {
        Self {
            expression: Expression::new(settings, Units::shipped()),
            t: Vec::new(),
            curves: vec![Default::default(); LEARNT_MEASURES],
        }
    }

    /// Takes a frame, with or without a face.
    pub(super) fn observe(&mut self, at: Timestamp, face: Option<(&Landmarks, &Rigid)>) {
        self.t.push(at.as_us() as f64 * 1e-6);
        if let Some((landmarks, sensor_from_head)) = face {
            let sensor_from_face = SensorFromFace::of(*sensor_from_head);
            self.expression.observe(landmarks, &sensor_from_face, at);
        }
        let (values, ranges) = (self.expression.corrected(), self.expression.ranges());
        for (m, curves) in self.curves.iter_mut().enumerate() {
            let range = ranges[m];
            let known = [values[m], range.low, range.rest, range.high];
            for (curve, value) in curves.iter_mut().zip(known) {
                curve.push(face.is_some().then_some(value));
            }
        }
    }

    /// Adds plots and the picture of the stores.
    pub(super) fn show(self, album: &mut Album) {
        let caption = "What is kept of each measure: blue, seconds that tell of rest; brown, of the ends; \
            height is their root; marks are low, rest and high";
        album.pictures.push((caption.into(), self.stores()));
        for (measure, curves) in Measure::ALL.iter().zip(self.curves) {
            album.plots.push(Plot {
                title: format!("{}, with its learned range", measure.name()),
                x: self.t.clone(),
                x_name: "s".into(),
                curves: CURVES
                    .iter()
                    .zip(curves)
                    .map(|(&name, values)| Curve {
                        name: name.into(),
                        values,
                    })
                    .collect(),
                at_least: None,
            });
        }
    }

    fn stores(&self) -> RgbImage {
        let height = ROW * LEARNT_MEASURES as u32 + 8;
        let mut picture = RgbImage::from_pixel(LEFT + WIDE + 16, height, Rgb([255; 3]));
        let ranges = self.expression.ranges();
        for (m, range) in ranges.iter().enumerate() {
            let bottom = (ROW * (m as u32 + 1)) as f32;
            canvas::text(
                &mut picture,
                6,
                bottom as u32 - 24,
                2,
                Measure::ALL[m].name(),
                [60; 3],
            );
            let nodes: Vec<_> = self.expression.history(m).collect();
            let ends = nodes.first().zip(nodes.last());
            let (first, last) = ends.map_or((range.low, range.high), |(a, b)| (a[0], b[0]));
            let (low, high) = (first.min(range.low), last.max(range.high));
            let x = |value: f64| {
                LEFT as f32 + ((value - low) / (high - low).max(1e-6)) as f32 * WIDE as f32
            };
            let most = nodes
                .iter()
                .flat_map(|node| [node[1], node[2]])
                .fold(1e-9, f64::max);
            let mut bar = |at: f32, seconds: f64, colour: [u8; 3]| {
                let up = (seconds / most).max(0.0).sqrt() as f32 * (ROW - 10) as f32;
                canvas::line(
                    &mut picture,
                    [at, bottom],
                    [at, bottom - up.max(1.0)],
                    colour,
                );
            };
            for [value, rest, ends] in nodes {
                bar(x(value) - 1.0, rest, REST);
                bar(x(value) + 1.0, ends, ENDS);
            }
            for bound in [range.low, range.rest, range.high] {
                canvas::line(
                    &mut picture,
                    [x(bound), bottom],
                    [x(bound), bottom + 4.0],
                    [20; 3],
                );
            }
        }
        picture
    }
}
