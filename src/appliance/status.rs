//! Status files: `status.json`, and `mien.prom` for Prometheus beside it, once a second.
//!
//! Each file is written under a temporary name and then renamed, so that a reader never sees a partial one. They belong on an
//! in-memory file system (`/run`) and are not synced. A write error is logged once, and writing is retried.
//! Latency is the time from a frame's arrival in this machine until its last output has taken it, over the last 1024 frames.
//! Nothing allocates after the first write; memory: two latency rings of 4 kB and a text of 24 kB.

use std::fmt::Write as _;
use std::fs::Metadata;
use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::{Duration, Instant};

use crate::settings::STATUS_PATH;
use mien_outputs::gesture::ENABLED;
use mien_outputs::{Report, Tally, TrackingState, finite};
use mien_stages::base::atomic_write::AtomicFile;
use mien_stages::base::bounded_read::reason;
use mien_stages::base::capacity::{GESTURES, REGIONS, UNITS, USERS};
use mien_stages::base::defaults;
use mien_stages::base::json::Quoted;
use mien_stages::base::sorting::sort;
use mien_stages::expression::UnitRange;
use mien_stages::face_model::scheme::VISIBLE_REGIONS;

/// Interval between writes.
const PERIOD: Duration = Duration::from_secs(1);
/// Frames whose latency is kept.
const LATENCIES: usize = 1024;
/// Capacity for the kinds of outputs, including the CSV.
const OUTPUTS: usize = 12;
/// Initial capacity of a file's text, bytes.
const TEXT: usize = 24 * 1024;

defaults! {
    /// Figures of the status files.
    pub struct Status {
        files: Option<Files> = None,
        source: String = String::new(),
        units: Vec<String> = Vec::new(),
        gestures: Vec<String> = Vec::new(),
        start: Instant = Instant::now(),
        written: Option<Instant> = None,
        frames: u64 = 0,
        time_us: u64 = 0,
        lost: u64 = 0,
        /// Activations of each gesture since the start, and in the last 24 hours.
        activations: [[u64; 2]; GESTURES] = [[0; 2]; GESTURES],
        /// Whether the sensor delivers frames.
        sensor: bool = false,
        latencies: Latencies = Latencies::default(),
        users: [Option<User>; USERS] = [const { None }; USERS],
        /// Sums of the outputs that reloads replaced, one per name.
        replaced: heapless::Vec<Tally, OUTPUTS> = heapless::Vec::new(),
        text: String = String::with_capacity(TEXT),
        /// Whether learned ranges are written; every user of the machine can read them.
        ranges: bool = false,
    }
}

/// A user as last reported.
#[derive(Clone, Debug)]
struct User {
    state: TrackingState,
    confidence: f32,
    /// How far each region can be seen; `None` without a face.
    seen: Option<[f32; REGIONS]>,
    frozen: bool,
    gestures: u32,
    weights: heapless::Vec<f32, UNITS>,
    ranges: heapless::Vec<UnitRange, UNITS>,
}

impl Status {
    /// Figures for the JSON file at `path`, empty for no files; `source`, `units` and `gestures` are names.
    pub fn new(path: &str, source: &str, units: &[&str], gestures: &[&str]) -> Self {
        let owned = |names: &[&str]| names.iter().map(|&name| name.to_owned()).collect();
        Self {
            files: (!path.is_empty()).then(|| Files::beside(Path::new(path))),
            source: source.to_owned(),
            units: owned(units),
            gestures: owned(gestures),
            ..Self::default()
        }
    }

    /// Sets whether learned ranges are written too.
    pub fn with_ranges(self, ranges: bool) -> Self {
        Self { ranges, ..self }
    }

    /// Takes the activations of each gesture since the start, and in the last 24 hours.
    pub(crate) fn count_activations(&mut self, counts: impl Iterator<Item = [u64; 2]>) {
        let own = self.activations.iter_mut();
        own.zip(counts).for_each(|(own, counts)| *own = counts);
    }

    /// Continues the figures from before a reload; `outputs` are the final tallies of the replaced outputs.
    pub fn continue_from(&mut self, before: Self, outputs: impl Iterator<Item = Tally>) {
        (self.start, self.frames, self.lost) = (before.start, before.frames, before.lost);
        (self.time_us, self.sensor) = (before.time_us, before.sensor);
        (self.latencies, self.users) = (before.latencies, before.users);
        // One sum per name over all reloads.
        let mut sums = before.replaced;
        for tally in outputs {
            match sums.iter_mut().find(|sum| sum.name == tally.name) {
                Some(sum) => *sum = sum.plus(tally),
                // Has room for all kinds of outputs.
                None => drop(sums.push(tally)),
            }
        }
        self.replaced = sums;
    }

