//! A picture with its fitted landmarks, to look at: `mien-studio fit --pictures`.

use image::RgbImage;

use crate::base::capacity::LANDMARKS;
use crate::studio::chart;
use crate::studio::inspect::canvas;

/// Width of the face, pixels: its 68 numbers stand beside each other.
const FACE: f32 = 640.0;
/// What is shown around it, in widths of the face.
const AROUND: f32 = 0.3;

/// The surroundings of a face, enlarged, with the fitted points in lines and numbers and the true ones as white squares.
#[must_use]
pub fn fitted_picture(
    picture: &RgbImage,
    fitted: &[[f32; 2]; LANDMARKS],
    truth: Option<&[[f32; 2]; LANDMARKS]>,
    confidence: f32,
) -> RgbImage {
    let ends = |axis: usize| {
        let along = fitted.iter().map(|p| p[axis]);
        along.fold((f32::MAX, f32::MIN), |(low, high), at| {
            (low.min(at), high.max(at))
        })
    };
    let ((x0, x1), (y0, y1)) = (ends(0), ends(1));
    let (most_x, most_y) = (picture.width() as f32, picture.height() as f32);
    let margin = AROUND * (x1 - x0);
    // A face beside the picture shows what there is.
    let left = (x0 - margin).clamp(0.0, most_x - 1.0);
    let top = (y0 - margin).clamp(0.0, most_y - 1.0);
    let width = (x1 + margin - left).clamp(1.0, most_x - left);
    let height = (y1 + margin - top).clamp(1.0, most_y - top);
    let cut = image::imageops::crop_imm(
        picture,
        left as u32,
        top as u32,
        (width as u32).max(1),
        (height as u32).max(1),
    );
    let cut = cut.to_image();
    let zoom = FACE / (x1 - x0).max(1.0);
    let size = |side: u32| ((side as f32 * zoom).round() as u32).clamp(1, 4 * FACE as u32);
    let filter = image::imageops::FilterType::Triangle;
    let mut out = image::imageops::resize(&cut, size(cut.width()), size(cut.height()), filter);
    let place = |[x, y]: [f32; 2]| {
        // Pixel centres are integers.
        [(x, left), (y, top)].map(|(at, from)| (at - from.floor() + 0.5) * zoom - 0.5)
    };
    let points = fitted.map(place);
    for [a, b] in canvas::face_lines() {
        canvas::line(&mut out, points[a], points[b], [0, 190, 255]);
    }
    for &point in truth.into_iter().flatten() {
        let [x, y] = place(point);
        canvas::square(&mut out, x, y, 2, [255; 3]);
    }
    for (k, [x, y]) in points.into_iter().enumerate() {
        canvas::square(&mut out, x, y, 2, [30, 220, 70]);
        let beside = [x + 4.0, y - 6.0].map(|at| at.max(0.0) as u32);
        chart::text(&mut out, beside, 9, &k.to_string(), [255, 230, 60]);
    }
    let confidence = format!("{confidence:.2}");
    chart::text(&mut out, [6, 4], 15, &confidence, [255; 3]);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_drawn_where_they_are_and_never_beside_the_picture() {
        let picture = RgbImage::from_pixel(200, 150, image::Rgb([90; 3]));
        let mut fitted = [[0.0; 2]; LANDMARKS];
        for (k, p) in fitted.iter_mut().enumerate() {
            *p = [60.0 + (k % 9) as f32 * 10.0, 40.0 + (k / 9) as f32 * 10.0];
        }
        let drawn = fitted_picture(&picture, &fitted, None, 0.5);
        // 80 wide at 640: eight times; the margin of 24 stands before the first point.
        let at = |k: usize| {
            let [x, y] = fitted[k];
            *drawn.get_pixel(
                (8.0 * (x - 36.0 + 0.5)) as u32,
                (8.0 * (y - 16.0 + 0.5)) as u32,
            )
        };
        assert_eq!(drawn.dimensions(), (8 * 128, 8 * 118));
        for k in [0, 8, 34, 67] {
            assert_eq!(at(k).0, [30, 220, 70], "{k}");
        }
        for away in [-500.0, 500.0] {
            let _ = fitted_picture(&picture, &fitted.map(|[x, y]| [x + away, y]), None, 0.0);
        }
    }
}
