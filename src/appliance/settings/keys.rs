//! Every key of the configuration: section, name, meaning, unit, range, and field.
//!
//! Outputs define their own sections; sensor, users and saved state define their own keys ([`Keys`]); the tables here define the
//! others. A row is `name: meaning => kind of value;`. Printing, reading and `config/mien.toml` follow the order of the table.

use tracing::Level;

use super::sections::Settings;
use mien_stages::base::settings::{Key, Keys, Kind};
use mien_stages::expression::measures::Scale;
use mien_stages::pose::smoothing::Smoothing;
use mien_stages::{expression, landmarks, pose};

/// The section whose keys are the units' names.
pub(super) const UNITS: &str = "units";
/// The section that is an array of tables.
pub(super) const GESTURE: &str = "gesture";

/// A section of the configuration.
pub(super) struct Section {
    pub(super) name: &'static str,
    /// Comment printed above the section.
    pub(super) about: &'static str,
    /// Its keys in the settings.
    pub(super) keys: Box<KeysOf>,
}

/// The keys of a section.
type KeysOf = dyn Fn(&mut Settings) -> Vec<Key<'_>>;

impl Section {
    pub(super) fn header(&self) -> String {
        match self.name {
            GESTURE => format!("[[{GESTURE}]]"),
            name => format!("[{name}]"),
        }
    }
}

/// Every section, in the order printed.
pub(super) fn sections() -> impl Iterator<Item = Section> {
    let outputs = mien_outputs::table::SECTIONS.iter().map(|section| Section {
        name: section.name,
        about: section.about,
        keys: Box::new(|settings| (section.keys)(&mut settings.outputs)),
    });
    stages().into_iter().chain(outputs).chain(appliance())
}

/// Defines a list of sections; `..settings` inserts the keys that `settings` define themselves.
macro_rules! sections {
    ($list:ident: $s:ident $($section:ident: $section_about:literal { $($name:ident: $about:expr => $kind:expr;)* $(..$more:expr)? })*) => {
        fn $list() -> Vec<Section> {
            vec![$(Section {
                name: stringify!($section),
                about: $section_about,
                keys: Box::new(|$s| {
                    let _ = &$s;
                    let keys = vec![$(Key { name: stringify!($name), about: $about, kind: $kind }),*];
                    keys.into_iter()$(.chain($more.keys()))?.collect()
                }),
            }),*]
        }
    };
}

