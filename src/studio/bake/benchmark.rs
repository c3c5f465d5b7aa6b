//! How close baked shapes come to sculpted ones: the expressions of the ICT head, given only the true displacement of its
//! 68 landmarks.
//!
//! Error of a shape = RMS(baked − true) / RMS(true) over the face (vertices 0 to 9408); the figure is the mean over the
//! 29 shapes that move the face.

use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::influence::{self, Field};
use super::laplacian::Operator;
use super::mesh::{Mesh, Vec3};
use super::recipe::Target;
use super::solve::{self, Settings, System};
use super::{obj, sparse::Singular};

/// Why the comparison cannot run.
#[derive(Debug, thiserror::Error)]
pub enum BenchmarkError {
    /// A file is missing.
    #[error("cannot read {path}: {source}; expected the ICT FaceKit folder")]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The mesh text is damaged.
    #[error(transparent)]
    Obj(#[from] obj::ObjError),
    /// A system could not be solved.
    #[error(transparent)]
    Singular(#[from] Singular),
}

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
    /// Vertices the error is taken over.
    pub const FACE: std::ops::Range<usize> = 0..9409;

    /// Reads the folder; leaves out the shapes that do not move the face.
    ///
    /// # Errors
    /// If a file is missing or damaged.
    pub fn read(folder: &Path) -> Result<Self, BenchmarkError> {
        let read = |path: PathBuf| {
            std::fs::read(&path).map_err(|source| BenchmarkError::Unreadable { path, source })
        };
        let text = read(folder.join("generic_neutral_mesh.obj"))?;
        let mesh = obj::parse(&String::from_utf8_lossy(&text))?;
        let text = read(folder.join("landmarks68.txt"))?;
        let landmarks = String::from_utf8_lossy(&text)
            .split_ascii_whitespace()
            .filter_map(|w| w.parse().ok())
            .collect();
        let mut shapes = Vec::new();
        let listing = std::fs::read_dir(folder.join("expr")).map_err(|source| {
            BenchmarkError::Unreadable {
                path: folder.join("expr"),
                source,
            }
        })?;
        let mut paths: Vec<PathBuf> = listing.flatten().map(|entry| entry.path()).collect();
        paths.sort();
        for path in paths {
            let name = path
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            if name.starts_with("PupilDilate") {
                continue;
            }
            let number = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
            let moved = read(path)?
                .chunks_exact(12)
                .map(|c| Vec3::new(number(&c[0..4]), number(&c[4..8]), number(&c[8..12])))
                .collect();
            shapes.push((name, moved));
        }
        Ok(Self {
            mesh,
            landmarks,
            shapes,
        })
    }

    /// The true motion of the landmarks in shape `s`, to bake.
    #[must_use]
    pub fn target(&self, s: usize) -> Target {
        let (name, d) = &self.shapes[s];
        Target {
            name: name.clone(),
            controls: self.landmarks.iter().map(|&v| (v, d[v as usize])).collect(),
            exact: true,
            ..Target::default()
        }
    }

    /// Error of a baked shape against shape `s`.
    #[must_use]
    pub fn error(&self, s: usize, baked: &[Vec3]) -> f64 {
        self.error_over(s, baked, Self::FACE)
    }

    /// The same over some vertices.
    #[must_use]
    pub fn error_over(
        &self,
        s: usize,
        baked: &[Vec3],
        some: impl IntoIterator<Item = usize>,
    ) -> f64 {
        let truth = &self.shapes[s].1;
        let (mut miss, mut size) = (0.0, 0.0);
        for v in some {
            miss += (baked[v] - truth[v]).norm_squared();
            size += truth[v].norm_squared();
        }
        (miss / size).sqrt()
    }
}

/// One row of the table: the method and its error per shape.
pub struct Row {
    /// Method.
    pub name: String,
    /// Error per shape, in the order of [`Truth::shapes`].
    pub errors: Vec<f64>,
}

impl Row {
    /// Mean over the shapes.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.errors.iter().sum::<f64>() / self.errors.len() as f64
    }
}

