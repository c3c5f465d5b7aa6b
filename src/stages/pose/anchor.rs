//! The anchor: the standard head, prepared so that finding its nearest point is one table look-up.
//!
//! Computed once: a grid of [`CELL_M`] cubes around the standard head with the index of the point nearest to each cube's
//! centre, the points on the rim of the open surface, and a trust weight per point. With points 5 mm apart and distances
//! along the normal, using a neighbour of the nearest point changes a distance by a fraction of a millimetre only, so the
//! look-up replaces a tree search in the tracking loop.
//!
//! Head frame, metres. Memory: about 0.6 MB of grid and 0.1 MB of points, built at construction (some tens of milliseconds).
//! Degenerate: an anchor of too few points is rejected. Limitation: points farther than [`MARGIN_M`] from the surface have no
//! nearest point; a start that far off needs the search over starts.

use nalgebra::{SMatrix, SVector};

use super::icp::{MIN_PAIRS, Target};
use crate::base::frames::HeadFromSensor;
use crate::base::geometry::{Point, Vector};
use crate::base::prelude::*;
use crate::base::vectors::{NO_FRACTION, with_avx2};

/// Side of a grid cell, metres.
const CELL_M: f32 = 0.004;
/// Largest distance of a point from the surface in the grid, metres.
pub(crate) const MARGIN_M: f32 = 0.040;
/// Most cells of the grid: ten times a head's.
const MAX_CELLS: usize = 1 << 22;
/// Neighbours per point, for the rim and smoothing.
pub(crate) const NEIGHBOURS: usize = 8;
/// Least angular gap between neighbours of a rim point, radians.
const RIM_GAP_RAD: f32 = 2.2;
/// Distance between points of the fine surface, metres.
const FINE_SPACING_M: f32 = 0.0015;
/// Subdivisions of an edge for the fine surface.
const EDGE_PARTS: u32 = 4;
/// Points of the fine surface added between two removals of duplicates.
const DEDUP_BATCH: usize = 1 << 16;
/// Longest edge of a triangle of the fine surface, metres.
const MAX_EDGE_M: f32 = 0.012;
/// Grid value of a cell without a point in reach.
const NO_POINT: u16 = u16::MAX;

/// Trust 0…1 in a point of the head: mouth and jaw move with speech, hair covers the upper cranium and the temples.
fn trust(p: &Point) -> f32 {
    let falling = |v: f32, from: f32, to: f32| ((to - v) / (to - from)).clamp(0.0, 1.0);
    let lower_face = 0.3 + 0.7 * falling(p.y, 0.030, 0.060);
    let hair = 0.4 + 0.6 * falling(-p.y, 0.065, 0.095);
    let side = 0.5 + 0.5 * falling(p.z, 0.045, 0.075);
    lower_face * hair * side
}

/// Whether a point belongs to the bare face: below the hairline, before the hair beside it, above the chin. Only there the
/// person's shape is fitted; elsewhere the surface may be hair, a cap or a collar.
fn is_bare_face(p: &Point) -> bool {
    p.y > -0.050 && p.y < 0.080 && p.z < 0.040 && p.x.abs() < 0.062
}

/// Number of parts of the head; see [`head_part`].
pub(crate) const HEAD_PARTS: usize = 3;

/// Part of the head of a point: 0 outside the bare face, 1 its beard area, 2 the rest of it.
fn head_part(p: &Point) -> u8 {
    u8::from(is_bare_face(p)) + u8::from(is_bare_face(p) && p.y < 0.060)
}

/// A point on a triangle of three anchor points: `shares` / [`EDGE_PARTS`] of the way to the second and to the third.
#[derive(Clone, Copy)]
struct SurfacePoint {
    corners: [u16; 3],
    shares: [u8; 2],
}

impl SurfacePoint {
    fn position(&self, vertex: impl Fn(usize) -> Point) -> Point {
        let [a, b, c] = self.corners.map(|i| vertex(usize::from(i)));
        let [u, v] = self.shares.map(|n| f32::from(n) / EDGE_PARTS as f32);
        a + (b - a) * u + (c - a) * v
    }
}

/// Points of a head's surface between its anchor points.
pub(crate) struct Surface(Vec<SurfacePoint>);

