//! One shape as it is asked for.

use nalgebra::{Isometry3, Rotation3};

use super::mesh::Vec3;
use super::promise::Promise;
use super::shape::PAIR;

/// One shape measured out on a head: what moves, in the mesh's unit and axes.
#[derive(Clone, Debug, Default)]
pub struct Target {
    /// Name of the morph target.
    pub name: String,
    /// Expression unit that drives it.
    pub unit: Option<String>,
    /// Shape it is meant to be added to.
    pub upon: Option<String>,
    /// Displacements of control vertices; those not named are free.
    pub controls: Vec<(u32, Vec3)>,
    /// The controls must be met exactly, even at the price of an inverted triangle.
    pub exact: bool,
    /// The skin between the controls moves as learned from sculpted shapes, see [`super::prior`].
    pub derive: bool,
    /// Lid closing per eye (left, right): amount and line.
    pub close: [Option<(f64, f64)>; 2],
    /// Eyeball rotation per eye.
    pub gaze: [Option<Rotation3<f64>>; 2],
    /// Motion of the jaw and what it carries.
    pub jaw: Option<Isometry3<f64>>,
    /// Displacement of the tongue's tip.
    pub tongue: Option<Vec3>,
    /// Shape whose effect on the lip line is taken back, and its share.
    pub undo: Option<(String, f64)>,
    /// The two shapes that this one makes together; what is left of it when both are taken off is their corrective.
    pub corrects: Option<[String; 2]>,
    /// What is checked once it is baked.
    pub must: Vec<Promise>,
}

impl Target {
    /// Both shapes at once. Of two that close a lid the one that closes it further says how.
    pub(super) fn with(&self, other: &Self, of: [String; 2]) -> Self {
        let mut controls = self.controls.clone();
        for &(v, d) in &other.controls {
            match controls.iter_mut().find(|c| c.0 == v) {
                Some(control) => control.1 += d,
                None => controls.push((v, d)),
            }
        }
        let sides = [0, 1];
        Self {
            name: of.join(PAIR),
            controls,
            exact: self.exact || other.exact,
            derive: self.derive && other.derive,
            close: sides.map(|side: usize| match (self.close[side], other.close[side]) {
                (Some(a), Some(b)) => Some(if a.0 >= b.0 { a } else { b }),
                (a, b) => a.or(b),
            }),
            gaze: sides.map(|side: usize| self.gaze[side].or(other.gaze[side])),
            jaw: self.jaw.or(other.jaw),
            tongue: self.tongue.or(other.tongue),
            corrects: Some(of),
            ..Self::default()
        }
    }
}
