//! The outputs: one row each. Another one is its file in `output/`, its section in `settings/keys.rs` and a row here.

use std::slice::from_ref;

use crate::appliance::settings::Settings;
use crate::output::osc::Osc;
use crate::output::osc::faceosc::FaceOsc;
use crate::output::osc::vmc::Vmc;
use crate::output::osc::vrchat::VrChat;
use crate::output::serial::Serial;
use crate::output::{Output, OutputError};

type Opened = Result<Box<dyn Output>, OutputError>;

/// One output.
pub(crate) struct Row {
    /// What it is called.
    name: &'static str,
    /// Section of the configuration.
    pub(crate) section: &'static str,
    /// The build feature that it needs; empty = none.
    feature: &'static str,
    enabled: fn(&Settings) -> bool,
    /// Where it sends to: hosts, a broker or a port.
    pub(crate) targets: fn(&Settings) -> &[String],
    /// Opens it; `None` if this build is without it. The names are the units', in the order of the weights.
    open: Option<fn(&Settings, &[&str]) -> Opened>,
}

/// `Some` of what a feature of the build opens.
macro_rules! built {
    ($feature:literal, $open:expr) => {{
        #[cfg(feature = $feature)]
        let open: Option<fn(&Settings, &[&str]) -> Opened> = Some($open);
        #[cfg(not(feature = $feature))]
        let open = None;
        open
    }};
}

const OUTPUTS: [Row; 13] = [
    Row {
        name: "OSC",
        section: "osc",
        feature: "",
        enabled: |s| s.osc.enabled,
        targets: |s| &s.osc.targets,
        open: Some(|s, units| Ok(Box::new(Osc::new(s.osc.clone(), units)?))),
    },
    Row {
        name: "VMC",
        section: "vmc",
        feature: "",
        enabled: |s| s.vmc.enabled,
        targets: |s| &s.vmc.targets,
        open: Some(|s, units| Ok(Box::new(Vmc::new(s.vmc.clone(), units)?))),
    },
    Row {
        name: "VRChat",
        section: "vrchat",
        feature: "",
        enabled: |s| s.vrchat.enabled,
        targets: |s| &s.vrchat.targets,
        open: Some(|s, units| Ok(Box::new(VrChat::new(s.vrchat.clone(), units)?))),
    },
    Row {
        name: "FaceOSC",
        section: "faceosc",
        feature: "",
        enabled: |s| s.faceosc.enabled,
        targets: |s| &s.faceosc.targets,
        open: Some(|s, _| Ok(Box::new(FaceOsc::new(s.faceosc.clone())?))),
    },
    Row {
        name: "serial",
        section: "serial",
        feature: "",
        enabled: |s| !s.serial.port.is_empty(),
        targets: |s| from_ref(&s.serial.port),
        open: Some(|s, units| Ok(Box::new(Serial::new(&s.serial, units)?))),
    },
    Row {
        name: "Art-Net",
        section: "artnet",
        feature: "lights",
        enabled: |s| s.network.artnet.enabled,
        targets: |s| &s.network.artnet.targets,
        open: built!("lights", |s, units| {
            use crate::output::lights::artnet::ArtNet;
            let (artnet, lights) = (&s.network.artnet, &s.network.lights);
            Ok(Box::new(ArtNet::new(artnet, lights, units)?))
        }),
    },
    Row {
        name: "sACN",
        section: "sacn",
        feature: "lights",
        enabled: |s| s.network.sacn.enabled,
        targets: |s| &s.network.sacn.targets,
        open: built!("lights", |s, units| {
            use crate::output::lights::sacn::Sacn;
            let (sacn, lights) = (&s.network.sacn, &s.network.lights);
            Ok(Box::new(Sacn::new(sacn, lights, &s.network.name, units)?))
        }),
    },
    Row {
        name: "Live Link",
        section: "live_link",
        feature: "live-link",
        enabled: |s| s.network.live_link.enabled,
        targets: |s| &s.network.live_link.targets,
        open: built!("live-link", |s, units| {
            use crate::output::live_link::LiveLink;
            let settings = s.network.live_link.clone();
            Ok(Box::new(LiveLink::new(settings, &s.network.name, units)?))
        }),
    },
    Row {
        name: "WebSocket",
        section: "websocket",
        feature: "web",
        enabled: |s| s.network.websocket.enabled,
        targets: |_| &[],
        open: built!("web", |s, units| {
            use crate::output::web::websocket;
            Ok(Box::new(websocket::open(&s.network.websocket, units)?))
        }),
    },
    Row {
        name: "page",
        section: "page",
        feature: "web",
        enabled: |s| s.network.page.enabled,
        targets: |_| &[],
        open: built!("web", |s, units| {
            use crate::output::web::page;
            // It is no place that weights are sent to.
            let sends = listed(enabled(s).filter(|row| row.section != "page"), s);
            let (page, name) = (&s.network.page, &s.network.name);
            Ok(Box::new(page::open(page, name, &sends, units)?))
        }),
    },
    Row {
        name: "OSCQuery",
        section: "oscquery",
        feature: "web",
        enabled: |s| s.network.oscquery.enabled,
        targets: |_| &[],
        open: built!("web", |s, units| {
            use crate::output::web::oscquery;
            let (query, name) = (&s.network.oscquery, &s.network.name);
            Ok(Box::new(oscquery::open(query, &s.osc, name, units)?))
        }),
    },
    Row {
        name: "MQTT",
        section: "mqtt",
        feature: "mqtt",
        enabled: |s| s.network.mqtt.enabled,
        targets: |s| from_ref(&s.network.mqtt.broker),
        open: built!("mqtt", |s, units| {
            use crate::output::mqtt;
            Ok(Box::new(mqtt::open(
                &s.network.mqtt,
                &s.network.name,
                units,
            )?))
        }),
    },
    // Sends no weights: it announces the others.
    Row {
        name: "mDNS",
        section: "discovery",
        feature: "discovery",
        enabled: |s| s.network.discovery.enabled,
        targets: |_| &[],
        open: built!("discovery", |s, _| {
            use crate::output::discovery::Discovery;
            Ok(Box::new(Discovery::new(&s.network.name, services(s))?))
        }),
    },
];

