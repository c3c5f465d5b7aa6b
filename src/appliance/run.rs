//! `mien run`: reads settings and model, runs frames through the pipeline, sends reports, and shuts down in order.
//! One file: the sequence of a run from start to end.

use std::io;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::Instant;

use crate::cli::Run;
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
use mien_outputs::gesture::Gestures;
use mien_outputs::table;
use mien_outputs::{Command, Output, OutputError, Report};
use mien_sensors::Frame;
use mien_sensors::sensor::Sensor;
use mien_stages::base::time::Timestamp;
use mien_stages::face_model::FaceModel;
use mien_stages::users::saved::People;

/// `mien run`: until the source ends, `--frames` are done, or a signal says stop.
///
/// # Errors
/// As [`Failure`] lists.
pub fn run(run: &Run) -> Result<(), Failure> {
    memory::map_large_blocks();
    let Some(mut session) = Session::start(run)? else {
        return Ok(());
    };
    let ended = session.play();
    session.release();
    ended.map(|()| session.finish())
}

/// A run, from the first frame to the last.
struct Session<'r> {
    run: &'r Run,
    settings: Settings,
    model: FaceModel,
    /// Name of the source that is used.
    name: String,
    source: Source,
    pipeline: Pipeline,
    signals: Signals,
    csv: Option<Csv<Rows>>,
    outputs: Vec<Box<dyn Output>>,
    gestures: Gestures,
    status: Status,
    people: Option<People>,
    live: Option<Live>,
    manager: ServiceManager,
    frame: Frame,
    pacer: Pacer,
    /// Frames still to come.
    left: u64,
    started: Instant,
    /// Whether there was a frame.
    begun: bool,
    /// When the last frame was taken up, and when it was whole in memory.
    taken: Instant,
    arrived: Instant,
}

impl<'r> Session<'r> {
    /// Opens everything and allocates all memory; `None` if stopped before its CSV had a reader.
    fn start(run: &'r Run) -> Result<Option<Self>, Failure> {
        let settings = settings(run.config.as_deref())?;
        crate::log::start(run.level(settings.log_level));
        let model = model(run.model.as_deref().or(settings.sensor.model()))?;
        let name = run.source.as_ref().unwrap_or(&settings.sensor.source);
        let (source, name) = source::open(name, run.require_device, settings.sensor.device)?;
        let name = name.to_owned();
        let mut pipeline = Pipeline::new(&settings.stages, source.camera(), &model)?;
        let signals = Signals::watch()?;
        let csv = run.csv.as_deref();
        let csv = csv.map(|to| csv_table(to, &signals, &*source, &pipeline, &settings));
        let csv = match csv.transpose() {
            // Nobody came to read it.
            Err(_) if signals.stop.load(Ordering::Relaxed) => return Ok(None),
            csv => csv?,
        };
        let outputs = table::open(&settings.outputs, &pipeline.unit_names())?;
        if outputs.is_empty() && csv.is_none() {
            tracing::warn!(
                "nothing is sent, because no output is enabled and --csv is not given; enable an output in the configuration (see `mien print-config`)"
            );
        }
        let (gestures, status) = shown(&settings, &name, &pipeline);
        let people = people(&settings, &*source);
        if let Some(people) = &people {
            pipeline.recall(people.load());
        }
        let live = live(run, &name, &settings);
        let manager = ServiceManager::from_environment();
        lock_memory(&manager);
        manager.say("READY=1");
        Ok(Some(Self {
            run,
            settings,
            model,
            name,
            source,
            pipeline,
            signals,
            csv,
            outputs,
            gestures,
            status,
            people,
            live,
            manager,
            frame: Frame::default(),
            pacer: Pacer::default(),
            left: run.frames.unwrap_or(u64::MAX),
            started: Instant::now(),
            begun: false,
            taken: Instant::now(),
            arrived: Instant::now(),
        }))
    }

    fn play(&mut self) -> Result<(), Failure> {
        while self.left > 0 && !self.signals.stop.load(Ordering::Relaxed) {
            self.renew();
            if self.next_frame()? {
                self.follow();
                self.tell()?;
            }
        }
        Ok(())
    }

    /// Reloads the configuration if a signal requests it; an invalid one changes nothing.
    fn renew(&mut self) {
        if !self.signals.reload.swap(false, Ordering::Relaxed) {
            return;
        }
        self.manager.say("RELOADING=1");
        match self.reload() {
            Ok(false) => tracing::info!("configuration reloaded, unchanged"),
            Ok(true) => tracing::info!("configuration reloaded"),
            Err(problem) => tracing::error!("{problem}; keeping the old configuration"),
        }
        // An unchanged configuration was read too.
        memory::give_back();
        self.manager.say("READY=1");
    }

