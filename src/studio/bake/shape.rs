//! One baked shape, as the solver leaves it and as report and files take it.

use super::mesh::Vec3;

/// Between the names of two shapes in that of their corrective, as rigging tools and engines write it.
pub const PAIR: &str = "_";

/// The two shapes that `name` is the corrective of, if it is one; `exists` says whether there is a shape of a name.
#[must_use]
pub fn pair(name: &str, exists: impl Fn(&str) -> bool) -> Option<[&str; 2]> {
    let (a, b) = name.split_once(PAIR)?;
    (exists(a) && exists(b)).then_some([a, b])
}

/// One baked shape.
#[derive(Clone, Debug, Default)]
pub struct Shape {
    /// Name of the morph target.
    pub name: String,
    /// Expression unit that drives it.
    pub unit: Option<String>,
    /// Shape it is meant to be added to.
    pub upon: Option<String>,
    /// What it must do and does not, in words; `None` if nothing is asked of it.
    pub misses: Option<Vec<String>>,
    /// Per vertex, mesh units.
    pub displacement: Vec<Vec3>,
    /// Vertices that were allowed to move.
    pub area: Vec<bool>,
}

impl Shape {
    /// The shapes it is added to.
    pub fn beneath<'a>(&'a self, all: &'a [Self]) -> impl Iterator<Item = &'a Self> {
        let pair = pair(&self.name, |name| all.iter().any(|s| s.name == name));
        let pair = pair.into_iter().flatten();
        let names = self.upon.as_deref().into_iter().chain(pair);
        names.filter_map(|name| all.iter().find(|s| s.name == *name))
    }
}
