//! Simplifies a head by half-edge collapses in the order of their cost.
//!
//! Garland & Heckbert, "Surface simplification using quadric error metrics" (1997), restricted to keeping one of the
//! two ends, so that the result's vertices are a subset of the head's and all vertex data carry over unchanged.
//! Expressions count as shape too: joining vertices that move differently is expensive, so lids and lips keep their
//! rows. Landmarks, rims and coincident vertices of different surfaces are kept. Cost: a heap of edges, lazily
//! re-evaluated; about 0.3 s for 25 000 vertices.

use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap, HashMap};

use nalgebra::{Matrix4, Vector3, Vector4};

use mien_simulator::virtual_head::{Expression, HeadAsset, Part, Site};
use mien_stages::base::geometry::Point;

/// Share of kept vertices, by part.
const KEPT: [f64; Part::COUNT] = [0.42, 0.14, 0.13, 0.13, 0.18, 0.15];
/// Distance from eyes and mouth within which errors are weighted by [`DETAIL`], metres.
const DETAIL_M: f32 = 0.018;
/// Weight of errors near eyes and mouth.
const DETAIL: f64 = 12.0;

/// Kept vertices, and the triangles between them.
pub struct Reduction {
    kept: Vec<u32>,
    triangles: Vec<[u32; 3]>,
    parts: Vec<Part>,
}

struct Mesh<'a> {
    asset: &'a HeadAsset,
    /// Triangles by corner, alive if not None.
    triangles: Vec<Option<[u32; 3]>>,
    at: Vec<BTreeSet<u32>>,
    quadrics: Vec<Matrix4<f64>>,
    /// Displacements by the key expressions, per vertex.
    motion: Vec<[Vector3<f32>; KEY_EXPRESSIONS.len()]>,
    weight: Vec<f64>,
    locked: Vec<bool>,
}

/// Part of every vertex.
fn part_of_each(asset: &HeadAsset) -> Vec<Part> {
    let mut part_at = vec![Part::Skin; asset.neutral.len()];
    for (t, &part) in asset.triangles.iter().zip(asset.parts.iter()) {
        for &v in t {
            part_at[v as usize] = part;
        }
    }
    part_at
}

/// For every vertex the first skin vertex at its position, itself if there is none.
fn merged(asset: &HeadAsset, part_at: &[Part]) -> Vec<u32> {
    let mut first: HashMap<[u32; 3], u32> = HashMap::new();
    let of = |(v, (p, part)): (u32, (&Point, &Part))| match part {
        Part::Skin => *first.entry([p.x, p.y, p.z].map(f32::to_bits)).or_insert(v),
        _ => v,
    };
    let places = asset.neutral.iter().zip(part_at);
    (0..).zip(places).map(of).collect()
}

/// Expressions that represent how vertices move.
const KEY_EXPRESSIONS: [&str; 8] = [
    "jawOpen",
    "eyeBlink_L",
    "eyeBlink_R",
    "mouthSmile_L",
    "mouthSmile_R",
    "mouthFunnel",
    "browInnerUp_L",
    "browInnerUp_R",
];

/// Displacements of each vertex by the key expressions.
fn motion(asset: &HeadAsset) -> Vec<[Vector3<f32>; KEY_EXPRESSIONS.len()]> {
    let mut motion = vec![[Vector3::zeros(); KEY_EXPRESSIONS.len()]; asset.neutral.len()];
    for (k, name) in KEY_EXPRESSIONS.iter().enumerate() {
        let Some(e) = asset.expression(name) else {
            continue;
        };
        let expression = &asset.expressions[e];
        for (&v, offset) in expression.vertices.iter().zip(&expression.offsets) {
            motion[v as usize][k] = *offset;
        }
    }
    motion
}

/// Weight of each vertex's errors: larger near eyes, nose and mouth.
fn weights(asset: &HeadAsset) -> Vec<f64> {
    let fine = asset.landmarks[36..68].iter();
    let fine: Vec<_> = fine.map(|site| site.position(&asset.neutral)).collect();
    let is_fine = |p: &Point| fine.iter().any(|q| (p - q).norm() < DETAIL_M);
    let weight = |p| if is_fine(p) { DETAIL } else { 1.0 };
    asset.neutral.iter().map(weight).collect()
}

