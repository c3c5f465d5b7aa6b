//! How close baked shapes come to sculpted ones: the expressions of the ICT head, given only the true displacement of its
//! 68 landmarks.
//!
//! Error of a shape = RMS(baked − true) / RMS(true) over the face (vertices 0 to 9408); the figure is the mean over the
//! 29 shapes that move the face.

use std::path::{Path, PathBuf};

use super::mesh::{Mesh, Vec3};
use super::obj;
use super::recipe::Target;

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
