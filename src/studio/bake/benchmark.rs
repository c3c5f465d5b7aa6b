//! How close baked shapes come to sculpted ones: the expressions of the ICT head, given only the true displacement of its
//! 68 landmarks.
//!
//! Error of a shape = RMS(baked − true) / RMS(true) over the face (vertices 0 to 9408); the figure is the mean over the
//! 29 shapes that move the face.

use std::path::Path;

use super::files::{read, read_bytes};
use super::mesh::{Mesh, Vec3};
use super::obj;
use super::recipe::Target;
use crate::studio::fault::Fault;
use crate::studio::text_files::listed;

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
    pub fn read(folder: &Path) -> Result<Self, Fault> {
        let neutral = folder.join("generic_neutral_mesh.obj");
        let mesh = obj::parse(&read(&neutral)?).map_err(Fault::within(&neutral))?;
        let landmarks = read(&folder.join("landmarks68.txt"))?;
        let expressions = folder.join("expr");
        let paths = listed(&expressions).map_err(Fault::cannot("read", &expressions, ""))?;
        let mut shapes = Vec::new();
        for path in paths {
            let name = path.file_stem().unwrap_or_default().to_string_lossy();
            if !name.starts_with("PupilDilate") {
                let bytes = read_bytes(&path)?;
                let numbers = bytes.as_chunks::<4>().0.iter();
                let numbers: Vec<f64> =
                    numbers.map(|b| f64::from(f32::from_le_bytes(*b))).collect();
                let rows = numbers.as_chunks::<3>().0.iter();
                shapes.push((name.into_owned(), rows.map(|&d| Vec3::from(d)).collect()));
            }
        }
        let landmarks = landmarks.split_ascii_whitespace();
        Ok(Self {
            mesh,
            landmarks: landmarks.filter_map(|w| w.parse().ok()).collect(),
            shapes,
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

    /// Error of a baked shape against shape `s`.
    pub fn error(&self, s: usize, baked: &[Vec3]) -> f64 {
        self.error_over(s, baked, Self::FACE)
    }

    /// The same over some vertices.
    pub fn error_over(
        &self,
        s: usize,
        baked: &[Vec3],
        some: impl IntoIterator<Item = usize>,
    ) -> f64 {
        let truth = &self.shapes[s].1;
        let both = some.into_iter().map(|v| (baked[v] - truth[v], truth[v]));
        let (miss, size) = both.fold((0.0, 0.0), |(miss, size), (off, truth)| {
            (miss + off.norm_squared(), size + truth.norm_squared())
        });
        (miss / size).sqrt()
    }
}