impl<'a> Mesh<'a> {
    /// The welded skin, locked vertices, and the planes of its triangles.
    fn new(asset: &'a HeadAsset, part_at: &[Part]) -> Self {
        let n = asset.neutral.len();
        let same = merged(asset, part_at);
        let welded = |t: &[u32; 3]| t.map(|v| same[v as usize]);
        let whole = |t: [u32; 3]| Some(t).filter(|[a, b, c]| a != b && b != c && c != a);
        let triangles: Vec<_> = asset.triangles.iter().map(|t| whole(welded(t))).collect();
        let mut at = vec![BTreeSet::new(); n];
        let mut edges: HashMap<(u32, u32), u32> = HashMap::new();
        for (k, t) in triangles.iter().enumerate() {
            let Some(t) = t else { continue };
            for i in 0..3 {
                at[t[i] as usize].insert(k as u32);
                let (a, b) = (t[i], t[(i + 1) % 3]);
                *edges.entry((a.min(b), a.max(b))).or_default() += 1;
            }
        }
        let mut locked = vec![false; n];
        for (&(a, b), &count) in &edges {
            if count != 2 {
                locked[a as usize] = true;
                locked[b as usize] = true;
            }
        }
        for site in asset.landmarks.iter() {
            for v in site.vertices {
                locked[same[v as usize] as usize] = true;
            }
        }
        let mut mesh = Mesh {
            asset,
            triangles,
            at,
            quadrics: vec![Matrix4::zeros(); n],
            motion: motion(asset),
            weight: weights(asset),
            locked,
        };
        for t in mesh.triangles.clone().into_iter().flatten() {
            let normal = mesh.normal(t);
            let (area, unit) = (normal.norm(), normal.normalize());
            if area > 0.0 {
                let plane = Vector4::new(unit.x, unit.y, unit.z, -unit.dot(&mesh.position(t[0])));
                // Weighted by area relative to a square centimetre, so that the sum stays a squared distance.
                let quadric = plane * plane.transpose() * (area / 1e-5).min(1.0);
                for v in t {
                    mesh.quadrics[v as usize] += quadric;
                }
            }
        }
        mesh
    }

    /// Vertices that have triangles.
    fn alive(&self) -> Vec<u32> {
        let all = 0..self.at.len() as u32;
        all.filter(|&v| !self.at[v as usize].is_empty()).collect()
    }

    /// Collapses the cheapest edges until each part has its share of vertices.
    fn collapse(&mut self, part_at: &[Part]) {
        let alive = self.alive();
        let mut left = [0usize; Part::COUNT];
        for &v in &alive {
            left[part_at[v as usize] as usize] += 1;
        }
        let share = |(&l, k): (&usize, f64)| (l as f64 * k) as usize;
        let target: Vec<usize> = left.iter().zip(KEPT).map(share).collect();
        let mut heap = BinaryHeap::new();
        let push = |mesh: &Mesh, heap: &mut BinaryHeap<Reverse<(u64, u32, u32)>>, v: u32| {
            for to in mesh.neighbours(v) {
                for (a, b) in [(v, to), (to, v)] {
                    let cost = mesh.cost(a, b);
                    if cost.is_finite() {
                        // Positive floats sort as their bits do.
                        heap.push(Reverse((cost.to_bits(), a, b)));
                    }
                }
            }
        };
        for &v in &alive {
            push(self, &mut heap, v);
        }
        while let Some(Reverse((bits, from, to))) = heap.pop() {
            let part = part_at[from as usize] as usize;
            let gone = self.at[from as usize].is_empty() || self.at[to as usize].is_empty();
            if gone || left[part] <= target[part] || self.cost(from, to).to_bits() != bits {
                continue;
            }
            for k in std::mem::take(&mut self.at[from as usize]) {
                let Some(t) = self.triangles[k as usize] else {
                    continue;
                };
                if t.contains(&to) {
                    self.triangles[k as usize] = None;
                    for v in t {
                        self.at[v as usize].remove(&k);
                    }
                } else {
                    self.triangles[k as usize] = Some(t.map(|v| if v == from { to } else { v }));
                    self.at[to as usize].insert(k);
                }
            }
            let quadric = self.quadrics[from as usize];
            self.quadrics[to as usize] += quadric;
            left[part] -= 1;
            push(self, &mut heap, to);
        }
    }

    fn position(&self, v: u32) -> Vector3<f64> {
        self.asset.neutral[v as usize].coords.cast()
    }

    fn normal(&self, t: [u32; 3]) -> Vector3<f64> {
        let [a, b, c] = t.map(|v| self.position(v));
        (b - a).cross(&(c - a))
    }

