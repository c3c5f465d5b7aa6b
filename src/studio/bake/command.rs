//! `mien-studio bake`: files in, files out.

use std::io::{IsTerminal, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use nalgebra::{Isometry3, Translation3, Unit, UnitQuaternion};

use super::glb::{Glb, GlbError};
use super::head::{Head, HeadError};
use super::mesh::Vec3;
use super::obj::{self, ObjError};
use super::patch::Foreign;
use super::recipe::{Recipe, RecipeError, SHIPPED, Target};
use super::rig::{self, Method, Shape};
use super::solve::Settings;
use super::sparse::Singular;
use super::{glb, report};

/// Text of `mien-studio bake --help`.
pub const HELP: &str = "\
Bake blendshapes onto a neutral head.

mien-studio bake --mesh FILE.obj|FILE.glb --landmarks FILE --out FILE.glb
                 [--recipe FILE.toml] [--controls FILE.csv] [--method aoi|laplacian] [--derive-controls]
                 [--unit mm|cm|m] [--dense] [--obj DIR] [--report FILE.html]

  --mesh       neutral head: OBJ (quads, texture coordinates and vertex order are kept), or GLB or VRM, whose copy in
               --out gets the shapes and keeps everything else
  --landmarks  68 vertex numbers from 0, one a line, in iBUG order; of a GLB in the order of its position accessors
  --out        glTF with one morph target per shape
  --recipe     shapes and their control points; default: the 67 built in (config/blendshapes.toml)
  --controls   CSV shape,vertex,dx,dy,dz in mesh units, instead of a recipe
  --method     laplacian: plain least squares, for comparison
  --derive-controls  with --controls: ten more points on cheeks and forehead, moved as skin slides between the 68. A
               recipe names how they move and has them always
  --unit       unit of the mesh; default: told from the distance of the eyes
  --dense      morph targets in full, for programs that cannot read sparse ones
  --obj        also neutral.obj, one OBJ per shape and shapes.json in this folder
  --report     pictures and figures of every shape, one HTML file

Example: mien-studio bake --mesh head.obj --landmarks head68.txt --out head.glb --report head.html
";

/// Why nothing was baked.
#[derive(Debug, thiserror::Error)]
pub enum BakeError {
    /// Wrong command line.
    #[error("{0}; see mien-studio bake --help")]
    Usage(String),
    /// A file cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file cannot be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The mesh text is damaged.
    #[error("{path}: {source}")]
    Obj {
        /// The file.
        path: PathBuf,
        /// Where and what.
        source: ObjError,
    },
    /// The glTF file is damaged or of a kind that cannot be baked onto.
    #[error("{path}: {source}")]
    Glb {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: GlbError,
    },
    /// The landmarks are not numbers.
    #[error("{path}: line {line}: expected a vertex number, found {found:?}")]
    Landmarks {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// The line.
        found: String,
    },
    /// The head does not fit its landmarks.
    #[error(transparent)]
    Head(#[from] HeadError),
    /// The recipe is damaged.
    #[error("{path}: {source}")]
    Recipe {
        /// The file.
        path: PathBuf,
        /// Where and what.
        source: RecipeError,
    },
    /// The controls are damaged.
    #[error("{path}: line {line}: expected {expected}, found {found:?}")]
    Controls {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// What should be there.
        expected: &'static str,
        /// The line.
        found: String,
    },
    /// The unit cannot be told.
    #[error(
        "the inner eye corners are {found} units apart, which is no head in mm, cm or m (2 to 6 cm); say which with --unit mm|cm|m or scale the mesh"
    )]
    Scale {
        /// Distance in mesh units.
        found: f64,
    },
    /// A system could not be solved.
    #[error(transparent)]
    Singular(#[from] Singular),
}

/// What to bake and where to put it.
#[derive(Debug, Default)]
pub struct Request {
    mesh: PathBuf,
    landmarks: PathBuf,
    out: PathBuf,
    recipe: Option<PathBuf>,
    controls: Option<PathBuf>,
    obj: Option<PathBuf>,
    report: Option<PathBuf>,
    metres: Option<f64>,
    laplacian: bool,
    derive: bool,
    dense: bool,
}

impl Request {
    /// Reads the command line behind `bake`.
    ///
    /// # Errors
    /// If an option is unknown, has no value or a needed one is missing.
    pub fn parse(args: &[String]) -> Result<Self, BakeError> {
        let usage = |text: String| BakeError::Usage(text);
        let mut request = Self::default();
        let mut seen = [false; 3];
        let mut args = args.iter();
        while let Some(arg) = args.next() {
            let mut value = || {
                args.next()
                    .map(String::as_str)
                    .ok_or_else(|| usage(format!("expected a value after {arg}")))
            };
            match arg.as_str() {
                "--mesh" => (request.mesh, seen[0]) = (value()?.into(), true),
                "--landmarks" => (request.landmarks, seen[1]) = (value()?.into(), true),
                "--out" => (request.out, seen[2]) = (value()?.into(), true),
                "--recipe" => request.recipe = Some(value()?.into()),
                "--controls" => request.controls = Some(value()?.into()),
                "--obj" => request.obj = Some(value()?.into()),
                "--report" => request.report = Some(value()?.into()),
                "--dense" => request.dense = true,
                "--derive-controls" => request.derive = true,
                "--method" => {
                    request.laplacian = match value()? {
                        "aoi" => false,
                        "laplacian" => true,
                        other => {
                            return Err(usage(format!(
                                "expected --method aoi or laplacian, found {other:?}"
                            )));
                        }
                    }
                }
                "--unit" => {
                    request.metres = Some(match value()? {
                        "mm" => 1e-3,
                        "cm" => 1e-2,
                        "m" => 1.0,
                        other => {
                            return Err(usage(format!(
                                "expected --unit mm, cm or m, found {other:?}"
                            )));
                        }
                    });
                }
                other => return Err(usage(format!("unknown option {other:?}"))),
            }
        }
        for (given, name) in seen.into_iter().zip(["--mesh", "--landmarks", "--out"]) {
            if !given {
                return Err(usage(format!("expected {name}, which is needed")));
            }
        }
        Ok(request)
    }
}

fn bytes(path: &Path) -> Result<Vec<u8>, BakeError> {
    std::fs::read(path).map_err(|source| BakeError::Read {
        path: path.into(),
        source,
    })
}

fn read(path: &Path) -> Result<String, BakeError> {
    Ok(String::from_utf8_lossy(&bytes(path)?).into_owned())
}

/// Writes through a temporary neighbour, so that no half file is left behind.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Result<(), BakeError> {
    let failed = |source| BakeError::Write {
        path: path.into(),
        source,
    };
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".part");
    let part = path.with_file_name(name);
    std::fs::write(&part, bytes)
        .and_then(|()| std::fs::rename(&part, path))
        .inspect_err(|_| {
            let _ = std::fs::remove_file(&part);
        })
        .map_err(failed)
}

