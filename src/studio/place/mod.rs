//! `mien-studio place`: a page for placing the 68 landmarks on a neutral head, with a preview of the resulting shapes.
//!
//! ```text
//! page (drags, undoes) ─► move: a ray to the vertex there (surface) ─► bake ─► the head with one shape ─► save
//! ```
//! The page holds the points and sends all of them with every request; the server holds the mesh, the last bake, and
//! the file. Server, viewer and glTF reader are those of [`super::preview`]. Served on the loopback interface only,
//! since it writes a file. Units and frame: the mesh's.

pub mod surface;

use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use serde_json::{Value, json};

use super::preview;
use super::preview::http::{self, Answer, Request, Site};
use mien_baking::bake::head::{Head, not_on_one_part, wrong_landmark_count};
use mien_baking::bake::locate::LOW_CONFIDENCE;
use mien_baking::bake::mesh::{Mesh, Vec3};
use mien_baking::bake::names::{LANDMARKS, NAMES, mirrored};
use mien_baking::bake::order::Ordered;
use mien_baking::bake::shape::{Shape, shown};
use mien_baking::bake::source::{Source, landmark_text};
use mien_baking::bake::{files, morphs};
use mien_baking::heads::default_head;
use mien_workbench::atomic_write;
use mien_workbench::fault::Fault;
use mien_workbench::text_files::display_name;
use surface::{Ray, Surface};

/// Port of the page.
pub const PORT: u16 = 9181;

/// Whose points to place, and where to save them.
#[derive(clap::Args)]
pub struct Args {
    /// Neutral head, as for bake
    #[arg(long)]
    mesh: PathBuf,
    /// Initial points: a file of 68 vertex numbers, as for bake, or auto to find them in a rendering of the mesh
    #[arg(long, default_value = "auto")]
    landmarks: PathBuf,
    /// File that Save writes, for bake --landmarks [default: beside the mesh, NAME.landmarks.txt]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Port of the page, on this machine only; 0 takes a free one
    #[arg(long, default_value_t = PORT)]
    port: u16,
}

/// The page's own files: path and text.
const PAGE: [(&str, &str); 3] = [
    ("/", include_str!("page/index.html")),
    ("/place.css", include_str!("page/place.css")),
    ("/place.js", include_str!("page/place.js")),
];
/// Paths of the files shared with the preview.
const SHARED_FILES: [&str; 5] = [
    "/look.css",
    "/style.css",
    "/head.js",
    "/glb.js",
    "/matrix.js",
];

/// A head and its landmarks, with the page that edits them.
pub struct LandmarkEditor {
    source: Source,
    /// The mesh for display, with skin, and eyes and teeth, in two colours.
    drawn: Mesh,
    ordered: Ordered,
    surface: Surface,
    /// The initial points.
    points: Vec<u64>,
    /// Confidence of each point, if they were found automatically.
    confidence: Option<Vec<f32>>,
    name: String,
    out: PathBuf,
    /// The shapes of the last bake.
    baked: Mutex<Vec<Shape>>,
    /// The last file with its shape, kept so that repeated requests get the same bytes.
    made: Mutex<Option<(String, Arc<[u8]>)>>,
    /// Held during a bake, so that there is one at a time.
    baking: Mutex<()>,
}

/// Default path for saved points, beside a mesh; never an existing file other than their source.
fn beside(mesh: &Path, landmarks: &Path) -> PathBuf {
    let name = mesh.with_extension("landmarks.txt");
    if name == landmarks {
        return name;
    }
    atomic_write::unused(&name)
}

impl LandmarkEditor {
    /// Reads a head and its initial points; `landmarks` is their file, or `auto`.
    ///
    /// # Errors
    /// If a file cannot be read or the points are not on the head.
    pub fn new(mesh: &Path, landmarks: &Path, out: Option<PathBuf>) -> Result<Self, Fault> {
        let source = Source::read(mesh)?;
        let (points, confidence) = if landmarks.as_os_str() == "auto" {
            let found = source.guess(mesh)?;
            (found.vertices, Some(found.point_confidence.to_vec()))
        } else {
            (source.landmarks_from_file(landmarks)?, None)
        };
        let ordered = Ordered::new(&source.mesh);
        // Checked for the same error as in `bake`.
        ordered.landmarks(&points)?;
        if points.len() != LANDMARKS {
            return Err(wrong_landmark_count(points.len()));
        }
        let surface = Surface::new(&source.mesh, &ordered, points[8]);
        if let Some(landmark) = points.iter().position(|&v| !surface.is_skin(v)) {
            return Err(not_on_one_part(landmark));
        }
        Ok(Self {
            drawn: match source.looks.is_empty() {
                true => in_two_colours(&source.mesh, &surface),
                false => source.mesh.clone(),
            },
            name: display_name(mesh),
            out: out.unwrap_or_else(|| beside(mesh, landmarks)),
            source,
            ordered,
            surface,
            points,
            confidence,
            baked: Mutex::default(),
            made: Mutex::default(),
            baking: Mutex::default(),
        })
    }

