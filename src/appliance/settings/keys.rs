//! Every key of the configuration: section, name, meaning, unit, range, and where it is stored.
//!
//! One table. A row is `name: meaning => kind of value;`; printing, reading and `config/mien.toml` follow its order.

use tracing::Level;

use super::gestures;
use super::sections::Settings;
use super::units::is_unit;
use crate::base::capacity::UNITS as UNITS_MOST;
use crate::expression::measures::Scale;
use crate::output::gesture::{LEVELS, Person, Press};
use crate::output::osc::Style;
use crate::output::osc::vmc::{Names, Role};
use crate::output::osc::vrchat::{MOST_BITS, Values};
use crate::output::serial;
use crate::pose::smoothing::Smoothing;
use crate::users::Policy;
use crate::{expression, landmarks, pose};

/// Most targets of an output; one given by name has a thread of its own.
const TARGETS_MOST: usize = 16;
/// The section whose keys are the units' names.
pub(super) const UNITS: &str = "units";

/// The section that is an array of tables.
pub(super) const GESTURE: &str = "gesture";

/// A section, with a sentence about it.
pub(super) struct Section {
    pub(super) name: &'static str,
    pub(super) about: &'static str,
    pub(super) keys: &'static [Key],
}

impl Section {
    pub(super) fn header(&self) -> String {
        match self.name {
            GESTURE => format!("[[{GESTURE}]]"),
            name => format!("[{name}]"),
        }
    }
}

/// One key.
pub(super) struct Key {
    pub(super) name: &'static str,
    pub(super) about: &'static str,
    pub(super) kind: fn(&mut Settings) -> Kind<'_>,
}

/// Type and range of a key's value, and where it is stored.
pub(super) enum Kind<'a> {
    /// From the least to the most, and in which unit.
    Number(Number<'a>, [f32; 2], &'static str),
    Bool(&'a mut bool),
    /// What it looks like, and whether one does.
    Text(&'a mut String, &'static str, fn(&str) -> bool),
    /// One text, or several in an array, from so many to so many.
    Texts(
        &'a mut Vec<String>,
        &'static str,
        fn(&str) -> bool,
        [usize; 2],
    ),
    /// The place of the present name among those that there are; what stores another.
    Choice(usize, Vec<&'static str>, Box<dyn FnOnce(usize) + 'a>),
}

/// A number as the stages store it: single precision for images, double for what accumulates over months.
pub(super) enum Number<'a> {
    Whole(&'a mut u32),
    Single(&'a mut f32),
    Double(&'a mut f64),
}

impl<'a> From<&'a mut f32> for Number<'a> {
    fn from(value: &'a mut f32) -> Self {
        Self::Single(value)
    }
}

impl<'a> From<&'a mut f64> for Number<'a> {
    fn from(value: &'a mut f64) -> Self {
        Self::Double(value)
    }
}

impl Number<'_> {
    pub(super) fn set(self, number: f64) {
        match self {
            Self::Whole(slot) => *slot = number as u32,
            Self::Single(slot) => *slot = number as f32,
            Self::Double(slot) => *slot = number,
        }
    }

    /// As TOML: a float always with a decimal point, so that it stays one.
    pub(super) fn text(&self) -> String {
        match self {
            Self::Whole(value) => value.to_string(),
            Self::Single(value) => format!("{value:?}"),
            Self::Double(value) => format!("{value:?}"),
        }
    }
}

const ENABLED: &str = "Whether this output is enabled.";
const SERVES: &str = "Whether this server is enabled.";
const TARGET: &str = "Destinations: hosts, broadcast addresses or multicast groups.";
const DERIVED: &str = "Whether ARKit shapes that are not measured are derived from related ones, such as raised cheeks from a smile.";
const MIRROR: &str = "Whether left and right are swapped, as in a mirror.";
const FILE: &str = "the path of a file, or empty";
const LISTEN: &str =
    "Address to serve on; 127.0.0.1 serves this machine only, 0.0.0.0 anyone who can reach it.";

