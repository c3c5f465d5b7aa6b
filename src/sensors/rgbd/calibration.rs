//! `camera.json`: the cameras of a recording and the pose between them.

use serde::Deserialize;

use mien_stages::base::geometry::{Rigid, Rotation, Vector};
use mien_stages::camera::{Camera, ColourProjection, DepthScale, Distortion, Pinhole};

use crate::reduction::{Reduction, SIZES, assumed_view};

/// Largest calibration file, bytes.
pub(crate) const CALIBRATION_MAX: usize = 1 << 16;

/// Largest deviation of a matrix from a rotation.
const ROTATION_TOLERANCE: f32 = 1e-2;
/// Largest plausible distortion coefficient.
const COEFFICIENT_MAX: f32 = 10.0;

/// One camera. Pixels; pixel centres are integers, (0, 0) is the centre of the upper left pixel.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Intrinsics {
    width: usize,
    height: usize,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
    /// Scale of depth values: 0.001 for millimetres, 0.0002 in the TUM data sets.
    #[serde(default = "millimetres")]
    pub(super) metres_per_unit: f32,
    /// Value of a 16-bit picture that is white.
    #[serde(default = "all_bits")]
    pub(super) white: u32,
    #[serde(default)]
    pub(super) distortion: Distortion,
}

fn millimetres() -> f32 {
    0.001
}

fn all_bits() -> u32 {
    65535
}

impl Intrinsics {
    /// Of a camera that is unknown but for the size of its pictures.
    fn assumed(size: [usize; 2]) -> Self {
        let Pinhole { focal, centre } = assumed_view(size);
        Self {
            width: size[0],
            height: size[1],
            fx: focal[0],
            fy: focal[1],
            cx: centre[0],
            cy: centre[1],
            metres_per_unit: millimetres(),
            white: all_bits(),
            distortion: Distortion::default(),
        }
    }

    /// How its pictures become those of a frame.
    pub(crate) fn reduction(&self) -> Reduction {
        Reduction::new(self.size())
    }

    /// Columns and rows.
    pub(crate) fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Pinhole of the pictures at the file's size.
    fn pinhole(&self) -> Pinhole {
        Pinhole {
            focal: [self.fx, self.fy],
            centre: [self.cx, self.cy],
        }
    }

    /// The first invalid key, with the expected and the found value.
    fn problem(&self) -> Option<String> {
        let (size, focal, centre) = (self.size(), [self.fx, self.fy], [self.cx, self.cy]);
        let coefficients = self.distortion.0;
        Some(if size.iter().any(|n| !SIZES.contains(n)) {
            let (least, most) = (SIZES.start(), SIZES.end());
            format!("width and height are {size:?}, expected {least} to {most} pixels")
        } else if focal.iter().any(|f| !(16.0..1e5).contains(f)) {
            format!("fx and fy are {focal:?}, expected focal lengths in pixels")
        } else if centre.iter().any(|c| c.is_nan() || c.abs() >= 1e4) {
            format!("cx and cy are {centre:?}, expected a column and a row")
        } else if !(1e-6..=1.0).contains(&self.metres_per_unit) {
            let found = self.metres_per_unit;
            format!("metres_per_unit is {found}, expected 0.001 for millimetres or 0.0002 for TUM")
        } else if !(1..=65535).contains(&self.white) {
            format!("white is {}, expected 1 to 65535", self.white)
        } else if coefficients
            .iter()
            .any(|k| k.is_nan() || k.abs() > COEFFICIENT_MAX)
        {
            format!("distortion is {coefficients:?}, expected k1, k2, p1, p2, k3")
        } else {
            return None;
        })
    }
}