    /// Vertices with positions and normals, as JSON for the page.
    fn points_json(&self, points: &[u64]) -> Value {
        let all = points.iter().map(|&v| self.surface.position_and_normal(v));
        let rows = all.map(|(p, n)| (<[f64; 3]>::from(p), <[f64; 3]>::from(n)));
        let (places, normals): (Vec<_>, Vec<_>) = rows.unzip();
        json!({"points": points, "places": places, "normals": normals})
    }

    /// The page's initial data, as JSON.
    fn start(&self) -> Value {
        let mut start = self.points_json(&self.points);
        let partners: Vec<usize> = (0..LANDMARKS).map(mirrored).collect();
        start["name"] = json!(self.name);
        start["names"] = json!(&NAMES[..LANDMARKS]);
        start["partners"] = json!(partners);
        start["confidence"] = json!(self.confidence);
        start["low"] = json!(LOW_CONFIDENCE);
        start["out"] = json!(self.out.display().to_string());
        start["exists"] = json!(self.out.exists());
        start["symmetric"] = json!(self.surface.is_symmetric());
        start
    }

    /// Number of points found with low confidence and not set manually.
    fn guessed(&self, points: &[u64], set: &[usize]) -> usize {
        let low = self.confidence.iter().flatten().zip(0..);
        let low = low.filter(|(sure, _)| **sure < LOW_CONFIDENCE);
        let guessed = low.filter(|&(_, k)| points[k] == self.points[k] && !set.contains(&k));
        guessed.count()
    }

    /// Bakes all shapes with these points; returns the duration, seconds.
    ///
    /// # Errors
    /// If the points do not describe a face.
    pub fn bake(&self, points: &[u64]) -> Result<f64, Fault> {
        let _one = self.baking.lock().unwrap_or_else(PoisonError::into_inner);
        let start = Instant::now();
        let numbers = self.ordered.landmarks(points)?;
        let head = Head::new(self.ordered.mesh.clone(), &numbers)?;
        let shapes = default_head::shapes(&head)?.into_iter();
        let shapes = shapes.map(|s| self.ordered.scattered(s));
        *self.baked.lock().unwrap_or_else(PoisonError::into_inner) = shapes.collect();
        *self.made.lock().unwrap_or_else(PoisonError::into_inner) = None;
        Ok(start.elapsed().as_secs_f64())
    }

    /// The head in the mesh's unit, with a shape of the last bake, if it exists.
    fn glb(&self, shape: &str) -> Arc<[u8]> {
        // Held meanwhile: simultaneous requests wait.
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((of, bytes)) = &*made
            && of == shape
        {
            return Arc::clone(bytes);
        }
        let baked = self.baked.lock().unwrap_or_else(PoisonError::into_inner);
        let found = baked.iter().position(|s| s.name == shape).map(|k| Shape {
            displacement: shown(&baked, k),
            ..baked[k].clone()
        });
        drop(baked);
        let mut glb = morphs::build(&self.drawn, found.as_slice(), 1.0, false, None);
        // Eyes and teeth are lighter than skin.
        if self.source.looks.is_empty()
            && let Some(other) = glb.json["materials"].get_mut(1)
        {
            other["pbrMetallicRoughness"]["baseColorFactor"] = json!([0.9, 0.92, 0.95, 1.0]);
        }
        self.source.looks.paint(&mut glb);
        let bytes: Arc<[u8]> = glb.emit().into();
        *made = Some((shape.to_owned(), Arc::clone(&bytes)));
        bytes
    }

