//! One baked shape, as the solver leaves it and as report and files take it.

use super::mesh::Vec3;

/// One baked shape.
#[derive(Clone, Debug)]
pub struct Shape {
    /// Name of the morph target.
    pub name: String,
    /// Expression unit that drives it.
    pub unit: Option<String>,
    /// Shape it is meant to be added to.
    pub upon: Option<String>,
    /// Per vertex, mesh units.
    pub displacement: Vec<Vec3>,
    /// Vertices that were allowed to move.
    pub area: Vec<bool>,
    /// Size of the solved system.
    pub unknowns: usize,
    /// Time it took, milliseconds.
    pub milliseconds: f64,
}
