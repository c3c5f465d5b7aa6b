//! The table of outputs: a row each. Another output is its file beside this one and a row here.

use std::net::SocketAddr;
use std::slice::from_ref;

use crate::features::{LiveLinkSettings, MqttSettings, PageSettings, WebSocketSettings};
use crate::gesture::{ENABLED, Gesture};
use crate::{Output, OutputError, UnitView, osc, serial};
use mien_stages::base::defaults;
use mien_stages::base::prelude::*;
use mien_stages::base::settings::{Key, Keys, keyed};

keyed! {
    /// The box on the network.
    pub struct NetworkSettings {
        /// Name of the box on the network; empty = the host name.
        name: String = String::new() => Text("at most 63 letters, digits and -, or empty", is_host),
    }
    /// The keyboard that gestures press.
    pub struct KeysSettings {
        /// The device that presses them: uinput, or the node of a USB HID gadget.
        device: String = "/dev/uinput".into() => Text("the path of a device", |text| !text.is_empty()),
    }
}

fn is_host(name: &str) -> bool {
    name.len() <= 63 && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-')
}

/// A section of the configuration.
pub struct Section {
    /// Its name.
    pub name: &'static str,
    /// A sentence about it.
    pub about: &'static str,
    /// Its keys.
    pub keys: fn(&mut Settings) -> Vec<Key<'_>>,
}

type Opened = Result<Box<dyn Output>, OutputError>;
/// Opens an output; the names are those of the units, in the order of the weights.
type Open = fn(&Settings, &[&str]) -> Opened;
/// Checks whether the settings can be used, without sockets, ports or threads.
type Check = fn(&Settings, &[&str]) -> Result<(), OutputError>;

/// One output.
pub struct Row {
    /// Its name in messages.
    name: &'static str,
    /// Section of the configuration.
    pub section: &'static str,
    enabled: fn(&Settings) -> bool,
    /// Where it sends to: hosts, a broker or a port.
    pub targets: fn(&Settings) -> &[String],
    /// How it is opened and checked; `None` if this build is without it.
    built: Option<(Open, Check)>,
}

/// A row: `section: Type [field of its view] = "a sentence" "name": enabled, targets => constructor, check;` of the settings
/// `s` and the names of the units. `in "wires"` behind the name: only builds with that feature have it. A section without a name
/// is no output. The check covers what the ranges of the keys do not.
macro_rules! outputs {
    ($s:ident $units:ident $(
        $section:ident: $kind:ty $([$view:ident])? = $about:literal
        $($name:literal $(in $feature:literal)?: $enabled:expr, $targets:expr => $open:expr $(, $check:expr)?)?;
    )*) => {
        defaults! {
            /// The settings of all outputs.
            #[derive(Clone, Debug, PartialEq)]
            pub struct Settings {
                /// Names and gains of units, for every output.
                pub units: Vec<UnitView> = Vec::new(),
                /// Gestures, for every output.
                pub gestures: Vec<Gesture> = Vec::new(),
                $(#[doc = $about] pub $section: $kind = <$kind>::default(),)*
            }
        }

        impl Settings {
            /// Copies the names and gains of the units into the view of every output.
            pub fn copy_units(&mut self) {
                $($(self.$section.$view.units.clone_from(&self.units);)?)*
            }
        }

        /// Every section, in the order printed.
        pub const SECTIONS: &[Section] = &[$(Section {
            name: stringify!($section),
            about: $about,
            keys: |$s| $s.$section.keys(),
        }),*];

        const OUTPUTS: &[Row] = &[$($(Row {
            name: $name,
            section: stringify!($section),
            enabled: |$s| $enabled,
            targets: |$s| {
                let _ = $s;
                $targets
            },
            built: {
                #[cfg(all($(feature = $feature)?))]
                let built: Option<(Open, Check)> = Some((
                    |$s, $units| {
                        let _ = $units;
                        Ok(Box::new($open))
                    },
                    |$s, $units| {
                        let _ = ($s, $units);
                        $($check?;)?
                        Ok(())
                    },
                ));
                #[cfg(not(all($(feature = $feature)?)))]
                let built = None;
                built
            },
        },)?)*];
    };
}

outputs! { s units
    osc: osc::Settings [view] = "OSC over UDP, the native schema."
        "OSC": s.osc.enabled, &s.osc.targets => osc::Osc::new(s.osc.clone(), units)?,
        osc::Osc::with_targets(Box::default(), s.osc.clone(), units);
    vmc: osc::vmc::Settings [view] = "OSC for avatar programs: the VMC protocol."
        "VMC": s.vmc.enabled, &s.vmc.targets => osc::vmc::Vmc::new(s.vmc.clone(), units)?;
    vrchat: osc::vrchat::Settings [view] = "OSC for VRChat: Unified Expressions."
        "VRChat": s.vrchat.enabled, &s.vrchat.targets => osc::vrchat::VrChat::new(s.vrchat.clone(), units)?,
        osc::vrchat::VrChat::with_targets(Box::default(), s.vrchat.clone(), units);
    faceosc: osc::faceosc::Settings = "OSC in FaceOSC's format."
        "FaceOSC": s.faceosc.enabled, &s.faceosc.targets => osc::faceosc::FaceOsc::new(s.faceosc.clone())?;
    serial: serial::Settings [view] = "Serial output."
        "serial": !s.serial.port.is_empty(), from_ref(&s.serial.port) => serial::Serial::new(&s.serial, units)?,
        serial::Encoder::new(&s.serial, units);
    network: NetworkSettings =
        "How the outputs below identify the box. They are optional build features, included in the package.";
    live_link: LiveLinkSettings [view] = "Unreal's Live Link, in the format of the Live Link Face app."
        "Live Link" in "wires": s.live_link.enabled, &s.live_link.targets =>
        crate::live_link::LiveLink::new(s.live_link.clone(), &s.network.name, units)?;
    websocket: WebSocketSettings [view] = "JSON over WebSocket, for web pages."
        "WebSocket" in "wires": s.websocket.enabled, &[] =>
        crate::web::websocket::open(&s.websocket, units, &s.gesture_names())?;
    page: PageSettings = "A page to watch and command the box, for a phone: state, weights, neutral, freeze, forget."
        "page" in "wires": s.page.enabled, &[] => {
        // No weights are sent to the page itself.
        let sends = listed(enabled(s).filter(|row| row.section != "page"), s);
        crate::web::page::open(&s.page, &s.units, &s.network.name, &sends, units, &s.gestures)?
    }, crate::web::page::read_password(&s.page);
    mqtt: MqttSettings [view] = "MQTT: presence, state, health, weights, and Home Assistant."
        "MQTT" in "wires": s.mqtt.enabled, from_ref(&s.mqtt.broker) =>
        crate::mqtt::open(&s.mqtt, &s.network.name, units, &s.gesture_names())?,
        crate::mqtt::check(&s.mqtt);
    keys: KeysSettings = "Keys that gestures press."
        "keys" in "wires": s.gestures.iter().any(|gesture| !gesture.key.is_empty()), from_ref(&s.keys.device) =>
        crate::keys::Keys::new(&s.keys.device),
        crate::keys::check(&s.keys.device, &s.gestures);
}

impl Settings {
    /// Names of the gestures, in their order.
    pub fn gesture_names(&self) -> Vec<&str> {
        let names = self.gestures.iter().map(|gesture| gesture.name.as_str());
        names.collect()
    }
}

/// Rows of the enabled outputs.
pub fn enabled(settings: &Settings) -> impl Iterator<Item = &'static Row> {
    OUTPUTS.iter().filter(|row| (row.enabled)(settings))
}

