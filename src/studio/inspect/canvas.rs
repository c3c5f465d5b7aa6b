//! Drawing on RGB pictures: lines, dots, curves, false colour, and letters of 3 × 5 pixels.
//!
//! Everything is clipped to the picture. Pixel centres are integers, as in all of the project.

use image::{Rgb, RgbImage};

/// A colour.
pub type Colour = [u8; 3];

/// Colours of curves, told apart also by the colour-blind (Okabe & Ito 2008).
pub const CURVES: [Colour; 7] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [230, 159, 0],
    [86, 180, 233],
    [90, 90, 90],
];

/// Height of a letter with its gap, at scale 1.
pub const LETTER_HEIGHT: u32 = 7;
/// Width of a letter with its gap, at scale 1.
pub const LETTER_WIDTH: u32 = 4;

/// Blue (0) over green to red (1); outside is cut.
#[must_use]
pub fn false_colour(share: f32) -> Colour {
    let t = share.clamp(0.0, 1.0);
    // Three overlapping triangles: the eye sees steps of depth at every hue.
    let channel = |centre: f32| ((1.5 - (4.0 * t - centre).abs()).clamp(0.0, 1.0) * 255.0) as u8;
    [channel(3.0), channel(2.0), channel(1.0)]
}

/// Sets one pixel, if it is in the picture.
pub fn dot(picture: &mut RgbImage, x: f32, y: f32, colour: Colour) {
    let (x, y) = (x.round(), y.round());
    if x >= 0.0 && y >= 0.0 && x < picture.width() as f32 && y < picture.height() as f32 {
        picture.put_pixel(x as u32, y as u32, Rgb(colour));
    }
}

/// A filled square about a point.
pub fn square(picture: &mut RgbImage, x: f32, y: f32, half: i32, colour: Colour) {
    for dy in -half..=half {
        for dx in -half..=half {
            dot(picture, x + dx as f32, y + dy as f32, colour);
        }
    }
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
pub fn frame(picture: &mut RgbImage, x0: f32, y0: f32, x1: f32, y1: f32, colour: Colour) {
    for (a, b) in [
        ([x0, y0], [x1, y0]),
        ([x1, y0], [x1, y1]),
        ([x1, y1], [x0, y1]),
        ([x0, y1], [x0, y0]),
    ] {
        line(picture, a, b, colour);
    }
}

/// Rows of a letter, three bits each, the left one highest.
const fn letter(c: char) -> [u8; 5] {
    match c {
        '0' | 'O' => [7, 5, 5, 5, 7],
        '1' => [2, 6, 2, 2, 7],
        '2' => [7, 1, 7, 4, 7],
        '3' => [7, 1, 7, 1, 7],
        '4' => [5, 5, 7, 1, 1],
        '5' | 'S' => [7, 4, 7, 1, 7],
        '6' => [7, 4, 7, 5, 7],
        '7' => [7, 1, 1, 2, 2],
        '8' => [7, 5, 7, 5, 7],
        '9' => [7, 5, 7, 1, 7],
        'A' => [2, 5, 7, 5, 5],
        'B' => [6, 5, 6, 5, 6],
        'C' => [7, 4, 4, 4, 7],
        'D' => [6, 5, 5, 5, 6],
        'E' => [7, 4, 6, 4, 7],
        'F' => [7, 4, 6, 4, 4],
        'G' => [7, 4, 5, 5, 7],
        'H' => [5, 5, 7, 5, 5],
        'I' => [7, 2, 2, 2, 7],
        'J' => [1, 1, 1, 5, 7],
        'K' => [5, 5, 6, 5, 5],
        'L' => [4, 4, 4, 4, 7],
        'M' => [5, 7, 7, 5, 5],
        'N' => [6, 5, 5, 5, 5],
        'P' => [7, 5, 7, 4, 4],
        'Q' => [7, 5, 5, 7, 1],
        'R' => [6, 5, 6, 5, 5],
        'T' => [7, 2, 2, 2, 2],
        'U' => [5, 5, 5, 5, 7],
        'V' => [5, 5, 5, 5, 2],
        'W' => [5, 5, 7, 7, 5],
        'X' => [5, 5, 2, 5, 5],
        'Y' => [5, 5, 2, 2, 2],
        'Z' => [7, 1, 2, 4, 7],
        '_' => [0, 0, 0, 0, 7],
        '-' => [0, 0, 7, 0, 0],
        '+' => [0, 2, 7, 2, 0],
        '.' => [0, 0, 0, 0, 2],
        ',' => [0, 0, 0, 2, 4],
        ':' => [0, 2, 0, 2, 0],
        '/' => [1, 1, 2, 4, 4],
        '%' => [5, 1, 2, 4, 5],
        '(' => [1, 2, 2, 2, 1],
        ')' => [4, 2, 2, 2, 4],
        _ => [0; 5],
    }
}

/// Writes a line of text with its top left corner at `x`, `y`; small letters become capitals, unknown ones gaps.
pub fn text(picture: &mut RgbImage, x: u32, y: u32, scale: u32, words: &str, colour: Colour) {
    for (k, c) in words.chars().enumerate() {
        let left = x + k as u32 * LETTER_WIDTH * scale;
        for (row, bits) in letter(c.to_ascii_uppercase()).into_iter().enumerate() {
            for column in (0..3).filter(|column| bits & (4 >> column) != 0) {
                for dy in 0..scale {
                    for dx in 0..scale {
                        let px = left + column * scale + dx;
                        let py = y + row as u32 * scale + dy;
                        dot(picture, px as f32, py as f32, colour);
                    }
                }
            }
        }
    }
}

/// Pairs of landmarks that a drawing of a face connects.
pub(in crate::studio) fn face_lines() -> impl Iterator<Item = [usize; 2]> {
    let open = [0..17, 17..22, 22..27, 27..31, 31..36]
        .into_iter()
        .flat_map(|run| (run.start..run.end - 1).map(|i| [i, i + 1]));
    let closed = [36..42, 42..48, 48..60, 60..68]
        .into_iter()
        .flat_map(|run| {
            run.clone()
                .map(move |i| [i, if i + 1 == run.end { run.start } else { i + 1 }])
        });
    open.chain(closed)
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
        text(&mut picture, 6, 6, 2, "gross", [4; 3]);
        assert!((0..8).all(|x| picture.get_pixel(x, 3).0 == [255; 3]));
        assert_eq!(picture.get_pixel(4, 4).0, [1, 2, 3]);
        assert_eq!(picture.get_pixel(3, 2).0, [0; 3]);
    }

    #[test]
    fn false_colour_runs_from_blue_to_red() {
        let (near, middle, far) = (false_colour(1.0), false_colour(0.5), false_colour(0.0));
        assert!(
            near[0] > near[2] && far[2] > far[0] && middle[1] == 255,
            "{near:?} {middle:?} {far:?}"
        );
    }
}
