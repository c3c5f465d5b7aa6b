//! Drawing on RGB pictures: lines, dots, faces and false colour.
//!
//! Everything is clipped to the picture. Pixel centres are integers, as in all of the project.

use image::{Rgb, RgbImage};

use mien_stages::base::capacity::LANDMARKS;

/// A colour.
pub type Colour = [u8; 3];

/// Dark blue (0) over purple and orange to light yellow (1), with ascending lightness; `share` is clamped.
pub fn false_colour(share: f32) -> Colour {
    let t = share.clamp(0.0, 1.0) * (DEPTHS.len() - 1) as f32;
    let k = (t as usize).min(DEPTHS.len() - 2);
    let along = t - k as f32;
    let [from, to] = [DEPTHS[k], DEPTHS[k + 1]];
    std::array::from_fn(|c| (f32::from(from[c]) * (1.0 - along) + f32::from(to[c]) * along) as u8)
}

/// Colours from far to near, with equal steps of lightness.
pub const DEPTHS: [Colour; 7] = [
    [26, 20, 84],
    [84, 26, 134],
    [142, 36, 132],
    [198, 58, 104],
    [238, 108, 66],
    [250, 172, 56],
    [246, 240, 150],
];

/// Sets one pixel, if it is in the picture.
pub fn dot(picture: &mut RgbImage, x: f32, y: f32, colour: Colour) {
    let (x, y) = (x.round(), y.round());
    if x >= 0.0 && y >= 0.0 && x < picture.width() as f32 && y < picture.height() as f32 {
        picture.put_pixel(x as u32, y as u32, Rgb(colour));
    }
}

/// Fills from one corner to the other, both included; nothing if one is not finite.
pub fn fill(picture: &mut RgbImage, from: [f32; 2], to: [f32; 2], colour: Colour) {
    let span = |k: usize, end: u32| {
        let [low, high] = [from[k], to[k] + 1.0].map(|at| at.round().clamp(0.0, end as f32));
        low as u32..high as u32
    };
    let (columns, rows) = (span(0, picture.width()), span(1, picture.height()));
    for y in rows {
        for x in columns.clone() {
            picture.put_pixel(x, y, Rgb(colour));
        }
    }
}

/// A filled square about a point.
pub fn square(picture: &mut RgbImage, x: f32, y: f32, half: i32, colour: Colour) {
    let half = half as f32;
    fill(picture, [x - half, y - half], [x + half, y + half], colour);
}

/// A line of one pixel; ends that are not finite draw nothing.
pub fn line(picture: &mut RgbImage, from: [f32; 2], to: [f32; 2], colour: Colour) {
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let steps = dx.abs().max(dy.abs()).ceil();
    // A line beyond any picture is a broken number, not a drawing.
    if !steps.is_finite() || steps > 20_000.0 {
        return;
    }
    for i in 0..=steps as u32 {
        let t = if steps > 0.0 { i as f32 / steps } else { 0.0 };
        dot(picture, from[0] + t * dx, from[1] + t * dy, colour);
    }
}

/// The outline of a rectangle.
pub fn frame(picture: &mut RgbImage, [x0, y0]: [f32; 2], [x1, y1]: [f32; 2], colour: Colour) {
    let corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
    for k in 0..4 {
        line(picture, corners[k], corners[(k + 1) % 4], colour);
    }
}

/// The lines of a face and its landmarks, green where they are trusted and red where not.
pub fn landmarks(
    picture: &mut RgbImage,
    points: &[[f32; 2]; LANDMARKS],
    confidence: &[f32; LANDMARKS],
) {
    for [a, b] in face_lines() {
        line(picture, points[a], points[b], [0, 190, 255]);
    }
    for ([x, y], confidence) in points.iter().zip(confidence) {
        let strong = (confidence.clamp(0.0, 1.0) * 255.0) as u8;
        square(picture, *x, *y, 1, [255 - strong, strong, 0]);
    }
}

/// Pairs of landmarks that a drawing of a face connects.
pub fn face_lines() -> impl Iterator<Item = [usize; 2]> {
    let open = [0..17, 17..22, 22..27, 27..31, 31..36];
    let closed = [36..42, 42..48, 48..60, 60..68];
    let ends = closed.clone().map(|run| [run.end - 1, run.start]);
    let along = open.into_iter().chain(closed);
    along
        .flat_map(|run| (run.start + 1..run.end).map(|i| [i - 1, i]))
        .chain(ends)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn drawing_is_clipped() {
        let mut picture = RgbImage::new(8, 8);
        line(&mut picture, [-50.0, 3.0], [50.0, 3.0], [255; 3]);
        line(&mut picture, [f32::NAN, 0.0], [f32::INFINITY, 3.0], [9; 3]);
        square(&mut picture, 7.0, 7.0, 3, [1, 2, 3]);
        assert!((0..8).all(|x| picture.get_pixel(x, 3).0 == [255; 3]));
        assert_eq!(picture.get_pixel(4, 4).0, [1, 2, 3]);
        assert_eq!(picture.get_pixel(3, 2).0, [0; 3]);
    }

    #[test]
    fn false_colour_is_lighter_the_nearer() {
        let light = |share: f32| {
            let [r, g, b] = false_colour(share).map(f32::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        let shares = (0..=20).map(|k| k as f32 / 20.0);
        let lights: Vec<f32> = shares.map(light).collect();
        assert!(lights.windows(2).all(|w| w[1] > w[0] + 4.0), "{lights:?}");
        assert_eq!((light(-1.0), light(2.0)), (lights[0], lights[20]));
    }
}
