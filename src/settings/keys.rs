//! Every key of the configuration: section, name, meaning, unit, range, place.
//! One table, so one file: every key stands beside the others of its section.

use super::Settings;
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
    ("sensor", "Where frames come from."),
    ("segment", "Finding the head in depth."),
    ("pose", "Where the head is."),
    ("landmarks", "The 68 points."),
    ("learning", "How each person's ranges are learned."),
    (
        "users",
        "Who is followed, and what happens when a face is lost.",
    ),
    (UNITS, UNITS_ABOUT),
    ("osc", "OSC over UDP, the native schema."),
    ("vmc", "OSC for avatar programmes, VMC protocol."),
    ("vrchat", "OSC for VRChat, Unified Expressions."),
    ("faceosc", "OSC as FaceOSC sends it."),
    ("serial", "A serial port."),
    (
        "network",
        "What the wires below show of the box; they are features of the build, and on in the package.",
    ),
    (
        "lights",
        "Lights and servos: which unit drives which channel, for Art-Net and sACN.",
    ),
    ("artnet", "Art-Net, the channels of [lights]."),
    ("sacn", "sACN (E1.31), the channels of [lights]."),
    (
        "live_link",
        "Unreal's Live Link, as the app Live Link Face sends it.",
    ),
    ("websocket", "JSON over WebSocket, for pages."),
    (
        "oscquery",
        "OSCQuery: the OSC addresses, their types, ranges and values, over HTTP.",
    ),
    (
        "discovery",
        "mDNS: the box announces OSC, OSCQuery and WebSocket, whichever are on.",
    ),
    (
        "mqtt",
        "MQTT: presence, state, health, weights, and Home Assistant.",
    ),
    (
        "state",
        "What outlives a restart, of people before a Kinect.",
    ),
    ("status", "What the programme tells of itself, in files."),
    ("log", "What is written to standard error."),
];

/// The section whose keys are the units' names.
pub(super) const UNITS: &str = "units";
const UNITS_ABOUT: &str = "Names and gains of units on the wires, for those to change: AU26 = { name = \"jaw\", gain = 1.2 }";

/// What a key may hold and where it is kept.
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

/// A number as the stages hold it: single precision about pictures, double about what goes on for months.
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

    /// As TOML, always with a point, so that it stays a number with one.
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

pub(super) const MIRROR: &str = "Whether left and right change places, as in a mirror.";

pub(super) fn index_of<T: PartialEq>(all: &[T], value: &T) -> usize {
    all.iter().position(|one| one == value).unwrap_or_default()
}

