//! `camera.json`: both cameras of a recording, and where one is from the other.

use serde::Deserialize;

use mien_stages::base::geometry::{Rigid, Rotation, Vector};
use mien_stages::camera::{Distortion, Pinhole};

/// Widest and highest picture, pixels.
const SIZE_MOST: usize = 8192;
/// Off a rotation's rows by more than this, they are none.
const UNIT: f32 = 1e-2;
/// Coefficients of a lens, at most.
const BENT_MOST: f32 = 10.0;

/// One camera. Pixels; pixel centres are whole numbers, (0, 0) is the centre of the upper left one.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct View {
    width: usize,
    height: usize,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
    /// Of a depth picture: 0.001 for millimetres, 0.0002 in the TUM data sets.
    #[serde(default = "millimetres")]
    pub(super) metres_per_unit: f32,
    /// Of a 16-bit picture, the value that is white.
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

impl View {
    /// Columns and rows.
    pub(super) fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// The view of its pictures, as large as the file has them.
    pub(super) fn pinhole(&self) -> Pinhole {
        Pinhole {
            focal: [self.fx, self.fy],
            centre: [self.cx, self.cy],
        }
    }

    /// What is wrong with it: its key, what is expected and what was found.
    fn fault(&self) -> Option<String> {
        let (size, focal, centre) = (self.size(), [self.fx, self.fy], [self.cx, self.cy]);
        let bent = self.distortion.0;
        Some(if size.iter().any(|n| !(64..=SIZE_MOST).contains(n)) {
            format!("width and height are {size:?}, expected 64 to {SIZE_MOST} pixels")
        } else if focal.iter().any(|f| !(16.0..1e5).contains(f)) {
            format!("fx and fy are {focal:?}, expected focal lengths in pixels")
        } else if centre.iter().any(|c| c.is_nan() || c.abs() >= 1e4) {
            format!("cx and cy are {centre:?}, expected a column and a row")
        } else if !(1e-6..=1.0).contains(&self.metres_per_unit) {
            let found = self.metres_per_unit;
            format!("metres_per_unit is {found}, expected 0.001 for millimetres or 0.0002 for TUM")
        } else if !(1..=65535).contains(&self.white) {
            format!("white is {}, expected 1 to 65535", self.white)
        } else if bent.iter().any(|k| k.is_nan() || k.abs() > BENT_MOST) {
            format!("distortion is {bent:?}, expected k1, k2, p1, p2, k3")
        } else {
            return None;
        })
    }
}

/// A rigid motion of its 4 × 4 matrix, row by row; what is wrong with it otherwise.
fn rigid(m: &[f32; 16]) -> Result<Rigid, String> {
    let rows = [0, 1, 2].map(|row| Vector::new(m[4 * row], m[4 * row + 1], m[4 * row + 2]));
    let place = Vector::new(m[3], m[7], m[11]);
    let is_turn = rows.iter().all(|row| (row.norm() - 1.0).abs() < UNIT)
        && (rows[0].cross(&rows[1]) - rows[2]).norm() < UNIT;
    if !is_turn || m[12..] != [0.0, 0.0, 0.0, 1.0] {
        return Err("colour_from_depth is not a rotation and a translation, expected four rows of four numbers, the last of them 0 0 0 1".into());
    }
    if place.iter().any(|m| m.is_nan() || m.abs() >= 1.0) {
        let found: [f32; 3] = place.into();
        return Err(format!(
            "the translation of colour_from_depth is {found:?}, expected metres, each below 1; are these millimetres?"
        ));
    }
    let rows = rows.map(|row| row.transpose());
    let turn = nalgebra::Rotation3::from_matrix(&nalgebra::Matrix3::from_rows(&rows));
    Ok(Rigid::from_parts(
        place.into(),
        Rotation::from_rotation_matrix(&turn),
    ))
}

/// Both cameras.
pub(super) struct Calibration {
    pub(super) depth: View,
    pub(super) colour: View,
    pub(super) colour_from_depth: Rigid,
}

impl Calibration {
    /// Reads the file; what is wrong in a sentence otherwise.
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Both {
            depth: View,
            colour: Option<View>,
            colour_from_depth: Option<[f32; 16]>,
        }
        let both: Both = serde_json::from_str(text).map_err(|error| error.to_string())?;
        // An infrared picture is the depth camera's own.
        let colour = both.colour.unwrap_or_else(|| both.depth.clone());
        if both.depth.distortion != Distortion::default() {
            return Err(
                "depth: distortion is not supported; undistort the depth pictures first".into(),
            );
        }
        for (name, view) in [("depth", &both.depth), ("colour", &colour)] {
            if let Some(fault) = view.fault() {
                return Err(format!("{name}: {fault}"));
            }
        }
        let colour_from_depth = both.colour_from_depth.as_ref().map(rigid);
        Ok(Self {
            depth: both.depth,
            colour,
            colour_from_depth: colour_from_depth
                .transpose()?
                .unwrap_or_else(Rigid::identity),
        })
    }
}
