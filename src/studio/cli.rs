//! The command line of the workstation: words to calls.
//! One file: the whole grammar of the program, with the texts of its help.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use lexopt::prelude::*;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;

use super::fit::{self, FitArgs};
use super::heads::average::make_simulated_head;
use super::inspect::inspect;
use super::nrsfm::{self, Tracks};
use super::place;
use super::preview;
use super::record;
use super::stopped::{self, Goes};
use super::train::{self, TrainArgs, TrainError, finish, train, train_paper_into, train_person};
use super::{animate, bake};
use crate::appliance::service::{self, NoKinect};
use crate::studio::atomic_write;
use crate::studio::evaluate;
use crate::studio::evaluate::figures;
use crate::studio::evaluate::head_scenes;
use crate::studio::evaluate::head_scenes::wild;
use crate::studio::evaluate::landmark_accuracy;
use crate::studio::evaluate::sessions::{self, Sessions};
use crate::studio::heads::{default_head, hero};
use crate::studio::people_split::Split;
use crate::studio::units::readings;

/// One command: its name, what it takes, what it does.
pub(super) struct Command {
    pub(super) name: &'static str,
    pub(super) usage: &'static str,
    pub(super) about: &'static str,
    pub(super) example: &'static str,
    /// Options that take a value.
    pub(super) options: &'static [&'static str],
    /// Options that stand alone.
    pub(super) flags: &'static [&'static str],
    /// Words without an option, at most.
    pub(super) words: usize,
    run: fn(&Words) -> Result<(), Fault>,
}