/// Every key, in the order printed.
pub(super) const KEYS: &[Key] = &[
    key(
        "sensor",
        "source",
        "Where frames come from; --source goes before it.",
        |s| Kind::Text {
            value: &mut s.sensor.source,
            form: "\"kinect\", \"kinect:SERIAL\", \"simulated\", \"simulated:SCENE\" or the path of a recording",
            valid: |text| !text.is_empty(),
        },
    ),
    key(
        "sensor",
        "model",
        "Face model file; --model goes before it.",
        |s| Kind::Text {
            value: &mut s.sensor.model,
            form: "a path, or empty for the built-in model",
            valid: |_| true,
        },
    ),
    key(
        "sensor",
        "near_mode",
        "Kinect for Windows: measure from 0.4 m on instead of 0.8 m.",
        |s| Kind::Bool {
            value: &mut s.sensor.kinect.near_mode,
        },
    ),
    key(
        "sensor",
        "freeze_exposure",
        "Whether exposure and white balance are held while a face is tracked.",
        |s| Kind::Bool {
            value: &mut s.sensor.kinect.freeze_exposure,
        },
    ),
    key(
        "sensor",
        "set_tilt",
        "Whether the Kinect's motor is moved when it is opened.",
        |s| Kind::Bool {
            value: &mut s.sensor.kinect.set_tilt,
        },
    ),
    key(
        "sensor",
        "tilt_deg",
        "Where to, against the horizon.",
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
        "Second series and Kinect for Windows: reset the audio device on opening; for units that stop streaming without.",
        |s| Kind::Bool {
            value: &mut s.sensor.kinect.reset_audio,
        },
    ),
    key(
        "segment",
        "max_distance_m",
        "Nobody is looked for beyond this distance.",
        |s| single(&mut s.segment.max_distance_m, 0.4, 4.0, "m"),
    ),
    key(
        "segment",
        "iterations",
        "Rounds of K-means per frame, at most.",
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
        "Point-to-plane against the learned head, or the paper's point-to-point.",
        |s| Kind::Choice {
            value: index_of(&POSE_METHODS, &s.pose.method),
            names: &["plane", "paper"],
            set: |s, index| s.pose.method = POSE_METHODS[index],
        },
    ),
    key(
        "pose",
        "smoothing",
        "Filter of the pose: none, the paper's window, or adaptive.",
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
        "Frames of the paper's window; the delay is (frames - 1) / 3 frames (window).",
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
        "Rounds of point-to-point alignment at most; it ends where it stands still (paper).",
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
        "Whether size and shape of the user's head are learned (plane).",
        |s| Kind::Bool {
            value: &mut s.pose.learn_shape,
        },
    ),
    key(
        "landmarks",
        "method",
        "Cascade on orientation patches, or the paper's 2D+3D AAM.",
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
        "What measures are divided by: the frame's eye distance, the learned one, or as the method has it.",
        |s| Kind::Choice {
            value: index_of(&SCALES, &s.learning.scale),
            names: &["by-method", "frame", "learned"],
            set: |s, index| s.learning.scale = SCALES[index],
        },
    ),
    key(
        "learning",
        "best_distance_m",
        "Distance at which samples count fully, equation (4).",
        |s| double(&mut s.learning.best_distance_m, 0.3, 4.0, "m"),
    ),
    key(
        "learning",
        "half_life_s",
        "Half-life of what was learned, in time of presence; 0 never forgets.",
        |s| double(&mut s.learning.half_life_s, 0.0, 86_400.0, "s"),
    ),
    key(
        "learning",
        "range_prior",
        "How many half seconds of expression outweigh the population's range (robust).",
        |s| double(&mut s.learning.range_prior, 0.5, 100.0, ""),
    ),
    key(
        "learning",
        "dead_zone",
        "Dead zone about rest, in deviations of the noise (robust).",
        |s| double(&mut s.learning.dead_zone, 0.0, 3.0, ""),
    ),
    key(
        "learning",
        "smoothing_hz",
        "Cut-off of the weights' filter on a still face; 0 switches it off (robust).",
        |s| double(&mut s.learning.smoothing_hz, 0.0, 30.0, "Hz"),
    ),
    key(
        "learning",
        "infer_covered",
        "Whether the units of a covered mouth are inferred from how it was and for how long, instead of read (robust).",
        |s| Kind::Bool {
            value: &mut s.learning.infer_covered,
        },
    ),
    key(
        "learning",
        "compensation_scale",
        "Spread of compensating samples as a share of the range; 0 is the paper's (paper).",
        |s| double(&mut s.learning.compensation_scale, 0.0, 1.0, ""),
    ),
    key(
        "learning",
        "gap_percent",
        "l of section 2.5: a gap that cuts the end of a range off, of its width (paper).",
        |s| double(&mut s.learning.scan.gap, 0.0, 100.0, "%"),
    ),
    key(
        "learning",
        "count_percent",
        "k of section 2.5: samples without a gap that end the scan, of all (paper).",
        |s| double(&mut s.learning.scan.count, 0.0, 100.0, "%"),
    ),
    key(
        "learning",
        "scanned_percent",
        "m of section 2.5: samples scanned at most, of all (paper).",
        |s| double(&mut s.learning.scan.scanned, 0.0, 100.0, "%"),
    ),
    key(
        "users",
        "most",
        "People followed at once, at most; with 1 whoever comes has slot 0.",
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
        "Whom wires show that have room for one (vmc, vrchat, faceosc, serial): who came first, is nearest, or in the middle.",
        |s| Kind::Choice {
            value: index_of(&POLICIES, &s.users.single),
            names: &["first", "nearest", "central"],
            set: |s, index| s.users.single = POLICIES[index],
        },
    ),
    key(
        "users",
        "hold_s",
        "How long values are kept after the face was last seen.",
        |s| single(&mut s.users.hold_s, 0.0, 10.0, "s"),
    ),
    key(
        "users",
        "forget_s",
        "How long a lost person keeps their slot after that.",
        |s| single(&mut s.users.forget_s, 0.0, 3600.0, "s"),
    ),
    key(
        "users",
        "remember_s",
        "How long a person who left is known again by the shape of the head, and gets ranges and slot back; 0 never.",
        |s| single(&mut s.users.remember_s, 0.0, 86_400.0, "s"),
    ),
    key("osc", "enabled", "Whether anything is sent.", |s| {
        Kind::Bool {
            value: &mut s.osc.enabled,
        }
    }),
    key(
        "osc",
        "target",
        "Where to: hosts, broadcast addresses or multicast groups.",
        |s| targets(&mut s.osc.targets),
    ),
    key("osc", "prefix", "What every address starts with.", |s| {
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
        "Whether /face/cmd/forget, freeze, neutral and schema are listened for.",
        |s| Kind::Bool {
            value: &mut s.osc.commands,
        },
    ),
    key(
        "osc",
        "listen",
        "Where they are listened for; 127.0.0.1 hears this machine only.",
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
        "How long the last weights of a lost face are kept.",
        |s| single(&mut s.osc.loss.hold_s, 0.0, 60.0, "s"),
    ),
    key(
        "osc",
        "decay_s",
        "How long they then take to fade to neutral.",
        |s| single(&mut s.osc.loss.decay_s, 0.0, 60.0, "s"),
    ),
    key("vmc", "enabled", "Whether anything is sent.", |s| {
        Kind::Bool {
            value: &mut s.vmc.enabled,
        }
    }),
    key(
        "vmc",
        "target",
        "Where to: hosts, broadcast addresses or multicast groups.",
        |s| targets(&mut s.vmc.targets),
    ),
    key(
        "vmc",
        "role",
        "What this programme is to the receiver.",
        |s| Kind::Choice {
            value: index_of(&ROLES, &s.vmc.role),
            names: &["performer", "assistant"],
            set: |s, index| s.vmc.role = ROLES[index],
        },
    ),
    key(
        "vmc",
        "names",
        "Whose names the blend shapes have: ARKit's, VRM avatars', or the units' own.",
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
        "How long the last weights of a lost face are kept.",
        |s| single(&mut s.vmc.loss.hold_s, 0.0, 60.0, "s"),
    ),
    key(
        "vmc",
        "decay_s",
        "How long they then take to fade to neutral.",
        |s| single(&mut s.vmc.loss.decay_s, 0.0, 60.0, "s"),
    ),
    key("vrchat", "enabled", "Whether anything is sent.", |s| {
        Kind::Bool {
            value: &mut s.vrchat.enabled,
        }
    }),
    key(
        "vrchat",
        "target",
        "Where to: hosts, broadcast addresses or multicast groups.",
        |s| targets(&mut s.vrchat.targets),
    ),
    key(
        "vrchat",
        "prefix",
        "What the avatar's author put before the names.",
        |s| Kind::Text {
            value: &mut s.vrchat.prefix,
            form: "empty or ending in a slash",
            valid: |text| text.is_empty() || text.ends_with('/'),
        },
    ),
    key(
        "vrchat",
        "values",
        "Parameters as numbers, made of switches, or both.",
        |s| Kind::Choice {
            value: index_of(&VALUES, &s.vrchat.values),
            names: &["float", "binary", "both"],
            set: |s, index| s.vrchat.values = VALUES[index],
        },
    ),
    key(
        "vrchat",
        "bits",
        "Switches of a parameter besides its sign.",
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
        "How long the last weights of a lost face are kept.",
        |s| single(&mut s.vrchat.loss.hold_s, 0.0, 60.0, "s"),
    ),
    key(
        "vrchat",
        "decay_s",
        "How long they then take to fade to neutral.",
        |s| single(&mut s.vrchat.loss.decay_s, 0.0, 60.0, "s"),
    ),
    key("faceosc", "enabled", "Whether anything is sent.", |s| {
        Kind::Bool {
            value: &mut s.faceosc.enabled,
        }
    }),
    key(
        "faceosc",
        "target",
        "Where to: hosts, broadcast addresses or multicast groups.",
        |s| targets(&mut s.faceosc.targets),
    ),
    key("faceosc", "mirror", MIRROR, |s| Kind::Bool {
        value: &mut s.faceosc.mirror,
    }),
    key("faceosc", "hold_s", "How long a lost face is kept.", |s| {
        single(&mut s.faceosc.hold_s, 0.0, 60.0, "s")
    }),
    key(
        "serial",
        "port",
        "Where to; empty = no serial output.",
        |s| Kind::Text {
            value: &mut s.serial.port,
            form: "the path of a port, like \"/dev/serial/by-id/usb-...\" or \"/dev/ttyUSB0\", tcp:host:port, or empty",
            valid: |text| text.strip_prefix("tcp:").is_none_or(is_host_port),
        },
    ),
    key("serial", "baud", "Speed.", |s| Kind::Integer {
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
        "What a weight of 1 is in lines; 100 are whole percents.",
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
        "Units to send, the most important first; empty = all.",
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
        "Frames a second below which units are left out on a slow line.",
        |s| single(&mut s.serial.min_rate_hz, 0.0, 30.0, "Hz"),
    ),
    key(
        "serial",
        "dtr",
        "Whether DTR is raised on opening, which resets many boards; else it stays as it is.",
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
        "How long the last weights of a lost face are kept.",
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
        "Whether ranges and head shape of those who left are saved, for users.remember_s, so that a restart forgets nobody.",
        |s| Kind::Bool {
            value: &mut s.state.persist,
        },
    ),
    key(
        "state",
        "path",
        "The file; rewritten once a minute and at the end.",
        |s| Kind::Text {
            value: &mut s.state.path,
            form: "the path of a file in an existing directory",
            valid: |path| !path.is_empty(),
        },
    ),
    key(
        "status",
        "path",
        "Rewritten once a second, with mien.prom for Prometheus beside it; empty = neither.",
        |s| Kind::Text {
            value: &mut s.status.path,
            form: "the path of a file in an existing directory, or empty",
            valid: |_| true,
        },
    ),
    key("log", "level", "Least severity written.", |s| {
        Kind::Choice {
            value: index_of(&LEVELS, &s.log.level),
            names: &["error", "warn", "info", "debug", "trace"],
            set: |s, index| s.log.level = LEVELS[index],
        }
    }),
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
