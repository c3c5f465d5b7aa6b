//! The standard head: evenly spaced points with normals on the part of a head that a depth camera in front of it
//! sees.
//!
//! Made from the mean identity's neutral mesh: face, temples and the front of the cranium. Left out are the neck and the
//! underside of the chin (they move against the head), the ears (thin, and under hair), the inside of mouth and eyes, and
//! the back of the head. Points are chosen by dart throwing over a dense deterministic sampling of the triangles: the
//! first sample is kept, every later one that is further than [`SPACING_M`] from all kept ones is kept too.
//!
//! Head frame, metres; normals are unit vectors out of the head. Same mesh, same points.

use std::collections::HashMap;

use mien_baking::heads::ict::{IctHead, part};
use mien_simulator::virtual_head::raster::sum_normals;
use mien_stages::base::geometry::{Point, Vector};

/// Least distance of two points, metres; yields about 1800.
pub const SPACING_M: f32 = 0.0047;
/// Largest depth in the head frame: behind the temples the surface is ear, hair or hidden.
const BACK_M: f32 = 0.085;
/// Half width from which the mesh is ear.
const EAR_M: f32 = 0.079;

/// Whether a point of the head frame belongs to the standard head: in front of the ears and above the line from the
/// chin to below the ear.
fn wanted(p: &Point) -> bool {
    p.z < BACK_M && p.x.abs() < EAR_M && p.y < 0.110 - 0.75 * (p.z + 0.012).max(0.0)
}

/// A cell and its neighbours.
fn around(cell: [i32; 3]) -> impl Iterator<Item = [i32; 3]> {
    let [x, y, z] = cell;
    (0..27).map(move |k| [x + k / 9 - 1, y + k / 3 % 3 - 1, z + k % 3 - 1])
}

/// Points (head frame, metres) and outward unit normals of the standard head, about 1800, evenly spread.
pub fn standard_head(ict: &IctHead) -> Vec<(Point, Vector)> {
    let skin = part::HEAD_AND_NECK.end;
    let mut normals = vec![Vector::zeros(); ict.neutral.len()];
    let triangles = ict.triangles.iter().map(|t| t.map(|v| v as usize));
    sum_normals(triangles, &ict.neutral, &mut normals);
    // The winding's sign comes from the mesh: the tip of the nose points to −z.
    let sign = -normals[ict.landmarks[30]].z.signum();
    let mut kept: Vec<(Point, Vector)> = Vec::new();
    let mut cells: HashMap<[i32; 3], Vec<usize>> = HashMap::new();
    for t in &ict.triangles {
        if t.iter().any(|&v| v as usize >= skin) {
            continue;
        }
        let corner = t.map(|v| ict.neutral[v as usize]);
        let normal = t.map(|v| normals[v as usize]);
        let sides = (0..3).map(|k| (corner[k] - corner[(k + 1) % 3]).norm());
        let longest = sides.fold(0.0, f32::max);
        let steps = (longest / (0.4 * SPACING_M)).ceil().max(1.0) as u32;
        for i in 0..=steps {
            for j in 0..=steps - i {
                let (u, v) = (i as f32 / steps as f32, j as f32 / steps as f32);
                let w = 1.0 - u - v;
                let p =
                    Point::from(corner[0].coords * u + corner[1].coords * v + corner[2].coords * w);
                if !wanted(&p) {
                    continue;
                }
                let cell = [p.x, p.y, p.z].map(|c| (c / SPACING_M).floor() as i32);
                let crowded = around(cell).any(|near| {
                    let there = cells.get(&near).into_iter().flatten();
                    let near = |&k: &usize| (kept[k].0 - p).norm_squared();
                    there.map(near).any(|apart| apart < SPACING_M * SPACING_M)
                });
                if crowded {
                    continue;
                }
                let n = (normal[0] * u + normal[1] * v + normal[2] * w) * sign;
                if let Some(n) = n.try_normalize(1e-12) {
                    cells.entry(cell).or_default().push(kept.len());
                    kept.push((p, n));
                }
            }
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stands_on_the_front_of_the_head_evenly() {
        let Some(folder) = crate::data::folder(crate::data::Set::IctFacekit) else {
            return;
        };
        let ict = IctHead::read(&folder).unwrap();
        let head = standard_head(&ict);
        println!("{} points", head.len());
        assert!((1500..=2000).contains(&head.len()), "{} points", head.len());
        // Outwards: away from the middle of the head, nearly everywhere.
        let middle = Point::new(0.0, 0.02, 0.09);
        let outward = head
            .iter()
            .filter(|(p, n)| (p - middle).dot(n) > 0.0)
            .count();
        assert!(
            outward * 100 >= head.len() * 95,
            "{outward} of {}",
            head.len()
        );
        assert!(head.iter().all(|(_, n)| (n.norm() - 1.0).abs() < 1e-4));
        // Left and right weigh the same: the mean identity is symmetric.
        let mean_x = head.iter().map(|(p, _)| p.x).sum::<f32>() / head.len() as f32;
        assert!(mean_x.abs() < 1e-3, "{mean_x}");
    }
}