impl Surface {
    /// Its points for anchor points at `vertex(index)`, as an ICP target. `None` if points coincide.
    pub(crate) fn target(&self, vertex: impl Fn(usize) -> Point) -> Option<Target> {
        let points: Vec<Point> = self.0.iter().map(|point| point.position(&vertex)).collect();
        Target::new(&points)
    }
}

#[inline(always)]
fn cross(a: &Vector, b: &Vector) -> Vector {
    Vector::new(
        a.y * b.z - a.z * b.y,
        a.z * b.x - a.x * b.z,
        a.x * b.y - a.y * b.x,
    )
}

/// Points that [`Anchor::locate`] handles at a time.
pub(crate) const BATCH: usize = 64;

/// Points of a live cloud in the head frame, metres, by coordinate, so that they are moved several at a time.
pub(crate) struct Batch {
    x: [f32; BATCH],
    y: [f32; BATCH],
    z: [f32; BATCH],
    /// Distance from the camera, metres.
    pub(crate) distance: [f32; BATCH],
    /// Index of the grid's cell; beyond its end outside the grid.
    pub(crate) cell: [u32; BATCH],
}

impl Batch {
    pub(crate) const EMPTY: Self = Self {
        x: [0.0; BATCH],
        y: [0.0; BATCH],
        z: [0.0; BATCH],
        distance: [0.0; BATCH],
        cell: [u32::MAX; BATCH],
    };

    /// A point, head frame, metres.
    #[inline(always)]
    pub(crate) fn point(&self, k: usize) -> Point {
        Point::new(self.x[k], self.y[k], self.z[k])
    }
}

/// The prepared standard head.
pub struct Anchor {
    pub(crate) points: Vec<Point>,
    pub(crate) normals: Vec<Vector>,
    /// Weight of each point, 0…1.
    pub(crate) trust: Vec<f32>,
    /// Whether each point is on the rim of the open surface.
    pub(crate) rim: Vec<bool>,
    /// Part of each point, below [`HEAD_PARTS`].
    pub(crate) part: Vec<u8>,
    pub(crate) neighbours: Vec<[u16; NEIGHBOURS]>,
    /// Displacement of each point along its normal per unit of rotation (x, y, z), shift (x, y, z) and ln(scale).
    pub(crate) motions: Vec<[f32; 7]>,
    /// Inverse of the motions' normal matrix over the bare face, weighted by trust.
    pub(crate) motions_inverse: SMatrix<f64, 7, 7>,
    /// Patches for re-identification.
    pub(crate) patches: Patches,
    /// Tree of the points, for the point-to-point method.
    pub(crate) target: Target,
    /// Centre of the grid's first cell.
    low: Point,
    size: [usize; 3],
    grid: Vec<u16>,
}

impl Anchor {
    /// Prepares points and outward unit normals (head frame, metres). `None` with fewer than [`MIN_PAIRS`] or more than
    /// 65,534 points, a coordinate that is not finite, or an extent beyond any head.
    pub fn new(standard_head: &[(Point, Vector)]) -> Option<Self> {
        let points: Vec<Point> = standard_head.iter().map(|(p, _)| *p).collect();
        let normals: Vec<Vector> = standard_head.iter().map(|(_, n)| *n).collect();
        let finite = standard_head
            .iter()
            .all(|(p, n)| p.iter().chain(n.iter()).all(|c| c.is_finite()));
        if points.len() < MIN_PAIRS || points.len() >= usize::from(NO_POINT) || !finite {
            return None;
        }
        let target = Target::new(&points)?;
        let (mut low, mut high) = (points[0], points[0]);
        for p in &points {
            low = low.inf(p);
            high = high.sup(p);
        }
        let margin = Vector::repeat(MARGIN_M);
        let (low, high) = (low - margin, high + margin);
        let size = [0, 1, 2].map(|k| ((high[k] - low[k]) / CELL_M).ceil() as usize + 1);
        let cells = size.iter().try_fold(1_usize, |n, &k| n.checked_mul(k));
        if cells.is_none_or(|cells| cells > MAX_CELLS) {
            return None;
        }
        let grid = nearest_points(&points, &low, size);
        let neighbours = nearest_neighbours(&points);
        let motions: Vec<[f32; 7]> = points
            .iter()
            .zip(&normals)
            .map(|(a, n)| {
                let turn = a.coords.cross(n);
                [turn.x, turn.y, turn.z, n.x, n.y, n.z, n.dot(&a.coords)]
            })
            .collect();
        let rim = (0..points.len())
            .map(|i| on_rim(i, &points, &normals, &neighbours[i]))
            .collect();
        Some(Self {
            motions_inverse: normal_matrix_inverse(&points, &motions)?,
            patches: Patches::new(&points, &motions),
            motions,
            trust: points.iter().map(trust).collect(),
            part: points.iter().map(head_part).collect(),
            points,
            normals,
            rim,
            neighbours,
            target,
            low,
            size,
            grid,
        })
    }

