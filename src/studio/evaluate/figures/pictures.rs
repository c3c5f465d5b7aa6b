//! Parts of pictures that several figures have.

use image::RgbImage;

use crate::landmarks::Landmarks;
use crate::sensor::kinect::frame::KinectFrame;
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
    for [a, b] in canvas::face_lines() {
        canvas::line(picture, points[a], points[b], [0, 190, 255]);
    }
    for ([x, y], confidence) in points.iter().zip(found.point_confidence) {
        let strong = (confidence.clamp(0.0, 1.0) * 255.0) as u8;
        canvas::square(picture, *x, *y, 1, [255 - strong, strong, 0]);
    }
}

/// Words on a dark strip at the top of a picture.
pub(super) fn title(picture: &mut RgbImage, words: &str) {
    for y in 0..18.min(picture.height()) {
        for x in 0..picture.width() {
            picture.put_pixel(x, y, image::Rgb([30; 3]));
        }
    }
    canvas::text(picture, 6, 4, 2, words, [255; 3]);
}