pub(super) const COMMANDS: &[Command] = &[
    Command {
        name: "train",
        usage: "--images DIR... --out FILE [--tracks FILE] [--offsets FILE] [--data DIR] [--drawn N] [--starts N] [--seed N] [--refine MODEL] [--no-paper | --paper-of MODEL] [--hold-out-dev] | --paper-into MODEL --out FILE [--tracks FILE] [--data DIR] [--seed N] | --person SESSION --out FILE [--paper-into MODEL] [--seed N]",
        about: "trains the face model (shape, appearance, confidence) and writes it to one file; prints the error on held-out people; with --paper-into only the paper's own model, replaced in a model file that otherwise stays unchanged; with --person a model of the one person in a recording, who must go through all expressions there",
        example: "mien-studio train --images ../shared/data/faces_frl189 --out face.model",
        options: &[
            "images",
            "out",
            "tracks",
            "offsets",
            "data",
            "drawn",
            "starts",
            "seed",
            "refine",
            "paper-of",
            "paper-into",
            "person",
        ],
        flags: &["no-paper", "hold-out-dev"],
        words: 0,
        run: run_train,
    },
    Command {
        name: "fit",
        usage: "--images DIR --out FILE.csv [--model FILE] [--box x,y,w,h | --boxes FILE.csv] [--offsets FILE] [--pictures DIR]",
        about: "fits landmarks to still pictures; reports the error if they are annotated",
        example: "mien-studio fit --images ../shared/data/faces_ytfaces68 --out points.csv",
        options: &[
            "images", "out", "model", "box", "boxes", "offsets", "pictures",
        ],
        flags: &[],
        words: 0,
        run: run_fit,
    },
    Command {
        name: "inspect",
        usage: "PATH [--out FILE.html|FILE.png] [--config FILE] [--model FILE]",
        about: "shows a recording, a model, the CSV of a run or a mesh as pictures and plots; an HTML page plays the recording",
        example: "mien-studio inspect session --out session.html",
        options: &["out", "config", "model"],
        flags: &[],
        words: 1,
        run: run_inspect,
    },
    Command {
        name: "simulated-head",
        usage: "--out FILE [--data DIR]",
        about: "rebuilds the simulated sensor's built-in head from the training people",
        example: "mien-studio simulated-head --out config/simulated.head",
        options: &["out", "data"],
        flags: &[],
        words: 0,
        run: run_simulated_head,
    },
    Command {
        name: "record",
        usage: "--out DIR [--seconds N] [--source S]",
        about: "records from the sensor or the simulator",
        example: "mien-studio record --source simulated --seconds 10 --out session",
        options: &["out", "seconds", "source"],
        flags: &[],
        words: 0,
        run: run_record,
    },
    Command {
        name: "evaluate",
        usage: "[--landmarks] [--data DIR] [--model FILE] [--config FILE] [--people N] [--seconds N] [--split test|dev|train] [--seed N] [--heads [--rows NAME,...] | --wild [--pictures DIR] | --figures DIR [--rows NAME,...]]",
        about: "runs rendered sessions of held-out people through the whole pipeline and prints one table; with --landmarks the face model alone under every condition; with --heads scenes of one or several heads, hands and rooms; with --wild people with hair, clothes and accessories in front of a sensor with realistic faults; with --figures the figures of docs/paper.md, the paper's system next to the default",
        example: "mien-studio evaluate --data ../shared/data --people 19 --seconds 45",
        options: &[
            "data", "model", "config", "people", "seconds", "split", "seed", "rows", "pictures",
            "figures",
        ],
        flags: &["landmarks", "heads", "wild"],
        words: 0,
        run: run_evaluate,
    },
    Command {
        name: "units",
        usage: "[--data DIR] [--model FILE] [--config FILE] [--people N] [--seconds N] [--seed N] [--examples FILE] [--out FILE]",
        about: "learns how each unit is computed from all measures together: the [[feature]] and [[reading]] tables of config/units.toml",
        example: "mien-studio units --data ../shared/data --out readings.toml",
        options: &[
            "data", "model", "config", "people", "seconds", "seed", "examples", "out",
        ],
        flags: &[],
        words: 0,
        run: run_units,
    },
    Command {
        name: "nrsfm",
        usage: "--tracks FILE.csv [--rank K] --out FILE.csv [--truth FILE.csv]",
        about: "recovers moving 3D shapes from 2D tracks; reports the error if the ground truth is given",
        example: "mien-studio nrsfm --tracks shark_W.csv --out shapes.csv --truth shark_S.csv",
        options: &["tracks", "rank", "out", "truth"],
        flags: &[],
        words: 0,
        run: run_nrsfm,
    },
    Command {
        name: "bake",
        usage: "--mesh FILE.obj|FILE.glb --landmarks FILE|auto --out FILE.glb|FILE.usda [--recipe FILE.toml] [--controls FILE.csv] [--method aoi|paper|laplacian] [--derive-controls] [--correctives] [--unit mm|cm|m] [--dense] [--obj DIR] [--report FILE.html]",
        about: "bakes 67 blendshapes onto a neutral head",
        example: "mien-studio bake --mesh head.obj --landmarks head68.txt --out head.glb --report head.html",
        options: &[
            "mesh",
            "landmarks",
            "out",
            "recipe",
            "controls",
            "method",
            "unit",
            "obj",
            "report",
        ],
        flags: &["derive-controls", "correctives", "dense"],
        words: 0,
        run: run_bake,
    },
    Command {
        name: "place",
        usage: "--mesh FILE.obj|FILE.glb [--landmarks FILE|auto] [--out FILE] [--port N]",
        about: "serves a web page for dragging the 68 landmarks into place on a neutral head, with a preview of the resulting shapes",
        example: "mien-studio place --mesh head.obj --out head68.txt",
        options: &["mesh", "landmarks", "out", "port"],
        flags: &[],
        words: 0,
        run: run_place,
    },
    Command {
        name: "head",
        usage: "--out FILE.glb|FILE.obj | --make FILE [--data DIR]",
        about: "writes a coloured head to experiment with, and its landmarks in a .txt beside it: baked with 67 shapes and a neck that stays still (.glb), or neutral with its materials (.obj); with --make rebuilds the data the program makes it from",
        example: "mien-studio head --out head.obj",
        options: &["out", "make", "data"],
        flags: &[],
        words: 0,
        run: run_head,
    },
    Command {
        name: "preview",
        usage: "[--osc PORT | --serial PORT | --csv FILE | --source S] [--config FILE] [--box ADDRESS:PORT] [--mesh FILE.glb...] [--port N]",
        about: "serves a web page: the animated head, the units, their ranges, curves, pose and state",
        example: "mien-studio preview --csv run.csv --mesh head.glb",
        options: &[
            "osc", "serial", "baud", "full", "csv", "source", "model", "config", "box", "mesh",
            "port",
        ],
        flags: &[],
        words: 0,
        run: run_preview,
    },
    Command {
        name: "skin",
        usage: "--out FILE [--data DIR]",
        about: "learns from sculpted shapes how skin moves, for bake; reports the error on held-out shapes",
        example: "mien-studio skin --out config/skin.prior",
        options: &["out", "data"],
        flags: &[],
        words: 0,
        run: run_skin,
    },
    Command {
        name: "animate",
        usage: "--mesh FILE.glb --csv FILE --out FILE.glb [--user N]",
        about: "exports the weights of a run as a glTF animation",
        example: "mien-studio animate --mesh head.glb --csv run.csv --out acted.glb",
        options: &["mesh", "csv", "out", "user"],
        flags: &[],
        words: 0,
        run: run_animate,
    },
];

