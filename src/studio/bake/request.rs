//! What `mien-studio bake` is asked for.

use std::path::{Path, PathBuf};

use super::rig::Method;

/// What to bake and where to put it.
#[derive(Debug, Default, clap::Args)]
pub struct Request {
    /// Neutral head: OBJ (quads, texture coordinates and vertex order are kept), or GLB, glTF or VRM, whose copy in --out
    /// gets the shapes and keeps everything else
    #[arg(long)]
    pub mesh: PathBuf,
    /// 68 vertex numbers from 0, one per line, in iBUG order; for a GLB, counted through its position accessors in order.
    /// auto finds them in a rendering of the mesh and writes beside --out a picture to check (.landmarks.png) and a file
    /// to correct and pass back in (.landmarks.txt)
    #[arg(long)]
    pub landmarks: PathBuf,
    /// glTF with one morph target per shape (.glb, .vrm), or USD with one blend shape (.usda), in the mesh's own unit
    #[arg(long, value_parser = |text: &str| written(text, &["glb", "vrm", "usda"]))]
    pub out: PathBuf,
    /// Shapes and their control points [default: the 67 of config/blendshapes.toml]
    #[arg(long)]
    pub recipe: Option<PathBuf>,
    /// CSV shape,vertex,dx,dy,dz in mesh units, instead of a recipe
    #[arg(long)]
    pub controls: Option<PathBuf>,
    /// Also neutral.obj, one OBJ per shape and shapes.json in this folder
    #[arg(long)]
    pub obj: Option<PathBuf>,
    /// Pictures and figures of every shape, one HTML file
    #[arg(long)]
    pub report: Option<PathBuf>,
    /// Unit of the mesh: mm, cm or m [default: from the distance of the eyes]
    #[arg(long = "unit", value_parser = metres)]
    pub metres: Option<f64>,
    /// aoi; for comparison paper, its Procedure 1 as printed, or laplacian, plain least squares
    #[arg(long, value_enum, default_value_t, hide_possible_values = true)]
    pub method: Method,
    /// With --controls: skin between the given vertices moves as learned from sculpted shapes; with a recipe it always does
    #[arg(long = "derive-controls")]
    pub derive: bool,
    /// Also the recipe's correctives for pairs of shapes, named like jawOpen_mouthSmileLeft, to be weighted by the product
    /// of both weights, as animate does
    #[arg(long)]
    pub correctives: bool,
    /// Morph targets and blend shapes in full, for programs that cannot read sparse ones
    #[arg(long)]
    pub dense: bool,
}

/// A file of ours by its name: binary glTF, the VRM that a head came in or, for `bake`, USD.
pub(in crate::studio) fn written(name: &str, endings: &[&str]) -> Result<PathBuf, String> {
    let out = PathBuf::from(name);
    let ending = out.extension().unwrap_or_default().to_ascii_lowercase();
    if endings.iter().any(|known| ending == *known) {
        return Ok(out);
    }
    let mut expected = format!("expected a name that ends in .{}", endings.join(" or ."));
    if endings.contains(&"usda") {
        expected += "; FBX and .blend come out of Blender, see docs/baking.md";
    }
    Err(expected)
}

/// Whether a file is to be USD, by its name.
#[must_use]
pub fn is_usd(path: &Path) -> bool {
    path.extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("usda"))
}

/// Metres per unit of a mesh.
fn metres(unit: &str) -> Result<f64, String> {
    match unit {
        "mm" => Ok(1e-3),
        "cm" => Ok(1e-2),
        "m" => Ok(1.0),
        _ => Err("expected mm, cm or m".into()),
    }
}
