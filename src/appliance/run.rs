//! `mien run`: reads settings and model, runs frames through the pipeline, sends reports, and shuts down in order.

use std::io;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::Instant;

use crate::cli::Run;
use crate::levels::LevelsFile;
use crate::memory;
use crate::pipe::{Pipe, Rows};
use crate::pipeline::Pipeline;
use crate::service::{Failure, SYSTEM_CONFIG, model, settings};
use crate::service_manager::ServiceManager;
use crate::settings::{Settings, SettingsError};
use crate::signals::Signals;
use crate::source::{self, Pacer, Source, SourceError};
use crate::status::Status;
use crate::terminal::Live;
use mien_outputs::csv::Csv;
use mien_outputs::gesture::{ENABLED, Gestures};
use mien_outputs::table;
use mien_outputs::{Output, OutputError, Report, Tally};
use mien_sensors::Frame;
use mien_sensors::sensor::{Activity, Sensor};
use mien_sensors::turned::upright;
use mien_stages::base::time::Timestamp;
use mien_stages::face_model::FaceModel;
use mien_stages::users::saved::People;

/// Runs until the source ends, `--frames` are done, or SIGINT or SIGTERM arrives.
///
/// # Errors
/// As [`Failure`] lists.
pub fn run(run: &Run) -> Result<(), Failure> {
    memory::map_large_blocks();
    let Some(mut session) = Session::start(run)? else {
        return Ok(());
    };
    let ended = session.run_frames();
    session.release();
    ended.map(|()| session.finish())
}

/// A run, from the first frame to the last.
struct Session<'r> {
    run: &'r Run,
    settings: Settings,
    model: FaceModel,
    /// Name of the source in use, after resolving `auto`.
    name: String,
    source: Source,
    pipeline: Pipeline,
    signals: Signals,
    /// The table of `--csv`, if given, then those of the configuration.
    outputs: Vec<Box<dyn Output>>,
    gestures: Gestures,
    status: Status,
    people: Option<People>,
    levels: Option<LevelsFile>,
    live: Option<Live>,
    manager: ServiceManager,
    frame: Frame,
    pacer: Pacer,
    /// Frames left of `--frames`.
    frames_left: u64,
    started: Instant,
    /// Whether any frame arrived.
    any_frame: bool,
    /// When the last frame was passed to the pipeline.
    taken_at: Instant,
    /// When the last frame was complete in memory.
    arrived_at: Instant,
}

impl<'r> Session<'r> {
    /// Opens everything and allocates all memory; `None` if stopped while the CSV's pipe had no reader.
    fn start(run: &'r Run) -> Result<Option<Self>, Failure> {
        let settings = settings(run.config.as_deref())?;
        crate::log::start(run.level(settings.log_level));
        let model = model(run.model.as_deref().or(settings.sensor.model()))?;
        let name = run.source.as_ref().unwrap_or(&settings.sensor.source);
        let (source, name) = source::open(name, run.require_device, &settings.sensor.device)?;
        let source = upright(source, settings.sensor.turned);
        let name = name.to_owned();
        let mut pipeline = Pipeline::new(&settings.stages, source.camera(), &model)?;
        let signals = Signals::watch()?;
        let csv = run.csv.as_deref();
        let csv = csv.map(|to| csv_table(to, &signals, &*source, &pipeline, &settings));
        let mut outputs: Vec<_> = match csv.transpose() {
            // Stopped while waiting for a reader.
            Err(_) if signals.stop.load(Ordering::Relaxed) => return Ok(None),
            csv => csv?.into_iter().collect(),
        };
        outputs.extend(table::open(&settings.outputs, &pipeline.unit_names())?);
        if outputs.is_empty() {
            tracing::warn!(
                "nothing is sent, because no output is enabled and --csv is not given; enable an output in the configuration (see `mien print-config`)"
            );
        }
        let (mut gestures, status) = gestures_and_status(&settings, &name, &pipeline);
        let (people, levels) = kept_files(&settings, &*source);
        if let Some(levels) = &levels {
            levels.load(&mut gestures);
        }
        if let Some(people) = &people {
            pipeline.recall(people.load());
        }
        let live = open_live(run, &name, &settings);
        let manager = ServiceManager::from_environment();
        lock_memory(&manager);
        manager.notify("READY=1");
        Ok(Some(Self {
            run,
            settings,
            model,
            name,
            source,
            pipeline,
            signals,
            outputs,
            gestures,
            status,
            people,
            levels,
            live,
            manager,
            frame: Frame::default(),
            pacer: Pacer::default(),
            frames_left: run.frames.unwrap_or(u64::MAX),
            started: Instant::now(),
            any_frame: false,
            taken_at: Instant::now(),
            arrived_at: Instant::now(),
        }))
    }

