//! Geometry of both cameras of a sensor: raw depth to metres, pixels to points, points to pixels of the grey image.
//!
//! A sensor's driver or calibration file builds a [`Camera`] from its scale of depth ([`DepthScale`]: a unit in metres, or a table
//! of distances in steps of 1/z), the depth camera's intrinsics, and the mapping to the grey image ([`ColourProjection`]): a
//! second pinhole camera, or the polynomial from the device's calibration.
//!
//! Frames and units: sensor frame in metres ([`crate::base::geometry`]); pixel centres are integers. Memory: four bytes a raw value on
//! the heap ([`RAW_DEPTH_VALUES`]), built once. Cost: `colour_pixel` about 40 multiplications. Degenerate: a raw value without a
//! distance gives 0; the projection of a point at z ≤ 0 is undefined (possibly infinite). Limitation: no lens distortion of the depth
//! camera.

use crate::base::capacity::{DEPTH_BINS, RAW_DEPTH_VALUES};
use crate::base::geometry::{Point, Rigid, Vector};
use crate::base::prelude::*;
use crate::turn::{Turn, TurnedImage};

/// Nearest and farthest distance of [`DepthScale::metric`], metres.
pub const RANGE_M: [f32; 2] = [0.3, 10.0];

/// The distances of raw depth values: a unit in metres, or a table.
///
/// Layers of depth are found in a histogram of equal steps of 1/z, finest near the sensor, whatever the unit; it has [`DEPTH_BINS`].
#[derive(Clone, Debug, PartialEq)]
pub struct DepthScale {
    /// Distance by raw value, metres; 0 = none.
    metres: Box<[f32]>,
    /// `[far, near]` of `bin = far - near / z`; z in metres.
    bins: [f64; 2],
    /// Metres per raw value; `None` if raw values are the bins.
    unit_m: Option<f32>,
}

impl DepthScale {
    /// Of raw values `bins[0] - bins[1] / z`, which are the bins; `metres`: their distances, 0 for none, at most [`DEPTH_BINS`].
    pub fn inverse(metres: Box<[f32]>, bins: [f64; 2]) -> Self {
        assert!(metres.len() <= DEPTH_BINS, "more raw values than bins");
        Self {
            metres,
            bins,
            unit_m: None,
        }
    }

    /// Of raw values in units of `unit_m` metres; those outside of [`RANGE_M`], which the bins divide, are no measurement.
    pub fn metric(unit_m: f32) -> Self {
        let [near, far] = RANGE_M.map(|m| 1.0 / f64::from(m));
        let per = (DEPTH_BINS - 1) as f64 / (near - far);
        let metres = (0..RAW_DEPTH_VALUES).map(|raw| raw as f32 * unit_m);
        let metres = metres.take_while(|z| *z <= RANGE_M[1]);
        let metres = metres.map(|z| if z < RANGE_M[0] { 0.0 } else { z });
        Self {
            metres: metres.collect(),
            bins: [near * per, per],
            unit_m: Some(unit_m),
        }
    }
}

/// Pinhole intrinsics, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Focal lengths along column and row.
    pub focal: [f32; 2],
    /// Principal point: column and row.
    pub centre: [f32; 2],
}

impl Pinhole {
    /// The pixel of a point with z > 0.
    pub fn pixel(&self, p: &Point) -> [f32; 2] {
        [0, 1].map(|k| p[k] * (self.focal[k] / p.z) + self.centre[k])
    }
}

/// Radial and tangential lens distortion (Brown–Conrady): k1, k2, p1, p2, k3 in OpenCV's order.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Deserialize)]
pub struct Distortion(pub [f32; 5]);

impl Distortion {
    /// Distorted normalised coordinates of a point with z > 0, at z = 1.
    pub fn distorted(&self, p: &Point) -> Point {
        let [k1, k2, p1, p2, k3] = self.0;
        let (x, y) = (p.x / p.z, p.y / p.z);
        let r = x * x + y * y;
        let radial = 1.0 + r * (k1 + r * (k2 + r * k3));
        Point::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r + 2.0 * x * x),
            y * radial + p1 * (r + 2.0 * y * y) + 2.0 * p2 * x * y,
            1.0,
        )
    }
}

