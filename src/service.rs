//! The life of a run: settings and model in, frames through the pipeline, reports out, an orderly end.
//! One file: the order of a run from its start to its end.

use std::io::{self, IsTerminal};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use crate::cli::{CsvTarget, Run};
use crate::face_model::{FaceModel, ModelError};
use crate::geometry::yaw_pitch_roll;
use crate::output::csv::Csv;
use crate::output::{Output, OutputError, Report, Tally};
use crate::pipe::{Pipe, Rows};
use crate::pipeline::{Pipeline, PipelineError};
use crate::sensor::{Frame, Pacer, Source, SourceError, SourceName, kinect};
use crate::service_manager::ServiceManager;
use crate::settings::{Settings, SettingsError};
use crate::status::Status;
use crate::time::Timestamp;
use crate::users::saved::People;
use crate::{bounded, live, memory, send_test, wires};

/// Where the configuration is looked for when none is named.
const SYSTEM_CONFIG: &str = "/etc/mien/mien.toml";
/// How long a run with a bad configuration lasts under a service manager: less than it may take to start.
const BACK_OFF: Duration = Duration::from_secs(15);
/// Time between two lines about what receivers ask for.
const HEARD_PERIOD: Duration = Duration::from_secs(1);
/// Bytes of the largest face model: a hundred times ours.
const MODEL_MOST: usize = 1 << 28;

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The configuration file.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The model file cannot be read.
    #[error("{}: cannot be read ({source}); give the path of a model made by mien-studio train", path.display())]
    ModelFile {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The model file is not a model.
    #[error("{}: {source}", path.display())]
    Model {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: ModelError,
    },
    /// No sensor that can be opened, and one was required.
    #[error(transparent)]
    NoSensor(kinect::KinectError),
    /// The source of frames.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The stages.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// An output.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// Standard output.
    #[error("cannot write to standard output: {0}; is the reader of the pipe gone?")]
    Print(io::Error),
    /// Signals cannot be watched.
    #[error("cannot watch for signals: {0}; is the system out of memory?")]
    Signals(io::Error),
}

impl Failure {
    /// Exit code of the contract.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Settings(_) => 2,
            Self::NoSensor(_) => 3,
            _ => 1,
        }
    }

    /// Waits before a service manager starts the run again, if that cannot go better until a person has done something:
    /// managers before systemd 254 have no patience of their own.
    pub fn back_off(&self) {
        if matches!(self, Self::Settings(_)) && std::env::var_os("NOTIFY_SOCKET").is_some() {
            std::thread::sleep(BACK_OFF);
        }
    }
}

/// The configuration in force: the named file, else the system's, else the built-in defaults.
///
/// # Errors
/// If the file cannot be read or is refused.
pub fn settings(file: Option<&Path>) -> Result<Settings, Failure> {
    let system = Path::new(SYSTEM_CONFIG);
    Ok(match file {
        Some(path) => Settings::read(path)?,
        None if system.exists() => Settings::read(system)?,
        None => Settings::default(),
    })
}

/// The face model in a file, or the built-in one.
///
/// # Errors
/// If the file cannot be read or is refused.
pub fn model(file: Option<&Path>) -> Result<FaceModel, Failure> {
    let Some(path) = file else {
        return Ok(FaceModel::shipped());
    };
    let bytes = bounded::read(path, MODEL_MOST).map_err(|source| Failure::ModelFile {
        path: path.into(),
        source,
    })?;
    FaceModel::read(&bytes).map_err(|source| Failure::Model {
        path: path.into(),
        source,
    })
}

/// What to do when a Kinect is asked for and none is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoKinect {
    /// Play the simulated sensor in its place.
    Simulate,
    /// Wait until one is plugged in.
    Wait,
    /// Fail.
    Refuse,
}

