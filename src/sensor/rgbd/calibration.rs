//! `camera.toml`: both cameras of a recording, and where one is from the other.

use serde::Deserialize;

use crate::base::geometry::{Rigid, Rotation, Vector};

/// Widest and highest picture, pixels.
const SIZE_MOST: usize = 8192;
/// Off a rotation's rows by more than this, they are none.
const UNIT: f32 = 1e-2;

/// One camera. Pixels; pixel centres are whole numbers, (0, 0) is the centre of the upper left one.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct View {
    /// Columns and rows.
    pub(super) size: [usize; 2],
    /// Focal lengths along column and row.
    pub(super) focal: [f32; 2],
    /// Column and row of the optical axis.
    pub(super) centre: [f32; 2],
    /// Of a depth picture, what is a metre: 1000 for millimetres, 5000 in the TUM data sets.
    #[serde(default = "millimetres")]
    pub(super) units_per_m: f32,
    /// Of a 16-bit picture, the value that is white.
    #[serde(default = "all_bits")]
    pub(super) white: u32,
    /// Rows of the rotation from the depth camera's frame to this one's; x right, y down, z forward.
    #[serde(default = "unturned")]
    rotation: [[f32; 3]; 3],
    /// Where the depth camera is in this one's frame, metres.
    #[serde(default)]
    translation: [f32; 3],
}

fn millimetres() -> f32 {
    1000.0
}

fn all_bits() -> u32 {
    65535
}

fn unturned() -> [[f32; 3]; 3] {
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
}

impl View {
    pub(super) fn picture_from_sensor(&self) -> Rigid {
        let rows = self.rotation.map(|row| Vector::from(row).transpose());
        let turn = nalgebra::Rotation3::from_matrix(&nalgebra::Matrix3::from_rows(&rows));
        let turn = Rotation::from_rotation_matrix(&turn);
        Rigid::from_parts(Vector::from(self.translation).into(), turn)
    }

    /// What is wrong with it: its key, what is expected and what was found.
    fn fault(&self) -> Option<String> {
        let rows = self.rotation.map(Vector::from);
        let is_turn = rows.iter().all(|row| (row.norm() - 1.0).abs() < UNIT)
            && (rows[0].cross(&rows[1]) - rows[2]).norm() < UNIT;
        let far = self
            .translation
            .iter()
            .any(|m| m.is_nan() || m.abs() >= 1.0);
        let (size, focal) = (self.size, self.focal);
        Some(if size.iter().any(|n| !(64..=SIZE_MOST).contains(n)) {
            format!("size is {size:?}, expected columns and rows of 64 to {SIZE_MOST} pixels")
        } else if focal.iter().any(|f| !(16.0..1e5).contains(f)) {
            format!("focal is {focal:?}, expected two focal lengths in pixels")
        } else if self.centre.iter().any(|c| c.is_nan() || c.abs() >= 1e4) {
            format!("centre is {:?}, expected a column and a row", self.centre)
        } else if !(1.0..1e6).contains(&self.units_per_m) {
            let found = self.units_per_m;
            format!("units_per_m is {found}, expected 1000 for millimetres, 5000 as TUM's")
        } else if !(1..=65535).contains(&self.white) {
            format!("white is {}, expected 1 to 65535", self.white)
        } else if !is_turn {
            "rotation is none; expected three rows, each of length 1, at right angles".to_owned()
        } else if far {
            let found = self.translation;
            format!("translation is {found:?}, expected metres, below 1; are these millimetres?")
        } else {
            return None;
        })
    }
}

/// Both cameras.
pub(super) struct Calibration {
    pub(super) depth: View,
    pub(super) picture: View,
}

impl Calibration {
    /// Reads the file; what is wrong in a sentence otherwise.
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Both {
            depth: View,
            picture: Option<View>,
        }
        let both: Both = toml::from_str(text).map_err(|error| {
            let before = &text[..error.span().map_or(0, |span| span.start.min(text.len()))];
            let line = before.matches('\n').count() + 1;
            format!("line {line}: {}", error.message().replace('\n', ", "))
        })?;
        // An infrared picture is the depth camera's own.
        let picture = both.picture.unwrap_or_else(|| both.depth.clone());
        for (name, view) in [("depth", &both.depth), ("picture", &picture)] {
            if let Some(fault) = view.fault() {
                return Err(format!("{name}.{fault}"));
            }
        }
        let depth = both.depth;
        Ok(Self { depth, picture })
    }
}