    /// The surface as points [`FINE_SPACING_M`] apart, for the point-to-point method, which on points 5 mm apart moves in jumps.
    pub(crate) fn fine_surface(&self) -> Surface {
        let cell = |p: &Point| p.coords.map(|c| (c / FINE_SPACING_M).floor() as i32);
        // Most cells are hit many times; only the first point of each is kept, in batches to bound memory.
        let mut fine: Vec<([i32; 3], SurfacePoint)> = Vec::new();
        let thin = |fine: &mut Vec<([i32; 3], SurfacePoint)>| {
            fine.sort_by_key(|(cell, _)| *cell);
            fine.dedup_by_key(|(cell, _)| *cell);
        };
        let mut most = DEDUP_BATCH;
        let near = |a: usize, b: usize| (self.points[a] - self.points[b]).norm() < MAX_EDGE_M;
        for (i, beside) in self.neighbours.iter().enumerate() {
            if fine.len() > most {
                thin(&mut fine);
                most = fine.len() + DEDUP_BATCH;
            }
            for (n, &j) in beside.iter().enumerate() {
                for &k in &beside[n + 1..] {
                    let corners = [i as u16, j, k];
                    let [i, j, k] = corners.map(usize::from);
                    if !(near(i, j) && near(i, k) && near(j, k)) {
                        continue;
                    }
                    for u in 0..=EDGE_PARTS {
                        for v in 0..=EDGE_PARTS - u {
                            let shares = [u as u8, v as u8];
                            let between = SurfacePoint { corners, shares };
                            let p = between.position(|i| self.points[i]);
                            fine.push((cell(&p).into(), between));
                        }
                    }
                }
            }
        }
        thin(&mut fine);
        Surface(fine.into_iter().map(|(_, between)| between).collect())
    }

    /// Whether a point is on the bare face.
    pub(crate) fn is_bare(&self, point: usize) -> bool {
        self.part[point] > 0
    }

    /// Moves up to [`BATCH`] points (sensor frame, metres), every `stride`-th of `points`, by `pose` and finds their grid cells on a head
    /// `1 / inverse_scale` times the standard size.
    // Not inlined: its callers would contain it several times.
    #[inline(never)]
    pub(crate) fn locate(
        &self,
        points: &[Point],
        stride: usize,
        (pose, inverse_scale): (&HeadFromSensor, f32),
        batch: &mut Batch,
    ) {
        let (turn, shift) = (pose.rotation.coords, pose.translation.vector);
        let (low, size) = (self.low.coords, self.size.map(|cells| cells as u32));
        with_avx2(
            #[inline(always)]
            || {
                for k in 0..points.len().div_ceil(stride).min(BATCH) {
                    let p = &points[k * stride];
                    (batch.x[k], batch.y[k], batch.z[k]) = (p.x, p.y, p.z);
                }
                for k in 0..BATCH {
                    let p = Vector::new(batch.x[k], batch.y[k], batch.z[k]);
                    // Rotation by a quaternion, written out so that it vectorises.
                    let across = cross(&turn.xyz(), &p) * 2.0;
                    let turned = across * turn.w + cross(&turn.xyz(), &across) + p;
                    let q = turned + shift;
                    (batch.x[k], batch.y[k], batch.z[k]) = (q.x, q.y, q.z);
                    let seen = q - shift;
                    let squares = seen.x * seen.x + seen.y * seen.y + seen.z * seen.z;
                    batch.distance[k] = squares.sqrt();
                    let (mut at, mut is_inside) = (0_u32, true);
                    for axis in [2, 1, 0] {
                        let x = q[axis] * inverse_scale;
                        let cell = (x - low[axis]) * (1.0 / CELL_M) + 0.5;
                        is_inside &= (cell >= 0.0) & (cell < size[axis] as i32 as f32);
                        let whole = (cell.floor() + NO_FRACTION).to_bits();
                        at = at.wrapping_mul(size[axis]);
                        at = at.wrapping_add(whole.wrapping_sub(NO_FRACTION.to_bits()));
                    }
                    batch.cell[k] = if is_inside { at } else { u32::MAX };
                }
            },
        );
    }

