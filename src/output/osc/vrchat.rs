//! OSC preset `vrchat`: avatar parameters of VRChat, with the names of Unified Expressions v2.
//!
//! Addresses are `/avatar/parameters/<prefix>v2/<Name>`; the prefix is the avatar author's, `FT/` is common. Only what is
//! measured is sent, and only what has changed; everything once a second, for avatars that were loaded meanwhile. The
//! switches `EyeTrackingActive`, `ExpressionTrackingActive` and `LipTrackingActive` tell whether there is a face. One face: the first
//! seen, until lost.

use super::packet::Argument;
use super::parameters::{Definition, Parameter, plain};
use super::wire::Wire;
use crate::output::{Every, LossPolicy, OneFace, Output, OutputError, Report};
use crate::time::Timestamp;

/// Changes below this are not sent: less than the 8 bits the receiver passes on.
const LEAST_CHANGE: f32 = 1.0 / 512.0;
/// How often everything is sent, seconds.
const REFRESH_S: f64 = 1.0;
/// Whether there is a face.
const SWITCHES: [&str; 3] = [
    "EyeTrackingActive",
    "ExpressionTrackingActive",
    "LipTrackingActive",
];

/// Where and how it goes.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Whether anything is sent.
    pub enabled: bool,
    /// `host:port`.
    pub target: String,
    /// What the avatar's author put before the names; empty, or ending in a slash.
    pub prefix: String,
    /// What is sent of a face that is lost.
    pub loss: LossPolicy,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            enabled: false,
            target: "127.0.0.1:9000".to_owned(),
            prefix: "FT/".to_owned(),
            loss: LossPolicy::default(),
        }
    }
}

/// An eye is open to 0.75 at rest, and to 1 when wide.
const fn lid(name: &'static str, terms: &'static [(f32, &'static [&'static str])]) -> Definition {
    Definition {
        name,
        rest: 0.75,
        terms,
    }
}

/// Parameters in terms of action units.
const PARAMETERS: [Definition; 26] = [
    lid(
        "EyeLidLeft",
        &[(-0.75, &["AU43L", "AU43"]), (0.25, &["AU5L", "AU5"])],
    ),
    lid(
        "EyeLidRight",
        &[(-0.75, &["AU43R", "AU43"]), (0.25, &["AU5R", "AU5"])],
    ),
    plain("EyeSquintLeft", &[(1.0, &["AU7L", "AU7"])]),
    plain("EyeSquintRight", &[(1.0, &["AU7R", "AU7"])]),
    plain(
        "BrowExpressionLeft",
        &[(1.0, &["AU2L", "AU1L"]), (-1.0, &["AU4L"])],
    ),
    plain(
        "BrowExpressionRight",
        &[(1.0, &["AU2R", "AU1R"]), (-1.0, &["AU4R"])],
    ),
    plain("JawOpen", &[(1.0, &["AU26", "AU27"])]),
    plain("JawX", &[(1.0, &["AU30R"]), (-1.0, &["AU30L"])]),
    plain("JawZ", &[(1.0, &["AU29"])]),
    plain("SmileFrownLeft", &[(1.0, &["AU12L"]), (-1.0, &["AU15L"])]),
    plain("SmileFrownRight", &[(1.0, &["AU12R"]), (-1.0, &["AU15R"])]),
    plain(
        "SmileSadLeft",
        &[(1.0, &["AU12L"]), (-1.0, &["AU15L", "AU20"])],
    ),
    plain(
        "SmileSadRight",
        &[(1.0, &["AU12R"]), (-1.0, &["AU15R", "AU20"])],
    ),
    plain("MouthStretchLeft", &[(1.0, &["AU20L", "AU20"])]),
    plain("MouthStretchRight", &[(1.0, &["AU20R", "AU20"])]),
    plain("MouthUpperUp", &[(1.0, &["AU10L", "AU10R", "AU10"])]),
    plain("MouthLowerDown", &[(1.0, &["AU16L", "AU16R", "AU16"])]),
    plain("MouthOpen", &[(1.0, &["AU25"])]),
    plain("MouthRaiserLower", &[(1.0, &["AU17"])]),
    plain("LipPucker", &[(1.0, &["AU18"])]),
    plain("LipFunnel", &[(1.0, &["AU22"])]),
    plain("LipSuckUpper", &[(1.0, &["AU28"])]),
    plain("LipSuckLower", &[(1.0, &["AU28"])]),
    plain("CheekPuffSuckLeft", &[(1.0, &["AU33", "AU34"])]),
    plain("CheekPuffSuckRight", &[(1.0, &["AU33", "AU34"])]),
    plain("NoseSneer", &[(1.0, &["AU9L", "AU9R", "AU9"])]),
];

/// A sender of avatar parameters.
pub struct VrChat {
    wire: Wire,
    face: OneFace,
    parameters: Box<[Parameter]>,
    /// What was sent last of each.
    last: Box<[f32]>,
    active: bool,
    refresh: Every,
}

impl VrChat {
    /// Opens the socket. `units` are the names in the order of the weights.
    ///
    /// # Errors
    /// If the settings are unusable, or there is no socket to be had.
    pub fn new(settings: Settings, units: &[&str]) -> Result<Self, OutputError> {
        let parameters = Parameter::resolve(&PARAMETERS, units);
        Ok(Self {
            wire: Wire::open(
                settings.target,
                format!("/avatar/parameters/{}v2", settings.prefix),
            )?,
            face: OneFace::new(units.len(), settings.loss),
            last: vec![f32::NAN; parameters.len()].into_boxed_slice(),
            parameters,
            active: false,
            refresh: Every::default(),
        })
    }

    /// Datagrams sent, and those that could not be.
    #[must_use]
    pub fn sent_and_dropped(&self) -> (u64, u64) {
        (self.wire.sent(), self.wire.dropped())
    }

    fn send_frame(&mut self, at: Timestamp, active: bool) {
        let all = self.refresh.due(at, REFRESH_S);
        if all || active != self.active {
            self.active = active;
            for name in SWITCHES {
                self.wire.message(
                    format_args!("/{name}"),
                    std::iter::once(Argument::Bool(active)),
                );
            }
        }
        for (parameter, last) in self.parameters.iter().zip(&mut self.last) {
            let value = parameter.value(self.face.weights.shown());
            // Rest and the ends are sent exactly: an eye must not stay open by a hair.
            let changed = (value - *last).abs() >= LEAST_CHANGE
                || (value != *last && [-1.0, 0.0, 1.0].contains(&value));
            if all || changed {
                *last = value;
                self.wire.message(
                    format_args!("/{}", parameter.name),
                    std::iter::once(Argument::Float(value)),
                );
            }
        }
        self.wire.flush();
    }
}

impl Output for VrChat {
    fn send(&mut self, report: &Report) -> Result<(), OutputError> {
        if let Some(state) = self.face.follow(report) {
            self.send_frame(report.at, state.is_present());
        }
        Ok(())
    }
}

impl Drop for VrChat {
    /// Neutral, and no face.
    fn drop(&mut self) {
        self.face.weights.reset();
        self.refresh = Every::default();
        self.send_frame(Timestamp::default(), false);
    }
}
