//! Meshes with a colour for every vertex.

use crate::bake::mesh::{Corner, Mesh, Vec3};

/// A mesh with a colour and a place in its picture for every vertex.
#[derive(Default)]
pub struct Layer {
    /// Faces; their materials are indices of looks.
    pub mesh: Mesh,
    /// Vertex factors of the look's colour, linear.
    pub tints: Vec<[f32; 3]>,
    /// Texture coordinates, origin at the top left.
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
        let corners: Vec<Corner> = corners.iter().map(|&v| Corner::bare(v)).collect();
        self.mesh.push_face(&corners, look as u32);
    }
}