/// What `--help` of a command says beyond its line.
const OPTIONS: [(&str, &str); 10] = [
    ("train", train::OPTIONS),
    ("fit", fit::OPTIONS),
    ("record", record::OPTIONS),
    ("evaluate", evaluate::OPTIONS),
    ("units", readings::OPTIONS),
    ("preview", preview::OPTIONS),
    ("bake", bake::request::OPTIONS),
    ("place", place::OPTIONS),
    ("animate", animate::OPTIONS),
    ("nrsfm", nrsfm::OPTIONS),
];

impl Command {
    /// Its options, one or more lines each; empty if `usage` says enough.
    pub(super) fn details(&self) -> &'static str {
        let found = OPTIONS.iter().find(|(name, _)| *name == self.name);
        found.map_or("", |(_, text)| text)
    }
}

/// What the program is.
pub(super) const ABOUT: &str = "the workstation tool of mien: trains face models, bakes blendshapes, records, inspects and previews";

/// Why a command failed, and with which exit code.
#[derive(Debug)]
pub enum Fault {
    /// Wrong words: exit code 64.
    Usage(String),
    /// Anything else.
    Failed {
        /// The sentence.
        text: String,
        /// The code.
        code: u8,
    },
}

impl<E: std::error::Error> From<E> for Fault {
    fn from(error: E) -> Self {
        Self::Failed {
            text: error.to_string(),
            code: 1,
        }
    }
}

fn service_fault(failure: &service::Failure) -> Fault {
    Fault::Failed {
        text: failure.to_string(),
        code: failure.exit_code(),
    }
}

/// The words of one invocation.
#[derive(Default)]
struct Words {
    options: BTreeMap<&'static str, Vec<OsString>>,
    free: Vec<OsString>,
}

impl Words {
    fn parse(command: &Command, parser: &mut lexopt::Parser) -> Result<Option<Self>, Fault> {
        let usage = |error: lexopt::Error| Fault::Usage(error.to_string());
        let mut words = Self::default();
        while let Some(word) = parser.next().map_err(usage)? {
            match word {
                Long("help") | Short('h') => return Ok(None),
                Long(name) => {
                    if let Some(&name) = command.options.iter().find(|&&known| known == name) {
                        let values = words.options.entry(name).or_default();
                        values.extend(parser.values().map_err(usage)?);
                    } else if let Some(&name) = command.flags.iter().find(|&&known| known == name) {
                        words.options.entry(name).or_default();
                    } else {
                        return Err(usage(word.unexpected()));
                    }
                }
                Value(free) if words.free.len() < command.words => words.free.push(free),
                other => return Err(usage(other.unexpected())),
            }
        }
        Ok(Some(words))
    }

    fn path(&self, name: &str) -> Option<PathBuf> {
        self.options
            .get(name)
            .and_then(|values| values.last())
            .map(PathBuf::from)
    }

    fn paths(&self, name: &str) -> Result<Vec<PathBuf>, Fault> {
        let values = self
            .options
            .get(name)
            .ok_or_else(|| Fault::Usage(format!("--{name} is missing")))?;
        Ok(values.iter().map(PathBuf::from).collect())
    }

    fn flag(&self, name: &str) -> bool {
        self.options.contains_key(name)
    }

    fn required(&self, name: &str) -> Result<PathBuf, Fault> {
        self.path(name)
            .ok_or_else(|| Fault::Usage(format!("--{name} is missing")))
    }

