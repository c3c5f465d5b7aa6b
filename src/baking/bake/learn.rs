//! Learns how skin moves ([`super::prior`]) from sculpted shapes.
//!
//! Units: eye distances in the face's frame inside, the mesh's outside. Deterministic.

use std::path::Path;

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::canonical::{in_frame, places};
use super::files::read;
use super::head::{Head, LANDMARKS};
use super::mesh::{Mesh, Vec3};
use super::obj;
use super::prior::{Comparison, Prior, SkinPoint};
use super::rig::{self, Method};
use super::shape::Target;
use crate::heads::ict::read_deltas;
use mien_workbench::fault::Fault;

/// Learned places on the left half, middle included.
const PLACES: usize = 360;
/// Spacing of places near landmarks relative to that far away.
const DENSE: f64 = 0.2;
/// Half width of the middle line, in eye distances.
const MIDDLE: f64 = 0.012;
/// Ridge penalty; the comparison of a shape with itself is 1 on average.
const RIDGE: f64 = 0.5;

/// The truth: mesh, landmarks and expression displacements in the source's centimetres.
pub struct Truth {
    /// Neutral mesh.
    pub mesh: Mesh,
    /// 68 vertex numbers.
    pub landmarks: Vec<u32>,
    /// Name and displacement per vertex.
    pub shapes: Vec<(String, Vec<Vec3>)>,
}

impl Truth {
    /// Vertices over which the error is computed.
    pub const FACE: std::ops::Range<usize> = 0..9409;

    /// Reads the folder, leaving out shapes that do not move the face.
    ///
    /// # Errors
    /// If a file is missing or damaged.
    pub fn read(folder: &Path) -> Result<Self, Fault> {
        let neutral = folder.join("generic_neutral_mesh.obj");
        let mesh = obj::parse(&read(&neutral)?).map_err(Fault::within(&neutral))?;
        let landmarks = read(&folder.join("landmarks68.txt"))?;
        let landmarks = landmarks.split_ascii_whitespace();
        let vertices = mesh.positions.len();
        Ok(Self {
            mesh,
            landmarks: landmarks.filter_map(|w| w.parse().ok()).collect(),
            shapes: read_deltas(&folder.join("expr"), vertices, |d| d.cast())?,
        })
    }

    /// The true motion of the landmarks in shape `s`, to bake.
    pub fn target(&self, s: usize) -> Target {
        let (name, d) = &self.shapes[s];
        Target {
            name: name.clone(),
            controls: self.landmarks.iter().map(|&v| (v, d[v as usize])).collect(),
            exact: true,
            ..Target::default()
        }
    }
}

/// Sculpted shapes and the solve's result from their landmarks.
pub struct Lesson<'a> {
    truth: &'a Truth,
    /// The neutral.
    pub head: Head,
    /// Displacements of the solve per shape, mesh units.
    pub solved: Vec<Vec<Vec3>>,
    /// Number of each shape's mirror image.
    pub mirror: Vec<usize>,
    /// Vertex and learned place, the left half first.
    places: Vec<(u32, SkinPoint)>,
}

/// The name of a shape's other side.
fn other_side(name: &str) -> String {
    let other = |here: &str, there: &str| Some(name.strip_suffix(here)?.to_owned() + there);
    let sides = [["_L", "_R"], ["Left", "Right"]].into_iter();
    let others = sides.flat_map(|[l, r]| [other(l, r), other(r, l)]);
    let other = others.flatten().next();
    other.unwrap_or_else(|| name.to_owned())
}

/// Places distributed evenly over the left half by farthest-point sampling, then their mirror images.
fn spread(head: &Head) -> Vec<(u32, SkinPoint)> {
    let face = places(head, |v| Truth::FACE.contains(&v));
    let soft = (17..LANDMARKS).map(|k| in_frame(head, &head.point(k)));
    let soft: Vec<Vec3> = soft.collect();
    let left: Vec<&(u32, SkinPoint)> = face.iter().filter(|p| p.1.at.x > -MIDDLE).collect();
    let eager = |(_, p): &&(u32, SkinPoint)| {
        let far = soft.iter().map(|l| (l - p.at).norm());
        1.0 / (DENSE + far.fold(1.0, f64::min))
    };
    let eager: Vec<f64> = left.iter().map(eager).collect();
    let mut far = vec![f64::INFINITY; left.len()];
    let tip = face.iter().find(|p| p.0 == head.points[30]);
    let mut chosen = vec![(head.points[30], tip.unwrap_or(&face[0]).1)];
    while chosen.len() < PLACES.min(left.len()) {
        let last = chosen[chosen.len() - 1].1;
        for (far, (_, p)) in far.iter_mut().zip(&left) {
            *far = far.min(p.far(&last));
        }
        let next =
            (0..left.len()).max_by(|&a, &b| (far[a] * eager[a]).total_cmp(&(far[b] * eager[b])));
        chosen.extend(next.map(|k| *left[k]));
    }
    for (_, p) in &mut chosen {
        if p.at.x.abs() < MIDDLE {
            p.at.x = 0.0;
        }
    }
    let left = chosen.iter().filter(|(_, p)| p.at.x != 0.0);
    let mirrored = |(_, p): &(u32, SkinPoint)| {
        let (p, all) = (p.mirrored(), face.iter());
        let nearest = all.min_by(|a, b| a.1.far(&p).total_cmp(&b.1.far(&p)))?;
        Some((nearest.0, p))
    };
    let right: Vec<(u32, SkinPoint)> = left.filter_map(mirrored).collect();
    chosen.extend(right);
    chosen
}