    fn neighbours(&self, v: u32) -> BTreeSet<u32> {
        let mut around = BTreeSet::new();
        for &t in &self.at[v as usize] {
            around.extend(self.triangles[t as usize].into_iter().flatten());
        }
        around.remove(&v);
        around
    }

    /// Cost of moving `from` onto `to`, squared metres; infinite if not allowed.
    fn cost(&self, from: u32, to: u32) -> f64 {
        if self.locked[from as usize] {
            return f64::INFINITY;
        }
        let (around, beyond) = (self.neighbours(from), self.neighbours(to));
        if around.intersection(&beyond).count() != 2 {
            return f64::INFINITY;
        }
        for &t in &self.at[from as usize] {
            let Some(before) = self.triangles[t as usize] else {
                continue;
            };
            if before.contains(&to) {
                continue;
            }
            let after = before.map(|v| if v == from { to } else { v });
            let (n, m) = (self.normal(before), self.normal(after));
            if n.dot(&m) < 0.3 * n.norm() * m.norm() || m.norm() < 1e-12 {
                return f64::INFINITY;
            }
        }
        let p = self.position(to);
        let q = Vector4::new(p.x, p.y, p.z, 1.0);
        let shape =
            (q.transpose() * (self.quadrics[from as usize] + self.quadrics[to as usize]) * q)[0];
        let [moves, there] = [from, to].map(|v| self.motion[v as usize].iter());
        let moves = moves
            .zip(there)
            .map(|(a, b)| f64::from((a - b).norm_squared()));
        let moves: f64 = moves.sum();
        let length = (self.position(from) - p).norm_squared();
        self.weight[from as usize] * (shape.max(0.0) + 0.03 * moves + 0.004 * length)
    }
}

impl Reduction {
    /// Chooses the vertices that stay.
    pub fn new(asset: &HeadAsset) -> Self {
        let part_at = part_of_each(asset);
        let mut mesh = Mesh::new(asset, &part_at);
        mesh.collapse(&part_at);
        let kept = mesh.alive();
        let place: HashMap<u32, u32> = kept.iter().zip(0u32..).map(|(&v, k)| (v, k)).collect();
        let mut triangles = Vec::new();
        let mut parts = Vec::new();
        for (t, &part) in mesh.triangles.iter().zip(asset.parts.iter()) {
            if let Some(t) = t {
                triangles.push(t.map(|v| place[&v]));
                parts.push(part);
            }
        }
        Self {
            kept,
            triangles,
            parts,
        }
    }

    /// Values of the kept vertices.
    pub fn pick<T: Copy>(&self, values: &[T]) -> Vec<T> {
        self.kept.iter().map(|&v| values[v as usize]).collect()
    }

    /// Another person's head reduced alike, sharing mesh and expressions with `first`, a result of
    /// [`Reduction::apply`].
    pub fn apply_like(&self, asset: &HeadAsset, first: &HeadAsset) -> HeadAsset {
        HeadAsset {
            neutral: self.pick(&asset.neutral),
            photo: self.pick(&asset.photo).into(),
            photo_share: self.pick(&asset.photo_share).into(),
            colour: self.pick(&asset.colour).into(),
            texture: asset.texture.clone(),
            ..first.clone()
        }
    }

    /// The reduced head, sharing nothing.
    pub fn apply(&self, asset: &HeadAsset) -> HeadAsset {
        let place: HashMap<u32, u32> = self.kept.iter().zip(0u32..).map(|(&v, k)| (v, k)).collect();
        let expressions = asset.expressions.iter().map(|e| {
            let moved = e.vertices.iter().zip(&e.offsets);
            let moved = moved.filter_map(|(v, o)| Some((*place.get(v)?, *o)));
            let (vertices, offsets) = moved.unzip();
            Expression {
                name: e.name.clone(),
                vertices,
                offsets,
            }
        });
        let at = |v: u32| {
            place.get(&v).copied().unwrap_or_else(|| {
                // Its position may be a coincident vertex's.
                let p = asset.neutral[v as usize];
                let mut kept = self.kept.iter();
                kept.position(|&k| asset.neutral[k as usize] == p)
                    .unwrap_or(0) as u32
            })
        };
        let landmarks = asset.landmarks.iter().map(|site| Site {
            vertices: site.vertices.map(at),
            shares: site.shares,
        });
        let shared = HeadAsset {
            triangles: self.triangles.clone().into(),
            parts: self.parts.clone().into(),
            expressions: expressions.collect(),
            landmarks: landmarks.collect(),
            ..HeadAsset::default()
        };
        self.apply_like(asset, &shared)
    }
}
