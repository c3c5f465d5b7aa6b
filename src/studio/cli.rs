//! The command line of `mien-studio`. Help, manual page and completions are generated from the declarations here.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::error::{ContextKind, ErrorKind};
use clap::{Args, CommandFactory, Parser, Subcommand};

use crate::completions;
use crate::inspect::inspect;
use crate::{animate, place, preview, record};
use mien_appliance::service;
use mien_appliance::settings::Settings;
use mien_appliance::source;
use mien_baking::bake;
use mien_baking::heads::average::make_simulated_head;
use mien_baking::heads::ict::Delta;
use mien_baking::heads::reshape::read_shapes;
use mien_baking::heads::{default_head, hero};
use mien_stages::face_model::FaceModel;
use mien_training::evaluate::head_scenes::{self, wild};
use mien_training::evaluate::sessions::{Sessions, Trial};
use mien_training::evaluate::{by_person, landmark_accuracy, paper, table};
use mien_training::fit::{self, FitArgs};
use mien_training::nrsfm;
use mien_training::train::{self, TrainArgs};
use mien_training::units::readings;
use mien_workbench::atomic_write::write_out;
use mien_workbench::fault::{Fault, USAGE};
use mien_workbench::people_split::{Data, Split};
use mien_workbench::stopped;

/// The workstation tool of mien: trains face models, bakes blendshapes, records, inspects and previews.
#[derive(Parser)]
#[command(name = "mien-studio", version)]
pub struct Line {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Train the face model (shape, appearance, confidence) into one file; prints the error on held-out people
    #[command(
        after_help = "Example: mien-studio train --images ../shared/data/faces_frl189 --out face.model"
    )]
    Train(TrainArgs),
    /// Fit landmarks to still pictures; reports the error if they are annotated
    #[command(
        after_help = "Example: mien-studio fit --images ../shared/data/faces_ytfaces68 --out points.csv"
    )]
    Fit(FitArgs),
    /// Show a recording, a model, the CSV of a run or a mesh as pictures and plots; an HTML page plays the recording
    #[command(after_help = "Example: mien-studio inspect session --out session.html")]
    Inspect(Inspect),
    /// Rebuild the simulated sensor's built-in head from the training people
    #[command(after_help = "Example: mien-studio simulated-head --out config/simulated.head")]
    SimulatedHead {
        /// The head to write
        #[arg(long)]
        out: PathBuf,
        #[command(flatten)]
        data: Data,
    },
    /// Record from the sensor or the simulator
    #[command(
        after_help = "Example: mien-studio record --source simulated --seconds 10 --out session"
    )]
    Record(record::Args),
    /// Run rendered sessions of held-out people through the whole pipeline and print one table
    #[command(
        after_help = "Example: mien-studio evaluate --data ../shared/data --people 19 --seconds 45"
    )]
    Evaluate(Evaluate),
    /// Learn how each unit is computed from all measures together: [[feature]] and [[reading]] of config/units.toml
    #[command(after_help = "Example: mien-studio units --data ../shared/data --out readings.toml")]
    Units(Units),
    /// Recover moving 3D shapes from 2D tracks; reports the error if the ground truth is given
    #[command(
        after_help = "Example: mien-studio nrsfm --tracks shark_W.csv --out shapes.csv --truth shark_S.csv"
    )]
    Nrsfm(nrsfm::Args),
    /// Bake 67 blendshapes onto a neutral head
    #[command(
        after_help = "Example: mien-studio bake --mesh head.obj --landmarks head68.txt --out head.glb --report head.html"
    )]
    Bake(bake::command::Request),
    /// Serve a web page for dragging the 68 landmarks into place on a neutral head, with a preview of the shapes
    #[command(after_help = "Example: mien-studio place --mesh head.obj --out head68.txt")]
    Place(place::Args),
    /// Write a coloured head to experiment with, and its landmarks in a .txt beside it: baked with 67 shapes and a
    /// neck that stays still (.glb), or neutral with its materials (.obj)
    #[command(after_help = "Example: mien-studio head --out head.obj")]
    Head {
        /// The head to write, .glb or .obj
        #[arg(long, required_unless_present = "make")]
        out: Option<PathBuf>,
        /// Rebuild the data from which the program makes the head
        #[arg(long)]
        make: Option<PathBuf>,
        /// Overwrite existing files beside it; otherwise new files beside it get a number
        #[arg(long)]
        force: bool,
        #[command(flatten)]
        data: Data,
    },
    /// Serve a web page: the animated head, the units, their ranges, curves, pose and state
    #[command(after_help = "Example: mien-studio preview --csv run.csv --mesh head.glb")]
    Preview(preview::Args),
    /// Learn from sculpted shapes how skin moves, for bake
    #[command(after_help = "Example: mien-studio skin --out config/skin.prior")]
    Skin {
        /// The prior to write
        #[arg(long)]
        out: PathBuf,
        #[command(flatten)]
        data: Data,
    },
    /// Export the weights of a run as a glTF animation
    #[command(
        after_help = "Example: mien-studio animate --mesh head.glb --csv run.csv --out acted.glb"
    )]
    Animate(animate::Args),
    /// Write this program's manual page and its completions for bash, zsh and fish
    #[command(after_help = "Example: mien-studio completions --out ~/.local/share")]
    Completions {
        /// Folder to write to, laid out like /usr/share
        #[arg(long)]
        out: PathBuf,
    },
}

