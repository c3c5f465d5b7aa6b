//! Opens the outputs enabled in the configuration.

use crate::appliance::settings::Settings;
use crate::output::osc::Osc;
use crate::output::osc::faceosc::FaceOsc;
use crate::output::osc::vmc::Vmc;
use crate::output::osc::vrchat::VrChat;
use crate::output::serial::Serial;
use crate::output::{Output, OutputError};

/// Opens every enabled output. `units` are the names in the order of the weights.
pub(crate) fn open(
    settings: &Settings,
    units: &[&str],
) -> Result<Vec<Box<dyn Output>>, OutputError> {
    let mut wires: Vec<Box<dyn Output>> = Vec::new();
    let mut settings = settings.clone();
    for view in [
        &mut settings.osc.view,
        &mut settings.vmc.view,
        &mut settings.vrchat.view,
        &mut settings.serial.view,
        &mut settings.network.lights.view,
        &mut settings.network.live_link.view,
        &mut settings.network.websocket.view,
        &mut settings.network.mqtt.view,
        &mut settings.network.page.view,
    ] {
        view.units.clone_from(&settings.units);
    }
    open_network(&settings, units, &mut wires)?;
    if settings.osc.enabled {
        wires.push(Box::new(Osc::new(settings.osc, units)?));
    }
    if settings.vmc.enabled {
        wires.push(Box::new(Vmc::new(settings.vmc, units)?));
    }
    if settings.vrchat.enabled {
        wires.push(Box::new(VrChat::new(settings.vrchat, units)?));
    }
    if settings.faceosc.enabled {
        wires.push(Box::new(FaceOsc::new(settings.faceosc)?));
    }
    if !settings.serial.port.is_empty() {
        wires.push(Box::new(Serial::new(&settings.serial, units)?));
    }
    Ok(wires)
}

/// Destinations of the enabled outputs, as text.
pub(crate) fn named(settings: &Settings) -> String {
    let networked = [
        ("OSC", settings.osc.enabled, &settings.osc.targets),
        ("VMC", settings.vmc.enabled, &settings.vmc.targets),
        ("VRChat", settings.vrchat.enabled, &settings.vrchat.targets),
        (
            "FaceOSC",
            settings.faceosc.enabled,
            &settings.faceosc.targets,
        ),
    ];
    let networked = networked.into_iter().filter(|(_, enabled, _)| *enabled);
    let mut all: Vec<String> = networked
        .map(|(name, _, targets)| format!("{name} to {}", targets.join(" and ")))
        .collect();
    if !settings.serial.port.is_empty() {
        all.push(format!("serial to {}", settings.serial.port));
    }
    let network = &settings.network;
    let features = [
        ("Art-Net", network.artnet.enabled),
        ("sACN", network.sacn.enabled),
        ("Live Link", network.live_link.enabled),
        ("WebSocket", network.websocket.enabled),
        ("page", network.page.enabled),
        ("OSCQuery", network.oscquery.enabled),
        ("MQTT", network.mqtt.enabled),
    ];
    let features = features.iter().filter(|(_, enabled)| *enabled);
    all.extend(features.map(|(name, _)| (*name).to_owned()));
    all.join(", ")
}

/// An output that is an optional build feature, or why there is none.
macro_rules! feature {
    ($wires:ident, $section:literal, $feature:literal, $make:expr) => {
        #[cfg(feature = $feature)]
        $wires.push(Box::new($make));
        #[cfg(not(feature = $feature))]
        return Err(OutputError::NotBuilt {
            section: $section,
            feature: $feature,
        });
    };
}

/// Opens the optional outputs.
#[allow(
    unused_variables,
    clippy::needless_return,
    clippy::ptr_arg,
    reason = "without features there is nothing to open"
)]
fn open_network(
    settings: &Settings,
    units: &[&str],
    wires: &mut Vec<Box<dyn Output>>,
) -> Result<(), OutputError> {
    let network = &settings.network;
    if network.artnet.enabled {
        feature!(wires, "artnet", "lights", {
            crate::output::lights::artnet::ArtNet::new(&network.artnet, &network.lights, units)?
        });
    }
    if network.sacn.enabled {
        feature!(wires, "sacn", "lights", {
            let (sacn, lights) = (&network.sacn, &network.lights);
            crate::output::lights::sacn::Sacn::new(sacn, lights, &network.name, units)?
        });
    }
    if network.live_link.enabled {
        feature!(wires, "live_link", "live-link", {
            let settings = network.live_link.clone();
            crate::output::live_link::LiveLink::new(settings, &network.name, units)?
        });
    }
    if network.websocket.enabled {
        feature!(wires, "websocket", "web", {
            crate::output::web::websocket::open(&network.websocket, units)?
        });
    }
    if network.page.enabled {
        feature!(wires, "page", "web", {
            // It is no place that weights are sent to.
            let mut others = settings.clone();
            others.network.page.enabled = false;
            let sends = named(&others);
            let (page, name) = (&network.page, &network.name);
            crate::output::web::page::open(page, name, &sends, units)?
        });
    }
    if network.oscquery.enabled {
        feature!(wires, "oscquery", "web", {
            let (oscquery, osc) = (&network.oscquery, &settings.osc);
            crate::output::web::oscquery::open(oscquery, osc, &network.name, units)?
        });
    }
    if network.discovery.enabled {
        feature!(wires, "discovery", "discovery", {
            crate::output::discovery::Discovery::new(&network.name, services(settings))?
        });
    }
    if network.mqtt.enabled {
        feature!(wires, "mqtt", "mqtt", {
            crate::output::mqtt::open(&network.mqtt, &network.name, units)?
        });
    }
    Ok(())
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
        assert_eq!(opened.is_ok(), cfg!(feature = "lights"));
        match opened {
            Ok(wires) => assert_eq!(wires[0].tally().name, "artnet"),
            Err(problem) => {
                let told = problem.to_string();
                assert!(told.contains("build with --features lights"), "{told}");
            }
        }
    }
}