/// Opens a source by name; `settings` are for a Kinect.
///
/// # Errors
/// If the source does not exist or cannot be opened.
pub fn open(
    name: &str,
    no_kinect: NoKinect,
    settings: kinect::Settings,
) -> Result<Source, Failure> {
    let serial = match name.parse().unwrap_or_else(|never| match never {}) {
        SourceName::Recording(path) => return Ok(Source::recording(&path)?),
        SourceName::Simulated { scene } => return Ok(Source::simulated(scene.as_deref())?),
        SourceName::Kinect { serial } => serial,
    };
    let (source, problem) = Source::kinect(serial.as_deref(), settings);
    match (no_kinect, problem) {
        (NoKinect::Refuse, Some(problem)) => Err(Failure::NoSensor(problem)),
        (NoKinect::Simulate, Some(problem)) => {
            tracing::warn!("{problem}; until mien is started again the simulated sensor plays");
            Ok(Source::simulated(None)?)
        }
        (NoKinect::Wait, Some(problem)) => {
            tracing::warn!("waiting for the Kinect: {problem}");
            Ok(source)
        }
        (_, None) => Ok(source),
    }
}

/// What the signals asked for.
struct Signals {
    stop: Arc<AtomicBool>,
    reload: Arc<AtomicBool>,
}

impl Signals {
    fn watch() -> Result<Self, Failure> {
        let signals = Self {
            stop: Arc::default(),
            reload: Arc::default(),
        };
        for signal in [SIGTERM, SIGINT] {
            signal_hook::flag::register(signal, Arc::clone(&signals.stop))
                .map_err(Failure::Signals)?;
        }
        signal_hook::flag::register(SIGHUP, Arc::clone(&signals.reload))
            .map_err(Failure::Signals)?;
        Ok(signals)
    }
}