#[derive(Args)]
struct Setup {
    /// Face model [default: the built-in one]
    #[arg(long)]
    model: Option<PathBuf>,
    /// Configuration [default: the built-in one]
    #[arg(long)]
    config: Option<PathBuf>,
}

impl Setup {
    fn read(&self) -> Result<(FaceModel, Settings), Fault> {
        let settings = service::settings(self.config.as_deref()).map_err(service_fault)?;
        let model = service::model(self.model.as_deref()).map_err(service_fault)?;
        Ok((model, settings))
    }
}

#[derive(Args)]
struct Inspect {
    /// Recording, run (CSV), face model, mesh or saved people to show
    path: PathBuf,
    /// Page or picture to write, .html or .png
    #[arg(long)]
    out: Option<PathBuf>,
    #[command(flatten)]
    setup: Setup,
}

#[derive(Args)]
struct Evaluate {
    #[command(flatten)]
    data: Data,
    #[command(flatten)]
    setup: Setup,
    /// Maximum number of people of the split [default: all; 4 with --heads, 1 with --paper]
    #[arg(long)]
    people: Option<usize>,
    /// Length of a session [default: 45; 5 with --landmarks, 10 with --heads, 20 with --wild and --paper]
    #[arg(long)]
    seconds: Option<f64>,
    /// People whose sessions are run: test (never used in development), dev (for choosing settings) or train
    #[arg(long, default_value = "test")]
    split: Split,
    /// Seed of everything random
    #[arg(long, default_value_t = Sessions::default().seed)]
    seed: u64,
    /// The face model alone: every condition on rendered and on real faces
    #[arg(long, group = "what")]
    landmarks: bool,
    /// Scenes of one and several heads, hands and rooms
    #[arg(long, group = "what")]
    heads: bool,
    /// People with hair, clothes and accessories before a sensor with realistic faults
    #[arg(long, group = "what")]
    wild: bool,
    /// Give the depth of --wild a stereo camera's noise (RealSense D435) instead of a Kinect's
    #[arg(long, requires = "wild")]
    stereo: bool,
    /// Record the sessions of --wild here instead of playing them, with the true points, for other programs
    #[arg(long, requires = "wild", value_name = "FOLDER")]
    record: Option<PathBuf>,
    /// The experiments of docs/paper.md: the paper's system next to the default
    #[arg(long, group = "what")]
    paper: bool,
    /// Give people the head shapes of this folder in turn (tests/people/run makes them); alone, it prints a row for each person, and a
    /// table of the same people with a weak left side
    #[arg(long, value_name = "FOLDER", conflicts_with = "paper")]
    shapes: Option<PathBuf>,
    /// Only these rows of --heads or --paper, separated by commas
    #[arg(long, value_delimiter = ',')]
    rows: Vec<String>,
}