/// Runs all methods.
/// Long because it is the table: every method with how it is called.
///
/// # Errors
/// If a system cannot be solved.
pub fn compare(truth: &Truth, settings: &Settings) -> Result<Vec<Row>, BenchmarkError> {
    let mesh = &truth.mesh;
    let n = mesh.positions.len();
    let node: Vec<u32> = (0..n as u32).collect();
    let w = (mesh.positions[truth.landmarks[39] as usize]
        - mesh.positions[truth.landmarks[42] as usize])
        .norm();
    let operator = Operator::new(
        mesh,
        &node,
        n,
        |_| false,
        |v| {
            let soft = truth.landmarks[36..].iter();
            let far = soft.map(|&l| (mesh.positions[l as usize] - mesh.positions[v]).norm());
            solve::stiffness(far.fold(f64::INFINITY, f64::min) / w)
        },
    );
    let printed = operator.printed();
    let rings = mesh.rings();
    let (component, _) = mesh.components(&rings);
    let skin: Vec<bool> = (0..n)
        .map(|v| component[v] == component[truth.landmarks[0] as usize])
        .collect();
    // The sockets behind lids and lips stay free, or the lids could not move.
    let head: Vec<bool> = (0..n)
        .map(|v| (Truth::FACE.end..11_248).contains(&v))
        .collect();
    let free = vec![false; n];
    let moves: Vec<Vec<Vec3>> = truth
        .shapes
        .iter()
        .map(|(_, d)| truth.landmarks.iter().map(|&v| d[v as usize]).collect())
        .collect();
    let row = |name: &str, baked: &[Vec<Vec3>]| Row {
        name: name.into(),
        errors: baked
            .iter()
            .enumerate()
            .map(|(s, d)| truth.error(s, d))
            .collect(),
    };
    let mut table = Vec::new();
    for (name, held) in [
        ("plain Laplacian, nothing else held", &free),
        ("plain Laplacian, head and neck held", &head),
    ] {
        let baked = solve::plain(&printed, &skin, held, &truth.landmarks, &moves, 100.0)?;
        table.push(row(name, &baked));
    }
    let given = |shape: &[Vec3]| {
        let mut d = vec![Vec3::zeros(); n];
        for (&v, &displacement) in truth.landmarks.iter().zip(shape) {
            d[v as usize] = displacement;
        }
        d
    };
    let whole = System::new(&printed, &skin, truth.landmarks.iter().copied())?;
    for s in [0.5, 2.0, 10.0] {
        let baked: Vec<_> = moves
            .par_iter()
            .map(|shape| {
                let controls: Vec<(u32, Vec3)> = truth
                    .landmarks
                    .iter()
                    .copied()
                    .zip(shape.iter().copied())
                    .collect();
                let d = influence::propagate(&rings, &mesh.positions, &controls, 10.0, 100);
                let u: Vec<f64> = d.iter().map(Vec3::norm).collect();
                let mut d = given(shape);
                let delta = |v: usize| (u[v] * s).min(1.0);
                whole.deform(&printed, &mesh.positions, &mut d, delta, 7);
                d
            })
            .collect();
        table.push(row(
            &format!("Procedure 1 as printed, s = {s} per cm"),
            &baked,
        ));
    }
    let field = Field::new(
        &operator,
        &rings,
        &mesh.positions,
        &skin,
        &truth.landmarks,
        settings.reach * w,
        settings.disc * w,
    )?;
    let lengths: Vec<Vec<f64>> = moves
        .iter()
        .map(|m| m.iter().map(Vec3::norm).collect())
        .collect();
    let u = field.spread(&lengths);
    for rounds in [0, settings.rounds] {
        let baked: Result<Vec<_>, Singular> = moves
            .par_iter()
            .zip(&u)
            .map(|(shape, u)| {
                let area: Vec<bool> = u
                    .iter()
                    .zip(&skin)
                    .map(|(&u, &skin)| skin && u > settings.edge * w)
                    .collect();
                let system = System::new(&operator, &area, truth.landmarks.iter().copied())?;
                let mut d = given(shape);
                let delta = |v: usize| (u[v] / (settings.full * w)).min(1.0);
                system.deform(&operator, &mesh.positions, &mut d, delta, rounds);
                Ok(d)
            })
            .collect();
        table.push(row(
            &format!("AOI, {rounds} rounds of Procedure 1"),
            &baked?,
        ));
    }
    Ok(table)
}