    fn run_frames(&mut self) -> Result<(), Failure> {
        while self.frames_left > 0 && !self.signals.stop.load(Ordering::Relaxed) {
            self.reload_if_requested();
            if self.next_frame()? {
                self.follow();
                self.send_reports()?;
            }
        }
        Ok(())
    }

    /// Reloads the configuration if a signal requests it; an invalid one changes nothing.
    fn reload_if_requested(&mut self) {
        if !self.signals.reload.swap(false, Ordering::Relaxed) {
            return;
        }
        self.manager.notify("RELOADING=1");
        match self.reload() {
            Ok(false) => tracing::info!("configuration reloaded, unchanged"),
            Ok(true) => tracing::info!("configuration reloaded"),
            Err(problem) => tracing::error!("{problem}; keeping the old configuration"),
        }
        // Reading frees memory even if nothing changed.
        memory::trim();
        self.manager.notify("READY=1");
    }

    /// Reads the configuration; if it changed, which is returned, reopens its outputs and rebuilds changed stages. An error
    /// changes nothing.
    fn reload(&mut self) -> Result<bool, Failure> {
        let config = self.run.config.as_deref();
        let path = config.unwrap_or(Path::new(SYSTEM_CONFIG));
        // Reading a pipe would block.
        if std::fs::metadata(path).is_ok_and(|about| !about.is_file()) {
            return Err(SettingsError::unreadable(path, "not a regular file").into());
        }
        let (new, old) = (settings(config)?, &self.settings);
        if new == *old {
            return Ok(false);
        }
        let units = Pipeline::unit_names_with(&new.stages);
        let units: Vec<&str> = units.iter().map(String::as_str).collect();
        let opened = table::open(&new.outputs, &units)?;
        // A change of outputs alone keeps the tracked users.
        if new.stages != old.stages {
            self.pipeline.rebuild(&new.stages, &self.model)?;
        }
        let needs_restart = [
            ("sensor", new.sensor != old.sensor),
            ("log", new.log_level != old.log_level),
        ];
        for (section, _) in needs_restart.iter().filter(|(_, changed)| *changed) {
            tracing::warn!("the change in [{section}] needs a restart");
        }
        self.release();
        self.settings = new;
        let (mut gestures, status) =
            gestures_and_status(&self.settings, &self.name, &self.pipeline);
        let before = std::mem::replace(&mut self.status, status);
        // The table goes on; the replaced outputs close and free their ports.
        let table = usize::from(self.run.csv.is_some());
        let replaced = self.outputs.split_off(table);
        self.outputs.extend(opened);
        self.status.continue_from(before, tallies(&replaced));
        self.save_levels();
        (self.people, self.levels) = kept_files(&self.settings, &*self.source);
        if let Some(levels) = &self.levels {
            levels.load(&mut gestures);
        }
        gestures.continue_from(&self.gestures);
        self.gestures = gestures;
        Ok(true)
    }