/// `mien run`: until the source ends, `--frames` are done, or a signal says stop.
///
/// # Errors
/// As [`Failure`] lists.
pub fn run(run: &Run) -> Result<(), Failure> {
    let mut settings = settings(run.config.as_deref())?;
    crate::log::start(settings.log.level);
    let named =
        Some(PathBuf::from(&settings.sensor.model)).filter(|path| !path.as_os_str().is_empty());
    let model = model(run.model.as_deref().or(named.as_deref()))?;
    let name = run
        .source
        .clone()
        .unwrap_or_else(|| settings.sensor.source.clone());
    // Who names the Kinect on the command line wants that one, now or when it is plugged in.
    let no_kinect = match (run.require_device, &run.source) {
        (true, _) => NoKinect::Refuse,
        (false, Some(_)) => NoKinect::Wait,
        (false, None) => NoKinect::Simulate,
    };
    let mut source = open(&name, no_kinect, settings.sensor.kinect)?;
    let mut pipeline = Pipeline::new(&settings, source.registration(), &model)?;
    let signals = Signals::watch()?;
    let csv = run.csv.as_ref();
    let csv = csv.map(|to| table(to, &signals, &source, &pipeline));
    let mut csv = match csv.transpose() {
        // Nobody came to read it.
        Err(_) if signals.stop.load(Ordering::Relaxed) => return Ok(()),
        csv => csv?,
    };
    let mut wires = wires::open(&settings, &pipeline.unit_names())?;
    let mut status = Status::new(&settings.status.path, &name, &pipeline.unit_names());
    let mut people = people(&settings, &source);
    if let Some(people) = &people {
        pipeline.recall(people.load());
    }
    let mut live = (run.csv != Some(CsvTarget::StandardOutput))
        .then(Live::on_a_terminal)
        .flatten();
    let mut manager = ServiceManager::from_environment();
    match memory::lock() {
        Ok(()) => tracing::debug!("memory is locked"),
        // Only as a service is somebody there who can permit it once and for all.
        Err(problem) if manager.is_there() => tracing::info!(
            "memory is not locked ({problem}), so frames may wait for pages; LimitMEMLOCK=infinity in the unit permits it"
        ),
        Err(problem) => tracing::debug!("memory is not locked ({problem})"),
    }
    manager.ready();
    let mut frame = Frame::default();
    let mut pacer = Pacer::default();
    let mut heard = Heard::default();
    let mut left = run.frames.unwrap_or(u64::MAX);
    let mut last = Instant::now();
    while left > 0 && !signals.stop.load(Ordering::Relaxed) {
        if signals.reload.swap(false, Ordering::Relaxed) {
            manager.reloading();
            match reload(run, &mut settings, &source, &model) {
                Ok(None) => tracing::info!("configuration read again, nothing in it has changed"),
                Ok(Some((mut renewed, opened))) => {
                    tracing::info!("configuration read again");
                    renewed.adopt(&pipeline);
                    pipeline = renewed;
                    // Those before say goodbye, and leave their ports.
                    wires = opened;
                    status = Status::new(&settings.status.path, &name, &pipeline.unit_names());
                    people = self::people(&settings, &source);
                }
                Err(problem) => tracing::error!("{problem}; the old configuration stays"),
            }
            manager.ready();
        }
        match source.next_frame(&mut frame) {
            Ok(true) => {}
            Ok(false) => break,
            // For what, the sensor's thread has said.
            Err(SourceError::Waiting(_)) => {
                let nobody = nobody(&frame, last.elapsed());
                // The CSV has rows of frames only.
                for wire in &mut wires {
                    wire.send(&nobody)?;
                }
                status.observe(&nobody, None);
                heard.obey(&mut wires, &mut pipeline);
                status.write(tallies(csv.as_ref(), &wires));
                let now = Instant::now();
                manager.alive(now);
                manager.state(format_args!("waiting for the sensor"), now);
                continue;
            }
            Err(problem) => return Err(problem.into()),
        }
        if !run.fast && !matches!(source, Source::Kinect(_)) {
            pacer.wait(frame.at);
        }
        last = Instant::now();
        let arrived = source.arrived().unwrap_or(last);
        // Another Kinect may have been plugged in.
        if source.registration() != pipeline.camera().registration() {
            pipeline.set_camera(source.registration());
        }
        pipeline.follow(&frame);
        let state = {
            let latency_us = arrived.elapsed().as_micros().try_into().unwrap_or(u32::MAX);
            let mut reports = pipeline.reports();
            for report in &mut reports {
                report.latency_us = latency_us;
                if let Some(Err(problem)) = csv.as_mut().map(|csv| csv.send(report)) {
                    // Whoever plays a recording wants its table; people who are there want their wires.
                    if !matches!(source, Source::Kinect(_)) {
                        return Err(problem.into());
                    }
                    tracing::error!("{problem}; the table ends here, the run goes on");
                    csv = None;
                }
                for wire in &mut wires {
                    wire.send(report)?;
                }
            }
            let mut latency = Some(arrived.elapsed());
            for report in &reports {
                status.observe(report, latency.take());
            }
            let shown = pipeline.report();
            if let Some(live) = &mut live {
                let units = pipeline.expression(0).unit_names();
                live.show(&shown, units.iter().map(|name| name.as_str()));
            }
            shown.state
        };
        if let Source::Kinect(live) = &mut source {
            live.show_tracking(state.has_face());
        }
        heard.obey(&mut wires, &mut pipeline);
        status.write(tallies(csv.as_ref(), &wires));
        if let Some(people) = people.as_mut().filter(|people| people.is_due()) {
            people.save(pipeline.people().iter(), pipeline.at());
        }
        let now = Instant::now();
        manager.alive(now);
        manager.state(format_args!("{}", state.name()), now);
        left -= 1;
    }
    manager.stopping();
    if let Some(people) = &mut people {
        people.save(pipeline.people().iter(), pipeline.at());
    }
    if let Some(live) = live {
        live.end();
    }
    if source.skipped() > 0 {
        tracing::warn!(frames = source.skipped(), "damaged frames were skipped");
    }
    Ok(())
}

/// Where people are saved, if they are: a recording must replay alike however often it has been played.
fn people(settings: &Settings, source: &Source) -> Option<People> {
    let saves = settings.state.persist && matches!(source, Source::Kinect(_));
    saves.then(|| People::at(Path::new(&settings.state.path)))
}

/// What is known while no frames come: the wires' heartbeat goes on, and faces on them are let go.
fn nobody(last: &Frame, since: Duration) -> Report<'static> {
    Report {
        frame: last.index,
        at: Timestamp::from_us(last.at.as_us() + since.as_micros() as u64),
        ..Report::default()
    }
}

/// What the table and the wires have done.
fn tallies<'a>(
    csv: Option<&'a Csv<Rows>>,
    wires: &'a [Box<dyn Output>],
) -> impl Iterator<Item = Tally> + Clone + 'a {
    let wires = wires.iter().map(|wire| wire.tally());
    csv.map(Output::tally).into_iter().chain(wires)
}

/// What receivers ask for, told in a line a second at most.
#[derive(Default)]
struct Heard {
    told: Option<Instant>,
    untold: u32,
}

