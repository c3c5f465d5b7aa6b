//! Meshes with a colour for every vertex, and the numbers of the looks that their faces have.

use crate::studio::bake::mesh::{Corner, Mesh, Vec3};

/// Places of the looks in the list of a head's looks.
pub mod look {
    pub(in crate::studio::heads::hero) const SKIN: usize = 0;
    /// Skin where the picture does not reach: back of head and neck.
    pub(in crate::studio::heads::hero) const BEHIND: usize = 1;
    pub(in crate::studio::heads::hero) const MOUTH: usize = 2;
    pub(in crate::studio::heads::hero) const GUMS: usize = 3;
    pub(in crate::studio::heads::hero) const TEETH: usize = 4;
    pub(in crate::studio::heads::hero) const EYES: usize = 5;
    pub(in crate::studio::heads::hero) const SOCKETS: usize = 6;
    pub(in crate::studio::heads::hero) const LASHES: usize = 7;
    pub(in crate::studio::heads::hero) const HAIR: usize = 8;
    pub(in crate::studio::heads::hero) const SHIRT: usize = 9;
}

/// A mesh with a colour and a place in its picture for every vertex.
#[derive(Default)]
pub struct Layer {
    /// Faces; their materials are numbers of looks.
    pub mesh: Mesh,
    /// What the look's colour is multiplied with, linear.
    pub tints: Vec<[f32; 3]>,
    /// Place in the picture, origin at the top left.
    pub uv: Vec<[f32; 2]>,
}

impl Layer {
    pub(super) fn vertex(&mut self, place: Vec3, tint: [f32; 3]) -> u32 {
        self.mesh.positions.push(place);
        self.tints.push(tint);
        self.uv.push([0.0; 2]);
        self.mesh.positions.len() as u32 - 1
    }

    pub(super) fn face(&mut self, corners: &[u32], look: usize) {
        let corners: Vec<Corner> = corners
            .iter()
            .map(|&vertex| Corner {
                vertex,
                uv: None,
                normal: None,
            })
            .collect();
        self.mesh.push_face(&corners, look as u32);
    }
}
