//! Parts of pictures that several figures have.

use image::RgbImage;

use crate::landmarks::Landmarks;
use crate::sensor::kinect::frame::KinectFrame;
use crate::studio::chart;
use crate::studio::inspect::canvas;

/// The colour picture around a place (pixels), half as large again, with what is drawn on it.
pub(super) fn crop(
    frame: &KinectFrame,
    middle: [f32; 2],
    half: [u32; 2],
    draw: impl Fn(&mut RgbImage, &dyn Fn([f32; 2]) -> [f32; 2]),
) -> RgbImage {
    const TIMES: f32 = 1.5;
    let whole = crate::studio::inspect::colour_picture(frame);
    let corner = [0, 1].map(|k| {
        let most = [whole.width(), whole.height()][k].saturating_sub(2 * half[k]);
        (middle[k].max(0.0) as u32)
            .saturating_sub(half[k])
            .min(most)
    });
    let part = image::imageops::crop_imm(&whole, corner[0], corner[1], 2 * half[0], 2 * half[1]);
    let filter = image::imageops::FilterType::Triangle;
    let [width, height] = half.map(|h| (2.0 * TIMES * h as f32) as u32);
    let mut picture = image::imageops::resize(&part.to_image(), width, height, filter);
    let place = |[x, y]: [f32; 2]| {
        [x - corner[0] as f32, y - corner[1] as f32].map(|v| (v + 0.5) * TIMES - 0.5)
    };
    draw(&mut picture, &place);
    picture
}

/// The lines of a face and its points, red where they are doubted.
pub(super) fn draw_points(
    picture: &mut RgbImage,
    found: &Landmarks,
    place: &dyn Fn([f32; 2]) -> [f32; 2],
) {
    let points = found.pixels.map(place);
    canvas::landmarks(picture, &points, &found.point_confidence);
}

/// Words on a dark strip at the top of a picture.
pub(super) fn title(picture: &mut RgbImage, words: &str) {
    let strip = [picture.width() as f32, 17.0];
    canvas::fill(picture, [0.0; 2], strip, [30; 3]);
    chart::text(picture, [6, 2], 13, words, [255; 3]);
}
