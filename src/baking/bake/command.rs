//! `mien-studio bake`: files in, files out.

use std::path::{Path, PathBuf};
use std::time::Instant;

use rayon::prelude::*;

use super::files::{read, write};
use super::head::Head;
use super::learn::{Lesson, Truth};
use super::mesh::Mesh;
use super::names::NAMES;
use super::neck::Neck;
use super::order::Ordered;
use super::prior::Prior;
use super::recipe::{Recipe, SHIPPED};
use super::render::Outside;
use super::rig::{self, Method};
use super::shape::{Shape, Target};
use super::source::{Source, landmark_text};
use super::table::table;
use super::{report, verdict};
use mien_stages::base::peak_memory::peak_resident_bytes;
use mien_workbench::fault::Fault;
use mien_workbench::picture_files::png;
use mien_workbench::progress::Progress;
use mien_workbench::text_files;

/// How many of the least confident points are named.
const NAMED_POINTS: usize = 5;
/// Usual distance of the inner eye corners, metres.
const EYE_DISTANCE_M: f64 = 0.034;
/// Bytes of a vertex of a shape: displacement, influence and whether it may move.
const SHAPE_BYTES: usize = 33;
/// Most bytes of all shapes together: 67 of a mesh of a million vertices.
const MAX_SHAPE_BYTES: usize = (67 * SHAPE_BYTES) << 20;

/// What becomes of joined lips.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Joined {
    /// They stay as they are and stretch.
    Keep,
    /// They are cut open.
    Cut,
}

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
    /// glTF with one morph target per shape (.glb, .vrm)
    #[arg(long, value_parser = output_name)]
    pub out: PathBuf,
    /// Shapes and their control points [default: the 67 of config/blendshapes.toml]
    #[arg(long)]
    pub recipe: Option<PathBuf>,
    /// CSV shape,vertex,dx,dy,dz in mesh units, instead of a recipe
    #[arg(long)]
    pub controls: Option<PathBuf>,
    /// Also neutral.obj, one OBJ per shape and shapes.json in this folder; where lips were cut open, also landmarks.txt
    #[arg(long)]
    pub obj: Option<PathBuf>,
    /// Pictures and figures of every shape, one HTML file
    #[arg(long)]
    pub report: Option<PathBuf>,
    /// Unit of the mesh: mm, cm, dm, m, in or metres as a number [default: from the distance of the eyes]; a glTF keeps its own
    #[arg(long = "unit", value_parser = metres)]
    pub metres: Option<f64>,
    /// aoi; for comparison paper, its Procedure 1 as printed, or laplacian, plain least squares
    #[arg(long, value_enum, default_value_t, hide_possible_values = true)]
    pub method: Method,
    /// With --controls: skin between the given vertices moves as learned from sculpted shapes; with a recipe it always does
    #[arg(long = "derive-controls")]
    pub derive: bool,
    /// Joined lips, which have no slit between them: cut opens the mesh from corner to corner and puts an inside of the mouth
    /// behind; keep bakes them as they are, so that they stretch [default: an OBJ is cut, a glTF or VRM is refused]
    #[arg(long, value_enum, hide_possible_values = true, value_name = "keep|cut")]
    pub lips: Option<Joined>,
    /// Also the recipe's correctives for pairs of shapes, named like jawOpen_mouthSmileLeft, to be weighted by the product
    /// of both weights, as animate does
    #[arg(long)]
    pub correctives: bool,
    /// Also the fifteen mouth shapes of speech, viseme_sil to viseme_ou, as sums of the others; a VRM without expressions of its
    /// own for aa, ih, ou, ee and oh gets these
    #[arg(long, conflicts_with = "controls")]
    pub visemes: bool,
    /// Morph targets in full, for programs that cannot read sparse ones
    #[arg(long)]
    pub dense: bool,
    /// Leave shapes that a GLB or VRM has already under names of ours (eyeBlinkLeft, EyeBlink_L) and add none of these; otherwise
    /// theirs are kept as NAME.original
    #[arg(long)]
    pub keep: bool,
}

/// Parses the name of an output: `.glb`, or `.vrm` for a head read from one.
pub fn output_name(name: &str) -> Result<PathBuf, &'static str> {
    let out = PathBuf::from(name);
    let ending = out.extension().unwrap_or_default().to_ascii_lowercase();
    let known = ending == "glb" || ending == "vrm";
    known.then_some(out).ok_or(
        "expected a name that ends in .glb or .vrm; FBX, USD and .blend come out of Blender, see docs/baking.md",
    )
}

/// Metres per unit of a mesh.
fn metres(unit: &str) -> Result<f64, String> {
    match unit {
        "mm" => Ok(1e-3),
        "cm" => Ok(1e-2),
        "dm" => Ok(0.1),
        "m" => Ok(1.0),
        "in" => Ok(0.0254),
        _ => match unit.parse::<f64>() {
            Ok(metres) if metres.is_normal() && metres > 0.0 => Ok(metres),
            _ => Err("expected mm, cm, dm, m, in or a number above 0 of metres".into()),
        },
    }
}