/// Mapping from the depth camera to the grey image.
#[derive(Clone, Debug, PartialEq)]
pub enum ColourProjection {
    /// A second camera.
    Pinhole {
        /// Its intrinsics.
        view: Pinhole,
        /// Its lens distortion.
        distortion: Distortion,
        /// From the sensor frame (the depth camera's) to its frame, metres.
        colour_from_sensor: Rigid,
    },
    /// A polynomial in depth pixels, and a shift along the row for the baseline.
    Polynomial {
        /// Displacement of column and row, pixels.
        displacement: Box<[Cubic; 2]>,
        /// Shift of the column at infinity, pixels, and its change with 1/z, pixel metres.
        shift: [f64; 2],
    },
}

/// A polynomial of column and row: `Σ t[i][j] column^i (row + 1)^j`, i + j ≤ 3.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cubic(pub [[f64; 4]; 4]);

impl Cubic {
    /// Its value at a pixel.
    pub fn value(&self, col: f64, row: f64) -> f64 {
        let [t0, t1, t2, t3] = &self.0;
        let n = row + 1.0;
        let c0 = ((t0[3] * n + t0[2]) * n + t0[1]) * n + t0[0];
        let c1 = (t1[2] * n + t1[1]) * n + t1[0];
        let c2 = t2[1] * n + t2[0];
        ((t3[0] * col + c2) * col + c1) * col + c0
    }
}

/// Geometry of both cameras; its maps are continuous and differentiable.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    scale: DepthScale,
    depth: Pinhole,
    /// Columns and rows of the depth image.
    size: [usize; 2],
    colour: ColourProjection,
    /// Depth camera and grey image as the sensor takes them, if it is turned.
    native: Option<(Pinhole, TurnedImage)>,
}

impl Camera {
    /// For a sensor with this scale of depth; `size`: columns and rows of the depth image.
    pub fn new(
        scale: DepthScale,
        depth: Pinhole,
        size: [usize; 2],
        colour: ColourProjection,
    ) -> Self {
        Self {
            scale,
            depth,
            size,
            colour,
            native: None,
        }
    }

    /// For a sensor without depth; `size`: columns and rows of its image. The sensor frame is that of the image.
    ///
    /// ```
    /// # use mien_stages::base::geometry::Point;
    /// # use mien_stages::camera::{Camera, Distortion, Pinhole};
    /// let view = Pinhole { focal: [600.0; 2], centre: [320.0, 240.0] };
    /// let camera = Camera::without_depth(view, Distortion::default(), [640, 480]);
    /// assert_eq!(camera.colour_pixel(&Point::new(0.1, 0.0, 1.0)), [380.0, 240.0]);
    /// ```
    pub fn without_depth(view: Pinhole, distortion: Distortion, size: [usize; 2]) -> Self {
        let colour = ColourProjection::Pinhole {
            view,
            distortion,
            colour_from_sensor: Rigid::identity(),
        };
        Self::new(DepthScale::metric(0.001), view, size, colour)
    }