#[derive(Args)]
struct Units {
    #[command(flatten)]
    data: Data,
    #[command(flatten)]
    setup: Setup,
    /// Give every second person another shape in turn, from this folder that tests/people/run writes
    #[arg(long, value_name = "FOLDER")]
    shapes: Option<PathBuf>,
    /// Number of people who act
    #[arg(long, default_value_t = 60)]
    people: usize,
    /// Seconds per person
    #[arg(long, default_value_t = 40.0)]
    seconds: f64,
    /// Seed of everything random
    #[arg(long, default_value_t = 41)]
    seed: u64,
    /// File of the acted sessions: read if it exists, otherwise written, so that a second run takes seconds
    #[arg(long)]
    examples: Option<PathBuf>,
    /// Where to write the tables [default: standard output]
    #[arg(long)]
    out: Option<PathBuf>,
}

fn service_fault(failure: service::Failure) -> Fault {
    Fault::with_code(failure.to_string(), failure.exit_code())
}

/// An error: wrong arguments.
fn misused(text: String) -> Fault {
    Fault::with_code(text, USAGE)
}

/// The error as one sentence.
fn sentence(error: &clap::Error) -> String {
    let text = error.to_string();
    let about = text.split("\n\n").next().unwrap_or_default();
    let about: Vec<&str> = about.split_whitespace().skip(1).collect();
    let about = about.join(" ");
    let meant = [
        ContextKind::SuggestedSubcommand,
        ContextKind::SuggestedArg,
        ContextKind::SuggestedValue,
    ];
    match meant.iter().find_map(|&kind| error.get(kind)) {
        Some(meant) => format!("{about}; did you mean {meant}?"),
        None => about,
    }
}

/// Parses the arguments; `None` after printing requested help.
fn parsed(words: impl IntoIterator<Item = OsString>) -> Result<Option<Line>, Fault> {
    let words = std::iter::once("mien-studio".into()).chain(words);
    Line::try_parse_from(words)
        .map(Some)
        .or_else(|error| match error.kind() {
            ErrorKind::DisplayHelp
            | ErrorKind::DisplayVersion
            | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
                print!("{error}");
                Ok(None)
            }
            _ => Err(misused(sentence(&error))),
        })
}

/// Runs one invocation with the arguments after the program's name.
///
/// # Errors
/// On wrong arguments, with [`USAGE`], and those of the command.
pub fn run(words: impl IntoIterator<Item = OsString>) -> Result<(), Fault> {
    let Some(line) = parsed(words)? else {
        return Ok(());
    };
    match line.command {
        Command::Train(args) => {
            stopped::report_what_is_kept(Some(args.out.clone()));
            train::run(&args, &mut print_line)
        }
        Command::Fit(args) => {
            stopped::report_what_is_kept(Some(args.out.clone()));
            fit::fit(&args, &mut print_line)
        }
        Command::Inspect(Inspect { path, out, setup }) => {
            let (model, settings) = setup.read()?;
            let out = inspect(&path, out.as_deref(), &model, &settings)?;
            print_line(&format!("wrote {}", out.display()));
            Ok(())
        }
        Command::SimulatedHead { out, data } => {
            let trains = |person| Split::from_index(person) == Split::Train;
            let bytes = make_simulated_head(&data.data, &out, trains)?;
            print_line(&format!("wrote {}: {bytes} bytes", out.display()));
            Ok(())
        }
        Command::Record(words) => run_record(&words),
        Command::Evaluate(words) => run_evaluate(&words),
        Command::Units(words) => run_units(words),
        Command::Nrsfm(args) => {
            stopped::report_what_is_kept(Some(args.out.clone()));
            nrsfm::run(&args)
        }
        Command::Bake(request) => bake::command::run(&request).map(drop),
        Command::Place(args) => place::run(args, &mut print_line),
        Command::Head {
            out,
            make,
            force,
            data,
        } => {
            if let Some(out) = make {
                let bytes = hero::make::make(&data.data, &out)?;
                print_line(&format!("wrote {}: {bytes} bytes", out.display()));
            } else if let Some(out) = out {
                print_line(&default_head::write_to(&out, force)?);
            }
            Ok(())
        }
        Command::Preview(args) => preview::run(&args, &mut print_line),
        Command::Skin { out, data } => bake::command::skin(&data.data, &out),
        Command::Animate(args) => animate::animate(&args),
        Command::Completions { out } => completions::write(Line::command(), &out),
    }
}