    fn value<T: FromStr>(&self, name: &str) -> Result<Option<T>, Fault> {
        let Some(word) = self.options.get(name).and_then(|values| values.last()) else {
            return Ok(None);
        };
        let parsed = word.to_str().and_then(|word| word.parse().ok());
        parsed.map(Some).ok_or_else(|| {
            Fault::Usage(format!(
                "--{name} {} is not a valid value",
                word.to_string_lossy()
            ))
        })
    }
}

/// Runs one invocation; the words after the program's name.
///
/// # Errors
/// [`Fault::Usage`] on wrong words, else what the command says.
#[expect(clippy::print_stdout, reason = "help is asked for")]
pub fn run(words: impl IntoIterator<Item = OsString>) -> Result<(), Fault> {
    let mut parser = lexopt::Parser::from_args(words);
    let first = parser
        .next()
        .map_err(|error| Fault::Usage(error.to_string()))?;
    let name = match first {
        None | Some(Long("help") | Short('h')) => {
            print!("{}", help());
            return Ok(());
        }
        Some(Long("version") | Short('V')) => {
            println!("mien-studio {}", env!("CARGO_PKG_VERSION"));
            return Ok(());
        }
        Some(Value(word)) => word.to_string_lossy().into_owned(),
        Some(other) => return Err(Fault::Usage(other.unexpected().to_string())),
    };
    if name == "help" {
        print!("{}", help());
        return Ok(());
    }
    let Some(command) = COMMANDS.iter().find(|command| command.name == name) else {
        return Err(Fault::Usage(format!("unknown command {name:?}")));
    };
    match Words::parse(command, &mut parser)? {
        Some(words) => (command.run)(&words),
        None => {
            println!(
                "mien-studio {} {}\n  {}\n{}Example: {}",
                command.name,
                command.usage,
                command.about,
                command.details(),
                command.example
            );
            Ok(())
        }
    }
}

fn help() -> String {
    let mut text = format!("mien-studio - {ABOUT}\n\n");
    for command in COMMANDS {
        text += &format!(
            "mien-studio {} {}\n    {}\n",
            command.name, command.usage, command.about
        );
    }
    text += "\nEvery command has --help with an example.\n";
    text
}

/// The data sets: `--data`, else `MIEN_DATA`, else `../shared/data`.
fn data(words: &Words) -> PathBuf {
    words
        .path("data")
        .or_else(|| std::env::var_os("MIEN_DATA").map(PathBuf::from))
        .unwrap_or_else(|| Path::new("../shared/data").to_path_buf())
}

/// What the first Ctrl-C sets; the second ends the program at once.
fn stop_on_signals() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        // Without them a signal ends the program at once, as it does elsewhere.
        let _ = flag::register_conditional_shutdown(signal, 1, Arc::clone(&stop));
        let _ = flag::register(signal, Arc::clone(&stop));
    }
    stop
}

#[expect(clippy::print_stdout, reason = "the command's output")]
fn run_record(words: &Words) -> Result<(), Fault> {
    let out = words.required("out")?;
    let name = words
        .value::<String>("source")?
        .unwrap_or_else(|| "kinect".into());
    let seconds = words.value("seconds")?.unwrap_or(10.0);
    let mut source = service::open(&name, NoKinect::Simulate, Default::default())
        .map_err(|failure| service_fault(&failure))?;
    let now = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .map_or(0.0, |since| since.as_secs_f64());
    let stop = stop_on_signals();
    let done = record::record(&mut source, &out, seconds, now, &stop)?;
    println!("{} frames in {}", done.frames, out.display());
    eprintln!(
        "{}{:.1} s at {:.1} Hz, {:.1} MB{}",
        if done.stopped { "stopped: " } else { "" },
        done.seconds,
        done.rate_hz(),
        done.bytes as f64 / 1e6,
        if done.stopped {
            "; the recording so far is kept and can be played"
        } else {
            ""
        },
    );
    Ok(())
}

