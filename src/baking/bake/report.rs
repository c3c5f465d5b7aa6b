//! The report: one HTML file with the verdict, a rendering of every shape with its defects, and figures on leakage,
//! lids and lips.

use std::fmt::Write as _;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use image::RgbImage;
use nalgebra::{Matrix3, Rotation3};
use rayon::prelude::*;

use super::eyeball::Ball;
use super::head::{Follow, Head};
use super::mesh::Vec3;
use super::render::Outside;
use super::shape::{Shape, shown};
use super::verdict::verdict;
use mien_workbench::picture_files::jpeg;

/// Figures of one shape. Lengths in eye distances.
#[derive(Clone, Debug, Default)]
pub struct Figures {
    /// Largest displacement.
    pub largest: f64,
    /// Largest displacement of a vertex outside the area of influence.
    pub outside: f64,
    /// Vertices that move.
    pub moved: usize,
    /// How much deeper than in the neutral a skin vertex lies in an eyeball.
    pub eye_depth: f64,
    /// Widest gap left between the lid lines of an eye that the shape closes.
    pub lid_gap: Option<f64>,
    /// Deepest crossing of the inner lip lines, beyond what the neutral has.
    pub lips_cross: f64,
}

/// Figures of shape `k`, together with the shape that it is added to.
pub fn figures(head: &Head, shapes: &[Shape], k: usize) -> Figures {
    let (shape, w) = (&shapes[k], head.eye_distance);
    let neutral = &head.mesh.positions;
    let moved = neutral.iter().zip(shown(shapes, k));
    let moved: Vec<Vec3> = moved.map(|(p, d)| p + d).collect();
    let at = |v: u32| moved[v as usize];
    let mut out = Figures::default();
    for (d, inside) in shape.displacement.iter().zip(&shape.area) {
        let length = d.norm() / w;
        out.largest = out.largest.max(length);
        out.moved += usize::from(length > 0.0);
        if !inside {
            out.outside = out.outside.max(length);
        }
    }
    for (side, closes) in ["eyeBlinkLeft", "eyeBlinkRight"].into_iter().enumerate() {
        let Some(ball) = &head.balls[side] else {
            continue;
        };
        let depth = eye_depth(head, side, ball, &moved);
        out.eye_depth = out.eye_depth.max(depth / w);
        if shape.name == closes {
            out.lid_gap = Some(head.lid_gap(side, at) / w);
        }
    }
    let before = head.lip_gaps(|v| neutral[v as usize]);
    for ((.., before), (.., now)) in before.into_iter().zip(head.lip_gaps(at)) {
        let crossing = (-now).max(0.0) - (-before).max(0.0);
        out.lips_cross = out.lips_cross.max(crossing / w);
    }
    out
}

/// Increase of the skin's depth in an eyeball with vertices at `moved`.
fn eye_depth(head: &Head, side: usize, ball: &Ball, moved: &[Vec3]) -> f64 {
    let turned = ball.turned(gaze(head, side, ball, moved).as_ref());
    let reach = 0.75 * head.eye_distance;
    let places = head.mesh.positions.iter().zip(moved).zip(&head.skin);
    let near = places.filter(|((p, now), skin)| {
        let before = (*now - ball.center).dot(&head.axes.column(2)) > 0.0;
        **skin && before && (*p - ball.center).norm() < reach
    });
    near.map(|((p, now), _)| (-turned.height(now)).max(0.0) - (-ball.height(p)).max(0.0))
        .fold(0.0, f64::max)
}

/// Rotation of an eyeball with vertices at `moved`.
fn gaze(head: &Head, side: usize, ball: &Ball, moved: &[Vec3]) -> Option<Rotation3<f64>> {
    let mut sum = Matrix3::zeros();
    let mut turns = false;
    for (v, p) in head.mesh.positions.iter().enumerate() {
        if head.follow[v] == Follow::Eyeball(side) {
            turns |= moved[v] != *p;
            sum += (moved[v] - ball.center) * (p - ball.center).transpose();
        }
    }
    turns.then(|| Rotation3::from_matrix(&sum))
}

/// Yaw of the head in its renderings, radians.
const YAW: f64 = 0.35;
const PIXELS: u32 = 300;
const JPEG_QUALITY: u8 = 75;

fn embedded(picture: &RgbImage) -> String {
    let jpeg = STANDARD.encode(jpeg(picture, JPEG_QUALITY));
    format!("data:image/jpeg;base64,{jpeg}")
}

