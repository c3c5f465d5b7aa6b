//! `mien-studio place`: a page for placing the 68 landmarks on a neutral head, with a preview of the resulting shapes.
//!
//! ```text
//! page (drags, undoes) ─► move: a ray to the vertex there (surface) ─► bake ─► the head with one shape ─► save
//! ```
//! The page holds the points and sends all of them with whatever it asks; here are the mesh, what was baked last, and the file.
//! Server, viewer and reader of glTF are those of [`super::preview`]. Served on the loopback interface only, since it
//! writes a file. Units and frame: the mesh's.

pub mod surface;

use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use serde_json::{Value, json};

use super::preview;
use super::preview::http::{self, Answer, Request as Asked, Site};
use mien_baking::bake::head::{Head, apart, miscounted};
use mien_baking::bake::locate::LOW;
use mien_baking::bake::mesh::{Mesh, Vec3};
use mien_baking::bake::names::{LANDMARKS, NAMES, mirrored};
use mien_baking::bake::order::Ordered;
use mien_baking::bake::shape::{Shape, shown};
use mien_baking::bake::source::{Source, landmark_text};
use mien_baking::bake::{files, morphs};
use mien_baking::heads::default_head;
use mien_workbench::atomic_write;
use mien_workbench::fault::Fault;
use mien_workbench::text_files::name_of;
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

/// The files of the page that are not the preview's.
const PAGE: [(&str, &str); 3] = [
    ("/", include_str!("page/index.html")),
    ("/place.css", include_str!("page/place.css")),
    ("/place.js", include_str!("page/place.js")),
];
/// Those that are.
const SHARED: [&str; 5] = [
    "/look.css",
    "/style.css",
    "/head.js",
    "/glb.js",
    "/matrix.js",
];

/// A head and its points, served.
pub struct Place {
    source: Source,
    /// The mesh again, its skin apart from eyes and teeth by colour.
    drawn: Mesh,
    ordered: Ordered,
    surface: Surface,
    /// The points to begin with.
    points: Vec<u64>,
    /// Of each point, if they were found.
    confidence: Option<Vec<f32>>,
    name: String,
    out: PathBuf,
    /// The shapes of the last bake.
    baked: Mutex<Vec<Shape>>,
    /// The file asked for last, and of which shape: everybody who asks for the same gets the same bytes.
    made: Mutex<Option<(String, Arc<[u8]>)>>,
    /// Held while shapes are baked: one at a time.
    baking: Mutex<()>,
}

/// Where points are saved beside a mesh: not over a file that is there, unless it is the one that they came from.
fn beside(mesh: &Path, landmarks: &Path) -> PathBuf {
    let name = mesh.with_extension("landmarks.txt");
    if name == landmarks {
        return name;
    }
    atomic_write::unused(&name)
}

