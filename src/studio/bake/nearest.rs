//! The nearest of a set of vertices, by a k-d tree. Units: the mesh's. Memory: linear; a query takes microseconds.

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use super::mesh::Vec3;

/// A set of vertices.
pub(in crate::studio) struct Nearest {
    /// `None` for an empty set.
    tree: Option<ImmutableKdTree<f64, 3>>,
    vertices: Vec<u32>,
}

impl Nearest {
    /// Of some vertices of a mesh.
    pub(in crate::studio) fn new(positions: &[Vec3], some: &[u32]) -> Self {
        let points: Vec<[f64; 3]> = some.iter().map(|&v| positions[v as usize].into()).collect();
        let tree = (!points.is_empty()).then(|| ImmutableKdTree::new_from_slice(&points).ok());
        Self {
            tree: tree.flatten(),
            vertices: some.to_vec(),
        }
    }

    /// The vertex nearest to a point; `None` if the set is empty.
    pub(in crate::studio) fn of(&self, p: &Vec3) -> Option<u32> {
        let point = [p.x, p.y, p.z];
        let found = self.tree.as_ref()?.query(&point);
        let found = found.nearest_one::<SquaredEuclidean<f64>>().execute();
        self.vertices.get(found.item as usize).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_what_looking_at_all_of_them_finds() {
        let mut random = fastrand::Rng::with_seed(7);
        let mut point = |size: f64| Vec3::from_fn(|_, _| (random.f64() - 0.5) * size);
        let positions: Vec<Vec3> = (0..500).map(|_| point(2.0)).collect();
        let some: Vec<u32> = (0..500).filter(|v| v % 3 == 0).collect();
        let nearest = Nearest::new(&positions, &some);
        for _ in 0..300 {
            let p = point(4.0);
            let far = |v: u32| (positions[v as usize] - p).norm();
            let best = some.iter().map(|&v| far(v)).fold(f64::INFINITY, f64::min);
            assert!((far(nearest.of(&p).unwrap()) - best).abs() < 1e-12);
        }
        assert_eq!(Nearest::new(&positions, &[]).of(&positions[0]), None);
        assert_eq!(Nearest::new(&positions, &[5]).of(&positions[9]), Some(5));
    }
}