    /// An output's counts since the program started.
    fn since_start(&self, tally: Tally) -> Tally {
        let before = self.replaced.iter().find(|sum| sum.name == tally.name);
        before.map_or(tally, |before| before.plus(tally))
    }

    /// Adds a report. `latency`: from arrival of the frame until all outputs took it, with the frame's first report only; `None`
    /// without a frame.
    pub fn observe(&mut self, report: &Report, latency: Option<Duration>) {
        self.time_us = report.at.as_us();
        // A report with neither latency nor user means that the sensor is absent.
        self.sensor = latency.is_some() || self.sensor && report.user.is_some();
        if let Some(latency) = latency {
            self.frames += 1;
            self.latencies.push(latency);
        }
        let Some(slot) = report.user.filter(|&slot| slot < USERS) else {
            self.users = [const { None }; USERS];
            return;
        };
        let before = self.users[slot].as_ref();
        let was_lost = before.is_none_or(|user| user.state == TrackingState::Lost);
        self.lost += u64::from(report.state == TrackingState::Lost && !was_lost);
        self.users[slot] = (report.state != TrackingState::Absent).then(|| User {
            state: report.state,
            confidence: report.confidence,
            seen: report.seen(),
            frozen: report.frozen,
            gestures: report.gestures,
            weights: report.weights.iter().copied().take(UNITS).collect(),
            ranges: report.ranges.iter().copied().take(UNITS).collect(),
        });
    }

    /// Writes both files if a second has passed.
    pub fn write(&mut self, outputs: impl Iterator<Item = Tally> + Clone) {
        let now = Instant::now();
        if self.written.is_none_or(|written| now - written >= PERIOD) {
            self.written = Some(now);
            self.write_now(outputs);
        }
    }

    /// Writes both files.
    pub fn write_now(&mut self, outputs: impl Iterator<Item = Tally> + Clone) {
        let Some(mut files) = self.files.take() else {
            return;
        };
        let mut text = std::mem::take(&mut self.text);
        let outputs = outputs.map(|tally| self.since_start(tally));
        // Writing to a string cannot fail.
        let _ = self.json(outputs.clone(), &mut text);
        files.write(0, text.as_bytes());
        text.clear();
        let _ = self.prometheus(outputs, &mut text);
        files.write(1, text.as_bytes());
        text.clear();
        self.text = text;
        self.files = Some(files);
    }

    fn json(&self, outputs: impl Iterator<Item = Tally>, text: &mut String) -> std::fmt::Result {
        let [median, p99, most] = self.latencies.quantiles();
        let uptime_s = self.start.elapsed().as_secs_f64();
        writeln!(
            text,
            "{{\n  \"version\": \"{}\",\n  \"source\": {},\n  \"sensor\": {},\n  \"uptime_s\": {uptime_s:.1},\n  \"frames\": {},\n  \"time_us\": {},",
            env!("CARGO_PKG_VERSION"),
            Quoted(&self.source),
            self.sensor,
            self.frames,
            self.time_us
        )?;
        writeln!(
            text,
            "  \"latency_ms\": {{\"median\": {median:.3}, \"p99\": {p99:.3}, \"max\": {most:.3}, \"frames\": {}}},",
            self.latencies.count()
        )?;
        writeln!(text, "  \"tracking_lost\": {},", self.lost)?;
        if ENABLED && !self.gestures.is_empty() {
            for (which, key) in ["activations", "activations_24h"].into_iter().enumerate() {
                write!(text, "  \"{key}\": {{")?;
                for (k, (name, counts)) in self.gestures.iter().zip(self.activations).enumerate() {
                    let comma = if k > 0 { ", " } else { "" };
                    write!(text, "{comma}{}: {}", Quoted(name), counts[which])?;
                }
                text.push_str("},\n");
            }
        }
        write!(text, "  \"outputs\": [")?;
        for (i, tally) in outputs.enumerate() {
            let comma = if i > 0 { "," } else { "" };
            let [taken, refused] = tally.commands;
            write!(
                text,
                "{comma}\n    {{\"name\": \"{}\", \"connected\": {}, \"sent\": {}, \"dropped\": {}, \"not_numbers\": {}, \"commands\": {taken}, \"commands_refused\": {refused}}}",
                tally.name, tally.connected, tally.sent, tally.dropped, tally.not_numbers
            )?;
        }
        write!(text, "\n  ],\n  \"users\": [")?;
        let users = self.users.iter().enumerate();
        let users = users.filter_map(|(slot, user)| Some((slot, user.as_ref()?)));
        for (i, (slot, user)) in users.enumerate() {
            text.push_str(if i > 0 { "," } else { "" });
            self.user(slot, user, text)?;
        }
        writeln!(text, "\n  ]\n}}")
    }