/// Whether this build has every enabled output, and it could be opened. `units` are the names in the order of the weights.
///
/// # Errors
/// The section that is not built in or whose settings cannot be used, and why.
pub fn check(settings: &Settings, units: &[&str]) -> Result<(), (&'static str, OutputError)> {
    if !ENABLED && !settings.gestures.is_empty() {
        return Err(("gesture", OutputError::NotBuilt("gesture")));
    }
    enabled(settings).try_for_each(|row| {
        let checked = match row.built {
            Some((_, check)) => check(settings, units),
            None => Err(OutputError::NotBuilt(row.section)),
        };
        checked.map_err(|problem| (row.section, problem))
    })
}

/// Whether both servers of the web would listen at one port of one address.
pub fn share_a_port(settings: &Settings) -> bool {
    let (one, other) = (&settings.websocket, &settings.page);
    let parsed = [&one.listen, &other.listen].map(|text| text.parse::<SocketAddr>().ok());
    let [Some(a), Some(b)] = parsed else {
        return false;
    };
    let overlap = a.ip() == b.ip() || a.ip().is_unspecified() || b.ip().is_unspecified();
    one.enabled && other.enabled && overlap && a.port() == b.port() && a.port() > 0
}

/// Sections of the outputs that are not built in.
pub fn not_built() -> Vec<&'static str> {
    let rows = OUTPUTS.iter().filter(|row| row.built.is_none());
    rows.map(|row| row.section).collect()
}

/// Opens every enabled output. `units` are the names in the order of the weights.
///
/// # Errors
/// If one of them cannot be opened.
pub fn open(settings: &Settings, units: &[&str]) -> Result<Vec<Box<dyn Output>>, OutputError> {
    check(settings, units).map_err(|(_, problem)| problem)?;
    let built = enabled(settings).filter_map(|row| row.built);
    built.map(|(open, _)| open(settings, units)).collect()
}

/// The enabled outputs and their targets, as text.
pub fn named(settings: &Settings) -> String {
    listed(enabled(settings), settings)
}

fn listed(rows: impl Iterator<Item = &'static Row>, settings: &Settings) -> String {
    let one = |row: &Row| match (row.targets)(settings) {
        [] => row.name.to_owned(),
        targets => format!("{} to {}", row.name, targets.join(" and ")),
    };
    rows.map(one).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_enabled_output_opens_or_the_message_says_why_not() {
        let mut settings = Settings::default();
        let units = ["AU26"];
        assert_eq!(open(&settings, &units).map(|all| all.len()).ok(), Some(1));
        settings.live_link.enabled = true;
        let opened = open(&settings, &units);
        assert_eq!(check(&settings, &units).is_ok(), opened.is_ok());
        assert_eq!(opened.is_ok(), cfg!(feature = "wires"));
        match opened {
            Ok(outputs) => assert_eq!(outputs[1].tally().name, "live_link"),
            Err(problem) => {
                let message = problem.to_string();
                assert!(message.contains("build with --features wires"), "{message}");
            }
        }
    }
}
