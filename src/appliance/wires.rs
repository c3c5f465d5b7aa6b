//! The outputs: one row each. Another one is its file in `output/`, with its keys, a section in `settings/keys.rs` and a row here.

use std::net::SocketAddr;
use std::slice::from_ref;

use crate::pipeline::Pipeline;
use crate::settings::Settings;
use mien_outputs::gesture::ENABLED;
use mien_outputs::{self, Output, OutputError, osc};

type Opened = Result<Box<dyn Output>, OutputError>;
/// Opens an output; the names are the units', in the order of the weights.
type Open = fn(&Settings, &[&str]) -> Opened;
/// Checks whether the settings can be used, without sockets, ports or threads.
type Check = fn(&Settings, &[&str]) -> Result<(), OutputError>;

/// One output.
pub(crate) struct Row {
    /// What it is called.
    name: &'static str,
    /// Section of the configuration.
    pub(crate) section: &'static str,
    enabled: fn(&Settings) -> bool,
    /// Where it sends to: hosts, a broker or a port.
    pub(crate) targets: fn(&Settings) -> &[String],
    /// How it is opened and checked; `None` if this build is without it.
    built: Option<(Open, Check)>,
}

/// A row: `"name" section: enabled, targets => constructor, check;`, the check where there is more to it than the keys' ranges, of the settings `s` and the names of the units; `"wires"` behind
/// the section where only builds with that feature have it.
macro_rules! outputs {
    ($s:ident $units:ident $($name:literal $section:ident $($feature:literal)?: $enabled:expr, $targets:expr => $open:expr $(, $check:expr)?;)*) => {
        const OUTPUTS: &[Row] = &[$(Row {
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
        }),*];
    };
}

outputs! { s units
    "OSC" osc: s.osc.enabled, &s.osc.targets => osc::Osc::new(s.osc.clone(), units)?,
        osc::Osc::over(Box::default(), s.osc.clone(), units);
    "VMC" vmc: s.vmc.enabled, &s.vmc.targets => osc::vmc::Vmc::new(s.vmc.clone(), units)?;
    "VRChat" vrchat: s.vrchat.enabled, &s.vrchat.targets => osc::vrchat::VrChat::new(s.vrchat.clone(), units)?,
        osc::vrchat::VrChat::over(Box::default(), s.vrchat.clone(), units);
    "FaceOSC" faceosc: s.faceosc.enabled, &s.faceosc.targets => osc::faceosc::FaceOsc::new(s.faceosc.clone())?;
    "serial" serial: !s.serial.port.is_empty(), from_ref(&s.serial.port) => mien_outputs::serial::Serial::new(&s.serial, units)?,
        mien_outputs::serial::Encoder::new(&s.serial, units);
    "Live Link" live_link "wires": s.live_link.enabled, &s.live_link.targets =>
        mien_outputs::live_link::LiveLink::new(s.live_link.clone(), &s.name, units)?;
    "WebSocket" websocket "wires": s.websocket.enabled, &[] =>
        mien_outputs::web::websocket::open(&s.websocket, units, &s.gesture_names())?;
    "page" page "wires": s.page.enabled, &[] => {
        // It is no place that weights are sent to.
        let sends = listed(enabled(s).filter(|row| row.section != "page"), s);
        mien_outputs::web::page::open(&s.page, &s.units, &s.name, &sends, units, &s.gestures)?
    }, mien_outputs::web::page::secret(&s.page);
    "MQTT" mqtt "wires": s.mqtt.enabled, from_ref(&s.mqtt.broker) =>
        mien_outputs::mqtt::open(&s.mqtt, &s.name, units, &s.gesture_names())?,
        mien_outputs::mqtt::check(&s.mqtt);
    "keys" keys "wires": s.gestures.iter().any(|gesture| !gesture.key.is_empty()), from_ref(&s.keys_device) =>
        mien_outputs::keys::Keys::new(&s.keys_device);
}

/// Rows of the enabled outputs.
pub(crate) fn enabled(settings: &Settings) -> impl Iterator<Item = &'static Row> {
    OUTPUTS.iter().filter(|row| (row.enabled)(settings))
}

/// Whether this build has every output that is enabled, and it could be opened.
///
/// # Errors
/// The section that it is without or whose settings cannot be used, and why.
pub(crate) fn check(settings: &Settings) -> Result<(), (&'static str, OutputError)> {
    if !ENABLED && !settings.gestures.is_empty() {
        return Err(("gesture", OutputError::NotBuilt("gesture")));
    }
    let units = Pipeline::unit_names_with(&settings.stages);
    let units: Vec<&str> = units.iter().map(String::as_str).collect();
    enabled(settings).try_for_each(|row| {
        let checked = match row.built {
            Some((_, check)) => check(settings, &units),
            None => Err(OutputError::NotBuilt(row.section)),
        };
        checked.map_err(|problem| (row.section, problem))
    })
}

/// Whether both servers of the web would listen at one port of one address.
pub(crate) fn share_a_port(settings: &Settings) -> bool {
    let (one, other) = (&settings.websocket, &settings.page);
    let parsed = [&one.listen, &other.listen].map(|at| at.parse::<SocketAddr>().ok());
    let [Some(a), Some(b)] = parsed else {
        return false;
    };
    let overlap = a.ip() == b.ip() || a.ip().is_unspecified() || b.ip().is_unspecified();
    one.enabled && other.enabled && overlap && a.port() == b.port() && a.port() > 0
}

/// Sections of the outputs that this build is without.
pub fn not_built() -> Vec<&'static str> {
    let rows = OUTPUTS.iter().filter(|row| row.built.is_none());
    rows.map(|row| row.section).collect()
}

/// Opens every enabled output. `units` are the names in the order of the weights.
pub fn open(settings: &Settings, units: &[&str]) -> Result<Vec<Box<dyn Output>>, OutputError> {
    check(settings).map_err(|(_, problem)| problem)?;
    let built = enabled(settings).filter_map(|row| row.built);
    built.map(|(open, _)| open(settings, units)).collect()
}

/// The enabled outputs and where they send to, as text.
pub(crate) fn named(settings: &Settings) -> String {
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
    fn what_is_switched_on_is_there_or_it_is_said_why_not() {
        let mut settings = Settings::default();
        assert_eq!(
            open(&settings, &["AU26"]).map(|wires| wires.len()).ok(),
            Some(1)
        );
        settings.live_link.enabled = true;
        let opened = open(&settings, &["AU26"]);
        assert_eq!(check(&settings).is_ok(), opened.is_ok());
        assert_eq!(opened.is_ok(), cfg!(feature = "wires"));
        match opened {
            Ok(wires) => assert_eq!(wires[1].tally().name, "live_link"),
            Err(problem) => {
                let told = problem.to_string();
                assert!(told.contains("build with --features wires"), "{told}");
            }
        }
    }
}