    fn user(&self, slot: usize, user: &User, text: &mut String) -> std::fmt::Result {
        let (state, sure, frozen) = (user.state.name(), finite(user.confidence), user.frozen);
        write!(
            text,
            "\n    {{\"slot\": {slot}, \"state\": \"{state}\", \"confidence\": {sure:.3}, "
        )?;
        for (k, share) in user.seen.iter().flatten().enumerate() {
            let start = if k > 0 { ", " } else { "\"seen\": {" };
            write!(text, "{start}\"{}\": {share:.2}", VISIBLE_REGIONS[k].0)?;
        }
        text.push_str(if user.seen.is_some() { "}, " } else { "" });
        write!(text, "\"frozen\": {frozen}, ")?;
        if ENABLED && !self.gestures.is_empty() {
            let on = (0..self.gestures.len()).filter(|i| user.gestures >> i & 1 == 1);
            text.push_str("\"gestures\": [");
            for (k, i) in on.enumerate() {
                let comma = if k > 0 { ", " } else { "" };
                write!(text, "{comma}{}", Quoted(&self.gestures[i]))?;
            }
            text.push_str("], ");
        }
        text.push_str("\"units\": {");
        let units = self.units.iter().zip(&user.weights).zip(&user.ranges);
        for (i, ((name, weight), range)) in units.enumerate() {
            let comma = if i > 0 { "," } else { "" };
            let [low, rest, high, noise] =
                [range.low, range.rest, range.high, range.noise].map(finite);
            let (name, weight) = (Quoted(name), finite(*weight));
            write!(text, "{comma}\n      {name}: {{\"weight\": {weight:.3}, ")?;
            if self.ranges {
                write!(
                    text,
                    "\"low\": {low:.4}, \"rest\": {rest:.4}, \"high\": {high:.4}, \"noise\": {noise:.4}, "
                )?;
            }
            write!(text, "\"readiness\": {:.2}}}", finite(range.readiness))?;
        }
        write!(text, "}}}}")
    }

    fn prometheus(
        &self,
        outputs: impl Iterator<Item = Tally> + Clone,
        text: &mut String,
    ) -> std::fmt::Result {
        let [median, p99, _] = self.latencies.quantiles().map(|ms| ms * 1e-3);
        let users = || self.users.iter().flatten();
        let faces = users().filter(|user| user.state.has_face()).count();
        for (name, kind, help) in METRICS {
            writeln!(text, "# HELP {name} {help}\n# TYPE {name} {kind}")?;
            match name {
                "mien_build_info" => {
                    let version = env!("CARGO_PKG_VERSION");
                    writeln!(text, "{name}{{version=\"{version}\"}} 1")?;
                }
                "mien_frames_captured_total" => writeln!(text, "{name} {}", self.frames)?,
                "mien_capture_to_send_seconds" => {
                    for (share, seconds) in [("0.5", median), ("0.99", p99)] {
                        writeln!(text, "{name}{{quantile=\"{share}\"}} {seconds:.6}")?;
                    }
                }
                "mien_face_present" => writeln!(text, "{name} {faces}")?,
                "mien_tracking_lost_total" => writeln!(text, "{name} {}", self.lost)?,
                "mien_sensor_connected" => writeln!(text, "{name} {}", u8::from(self.sensor))?,
                "mien_uptime_seconds" => {
                    writeln!(text, "{name} {:.1}", self.start.elapsed().as_secs_f64())?;
                }
                "mien_users" => {
                    for state in &TrackingState::ALL[1..] {
                        let count = users().filter(|user| user.state == *state).count();
                        writeln!(text, "{name}{{state=\"{}\"}} {count}", state.name())?;
                    }
                }
                _ => {
                    for tally in outputs.clone() {
                        let value = value_of_output(name, &tally);
                        writeln!(text, "{name}{{output=\"{}\"}} {value}", tally.name)?;
                    }
                }
            }
        }
        if ENABLED && !self.gestures.is_empty() {
            let name = "mien_gesture_activations_total";
            writeln!(
                text,
                "# HELP {name} Number of activations of a gesture, summed over all people.\n# TYPE {name} counter"
            )?;
            for (gesture, [count, _]) in self.gestures.iter().zip(self.activations) {
                writeln!(text, "{name}{{gesture=\"{gesture}\"}} {count}")?;
            }
        }
        Ok(())
    }
}