fn number(value: f64) -> String {
    if value == 0.0 {
        "0".into()
    } else {
        format!("{value:.4}")
    }
}

const STYLE: &str = "<!doctype html><meta charset=\"utf-8\"><title>Baked shapes</title><style>\
    body{font:14px/1.4 system-ui,sans-serif;margin:2em;background:#f6f6f4;color:#222}\
    .sheet{display:grid;grid-template-columns:repeat(auto-fill,minmax(220px,1fr));gap:10px}\
    figure{margin:0;background:#fff;border-radius:6px;overflow:hidden}figure img{width:100%;display:block}\
    figcaption{padding:4px 8px}table{border-collapse:collapse;margin:2em 0;background:#fff}\
    td,th{padding:3px 10px;border-bottom:1px solid #ddd;text-align:right}\
    td:first-child,th:first-child{text-align:left}.bad{background:#fbd3c8}</style>";

/// The report as HTML, and its figures; `defects` are those of every shape, `notes` are title and remarks.
pub fn html(
    head: &Head,
    drawn: &Outside,
    shapes: &[Shape],
    defects: &[Vec<String>],
    [title, notes]: [&str; 2],
) -> (String, Vec<Figures>) {
    let one = |k: usize| {
        let picture = drawn.draw(head, &shown(shapes, k), YAW, PIXELS);
        (figures(head, shapes, k), embedded(&picture))
    };
    let all = (0..shapes.len()).into_par_iter().map(one);
    let (figures, pictures): (Vec<Figures>, Vec<String>) = all.unzip();
    let (count, vertices) = (shapes.len(), head.mesh.positions.len());
    let neutral = embedded(&drawn.draw(head, &[], YAW, PIXELS));
    let mut out = format!(
        "{STYLE}<h1>{title}</h1><p><b>{}</b></p><p>{notes}</p><p>{count} shapes on {vertices} vertices. \
         Lengths are in distances between the inner eye corners. A shape made to be added to another one is shown and \
         judged upon it.</p><div class=\"sheet\">\
         <figure><img alt=\"neutral\" src=\"{neutral}\"><figcaption>neutral</figcaption></figure>",
        verdict(shapes, defects)
    );
    for ((Shape { name, unit, .. }, picture), defects) in shapes.iter().zip(&pictures).zip(defects)
    {
        let (unit, defects) = (unit.as_deref().unwrap_or(""), defects.join("; "));
        let class = marked(!defects.is_empty());
        let _ = write!(
            out,
            "<figure><img alt=\"{name}\" src=\"{picture}\"><figcaption{class}><b>{name}</b> {unit} {defects}</figcaption></figure>"
        );
    }
    out += "</div>";
    table(&mut out, shapes, &figures);
    (out, figures)
}

fn marked(bad: bool) -> &'static str {
    if bad { " class=\"bad\"" } else { "" }
}

/// A row of figures for every shape; bad values are marked.
fn table(out: &mut String, shapes: &[Shape], figures: &[Figures]) {
    *out += "<table><tr><th>shape<th>unit<th>largest<th>outside AOI<th>vertices\
        <th>deeper in eye<th>lid gap<th>lips cross</tr>";
    let some = |v: Option<f64>| v.map_or_else(String::new, number);
    for (shape, f) in shapes.iter().zip(figures) {
        let cells = [
            (shape.name.clone(), false),
            (shape.unit.clone().unwrap_or_default(), false),
            (number(f.largest), false),
            (number(f.outside), f.outside > 0.0),
            (f.moved.to_string(), false),
            (number(f.eye_depth), f.eye_depth > 1e-3),
            (some(f.lid_gap), f.lid_gap > Some(0.02)),
            (number(f.lips_cross), f.lips_cross > 0.01),
        ];
        for (text, bad) in cells {
            let class = marked(bad);
            let _ = write!(out, "<td{class}>{text}");
        }
        *out += "</tr>";
    }
    *out += "</table>";
}

/// The worst of all shapes' figures, in words.
pub(super) fn worst(figures: &[Figures]) -> String {
    let outside = figures.iter().map(|f| f.outside).fold(0.0, f64::max);
    let depth = figures.iter().map(|f| f.eye_depth).fold(0.0, f64::max);
    format!(
        "largest motion outside its area {outside}, lids at most {depth:.5} eye distances deeper in the eye"
    )
}