impl Heard {
    /// Obeys.
    fn obey(&mut self, wires: &mut [Box<dyn Output>], pipeline: &mut Pipeline) {
        for wire in wires {
            while let Some(command) = wire.next_command() {
                pipeline.obey(command);
                let now = Instant::now();
                if self.told.is_some_and(|told| now - told < HEARD_PERIOD) {
                    self.untold += 1;
                    continue;
                }
                tracing::info!("asked over a wire: {command:?}, {} before", self.untold);
                (self.told, self.untold) = (Some(now), 0);
            }
        }
    }
}

/// `mien send-test`: every unit swept on every output.
///
/// # Errors
/// As [`Failure`] lists.
pub fn send_test(config: Option<&Path>) -> Result<(), Failure> {
    let settings = settings(config)?;
    // The names are what the command is for.
    crate::log::start(settings.log.level.max(tracing::Level::INFO));
    let named = Some(Path::new(&settings.sensor.model)).filter(|path| !path.as_os_str().is_empty());
    let signals = Signals::watch()?;
    Ok(send_test::sweep(&settings, &model(named)?, &signals.stop)?)
}

/// Stages and wires that a configuration wants.
type Standing = (Pipeline, Vec<Box<dyn Output>>);

/// Reads the configuration again; if it has changed, the stages and wires it wants, all of which stand. Only then are the
/// settings those read.
fn reload(
    run: &Run,
    settings: &mut Settings,
    source: &Source,
    model: &FaceModel,
) -> Result<Option<Standing>, Failure> {
    let path = run.config.as_deref().unwrap_or(Path::new(SYSTEM_CONFIG));
    // What a pipe would give is not waited for.
    if std::fs::metadata(path).is_ok_and(|about| !about.is_file()) {
        return Err(Failure::Settings(SettingsError::Unreadable {
            path: path.into(),
            reason: "it is no file".to_owned(),
        }));
    }
    let new = self::settings(run.config.as_deref())?;
    if new == *settings {
        return Ok(None);
    }
    let pipeline = Pipeline::new(&new, source.registration(), model)?;
    let wires = wires::open(&new, &pipeline.unit_names())?;
    let later = [
        ("sensor", new.sensor != settings.sensor),
        ("log", new.log != settings.log),
    ];
    for (section, _) in later.iter().filter(|(_, changed)| *changed) {
        tracing::warn!("what has changed in [{section}] needs a restart");
    }
    *settings = new;
    Ok(Some((pipeline, wires)))
}

/// The table that is asked for.
fn table(
    to: &CsvTarget,
    signals: &Signals,
    source: &Source,
    pipeline: &Pipeline,
) -> Result<Csv<Rows>, OutputError> {
    let live = matches!(source, Source::Kinect(_));
    let rows = match to {
        CsvTarget::StandardOutput => Pipe::of(io::stdout()),
        CsvTarget::File(path) => Pipe::create(path, &signals.stop),
    };
    let rows = rows.map(|pipe| Rows::to(pipe, &signals.stop, live));
    let rows = rows.map_err(|source| OutputError::Csv { source })?;
    Csv::new(rows, &Pipeline::measure_names(), &pipeline.unit_names())
}

/// The line of weights that a terminal shows.
struct Live {
    out: Pipe,
    shown: bool,
}

impl Live {
    /// Only there: a log is no place for weights.
    fn on_a_terminal() -> Option<Self> {
        let terminal = Some(io::stdout()).filter(IsTerminal::is_terminal);
        let out = Pipe::of(terminal?).ok()?;
        Some(Self { out, shown: false })
    }

    fn show<'a>(&mut self, report: &Report, names: impl Iterator<Item = &'a str>) {
        let turn = report
            .sensor_from_head
            .map(|pose| yaw_pitch_roll(&pose.rotation));
        let mut units = names.zip(report.weights.iter().copied());
        let line = live::line(
            report.at.as_us() as f64 * 1e-6,
            report.state,
            report.confidence,
            turn,
            &mut units,
        );
        // Over the one before. A terminal that takes nothing more is not waited for.
        self.shown |= self.out.offer(line.as_bytes());
    }

    fn end(self) {
        if self.shown {
            self.out.offer(b"\n");
        }
    }
}
