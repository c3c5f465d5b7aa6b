//! `mien-studio bake`: files in, files out.

use std::io::{IsTerminal, Write as _};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use rayon::prelude::*;

use super::benchmark::Truth;
use super::error::BakeError;
use super::files::{read, read_bytes, write};
use super::glb::Glb;
use super::head::Head;
use super::learn::{Lesson, means};
use super::locate::guess;
use super::looks::Looks;
use super::measure::Figures;
use super::mesh::{Mesh, Vec3};
use super::names::NAMES;
use super::obj;
use super::order::Ordered;
use super::patch::Foreign;
use super::prior::Prior;
use super::recipe::{Recipe, SHIPPED, Target};
use super::render::Outside;
use super::request::{Request, is_usd};
use super::rig;
use super::shape::Shape;
use super::solve::Settings;
use super::table::table;
use super::{morphs, report, usd};
use crate::appliance::memory::peak_resident_bytes;
use crate::face_model::FaceModel;
use crate::studio::text_files;

/// How many of the points found least surely are named.
const NAMED: usize = 5;
/// What a vertex of a shape takes: its displacement, its influence and whether it could move.
const SHAPE_BYTES: usize = 33;
/// What all shapes together may take: 67 of a mesh of a million vertices.
const SHAPES_MOST: usize = (67 * SHAPE_BYTES) << 20;