sections! { stages: s
    sensor: "The source of frames." { ..s.sensor }
    segment: "Head segmentation in the depth picture." {
        max_distance_m: "Maximum distance at which heads are detected." =>
            Kind::number(&mut s.stages.segment.max_distance_m, 0.4, 4.0, "m");
        iterations: "Maximum K-means iterations per frame." => Kind::number(&mut s.stages.segment.iterations, 1.0, 100.0, "");
    }
    pose: "Head pose." {
        method: "Point-to-plane ICP against the learned head, or the paper's point-to-point ICP." =>
            Kind::choice(&mut s.stages.pose.method, &[("plane", pose::Method::Plane), ("paper", pose::Method::Paper), ("image", pose::Method::Image)]);
        smoothing: "Pose filter: none, the paper's window, or adaptive." =>
            Kind::choice(&mut s.stages.pose.smoothing, &[("off", Smoothing::Off), ("window", Smoothing::Window(pose::WINDOW_FRAMES as usize)), ("adaptive", Smoothing::ADAPTIVE)]);
        window_frames: "Length of the paper's window in frames; 1 and 2 do not smooth (window)." =>
            Kind::number(&mut s.stages.pose.window_frames, 1.0, 16.0, "");
        rounds: "Maximum iterations of point-to-point ICP, which stops early when it converges (paper)." =>
            Kind::number(&mut s.stages.pose.rounds, 1.0, 1000.0, "");
        min_agreement: "Agreement with the head model below which the head counts as lost." =>
            Kind::number(&mut s.stages.pose.min_agreement, 0.0, 1.0, "");
        learn_shape: "Whether the size and shape of the user's head are learned (plane)." =>
            Kind::Bool(&mut s.stages.pose.learn_shape);
    }
    landmarks: "The 68 landmarks." {
        method: "Cascade on gradient-orientation patches, or the paper's 2D+3D AAM." =>
            Kind::choice(&mut s.stages.landmarks.method, &[("cascade", landmarks::Method::Cascade), ("paper", landmarks::Method::Paper)]);
        min_confidence: "Confidence below which the face counts as lost." =>
            Kind::number(&mut s.stages.landmarks.cascade.min_confidence, 0.0, 1.0, "");
        still_hz: "Cut-off of the shape filter on a still face; lower is steadier." =>
            Kind::number(&mut s.stages.landmarks.cascade.steadiness.still_hz, 0.05, 30.0, "Hz");
        visibility: "Whether covered regions (mask, dark glasses) are recognised: their units rest and their pixels do not count (cascade)." =>
            Kind::Bool(&mut s.stages.landmarks.cascade.visibility);
    }
    learning: "How each person's ranges are learned." {
        method: "The robust learner, or sections 2.2 to 2.6 of the paper to the letter." =>
            Kind::choice(&mut s.stages.learning.method, &[("robust", expression::Method::Robust), ("paper", expression::Method::Paper)]);
        scale: "Scale by which measures are divided: the frame's eye distance, the learned one, or the method's default." =>
            Kind::choice(&mut s.stages.learning.scale, &[("by-method", Scale::ByMethod), ("frame", Scale::Frame), ("learned", Scale::Learnt)]);
        best_distance_m: "Distance at which samples have full weight, equation (4)." =>
            Kind::number(&mut s.stages.learning.best_distance_m, 0.3, 4.0, "m");
        half_life_s: "Half-life of what was learned, counted while the person is present; 0 disables forgetting." =>
            Kind::number(&mut s.stages.learning.half_life_s, 0.0, 86_400.0, "s");
        range_prior: "Number of half seconds of expression that outweigh the population's range (robust)." =>
            Kind::number(&mut s.stages.learning.range_prior, 0.5, 100.0, "");
        dead_zone: "Dead zone around rest, in standard deviations of the noise (robust)." =>
            Kind::number(&mut s.stages.learning.dead_zone, 0.0, 3.0, "");
        smoothing_hz: "Cut-off of the weight filter on a still face; 0 disables it (robust)." =>
            Kind::number(&mut s.stages.learning.smoothing_hz, 0.0, 30.0, "Hz");
        infer_covered: "Whether the units of a covered mouth are inferred from its last state and the time since, instead of measured (robust)." =>
            Kind::Bool(&mut s.stages.learning.infer_covered);
        compensation_scale: "Spread of compensation samples as a share of the range; 0 is the paper's value (paper)." =>
            Kind::number(&mut s.stages.learning.compensation_scale, 0.0, 1.0, "");
        gap_percent: "l of section 2.5: the gap that cuts off the end of a range, as a share of its width (paper)." =>
            Kind::number(&mut s.stages.learning.scan.gap, 0.0, 100.0, "%");
        count_percent: "k of section 2.5: samples without a gap that end the scan, as a share of all (paper)." =>
            Kind::number(&mut s.stages.learning.scan.count, 0.0, 100.0, "%");
        scanned_percent: "m of section 2.5: maximum samples scanned, as a share of all (paper)." =>
            Kind::number(&mut s.stages.learning.scan.scanned, 0.0, 100.0, "%");
        rest_percent: "Share of samples beyond the rest end of a one-way range; 0 uses l, k and m, as at the other end (paper)." =>
            Kind::number(&mut s.stages.learning.scan.rest, 0.0, 100.0, "%");
        prior_s: "Time over which the population's ranges fade into the person's (paper)." =>
            Kind::number(&mut s.stages.learning.prior_s, 0.0, 60.0, "s");
    }
    users: "Which people are tracked, and what happens when a face is lost." { ..s.stages.users }
    units: "Names and gains of units in the outputs; list only those to change: AU26 = { name = \"jaw\", gain = 1.2 }" {}
}

sections! { appliance: s
    state: "What is kept across restarts about people tracked with a Kinect." { ..s.state }
    status: "Status files." {
        path: "The file; rewritten once a second, with mien.prom for Prometheus beside it; empty = neither." =>
            Kind::Text(&mut s.status_path, "the path of a file in an existing directory, or empty", |_| true);
        ranges: "Whether the file also contains everybody's learned ranges; every user of this machine can read it." =>
            Kind::Bool(&mut s.status_ranges);
    }
    log: "Log on standard error." {
        level: "Lowest severity written; \"trace\" is the same as \"debug\"." =>
            Kind::choice(&mut s.log_level, &[("error", Level::ERROR), ("warn", Level::WARN), ("info", Level::INFO), ("debug", Level::DEBUG), ("trace", Level::TRACE)]);
    }
    gesture: "Expressions that switch something, see docs/gestures.md. At most 16; smile, brows, mouth_open, wink_left,\n# wink_right, blink_long, look_left, look_right, look_up and kiss need only their name." { ..s.gesture() }
}
