//! Imperfections of a simulated sensor.

use mien_stages::base::capacity::{HEIGHT, WIDTH};
use mien_stages::base::defaults;
use mien_stages::base::geometry::{Rigid, Rotation, Vector};

/// Focal length of the colour camera, pixels; used for distortion only.
const COLOUR_FOCAL_PX: f32 = 525.0;

defaults! {
    /// Imperfections of the cameras. Golden tests use the default.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Sensor {
        /// Strength of the additional depth errors: 0 = none, 1 = a real Kinect's.
        pub faults: f32 = 0.0,
        /// Whether the additional errors, if there are any, contain a stereo camera's noise (RealSense D435), in full, instead of a Kinect's.
        pub stereo: bool = false,
        /// Delay of the colour picture after the depth picture, seconds.
        pub colour_late_s: f32 = 0.0,
        /// Error of the registration: shift of the colour picture, pixels.
        pub colour_shift_px: [f32; 2] = [0.0; 2],
        /// Radial distortion of the colour lens: coefficients of r² and r⁴.
        pub distortion: [f32; 2] = [0.0; 2],
        /// White balance: gain of red, green and blue.
        pub balance: [f32; 3] = [1.0; 3],
        /// Standard deviation of the colour sensor's noise, grey levels.
        pub colour_sigma: f32 = 2.0,
        /// Pitch of the sensor about the person, radians; above 0 it is higher and looks down.
        pub above: f32 = 0.0,
        /// Turn of the sensor about its optical axis, radians; clockwise as seen by the person.
        pub turned: f32 = 0.0,
    }
}

impl Sensor {
    /// Applies distortion and registration error to a pixel of the perfect colour camera.
    pub(super) fn distort(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        if *self == Self::default() {
            return [x, y];
        }
        let (dx, dy) = (x - 0.5 * WIDTH as f32, y - 0.5 * HEIGHT as f32);
        // Beyond the picture's corners the polynomial is not valid.
        let r2 = ((dx * dx + dy * dy) / (COLOUR_FOCAL_PX * COLOUR_FOCAL_PX)).min(0.7);
        let [k1, k2] = self.distortion;
        let bend = r2 * (k1 + r2 * k2);
        let [sx, sy] = self.colour_shift_px;
        [x + dx * bend + sx, y + dy * bend + sy]
    }

    /// What its accelerometer measures, 819 counts a g: x to the left in the picture, y up, z forward.
    pub fn acceleration(&self) -> [i16; 3] {
        let up = self.viewpoint().rotation * Vector::new(0.0, -1.0, 0.0);
        [-up.x, -up.y, up.z].map(|axis| (819.0 * axis).round() as i16)
    }

    /// Transformation from the frame of a level sensor to this sensor's: a rotation about the seat, then one about the optical axis.
    pub(super) fn viewpoint(&self) -> Rigid {
        let turn = Rotation::from_axis_angle(&Vector::x_axis(), self.above);
        let seat = Vector::new(0.0, -0.02, 0.8);
        let level = Rigid::from_parts((seat - turn * seat).into(), turn);
        Rotation::from_axis_angle(&Vector::z_axis(), self.turned) * level
    }
}