    /// The camera of this sensor turned about its optical axis, whose images are turned upright by [`Turn::turn_upright`]; the sensor
    /// frame is then upright too. `luma`: columns and rows of the grey image as the sensor takes it.
    ///
    /// ```
    /// # use mien_stages::base::geometry::{Point, Rigid};
    /// # use mien_stages::camera::{Camera, ColourProjection, DepthScale, Distortion, Pinhole};
    /// # use mien_stages::turn::Turn;
    /// # let view = Pinhole { focal: [576.0; 2], centre: [320.0, 240.0] };
    /// # let (distortion, colour_from_sensor) = (Distortion::default(), Rigid::identity());
    /// # let colour = ColourProjection::Pinhole { view, distortion, colour_from_sensor };
    /// # let camera = Camera::new(DepthScale::metric(0.001), view, [640, 480], colour);
    /// let on_its_side = camera.turned(Turn::Quarter, [640, 480]);
    /// assert_eq!(on_its_side.depth_size(), [480, 480]);
    /// // A point above the sensor, which it sees on the right.
    /// assert_eq!(on_its_side.depth_pixel(&Point::new(0.0, -0.1, 1.0))[0], 240.0);
    /// ```
    #[must_use]
    pub fn turned(mut self, turn: Turn, luma: [usize; 2]) -> Self {
        let image = |size| TurnedImage { turn, size };
        let (native, depth) = (self.depth, image(self.size));
        self.depth = Pinhole {
            focal: turn.lengths(native.focal),
            centre: depth.upright_pixel(native.centre),
        };
        self.size = depth.upright_size();
        self.native = (turn != Turn::Upright).then(|| (native, image(luma)));
        self
    }

    /// Focal length of the depth camera, pixels.
    pub fn depth_focal_px(&self) -> f32 {
        self.depth.focal[0]
    }

    /// Columns and rows of the depth image.
    pub fn depth_size(&self) -> [usize; 2] {
        self.size
    }

    /// Distance along z of a raw depth value, metres; 0 = none (no measurement, or 10 m and beyond).
    pub fn depth_m(&self, raw: u16) -> f32 {
        let z = self.scale.metres.get(usize::from(raw));
        z.copied().unwrap_or(0.0)
    }

    /// Whether anything in a raw depth image is measured; false for a sensor without depth, or in bright sunlight.
    pub fn measures(&self, depth: &[u16]) -> bool {
        // Every 29th pixel: a face at three metres has eighty of them.
        let mut sampled = depth.iter().step_by(29);
        sampled.any(|&raw| self.depth_m(raw) > 0.0)
    }

    /// Unrounded raw value of a distance `z` > 0 in metres: the inverse of [`Self::depth_m`].
    ///
    /// ```
    /// # use mien_stages::base::geometry::Rigid;
    /// # use mien_stages::camera::{Camera, ColourProjection, DepthScale, Distortion, Pinhole};
    /// # let view = Pinhole { focal: [576.0; 2], centre: [320.0, 240.0] };
    /// # let (distortion, colour_from_sensor) = (Distortion::default(), Rigid::identity());
    /// # let colour = ColourProjection::Pinhole { view, distortion, colour_from_sensor };
    /// let camera = Camera::new(DepthScale::metric(0.001), view, [640, 480], colour);
    /// assert!((camera.depth_m(700) - 0.7).abs() < 1e-6);
    /// assert!((camera.raw_from_m(0.7) - 700.0).abs() < 0.01);
    /// ```
    pub fn raw_from_m(&self, z: f32) -> f32 {
        self.scale
            .unit_m
            .map_or_else(|| self.bin_from_m(z), |unit_m| z / unit_m)
    }

    /// Whether raw values are the bins of [`DepthScale`].
    pub fn raw_is_bin(&self) -> bool {
        self.scale.unit_m.is_none()
    }

    /// Bin of a raw value; [`DEPTH_BINS`] or more if it is no measurement.
    pub fn bin(&self, raw: u16) -> usize {
        if self.raw_is_bin() {
            return usize::from(raw);
        }
        match self.depth_m(raw) {
            0.0 => DEPTH_BINS,
            z => self.bin_from_m(z) as usize,
        }
    }

    /// First raw value of a bin.
    pub fn raw_from_bin(&self, bin: usize) -> u16 {
        let [far, near] = self.scale.bins;
        self.scale.unit_m.map_or(bin as u16, |unit_m| {
            (near / (far - bin as f64) / f64::from(unit_m)).ceil() as u16
        })
    }