/// Name, kind and meaning of each metric; a metric's samples follow each other, as the format requires.
#[rustfmt::skip]
const METRICS: [(&str, &str, &str); 12] = [
    ("mien_build_info", "gauge", "The program's version; always 1."),
    ("mien_frames_captured_total", "counter", "Frames since the start."),
    ("mien_capture_to_send_seconds", "summary", "Time from a frame's arrival until all outputs have sent it, over the last 1024 frames."),
    ("mien_face_present", "gauge", "People whose face is tracked."),
    ("mien_tracking_lost_total", "counter", "Times that a person was lost."),
    ("mien_sensor_connected", "gauge", "1 while frames arrive."),
    ("mien_uptime_seconds", "gauge", "Time since the start."),
    ("mien_users", "gauge", "People by state."),
    ("mien_output_sent_total", "counter", "Messages passed to the operating system."),
    ("mien_output_errors_total", "counter", "Messages dropped because the operating system did not accept them."),
    ("mien_output_refused_total", "counter", "Commands that were malformed or not allowed."),
    ("mien_output_connected", "gauge", "1 while the output is connected to its device or receiver."),
];

/// An output's value of a metric.
fn value_of_output(metric: &str, tally: &Tally) -> u64 {
    match metric {
        "mien_output_sent_total" => tally.sent,
        "mien_output_errors_total" => tally.dropped,
        "mien_output_refused_total" => tally.commands[1],
        _ => tally.connected.into(),
    }
}

defaults! {
    /// Ring of the last latencies, microseconds.
    struct Latencies {
        us: [u32; LATENCIES] = [0; LATENCIES],
        pushed: usize = 0,
    }
}

impl Latencies {
    fn push(&mut self, latency: Duration) {
        self.us[self.pushed % LATENCIES] = latency.as_micros().try_into().unwrap_or(u32::MAX);
        self.pushed += 1;
    }

    fn count(&self) -> usize {
        self.pushed.min(LATENCIES)
    }

    /// Median, 99th percentile and maximum in milliseconds, by the nearest rank; 0 before the first frame.
    fn quantiles(&self) -> [f64; 3] {
        // Exact up to 16 s.
        let mut sorted = self.us.map(|us| us as f32);
        let sorted = &mut sorted[..self.count()];
        sort(sorted);
        [0.5, 0.99, 1.0].map(|share| {
            let rank = (share * sorted.len() as f64).ceil() as usize;
            let us = sorted.get(rank.saturating_sub(1)).copied();
            f64::from(us.unwrap_or(0.0)) * 1e-3
        })
    }
}

/// The two files.
struct Files {
    files: [AtomicFile; 2],
    /// Whether a write error was logged.
    error_logged: bool,
    /// The files as last written: device, inode and creation time.
    last_written: [Option<[u64; 3]>; 2],
    /// Whether another writer was logged.
    other_writer_logged: bool,
}

impl Files {
    fn beside(json: &Path) -> Self {
        let prometheus = json.with_file_name("mien.prom");
        // Readable for everybody regardless of the umask; not synced, as they are outdated after a second.
        let file = |path: &Path| AtomicFile::new(path, Some(0o644), false);
        Self {
            files: [json, &prometheus].map(file),
            error_logged: false,
            last_written: [None; 2],
            other_writer_logged: false,
        }
    }

