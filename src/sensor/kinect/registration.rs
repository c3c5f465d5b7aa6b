//! Calibration in the device's own names and numbers, with that of one real device as the default.

use crate::base::defaults;

macro_rules! registration_integers {
    ($($name:ident = $sample:literal),* $(,)?) => {
        /// The 29 integers that describe the mapping from depth to colour pixels, as the device names them. The large
        /// ones are negative numbers in fewer bits.
        #[derive(Clone, Debug, PartialEq, Eq)]
        pub struct RegistrationIntegers {
            $(#[doc = concat!("`", stringify!($name), "` of the device's block.")] pub $name: i32,)*
        }

        impl RegistrationIntegers {
            /// Names in the device's order.
            pub const NAMES: [&'static str; 29] = [$(stringify!($name)),*];

            /// All zero: what stands for the absent ones when a file names only some.
            #[must_use]
            pub const fn zero() -> Self {
                Self { $($name: 0),* }
            }

            /// In the device's order.
            #[must_use]
            pub const fn to_array(&self) -> [i32; 29] {
                [$(self.$name),*]
            }

            /// By name; `None` for a name that is not one of [`Self::NAMES`].
            pub fn by_name(&mut self, name: &str) -> Option<&mut i32> {
                match name {
                    $(stringify!($name) => Some(&mut self.$name),)*
                    _ => None,
                }
            }
        }

        impl Default for RegistrationIntegers {
            /// The block of one real unit.
            fn default() -> Self {
                Self { $($name: $sample),* }
            }
        }
    };
}

registration_integers! {
    dx_center = 2_048_330_528, ax = 1964, bx = 56, cx = -26, dx = 600, dx_start = 6161, ay = -13, by = 2825, cy = 684,
    dy = 5, dy_start = 6434, dx_beta_start = 10062, dy_beta_start = 130_801, rollout_blank = 0, rollout_size = 0,
    dx_beta_inc = 170, dy_beta_inc = 136, dxdx_start = 2_095_986, dxdy_start = 890, dydx_start = 763,
    dydy_start = 2_096_378, dxdxdx_start = 134_215_474, dydxdx_start = 134_217_093, dxdxdy_start = 134_216_989,
    dydxdy_start = 134_216_925, back_comp1 = 0, dydydx_start = 134_216_984, back_comp2 = 0, dydydy_start = 134_214_659,
}

/// Rows and columns the device cuts off; all zero on the sensors known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Padding {
    /// Rows above the picture.
    pub start_lines: u16,
    /// Rows below the picture.
    pub end_lines: u16,
    /// Rows cropped.
    pub cropping_lines: u16,
}

defaults! {
    /// The triangle of emitter, camera and reference plane. Lengths in centimetres, as the device gives them.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct ZeroPlane {
        /// E: depth camera to emitter.
        pub dcmos_emitter_distance: f32 = 7.5,
        /// B: depth camera to colour camera.
        pub dcmos_rcmos_distance: f32 = 2.4,
        /// D: distance of the reference plane.
        pub reference_distance: f32 = 120.0,
        /// P: size of a pixel of the 1280×1024 picture on the reference plane.
        pub reference_pixel_size: f32 = 0.1042,
    }

    /// Calibration as read from the device. The default is a real unit's block with the usual optics.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Registration {
        /// Depth pixel to colour pixel.
        pub integers: RegistrationIntegers = RegistrationIntegers::default(),
        /// Rows cut off.
        pub padding: Padding = Padding::default(),
        /// Raw depth to distance.
        pub zero_plane: ZeroPlane = ZeroPlane::default(),
        /// C: offset of raw depth, in steps of four raw values.
        pub const_shift: u16 = 200,
    }
}