#[expect(clippy::print_stdout, reason = "the command's output")]
fn run_evaluate(words: &Words) -> Result<(), Fault> {
    let defaults = Sessions::default();
    let sessions = Sessions {
        people: words.value("people")?.unwrap_or(defaults.people),
        seconds: words.value("seconds")?.unwrap_or(defaults.seconds),
        seed: words.value("seed")?.unwrap_or(defaults.seed),
        split: match words.value::<String>("split")?.as_deref() {
            None | Some("test") => Split::Test,
            Some("dev") => Split::Dev,
            Some("train") => Split::Train,
            Some(other) => {
                return Err(Fault::Usage(format!(
                    "--split {other} is not test, dev or train"
                )));
            }
        },
    };
    let settings = service::settings(words.path("config").as_deref())
        .map_err(|failure| service_fault(&failure))?;
    let model = service::model(words.path("model").as_deref())
        .map_err(|failure| service_fault(&failure))?;
    let folder = words.path("figures").or_else(|| words.path("pictures"));
    stopped::tell(folder.map_or(Goes::Printed, Goes::Pictures));
    if words.flag("landmarks") {
        // Five seconds show every condition unless more is asked for.
        let seconds = words.value("seconds")?.unwrap_or(5.0);
        let sessions = Sessions {
            seconds,
            ..sessions
        };
        landmark_accuracy::measure(&data(words), &model, &settings, &sessions, &mut say)?;
        return Ok(());
    }
    if let Some(folder) = words.path("figures") {
        let length = (
            words.value("people")?.unwrap_or(1),
            words.value("seconds")?.unwrap_or(20.0),
        );
        let only = rows(words, &figures::FIGURES)?;
        let data = data(words);
        figures::draw(&data, &model, &settings, length, &folder, &only, &mut say)?;
        return Ok(());
    }
    if words.flag("heads") {
        let rows = rows(words, &head_scenes::ROWS)?;
        let sessions = Sessions {
            people: words.value("people")?.unwrap_or(head_scenes::PEOPLE),
            seconds: words.value("seconds")?.unwrap_or(head_scenes::SECONDS),
            ..sessions
        };
        print!(
            "{}",
            head_scenes::play(&data(words), &model, &settings, &sessions, &rows)?
        );
        return Ok(());
    }
    if words.flag("wild") {
        let sessions = Sessions {
            seconds: words.value("seconds")?.unwrap_or(wild::SECONDS),
            ..sessions
        };
        let pictures = words.path("pictures");
        let table = wild::play(
            &data(words),
            &model,
            &settings,
            &sessions,
            pictures.as_deref(),
        )?;
        print!("{table}");
        return Ok(());
    }
    print!(
        "{}",
        sessions::play(&data(words), &model, &settings, &sessions)?
    );
    Ok(())
}

/// What `--rows` chooses of these; all if it is not given.
fn rows(words: &Words, names: &[&str]) -> Result<Vec<String>, Fault> {
    let rows = words.value::<String>("rows")?;
    let rows: Vec<String> = rows.map_or_else(Vec::new, |rows| {
        rows.split(',').map(str::to_owned).collect()
    });
    match rows.iter().find(|row| !names.contains(&row.as_str())) {
        Some(unknown) => Err(Fault::Usage(format!(
            "--rows {unknown} is not one of {}",
            names.join(", ")
        ))),
        None => Ok(rows),
    }
}

#[expect(clippy::print_stdout, reason = "the command's output")]
fn run_units(words: &Words) -> Result<(), Fault> {
    let defaults = readings::Practice::default();
    let practice = readings::Practice {
        people: words.value("people")?.unwrap_or(defaults.people),
        seconds: words.value("seconds")?.unwrap_or(defaults.seconds),
        seed: words.value("seed")?.unwrap_or(defaults.seed),
        examples: words.path("examples"),
    };
    let settings = service::settings(words.path("config").as_deref())
        .map_err(|failure| service_fault(&failure))?;
    let model = service::model(words.path("model").as_deref())
        .map_err(|failure| service_fault(&failure))?;
    stopped::tell(words.path("out").map_or(Goes::Printed, Goes::File));
    let mut progress = |line: &str| eprintln!("{line}");
    let text = readings::learn(&data(words), &model, &settings, &practice, &mut progress)?;
    match words.path("out") {
        Some(out) => atomic_write::write(&out, text)
            .map_err(|source| TrainError::Unwritable { path: out, source })?,
        None => print!("{text}"),
    }
    Ok(())
}

#[expect(clippy::print_stdout, reason = "the command's output")]
fn say(line: &str) {
    println!("{line}");
}

