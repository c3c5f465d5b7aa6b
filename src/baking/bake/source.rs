//! A head as read from OBJ, GLB, glTF or VRM, and output in the same kind of file.

use std::path::Path;

use serde_json::json;

use super::files::{read, read_bytes, write};
use super::glb::Glb;
use super::head::Head;
use super::locate::{Located, guess};
use super::looks::Looks;
use super::mesh::Mesh;
use super::neck::Neck;
use super::patch::ImportedGltf;
use super::shape::{Shape, Target};
use super::{lips, morphs, obj};
use mien_stages::face_model::FaceModel;
use mien_workbench::fault::Fault;
use mien_workbench::text_files;

/// Vertex numbers from the text of the landmark file at `path`: one a line, `#` begins a comment.
///
/// # Errors
/// At the first line that is no vertex number.
pub fn landmarks(text: &str, path: &Path) -> Result<Vec<u64>, Fault> {
    let lines = text.lines().map(str::trim).zip(1..);
    let said = lines.filter(|(line, _)| !line.is_empty() && !line.starts_with('#'));
    let number = |(text, line): (&str, usize)| {
        let beginning: String = text.chars().take(40).collect();
        let refuse = |_| Fault::at_line(path, line, "a vertex number", &beginning);
        text.parse().map_err(refuse)
    };
    said.map(number).collect()
}

/// The text of a landmark file for these vertices of the mesh, in the file's numbering.
pub fn landmark_text(vertices: &[u64], imported: Option<&ImportedGltf>) -> String {
    let numbers = imported.map_or_else(|| vertices.to_vec(), |f| f.rows(vertices));
    numbers.iter().map(|v| format!("{v}\n")).collect()
}

/// A mesh as read.
pub struct Source {
    /// Vertices and triangles.
    pub mesh: Mesh,
    /// Materials and textures.
    pub looks: Looks,
    /// The text of the OBJ, if it is one.
    obj: Option<String>,
    /// The glTF, if it is one.
    pub imported: Option<ImportedGltf>,
    /// Number of inward faces in the file, turned in the mesh.
    turned: usize,
}

impl Source {
    /// Reads the mesh of a file.
    pub fn read(path: &Path) -> Result<Self, Fault> {
        let bytes = read_bytes(path)?;
        if bytes.starts_with(b"glTF") || bytes.trim_ascii_start().starts_with(b"{") {
            let folder = path.parent().unwrap_or(Path::new(""));
            let glb = Glb::read(&bytes, folder).map_err(Fault::within(path))?;
            let looks = Looks::from_glb(&glb);
            let (mesh, imported) = ImportedGltf::read(glb).map_err(Fault::within(path))?;
            return Ok(Self {
                obj: None,
                mesh,
                looks,
                turned: imported.turned,
                imported: Some(imported),
            });
        }
        let obj = text_files::decoded(&bytes);
        let mut mesh = obj::parse(&obj).map_err(Fault::within(path))?;
        Ok(Self {
            turned: mesh.turn_outward(),
            mesh,
            looks: Looks::from_obj(path, &obj),
            obj: Some(obj),
            imported: None,
        })
    }

    /// Finds the landmarks on the mesh of this file.
    pub fn guess(&self, path: &Path) -> Result<Located, Fault> {
        let front = self.imported.as_ref().map(ImportedGltf::front);
        guess(&self.mesh, &self.looks, front, &FaceModel::shipped())
            .ok_or("expected vertices to find a face on, found none")
            .map_err(Fault::within(path))
    }

    /// Vertex numbers of the landmarks in a file.
    pub fn landmarks_from_file(&self, path: &Path) -> Result<Vec<u64>, Fault> {
        let numbers = landmarks(&read(path)?, path)?;
        Ok(match &self.imported {
            Some(imported) => imported.landmarks(&numbers),
            None => numbers,
        })
    }

    /// Cuts joined lips open, as `head` has them; returns the new landmarks.
    pub(super) fn cut(
        &mut self,
        path: &Path,
        head: &Head,
        vertex: &[u32],
        landmarks: &mut [u64],
    ) -> Result<(), Fault> {
        let Some(text) = self.obj.take() else {
            return Err(Fault::within(path)(
                "expected lips with a slit between them, found joined ones, which only an OBJ can be cut at; give an OBJ of this head, or --lips keep to bake them as they are",
            ));
        };
        let opened = lips::opened(&self.mesh, vertex, head).ok_or(
            "expected joined lips with a way from corner to corner to cut along, found none; cut the mesh by hand, or give --lips keep to bake them as they are",
        );
        let opened = opened.map_err(Fault::within(path))?;
        self.obj = Some(obj::cut(&text, &self.mesh, &opened.mesh, &opened.kept));
        self.mesh = opened.mesh;
        landmarks[60..68].copy_from_slice(&opened.landmarks);
        Ok(())
    }

    /// The output file with the shapes.
    pub(super) fn with_shapes(
        &mut self,
        shapes: &[Shape],
        metres: f64,
        dense: bool,
        neck: Option<&Neck>,
    ) -> Vec<u8> {
        if let Some(imported) = self.imported.take() {
            return imported.patched(&self.mesh, shapes, dense).emit();
        }
        let mut glb = morphs::build(&self.mesh, shapes, metres, dense, neck);
        self.looks.paint(&mut glb);
        glb.emit()
    }

    /// Remarks on unexpected contents of the file and how they were handled.
    pub(super) fn oddities(&self, targets: &[Target], keep: bool, out: &Path) -> String {
        let mut said = String::new();
        if self.turned > 0 {
            let (turned, out) = (self.turned, out.display());
            let rest = match &self.imported {
                Some(_) => "the file keeps them as they run".into(),
                None => format!("{out} has them turned"),
            };
            said += &format!("{turned} faces look inwards: turned round for the solve; {rest}. ");
        }
        let namesakes = targets.iter().filter(|t| self.has(&t.name)).count();
        if namesakes > 0 {
            let kept = match keep {
                true => "these stay, and none of that name is added",
                false => "kept as NAME.original",
            };
            said += &format!(
                "{namesakes} shapes are in the file already under names of ours: {kept}. "
            );
        }
        said
    }

    /// Whether the file has a shape of this name from elsewhere.
    pub(super) fn has(&self, name: &str) -> bool {
        self.imported.as_ref().is_some_and(|f| f.has(name))
    }

    /// Writes the neutral and every shape as OBJ, and a list of them.
    pub(super) fn folder_of_obj(&self, folder: &Path, shapes: &[Shape]) -> Result<(), Fault> {
        std::fs::create_dir_all(folder).map_err(Fault::cannot("write", folder, ""))?;
        let emitted = || obj::emit(&self.mesh);
        let neutral = self.obj.clone().unwrap_or_else(emitted);
        write(&folder.join("neutral.obj"), neutral.as_bytes())?;
        let mut list = Vec::with_capacity(shapes.len());
        for shape in shapes {
            let moved = shape.moved(&self.mesh.positions);
            let file = format!("{}.obj", shape.name);
            let text = obj::with_positions(&neutral, &moved);
            write(&folder.join(&file), text.as_bytes())?;
            list.push(
                json!({"name": shape.name, "file": file, "unit": shape.unit, "upon": shape.upon}),
            );
        }
        let index = json!({"neutral": "neutral.obj", "shapes": list});
        let index = format!("{index:#}\n");
        write(&folder.join("shapes.json"), index.as_bytes())
    }
}
