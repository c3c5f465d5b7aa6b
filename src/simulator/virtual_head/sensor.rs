//! How a simulated sensor is imperfect.

use mien_stages::base::capacity::{HEIGHT, WIDTH};
use mien_stages::base::defaults;
use mien_stages::base::geometry::{Rigid, Rotation, Vector};

/// Focal length of the colour camera, pixels: only for its distortion.
const COLOUR_FOCAL_PX: f32 = 525.0;

defaults! {
    /// How far the cameras are from perfect ones; the default is what all scenes had from the beginning.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Sensor {
        /// Faults of the depth reading: 0 as from the beginning, 1 as a real Kinect's.
        pub faults: f32 = 0.0,
        /// The colour picture is taken so much later than the depth picture, seconds.
        pub colour_late_s: f32 = 0.0,
        /// Error of the registration: the colour picture lies so far off, pixels.
        pub colour_shift_px: [f32; 2] = [0.0; 2],
        /// Radial distortion of the colour lens, of the square and the fourth power of the distance from its axis.
        pub distortion: [f32; 2] = [0.0; 2],
        /// White balance: gain of red, green and blue.
        pub balance: [f32; 3] = [1.0; 3],
        /// Noise of the colour sensor, one standard deviation, grey levels.
        pub colour_sigma: f32 = 2.0,
        /// Pitch of the sensor about the person, radians: above 0 it stands higher and looks down.
        pub above: f32 = 0.0,
    }
}

impl Sensor {
    /// Where the lens and the registration put what a perfect colour camera sees at a pixel.
    pub(super) fn seen_at(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        if *self == Self::default() {
            return [x, y];
        }
        let (dx, dy) = (x - 0.5 * WIDTH as f32, y - 0.5 * HEIGHT as f32);
        // Beyond the picture's corners the polynomial has no meaning.
        let r2 = ((dx * dx + dy * dy) / (COLOUR_FOCAL_PX * COLOUR_FOCAL_PX)).min(0.7);
        let [k1, k2] = self.distortion;
        let bend = r2 * (k1 + r2 * k2);
        let [sx, sy] = self.colour_shift_px;
        [x + dx * bend + sx, y + dy * bend + sy]
    }

    /// The world as this sensor sees it, from as a level one does: turned about where people sit.
    pub(super) fn viewpoint(&self) -> Rigid {
        let turn = Rotation::from_axis_angle(&Vector::x_axis(), self.above);
        let seat = Vector::new(0.0, -0.02, 0.8);
        Rigid::from_parts((seat - turn * seat).into(), turn)
    }
}