/// Vertex numbers from the text of the landmark file at `path`: one a line, `#` begins a comment.
///
/// # Errors
/// At the first line that is none.
pub fn landmarks(text: &str, path: &Path) -> Result<Vec<u64>, BakeError> {
    text.lines()
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

/// The text of a landmark file: these vertices of the mesh in the numbering that its file has.
pub(in crate::studio) fn landmark_text(vertices: &[u64], foreign: Option<&Foreign>) -> String {
    let numbers = foreign.map_or_else(|| vertices.to_vec(), |f| f.rows(vertices));
    numbers.iter().map(|v| format!("{v}\n")).collect()
}

/// A mesh as it came.
pub(in crate::studio) struct Source {
    pub(in crate::studio) mesh: Mesh,
    pub(in crate::studio) looks: Looks,
    /// As OBJ text, if it came so or OBJ is wanted.
    obj: String,
    /// The glTF that it came in.
    pub(in crate::studio) foreign: Option<Foreign>,
}

impl Source {
    pub(in crate::studio) fn read(request: &Request) -> Result<Self, BakeError> {
        let bytes = read_bytes(&request.mesh)?;
        let folder = request.mesh.parent().unwrap_or(Path::new(""));
        if bytes.starts_with(b"glTF") || bytes.trim_ascii_start().starts_with(b"{") {
            let refuse = |source| BakeError::Glb {
                path: request.mesh.clone(),
                source,
            };
            let glb = Glb::read(&bytes, folder).map_err(refuse)?;
            let looks = Looks::in_glb(&glb);
            let (mesh, foreign) = Foreign::read(glb).map_err(refuse)?;
            let obj = request.obj.is_some().then(|| obj::emit(&mesh));
            return Ok(Self {
                mesh,
                looks,
                obj: obj.unwrap_or_default(),
                foreign: Some(foreign),
            });
        }
        let obj = text_files::decoded(&bytes);
        let mesh = obj::parse(&obj).map_err(|source| BakeError::Obj {
            path: request.mesh.clone(),
            source,
        })?;
        Ok(Self {
            mesh,
            looks: Looks::of(&request.mesh, &obj),
            obj,
            foreign: None,
        })
    }

    /// Vertex numbers of the landmarks, as told or as found.
    fn landmarks(&self, request: &Request) -> Result<Vec<u64>, BakeError> {
        if request.landmarks.as_os_str() == "auto" {
            return found(request, self);
        }
        self.told(&request.landmarks)
    }

    /// Vertex numbers of the landmarks in a file.
    pub(in crate::studio) fn told(&self, path: &Path) -> Result<Vec<u64>, BakeError> {
        let numbers = landmarks(&read(path)?, path)?;
        Ok(match &self.foreign {
            Some(foreign) => foreign.landmarks(&numbers),
            None => numbers,
        })
    }
}

/// Metres per unit of the mesh, and how that is known.
fn scale(request: &Request, head: &Head) -> Result<(f64, &'static str), BakeError> {
    if let Some(metres) = request.metres {
        return Ok((metres, "as told"));
    }
    let found = head.eye_distance;
    let mut units = [1.0, 1e-2, 1e-3].into_iter();
    let fits = units.find(|m| (0.02..0.06).contains(&(found * m)));
    Ok((
        fits.ok_or(BakeError::Scale { found })?,
        "told from the eyes",
    ))
}

/// What is to be baked: a table of controls or a recipe, if it leaves room for the shapes.
fn targets(request: &Request, head: &Head, vertex: &[u32]) -> Result<Vec<Target>, BakeError> {
    let targets = match (&request.controls, &request.recipe) {
        (Some(path), _) => table(path, head, vertex, request.derive)?,
        (None, path) => {
            let text = path
                .as_ref()
                .map_or_else(|| Ok(SHIPPED.to_owned()), |path| read(path))?;
            let named = |source| BakeError::Recipe {
                path: path.clone().unwrap_or_else(|| "built-in recipe".into()),
                source,
            };
            let recipe = Recipe::read(&text).map_err(named)?;
            let mut targets = recipe.targets(head).map_err(named)?;
            if request.correctives {
                targets.extend(recipe.correctives(&targets));
            }
            targets
        }
    };
    let vertices = head.mesh.positions.len();
    let bytes = (targets.len() * vertices).saturating_mul(SHAPE_BYTES);
    if bytes > SHAPES_MOST {
        return Err(BakeError::Large {
            shapes: targets.len(),
            vertices,
            bytes,
            most: SHAPES_MOST,
        });
    }
    Ok(targets)
}

/// Bakes with a bar on a terminal.
fn baked(request: &Request, head: &Head, targets: &[Target]) -> Result<Vec<Shape>, BakeError> {
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
    let shapes = rig::bake(head, targets, &Settings::default(), request.method, &done)?;
    if terminal {
        eprintln!();
    }
    Ok(shapes)
}

/// What was read, and what will not open.
fn say_head(request: &Request, mesh: &Mesh, head: &Head, (metres, how): (f64, &str)) {
    println!(
        "{}: {} vertices, {} faces; one unit is {metres} m ({how}), eye corners {:.1} mm apart",
        request.mesh.display(),
        mesh.positions.len(),
        mesh.faces(),
        head.eye_distance * metres * 1e3
    );
    if head.lips_are_joined() {
        println!(
            "lips joined: skin spans the mouth and will stretch as it opens; cut the mesh along the lip line for a mouth that opens"
        );
    }
}

/// Bakes what the request asks for and writes it; prints one line per step.
///
/// # Errors
/// If something cannot be read, solved or written; nothing half-written is left.
pub fn run(request: &Request) -> Result<Vec<Shape>, BakeError> {
    let start = Instant::now();
    // Unpacked while the mesh is read: it takes as long.
    std::thread::spawn(Prior::shipped);
    let source = Source::read(request)?;
    let numbers = source.landmarks(request)?;
    let mut ordered = Ordered::new(&source.mesh);
    let numbers = ordered.landmarks(&numbers)?;
    let head = Head::new(std::mem::take(&mut ordered.mesh), &numbers)?;
    let (metres, how) = scale(request, &head)?;
    say_head(request, &source.mesh, &head, (metres, how));
    let shapes = baked(request, &head, &targets(request, &head, ordered.vertex())?)?;
    let promises = report::promises(&shapes);
    if !promises.is_empty() {
        println!("{promises}");
    }
    let report = request.report.as_ref();
    let outside = || Outside::new(&source.mesh, ordered.vertex(), &source.looks);
    let report = report.map(|path| Report::of(path, request, &head, &outside(), &shapes));
    // From here on in the order of the file.
    let shapes: Vec<Shape> = shapes
        .into_par_iter()
        .map(|s| ordered.scattered(s))
        .collect();
    println!(
        "{} shapes baked at {:.2} s",
        shapes.len(),
        start.elapsed().as_secs_f64()
    );
    let out = match source.foreign {
        _ if is_usd(&request.out) => {
            let looks = &source.looks;
            let pictures = looks.beside(&request.out, &source.mesh.materials);
            for (file, bytes) in pictures.values() {
                write(&request.out.with_file_name(file), bytes)?;
            }
            usd::emit(
                &source.mesh,
                looks,
                &pictures,
                &shapes,
                metres,
                request.dense,
            )
            .into_bytes()
        }
        Some(foreign) => foreign.patched(&shapes, request.dense).emit(),
        None => {
            let mut glb = morphs::build(&source.mesh, &shapes, metres, request.dense);
            source.looks.paint(&mut glb);
            glb.emit()
        }
    };
    write(&request.out, &out)?;
    let memory = peak_resident_bytes().map_or_else(String::new, |bytes| {
        format!(", {} MiB of memory", bytes >> 20)
    });
    println!(
        "{} written at {:.2} s{memory}",
        request.out.display(),
        start.elapsed().as_secs_f64()
    );
    if let Some(folder) = &request.obj {
        folder_of_obj(folder, &source.obj, &source.mesh, &shapes)?;
        println!("{} written", folder.display());
    }
    if let Some(report) = report {
        report.write()?;
    }
    Ok(shapes)
}

/// The page about the shapes and its worst figures.
struct Report<'a> {
    path: &'a Path,
    text: String,
    figures: Vec<Figures>,
}