fn landmarks(path: &Path) -> Result<Vec<u64>, BakeError> {
    read(path)?
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty() && !line.trim_start().starts_with('#'))
        .map(|(k, line)| {
            line.trim().parse().map_err(|_| BakeError::Landmarks {
                path: path.into(),
                line: k + 1,
                found: line.chars().take(40).collect(),
            })
        })
        .collect()
}

/// Targets from a table of controls.
fn table(path: &Path, head: &Head, derive: bool) -> Result<Vec<Target>, BakeError> {
    let text = read(path)?;
    let refuse = |line: usize, expected, found: &str| BakeError::Controls {
        path: path.into(),
        line: line + 1,
        expected,
        found: found.chars().take(60).collect(),
    };
    let mut lines = text.lines().enumerate();
    let header = lines.next().map_or("", |(_, l)| l);
    let column = |name: &'static str| header.split(',').position(|c| c.trim() == name);
    const HEADER: &str = "the columns shape,vertex,dx,dy,dz";
    let at: Option<Vec<usize>> = ["shape", "vertex", "dx", "dy", "dz"]
        .into_iter()
        .map(column)
        .collect();
    let at = at.ok_or_else(|| refuse(0, HEADER, header))?;
    let mut targets: Vec<Target> = Vec::new();
    for (k, line) in lines {
        if line.trim().is_empty() {
            continue;
        }
        const ROW: &str = "a shape, a vertex of the mesh (from 0) and three finite numbers";
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        let cell = |c: usize| {
            cells
                .get(at[c])
                .copied()
                .ok_or_else(|| refuse(k, ROW, line))
        };
        let name = cell(0)?;
        let vertex: usize = cell(1)?.parse().map_err(|_| refuse(k, ROW, line))?;
        let mut d = Vec3::zeros();
        for c in 0..3 {
            d[c] = cell(2 + c)?.parse().map_err(|_| refuse(k, ROW, line))?;
        }
        if vertex >= head.mesh.positions.len()
            || !d.iter().all(|x: &f64| x.is_finite())
            || name.is_empty()
        {
            return Err(refuse(k, ROW, line));
        }
        // Rows of one shape stand together in practice; look from the end.
        let target = match targets.iter().rposition(|t| t.name == name) {
            Some(at) => &mut targets[at],
            None => {
                targets.push(Target {
                    name: name.into(),
                    unit: None,
                    upon: None,
                    controls: Vec::new(),
                    exact: true,
                    derive,
                    close: [None; 2],
                    gaze: [None; 2],
                    jaw: None,
                    tongue: None,
                    undo: None,
                });
                targets.last_mut().expect("just pushed")
            }
        };
        target.controls.push((vertex as u32, d));
    }
    for target in &mut targets {
        target.jaw = jaw_of(head, &target.controls);
    }
    Ok(targets)
}

