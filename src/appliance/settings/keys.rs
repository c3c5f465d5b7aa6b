//! Every key of the configuration: section, name, meaning, unit, range, and where it is stored.
//! One table, so one file: every key is next to the others of its section.

use super::sections::Settings;
use crate::expression::measures::Scale;
use crate::output::osc::Style;
use crate::output::osc::vmc::{Names, Role};
use crate::output::osc::vrchat::{MOST_BITS, Values};
use crate::output::serial;
use crate::pose::smoothing::Smoothing;
use crate::users::Policy;
use crate::{expression, landmarks, pose};

/// Sections in the order they are printed, with a sentence about each.
pub(super) const SECTIONS: &[(&str, &str)] = &[
    ("sensor", "The source of frames."),
    ("segment", "Head segmentation in the depth picture."),
    ("pose", "Head pose."),
    ("landmarks", "The 68 landmarks."),
    ("learning", "How each person's ranges are learned."),
    (
        "users",
        "Which people are tracked, and what happens when a face is lost.",
    ),
    (UNITS, UNITS_ABOUT),
    ("osc", "OSC over UDP, the native schema."),
    ("vmc", "OSC for avatar programs: the VMC protocol."),
    ("vrchat", "OSC for VRChat: Unified Expressions."),
    ("faceosc", "OSC in FaceOSC's format."),
    ("serial", "Serial output."),
    (
        "network",
        "What the outputs below say about the box. They are optional build features, included in the package.",
    ),
    (
        "lights",
        "Lights and servos: which unit drives which channel, for Art-Net and sACN.",
    ),
    ("artnet", "Art-Net, the channels of [lights]."),
    ("sacn", "sACN (E1.31), the channels of [lights]."),
    (
        "live_link",
        "Unreal's Live Link, in the format of the Live Link Face app.",
    ),
    ("websocket", "JSON over WebSocket, for web pages."),
    (
        "page",
        "A page to watch and command the box, for a phone: state, weights, neutral, freeze, forget.",
    ),
    (
        "oscquery",
        "OSCQuery: the OSC addresses with their types, ranges and values, over HTTP.",
    ),
    (
        "discovery",
        "mDNS: the box announces OSC, OSCQuery and WebSocket, if enabled.",
    ),
    (
        "mqtt",
        "MQTT: presence, state, health, weights, and Home Assistant.",
    ),
    (
        "state",
        "What is kept across restarts about people tracked with a Kinect.",
    ),
    ("status", "Status files."),
    ("log", "What is written to standard error."),
];

/// The section whose keys are the units' names.
pub(super) const UNITS: &str = "units";
const UNITS_ABOUT: &str = "Names and gains of units in the outputs; list only those to change: AU26 = { name = \"jaw\", gain = 1.2 }";

/// Type and range of a key's value, and where it is stored.
pub(super) enum Kind<'a> {
    Float {
        value: Number<'a>,
        min: f32,
        max: f32,
        unit: &'static str,
    },
    Integer {
        value: &'a mut u32,
        min: u32,
        max: u32,
        unit: &'static str,
    },
    Bool {
        value: &'a mut bool,
    },
    Text {
        value: &'a mut String,
        form: &'static str,
        valid: fn(&str) -> bool,
    },
    /// One text, or several in an array.
    Texts {
        value: &'a mut Vec<String>,
        form: &'static str,
        valid: fn(&str) -> bool,
        least: usize,
    },
    Choice {
        value: usize,
        names: &'static [&'static str],
        set: fn(&mut Settings, usize),
    },
}

/// A number as the stages store it: single precision for images, double for what accumulates over months.
pub(super) enum Number<'a> {
    Single(&'a mut f32),
    Double(&'a mut f64),
}

impl Number<'_> {
    pub(super) fn set(self, number: f64) {
        match self {
            Self::Single(slot) => *slot = number as f32,
            Self::Double(slot) => *slot = number,
        }
    }

    /// As TOML, always with a decimal point, so that it stays a float.
    pub(super) fn text(&self) -> String {
        match self {
            Self::Single(value) => format!("{value:?}"),
            Self::Double(value) => format!("{value:?}"),
        }
    }
}

/// One key.
pub(super) struct Key {
    pub(super) section: &'static str,
    pub(super) name: &'static str,
    pub(super) about: &'static str,
    pub(super) kind: fn(&mut Settings) -> Kind<'_>,
}

