//! Calibration with the device's own names and numbers; the default is that of a real device.

use mien_stages::base::defaults;

/// Names of the device's registration integers, in its order. For an axis k (x or y), `ak` … `dk`, `dk_start`, `dxdk_start` and so on
/// are its polynomial; the large values are negative numbers of fewer bits.
const INTEGERS: &str = "dx_center ax bx cx dx dx_start ay by cy dy dy_start dx_beta_start dy_beta_start rollout_blank \
    rollout_size dx_beta_inc dy_beta_inc dxdx_start dxdy_start dydx_start dydy_start dxdxdx_start dydxdx_start dxdxdy_start \
    dydxdy_start back_comp1 dydydx_start back_comp2 dydydy_start";
/// Registration integers of a real unit.
const SAMPLE: [i32; 29] = [
    2048330528, 1964, 56, -26, 600, 6161, -13, 2825, 684, 5, 6434, 10062, 130801, 0, 0, 170, 136,
    2095986, 890, 763, 2096378, 134215474, 134217093, 134216989, 134216925, 0, 134216984, 0,
    134214659,
];

/// Names of [`Registration::integers`].
pub fn integer_names() -> impl Iterator<Item = &'static str> {
    INTEGERS.split_whitespace()
}

/// Names of [`Registration::padding`].
pub const PADDING: [&str; 3] = ["start_lines", "end_lines", "cropping_lines"];

defaults! {
    /// The triangle of emitter, camera and reference plane; centimetres, as in the device.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct ZeroPlane {
        /// E: distance from depth camera to emitter.
        pub dcmos_emitter_distance: f32 = 7.5,
        /// B: distance from depth camera to colour camera.
        pub dcmos_rcmos_distance: f32 = 2.4,
        /// D: distance of the reference plane.
        pub reference_distance: f32 = 120.0,
        /// P: size on the reference plane of a pixel of the 1280×1024 picture.
        pub reference_pixel_size: f32 = 0.1042,
    }

    /// Calibration as read from the device. The default is a real unit's registration with the usual optics.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Registration {
        /// The device's integers for depth pixel to colour pixel, named by [`integer_names`].
        pub integers: [i32; 29] = SAMPLE,
        /// Numbers of cropped lines, named by [`PADDING`]; zero on all known sensors.
        pub padding: [u16; 3] = [0; 3],
        /// Optics, for raw depth to distance.
        pub zero_plane: ZeroPlane = ZeroPlane::default(),
        /// C: offset of raw depth, in steps of four raw values.
        pub const_shift: u16 = 200,
    }
}