/// The jaw's motion behind a table of controls: a turn about its axis, if chin and lower lip go down and back together.
fn jaw_of(head: &Head, controls: &[(u32, Vec3)]) -> Option<Isometry3<f64>> {
    /// What a sculpted chin takes part in a jaw's motion, see `jawOpen` in the recipe.
    const SHARE: f64 = 0.84;
    let w = head.eye_distance;
    let (left, up) = (
        head.axes.column(0).into_owned(),
        head.axes.column(1).into_owned(),
    );
    let mut turn = 0.0;
    for point in [7, 8, 9] {
        let (_, d) = controls.iter().find(|(v, _)| *v == head.points[point])?;
        let arm = head.point(point) - head.hinge;
        let along = left.cross(&arm);
        if d.dot(&up) > -0.15 * w || d.dot(&along) < 0.8 * d.norm() * along.norm() {
            return None;
        }
        turn += d.dot(&along) / along.norm_squared() / SHARE / 3.0;
    }
    let (_, lip) = controls.iter().find(|(v, _)| *v == head.points[57])?;
    if lip.dot(&up) > -0.15 * w {
        return None;
    }
    let turn = UnitQuaternion::from_axis_angle(&Unit::new_normalize(left), turn);
    Some(Isometry3::from_parts(
        Translation3::from(head.hinge - turn * head.hinge),
        turn,
    ))
}