impl Place {
    /// Reads a head and the points to begin with; `landmarks` is their file, or `auto`.
    ///
    /// # Errors
    /// If one cannot be read or the points are not on the head.
    pub fn new(mesh: &Path, landmarks: &Path, out: Option<PathBuf>) -> Result<Self, Fault> {
        let source = Source::read(mesh)?;
        let (points, confidence) = if landmarks.as_os_str() == "auto" {
            let found = source.guess(mesh)?;
            (found.vertices, Some(found.of_points.to_vec()))
        } else {
            (source.told(landmarks)?, None)
        };
        let ordered = Ordered::new(&source.mesh);
        // Said as bake would say it.
        ordered.landmarks(&points)?;
        if points.len() != LANDMARKS {
            return Err(miscounted(points.len()));
        }
        let surface = Surface::new(&source.mesh, &ordered, points[8]);
        if let Some(landmark) = points.iter().position(|&v| !surface.is_skin(v)) {
            return Err(apart(landmark));
        }
        Ok(Self {
            drawn: match source.looks.is_empty() {
                true => in_two_colours(&source.mesh, &surface),
                false => source.mesh.clone(),
            },
            name: name_of(mesh),
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

    /// Vertices of the mesh, their places and normals, as the page takes them.
    fn points_json(&self, points: &[u64]) -> Value {
        let all = points.iter().map(|&v| self.surface.position_and_normal(v));
        let rows = all.map(|(p, n)| (<[f64; 3]>::from(p), <[f64; 3]>::from(n)));
        let (places, normals): (Vec<_>, Vec<_>) = rows.unzip();
        json!({"points": points, "places": places, "normals": normals})
    }

    /// What the page knows at its start.
    fn start(&self) -> Value {
        let mut start = self.points_json(&self.points);
        let partners: Vec<usize> = (0..LANDMARKS).map(mirrored).collect();
        start["name"] = json!(self.name);
        start["names"] = json!(&NAMES[..LANDMARKS]);
        start["partners"] = json!(partners);
        start["confidence"] = json!(self.confidence);
        start["low"] = json!(LOW);
        start["out"] = json!(self.out.display().to_string());
        start["exists"] = json!(self.out.exists());
        start["symmetric"] = json!(self.surface.is_symmetric());
        start
    }

    /// How many points are where they were found with little confidence, and not set by hand.
    fn guessed(&self, points: &[u64], set: &[usize]) -> usize {
        let is_low = |k: usize| self.confidence.as_ref().is_some_and(|sure| sure[k] < LOW);
        let is_guessed =
            |k: &usize| is_low(*k) && points[*k] == self.points[*k] && !set.contains(k);
        (0..LANDMARKS).filter(is_guessed).count()
    }

    /// Bakes all shapes with these points; how long it took, seconds.
    ///
    /// # Errors
    /// If the points describe no face.
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

    /// The head in the mesh's unit, with a shape of the last bake if there is one of that name.
    fn glb(&self, shape: &str) -> Arc<[u8]> {
        // Held while it is made: who asks at the same time waits for it.
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
        if self.source.looks.is_empty() {
            // Eyes and teeth lighter than skin, where there are any.
            if let Some(other) = glb.json["materials"].get_mut(1) {
                other["pbrMetallicRoughness"]["baseColorFactor"] = json!([0.9, 0.92, 0.95, 1.0]);
            }
        }
        self.source.looks.paint(&mut glb);
        let bytes: Arc<[u8]> = glb.emit().into();
        *made = Some((shape.to_owned(), Arc::clone(&bytes)));
        bytes
    }

    /// Something the page lets be done.
    fn change(&self, asked: &Asked) -> Result<Value, String> {
        let word = |name| asked.word(name);
        let points = numbers::<u64>(word("points"));
        let points = points
            .filter(|p| p.len() == LANDMARKS && p.iter().all(|&v| self.surface.is_skin(v)))
            .ok_or("expected 68 skin vertices; reload the page")?;
        match &*asked.path {
            "/move" => {
                let (k, mirror) = point(asked)?;
                let [from, along] = vectors(word("ray")).ok_or("expected a ray of six numbers")?;
                if along.norm() == 0.0 {
                    return Err("expected a ray with a direction".into());
                }
                let ray = Ray { from, along };
                Ok(self.points_json(&self.surface.moved(&points, k, &ray, mirror)))
            }
            "/step" => {
                let (k, mirror) = point(asked)?;
                let both = format!("{},{}", word("sight"), word("towards"));
                let both = vectors(&both).filter(|both| both.iter().all(|v| v.norm() > 0.0));
                let both = both.ok_or("expected the lines of sight and of the step")?;
                Ok(self.points_json(&self.surface.stepped(&points, k, both, mirror)))
            }
            "/bake" => {
                let set = numbers::<usize>(word("hand")).unwrap_or_default();
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
                let text = landmark_text(&points, self.source.foreign.as_ref());
                files::write(&self.out, text.as_bytes()).map_err(|error| error.to_string())?;
                Ok(json!({"said": format!("saved {}", self.out.display())}))
            }
            _ => Err("no such command".into()),
        }
    }
}

/// Why nothing is baked while points are unsure.
fn waits_for(guessed: usize) -> String {
    match guessed {
        1 => "not baked: 1 point was found with low confidence; move it, or press Confirm if it is right".into(),
        n => format!("not baked: {n} points were found with low confidence; move or confirm each of them"),
    }
}

/// The landmark that is meant, and whether its partner follows.
fn point(asked: &Asked) -> Result<(usize, bool), String> {
    let k = asked.word("point").parse().ok().filter(|&k| k < LANDMARKS);
    let k = k.ok_or("expected a point from 0 to 67")?;
    Ok((k, asked.word("mirror") == "1"))
}

/// Two vectors of finite numbers.
fn vectors(text: &str) -> Option<[Vec3; 2]> {
    let all = numbers::<f64>(text).filter(|all| all.iter().all(|x| x.is_finite()))?;
    let &[x, y, z, a, b, c] = &*all else {
        return None;
    };
    Some([Vec3::new(x, y, z), Vec3::new(a, b, c)])
}

/// Numbers between commas, which may be escaped.
fn numbers<T: std::str::FromStr>(text: &str) -> Option<Vec<T>> {
    let text = text.replace("%2C", ",");
    text.split(',').map(|word| word.parse().ok()).collect()
}

/// The mesh with what is not skin as a material of its own.
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

impl Site for Place {
    fn answer(&self, asked: &Asked) -> Answer {
        if asked.post {
            return Answer::json(&match self.change(asked) {
                Ok(mut done) => {
                    done["ok"] = json!(true);
                    done
                }
                Err(said) => json!({"ok": false, "said": said}),
            });
        }
        let shared = preview::PAGE.iter().filter(|file| SHARED.contains(&file.0));
        if let Some(file) = Answer::page_file(PAGE.iter().chain(shared), &asked.path) {
            return file;
        }
        match &*asked.path {
            "/start.json" => Answer::json(&self.start()),
            "/head.glb" => Answer::File("model/gltf-binary", self.glb(asked.word("shape"))),
            _ => Answer::Missing("no such file; the page is at /\n"),
        }
    }
}

/// Serves the page until the process ends; `say` gets a line once it can be opened.
///
/// # Errors
/// If the head or its points cannot be read, or the port is taken.
pub fn run(args: Args, say: &mut dyn FnMut(&str)) -> Result<(), Fault> {
    let place = Arc::new(Place::new(&args.mesh, &args.landmarks, args.out)?);
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.port));
    let (listener, page) = http::listen(address)?;
    let (name, out) = (&place.name, place.out.display());
    say(&format!(
        "open http://{page}/ (points on {name}; Save writes {out}; Ctrl-C ends)"
    ));
    http::serve(&listener, &place);
    Ok(())
}