    /// Reloads the configuration; if it has changed (returned), its outputs are opened anew, and its stages rebuilt where they
    /// differ. Nothing is replaced unless all of them succeed.
    fn reload(&mut self) -> Result<bool, Failure> {
        let config = self.run.config.as_deref();
        let path = config.unwrap_or(Path::new(SYSTEM_CONFIG));
        // What a pipe would give is not waited for.
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
        // Another receiver is no reason to lose whoever is tracked.
        if new.stages != old.stages {
            self.pipeline.rebuild(&new.stages, &self.model)?;
        }
        let later = [
            ("sensor", new.sensor != old.sensor),
            ("log", new.log_level != old.log_level),
        ];
        for (section, _) in later.iter().filter(|(_, changed)| *changed) {
            tracing::warn!("the change in [{section}] needs a restart");
        }
        self.release();
        self.settings = new;
        let (gestures, status) = shown(&self.settings, &self.name, &self.pipeline);
        let before = std::mem::replace(&mut self.status, status);
        let tallies = self.outputs.iter().map(|output| output.tally());
        self.status.go_on_from(before, tallies);
        self.gestures = gestures;
        // Those before say goodbye, and leave their ports.
        self.outputs = opened;
        self.people = people(&self.settings, &*self.source);
        Ok(true)
    }

    /// Takes the next frame, at its pace; `false` if there is none now, or the source has ended.
    fn next_frame(&mut self) -> Result<bool, Failure> {
        match self.source.next_frame(&mut self.frame) {
            Ok(true) => {}
            Ok(false) if !self.begun => {
                return Err(SourceError::Nothing(self.source.state().frames).into());
            }
            Ok(false) => {
                self.left = 0;
                return Ok(false);
            }
            // For what, the sensor's thread has said.
            Err(_) => {
                self.wait()?;
                return Ok(false);
            }
        }
        if !self.run.fast && !self.source.state().is_live {
            self.pacer.wait(self.frame.at);
        }
        if !std::mem::replace(&mut self.begun, true) {
            // The frames' time begins only now.
            self.pipeline.age(self.started.elapsed().as_secs_f64());
        }
        self.taken = Instant::now();
        self.arrived = self.source.state().arrived.unwrap_or(self.taken);
        Ok(true)
    }

    /// Half a second without a frame: outputs continue their heartbeat and let faces fade.
    fn wait(&mut self) -> Result<(), Failure> {
        let mut nobody = Report {
            frame: self.frame.index,
            at: self.now(),
            ..Report::default()
        };
        self.gestures.observe(std::slice::from_mut(&mut nobody));
        tell_gestures(&mut self.gestures, &mut self.outputs);
        // The CSV has rows of frames only.
        for output in &mut self.outputs {
            output.send(&nobody)?;
        }
        self.status.observe(&nobody, None);
        self.pipeline.forget_older(self.now());
        self.save_people();
        self.keep_up(format_args!("waiting for the sensor"));
        Ok(())
    }

    fn follow(&mut self) {
        // Another sensor may have been plugged in.
        if self.source.camera() != self.pipeline.camera() {
            self.pipeline.set_camera(self.source.camera());
        }
        self.pipeline.follow(&self.frame);
    }

    /// Passes the frame's reports to all outputs.
    fn tell(&mut self) -> Result<(), Failure> {
        let latency_us = self.arrived.elapsed().as_micros();
        let mut reports = self.pipeline.reports();
        self.gestures.observe(&mut reports);
        for report in &mut reports {
            report.latency_us = latency_us.try_into().unwrap_or(u32::MAX);
            if let Some(Err(problem)) = self.csv.as_mut().map(|csv| csv.send(report)) {
                // Whoever plays a recording wants its table; people who are there want their outputs.
                if !self.source.state().is_live {
                    return Err(problem.into());
                }
                tracing::error!("{problem}; the CSV ends here, the run continues");
                self.csv = None;
            }
            for output in &mut self.outputs {
                output.send(report)?;
            }
        }
        // After the reports, as a tapped key goes up with the next ones.
        tell_gestures(&mut self.gestures, &mut self.outputs);
        let mut latency = Some(self.arrived.elapsed());
        for report in &reports {
            self.status.observe(report, latency.take());
        }
        if let Some(live) = &mut self.live {
            live.show(&reports, self.pipeline.expression(0).unit_names());
        }
        let state = self.pipeline.report().state;
        drop(reports);
        self.source.show_tracking(state.has_face());
        self.save_people();
        self.keep_up(format_args!("{}", state.name()));
        self.left -= 1;
        Ok(())
    }