/// Bakes what the request asks for and writes it; prints one line per step.
///
/// # Errors
/// If something cannot be read, solved or written; nothing half-written is left.
pub fn run(request: &Request) -> Result<Vec<Shape>, BakeError> {
    let start = Instant::now();
    let bytes = bytes(&request.mesh)?;
    let numbers = landmarks(&request.landmarks)?;
    let (head, source, foreign) = if bytes.starts_with(b"glTF") {
        let refuse = |source| BakeError::Glb {
            path: request.mesh.clone(),
            source,
        };
        let glb = Glb::parse(&bytes).map_err(refuse)?;
        let (mesh, foreign) = Foreign::read(glb).map_err(refuse)?;
        let source = obj::emit(&mesh);
        let head = Head::new(mesh, &foreign.landmarks(&numbers))?;
        (head, source, Some(foreign))
    } else {
        let source = String::from_utf8_lossy(&bytes).into_owned();
        let mesh = obj::parse(&source).map_err(|source| BakeError::Obj {
            path: request.mesh.clone(),
            source,
        })?;
        (Head::new(mesh, &numbers)?, source, None)
    };
    let (metres, how) = match request.metres {
        Some(metres) => (metres, "as told"),
        None => {
            let found = head.eye_distance;
            let fits = [1.0, 1e-2, 1e-3]
                .into_iter()
                .find(|m| (0.02..0.06).contains(&(found * m)));
            (
                fits.ok_or(BakeError::Scale { found })?,
                "told from the eyes",
            )
        }
    };
    println!(
        "{}: {} vertices, {} faces; one unit is {metres} m ({how}), eye corners {:.1} mm apart",
        request.mesh.display(),
        head.mesh.positions.len(),
        head.mesh.faces(),
        head.eye_distance * metres * 1e3
    );
    let targets = match (&request.controls, &request.recipe) {
        (Some(path), _) => table(path, &head, request.derive)?,
        (None, path) => {
            let text = path
                .as_ref()
                .map_or_else(|| Ok(SHIPPED.to_owned()), |path| read(path))?;
            let named = |source| BakeError::Recipe {
                path: path.clone().unwrap_or_else(|| "built-in recipe".into()),
                source,
            };
            let recipe = Recipe::read(&text).map_err(named)?;
            recipe.targets(&head).map_err(named)?
        }
    };
    let method = if request.laplacian {
        Method::Laplacian
    } else {
        Method::Aoi
    };
    let count = AtomicUsize::new(0);
    let terminal = std::io::stderr().is_terminal();
    let total = targets.len();
    let done = |name: &str| {
        let k = count.fetch_add(1, Ordering::Relaxed) + 1;
        if terminal {
            let filled = 30 * k / total.max(1);
            eprint!(
                "\r[{}{}] {k}/{total} {name:28}",
                "#".repeat(filled),
                ".".repeat(30 - filled)
            );
            let _ = std::io::stderr().flush();
        }
    };
    let shapes = rig::bake(&head, &targets, &Settings::default(), method, &done)?;
    if terminal {
        eprintln!();
    }
    println!(
        "{} shapes baked at {:.2} s",
        shapes.len(),
        start.elapsed().as_secs_f64()
    );
    let out = match foreign {
        Some(foreign) => foreign.patched(&shapes, request.dense),
        None => glb::build(&head.mesh, &shapes, metres, request.dense),
    };
    write(&request.out, &out.emit())?;
    println!(
        "{} written at {:.2} s",
        request.out.display(),
        start.elapsed().as_secs_f64()
    );
    if let Some(folder) = &request.obj {
        folder_of_obj(folder, &source, &head, &shapes)?;
        println!("{} written", folder.display());
    }
    if let Some(path) = &request.report {
        let title = format!(
            "Blendshapes of {}",
            request
                .mesh
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
        );
        let (text, figures) = report::html(&head, &shapes, &title);
        write(path, text.as_bytes())?;
        let inverted: usize = figures.iter().map(|f| f.inverted).sum();
        let outside = figures.iter().map(|f| f.outside).fold(0.0, f64::max);
        let depth = figures.iter().map(|f| f.eye_depth).fold(0.0, f64::max);
        println!(
            "{} written: {inverted} inverted triangles, largest motion outside its area {outside}, \
             lids at most {depth:.5} eye distances deeper in the eye",
            path.display()
        );
    }
    Ok(shapes)
}

fn folder_of_obj(
    folder: &Path,
    source: &str,
    head: &Head,
    shapes: &[Shape],
) -> Result<(), BakeError> {
    std::fs::create_dir_all(folder).map_err(|source| BakeError::Write {
        path: folder.into(),
        source,
    })?;
    write(&folder.join("neutral.obj"), source.as_bytes())?;
    for shape in shapes {
        let moved: Vec<Vec3> = head
            .mesh
            .positions
            .iter()
            .zip(&shape.displacement)
            .map(|(p, d)| p + d)
            .collect();
        let text = obj::with_positions(source, &moved, false);
        write(&folder.join(format!("{}.obj", shape.name)), text.as_bytes())?;
    }
    let list: Vec<serde_json::Value> = shapes
        .iter()
        .map(|s| {
            serde_json::json!({"name": s.name, "file": format!("{}.obj", s.name), "unit": s.unit, "upon": s.upon})
        })
        .collect();
    let index = serde_json::json!({"neutral": "neutral.obj", "shapes": list});
    write(
        &folder.join("shapes.json"),
        format!("{index:#}\n").as_bytes(),
    )
}

/// The command: everything behind `mien-studio bake`.
///
/// # Errors
/// As [`Request::parse`] and [`run`].
pub fn bake(args: &[String]) -> Result<(), BakeError> {
    if args.iter().any(|a| a == "--help" || a == "-h") {
        print!("{HELP}");
        return Ok(());
    }
    run(&Request::parse(args)?).map(|_| ())
}