/// Sections of keys; `..view` stands for the keys of a [`View`](crate::output::View).
macro_rules! sections {
    ($s:ident $($section:ident: $of:literal { $($name:ident: $about:expr => $kind:expr;)* $(..$view:expr)? })*) => {
        /// Every section and key, in the order printed.
        pub(super) const SECTIONS: &[Section] = &[$(Section {
            name: stringify!($section),
            about: $of,
            keys: &[
                $(Key { name: stringify!($name), about: $about, kind: |$s| $kind },)*
                $(
                    Key { name: "mirror", about: MIRROR, kind: |$s| Kind::Bool(&mut $view.mirror) },
                    Key {
                        name: "hold_s",
                        about: "How long the last weights of a lost face are held.",
                        kind: |$s| seconds(&mut $view.loss.hold_s),
                    },
                    Key {
                        name: "decay_s",
                        about: "How long they then take to fade to neutral.",
                        kind: |$s| seconds(&mut $view.loss.decay_s),
                    },
                )?
            ],
        }),*];
    };
}

sections! { s
    sensor: "The source of frames." {
        source: "Where frames come from; the option --source takes precedence. auto is a Kinect, or the simulated sensor if none is plugged in; kinect waits for one." =>
            Kind::Text(&mut s.sensor.source, "\"auto\", \"kinect\", \"kinect:SERIAL\", \"simulated\", \"simulated:SCENE\" or the path of a recording", |text| !text.is_empty());
        model: "Face model file; the option --model takes precedence." =>
            Kind::Text(&mut s.sensor.model, "a path, or empty for the built-in model", |_| true);
        near_mode: "Kinect for Windows: measure from 0.4 m instead of 0.8 m." => Kind::Bool(&mut s.sensor.device.near_mode);
        freeze_exposure: "Whether exposure and white balance are locked while a face is tracked." =>
            Kind::Bool(&mut s.sensor.device.freeze_exposure);
        set_tilt: "Whether the motor tilts the Kinect when it is opened." => Kind::Bool(&mut s.sensor.device.set_tilt);
        tilt_deg: "The tilt, relative to the horizon." =>
            float(&mut s.sensor.device.tilt_deg, -31.0, 31.0, "degrees");
        reset_audio: "Model 1473 and Kinect for Windows: reset the audio device when opening, for sensors that otherwise stop streaming." =>
            Kind::Bool(&mut s.sensor.device.reset_audio);
    }
    segment: "Head segmentation in the depth picture." {
        max_distance_m: "Maximum distance at which heads are detected." =>
            float(&mut s.stages.segment.max_distance_m, 0.4, 4.0, "m");
        iterations: "Maximum K-means iterations per frame." => integer(&mut s.stages.segment.iterations, 1, 100, "");
    }
    pose: "Head pose." {
        method: "Point-to-plane ICP against the learned head, or the paper's point-to-point ICP." =>
            choice(&mut s.stages.pose.method, &[("plane", pose::Method::Plane), ("paper", pose::Method::Paper)]);
        smoothing: "Pose filter: none, the paper's window, or adaptive." =>
            choice(&mut s.stages.pose.smoothing, &[("off", Smoothing::Off), ("window", Smoothing::Window(pose::WINDOW_FRAMES as usize)), ("adaptive", Smoothing::ADAPTIVE)]);
        window_frames: "Length of the paper's window in frames; 1 and 2 do not smooth (window)." =>
            integer(&mut s.stages.pose.window_frames, 1, 16, "");
        rounds: "Maximum iterations of point-to-point ICP, which stops early when it converges (paper)." =>
            integer(&mut s.stages.pose.rounds, 1, 1000, "");
        min_agreement: "Agreement with the head model below which the head counts as lost." =>
            float(&mut s.stages.pose.min_agreement, 0.0, 1.0, "");
        learn_shape: "Whether the size and shape of the user's head are learned (plane)." =>
            Kind::Bool(&mut s.stages.pose.learn_shape);
    }
    landmarks: "The 68 landmarks." {
        method: "Cascade on gradient-orientation patches, or the paper's 2D+3D AAM." =>
            choice(&mut s.stages.landmarks.method, &[("cascade", landmarks::Method::Cascade), ("paper", landmarks::Method::Paper)]);
        min_confidence: "Confidence below which the face counts as lost." =>
            float(&mut s.stages.landmarks.cascade.min_confidence, 0.0, 1.0, "");
        still_hz: "Cut-off of the shape filter on a still face; lower is steadier." =>
            float(&mut s.stages.landmarks.cascade.steadiness.still_hz, 0.05, 30.0, "Hz");
    }
    learning: "How each person's ranges are learned." {
        method: "The robust learner, or sections 2.2 to 2.6 of the paper to the letter." =>
            choice(&mut s.stages.learning.method, &[("robust", expression::Method::Robust), ("paper", expression::Method::Paper)]);
        scale: "Scale by which measures are divided: the frame's eye distance, the learned one, or the method's default." =>
            choice(&mut s.stages.learning.scale, &[("by-method", Scale::ByMethod), ("frame", Scale::Frame), ("learned", Scale::Learnt)]);
        best_distance_m: "Distance at which samples have full weight, equation (4)." =>
            float(&mut s.stages.learning.best_distance_m, 0.3, 4.0, "m");
        half_life_s: "Half-life of what was learned, counted while the person is present; 0 disables forgetting." =>
            float(&mut s.stages.learning.half_life_s, 0.0, 86_400.0, "s");
        range_prior: "Number of half seconds of expression that outweigh the population's range (robust)." =>
            float(&mut s.stages.learning.range_prior, 0.5, 100.0, "");
        dead_zone: "Dead zone around rest, in standard deviations of the noise (robust)." =>
            float(&mut s.stages.learning.dead_zone, 0.0, 3.0, "");
        smoothing_hz: "Cut-off of the weight filter on a still face; 0 disables it (robust)." =>
            float(&mut s.stages.learning.smoothing_hz, 0.0, 30.0, "Hz");
        infer_covered: "Whether the units of a covered mouth are inferred from its last state and the time since, instead of measured (robust)." =>
            Kind::Bool(&mut s.stages.learning.infer_covered);
        compensation_scale: "Spread of compensation samples as a share of the range; 0 is the paper's value (paper)." =>
            float(&mut s.stages.learning.compensation_scale, 0.0, 1.0, "");
        gap_percent: "l of section 2.5: the gap that cuts off the end of a range, as a share of its width (paper)." =>
            float(&mut s.stages.learning.scan.gap, 0.0, 100.0, "%");
        count_percent: "k of section 2.5: samples without a gap that end the scan, as a share of all (paper)." =>
            float(&mut s.stages.learning.scan.count, 0.0, 100.0, "%");
        scanned_percent: "m of section 2.5: maximum samples scanned, as a share of all (paper)." =>
            float(&mut s.stages.learning.scan.scanned, 0.0, 100.0, "%");
        rest_percent: "Share of samples beyond the rest end of a one-way range; 0 uses l, k and m, as at the other end (paper)." =>
            float(&mut s.stages.learning.scan.rest, 0.0, 100.0, "%");
        prior_s: "Time over which the population's ranges fade into the person's (paper)." =>
            float(&mut s.stages.learning.prior_s, 0.0, 60.0, "s");
    }
    users: "Which people are tracked, and what happens when a face is lost." {
        most: "Maximum number of people tracked at once; with 1, everybody who appears gets slot 0." =>
            integer(&mut s.stages.users.most, 1, 4, "");
        single: "Which person a single-person output sends (vmc, vrchat, faceosc, serial): the first to arrive, the nearest, or the most central." =>
            choice(&mut s.stages.users.single, &[("first", Policy::First), ("nearest", Policy::Nearest), ("central", Policy::Central)]);
        hold_s: "How long values are held after the face was last seen." =>
            float(&mut s.stages.users.hold_s, 0.0, 10.0, "s");
        forget_s: "How long a lost person then keeps their slot." => float(&mut s.stages.users.forget_s, 0.0, 3600.0, "s");
        remember_s: "How long the ranges and head shape of a person who left are kept; a returning person who is recognised gets ranges and slot back; 0 keeps none." =>
            float(&mut s.stages.users.remember_s, 0.0, 86_400.0, "s");
    }
    units: "Names and gains of units in the outputs; list only those to change: AU26 = { name = \"jaw\", gain = 1.2 }" {}
    osc: "OSC over UDP, the native schema." {
        enabled: ENABLED => Kind::Bool(&mut s.osc.enabled);
        target: TARGET => targets(&mut s.osc.targets);
        prefix: "Prefix of every address." =>
            Kind::Text(&mut s.osc.prefix, "a slash and a name of at most 63 characters, without spaces or # * , ? [ ] { }", crate::output::osc::is_prefix);
        style: "All weights in one message, each under its own address, or both." =>
            choice(&mut s.osc.style, &[("vector", Style::Vector), ("scalar", Style::Scalar), ("both", Style::Both)]);
        ranges: "Whether learned ranges are sent, every 5 s." => Kind::Bool(&mut s.osc.ranges);
        commands: "Whether the commands /face/cmd/forget, freeze, neutral and schema are accepted." =>
            Kind::Bool(&mut s.osc.commands);
        levels: "Whether /face/cmd/level, which moves the level at which a gesture goes on, is accepted too." =>
            Kind::Bool(&mut s.osc.levels);
        listen: "Address on which these commands are received; 127.0.0.1 accepts this machine only, 0.0.0.0 its networks and the targets named by address." =>
            listen(&mut s.osc.listen);
        ..s.osc.view
    }
    vmc: "OSC for avatar programs: the VMC protocol." {
        enabled: ENABLED => Kind::Bool(&mut s.vmc.enabled);
        target: TARGET => targets(&mut s.vmc.targets);
        role: "This program's role, as the receiver sees it." =>
            choice(&mut s.vmc.role, &[("performer", Role::Performer), ("assistant", Role::Assistant)]);
        names: "Names of the blend shapes: ARKit's, VRM avatars', or the units' own." =>
            choice(&mut s.vmc.names, &[("arkit", Names::Arkit), ("vrm0", Names::Vrm0), ("vrm1", Names::Vrm1), ("units", Names::Units)]);
        derived: DERIVED => Kind::Bool(&mut s.vmc.derived);
        eyes: "Whether the gaze turns the bones of the eyes." => Kind::Bool(&mut s.vmc.eyes);
        ..s.vmc.view
    }
    vrchat: "OSC for VRChat: Unified Expressions." {
        enabled: ENABLED => Kind::Bool(&mut s.vrchat.enabled);
        target: TARGET => targets(&mut s.vrchat.targets);
        prefix: "Prefix that the avatar's author put before the parameter names." =>
            Kind::Text(&mut s.vrchat.prefix, "empty or ending in a slash", |text| text.is_empty() || text.ends_with('/'));
        values: "Parameters as floats, as binary switches, or both." =>
            choice(&mut s.vrchat.values, &[("float", Values::Float), ("binary", Values::Binary), ("both", Values::Both)]);
        bits: "Binary switches per parameter, besides its sign." => integer(&mut s.vrchat.bits, 1, MOST_BITS, "");
        ..s.vrchat.view
    }
    faceosc: "OSC in FaceOSC's format." {
        enabled: ENABLED => Kind::Bool(&mut s.faceosc.enabled);
        target: TARGET => targets(&mut s.faceosc.targets);
        mirror: MIRROR => Kind::Bool(&mut s.faceosc.view.mirror);
        hold_s: "How long a lost face is held." => seconds(&mut s.faceosc.view.loss.hold_s);
    }
    serial: "Serial output." {
        port: "The port; empty = no serial output." =>
            Kind::Text(&mut s.serial.port, "the path of a port, like \"/dev/serial/by-id/usb-...\" or \"/dev/ttyUSB0\", tcp:host:port, or empty", |text| text.strip_prefix("tcp:").is_none_or(is_host_port));
        baud: "Baud rate." => integer(&mut s.serial.baud, 1200, 4_000_000, "bit/s");
        style: "Lines with checksums, lines for the Arduino plotter, or binary frames." =>
            choice(&mut s.serial.style, &[("text", serial::Style::Text), ("plot", serial::Style::Plot), ("cobs", serial::Style::Cobs)]);
        full: "Number sent for a weight of 1 in text lines; 100 gives percentages, in tenths if the line is fast enough; from 128 on, numbers are whole." =>
            integer(&mut s.serial.full, 10, 10_000, "");
        pose: "Whether head poses are sent too." => Kind::Bool(&mut s.serial.pose);
        units: "Units to send, most important first; empty = all." =>
            Kind::Texts(&mut s.serial.units, "units, like [\"AU26\", \"AU25\"]", is_unit, [0, UNITS_MOST]);
        min_rate_hz: "Frame rate below which units are omitted on a slow line." =>
            float(&mut s.serial.min_rate_hz, 0.0, 30.0, "Hz");
        dtr: "Whether DTR is raised on opening, which resets many boards; otherwise it is left unchanged." =>
            Kind::Bool(&mut s.serial.dtr);
        ..s.serial.view
    }
    network: "How the outputs below identify the box. They are optional build features, included in the package." {
        name: "Name of the box on the network; empty = the host name." =>
            Kind::Text(&mut s.name, "at most 63 letters, digits and -, or empty", is_host);
    }
    live_link: "Unreal's Live Link, in the format of the Live Link Face app." {
        enabled: ENABLED => Kind::Bool(&mut s.live_link.enabled);
        target: TARGET => targets(&mut s.live_link.targets);
        subject: "Subject name in Unreal; empty = the name of the box." =>
            Kind::Text(&mut s.live_link.subject, "at most 64 bytes", |name| name.len() <= 64);
        derived: DERIVED => Kind::Bool(&mut s.live_link.derived);
        ..s.live_link.view
    }
    websocket: "JSON over WebSocket, for web pages." {
        enabled: SERVES => Kind::Bool(&mut s.websocket.enabled);
        listen: LISTEN => listen(&mut s.websocket.listen);
        ..s.websocket.view
    }
    page: "A page to watch and command the box, for a phone: state, weights, neutral, freeze, forget." {
        enabled: SERVES => Kind::Bool(&mut s.page.enabled);
        listen: LISTEN => listen(&mut s.page.listen);
        password_file: "File whose first line is the password, accepted with any user name; empty = no password, and local networks only." =>
            Kind::Text(&mut s.page.password_file, FILE, |_| true);
    }
    mqtt: "MQTT: presence, state, health, weights, and Home Assistant." {
        enabled: ENABLED => Kind::Bool(&mut s.mqtt.enabled);
        broker: "The broker's address." => Kind::Text(&mut s.mqtt.broker, "host:port", is_host_port);
        tls: "Whether the connection is encrypted with TLS, usually on port 8883." => Kind::Bool(&mut s.mqtt.tls);
        ca_file: "Trusted CA certificates, in PEM; the default is the system's." =>
            Kind::Text(&mut s.mqtt.ca_file, "the path of a file", |path| !path.is_empty());
        user: "User name; empty = none." =>
            Kind::Text(&mut s.mqtt.user, "at most 64 bytes, or empty", |name| name.len() <= 64);
        password_file: "File whose first line is the password; empty = none." =>
            Kind::Text(&mut s.mqtt.password_file, FILE, |_| true);
        prefix: "Prefix of every topic; the name of the box follows it." =>
            Kind::Text(&mut s.mqtt.prefix, "at most 64 bytes without spaces, #, + or a slash at either end", is_topic);
        rate_hz: "Maximum rate at which weights are sent; 0 sends none." =>
            float(&mut s.mqtt.rate_hz, 0.0, 30.0, "Hz");
        health_s: "Interval between health messages." => float(&mut s.mqtt.health_s, 1.0, 3600.0, "s");
        commands: "Whether the commands forget, freeze and neutral are accepted." =>
            Kind::Bool(&mut s.mqtt.commands);
        home_assistant: "Whether the box announces itself to Home Assistant (MQTT discovery)." =>
            Kind::Bool(&mut s.mqtt.home_assistant);
        ..s.mqtt.view
    }
    keys: "Keys that gestures press." {
        device: "The device that presses them: uinput, or the node of a USB HID gadget." =>
            Kind::Text(&mut s.keys_device, "the path of a device", |text| !text.is_empty());
    }
    state: "What is kept across restarts about people tracked with a Kinect." {
        persist: "Whether the ranges and head shape of people who left are saved for users.remember_s, so that a restart forgets nobody." =>
            Kind::Bool(&mut s.state.persist);
        path: "The file; rewritten once a minute and on exit." =>
            Kind::Text(&mut s.state.path, "the path of a file in an existing directory", |path| !path.is_empty());
    }
    status: "Status files." {
        path: "The file; rewritten once a second, with mien.prom for Prometheus beside it; empty = neither." =>
            Kind::Text(&mut s.status_path, "the path of a file in an existing directory, or empty", |_| true);
        ranges: "Whether the file also contains everybody's learned ranges; every user of this machine can read it." =>
            Kind::Bool(&mut s.status_ranges);
    }
    log: "Log on standard error." {
        level: "Lowest severity written; \"trace\" is the same as \"debug\"." =>
            choice(&mut s.log_level, &[("error", Level::ERROR), ("warn", Level::WARN), ("info", Level::INFO), ("debug", Level::DEBUG), ("trace", Level::TRACE)]);
    }
    gesture: "Expressions that switch something, see docs/gestures.md. At most 16; smile, brows, mouth_open, wink_left,\n# wink_right, blink_long, look_left, look_right, look_up and kiss need only their name." {
        name: "Name of the gesture." =>
            Kind::Text(&mut s.gesture().name, "at most 24 letters, digits and signs such as _ or -", gestures::is_word);
        of: "Expression that switches it." =>
            Kind::Text(&mut s.gesture().of, "a sum of units, such as \"AU12L + AU12R - AU26\", or sums joined by &, of which the smallest counts", gestures::is_sum);
        on: "Level of that expression at which it goes on." => float(&mut s.gesture().on, LEVELS[0], LEVELS[1], "");
        off: "Level below which it goes off." => float(&mut s.gesture().off, 0.0, 8.0, "");
        hold_s: "How long the level must be kept before it goes on." => seconds(&mut s.gesture().hold_s);
        pause_s: "Shortest time from going off to going on again." => seconds(&mut s.gesture().pause_s);
        person: "Whose expression counts: that of the person in single-person outputs, anybody's, or each person's separately." =>
            choice(&mut s.gesture().person, &[("shown", Person::Shown), ("any", Person::Any), ("each", Person::Each)]);
        speaking: "Whether it goes on at its level while the person speaks; if false, only at twice that level." => Kind::Bool(&mut s.gesture().speaking);
        turned_deg: "Largest sideways angle between the face and the line of sight." => float(&mut s.gesture().turned_deg, 1.0, 90.0, "degrees");
        key: "Key that it presses; empty = none." =>
            Kind::Text(&mut s.gesture().key, "a key such as \"space\", \"a\", \"page_down\", \"mouse_left\", or empty", gestures::is_key);
        press: "Whether the key is tapped once, or held down while the gesture is on." =>
            choice(&mut s.gesture().press, &[("tap", Press::Tap), ("hold", Press::Hold)]);
    }
}