    /// The point nearest to a grid cell's centre; `None` if none is within [`MARGIN_M`].
    #[inline(always)]
    pub(crate) fn nearest(&self, cell: u32) -> Option<usize> {
        let found = *self.grid.get(cell as usize)?;
        (found != NO_POINT).then_some(usize::from(found))
    }
}

/// For each cell of the grid the index of the point nearest to its centre, [`NO_POINT`] beyond [`MARGIN_M`]. Each point updates
/// the cells within the margin, layer by layer: a third of the work of a tree search per cell.
fn nearest_points(points: &[Point], low: &Point, size: [usize; 3]) -> Vec<u16> {
    let [columns, rows, layers] = size;
    let most = MARGIN_M * MARGIN_M;
    let centre = |k: usize, cell: usize| low[k] + cell as f32 * CELL_M;
    // Cells along an axis with centres within reach, and up to one more at each end.
    let cells = |k: usize, coordinate: f32, reach: f32| {
        let cell = |metres: f32| ((metres - low[k]) / CELL_M).max(0.0) as usize;
        cell(coordinate - reach)..(cell(coordinate + reach) + 2).min(size[k])
    };
    let across: Vec<f32> = (0..columns).map(|column| centre(0, column)).collect();
    let mut grid = vec![NO_POINT; columns * rows * layers];
    let mut distances = vec![0.0_f32; columns * rows];
    for (layer, slots) in grid.chunks_exact_mut(columns * rows).enumerate() {
        distances.fill(most);
        for (index, p) in (0_u16..).zip(points) {
            let dz = centre(2, layer) - p.z;
            let reach2 = most - dz * dz;
            if reach2 < 0.0 {
                continue;
            }
            for row in cells(1, p.y, reach2.sqrt()) {
                let dy = centre(1, row) - p.y;
                let near = cells(0, p.x, (reach2 - dy * dy).max(0.0).sqrt());
                let at = row * columns + near.start..row * columns + near.end;
                let nearest = distances[at.clone()].iter_mut().zip(&mut slots[at]);
                for ((nearest2, slot), x) in nearest.zip(&across[near]) {
                    let dx = x - p.x;
                    let distance2 = dx * dx + dy * dy + dz * dz;
                    if distance2 < *nearest2 {
                        (*nearest2, *slot) = (distance2, index);
                    }
                }
            }
        }
    }
    grid
}

fn normal_matrix_inverse(points: &[Point], motions: &[[f32; 7]]) -> Option<SMatrix<f64, 7, 7>> {
    let mut h = SMatrix::<f64, 7, 7>::zeros();
    for (p, j) in points.iter().zip(motions).filter(|(p, _)| is_bare_face(p)) {
        let j = SVector::<f32, 7>::from(*j).cast::<f64>();
        h += (j * f64::from(trust(p))) * j.transpose();
    }
    // Slight damping: on a nearly spherical head rotations and shifts are indistinguishable.
    for k in 0..7 {
        h[(k, k)] *= 1.0 + 1e-6;
    }
    Some(h.cholesky()?.inverse())
}

fn nearest_neighbours(points: &[Point]) -> Vec<[u16; NEIGHBOURS]> {
    let mut order: Vec<(f32, u16)> = Vec::with_capacity(points.len());
    points
        .iter()
        .enumerate()
        .map(|(i, p)| {
            order.clear();
            let others = (0u16..).zip(points).filter(|&(k, _)| usize::from(k) != i);
            order.extend(others.map(|(k, q)| ((q - p).norm_squared(), k)));
            let n = NEIGHBOURS.min(order.len());
            order.select_nth_unstable_by(n - 1, |a, b| a.0.total_cmp(&b.0));
            let mut found = [order[0].1; NEIGHBOURS];
            for (slot, (_, k)) in found.iter_mut().zip(&order[..n]) {
                *slot = *k;
            }
            found
        })
        .collect()
}

