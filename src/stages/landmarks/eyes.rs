//! Eye patches: cut from the colour image, rotated upright, normalised in brightness.
//!
//! No landmark marks the iris, and lids move by less than the landmarks' error, but the 20 pixels of an eye at 0.75 m show
//! both. Each eye is resampled around the midpoint of its corners, x along the line through both eyes, 1.1 eye widths wide; the
//! left one is mirrored. Grey values are normalised to zero mean and unit deviation, which cancels light and skin. Cost:
//! 2 × 144 × 4 bilinear samples, some 10 µs. Degenerate: eyes under 15 pixels wide or without contrast give `None`.

use super::window::LumaImage;
use crate::base::capacity::LANDMARKS;
#[cfg(not(feature = "std"))]
use crate::base::prelude::*;

/// Columns of an eye patch.
pub const ACROSS: usize = 16;
/// Rows of an eye patch.
pub const DOWN: usize = 9;
/// Cells of an eye patch.
pub const CELLS: usize = ACROSS * DOWN;
/// Patches of the subject's right and left eye, row by row from above, x from the temple to the nose; zero mean, unit deviation.
pub type Eyes = [[f32; CELLS]; 2];

/// Landmarks of the corners of the right and left eye, the one at the temple first.
const CORNERS: [[usize; 2]; 2] = [[36, 39], [45, 42]];
/// Width and height of a patch, eye widths.
const EXTENT: [f32; 2] = [1.1, 0.7];
/// Samples per cell and axis.
const SAMPLES: usize = 2;
/// Least width of an eye, colour pixels: about 1 m away.
const MIN_WIDTH_PX: f32 = 15.0;
/// Least standard deviation of the grey values.
const MIN_CONTRAST: f32 = 2.0;

/// Cuts both eye patches from an image, given the landmarks in its pixels; `None` if the eyes are too small or without contrast.
pub fn cut(image: &LumaImage, pixels: &[[f32; 2]; LANDMARKS]) -> Option<Eyes> {
    let between = |a: [f32; 2], b: [f32; 2]| [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0];
    let middles = CORNERS.map(|[temple, nose]| between(pixels[temple], pixels[nose]));
    let widths = CORNERS.map(|[a, b]| {
        let [dx, dy] = [pixels[b][0] - pixels[a][0], pixels[b][1] - pixels[a][1]];
        (dx * dx + dy * dy).sqrt()
    });
    let width = (widths[0] + widths[1]) / 2.0;
    let line = [middles[1][0] - middles[0][0], middles[1][1] - middles[0][1]];
    let length = (line[0] * line[0] + line[1] * line[1]).sqrt();
    if !(width >= MIN_WIDTH_PX && length >= MIN_WIDTH_PX) {
        return None;
    }
    let axis = [line[0] / length, line[1] / length];
    let mut eyes = [[0.0; CELLS]; 2];
    for ((eye, middle), to_nose) in eyes.iter_mut().zip(middles).zip([1.0, -1.0]) {
        for (at, cell) in eye.iter_mut().enumerate() {
            for fine in 0..SAMPLES * SAMPLES {
                let step = |cell: usize, fine: usize, cells: usize, extent: f32| {
                    let at = cell as f32 + (fine as f32 + 0.5) / SAMPLES as f32;
                    (at / cells as f32 - 0.5) * extent * width
                };
                let x = to_nose * step(at % ACROSS, fine % SAMPLES, ACROSS, EXTENT[0]);
                let y = step(at / ACROSS, fine / SAMPLES, DOWN, EXTENT[1]);
                *cell += image.bilinear(
                    middle[0] + x * axis[0] - y * axis[1],
                    middle[1] + x * axis[1] + y * axis[0],
                );
            }
        }
        normalise(eye)?;
    }
    Some(eyes)
}