    /// Bin of a distance `z` > 0 in metres, unrounded.
    pub fn bin_from_m(&self, z: f32) -> f32 {
        let [far, near] = self.scale.bins;
        (far - near / f64::from(z)) as f32
    }

    /// Number of bins in a difference of 1/z, at least 1; `per_m` in 1/m.
    pub fn bin_steps(&self, per_m: f32) -> usize {
        (self.scale.bins[1] * f64::from(per_m)).round().max(1.0) as usize
    }

    /// Number of depth pixels in a solid angle (steradians).
    pub fn pixels_in_solid_angle(&self, solid_angle: f32) -> u32 {
        (solid_angle * self.depth.focal[0] * self.depth.focal[1]).round() as u32
    }

    /// Back-projects a depth pixel at depth `z`: a point in the sensor frame, metres.
    pub fn point(&self, col: f32, row: f32, z: f32) -> Point {
        let Pinhole { focal, centre, .. } = &self.depth;
        let (x, y) = (z / focal[0], z / focal[1]);
        Point::new((col - centre[0]) * x, (row - centre[1]) * y, z)
    }

    /// Depth pixel (column, row) of a point with z > 0, sensor frame, metres.
    pub fn depth_pixel(&self, p: &Point) -> [f32; 2] {
        self.depth.pixel(p)
    }

    /// Grey pixel (column, row) of a point with z > 0, sensor frame, metres.
    pub fn colour_pixel(&self, p: &Point) -> [f32; 2] {
        match &self.native {
            None => self.native_colour_pixel(p, &self.depth),
            Some((depth, luma)) => {
                let native = luma.turn.native_from_upright(p);
                luma.upright_pixel(self.native_colour_pixel(&native, depth))
            }
        }
    }

    /// The point that is seen at a grey pixel where a length across the line of sight has `pixels_per_metre`, sensor frame, metres.
    pub fn point_in_image(&self, pixel: [f32; 2], pixels_per_metre: f32) -> Point {
        /// Half the base of the differences, metres.
        const DIFFERENCE: f32 = 0.03;
        let mut point = self.point(pixel[0], pixel[1], self.depth.focal[0] / pixels_per_metre);
        // The two cameras are alike, so that the second step changes little.
        for _ in 0..3 {
            let seen = self.colour_pixel(&point);
            let beside = |x: f32| self.colour_pixel(&(point + Vector::x() * x))[0];
            let per_metre = (beside(DIFFERENCE) - beside(-DIFFERENCE)) / (2.0 * DIFFERENCE);
            let [x, y] = [0, 1].map(|k| point[k] + (pixel[k] - seen[k]) / per_metre);
            point = Point::new(x, y, point.z) * (per_metre / pixels_per_metre);
        }
        point
    }

