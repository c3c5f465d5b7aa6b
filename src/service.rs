//! The life of a run: settings and model in, frames through the pipeline, reports out, an orderly end.
//! One file: the order of a run from its start to its end.

use std::fs::File;
use std::io::{self, BufWriter, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use crate::cli::{CsvTarget, Run};
use crate::face_model::{FaceModel, ModelError};
use crate::geometry::yaw_pitch_roll;
use crate::output::csv::Csv;
use crate::output::{Output, OutputError, Report};
use crate::pipeline::{Pipeline, PipelineError};
use crate::sensor::{Frame, Pacer, Source, SourceError, SourceName, kinect};
use crate::service_manager::ServiceManager;
use crate::settings::{Settings, SettingsError};
use crate::status::Status;
use crate::time::Timestamp;
use crate::users::TrackingState;
use crate::users::saved::People;
use crate::{live, memory, send_test, wires};

/// Where the configuration is looked for when none is named.
const SYSTEM_CONFIG: &str = "/etc/mien/mien.toml";
/// How often the live line is written where it cannot overwrite itself, in microseconds.
const LIVE_PERIOD_US: u64 = 1_000_000;

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
    let bytes = std::fs::read(path).map_err(|source| Failure::ModelFile {
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
    let mut outputs = outputs(&settings, run.csv.as_ref(), &pipeline)?;
    let mut status = Status::new(&settings.status.path, &name, &pipeline.unit_names());
    let mut people = people(&settings, &source);
    if let Some(people) = &people {
        pipeline.recall(people.load());
    }
    let mut live = (run.csv != Some(CsvTarget::StandardOutput)).then(Live::default);
    let signals = Signals::watch()?;
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
    let mut left = run.frames.unwrap_or(u64::MAX);
    let mut last = Instant::now();
    while left > 0 && !signals.stop.load(Ordering::Relaxed) {
        if signals.reload.swap(false, Ordering::Relaxed) {
            manager.reloading();
            let old = settings.clone();
            settings = reload(run, settings);
            let mut renewed = Pipeline::new(&settings, source.registration(), &model)?;
            renewed.adopt(&pipeline);
            pipeline = renewed;
            outputs.truncate(usize::from(run.csv.is_some()));
            let units = pipeline.unit_names();
            outputs.extend(match wires::open(&settings, &units) {
                Ok(wires) => wires,
                Err(problem) => {
                    tracing::error!("{problem}; the outputs stay as they were");
                    wires::open(&old, &units)?
                }
            });
            status = Status::new(&settings.status.path, &name, &pipeline.unit_names());
            people = self::people(&settings, &source);
            manager.ready();
        }
        match source.next_frame(&mut frame) {
            Ok(true) => {}
            Ok(false) => break,
            // For what, the sensor's thread has said.
            Err(SourceError::Waiting(_)) => {
                let nobody = nobody(&frame, last.elapsed());
                // The CSV has rows of frames only.
                for wire in outputs.iter_mut().skip(run.csv.is_some().into()) {
                    wire.send(&nobody)?;
                }
                status.observe(&nobody, None);
                hear(&mut outputs, &mut pipeline);
                status.write(outputs.iter().map(|output| output.tally()));
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
                for output in &mut outputs {
                    output.send(report)?;
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
        hear(&mut outputs, &mut pipeline);
        status.write(outputs.iter().map(|output| output.tally()));
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

/// Obeys what receivers ask for.
fn hear(outputs: &mut [Box<dyn Output>], pipeline: &mut Pipeline) {
    for output in outputs {
        while let Some(command) = output.next_command() {
            tracing::info!("asked over OSC: {command:?}");
            pipeline.obey(command);
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

/// The configuration read again; the old one if the new one is refused.
fn reload(run: &Run, old: Settings) -> Settings {
    match settings(run.config.as_deref()) {
        Ok(new) => {
            tracing::info!("configuration read again");
            new
        }
        Err(error) => {
            tracing::error!("{error}; the old configuration stays");
            old
        }
    }
}

/// The CSV, if asked for, and then the configured wires.
fn outputs(
    settings: &Settings,
    csv: Option<&CsvTarget>,
    pipeline: &Pipeline,
) -> Result<Vec<Box<dyn Output>>, Failure> {
    let mut outputs: Vec<Box<dyn Output>> = Vec::new();
    let (measures, units) = (Pipeline::measure_names(), pipeline.unit_names());
    match csv {
        Some(CsvTarget::StandardOutput) => {
            outputs.push(Box::new(Csv::new(io::stdout().lock(), &measures, &units)?))
        }
        Some(CsvTarget::File(path)) => {
            let file = File::create(path).map_err(|source| OutputError::Csv { source })?;
            outputs.push(Box::new(Csv::new(BufWriter::new(file), &measures, &units)?));
        }
        None => {}
    }
    outputs.extend(wires::open(settings, &units)?);
    Ok(outputs)
}

/// The line on standard output: overwritten in place on a terminal, one a second elsewhere.
#[derive(Default)]
struct Live {
    last_us: Option<u64>,
    state: TrackingState,
}

impl Live {
    fn show<'a>(&mut self, report: &Report, names: impl Iterator<Item = &'a str>) {
        let mut out = io::stdout().lock();
        let terminal = out.is_terminal();
        let now = report.at.as_us();
        let due = self.last_us.is_none_or(|last| now >= last + LIVE_PERIOD_US)
            || report.state != self.state;
        if !terminal && !due {
            return;
        }
        (self.last_us, self.state) = (Some(now), report.state);
        let turn = report
            .sensor_from_head
            .map(|pose| yaw_pitch_roll(&pose.rotation));
        let mut units = names.zip(report.weights.iter().copied());
        let line = live::line(
            now as f64 * 1e-6,
            report.state,
            report.confidence,
            turn,
            &mut units,
        );
        // A closed standard output is not worth ending the run for.
        let _ = if terminal {
            write!(out, "\r\x1b[K{line}").and_then(|()| out.flush())
        } else {
            writeln!(out, "{line}")
        };
    }

    fn end(self) {
        let mut out = io::stdout().lock();
        if out.is_terminal() && self.last_us.is_some() {
            let _ = writeln!(out);
        }
    }
}