pub(super) const fn key(
    section: &'static str,
    name: &'static str,
    about: &'static str,
    kind: fn(&mut Settings) -> Kind<'_>,
) -> Key {
    Key {
        section,
        name,
        about,
        kind,
    }
}

const LEVELS: [tracing::Level; 5] = [
    tracing::Level::ERROR,
    tracing::Level::WARN,
    tracing::Level::INFO,
    tracing::Level::DEBUG,
    tracing::Level::TRACE,
];

const POLICIES: [Policy; 3] = [Policy::First, Policy::Nearest, Policy::Central];
const POSE_METHODS: [pose::Method; 2] = [pose::Method::Plane, pose::Method::Paper];
const LANDMARK_METHODS: [landmarks::Method; 2] =
    [landmarks::Method::Cascade, landmarks::Method::Paper];
const LEARNING_METHODS: [expression::Method; 2] =
    [expression::Method::Robust, expression::Method::Paper];
const SCALES: [Scale; 3] = [Scale::ByMethod, Scale::Frame, Scale::Learnt];
const NAMES: [Names; 4] = [Names::Arkit, Names::Vrm0, Names::Vrm1, Names::Units];
const VALUES: [Values; 3] = [Values::Float, Values::Binary, Values::Both];
const ROLES: [Role; 2] = [Role::Performer, Role::Assistant];
const SERIAL_STYLES: [serial::Style; 3] = [
    serial::Style::Text,
    serial::Style::Plot,
    serial::Style::Cobs,
];
const STYLES: [Style; 3] = [Style::Vector, Style::Scalar, Style::Both];

pub(super) const MIRROR: &str = "Whether left and right are swapped, as in a mirror.";

pub(super) fn index_of<T: PartialEq>(all: &[T], value: &T) -> usize {
    all.iter().position(|one| one == value).unwrap_or_default()
}