/// Metres per unit of the mesh, and how that was determined.
fn scale(request: &Request, head: &Head) -> (f64, &'static str) {
    if let Some(metres) = request.metres {
        return (metres, "as given");
    }
    let found = head.eye_distance;
    let mut units = [1.0, 1e-2, 1e-3, 0.1, 0.0254].into_iter();
    match units.find(|m| (0.02..0.06).contains(&(found * m))) {
        Some(metres) => (metres, "from the distance of the eyes"),
        None => (
            EYE_DISTANCE_M / found,
            "no usual one: eyes put as far apart as people's",
        ),
    }
}

/// Targets from a table of controls or a recipe, if all shapes fit into [`MAX_SHAPE_BYTES`].
fn targets(request: &Request, head: &Head, vertex: &[u32]) -> Result<Vec<Target>, Fault> {
    let targets = match &request.controls {
        Some(path) => table(path, head, vertex, request.derive)?,
        None => recipe_targets(request, head)?,
    };
    let (shapes, vertices) = (targets.len(), head.mesh.positions.len());
    let bytes = (shapes * vertices).saturating_mul(SHAPE_BYTES);
    if bytes > MAX_SHAPE_BYTES {
        return Err(Fault::new(format!(
            "{shapes} shapes of {vertices} vertices would take {bytes} bytes, expected at most {MAX_SHAPE_BYTES}; bake fewer shapes or a coarser mesh"
        )));
    }
    Ok(targets)
}

fn recipe_targets(request: &Request, head: &Head) -> Result<Vec<Target>, Fault> {
    let (text, path) = match &request.recipe {
        Some(path) => (&*read(path)?, path.as_path()),
        None => (SHIPPED, Path::new("built-in recipe")),
    };
    let recipe = Recipe::read(text).map_err(Fault::within(path))?;
    let mut targets = recipe.targets(head).map_err(Fault::within(path))?;
    if request.correctives {
        targets.extend(recipe.correctives(&targets));
    }
    if request.visemes {
        let visemes = recipe.visemes(head).map_err(Fault::within(path))?;
        if visemes.is_empty() {
            let none = "expected [[viseme]] tables for --visemes, found none; the built-in recipe has them";
            return Err(Fault::within(path)(none));
        }
        targets.extend(visemes);
    }
    Ok(targets)
}

const KEPT: &str = "The lips are joined: skin spans the mouth and stretches as it opens.";
const CUT: &str = "The lips were joined: they are cut open along the line between them, with an inside of the mouth behind; give --lips keep to bake them as they were.";

/// Prints the figures of the head.
fn print_head(request: &Request, mesh: &Mesh, head: &Head, (metres, how): (f64, &str)) {
    println!(
        "{}: {} vertices, {} faces; one unit is {metres} m ({how}), eye corners {:.1} mm apart",
        request.mesh.display(),
        mesh.positions.len(),
        mesh.faces(),
        head.eye_distance * metres * 1e3
    );
}

/// Analyses the head in the canonical order.
fn analysed(source: &Source, landmarks: &[u64]) -> Result<(Head, Ordered), Fault> {
    let mut ordered = Ordered::new(&source.mesh);
    let numbers = ordered.landmarks(landmarks)?;
    let head = Head::new(std::mem::take(&mut ordered.mesh), &numbers)?;
    Ok((head, ordered))
}

/// Analyses the head of a source, cutting joined lips open first; the last value is a note on that for the report.
fn opened(
    request: &Request,
    source: &mut Source,
    numbers: &mut [u64],
) -> Result<(Head, Ordered, Option<&'static str>), Fault> {
    let (head, ordered) = analysed(source, numbers)?;
    if !head.lips_are_joined() {
        return Ok((head, ordered, None));
    }
    if request.lips == Some(Joined::Keep) {
        println!("{KEPT}");
        return Ok((head, ordered, Some(KEPT)));
    }
    source.cut(&request.mesh, &head, ordered.vertex(), numbers)?;
    let (head, ordered) = analysed(source, numbers)?;
    println!("{CUT}");
    Ok((head, ordered, Some(CUT)))
}