impl<'a> Report<'a> {
    fn of(
        path: &'a Path,
        request: &Request,
        head: &Head,
        outside: &Outside<'_>,
        shapes: &[Shape],
    ) -> Self {
        let name = request.mesh.file_name().unwrap_or_default();
        let title = format!("Blendshapes of {}", name.to_string_lossy());
        let (text, figures) = report::html(head, outside, shapes, &title);
        Self {
            path,
            text,
            figures,
        }
    }

    fn write(&self) -> Result<(), BakeError> {
        let figures = &self.figures;
        write(self.path, self.text.as_bytes())?;
        let inverted: usize = figures.iter().map(|f| f.inverted).sum();
        let outside = figures.iter().map(|f| f.outside).fold(0.0, f64::max);
        let depth = figures.iter().map(|f| f.eye_depth).fold(0.0, f64::max);
        println!(
            "{} written: {inverted} inverted triangles, largest motion outside its area {outside}, \
             lids at most {depth:.5} eye distances deeper in the eye",
            self.path.display()
        );
        Ok(())
    }
}

/// Learns the prior of the skin from the sculpted shapes under `data` into `out`; prints how close each shape comes by what is
/// learned without it and its other side.
///
/// # Errors
/// If the shapes cannot be read, solved or the file not be written.
pub fn skin(data: &Path, out: &Path) -> Result<(), BakeError> {
    let truth = Truth::read(&data.join("ict_facekit"))?;
    let lesson = Lesson::new(&truth)?;
    let bytes = lesson.prior().emit();
    write(out, &bytes)?;
    println!("wrote {}: {} bytes", out.display(), bytes.len());
    let scores = lesson.left_out()?;
    println!("RMS error over RMS motion: the solve alone -> with what the other shapes teach");
    for score in &scores {
        let [alone, taught] = score.face;
        let cheek = score.cheek.map_or_else(String::new, |[alone, taught]| {
            format!("; cheek {alone:.3} -> {taught:.3}")
        });
        println!("{:20} {alone:.3} -> {taught:.3}{cheek}", score.name);
    }
    let [face, cheek] = means(&scores);
    println!(
        "mean of {} shapes {:.4} -> {:.4}; of the cheek {:.4} -> {:.4}",
        scores.len(),
        face[0],
        face[1],
        cheek[0],
        cheek[1]
    );
    Ok(())
}

/// Landmarks found on the mesh, written beside the output for a person to confirm.
fn found(request: &Request, source: &Source) -> Result<Vec<u64>, BakeError> {
    let (picture, text) = (
        request.out.with_extension("landmarks.png"),
        request.out.with_extension("landmarks.txt"),
    );
    let drawn = |seen: &image::RgbImage| {
        let mut png = std::io::Cursor::new(Vec::new());
        let drawn = seen.write_to(&mut png, image::ImageFormat::Png);
        drawn.map_err(|e| BakeError::Write {
            path: picture.clone(),
            source: std::io::Error::other(e),
        })?;
        write(&picture, png.get_ref())
    };
    let model = FaceModel::shipped();
    let found = guess(&source.mesh, &source.looks, &model).map_err(|source| BakeError::Locate {
        path: request.mesh.clone(),
        source,
    })?;
    drawn(&found.picture)?;
    if !found.is_face() {
        return Err(BakeError::Unseen {
            mesh: request.mesh.clone(),
            confidence: found.confidence,
            picture,
        });
    }
    write(
        &text,
        landmark_text(&found.vertices, source.foreign.as_ref()).as_bytes(),
    )?;
    let unsure = found.unsure();
    let names: Vec<&str> = unsure.iter().take(NAMED).map(|&k| NAMES[k]).collect();
    let doubts = match unsure.len() {
        0 => String::new(),
        count => format!("; {count} points unsure, least {}", names.join(", ")),
    };
    println!(
        "face found with confidence {:.2}, up {}, facing {}{doubts}: look at {}; to correct points, use mien-studio place, or edit {} and give it with --landmarks",
        found.confidence,
        found.up,
        found.facing,
        picture.display(),
        text.display()
    );
    Ok(found.vertices)
}

fn folder_of_obj(
    folder: &Path,
    source: &str,
    mesh: &Mesh,
    shapes: &[Shape],
) -> Result<(), BakeError> {
    std::fs::create_dir_all(folder).map_err(|source| BakeError::Write {
        path: folder.into(),
        source,
    })?;
    write(&folder.join("neutral.obj"), source.as_bytes())?;
    for shape in shapes {
        let moved: Vec<Vec3> = mesh
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