/// Whether the neighbours leave a gap of over [`RIM_GAP_RAD`] in the tangent plane.
fn on_rim(i: usize, points: &[Point], normals: &[Vector], neighbours: &[u16; NEIGHBOURS]) -> bool {
    let n = normals[i];
    let (x, y) = (Vector::x(), Vector::y());
    let helper = if n.x.abs() < 0.8 { x } else { y };
    let u = n.cross(&helper).normalize();
    let v = n.cross(&u);
    let mut angles = neighbours.map(|k| {
        let d = points[usize::from(k)] - points[i];
        d.dot(&v).atan2(d.dot(&u))
    });
    crate::base::sorting::sort(&mut angles);
    let mut widest = angles[0] + core::f32::consts::TAU - angles[NEIGHBOURS - 1];
    for pair in angles.windows(2) {
        widest = widest.max(pair[1] - pair[0]);
    }
    widest > RIM_GAP_RAD
}

/// Columns and rows of patches over the face.
const PATCH_GRID: [usize; 2] = [6, 6];

/// Number of patches of a signature.
pub const PATCHES: usize = PATCH_GRID[0] * PATCH_GRID[1];

/// Left, top, right, bottom of the patches, head frame, metres: forehead to upper lip, temple to temple.
const PATCH_AREA_M: [f32; 4] = [-0.066, -0.060, 0.066, 0.052];

/// Patch of a point of the anchor, row by row; `None` outside.
fn patch(p: &Point) -> Option<usize> {
    let [left, top, right, bottom] = PATCH_AREA_M;
    let (x, y) = ((p.x - left) / (right - left), (p.y - top) / (bottom - top));
    let inside = (0.0..1.0).contains(&x) && (0.0..1.0).contains(&y);
    inside.then(|| {
        (y * PATCH_GRID[1] as f32) as usize * PATCH_GRID[0] + (x * PATCH_GRID[0] as f32) as usize
    })
}

/// Patches of an anchor, and the effect of motions on each.
#[derive(Clone, Debug)]
pub(crate) struct Patches {
    /// Mean of [`Anchor::motions`] over each patch.
    pub(super) rows: [[f64; 7]; PATCHES],
    /// Patch of each anchor point, [`PATCHES`] for none.
    pub(super) patch_of_point: Vec<u8>,
}

