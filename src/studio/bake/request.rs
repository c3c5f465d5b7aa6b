//! What `mien-studio bake` is asked for.

use std::path::{Path, PathBuf};

use super::rig::Method;

/// The options of `mien-studio bake`, explained.
pub const OPTIONS: &str = "  --mesh       neutral head: OBJ (quads, texture coordinates and vertex order are kept), or GLB or VRM, whose copy in
               --out gets the shapes and keeps everything else
  --landmarks  68 vertex numbers from 0, one per line, in iBUG order; for a GLB, counted through its position accessors in order.
               auto finds them in a rendering of the mesh (y up, face towards z) and writes beside --out a picture to check
               (.landmarks.png) and a file to correct and pass back in (.landmarks.txt)
  --out        glTF with one morph target per shape (.glb, .vrm), or USD with one blend shape (.usda): geometry, shapes and names
               of materials, in the mesh's own unit
  --recipe     shapes and their control points; default: the 67 built in (config/blendshapes.toml)
  --controls   CSV shape,vertex,dx,dy,dz in mesh units, instead of a recipe
  --method     for comparison: paper, its Procedure 1 as printed, or laplacian, plain least squares; default: aoi
  --derive-controls  with --controls: skin between the given vertices moves as learned from sculpted shapes. With a recipe it
               always does
  --correctives  also the recipe's correctives, for pairs of shapes that do not combine well when simply added, named like jawOpen_mouthSmileLeft,
               to be weighted by the product of both weights, as `mien-studio animate` does
  --unit       unit of the mesh; default: told from the distance of the eyes
  --dense      morph targets and blend shapes in full, for programs that cannot read sparse ones
  --obj        also neutral.obj, one OBJ per shape and shapes.json in this folder
  --report     pictures and figures of every shape, one HTML file
";

/// What to bake and where to put it.
#[derive(Debug, Default)]
pub struct Request {
    /// Neutral head.
    pub mesh: PathBuf,
    /// Their file, or `auto`.
    pub landmarks: PathBuf,
    /// glTF or USD to write.
    pub out: PathBuf,
    /// Instead of the built-in one.
    pub recipe: Option<PathBuf>,
    /// Instead of a recipe.
    pub controls: Option<PathBuf>,
    /// Folder of OBJ files.
    pub obj: Option<PathBuf>,
    /// HTML file.
    pub report: Option<PathBuf>,
    /// Metres per unit of the mesh.
    pub metres: Option<f64>,
    /// What places the skin.
    pub method: Method,
    /// Points of the tool's own.
    pub derive: bool,
    /// Correctives of the recipe too.
    pub correctives: bool,
    /// Targets in full.
    pub dense: bool,
}

/// Whether a file is to be USD, by its name.
#[must_use]
pub fn is_usd(path: &Path) -> bool {
    path.extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("usda"))
}

/// Metres per unit of a mesh in mm, cm or m.
#[must_use]
pub fn metres(unit: &str) -> Option<f64> {
    match unit {
        "mm" => Some(1e-3),
        "cm" => Some(1e-2),
        "m" => Some(1.0),
        _ => None,
    }
}