/// Every key, in the order printed.
pub(super) const KEYS: &[Key] = &[
    key(
        "sensor",
        "source",
        "Where frames come from; the option --source takes precedence.",
        |s| Kind::Text {
            value: &mut s.sensor.source,
            form: "\"kinect\", \"kinect:SERIAL\", \"simulated\", \"simulated:SCENE\" or the path of a recording",
            valid: |text| !text.is_empty(),
        },
    ),
    key(
        "sensor",
        "model",
        "Face model file; the option --model takes precedence.",
        |s| Kind::Text {
            value: &mut s.sensor.model,
            form: "a path, or empty for the built-in model",
            valid: |_| true,
        },
    ),
    key(
        "sensor",
        "near_mode",
        "Kinect for Windows: measure from 0.4 m instead of 0.8 m.",
        |s| Kind::Bool {
            value: &mut s.sensor.kinect.near_mode,
        },
    ),
    key(
        "sensor",
        "freeze_exposure",
        "Whether exposure and white balance are locked while a face is tracked.",
        |s| Kind::Bool {
            value: &mut s.sensor.kinect.freeze_exposure,
        },
    ),
    key(
        "sensor",
        "set_tilt",
        "Whether the motor tilts the Kinect when it is opened.",
        |s| Kind::Bool {
            value: &mut s.sensor.kinect.set_tilt,
        },
    ),
    key(
        "sensor",
        "tilt_deg",
        "The tilt, relative to the horizon.",
        |s| Kind::Float {
            value: Number::Single(&mut s.sensor.kinect.tilt_deg),
            min: -31.0,
            max: 31.0,
            unit: "degrees",
        },
    ),
    key(
        "sensor",
        "reset_audio",
        "Second series and Kinect for Windows: reset the audio device on opening, for sensors that otherwise stop streaming.",
        |s| Kind::Bool {
            value: &mut s.sensor.kinect.reset_audio,
        },
    ),
    key(
        "segment",
        "max_distance_m",
        "Maximum distance at which heads are detected.",
        |s| single(&mut s.segment.max_distance_m, 0.4, 4.0, "m"),
    ),
    key(
        "segment",
        "iterations",
        "Maximum K-means iterations per frame.",
        |s| Kind::Integer {
            value: &mut s.segment.iterations,
            min: 1,
            max: 100,
            unit: "",
        },
    ),
    key(
        "pose",
        "method",
        "Point-to-plane ICP against the learned head, or the paper's point-to-point ICP.",
        |s| Kind::Choice {
            value: index_of(&POSE_METHODS, &s.pose.method),
            names: &["plane", "paper"],
            set: |s, index| s.pose.method = POSE_METHODS[index],
        },
    ),
    key(
        "pose",
        "smoothing",
        "Pose filter: none, the paper's window, or adaptive.",
        |s| Kind::Choice {
            value: match s.pose.smoothing {
                Smoothing::Off => 0,
                Smoothing::Window(_) => 1,
                Smoothing::Adaptive { .. } => 2,
            },
            names: &["off", "window", "adaptive"],
            set: |s, index| {
                s.pose.smoothing = [
                    Smoothing::Off,
                    Smoothing::Window(pose::WINDOW_FRAMES as usize),
                    Smoothing::default(),
                ][index]
            },
        },
    ),
    key(
        "pose",
        "window_frames",
        "Length of the paper's window in frames; the delay is (frames - 1) / 3 frames (window).",
        |s| Kind::Integer {
            value: &mut s.pose.window_frames,
            min: 1,
            max: 16,
            unit: "",
        },
    ),
    key(
        "pose",
        "rounds",
        "Maximum iterations of point-to-point ICP, which stops early when it converges (paper).",
        |s| Kind::Integer {
            value: &mut s.pose.rounds,
            min: 1,
            max: 1000,
            unit: "",
        },
    ),
    key(
        "pose",
        "min_agreement",
        "Agreement with the head model below which the head counts as lost.",
        |s| single(&mut s.pose.min_agreement, 0.0, 1.0, ""),
    ),
    key(
        "pose",
        "learn_shape",
        "Whether the size and shape of the user's head are learned (plane).",
        |s| Kind::Bool {
            value: &mut s.pose.learn_shape,
        },
    ),
    key(
        "landmarks",
        "method",
        "Cascade on gradient-orientation patches, or the paper's 2D+3D AAM.",
        |s| Kind::Choice {
            value: index_of(&LANDMARK_METHODS, &s.landmarks.method),
            names: &["cascade", "paper"],
            set: |s, index| s.landmarks.method = LANDMARK_METHODS[index],
        },
    ),
    key(
        "landmarks",
        "min_confidence",
        "Confidence below which the face counts as lost.",
        |s| single(&mut s.landmarks.cascade.min_confidence, 0.0, 1.0, ""),
    ),
    key(
        "landmarks",
        "still_hz",
        "Cut-off of the shape filter on a still face; lower is steadier.",
        |s| {
            single(
                &mut s.landmarks.cascade.steadiness.still_hz,
                0.05,
                30.0,
                "Hz",
            )
        },
    ),
    key(
        "learning",
        "method",
        "The robust learner, or sections 2.2 to 2.6 of the paper to the letter.",
        |s| Kind::Choice {
            value: index_of(&LEARNING_METHODS, &s.learning.method),
            names: &["robust", "paper"],
            set: |s, index| s.learning.method = LEARNING_METHODS[index],
        },
    ),
    key(
        "learning",
        "scale",
        "What measures are divided by: the frame's eye distance, the learned one, or the method's default.",
        |s| Kind::Choice {
            value: index_of(&SCALES, &s.learning.scale),
            names: &["by-method", "frame", "learned"],
            set: |s, index| s.learning.scale = SCALES[index],
        },
    ),
    key(
        "learning",
        "best_distance_m",
        "Distance at which samples have full weight, equation (4).",
        |s| double(&mut s.learning.best_distance_m, 0.3, 4.0, "m"),
    ),
    key(
        "learning",
        "half_life_s",
        "Half-life of what was learned, counted while the person is present; 0 never forgets.",
        |s| double(&mut s.learning.half_life_s, 0.0, 86_400.0, "s"),
    ),
    key(
        "learning",
        "range_prior",
        "Half seconds of expression that outweigh the population's range (robust).",
        |s| double(&mut s.learning.range_prior, 0.5, 100.0, ""),
    ),
    key(
        "learning",
        "dead_zone",
        "Dead zone around rest, in deviations of the noise (robust).",
        |s| double(&mut s.learning.dead_zone, 0.0, 3.0, ""),
    ),
    key(
        "learning",
        "smoothing_hz",
        "Cut-off of the weight filter on a still face; 0 disables it (robust).",
        |s| double(&mut s.learning.smoothing_hz, 0.0, 30.0, "Hz"),
    ),
    key(
        "learning",
        "infer_covered",
        "Whether the units of a covered mouth are inferred from its last state and the time since, instead of measured (robust).",
        |s| Kind::Bool {
            value: &mut s.learning.infer_covered,
        },
    ),
    key(
        "learning",
        "compensation_scale",
        "Spread of compensation samples as a share of the range; 0 is the paper's value (paper).",
        |s| double(&mut s.learning.compensation_scale, 0.0, 1.0, ""),
    ),
    key(
        "learning",
        "gap_percent",
        "l of section 2.5: the gap that cuts off the end of a range, as a share of its width (paper).",
        |s| double(&mut s.learning.scan.gap, 0.0, 100.0, "%"),
    ),
    key(
        "learning",
        "count_percent",
        "k of section 2.5: samples without a gap that end the scan, as a share of all (paper).",
        |s| double(&mut s.learning.scan.count, 0.0, 100.0, "%"),
    ),
    key(
        "learning",
        "scanned_percent",
        "m of section 2.5: maximum samples scanned, as a share of all (paper).",
        |s| double(&mut s.learning.scan.scanned, 0.0, 100.0, "%"),
    ),
    key(
        "learning",
        "rest_percent",
        "Share of samples beyond the rest end of a one-way range; 0 uses l, k and m, as at the other end (paper).",
        |s| double(&mut s.learning.scan.rest, 0.0, 100.0, "%"),
    ),
    key(
        "learning",
        "prior_s",
        "Time over which the population's ranges fade into the person's (paper).",
        |s| double(&mut s.learning.prior_s, 0.0, 60.0, "s"),
    ),
    key(
        "users",
        "most",
        "Maximum number of people tracked at once; with 1, whoever appears gets slot 0.",
        |s| Kind::Integer {
            value: &mut s.users.most,
            min: 1,
            max: 4,
            unit: "",
        },
    ),
    key(
        "users",
        "single",
        "Which person a single-person output sends (vmc, vrchat, faceosc, serial): the first to arrive, the nearest, or the most central.",
        |s| Kind::Choice {
            value: index_of(&POLICIES, &s.users.single),
            names: &["first", "nearest", "central"],
            set: |s, index| s.users.single = POLICIES[index],
        },
    ),
    key(
        "users",
        "hold_s",
        "How long values are held after the face was last seen.",
        |s| single(&mut s.users.hold_s, 0.0, 10.0, "s"),
    ),
    key(
        "users",
        "forget_s",
        "How long a lost person then keeps their slot.",
        |s| single(&mut s.users.forget_s, 0.0, 3600.0, "s"),
    ),
    key(
        "users",
        "remember_s",
        "How long the ranges and head shape of a person who left are kept; recognised by the head, they get their ranges and slot back; 0 never.",
        |s| single(&mut s.users.remember_s, 0.0, 86_400.0, "s"),
    ),
    key("osc", "enabled", "Whether this output is enabled.", |s| {
        Kind::Bool {
            value: &mut s.osc.enabled,
        }
    }),
    key(
        "osc",
        "target",
        "Destinations: hosts, broadcast addresses or multicast groups.",
        |s| targets(&mut s.osc.targets),
    ),
    key("osc", "prefix", "Prefix of every address.", |s| {
        Kind::Text {
            value: &mut s.osc.prefix,
            form: "a slash and a name",
            valid: |text| text.len() > 1 && text.starts_with('/') && !text.ends_with('/'),
        }
    }),
    key(
        "osc",
        "style",
        "All weights in one message, each under its own address, or both.",
        |s| Kind::Choice {
            value: index_of(&STYLES, &s.osc.style),
            names: &["vector", "scalar", "both"],
            set: |s, index| s.osc.style = STYLES[index],
        },
    ),
    key(
        "osc",
        "ranges",
        "Whether learned ranges are sent, every 5 s.",
        |s| Kind::Bool {
            value: &mut s.osc.ranges,
        },
    ),
    key(
        "osc",
        "commands",
        "Whether the commands /face/cmd/forget, freeze, neutral and schema are accepted.",
        |s| Kind::Bool {
            value: &mut s.osc.commands,
        },
    ),
    key(
        "osc",
        "listen",
        "Address on which these commands are received; 127.0.0.1 accepts this machine only.",
        |s| Kind::Text {
            value: &mut s.osc.listen,
            form: "address:port",
            valid: |text| text.parse::<std::net::SocketAddr>().is_ok(),
        },
    ),
    key("osc", "mirror", MIRROR, |s| Kind::Bool {
        value: &mut s.osc.view.mirror,
    }),
    key(
        "osc",
        "hold_s",
        "How long the last weights of a lost face are held.",
        |s| single(&mut s.osc.loss.hold_s, 0.0, 60.0, "s"),
    ),
    key(
        "osc",
        "decay_s",
        "How long they then take to fade to neutral.",
        |s| single(&mut s.osc.loss.decay_s, 0.0, 60.0, "s"),
    ),
    key("vmc", "enabled", "Whether this output is enabled.", |s| {
        Kind::Bool {
            value: &mut s.vmc.enabled,
        }
    }),
    key(
        "vmc",
        "target",
        "Destinations: hosts, broadcast addresses or multicast groups.",
        |s| targets(&mut s.vmc.targets),
    ),
    key(
        "vmc",
        "role",
        "This program's role, as the receiver sees it.",
        |s| Kind::Choice {
            value: index_of(&ROLES, &s.vmc.role),
            names: &["performer", "assistant"],
            set: |s, index| s.vmc.role = ROLES[index],
        },
    ),
    key(
        "vmc",
        "names",
        "Names of the blend shapes: ARKit's, VRM avatars', or the units' own.",
        |s| Kind::Choice {
            value: index_of(&NAMES, &s.vmc.names),
            names: &["arkit", "vrm0", "vrm1", "units"],
            set: |s, index| s.vmc.names = NAMES[index],
        },
    ),
    key("vmc", "mirror", MIRROR, |s| Kind::Bool {
        value: &mut s.vmc.view.mirror,
    }),
    key(
        "vmc",
        "hold_s",
        "How long the last weights of a lost face are held.",
        |s| single(&mut s.vmc.loss.hold_s, 0.0, 60.0, "s"),
    ),
    key(
        "vmc",
        "decay_s",
        "How long they then take to fade to neutral.",
        |s| single(&mut s.vmc.loss.decay_s, 0.0, 60.0, "s"),
    ),
    key(
        "vrchat",
        "enabled",
        "Whether this output is enabled.",
        |s| Kind::Bool {
            value: &mut s.vrchat.enabled,
        },
    ),
    key(
        "vrchat",
        "target",
        "Destinations: hosts, broadcast addresses or multicast groups.",
        |s| targets(&mut s.vrchat.targets),
    ),
    key(
        "vrchat",
        "prefix",
        "Prefix that the avatar's author put before the parameter names.",
        |s| Kind::Text {
            value: &mut s.vrchat.prefix,
            form: "empty or ending in a slash",
            valid: |text| text.is_empty() || text.ends_with('/'),
        },
    ),
    key(
        "vrchat",
        "values",
        "Parameters as floats, as binary switches, or both.",
        |s| Kind::Choice {
            value: index_of(&VALUES, &s.vrchat.values),
            names: &["float", "binary", "both"],
            set: |s, index| s.vrchat.values = VALUES[index],
        },
    ),
    key(
        "vrchat",
        "bits",
        "Binary switches per parameter, besides its sign.",
        |s| Kind::Integer {
            value: &mut s.vrchat.bits,
            min: 1,
            max: MOST_BITS,
            unit: "",
        },
    ),
    key("vrchat", "mirror", MIRROR, |s| Kind::Bool {
        value: &mut s.vrchat.view.mirror,
    }),
    key(
        "vrchat",
        "hold_s",
        "How long the last weights of a lost face are held.",
        |s| single(&mut s.vrchat.loss.hold_s, 0.0, 60.0, "s"),
    ),
    key(
        "vrchat",
        "decay_s",
        "How long they then take to fade to neutral.",
        |s| single(&mut s.vrchat.loss.decay_s, 0.0, 60.0, "s"),
    ),
    key(
        "faceosc",
        "enabled",
        "Whether this output is enabled.",
        |s| Kind::Bool {
            value: &mut s.faceosc.enabled,
        },
    ),
    key(
        "faceosc",
        "target",
        "Destinations: hosts, broadcast addresses or multicast groups.",
        |s| targets(&mut s.faceosc.targets),
    ),
    key("faceosc", "mirror", MIRROR, |s| Kind::Bool {
        value: &mut s.faceosc.mirror,
    }),
    key("faceosc", "hold_s", "How long a lost face is held.", |s| {
        single(&mut s.faceosc.hold_s, 0.0, 60.0, "s")
    }),
    key(
        "serial",
        "port",
        "The port; empty = no serial output.",
        |s| Kind::Text {
            value: &mut s.serial.port,
            form: "the path of a port, like \"/dev/serial/by-id/usb-...\" or \"/dev/ttyUSB0\", tcp:host:port, or empty",
            valid: |text| text.strip_prefix("tcp:").is_none_or(is_host_port),
        },
    ),
    key("serial", "baud", "Baud rate.", |s| Kind::Integer {
        value: &mut s.serial.baud,
        min: 1200,
        max: 4_000_000,
        unit: "bit/s",
    }),
    key(
        "serial",
        "style",
        "Lines with checksums, lines for the Arduino plotter, or binary frames.",
        |s| Kind::Choice {
            value: index_of(&SERIAL_STYLES, &s.serial.style),
            names: &["text", "plot", "cobs"],
            set: |s, index| s.serial.style = SERIAL_STYLES[index],
        },
    ),
    key(
        "serial",
        "full",
        "Value of a weight of 1 in text lines; 100 gives percentages, in tenths if the line is fast enough; from 128 numbers are whole.",
        |s| Kind::Integer {
            value: &mut s.serial.full,
            min: 10,
            max: 10_000,
            unit: "",
        },
    ),
    key("serial", "pose", "Whether head poses are sent too.", |s| {
        Kind::Bool {
            value: &mut s.serial.pose,
        }
    }),
    key(
        "serial",
        "units",
        "Units to send, most important first; empty = all.",
        |s| Kind::Texts {
            value: &mut s.serial.units,
            form: "units, like [\"AU26\", \"AU25\"]",
            valid: super::units::is_unit,
            least: 0,
        },
    ),
    key(
        "serial",
        "min_rate_hz",
        "Frame rate below which units are left out on a slow line.",
        |s| single(&mut s.serial.min_rate_hz, 0.0, 30.0, "Hz"),
    ),
    key(
        "serial",
        "dtr",
        "Whether DTR is raised on opening, which resets many boards; otherwise it is left unchanged.",
        |s| Kind::Bool {
            value: &mut s.serial.dtr,
        },
    ),
    key("serial", "mirror", MIRROR, |s| Kind::Bool {
        value: &mut s.serial.view.mirror,
    }),
    key(
        "serial",
        "hold_s",
        "How long the last weights of a lost face are held.",
        |s| single(&mut s.serial.loss.hold_s, 0.0, 60.0, "s"),
    ),
    key(
        "serial",
        "decay_s",
        "How long they then take to fade to neutral.",
        |s| single(&mut s.serial.loss.decay_s, 0.0, 60.0, "s"),
    ),
    key(
        "state",
        "persist",
        "Whether the ranges and head shape of people who left are saved for users.remember_s, so that a restart forgets nobody.",
        |s| Kind::Bool {
            value: &mut s.state.persist,
        },
    ),
    key(
        "state",
        "path",
        "The file; rewritten once a minute and on exit.",
        |s| Kind::Text {
            value: &mut s.state.path,
            form: "the path of a file in an existing directory",
            valid: |path| !path.is_empty(),
        },
    ),
    key(
        "status",
        "path",
        "The file; rewritten once a second, with mien.prom for Prometheus beside it; empty = neither.",
        |s| Kind::Text {
            value: &mut s.status.path,
            form: "the path of a file in an existing directory, or empty",
            valid: |_| true,
        },
    ),
    key(
        "log",
        "level",
        "Lowest severity written; \"trace\" is the same as \"debug\".",
        |s| Kind::Choice {
            value: index_of(&LEVELS, &s.log.level),
            names: &["error", "warn", "info", "debug", "trace"],
            set: |s, index| s.log.level = LEVELS[index],
        },
    ),
];

pub(super) fn single<'a>(value: &'a mut f32, min: f32, max: f32, unit: &'static str) -> Kind<'a> {
    Kind::Float {
        value: Number::Single(value),
        min,
        max,
        unit,
    }
}

fn double<'a>(value: &'a mut f64, min: f32, max: f32, unit: &'static str) -> Kind<'a> {
    Kind::Float {
        value: Number::Double(value),
        min,
        max,
        unit,
    }
}

pub(super) fn targets(value: &mut Vec<String>) -> Kind<'_> {
    Kind::Texts {
        value,
        form: "host:port, or several as [\"host:port\", \"host:port\"]",
        valid: is_host_port,
        least: 1,
    }
}

pub(super) fn is_host_port(text: &str) -> bool {
    text.rsplit_once(':')
        .is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok())
}