fn run_train(words: &Words) -> Result<(), Fault> {
    stopped::tell(Goes::File(words.required("out")?));
    let defaults = TrainArgs::default();
    let tracks = words
        .path("tracks")
        .map(|path| Tracks::read(&path))
        .transpose()?;
    let into = words.path("paper-into");
    let session = words.path("person");
    let args = TrainArgs {
        images: match into.as_ref().or(session.as_ref()) {
            Some(_) => Vec::new(),
            None => words.paths("images")?,
        },
        data: data(words),
        out: words.required("out")?,
        offsets: words.path("offsets"),
        tracks,
        drawn: words.value("drawn")?.unwrap_or(defaults.drawn),
        starts: words.value("starts")?.unwrap_or(defaults.starts),
        seed: words.value("seed")?.unwrap_or(defaults.seed),
        paper_pictures: if words.flag("no-paper") {
            0
        } else {
            defaults.paper_pictures
        },
        paper_aam: words
            .path("paper-of")
            .map(|path| service::model(Some(&path)))
            .transpose()
            .map_err(|failure| service_fault(&failure))?
            .map(|model| model.paper_aam),
        hold_out_dev: words.flag("hold-out-dev"),
        ..defaults
    };
    if let Some(session) = session {
        train_person(&args, &session, into.as_ref(), &mut say)?;
    } else if let Some(path) = into {
        train_paper_into(&args, &path, &mut say)?;
    } else if let Some(path) = words.path("refine") {
        let model = service::model(Some(&path)).map_err(|failure| service_fault(&failure))?;
        finish(&args, model, &mut say)?;
    } else {
        train(&args, &mut say)?;
    }
    Ok(())
}

fn run_fit(words: &Words) -> Result<(), Fault> {
    let face_box = words.value::<String>("box")?;
    let face_box = face_box.map(|text| {
        fit::parse_box(&text)
            .ok_or_else(|| Fault::Usage(format!("--box {text} is not x,y,w,h in pixels")))
    });
    let args = FitArgs {
        model: words.path("model"),
        images: words.required("images")?,
        out: words.required("out")?,
        face_box: face_box.transpose()?,
        boxes: words.path("boxes"),
        offsets: words.path("offsets"),
        pictures: words.path("pictures"),
    };
    stopped::tell(Goes::File(args.out.clone()));
    fit::fit(&args, &mut say)?;
    Ok(())
}

fn run_inspect(words: &Words) -> Result<(), Fault> {
    let path = words
        .free
        .first()
        .map(PathBuf::from)
        .ok_or_else(|| Fault::Usage("a path is missing".into()))?;
    let model = service::model(words.path("model").as_deref())
        .map_err(|failure| service_fault(&failure))?;
    let settings = service::settings(words.path("config").as_deref())
        .map_err(|failure| service_fault(&failure))?;
    let out = inspect(&path, words.path("out").as_deref(), &model, &settings)?;
    say(&format!("wrote {}", out.display()));
    Ok(())
}

fn run_simulated_head(words: &Words) -> Result<(), Fault> {
    let out = words.required("out")?;
    let bytes = make_simulated_head(&data(words), &out, |person| {
        Split::of(person) == Split::Train
    })?;
    say(&format!("wrote {}: {bytes} bytes", out.display()));
    Ok(())
}

fn run_nrsfm(words: &Words) -> Result<(), Fault> {
    let truth = words.path("truth");
    stopped::tell(Goes::File(words.required("out")?));
    nrsfm::run(
        &words.required("tracks")?,
        words.value("rank")?,
        &words.required("out")?,
        truth.as_deref(),
    )
    .map_err(|error| match error {
        nrsfm::Error::Usage { problem } => Fault::Usage(problem),
        other => other.into(),
    })
}

/// A file of ours by its name: binary glTF, the VRM that a head came in or, for `bake`, USD.
fn head_out(words: &Words, endings: &[&str], written: &str) -> Result<PathBuf, Fault> {
    let out: PathBuf = words.required("out")?;
    let ending = out.extension().unwrap_or_default().to_ascii_lowercase();
    if endings.iter().any(|known| ending == *known) {
        return Ok(out);
    }
    Err(Fault::Usage(format!(
        "--out {}: expected a name that ends in .{} ({written})",
        out.display(),
        endings.join(" or .")
    )))
}