/// Rows of the enabled outputs.
pub(crate) fn enabled(settings: &Settings) -> impl Iterator<Item = &'static Row> {
    OUTPUTS.iter().filter(|row| (row.enabled)(settings))
}

/// Whether this build has every output that is enabled.
///
/// # Errors
/// If it is without one.
pub fn check(settings: &Settings) -> Result<(), OutputError> {
    match enabled(settings).find(|row| row.open.is_none()) {
        Some(row) => Err(OutputError::NotBuilt {
            section: row.section,
            feature: row.feature,
        }),
        None => Ok(()),
    }
}

/// Opens every enabled output. `units` are the names in the order of the weights.
pub(crate) fn open(
    settings: &Settings,
    units: &[&str],
) -> Result<Vec<Box<dyn Output>>, OutputError> {
    check(settings)?;
    let mut settings = settings.clone();
    let network = &mut settings.network;
    for view in [
        &mut settings.osc.view,
        &mut settings.vmc.view,
        &mut settings.vrchat.view,
        &mut settings.serial.view,
        &mut network.lights.view,
        &mut network.live_link.view,
        &mut network.websocket.view,
        &mut network.mqtt.view,
        &mut network.page.view,
    ] {
        view.units.clone_from(&settings.units);
    }
    let open = enabled(&settings).filter_map(|row| row.open);
    open.map(|open| open(&settings, units)).collect()
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
    let rows = rows.filter(|row| row.section != "discovery");
    rows.map(one).collect::<Vec<_>>().join(", ")
}

/// The services to announce.
#[cfg(feature = "discovery")]
fn services(settings: &Settings) -> Vec<crate::output::discovery::Service> {
    let one = |on: bool, listen: &str, kind, transport, text| {
        let (_, port) = listen.rsplit_once(':').filter(|_| on)?;
        Some(crate::output::discovery::Service {
            kind,
            transport,
            port: port.parse().ok()?,
            text,
        })
    };
    let (osc, network) = (&settings.osc, &settings.network);
    let (query, page, pages) = (&network.oscquery, &network.page, &network.websocket);
    [
        one(osc.enabled && osc.commands, &osc.listen, "_osc", "_udp", ""),
        one(query.enabled, &query.listen, "_oscjson", "_tcp", ""),
        one(page.enabled, &page.listen, "_http", "_tcp", "path=/"),
        // A name has one service of a kind, and the page is what a browser can show.
        one(
            pages.enabled && !page.enabled,
            &pages.listen,
            "_http",
            "_tcp",
            "path=/",
        ),
    ]
    .into_iter()
    .flatten()
    .collect()
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
        settings.network.lights.channels = vec!["AU26 1 1".into()];
        settings.network.artnet.enabled = true;
        let opened = open(&settings, &["AU26"]);
        assert_eq!(check(&settings).is_ok(), opened.is_ok());
        assert_eq!(opened.is_ok(), cfg!(feature = "lights"));
        match opened {
            Ok(wires) => assert_eq!(wires[1].tally().name, "artnet"),
            Err(problem) => {
                let told = problem.to_string();
                assert!(told.contains("build with --features lights"), "{told}");
            }
        }
    }
}