    /// Executes a POST of the page.
    fn change(&self, request: &Request) -> Result<Value, String> {
        let parameter = |name| request.parameter(name);
        let points = numbers::<u64>(parameter("points"));
        let points = points
            .filter(|p| p.len() == LANDMARKS && p.iter().all(|&v| self.surface.is_skin(v)))
            .ok_or("expected 68 skin vertices; reload the page")?;
        match request.path {
            "/move" => {
                let (k, mirror) = point(request)?;
                let ray = vectors(parameter("ray"));
                let [from, along] = ray.ok_or("expected a ray of six numbers")?;
                if along.norm() == 0.0 {
                    return Err("expected a ray with a direction".into());
                }
                let ray = Ray { from, along };
                Ok(self.points_json(&self.surface.moved(&points, k, &ray, mirror)))
            }
            "/step" => {
                let (k, mirror) = point(request)?;
                let both = format!("{},{}", parameter("sight"), parameter("towards"));
                let both = vectors(&both).filter(|both| both.iter().all(|v| v.norm() > 0.0));
                let both = both.ok_or("expected the lines of sight and of the step")?;
                Ok(self.points_json(&self.surface.stepped(&points, k, both, mirror)))
            }
            "/bake" => {
                let set = numbers::<usize>(parameter("hand")).unwrap_or_default();
                let guessed = self.guessed(&points, &set);
                if guessed > 0 {
                    return Err(waits_for(guessed));
                }
                let seconds = self.bake(&points).map_err(|error| error.to_string())?;
                let baked = self.baked.lock().unwrap_or_else(PoisonError::into_inner);
                let names: Vec<&str> = baked.iter().map(|s| s.name.as_str()).collect();
                let said = format!("{} shapes baked in {seconds:.1} s", names.len());
                Ok(json!({"said": said, "shapes": names}))
            }
            "/save" => {
                let text = landmark_text(&points, self.source.imported.as_ref());
                files::write(&self.out, text.as_bytes()).map_err(|error| error.to_string())?;
                Ok(json!({"said": format!("saved {}", self.out.display())}))
            }
            _ => Err("no such command".into()),
        }
    }
}

/// The message while points are unconfirmed.
fn waits_for(guessed: usize) -> String {
    match guessed {
        1 => "not baked: 1 point was found with low confidence; move it, or press Confirm if it is right".into(),
        n => format!("not baked: {n} points were found with low confidence; move or confirm each of them"),
    }
}

/// The landmark of a request, and whether its mirror partner follows.
fn point(request: &Request) -> Result<(usize, bool), String> {
    let k = request.parameter("point").parse().ok();
    let k = k.filter(|&k| k < LANDMARKS);
    let k = k.ok_or("expected a point from 0 to 67")?;
    Ok((k, request.parameter("mirror") == "1"))
}

/// Two vectors of finite numbers.
fn vectors(text: &str) -> Option<[Vec3; 2]> {
    let all = numbers::<f64>(text).filter(|all| all.iter().all(|x| x.is_finite()))?;
    let &[x, y, z, a, b, c] = &*all else {
        return None;
    };
    Some([Vec3::new(x, y, z), Vec3::new(a, b, c)])
}

/// Comma-separated numbers; commas may be percent-encoded.
fn numbers<T: std::str::FromStr>(text: &str) -> Option<Vec<T>> {
    let text = text.replace("%2C", ",");
    text.split(',').map(|word| word.parse().ok()).collect()
}

/// The mesh with a second material for parts other than skin.
fn in_two_colours(mesh: &Mesh, surface: &Surface) -> Mesh {
    let mut drawn = mesh.clone();
    drawn.materials = vec!["skin".into(), "other".into()];
    for f in 0..mesh.faces() {
        let of_skin = mesh.face(f).first();
        let of_skin = of_skin.is_some_and(|c| surface.is_skin(u64::from(c.vertex)));
        drawn.face_material[f] = u32::from(!of_skin);
    }
    drawn
}

impl Site for LandmarkEditor {
    fn answer(&self, request: &Request) -> Answer {
        if request.post {
            return Answer::json(&match self.change(request) {
                Ok(mut done) => {
                    done["ok"] = json!(true);
                    done
                }
                Err(said) => json!({"ok": false, "said": said}),
            });
        }
        let shared = preview::PAGE.iter();
        let shared = shared.filter(|file| SHARED_FILES.contains(&file.0));
        if let Some(file) = Answer::page_file(PAGE.iter().chain(shared), request.path) {
            return file;
        }
        match request.path {
            "/start.json" => Answer::json(&self.start()),
            "/head.glb" => Answer::File("model/gltf-binary", self.glb(request.parameter("shape"))),
            _ => Answer::Refused(404, "no such file; the page is at /\n"),
        }
    }
}

/// Serves the page until the process ends; `say` gets a line once it can be opened.
///
/// # Errors
/// If the head or its points cannot be read, or the port is taken.
pub fn run(args: Args, say: &mut dyn FnMut(&str)) -> Result<(), Fault> {
    let place = Arc::new(LandmarkEditor::new(&args.mesh, &args.landmarks, args.out)?);
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.port));
    let (listener, page) = http::listen(address)?;
    let (name, out) = (&place.name, place.out.display());
    say(&format!(
        "open http://{page}/ (points on {name}; Save writes {out}; Ctrl-C ends)"
    ));
    http::serve(&listener, &place);
    Ok(())
}