    /// Time of the last frame and what has passed since: people age without a sensor too.
    fn now(&self) -> Timestamp {
        let since = self.taken.elapsed().as_micros() as u64;
        Timestamp::from_us(self.frame.at.as_us() + since)
    }

    /// Saves the people remembered, once a minute.
    fn save_people(&mut self) {
        let now = self.now();
        if let Some(people) = self.people.as_mut().filter(|people| people.is_due()) {
            people.save(self.pipeline.people(now), now);
        }
    }

    /// Switches off what gestures have switched on.
    fn release(&mut self) {
        self.gestures.release();
        tell_gestures(&mut self.gestures, &mut self.outputs);
    }

    /// What is due with or without a frame: commands, status, the service manager.
    fn keep_up(&mut self, state: std::fmt::Arguments<'_>) {
        for output in &mut self.outputs {
            while let Some(command) = output.next_command() {
                self.pipeline.obey(command);
                if let Command::Level(gesture, hundredths) = command {
                    let level = f32::from(hundredths) / 100.0;
                    self.gestures.set_level(gesture, level);
                }
                tracing::info!("receiver asked to {command}");
            }
        }
        let outputs = self.outputs.iter().map(|output| output.tally());
        let csv = self.csv.iter().map(Output::tally);
        self.status.write(csv.chain(outputs));
        let now = Instant::now();
        self.manager.alive(now);
        self.manager.state(state, now);
    }

    fn finish(mut self) {
        self.manager.say("STOPPING=1");
        let now = self.now();
        if let Some(people) = &mut self.people {
            people.save(self.pipeline.people(now), now);
        }
        if let Some(live) = self.live {
            live.end(self.started.elapsed());
        }
        let frames = self.source.state().skipped;
        if frames > 0 {
            tracing::warn!(frames, "damaged frames were skipped");
        }
    }
}

fn tell_gestures(gestures: &mut Gestures, outputs: &mut [Box<dyn Output>]) {
    gestures.for_each_switch(|switch| outputs.iter_mut().for_each(|output| output.switch(switch)));
}

/// What of the units is looked at besides sending them.
fn shown(settings: &Settings, source: &str, pipeline: &Pipeline) -> (Gestures, Status) {
    let (units, names) = (pipeline.unit_names(), settings.outputs.gesture_names());
    let status = Status::new(&settings.status_path, source, &units, &names)
        .with_ranges(settings.status_ranges);
    (Gestures::new(&settings.outputs.gestures, &units), status)
}

/// The line on a terminal that goes with the run, unless the CSV goes there or it was asked to be quiet.
fn live(run: &Run, source: &str, settings: &Settings) -> Option<Live> {
    if run.quiet || run.csv.as_ref().is_some_and(|to| to.as_os_str() == "-") {
        return None;
    }
    let live = Live::on_a_terminal()?;
    live.greet(source, &table::named(&settings.outputs));
    Some(live)
}

fn lock_memory(manager: &ServiceManager) {
    match memory::lock() {
        Ok(()) => tracing::debug!("memory is locked"),
        // Only as a service is somebody there who can permit it once and for all.
        Err(problem) if manager.is_there() => tracing::info!(
            "memory is not locked ({problem}), so page faults may delay frames; LimitMEMLOCK=infinity in the unit allows locking"
        ),
        Err(problem) => tracing::debug!("memory is not locked ({problem})"),
    }
}

/// Where people are saved, if enabled: a recording must replay identically every time.
fn people(settings: &Settings, source: &dyn Sensor) -> Option<People> {
    let saves = settings.state.persist && source.state().is_live;
    saves.then(|| People::new(Path::new(&settings.state.path)))
}

/// Opens the CSV requested.
fn csv_table(
    to: &Path,
    signals: &Signals,
    source: &dyn Sensor,
    pipeline: &Pipeline,
    settings: &Settings,
) -> Result<Csv<Rows>, OutputError> {
    let pipe = if to.as_os_str() == "-" {
        Pipe::of(io::stdout())
    } else {
        Pipe::create(to, &signals.stop)
    };
    let rows = pipe.map(|pipe| Rows::to(pipe, &signals.stop, source.state().is_live));
    let rows = rows.map_err(OutputError::Csv)?;
    let (units, gestures) = (pipeline.unit_names(), settings.outputs.gesture_names());
    let csv = Csv::new(rows, &Pipeline::measure_names(), &units, &gestures)?;
    Ok(csv.with_reduction(source.state().reduced))
}