fn float<'a>(value: impl Into<Number<'a>>, min: f32, max: f32, unit: &'static str) -> Kind<'a> {
    Kind::Number(value.into(), [min, max], unit)
}

fn seconds(value: &mut f32) -> Kind<'_> {
    float(value, 0.0, 60.0, "s")
}

fn integer<'a>(value: &'a mut u32, min: u32, max: u32, unit: &'static str) -> Kind<'a> {
    float(Number::Whole(value), min as f32, max as f32, unit)
}

fn choice<'a, T: Copy + PartialEq>(slot: &'a mut T, all: &'static [(&'static str, T)]) -> Kind<'a> {
    let present = all.iter().position(|one| one.1 == *slot);
    let names = all.iter().map(|one| one.0).collect();
    let set = Box::new(|index: usize| *slot = all[index].1);
    Kind::Choice(present.unwrap_or_default(), names, set)
}

fn targets(value: &mut Vec<String>) -> Kind<'_> {
    let form = "host:port, or up to 16 as [\"host:port\", \"host:port\"]";
    Kind::Texts(value, form, is_host_port, [1, TARGETS_MOST])
}

/// `address:port` of this machine.
fn listen(value: &mut String) -> Kind<'_> {
    let valid = |text: &str| text.parse::<std::net::SocketAddr>().is_ok();
    Kind::Text(value, "address:port", valid)
}

fn is_host_port(text: &str) -> bool {
    text.rsplit_once(':')
        .is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok())
}

fn is_host(name: &str) -> bool {
    name.len() <= 63 && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-')
}

fn is_topic(text: &str) -> bool {
    let plain = |c: char| c.is_ascii_graphic() && !"#+\"\\$".contains(c);
    let open = text.starts_with('/') || text.ends_with('/');
    (1..=64).contains(&text.len()) && text.chars().all(plain) && !open
}