    /// The same for a point in the frame of the sensor as it is mounted, with its `depth` camera.
    fn native_colour_pixel(&self, p: &Point, depth: &Pinhole) -> [f32; 2] {
        match &self.colour {
            ColourProjection::Pinhole {
                view,
                distortion,
                colour_from_sensor,
            } => view.pixel(&distortion.distorted(&(colour_from_sensor * p))),
            ColourProjection::Polynomial {
                displacement,
                shift: [far, near],
            } => {
                let [col, row] = depth.pixel(p).map(f64::from);
                let [dx, dy] = [0, 1].map(|axis| displacement[axis].value(col, row));
                let shift = far + near / f64::from(p.z);
                [(col + dx + 1.0 + shift) as f32, (row + dy + 1.0) as f32]
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::capacity::{HEIGHT, WIDTH};
    use crate::frame::NO_DEPTH;

    impl Default for DepthScale {
        /// Steps of 1/z, 1.6 mm at 1 m.
        fn default() -> Self {
            let bins = Self::metric(1.0).bins;
            let metres = (0..DEPTH_BINS).map(|raw| (bins[1] / (bins[0] - raw as f64)) as f32);
            Self::inverse(metres.collect(), bins)
        }
    }

    impl Default for Camera {
        fn default() -> Self {
            Self::of_scale(DepthScale::default())
        }
    }

    impl Camera {
        /// A depth camera 58° wide whose grey image is the same view.
        pub(crate) fn of_scale(scale: DepthScale) -> Self {
            let view = Pinhole {
                focal: [576.0; 2],
                centre: [320.0, 240.0],
            };
            let colour_from_sensor = Rigid::identity();
            Self::new(
                scale,
                view,
                [WIDTH, HEIGHT],
                ColourProjection::Pinhole {
                    view,
                    distortion: Distortion::default(),
                    colour_from_sensor,
                },
            )
        }
    }

    #[test]
    fn steps_of_1_z_round_trip_and_are_small() {
        let camera = Camera::default();
        assert_eq!(camera.depth_m(0), RANGE_M[0]);
        for raw in 1..DEPTH_BINS as u16 {
            let (z, before) = (camera.depth_m(raw), camera.depth_m(raw - 1));
            assert!((camera.raw_from_m(z) - f32::from(raw)).abs() < 0.01);
            assert!(z > before && (z - before) < 0.0017 * z * z);
        }
        for none in [DEPTH_BINS as u16, NO_DEPTH] {
            assert_eq!(camera.depth_m(none), 0.0);
            assert!(camera.bin(none) >= DEPTH_BINS);
        }
    }

    #[test]
    fn metres_keep_their_unit_and_thresholds_mean_the_same_as_in_steps_of_1_z() {
        let steps = Camera::default();
        for unit_m in [0.0001, 0.0002, 0.00025, 0.001] {
            let camera = Camera::of_scale(DepthScale::metric(unit_m));
            for z in [0.35, 0.5, 0.8, 1.0, 2.1, 5.0] {
                let raw = camera.raw_from_m(z).round() as u16;
                let found = camera.depth_m(raw);
                assert!((found - z).abs() < 0.51 * unit_m, "{found} {z}");
                assert!((camera.raw_from_m(found) - f32::from(raw)).abs() < 0.01);
                let bin = camera.bin(raw);
                assert_eq!(bin, steps.raw_from_m(found) as usize);
                let first = camera.raw_from_bin(bin);
                assert!(first <= raw && camera.bin(first - 1) < bin);
                let [behind, expected] = [&camera, &steps].map(|camera| {
                    let raw = camera.raw_from_m(z).round() as u16;
                    let bin = camera.bin(raw) + camera.bin_steps(0.035);
                    camera.depth_m(camera.raw_from_bin(bin)) - z
                });
                let most = 1.01 * unit_m + 0.0025 * z * z;
                assert!((behind - expected).abs() < most, "{behind} {expected}");
            }
            for none in [0, (0.29 / unit_m) as u16, NO_DEPTH] {
                assert_eq!(camera.depth_m(none), 0.0);
                assert!(camera.bin(none) >= DEPTH_BINS);
            }
            assert!(camera.raw_from_bin(DEPTH_BINS) > camera.raw_from_m(6.0) as u16);
        }
    }

    #[test]
    fn pixels_and_points_round_trip_in_both_images() {
        let depth = Pinhole {
            focal: [365.0, 366.0],
            centre: [256.0, 212.0],
        };
        let view = Pinhole {
            focal: [600.0, 601.0],
            ..depth
        };
        let colour_from_sensor = Rigid::translation(-0.052, 0.0, 0.0);
        let camera = Camera::new(
            DepthScale::default(),
            depth,
            [512, 424],
            ColourProjection::Pinhole {
                view,
                distortion: Distortion::default(),
                colour_from_sensor,
            },
        );
        let p = camera.point(100.0, 50.0, 0.8);
        let [col, row] = camera.depth_pixel(&p);
        assert!((col - 100.0).abs() < 1e-3 && (row - 50.0).abs() < 1e-3);
        let [col, row] = camera.colour_pixel(&p);
        let expected = [
            256.0 + 600.0 * (p.x - 0.052) / 0.8,
            212.0 + 601.0 * p.y / 0.8,
        ];
        assert!((col - expected[0]).abs() < 1e-3 && (row - expected[1]).abs() < 1e-3);
        // From the pixel and the scale there.
        let found = camera.point_in_image([col, row], 600.0 / 0.8);
        assert!((found - p).norm() < 1e-4, "{found} {p}");
    }

    #[test]
    fn a_depth_image_is_measured_if_anything_in_it_is() {
        let camera = Camera::default();
        let mut depth = vec![NO_DEPTH; WIDTH * HEIGHT];
        assert!(!camera.measures(&depth));
        // A patch of nine by nine pixels.
        for row in 100..109 {
            depth[row * WIDTH + 300..][..9].fill(camera.raw_from_m(0.8) as u16);
        }
        assert!(camera.measures(&depth));
    }

    #[test]
    fn a_turned_camera_projects_to_the_turned_pixels_of_the_native_one() {
        let depth = Pinhole {
            focal: [574.0, 577.0],
            centre: [318.0, 241.0],
        };
        let mut wave = Cubic([[0.0; 4]; 4]);
        wave.0[0] = [3.0, 0.01, 1e-5, 0.0];
        wave.0[1] = [-0.02, 2e-5, 0.0, 0.0];
        let seconds = [
            ColourProjection::Pinhole {
                view: Pinhole {
                    focal: [601.0, 599.0],
                    centre: [322.0, 236.0],
                },
                distortion: Distortion([-0.2, 0.1, 0.001, -0.002, 0.05]),
                colour_from_sensor: Rigid::translation(-0.025, 0.001, 0.002),
            },
            ColourProjection::Polynomial {
                displacement: Box::new([wave, wave]),
                shift: [12.0, -14.0],
            },
        ];
        for colour in seconds {
            let native = Camera::new(DepthScale::default(), depth, [632, HEIGHT], colour);
            assert_eq!(native.clone().turned(Turn::Upright, [640, 480]), native);
            for (turn, size) in [
                (Turn::Quarter, [480; 2]),
                (Turn::Half, [632, 480]),
                (Turn::ThreeQuarters, [480; 2]),
            ] {
                let turned = native.clone().turned(turn, [640, 480]);
                assert_eq!(turned.depth_size(), size);
                let image = |size| TurnedImage { turn, size };
                for [x, y, z] in [[0.0, 0.0, 0.5], [0.2, -0.1, 0.8], [-0.1, 0.2, 1.4]] {
                    let upright = Point::new(x, y, z);
                    let seen = turn.native_from_upright(&upright);
                    let near = |a: [f32; 2], b: [f32; 2]| {
                        let [dx, dy] = [a[0] - b[0], a[1] - b[1]];
                        assert!(dx.hypot(dy) < 1e-3, "{turn:?}: {a:?}, expected {b:?}");
                    };
                    let expected = image([632, 480]).upright_pixel(native.depth_pixel(&seen));
                    near(turned.depth_pixel(&upright), expected);
                    let expected = image([640, 480]).upright_pixel(native.colour_pixel(&seen));
                    near(turned.colour_pixel(&upright), expected);
                    let [col, row] = turned.depth_pixel(&upright);
                    assert!((turned.point(col, row, z) - upright).norm() < 1e-5);
                }
            }
        }
    }

    #[test]
    fn distortion_equals_opencv() {
        // cv2.projectPoints, fx = fy = 600, cx = 320, cy = 240.
        let lens = Distortion([-0.2, 0.1, 0.001, -0.002, 0.05]);
        let p = lens.distorted(&Point::new(0.2, -0.1, 0.8));
        let (col, row) = (320.0 + 600.0 * p.x, 240.0 + 600.0 * p.y);
        assert!((col - 467.4701).abs() < 1e-3 && (row - 166.2649).abs() < 1e-3);
    }
}