/// The rigid motion of a 4 × 4 matrix, row by row, metres.
///
/// # Errors
/// The problem with the matrix.
fn rigid(m: &[f32; 16]) -> Result<Rigid, String> {
    let rows = [0, 1, 2].map(|row| Vector::new(m[4 * row], m[4 * row + 1], m[4 * row + 2]));
    let translation = Vector::new(m[3], m[7], m[11]);
    let is_rotation = rows
        .iter()
        .all(|row| (row.norm() - 1.0).abs() < ROTATION_TOLERANCE)
        && (rows[0].cross(&rows[1]) - rows[2]).norm() < ROTATION_TOLERANCE;
    if !is_rotation || m[12..] != [0.0, 0.0, 0.0, 1.0] {
        return Err("colour_from_depth is not a rotation and a translation, expected four rows of four numbers, the last of them 0 0 0 1".into());
    }
    if translation.iter().any(|m| m.is_nan() || m.abs() >= 1.0) {
        let found: [f32; 3] = translation.into();
        return Err(format!(
            "the translation of colour_from_depth is {found:?}, expected metres, each below 1; are these millimetres?"
        ));
    }
    let rows = rows.map(|row| row.transpose());
    let rotation = nalgebra::Rotation3::from_matrix(&nalgebra::Matrix3::from_rows(&rows));
    Ok(Rigid::from_parts(
        translation.into(),
        Rotation::from_rotation_matrix(&rotation),
    ))
}

/// The cameras and the pose between them.
pub(crate) struct Calibration {
    /// `None` for a recording of colour alone.
    pub(crate) depth: Option<Intrinsics>,
    pub(crate) colour: Intrinsics,
    /// Whether `colour` is a camera of its own.
    pub(crate) has_colour: bool,
    colour_from_depth: Rigid,
}

impl Calibration {
    /// Parses the file.
    ///
    /// # Errors
    /// The problem, in a sentence.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct File {
            depth: Option<Intrinsics>,
            colour: Option<Intrinsics>,
            colour_from_depth: Option<[f32; 16]>,
        }
        let file: File = serde_json::from_str(text).map_err(|error| error.to_string())?;
        // Without a colour camera, pictures are infrared ones of the depth camera.
        let has_colour = file.colour.is_some();
        let colour = file.colour.or_else(|| file.depth.clone());
        let colour = colour
            .ok_or("expected `depth`, `colour` or both, found neither; see docs/recordings.md")?;
        let mut calibration = Self {
            depth: file.depth,
            colour,
            has_colour,
            colour_from_depth: Rigid::identity(),
        }
        .check()?;
        if let Some(matrix) = &file.colour_from_depth {
            calibration.colour_from_depth = rigid(matrix)?;
        }
        Ok(calibration)
    }

    /// Of cameras that are unknown but for the size of their pictures, and see the same.
    pub(crate) fn assumed(depth: Option<[usize; 2]>, colour: [usize; 2]) -> Self {
        Self {
            depth: depth.map(Intrinsics::assumed),
            colour: Intrinsics::assumed(colour),
            has_colour: false,
            colour_from_depth: Rigid::identity(),
        }
    }

    /// Itself, if every key is valid.
    ///
    /// # Errors
    /// The first invalid one.
    pub(super) fn check(self) -> Result<Self, String> {
        for (name, view) in [
            ("depth", self.depth.as_ref()),
            ("colour", Some(&self.colour)),
        ] {
            if let Some(problem) = view.and_then(Intrinsics::problem) {
                return Err(format!("{name}: {problem}"));
            }
        }
        let is_distorted = |view: &Intrinsics| view.distortion != Distortion::default();
        if self.depth.as_ref().is_some_and(is_distorted) {
            return Err(
                "depth: distortion is not supported; undistort the depth pictures first".into(),
            );
        }
        Ok(self)
    }

    /// Geometry of the reduced pictures.
    pub(crate) fn camera(&self) -> Camera {
        let (colour, distortion) = (self.colour.reduction(), self.colour.distortion);
        let view = colour.averaged(self.colour.pinhole());
        let Some(depth) = &self.depth else {
            return Camera::without_depth(view, distortion, colour.frame_size());
        };
        Camera::new(
            DepthScale::metric(depth.metres_per_unit),
            depth.reduction().picked(depth.pinhole()),
            depth.reduction().frame_size(),
            ColourProjection::Pinhole {
                distortion,
                view,
                colour_from_sensor: self.colour_from_depth,
            },
        )
    }
}
