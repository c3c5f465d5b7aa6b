//! The jaw's motion on the skin: every vertex follows one rigid motion by a share.
//!
//! The recipe gives the shares at the landmarks; they are 0 below the collar and above the cheekbones. Between,
//! they minimise `∫ |Δs|²` over the surface, with the lips cut apart. So the chin turns with the teeth, and the
//! throat stretches down to the collar; a mask that ends below the chin moves its rim along. Vertices deep in the
//! mouth have their own share, [`Head::socket`].
//!
//! Units: the mesh's; shares are pure numbers. Cost: one factor a head, of the skin below the cheekbones.

use std::collections::BTreeMap;

use nalgebra::Isometry3;

use super::head::Head;
use super::mesh::Vec3;
use super::shape::Target;
use super::sparse::{Factor, Unknowns};
use mien_workbench::fault::Fault;

/// Height over the chin below which skin is fixed, as share of the ears' height.
const COLLAR: f64 = -0.55;
/// Height over the chin above which skin is fixed, as share of the ears' height.
const CHEEKBONE: f64 = 0.85;
/// Depth behind the ears beyond which skin is fixed, as share of the ears' height.
const NAPE: f64 = 0.2;

/// Rotation of the jaw, at most `most` radians, that lowers the middle of the lower lip's inner line by `lowers` eye
/// distances.
pub(super) fn opening(head: &Head, lowers: f64, most: f64) -> f64 {
    let arm = head.axes.transpose() * (head.point(66) - head.hinge) / head.eye_distance;
    // Rotated by a, the lip at distance r falls by r cos(b - a) - r cos b, where b is the angle of its arm from
    // straight down.
    let (size, at) = (arm.y.hypot(arm.z), arm.z.atan2(-arm.y));
    let reached = (lowers + size * at.cos()) / size;
    let turn = at - reached.clamp(-1.0, 1.0).acos();
    turn.clamp(0.0, most)
}

/// The share field, solved once for all shapes with a jaw.
pub(super) struct Jaw<'a> {
    head: &'a Head,
    /// Fixed shares of vertices that no recipe names.
    given: BTreeMap<u32, f64>,
    system: Option<(Unknowns, Factor)>,
}

impl<'a> Jaw<'a> {
    /// Solves the share field of one head for these targets.
    ///
    /// # Errors
    /// If the system is singular.
    pub(super) fn new(head: &'a Head, targets: &[Target]) -> Result<Self, Fault> {
        let mut out = Self {
            head,
            given: BTreeMap::new(),
            system: None,
        };
        let Some(first) = targets.iter().find(|t| !t.shares.is_empty()) else {
            return Ok(out);
        };
        for v in (0..head.skin.len()).filter(|&v| head.skin[v]) {
            if head.deep(v) {
                out.given.insert(v as u32, f64::from(head.socket[v]));
            } else if out.stays(&head.mesh.positions[v]) {
                out.given.insert(v as u32, 0.0);
            }
        }
        let named: Vec<u32> = first.shares.iter().map(|s| s.0).collect();
        let held = |v: usize| named.contains(&(v as u32)) || out.given.contains_key(&(v as u32));
        let unknowns = head.operator.unknowns(|v| head.skin[v] && !held(v));
        let factor = Factor::new(&head.operator.even(), &unknowns, |_| 0.0)?;
        out.system = Some((unknowns, factor));
        Ok(out)
    }

    /// Whether a point is out of the jaw's reach.
    fn stays(&self, p: &Vec3) -> bool {
        let seen = |p: Vec3| self.head.axes.transpose() * p;
        let (ears, chin) = (
            seen((self.head.point(0) + self.head.point(16)) / 2.0),
            seen(self.head.point(8)),
        );
        let (p, unit) = (seen(*p), ears.y - chin.y);
        let height = (p.y - chin.y) / unit;
        !(COLLAR..CHEEKBONE).contains(&height) || p.z < ears.z - NAPE * unit
    }

    /// Displacement of each skin vertex by the jaw in a shape; `None` if it has no jaw.
    pub(super) fn motion(&self, target: &Target) -> Option<Vec<Vec3>> {
        let (jaw, (unknowns, factor)) = (target.jaw.as_ref()?, self.system.as_ref()?);
        let mut share = vec![0.0; self.head.skin.len()];
        for (&v, &given) in &self.given {
            share[v as usize] = given;
        }
        for &(v, given) in &target.shares {
            share[v as usize] = given;
        }
        let mut solved = factor.pulled(|v| [share[v]]);
        factor.solve(&mut solved);
        for (&v, [s]) in unknowns.rows.iter().zip(&solved) {
            share[v as usize] = s.clamp(0.0, 1.0);
        }
        let positions = &self.head.mesh.positions;
        let moved = positions.iter().zip(share);
        Some(moved.map(|(p, s)| turned(jaw, p) * s).collect())
    }
}

/// Displacement of a point by a rigid motion.
pub(super) fn turned(jaw: &Isometry3<f64>, p: &Vec3) -> Vec3 {
    jaw.transform_point(&(*p).into()).coords - p
}
