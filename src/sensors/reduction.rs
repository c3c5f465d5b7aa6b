//! Reduction of images larger than a frame by an integer factor.

use core::ops::RangeInclusive;

use mien_stages::base::capacity::{HEIGHT, PIXELS, WIDTH};
use mien_stages::camera::{Camera, Pinhole};
use mien_stages::frame::NO_DEPTH;

/// Widths and heights of images that can be read, pixels.
pub(super) const SIZES: RangeInclusive<usize> = 64..=8192;
/// Assumed field of view along the longer side of a 4:3 image whose camera is unknown, degrees: webcams and phones have about 50 to 70.
/// A wider format is taken to have the same field of view along the shorter side and more along the longer one.
pub(super) const ASSUMED_VIEW_DEG: f32 = 60.0;

/// Assumed intrinsics of an unknown camera for images of `size`: the focal length follows from the shorter side, the principal point
/// is in the middle.
pub(super) fn assumed_view(size: [usize; 2]) -> Pinhole {
    let across = size[0].min(size[1]) as f32 * 4.0 / 3.0;
    let focal = across * 0.5 / (ASSUMED_VIEW_DEG * 0.5).to_radians().tan();
    Pinhole {
        focal: [focal; 2],
        // Pixel centres are integers.
        centre: size.map(|pixels| (pixels as f32 - 1.0) * 0.5),
    }
}

/// How images of a given size are reduced to a frame.
#[derive(Clone, Copy)]
pub(super) struct Reduction {
    /// Columns and rows of the image.
    pub(super) size: [usize; 2],
    /// Image pixels per frame pixel, along each side.
    pub(super) factor: usize,
}

impl Reduction {
    pub(super) fn new(size: [usize; 2]) -> Self {
        let factor = size[0].div_ceil(WIDTH).max(size[1].div_ceil(HEIGHT)).max(1);
        Self { size, factor }
    }

    /// Columns and rows in the frame.
    pub(super) fn frame_size(&self) -> [usize; 2] {
        self.size.map(|pixels| pixels / self.factor)
    }

    /// Fills `luma` with means of blocks and pads it with border pixels. `pixel`: grey level at a column and row of the image, 0…255.
    pub(super) fn average(&self, luma: &mut [u8; PIXELS], pixel: impl Fn(usize, usize) -> u32) {
        let ([columns, rows], factor) = (self.frame_size(), self.factor);
        for row in 0..rows {
            let line = &mut luma[row * WIDTH..][..WIDTH];
            for (col, out) in line[..columns].iter_mut().enumerate() {
                let mut sum = 0;
                for y in row * factor..(row + 1) * factor {
                    let block = col * factor..(col + 1) * factor;
                    sum += block.map(|x| pixel(x, y)).sum::<u32>();
                }
                *out = (sum / (factor * factor) as u32) as u8;
            }
            let last = line[columns - 1];
            line[columns..].fill(last);
        }
        for row in rows..HEIGHT {
            luma.copy_within((rows - 1) * WIDTH..rows * WIDTH, row * WIDTH);
        }
    }

    /// Fills `depth` with one pixel of each block, near its middle, so that edges are not blurred. Pixels beyond the blocks, and those for
    /// which `camera` has no distance, are [`NO_DEPTH`]. `raw`: value at a column and row of the image.
    pub(super) fn pick(
        &self,
        depth: &mut [u16; PIXELS],
        camera: &Camera,
        raw: impl Fn(usize, usize) -> u16,
    ) {
        let ([columns, rows], factor) = (self.frame_size(), self.factor);
        depth.fill(NO_DEPTH);
        for row in 0..rows {
            let line = &mut depth[row * WIDTH..][..columns];
            for (col, out) in line.iter_mut().enumerate() {
                let raw = raw(col * factor + factor / 2, row * factor + factor / 2);
                if camera.depth_m(raw) > 0.0 {
                    *out = raw;
                }
            }
        }
    }

    /// The intrinsics after picking one pixel of each block, near its middle.
    pub(super) fn picked(&self, view: Pinhole) -> Pinhole {
        self.reduced(view, (self.factor / 2) as f32)
    }

    /// The intrinsics after averaging each block.
    pub(super) fn averaged(&self, view: Pinhole) -> Pinhole {
        self.reduced(view, (self.factor - 1) as f32 * 0.5)
    }

    /// The intrinsics of the reduced image; `within`: position of a reduced pixel's centre in its block, image pixels.
    fn reduced(&self, view: Pinhole, within: f32) -> Pinhole {
        let factor = self.factor as f32;
        Pinhole {
            focal: view.focal.map(|focal| focal / factor),
            centre: view.centre.map(|centre| (centre - within) / factor),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_camera_sees_sixty_degrees_across_four_to_three_after_reduction_too() {
        for (size, reduced, focal) in [
            ([1280, 960], [640, 480], 320.0 * 3f32.sqrt()),
            ([1280, 720], [640, 360], 240.0 * 3f32.sqrt()),
            // A phone held upright.
            ([720, 1280], [240, 426], 160.0 * 3f32.sqrt()),
        ] {
            let reduction = Reduction::new(size);
            assert_eq!(reduction.frame_size(), reduced);
            let view = reduction.averaged(assumed_view(size));
            assert!((view.focal[0] - focal).abs() < 1e-3 && view.focal[0] == view.focal[1]);
            assert!((view.centre[0] - (reduced[0] as f32 - 1.0) * 0.5).abs() < 1e-3);
        }
    }

    #[test]
    fn depth_is_picked_near_the_middle_of_blocks_and_what_has_no_distance_is_none() {
        let reduction = Reduction::new([1280, 720]);
        let view = reduction.picked(assumed_view([1280, 720]));
        let camera = Camera::without_depth(view, Default::default(), [640, 360]);
        let mut depth = crate::Frame::default().depth;
        depth.fill(700);
        reduction.pick(&mut depth, &camera, |col, row| match (col, row) {
            // No depth, and a distance shorter than any camera measures.
            (1, 1) => 0,
            (3, 1) => 200,
            _ => (1000 + col + row) as u16,
        });
        assert_eq!(depth[..3], [NO_DEPTH, NO_DEPTH, 1006]);
        assert_eq!(depth[359 * WIDTH..][639], 1000 + 1279 + 719);
        assert!(depth[360 * WIDTH..].iter().all(|&raw| raw == NO_DEPTH));
    }
}
