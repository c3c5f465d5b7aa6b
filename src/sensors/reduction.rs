//! Pictures larger than a frame, reduced by a whole factor.

use core::ops::RangeInclusive;

use mien_stages::base::capacity::{HEIGHT, WIDTH};
use mien_stages::camera::Pinhole;

/// Width and height of pictures that are read, pixels.
pub(super) const SIZES: RangeInclusive<usize> = 64..=8192;
/// Assumed field of view across a picture whose camera is unknown, degrees: webcams and telephones see about 50 to 75.
pub(super) const ASSUMED_VIEW_DEG: f32 = 60.0;

/// The view of an unknown camera by the size of its pictures: [`ASSUMED_VIEW_DEG`] from the left border to the right, axis in the middle.
pub(super) fn assumed_view(size: [usize; 2]) -> Pinhole {
    let focal = size[0] as f32 * 0.5 / (ASSUMED_VIEW_DEG * 0.5).to_radians().tan();
    Pinhole {
        focal: [focal; 2],
        // Pixel centres are integers.
        centre: size.map(|pixels| (pixels as f32 - 1.0) * 0.5),
    }
}

/// How pictures of a size become those of a frame.
#[derive(Clone, Copy)]
pub(super) struct Reduction {
    /// Columns and rows of the file.
    pub(super) size: [usize; 2],
    /// File pixels per frame pixel, along each side.
    pub(super) factor: usize,
}

impl Reduction {
    pub(super) fn new(size: [usize; 2]) -> Self {
        let factor = size[0].div_ceil(WIDTH).max(size[1].div_ceil(HEIGHT));
        Self { size, factor }
    }

    /// Columns and rows in the frame.
    pub(super) fn frame_size(&self) -> [usize; 2] {
        self.size.map(|pixels| pixels / self.factor)
    }

    /// The view of pictures reduced by picking one pixel of each block, near its middle.
    pub(super) fn picked(&self, view: Pinhole) -> Pinhole {
        self.reduced(view, (self.factor / 2) as f32)
    }

    /// The view of pictures reduced by averaging each block.
    pub(super) fn averaged(&self, view: Pinhole) -> Pinhole {
        self.reduced(view, (self.factor - 1) as f32 * 0.5)
    }

    /// `within`: position of a reduced pixel's centre in its block, file pixels.
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
    fn an_unknown_camera_sees_sixty_degrees_after_reduction_too() {
        let reduction = Reduction::new([1280, 720]);
        assert_eq!((reduction.factor, reduction.frame_size()), (2, [640, 360]));
        let view = reduction.averaged(assumed_view([1280, 720]));
        // Outer borders of the first and the last column.
        let [left, right] = [-0.5, 639.5].map(|col| (col - view.centre[0]) / view.focal[0]);
        let seen_deg = (right.atan() - left.atan()).to_degrees();
        assert!((seen_deg - 60.0).abs() < 1e-3, "{seen_deg}");
        assert_eq!(view.centre, [319.5, 179.5]);
        assert_eq!(view.focal[0], view.focal[1]);
    }
}
