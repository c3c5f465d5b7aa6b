//! Control points on cheeks and forehead that no landmark gives, placed and moved by what the 68 do.

use super::head::Head;
use super::mesh::Vec3;

/// Adds the derived points of a head to a list of controls that holds its landmarks.
pub fn derive(_head: &Head, _controls: &mut Vec<(u32, Vec3)>) {}