impl Patches {
    /// Patches from the anchor's points and the effect of motions on them.
    pub(crate) fn new(points: &[Point], motions: &[[f32; 7]]) -> Self {
        let patch_of_point: Vec<u8> = points
            .iter()
            .map(|p| patch(p).unwrap_or(PATCHES) as u8)
            .collect();
        let mut rows = [[0.0; 7]; PATCHES];
        let mut counts = [0.0f64; PATCHES];
        for (motion, &k) in motions.iter().zip(&patch_of_point) {
            let k = usize::from(k);
            if k < PATCHES {
                for (sum, value) in rows[k].iter_mut().zip(motion) {
                    *sum += f64::from(*value);
                }
                counts[k] += 1.0;
            }
        }
        for (row, count) in rows.iter_mut().zip(counts) {
            for value in row {
                *value /= count.max(1.0);
            }
        }
        Self {
            rows,
            patch_of_point,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Half an ellipsoid with a nose, points about 5 mm apart.
    pub(crate) fn half_egg() -> Vec<(Point, Vector)> {
        let surface = |a: f32, b: f32| {
            let bump = |a0: f32, b0: f32, wide: f32, tall: f32, height: f32| {
                let (x, y) = ((a - a0) / wide, (b - b0) / tall);
                height * (-(x * x + y * y)).exp()
            };
            let extra = bump(0.0, 0.25, 0.16, 0.28, 0.025) + bump(0.0, -0.2, 0.7, 0.12, 0.006)
                - bump(0.38, 0.02, 0.16, 0.12, 0.008)
                - bump(-0.38, 0.02, 0.16, 0.12, 0.008);
            let radius = 1.0 + extra / 0.09;
            Point::new(
                0.075 * radius * a.sin() * b.cos(),
                0.11 * radius * b.sin(),
                0.09 - 0.10 * radius * a.cos() * b.cos(),
            )
        };
        let mut points = Vec::new();
        for j in -21..=21 {
            let b = j as f32 * 0.055;
            let across = (24.0 * b.cos()).round().max(1.0) as i32;
            for i in -across..=across {
                let a = i as f32 / across as f32 * 1.45;
                let e = 1e-3;
                let du = surface(a + e, b) - surface(a - e, b);
                let dv = surface(a, b + e) - surface(a, b - e);
                points.push((surface(a, b), dv.cross(&du).normalize()));
            }
        }
        points
    }

    #[test]
    fn the_fine_surface_has_no_holes_between_neighbours() {
        let head = half_egg();
        let anchor = Anchor::new(&head).unwrap();
        let fine = anchor.fine_surface().target(|i| anchor.points[i]).unwrap();
        let coarse = |p: &Point| anchor.target.nearest(p).1.sqrt();
        let mut furthest = [0.0_f32; 2];
        for (i, beside) in anchor.neighbours.iter().enumerate() {
            let j = usize::from(beside[0]);
            let between = nalgebra::center(&anchor.points[i], &anchor.points[j]);
            furthest[0] = furthest[0].max(fine.nearest(&between).1.sqrt());
            furthest[1] = furthest[1].max(coarse(&between));
        }
        // Within a cell of the fine surface; the standard head alone has no points in between.
        assert!(
            furthest[0] < 1.8 * FINE_SPACING_M && furthest[1] > 1.8 * FINE_SPACING_M,
            "{furthest:?}"
        );
    }

    #[test]
    fn the_fine_surface_spans_no_gap() {
        let anchor = Anchor::new(&half_egg()).unwrap();
        let apart =
            |a: u16, b: u16| (anchor.points[usize::from(a)] - anchor.points[usize::from(b)]).norm();
        let mut longest = 0.0_f32;
        for SurfacePoint {
            corners: [a, b, c], ..
        } in anchor.fine_surface().0
        {
            longest = longest.max(apart(a, b)).max(apart(a, c)).max(apart(b, c));
        }
        // Some neighbours are farther apart, so the limit is effective.
        assert!(longest < MAX_EDGE_M, "{longest}");
        assert!(
            (0u16..)
                .zip(&anchor.neighbours)
                .any(|(i, beside)| beside.iter().any(|&j| apart(i, j) > MAX_EDGE_M))
        );
    }

    #[test]
    fn the_grid_finds_what_the_tree_finds() {
        let head = half_egg();
        let anchor = Anchor::new(&head).unwrap();
        let nearest = |q: Point| {
            let mut batch = Batch::EMPTY;
            let here = HeadFromSensor::identity();
            anchor.locate(&[Point::origin(), q], 1, (&here, 1.0), &mut batch);
            anchor.nearest(batch.cell[1])
        };
        let mut rng = fastrand::Rng::with_seed(1);
        for _ in 0..2000 {
            let q = head[rng.usize(..head.len())].0
                + Vector::new(rng.f32() - 0.5, rng.f32() - 0.5, rng.f32() - 0.5) * 0.03;
            let (_, best2) = anchor.target.nearest(&q);
            let found = nearest(q).expect("within the margin");
            let distance = (anchor.points[found] - q).norm();
            // Both ways through the cell's centre.
            assert!(
                distance <= best2.sqrt() + CELL_M * 1.8,
                "{distance} {}",
                best2.sqrt()
            );
        }
        for outside in [1.0, -1.0, f32::NAN] {
            assert!(nearest(Point::new(outside, 0.0, 0.0)).is_none());
        }
    }

    #[test]
    fn the_rim_is_the_edge_of_the_surface() {
        let head = half_egg();
        let anchor = Anchor::new(&head).unwrap();
        let (mut inside, mut outside) = (0, 0);
        for (i, (p, n)) in head.iter().enumerate() {
            assert!(n.z < 0.6, "normals point out of the head");
            if p.z < 0.05 && p.y.abs() < 0.08 {
                inside += usize::from(anchor.rim[i]);
            }
            if p.z > 0.0779 && p.y.abs() < 0.08 {
                outside += usize::from(!anchor.rim[i]);
            }
        }
        assert_eq!((inside, outside), (0, 0));
    }

    #[test]
    fn too_few_or_broken_points_are_refused() {
        assert!(Anchor::new(&[]).is_none());
        let mut head = half_egg();
        head[5].0.x = f32::NAN;
        assert!(Anchor::new(&head).is_none());
    }

    #[test]
    fn trust_falls_over_the_lower_face_the_hair_and_the_sides() {
        for (y, z, expected) in [
            (0.0, 0.0, 1.0),
            (0.03, 0.045, 1.0),
            (0.045, 0.0, 0.65),
            (0.07, 0.0, 0.3),
            (-0.065, 0.0, 1.0),
            (-0.08, 0.0, 0.7),
            (-0.1, 0.0, 0.4),
            (0.0, 0.06, 0.75),
            (0.0, 0.09, 0.5),
            (0.045, 0.06, 0.4875),
        ] {
            let found = trust(&Point::new(0.0, y, z));
            assert!((found - expected).abs() < 1e-5, "{y} {z}: {found}");
        }
        for (x, y, z, is_bare) in [
            (0.0, 0.0, 0.0, true),
            (0.0, -0.051, 0.0, false),
            (0.0, 0.081, 0.0, false),
            (0.0, 0.0, 0.041, false),
            (0.063, 0.0, 0.0, false),
            (-0.063, 0.0, 0.0, false),
            (-0.061, 0.079, 0.039, true),
        ] {
            assert_eq!(is_bare_face(&Point::new(x, y, z)), is_bare, "{x} {y} {z}");
        }
    }

    #[test]
    fn the_bare_face_ends_at_its_bounds() {
        for (inside, outside) in [
            ([0.0, -0.049, 0.0], [0.0, -0.050, 0.0]),
            ([0.0, 0.079, 0.0], [0.0, 0.080, 0.0]),
            ([0.0, 0.0, 0.039], [0.0, 0.0, 0.040]),
            ([0.061, 0.0, 0.0], [0.062, 0.0, 0.0]),
            ([-0.061, 0.0, 0.0], [-0.062, 0.0, 0.0]),
        ] {
            assert!(
                is_bare_face(&inside.into()) && !is_bare_face(&outside.into()),
                "{outside:?}"
            );
        }
    }

    #[test]
    fn the_fewest_points_make_a_head_and_one_fewer_does_not() {
        // Spread over the whole head, so that all motions are determined.
        let head = half_egg();
        let spread = |count: usize| -> Vec<(Point, Vector)> {
            (0..count)
                .map(|k| head[k * head.len() / count + head.len() / (2 * count)])
                .collect()
        };
        assert!(Anchor::new(&spread(12)).is_some());
        assert!(Anchor::new(&spread(11)).is_none());
    }

    #[test]
    fn a_ball_is_a_head_though_its_turns_are_shifts() {
        let middle = Vector::new(0.01, 0.02, 0.03);
        let mut rng = fastrand::Rng::with_seed(6);
        let ball: Vec<(Point, Vector)> = (0..200)
            .map(|_| {
                let n = Vector::from_fn(|_, _| rng.f32() - 0.5).normalize();
                (Point::from(middle + n * 0.05), n)
            })
            .collect();
        let anchor = Anchor::new(&ball).expect("a head");
        assert!(anchor.motions_inverse.iter().all(|c| c.is_finite()));
    }

    #[test]
    fn patches_are_numbered_as_one_reads_and_end_with_the_area() {
        let [left, top, right, bottom] = PATCH_AREA_M;
        let patch_at = |column: f32, row: f32| {
            let (x, y) = (
                left + (right - left) * column / 6.0,
                top + (bottom - top) * row / 6.0,
            );
            patch(&Point::new(x, y, 0.0))
        };
        let mut number = 0;
        for row in 0..6 {
            for column in 0..6 {
                let middle = patch_at(column as f32 + 0.5, row as f32 + 0.5);
                assert_eq!(middle, Some(number), "row {row}, column {column}");
                number += 1;
            }
        }
        for (column, row) in [(-0.1, 3.0), (6.1, 3.0), (3.0, -0.1), (3.0, 6.1)] {
            assert_eq!(patch_at(column, row), None);
        }
    }
}