fn print_line(line: &str) {
    println!("{line}");
}

fn run_record(args: &record::Args) -> Result<(), Fault> {
    let required = args.source != source::AUTO;
    let opened = source::open(&args.source, required, &Default::default());
    let (mut source, _) = opened.map_err(|failure| service_fault(failure.into()))?;
    let now = std::time::UNIX_EPOCH.elapsed();
    let now = now.map_or(0.0, |since| since.as_secs_f64());
    let stop = stopped::flag_on_signals();
    let done = record::record(&mut *source, &args.out, args.seconds, now, &stop)?;
    print_line(&format!("{} frames in {}", done.frames, args.out.display()));
    eprintln!("{done}");
    Ok(())
}

fn run_evaluate(words: &Evaluate) -> Result<(), Fault> {
    let (model, settings) = words.setup.read()?;
    stopped::report_what_is_kept(None);
    let all = usize::MAX;
    let (people, seconds) = match words {
        // Five seconds contain every condition.
        Evaluate {
            landmarks: true, ..
        } => (all, 5.0),
        Evaluate { paper: true, .. } => (1, 20.0),
        Evaluate { heads: true, .. } => (head_scenes::PEOPLE, head_scenes::SECONDS),
        Evaluate { wild: true, .. } => (all, wild::SECONDS),
        _ => (all, Sessions::default().seconds),
    };
    let shapes = shapes(words.shapes.as_deref())?;
    let trial = Trial {
        shapes: &shapes,
        data: &words.data.data,
        model: &model,
        settings: &settings,
        sessions: &Sessions {
            people: words.people.unwrap_or(people),
            seconds: words.seconds.unwrap_or(seconds),
            split: words.split,
            seed: words.seed,
        },
    };
    if words.landmarks {
        return landmark_accuracy::measure(&trial, &mut print_line);
    }
    if words.paper {
        return paper::play(&trial, rows(&words.rows, &paper::ROWS)?, &mut print_line);
    }
    match &words.record {
        Some(out) => wild::record(&trial, words.stereo, out)?,
        None if words.wild => print!("{}", wild::play(&trial, words.stereo)?),
        None if words.heads => {
            let rows = rows(&words.rows, &head_scenes::ROWS)?;
            print!("{}", head_scenes::play(&trial, rows)?);
        }
        None if words.shapes.is_some() => print!("{}", by_person::play(&trial)?),
        None => print!("{}", table::play(&trial)?),
    }
    Ok(())
}

/// The shapes of heads in a folder, none without one.
fn shapes(folder: Option<&Path>) -> Result<Vec<Delta>, Fault> {
    folder.map_or_else(|| Ok(Vec::new()), read_shapes)
}

/// The requested rows, if all of them are among `names`.
fn rows<'a>(rows: &'a [String], names: &[&str]) -> Result<&'a [String], Fault> {
    match rows.iter().find(|row| !names.contains(&row.as_str())) {
        Some(unknown) => {
            let names = names.join(", ");
            Err(misused(format!("--rows {unknown} is not one of {names}")))
        }
        None => Ok(rows),
    }
}

fn run_units(words: Units) -> Result<(), Fault> {
    let (model, settings) = words.setup.read()?;
    stopped::report_what_is_kept(words.out.clone());
    let mut progress = |line: &str| eprintln!("{line}");
    let shapes = shapes(words.shapes.as_deref())?;
    let trial = Trial {
        shapes: &shapes,
        data: &words.data.data,
        model: &model,
        settings: &settings,
        sessions: &Sessions {
            people: words.people,
            seconds: words.seconds,
            seed: words.seed,
            ..Sessions::default()
        },
    };
    let text = readings::learn(&trial, words.examples.as_deref(), &mut progress)?;
    match words.out {
        Some(out) => write_out(&out, text)?,
        None => print!("{text}"),
    }
    Ok(())
}