    /// Reads the next frame, paced in real time; `false` if there is none yet or the source has ended.
    fn next_frame(&mut self) -> Result<bool, Failure> {
        match self.source.next_frame(&mut self.frame) {
            Ok(true) => {}
            Ok(false) if !self.any_frame => {
                return Err(SourceError::Nothing(self.source.state().frames).into());
            }
            Ok(false) => {
                self.frames_left = 0;
                return Ok(false);
            }
            // The sensor's thread has logged the cause.
            Err(_) => {
                self.send_absence()?;
                return Ok(false);
            }
        }
        if !self.run.fast && !self.source.state().is_live {
            self.pacer.wait(self.frame.at);
        }
        if !std::mem::replace(&mut self.any_frame, true) {
            // Saved people age by the time spent starting: frame time begins now.
            self.pipeline.age(self.started.elapsed().as_secs_f64());
        }
        self.taken_at = Instant::now();
        self.arrived_at = self.source.state().arrived.unwrap_or(self.taken_at);
        Ok(true)
    }

    /// Handles half a second without a frame: outputs send their heartbeat and fade faces out.
    fn send_absence(&mut self) -> Result<(), Failure> {
        let mut nobody = Report {
            frame: self.frame.index,
            at: self.now(),
            ..Report::default()
        };
        self.gestures.observe(std::slice::from_mut(&mut nobody));
        send_switches(&mut self.gestures, &mut self.outputs);
        for output in &mut self.outputs {
            output.send_absence(&nobody)?;
        }
        self.status.observe(&nobody, None);
        self.pipeline.forget_older(self.now());
        self.save_people();
        self.handle_commands_and_status(format_args!("waiting for the sensor"));
        Ok(())
    }

    fn follow(&mut self) {
        // Another sensor may have been plugged in.
        if self.source.camera() != self.pipeline.camera() {
            self.pipeline.set_camera(self.source.camera());
        }
        self.pipeline.follow(&self.frame);
    }

    /// Sends the frame's reports to all outputs.
    fn send_reports(&mut self) -> Result<(), Failure> {
        let latency_us = self.arrived_at.elapsed().as_micros();
        let mut reports = self.pipeline.reports();
        self.gestures.observe(&mut reports);
        for report in &mut reports {
            report.latency_us = latency_us.try_into().unwrap_or(u32::MAX);
            for output in &mut self.outputs {
                output.send(report)?;
            }
        }
        // After the reports: outputs release a tapped key when the next ones are sent.
        send_switches(&mut self.gestures, &mut self.outputs);
        let mut latency = Some(self.arrived_at.elapsed());
        for report in &reports {
            self.status.observe(report, latency.take());
        }
        if let Some(live) = &mut self.live {
            live.update(&reports, self.pipeline.expression(0).unit_names());
        }
        let state = self.pipeline.report().state;
        let activity = if reports.iter().any(|report| report.gestures != 0) {
            Activity::Gesture
        } else if state.has_face() {
            Activity::Tracking
        } else {
            Activity::Searching
        };
        drop(reports);
        self.source.show(activity);
        self.save_people();
        self.handle_commands_and_status(format_args!("{}", state.name()));
        self.frames_left -= 1;
        Ok(())
    }

    /// Time of the last frame plus the time elapsed since, so that people age without a sensor too.
    fn now(&self) -> Timestamp {
        let since = self.taken_at.elapsed().as_micros() as u64;
        Timestamp::from_us(self.frame.at.as_us() + since)
    }

    /// Saves people when due, once a minute.
    fn save_people(&mut self) {
        let now = self.now();
        if let Some(people) = self.people.as_mut().filter(|people| people.is_due()) {
            people.save(self.pipeline.people(now), now);
        }
    }

    fn save_levels(&mut self) {
        if let Some(levels) = &mut self.levels {
            levels.save(&mut self.gestures);
        }
    }

    /// Releases all switches that gestures hold.
    fn release(&mut self) {
        self.gestures.release();
        send_switches(&mut self.gestures, &mut self.outputs);
    }

    /// Handles commands and updates status and service manager, with or without a frame.
    fn handle_commands_and_status(&mut self, state: std::fmt::Arguments<'_>) {
        for output in &mut self.outputs {
            while let Some(command) = output.next_command() {
                self.pipeline.execute(command);
                self.gestures.execute(command);
                tracing::info!("receiver asked to {command}");
            }
        }
        if let Some(levels) = self.levels.as_mut().filter(|levels| levels.is_due()) {
            levels.save(&mut self.gestures);
        }
        self.status.count_activations(self.gestures.activations());
        self.status.write(tallies(&self.outputs));
        let now = Instant::now();
        self.manager.feed_watchdog(now);
        self.manager.set_status(state, now);
    }