/// Bakes what the request asks for and writes it; prints one line per step.
///
/// # Errors
/// If something cannot be read, solved or written; nothing half-written is left.
pub fn run(request: &Request) -> Result<Vec<Shape>, Fault> {
    let start = Instant::now();
    // Unpacked while the mesh is read, as it takes as long.
    std::thread::spawn(Prior::shipped);
    let mut source = Source::read(&request.mesh)?;
    let (mut numbers, mut notes) = match request.landmarks.as_os_str() == "auto" {
        true => find_landmarks(request, &source)?,
        false => (
            source.landmarks_from_file(&request.landmarks)?,
            String::new(),
        ),
    };
    let (head, ordered, joined) = opened(request, &mut source, &mut numbers)?;
    notes = format!("{} {notes}", joined.unwrap_or(""));
    let (metres, how) = scale(request, &head);
    print_head(request, &source.mesh, &head, (metres, how));
    let targets = targets(request, &head, ordered.vertex())?;
    let oddities = source.oddities(&targets, request.keep, &request.out);
    if !oddities.is_empty() {
        println!("{}", oddities.trim_end());
        notes = format!("{oddities}{notes}");
    }
    let progress = Progress::new("baking", targets.len());
    let done = |name: &str| progress.step_with(|| name.to_owned());
    let prior = Some(Prior::shipped());
    let shapes = rig::bake(&head, &targets, request.method, prior, &done)?;
    drop(progress);
    let defects = verdict::defects(&head, &shapes);
    println!("{}", verdict::verdict(&shapes, &defects));
    let report = request.report.as_ref().map(|path| {
        let outside = Outside::new(&source.mesh, ordered.vertex(), &source.looks);
        let title = format!("Blendshapes of {}", text_files::display_name(&request.mesh));
        let page = report::html(&head, &outside, &shapes, &defects, [&title, &notes]);
        (path, page)
    });
    let neck = Neck::from_head(&head, &source.mesh.positions);
    // From here on in the vertex order of the file.
    let shapes = shapes.into_par_iter().map(|s| ordered.scattered(s));
    let mut shapes: Vec<Shape> = shapes.collect();
    shapes.retain(|shape| !(request.keep && source.has(&shape.name)));
    let elapsed = || start.elapsed().as_secs_f64();
    println!("{} shapes baked at {:.2} s", shapes.len(), elapsed());
    let file = source.with_shapes(&shapes, metres, request.dense, neck.as_ref());
    write(&request.out, &file)?;
    let memory = peak_resident_bytes().map(|bytes| format!(", {} MiB of memory", bytes >> 20));
    let (out, memory) = (request.out.display(), memory.unwrap_or_default());
    println!("{out} written at {:.2} s{memory}", elapsed());
    if let Some(folder) = &request.obj {
        source.folder_of_obj(folder, &shapes)?;
        if joined == Some(CUT) {
            let numbers = landmark_text(&numbers, None);
            write(&folder.join("landmarks.txt"), numbers.as_bytes())?;
        }
        println!("{} written", folder.display());
    }
    if let Some((path, (text, figures))) = report {
        write(path, text.as_bytes())?;
        println!("{} written: {}", path.display(), report::worst(&figures));
    }
    Ok(shapes)
}

/// Learns the prior of the skin from the sculpted shapes under `data` into `out`.
///
/// # Errors
/// If the shapes cannot be read, solved or the file not be written.
pub fn skin(data: &Path, out: &Path) -> Result<(), Fault> {
    let truth = Truth::read(&data.join("ict_facekit"))?;
    let bytes = Lesson::new(&truth)?.prior(|_| true).emit();
    write(out, &bytes)?;
    println!("wrote {}: {} bytes", out.display(), bytes.len());
    Ok(())
}

/// Landmarks found on the mesh, written beside the output for the user to check.
fn find_landmarks(request: &Request, source: &Source) -> Result<(Vec<u64>, String), Fault> {
    let [picture, text] =
        ["png", "txt"].map(|kind| request.out.with_extension(format!("landmarks.{kind}")));
    let found = source.guess(&request.mesh)?;
    let confidence = found.confidence;
    write(&picture, &png(&found.picture))?;
    let (mesh, shown) = (request.mesh.display(), picture.display());
    if !found.is_face() {
        return Err(Fault::new(format!(
            "{mesh}: expected a face, found none with more than {confidence:.2} confidence ({shown} shows what was seen); place the points with: mien-studio place --mesh {mesh}"
        )));
    }
    let numbers = landmark_text(&found.vertices, source.imported.as_ref());
    // Never overwrite points that were saved by hand.
    let saved = text.exists() && read(&text)? != numbers;
    if saved {
        let text = text.display();
        println!("{text} has other points and was kept; delete it to save the points found here");
    } else {
        write(&text, numbers.as_bytes())?;
    }
    let unsure = found.unsure();
    let names = unsure.iter().take(NAMED_POINTS).map(|&k| NAMES[k]);
    let names: Vec<&str> = names.collect();
    let doubts = match unsure.len() {
        0 => String::new(),
        count => format!("; {count} points unsure, least {}", names.join(", ")),
    };
    let (up, facing, text) = (found.up, found.facing, text.display());
    let found_it =
        format!("face found with confidence {confidence:.2}, up {up}, facing {facing}{doubts}");
    println!(
        "{found_it}: look at {shown}; to correct points, use mien-studio place, or edit {text} and give it with --landmarks"
    );
    Ok((found.vertices, found_it))
}