/// Normalises a patch to mean 0 and deviation 1; `None` without contrast.
fn normalise(eye: &mut [f32; CELLS]) -> Option<()> {
    let n = CELLS as f32;
    let mean = eye.iter().sum::<f32>() / n;
    let deviation = (eye.iter().map(|v| (v - mean) * (v - mean)).sum::<f32>() / n).sqrt();
    if deviation < MIN_CONTRAST * (SAMPLES * SAMPLES) as f32 {
        return None;
    }
    for value in eye {
        *value = (*value - mean) / deviation;
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::capacity::{HEIGHT, PIXELS, WIDTH};

    /// A face whose eyes are 40 and 80 pixels right of column 200, turned about (250, 200), with a dark disc in each eye.
    fn face(turn: f32, aside: f32, width: f32) -> (Vec<u8>, [[f32; 2]; LANDMARKS]) {
        let turned = |x: f32, y: f32| {
            let (s, c) = turn.sin_cos();
            [250.0 + c * x - s * y, 200.0 + s * x + c * y]
        };
        let mut pixels = [[0.0; 2]; LANDMARKS];
        for (middle, [temple, nose], side) in [(-40.0, CORNERS[0], 1.0), (40.0, CORNERS[1], -1.0)] {
            pixels[temple] = turned(middle - side * width / 2.0, 0.0);
            pixels[nose] = turned(middle + side * width / 2.0, 0.0);
        }
        let mut luma = vec![200; PIXELS];
        for (at, grey) in luma.iter_mut().enumerate() {
            let (x, y) = ((at % WIDTH) as f32, (at / WIDTH) as f32);
            let dark = [-40.0, 40.0].map(|middle| turned(middle + aside, 0.0));
            if dark.iter().any(|[u, v]| (x - u).hypot(y - v) < width / 5.0) {
                *grey = 30;
            }
        }
        debug_assert_eq!(luma.len(), WIDTH * HEIGHT);
        (luma, pixels)
    }

    fn seen(turn: f32, aside: f32, width: f32) -> Option<Eyes> {
        let (luma, pixels) = face(turn, aside, width);
        let image = LumaImage {
            luma: &luma,
            width: WIDTH,
            height: HEIGHT,
        };
        cut(&image, &pixels)
    }

    /// Column of the dark middle, cells from the temple.
    fn iris(eye: &[f32; CELLS]) -> f32 {
        let dark = |at: usize| (-eye[at]).max(0.0);
        let total: f32 = (0..CELLS).map(dark).sum();
        (0..CELLS)
            .map(|at| dark(at) * (at % ACROSS) as f32)
            .sum::<f32>()
            / total
    }

    #[test]
    fn a_moving_iris_is_mirrored_between_the_eyes() {
        let straight = seen(0.0, 0.0, 30.0).expect("eyes");
        let aside = seen(0.0, 4.0, 30.0).expect("eyes");
        let middle = (ACROSS - 1) as f32 / 2.0;
        // A cell is 1.1 eye widths over 16.
        let moved = 4.0 / 30.0 / EXTENT[0] * ACROSS as f32;
        for (eye, expected) in [(&straight[0], 0.0), (&aside[0], moved), (&aside[1], -moved)] {
            assert!((iris(eye) - middle - expected).abs() < 0.3, "{expected}");
        }
    }

    #[test]
    fn a_tilted_face_has_the_same_eyes() {
        let straight = seen(0.0, 3.0, 30.0).expect("eyes");
        for turn in [0.4, -0.9] {
            let tilted = seen(turn, 3.0, 30.0).expect("eyes");
            let far = |e: usize| {
                let pairs = straight[e].iter().zip(&tilted[e]);
                (pairs.map(|(a, b)| (a - b).powi(2)).sum::<f32>() / CELLS as f32).sqrt()
            };
            assert!(far(0) < 0.3 && far(1) < 0.3, "{} {}", far(0), far(1));
        }
    }

    #[test]
    fn small_eyes_and_flat_images_give_none() {
        assert!(seen(0.0, 0.0, 14.0).is_none());
        let (_, pixels) = face(0.0, 0.0, 30.0);
        let plain = vec![90; PIXELS];
        let image = LumaImage {
            luma: &plain,
            width: WIDTH,
            height: HEIGHT,
        };
        assert!(cut(&image, &pixels).is_none());
    }
}