    fn write(&mut self, file: usize, text: &[u8]) {
        let path = self.files[file].path();
        let found = std::fs::metadata(path).ok().as_ref().map(file_identity);
        let last = self.last_written[file];
        let other = last.is_some() && found.is_some() && found != last;
        if other && !std::mem::replace(&mut self.other_writer_logged, true) {
            tracing::warn!(
                "another program, perhaps a second mien, also writes {}; give each its own status.path",
                path.display()
            );
        }
        match self.files[file].write(text) {
            Ok(written) => {
                self.error_logged = false;
                self.last_written[file] = Some(file_identity(&written));
            }
            Err(error) if !self.error_logged => {
                // The default folder exists only under the service; a missing one is not reported.
                let is_default_path = path.to_str() == Some(STATUS_PATH);
                if !(is_default_path && error.kind() == ErrorKind::NotFound) {
                    let (path, why) = (path.display(), reason(error));
                    tracing::info!(
                        "{path} is not written ({why}); set status.path to another file"
                    );
                }
                self.error_logged = true;
            }
            Err(_) => {}
        }
    }
}

/// Identity of a file, to detect replacement.
fn file_identity(about: &Metadata) -> [u64; 3] {
    [about.dev(), about.ino(), about.mtime_nsec() as u64]
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_stages::landmarks::Landmarks;

    #[test]
    fn quantiles_are_of_the_last_frames() {
        let mut latencies = Latencies::default();
        assert_eq!(latencies.quantiles(), [0.0; 3]);
        for ms in 1..=100 {
            latencies.push(Duration::from_millis(ms));
        }
        assert_eq!(latencies.quantiles(), [50.0, 99.0, 100.0]);
        for _ in 0..LATENCIES {
            latencies.push(Duration::from_micros(2500));
        }
        assert_eq!(
            (latencies.quantiles(), latencies.count()),
            ([2.5; 3], LATENCIES)
        );
    }

    #[test]
    fn files_are_complete_and_leave_no_others() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("status.json");
        let status = Status::new(path.to_str().unwrap(), "a \"b\"\\", &["AU26"], &[]);
        let mut status = status.with_ranges(true);
        let report = Report {
            user: Some(1),
            state: TrackingState::Tracking,
            confidence: f32::NAN,
            weights: &[0.25],
            ranges: &[UnitRange {
                low: 0.1,
                rest: 0.2,
                high: 0.3,
                noise: 0.01,
                readiness: 0.5,
            }],
            ..Report::default()
        };
        status.observe(&report, Some(Duration::from_millis(4)));
        let tally = Tally {
            name: "osc",
            sent: 5,
            dropped: 1,
            connected: true,
            not_numbers: 0,
            commands: [2, 3],
        };
        status.write([tally; 2].into_iter());
        let text = std::fs::read_to_string(&path).unwrap();
        for part in [
            "\"source\": \"a \\\"b\\\"\\\\\"",
            "\"latency_ms\": {\"median\": 4.000, \"p99\": 4.000, \"max\": 4.000, \"frames\": 1}",
            "\"slot\": 1, \"state\": \"tracking\", \"confidence\": 0.000",
            "\"AU26\": {\"weight\": 0.250, \"low\": 0.1000, \"rest\": 0.2000, \"high\": 0.3000, \"noise\": 0.0100, \"readiness\": 0.50}",
            "\"sent\": 5, \"dropped\": 1",
        ] {
            assert!(text.contains(part), "{part} in {text}");
        }
        #[cfg(feature = "studio")]
        assert!(
            serde_json::from_str::<serde_json::Value>(&text).is_ok(),
            "{text}"
        );
        let prom = std::fs::read_to_string(folder.path().join("mien.prom")).unwrap();
        for line in [
            "mien_capture_to_send_seconds{quantile=\"0.99\"} 0.004000",
            "mien_face_present 1",
            "mien_users{state=\"tracking\"} 1",
            "mien_users{state=\"posed\"} 0",
        ] {
            assert!(
                prom.lines().any(|expected| expected == line),
                "{line} in {prom}"
            );
        }
        // Each metric is explained once, and all its samples stand below that.
        let mut metric = "";
        for line in prom.lines() {
            if let Some(help) = line.strip_prefix("# HELP ") {
                metric = help.split(' ').next().unwrap();
            } else {
                let line = line.strip_prefix("# TYPE ").unwrap_or(line);
                assert_eq!(line.split([' ', '{']).next(), Some(metric), "{prom}");
            }
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
        // A head without a face counts as posed, not as a face.
        let posed = Report {
            state: TrackingState::Posed,
            weights: &[],
            ranges: &[],
            ..report
        };
        status.observe(&posed, None);
        let (mut json, mut prom) = (String::new(), String::new());
        status.json([tally].into_iter(), &mut json).unwrap();
        status.prometheus([tally].into_iter(), &mut prom).unwrap();
        assert!(json.contains(
            "\"state\": \"posed\", \"confidence\": 0.000, \"frozen\": false, \"units\": {}"
        ));
        assert!(prom.contains("mien_face_present 0\n"), "{prom}");
        assert!(prom.contains("mien_users{state=\"posed\"} 1\n"), "{prom}");
        // Not written again within a second.
        std::fs::remove_file(&path).unwrap();
        status.write([tally; 2].into_iter());
        assert!(!path.exists());
        // Ranges are omitted unless enabled.
        status.ranges = false;
        status.observe(&report, None);
        json.clear();
        status.json([tally].into_iter(), &mut json).unwrap();
        let expected = "\"AU26\": {\"weight\": 0.250, \"readiness\": 0.50}";
        assert!(json.contains(expected), "{json}");
        // Counts continue across a reload, those of the outputs included.
        let mut after = Status::new("", "", &["AU26"], &[]);
        let start = status.start;
        after.continue_from(status, [tally].into_iter());
        assert_eq!((after.frames, after.start), (1, start));
        assert_eq!(after.since_start(tally).sent, 10);
    }

    #[test]
    fn gestures_that_are_on_are_named_and_counted() {
        if !ENABLED {
            // Only a build with the wires has gestures.
            return;
        }
        let mut status = Status::new("", "", &[], &["smile", "kiss", "brows"]);
        let report = Report {
            user: Some(0),
            state: TrackingState::Tracking,
            gestures: 0b101,
            ..Report::default()
        };
        status.observe(&report, None);
        let mut json = String::new();
        status.json(std::iter::empty(), &mut json).unwrap();
        assert!(
            json.contains("\"gestures\": [\"smile\", \"brows\"], \"units\": {}"),
            "{json}"
        );
        status.count_activations([[2, 1], [0, 0], [1, 1]].into_iter());
        let (mut json, mut metrics) = (String::new(), String::new());
        status.json(std::iter::empty(), &mut json).unwrap();
        for counts in [
            "\"activations\": {\"smile\": 2, \"kiss\": 0, \"brows\": 1}",
            "\"activations_24h\": {\"smile\": 1, \"kiss\": 0, \"brows\": 1}",
        ] {
            assert!(json.contains(counts), "{json}");
        }
        status.prometheus(std::iter::empty(), &mut metrics).unwrap();
        let sample = "\nmien_gesture_activations_total{gesture=\"smile\"} 2\n";
        assert!(metrics.contains(sample), "{metrics}");
    }

    #[test]
    fn a_face_has_how_far_its_regions_are_seen() {
        let mut status = Status::new("", "", &[], &[]);
        let landmarks = Landmarks {
            seen: [1.0, 0.75, 0.5, 0.254, f32::NAN, 0.0],
            ..Landmarks::default()
        };
        let mut users = |state| {
            let report = Report {
                user: Some(0),
                state,
                confidence: 0.5,
                landmarks: Some(&landmarks),
                ..Report::default()
            };
            status.observe(&report, None);
            let mut json = String::new();
            status.json(std::iter::empty(), &mut json).unwrap();
            json.split_once("\"users\"").unwrap().1.to_owned()
        };
        let json = users(TrackingState::Tracking);
        let expected = "\"confidence\": 0.500, \"seen\": {\"brow_L\": 1.00, \"brow_R\": 0.75, \"eye_L\": 0.50, \
                        \"eye_R\": 0.25, \"nose\": 0.00, \"mouth\": 0.00}, \"frozen\": false, ";
        assert!(json.contains(expected), "{json}");
        let json = users(TrackingState::Lost);
        assert!(
            json.contains("\"confidence\": 0.500, \"frozen\": false, "),
            "{json}"
        );
    }

    #[test]
    fn two_writers_of_one_file_detect_each_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("status.json");
        let mut both = [(); 2].map(|()| Files::beside(&path));
        both[0].write(0, b"{}");
        both[0].write(0, b"{}");
        assert!(!both[0].other_writer_logged, "alone");
        // A program before this one has left its file.
        both[1].write(0, b"{}");
        assert!(!both[1].other_writer_logged);
        both[0].write(0, b"{}");
        both[1].write(0, b"{}");
        assert_eq!(both.map(|files| files.other_writer_logged), [true; 2]);
    }

    #[test]
    fn the_files_are_readable_for_everybody_under_any_umask() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("status.json");
        Files::beside(&path).write(0, b"{}");
        let mode = std::fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o644);
    }
}
