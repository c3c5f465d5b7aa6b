//! The outputs that a configuration asks for.

use crate::appliance::settings::Settings;
use crate::output::osc::Osc;
use crate::output::osc::faceosc::FaceOsc;
use crate::output::osc::vmc::Vmc;
use crate::output::osc::vrchat::VrChat;
use crate::output::serial::Serial;
use crate::output::{Output, OutputError};

/// Opens every wire that is switched on. `units` are the names in the order of the weights.
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
    ] {
        view.units.clone_from(&settings.units);
    }
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

/// Where the outputs that are switched on send, for a person to read.
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
    all.join(", ")
}