    fn finish(mut self) {
        self.manager.notify("STOPPING=1");
        let now = self.now();
        if let Some(people) = &mut self.people {
            people.save(self.pipeline.people(now), now);
        }
        self.save_levels();
        // What happened since the last second counts too.
        self.status.write_now(tallies(&self.outputs));
        if let Some(live) = self.live {
            live.finish(self.started.elapsed());
        }
        let frames = self.source.state().skipped;
        if frames > 0 {
            tracing::warn!(frames, "damaged frames were skipped");
        }
    }
}

/// What every output has sent.
fn tallies(outputs: &[Box<dyn Output>]) -> impl Iterator<Item = Tally> + Clone {
    outputs.iter().map(|output| output.tally())
}

fn send_switches(gestures: &mut Gestures, outputs: &mut [Box<dyn Output>]) {
    gestures.for_each_switch(|switch| outputs.iter_mut().for_each(|output| output.switch(switch)));
    gestures.for_each_set_up(|set_up| outputs.iter_mut().for_each(|output| output.set_up(set_up)));
}

/// Gestures and status of a configuration.
fn gestures_and_status(
    settings: &Settings,
    source: &str,
    pipeline: &Pipeline,
) -> (Gestures, Status) {
    let (units, names) = (pipeline.unit_names(), settings.outputs.gesture_names());
    let status = Status::new(&settings.status_path, source, &units, &names)
        .with_ranges(settings.status_ranges);
    (Gestures::new(&settings.outputs.gestures, &units), status)
}

/// Opens the live line on a terminal, unless `--quiet` is given or the CSV goes to standard output.
fn open_live(run: &Run, source: &str, settings: &Settings) -> Option<Live> {
    if run.quiet || run.csv.as_ref().is_some_and(|to| to.as_os_str() == "-") {
        return None;
    }
    let live = Live::on_terminal()?;
    live.print_header(source, &table::named(&settings.outputs));
    Some(live)
}

fn lock_memory(manager: &ServiceManager) {
    match memory::lock() {
        Ok(()) => tracing::debug!("memory is locked"),
        // Only a service has a unit file that can permit it.
        Err(problem) if manager.is_connected() => tracing::info!(
            "memory is not locked ({problem}), so page faults may delay frames; LimitMEMLOCK=infinity in the unit allows locking"
        ),
        Err(problem) => tracing::debug!("memory is not locked ({problem})"),
    }
}

/// The files of saved people and of changed levels, if enabled; not for recordings, which must replay identically.
fn kept_files(settings: &Settings, source: &dyn Sensor) -> (Option<People>, Option<LevelsFile>) {
    let saves = settings.state.persist && source.state().is_live;
    let path = Path::new(&settings.state.path);
    let has_gestures = ENABLED && !settings.outputs.gestures.is_empty();
    let levels = (saves && has_gestures).then(|| LevelsFile::new(path));
    (saves.then(|| People::new(path)), levels)
}

/// Opens the CSV and writes its header.
fn csv_table(
    to: &Path,
    signals: &Signals,
    source: &dyn Sensor,
    pipeline: &Pipeline,
    settings: &Settings,
) -> Result<Box<dyn Output>, OutputError> {
    let pipe = match to.as_os_str() == "-" {
        true => Pipe::from_stream(io::stdout()),
        false => Pipe::create(to, &signals.stop),
    };
    let rows = pipe.map(|pipe| Rows::new(pipe, &signals.stop, source.state().is_live));
    let rows = rows.map_err(OutputError::Csv)?;
    let (units, gestures) = (pipeline.unit_names(), settings.outputs.gesture_names());
    let csv = Csv::new(rows, &Pipeline::measure_names(), &units, &gestures)?;
    let state = source.state();
    Ok(Box::new(csv.of_source(state.reduced, state.is_live)))
}