impl<'a> Lesson<'a> {
    /// Solves every sculpted shape from its landmarks alone.
    ///
    /// # Errors
    /// If the head cannot be analysed or a system not be solved.
    pub fn new(truth: &'a Truth) -> Result<Self, Fault> {
        let landmarks: Vec<u64> = truth.landmarks.iter().map(|&v| u64::from(v)).collect();
        let head = Head::new(truth.mesh.clone(), &landmarks)?;
        let targets: Vec<Target> = (0..truth.shapes.len()).map(|s| truth.target(s)).collect();
        let shapes = rig::bake(&head, &targets, Method::Aoi, None, &|_| ())?;
        let partner = |(name, _): &(String, _)| {
            let other = other_side(name);
            let found = truth.shapes.iter().position(|s| s.0 == other);
            let expected = "expected every one-sided shape with its other side, found";
            found.ok_or_else(|| Fault::new(format!("{expected} {name} alone")))
        };
        let mirror = truth.shapes.iter().map(partner).collect::<Result<_, _>>()?;
        Ok(Self {
            places: spread(&head),
            solved: shapes.into_iter().map(|s| s.displacement).collect(),
            truth,
            head,
            mirror,
        })
    }

    /// A displacement from mesh axes to the face's frame.
    fn inward(&self, d: &Vec3) -> Vec3 {
        self.head.axes.tr_mul(d) / self.head.eye_distance
    }

    /// RMS motion of the face in a sculpted shape, eye distances.
    fn size(&self, s: usize) -> f64 {
        let d = &self.truth.shapes[s].1;
        let sum: f64 = Truth::FACE.map(|v| d[v].norm_squared()).sum();
        (sum / Truth::FACE.len() as f64).sqrt() / self.head.eye_distance
    }

    /// Learns a prior from the shapes that pass.
    pub fn prior(&self, kept: impl Fn(usize) -> bool) -> Prior {
        let all = 0..self.truth.shapes.len();
        let kept: Vec<usize> = all.filter(|&s| kept(s)).collect();
        let head = &self.head;
        let landmarks = (0..LANDMARKS).map(|k| in_frame(head, &head.point(k)));
        let places = self.places.iter().map(|p| p.1);
        let comparison = Comparison::new(landmarks.collect(), places.collect());
        // Each shape is normalised to unit motion.
        let size: Vec<f64> = kept.iter().map(|&s| self.size(s)).collect();
        let learned = kept.iter().zip(&size).map(|(&s, size)| {
            let truth = &self.truth.shapes[s].1;
            let of = |v: u32, d: &[Vec3]| self.inward(&d[v as usize]) / *size;
            let controls = self.truth.landmarks.iter().map(|&v| of(v, truth));
            let skin = self.places.iter().map(|p| of(p.0, &self.solved[s]));
            comparison.motion(controls.collect(), skin.collect())
        });
        let learned: Vec<_> = learned.collect();
        let other = |&s: &usize| kept.iter().position(|&o| o == self.mirror[s]);
        let mirror = kept.iter().map(|s| other(s).unwrap_or(0) as u8).collect();
        let mut prior = Prior::new(comparison, learned, mirror, Vec::new());
        let alike = prior.learned.iter().map(|one| prior.compared(one));
        let alike: Vec<Vec<f32>> = alike.collect();
        let adds = (0..self.places.len()).into_par_iter();
        let adds = adds.map(|q| self.regressed(q, &kept, &size, &alike));
        prior.adds = adds.collect::<Vec<_>>().concat();
        prior
    }

    /// Ridge regression at one place: residual of each kept shape per unit of comparison.
    fn regressed(&self, q: usize, kept: &[usize], size: &[f64], alike: &[Vec<f32>]) -> Vec<Vec3> {
        let n = kept.len();
        let mut k = DMatrix::from_fn(n, n, |r, c| f64::from(alike[r][q * n + c]));
        k = (&k + k.transpose()) * 0.5;
        for s in 0..n {
            k[(s, s)] += RIDGE;
        }
        let v = self.places[q].0 as usize;
        let left = DMatrix::from_fn(n, 3, |r, c| {
            let s = kept[r];
            (self.inward(&(self.truth.shapes[s].1[v] - self.solved[s][v])) / size[r])[c]
        });
        let x = k.cholesky().map(|f| f.solve(&left));
        let x = x.unwrap_or_else(|| DMatrix::zeros(n, 3));
        let rows = x.row_iter();
        rows.map(|row| Vec3::new(row[0], row[1], row[2])).collect()
    }
}