fn run_bake(words: &Words) -> Result<(), Fault> {
    let method = words.value::<String>("method")?;
    let unit = words.value::<String>("unit")?;
    let metres = unit.as_deref().map(|unit| {
        bake::request::metres(unit)
            .ok_or_else(|| Fault::Usage(format!("--unit {unit} is not mm, cm or m")))
    });
    let request = bake::request::Request {
        mesh: words.required("mesh")?,
        landmarks: words.required("landmarks")?,
        out: head_out(
            words,
            &["glb", "vrm", "usda"],
            "only binary glTF and text USD are supported; --obj FOLDER also writes every shape as OBJ; \
             FBX and .blend come out of Blender, see docs/baking.md",
        )?,
        recipe: words.path("recipe"),
        controls: words.path("controls"),
        obj: words.path("obj"),
        report: words.path("report"),
        metres: metres.transpose()?,
        method: match method.as_deref() {
            None => bake::rig::Method::default(),
            Some(name) => bake::rig::Method::named(name).ok_or_else(|| {
                Fault::Usage(format!("--method {name} is not aoi, paper or laplacian"))
            })?,
        },
        derive: words.flag("derive-controls"),
        correctives: words.flag("correctives"),
        dense: words.flag("dense"),
    };
    bake::command::run(&request)?;
    Ok(())
}

fn run_place(words: &Words) -> Result<(), Fault> {
    let landmarks = words.path("landmarks").unwrap_or_else(|| "auto".into());
    let port = words.value("port")?.unwrap_or(place::PORT);
    let mesh = words.required("mesh")?;
    place::run(&mesh, &landmarks, words.path("out"), port, &mut say)?;
    Ok(())
}

fn run_skin(words: &Words) -> Result<(), Fault> {
    Ok(bake::command::skin(&data(words), &words.required("out")?)?)
}

fn run_head(words: &Words) -> Result<(), Fault> {
    if let Some(out) = words.path("make") {
        let bytes = hero::make::make(&data(words), &out)?;
        say(&format!("wrote {}: {bytes} bytes", out.display()));
        return Ok(());
    }
    say(&default_head::write_to(&words.required("out")?)?);
    Ok(())
}

fn run_preview(words: &Words) -> Result<(), Fault> {
    let address = |option: &str, default: &str| {
        let word = words.value::<String>(option)?;
        let word = word.as_deref().unwrap_or(default);
        preview::address(word).ok_or_else(|| {
            Fault::Usage(format!(
                "--{option} {word} is not a port or an address:port"
            ))
        })
    };
    let sources = ["osc", "serial", "csv", "source"];
    let given: Vec<&str> = sources
        .into_iter()
        .filter(|name| words.flag(name))
        .collect();
    let feed = match given[..] {
        [] | ["osc"] => preview::Feed::Osc(address("osc", preview::OSC_AT)?),
        ["serial"] => preview::Feed::Serial(preview::serial::Port {
            name: words.value("serial")?.unwrap_or_default(),
            baud: words.value("baud")?.unwrap_or(115_200),
            full: words.value::<u32>("full")?.unwrap_or(100).max(1) as f32,
        }),
        ["csv"] => preview::Feed::Csv(words.required("csv")?),
        ["source"] => preview::Feed::Sensor {
            name: words.value("source")?.unwrap_or_default(),
            model: words.path("model"),
            config: words.path("config"),
        },
        _ => {
            return Err(Fault::Usage(format!(
                "--{} and --{} cannot be shown at once",
                given[0], given[1]
            )));
        }
    };
    let request = preview::Request {
        feed,
        meshes: words.paths("mesh").unwrap_or_default(),
        gains: words.path("config"),
        page: address("port", preview::PAGE_AT)?,
        commands: match words.flag("box") {
            true => Some(address("box", "")?),
            false => None,
        },
    };
    preview::run(&request, &mut say)?;
    Ok(())
}

fn run_animate(words: &Words) -> Result<(), Fault> {
    let user = words.value::<String>("user")?;
    animate::animate(
        &words.required("mesh")?,
        &words.required("csv")?,
        &head_out(words, &["glb", "vrm"], "binary glTF is what is written")?,
        user.as_deref(),
    )?;
    Ok(())
}
