//! What a shape must do, as its recipe says, and by how much it misses that.
//!
//! Units: eye distances.

use super::head::Head;
use super::measure::lid_gap;
use super::mesh::Vec3;

/// What is asked.
#[derive(Clone, Debug)]
pub enum Deed {
    /// The middles of two groups of points end at least so far apart.
    Part,
    /// They end at most so much further apart than in the neutral, where lips need not touch.
    Meet,
    /// One moves at most so many times as far as the other.
    Less,
    /// The lid lines of an eye end at most so far apart anywhere.
    Lids(usize),
    /// The points move at least so far, each in its direction.
    Move(Vec<Vec3>),
}

/// One thing that a shape must do.
#[derive(Clone, Debug)]
pub struct Promise {
    /// What.
    pub deed: Deed,
    /// The points meant, as vertices.
    pub one: Vec<u32>,
    /// The points they are compared with.
    pub other: Vec<u32>,
    /// How far, at least or at most.
    pub bound: f64,
    /// The same as the recipe says it.
    pub words: String,
}

impl Promise {
    /// What is found instead, in words; `at` is where vertices are.
    #[must_use]
    pub fn missed(&self, head: &Head, at: &impl Fn(usize) -> Vec3) -> Option<String> {
        let w = head.eye_distance;
        let middle = |some: &[u32], p: &dyn Fn(usize) -> Vec3| {
            some.iter().map(|&v| p(v as usize)).sum::<Vec3>() / some.len().max(1) as f64
        };
        let neutral = |v: usize| head.mesh.positions[v];
        let moves = |some: &[u32]| (middle(some, at) - middle(some, &neutral)).norm();
        let apart =
            |p: &dyn Fn(usize) -> Vec3| (middle(&self.one, p) - middle(&self.other, p)).norm() / w;
        let (found, kept) = match &self.deed {
            Deed::Part => (apart(at), apart(at) >= self.bound),
            Deed::Meet => {
                let further = apart(at) - apart(&neutral);
                (further, further <= self.bound)
            }
            Deed::Less => {
                let share = moves(&self.one) / moves(&self.other).max(f64::MIN_POSITIVE);
                (share, share <= self.bound)
            }
            Deed::Lids(side) => {
                let gap = lid_gap(head, *side, |v| at(v as usize)) / w;
                (gap, gap <= self.bound)
            }
            Deed::Move(ways) => {
                let moved = self
                    .one
                    .iter()
                    .map(|&v| at(v as usize) - neutral(v as usize));
                let along = moved.zip(ways).map(|(d, way)| d.dot(way));
                let mean = along.sum::<f64>() / self.one.len().max(1) as f64 / w;
                (mean, mean >= self.bound)
            }
        };
        (!kept).then(|| format!("{}: {found:.2} instead of {:.2}", self.words, self.bound))
    }
}
