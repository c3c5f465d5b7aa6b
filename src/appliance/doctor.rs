//! `mien doctor`: one line per requirement of a run, OK, WARN or FAIL, and the remedy. It changes nothing, and opens only
//! devices and files that a run would open.

use std::fmt::{Display, Write as _};
use std::io::ErrorKind;
use std::net::{IpAddr, ToSocketAddrs};
use std::path::Path;

use crate::log::one_line;
use crate::service;
use crate::settings::Settings;
use crate::source;
use mien_outputs::table;
use mien_sensors::sensor::Missing;
use mien_stages::base::bounded_read::reason;

/// Kernel limit on the memory of USB transfers, in MB.
const USB_MEMORY: &str = "/sys/module/usbcore/parameters/usbfs_memory_mb";
/// Memory for one sensor's transfers in flight and a second program, MB.
const USB_MEMORY_MB: u32 = 4;

/// Verdicts, as they begin a line.
const OK: &str = "OK  ";
const WARN: &str = "WARN";
const FAIL: &str = "FAIL";

/// The lines so far.
#[derive(Default)]
struct Lines {
    text: String,
    failed: bool,
}

impl Lines {
    fn say(&mut self, verdict: &str, what: &str, text: impl Display) {
        self.failed |= verdict == FAIL;
        // Writing to a string cannot fail.
        let _ = writeln!(self.text, "{verdict}  {what}: {}", one_line(text));
    }

    /// Adds OK, or the verdict `otherwise` with the problem.
    fn judge<T: Display>(&mut self, otherwise: &str, what: &str, found: Result<T, impl Display>) {
        match found {
            Ok(text) => self.say(OK, what, text),
            Err(problem) => self.say(otherwise, what, problem),
        }
    }
}

/// The report and its exit code: 2 for an invalid configuration, else 1 if any line is FAIL, else 0. `config` as for a run.
pub fn report(config: Option<&Path>) -> (String, u8) {
    let mut lines = Lines::default();
    let found = service::settings(config);
    let configured = found.is_ok();
    let known = found.as_ref().map(|_| "all keys are known and in range");
    lines.judge(FAIL, "configuration", known);
    let settings = found.unwrap_or_else(|_| service::settings_unchecked(config));
    let model = service::model(settings.sensor.model()).map(|model| format!("{:08x}", model.id));
    lines.judge(FAIL, "face model", model);
    sensor(&mut lines, &settings);
    let limit = std::fs::read_to_string(USB_MEMORY).unwrap_or_default();
    if let Ok(megabytes @ 1..USB_MEMORY_MB) = limit.trim().parse() {
        let advice = format!("write 16 to {USB_MEMORY}");
        let text = format_args!("the limit is {megabytes} MB for all transfers; {advice}");
        lines.say(WARN, "USB memory", text);
    }
    serial(&mut lines, &settings.outputs.serial.port);
    targets(&mut lines, &settings);
    status(&mut lines, Path::new(&settings.status_path));
    let failed = lines.failed.into();
    let code = if configured { failed } else { 2 };
    (lines.text, code)
}

fn sensor(lines: &mut Lines, settings: &Settings) {
    if let Some(turn) = settings.sensor.turned {
        let text = format_args!("turned by {} degrees, as configured", turn.degrees());
        lines.say(OK, "sensor", text);
    }
    let (kinds, wanted) = source::kinds(&settings.sensor.source);
    if kinds.is_empty() {
        let text = format_args!("using {}; no sensor is needed", settings.sensor.source);
        return lines.say(OK, "sensor", text);
    }
    for kind in kinds {
        let found = match (kind.list)() {
            Ok(found) => found,
            Err(Missing { is_absent, text }) => {
                lines.say(if is_absent { WARN } else { FAIL }, "sensor", text);
                continue;
            }
        };
        for sensor in &found {
            match &sensor.trouble {
                None => lines.say(OK, "sensor", &sensor.line),
                Some(trouble) => lines.say(FAIL, "sensor", trouble),
            }
        }
        if wanted.is_none() && found.iter().any(|sensor| sensor.trouble.is_none()) {
            // What a run with this source opens; further kinds do not matter.
            return;
        }
        if let Some(text) = wanted.and_then(|wanted| (kind.missing)(wanted, &found)) {
            lines.say(FAIL, "sensor", text);
        }
    }
}

fn serial(lines: &mut Lines, port: &str) {
    let absent = "plug it in (`mien run` waits for it); `mien devices` lists what is connected";
    let forbidden = "add the user to the group dialout and log in again";
    match port {
        "" => lines.say(OK, "serial port", "none configured"),
        _ if port.starts_with("tcp:") => {
            let text = format_args!("{port} was not tested; `mien run` connects to it");
            lines.say(OK, "serial port", text);
        }
        _ => device(lines, "serial port", port, [absent, forbidden]),
    }
}

/// Checks a device that a run opens, with retries; the array has the remedies for an absent and for a forbidden device.
fn device(lines: &mut Lines, what: &str, path: &str, [absent, forbidden]: [&str; 2]) {
    // Opening it as a plain file neither raises DTR, nor locks it, nor creates a uinput keyboard.
    let Err(problem) = std::fs::OpenOptions::new().write(true).open(path) else {
        return lines.say(OK, what, format_args!("{path} is writable"));
    };
    let (verdict, advice) = match problem.kind() {
        ErrorKind::NotFound => (WARN, absent),
        ErrorKind::PermissionDenied => (FAIL, forbidden),
        _ => (FAIL, "stop the other program that uses it"),
    };
    let problem = reason(problem);
    let text = format_args!("{path} cannot be opened ({problem}); {advice}");
    lines.say(verdict, what, text);
}

/// Checks the device that presses keys.
fn keys(lines: &mut Lines, path: &str) {
    let absent = if path.ends_with("uinput") {
        "run `modprobe uinput` as root, and write uinput into /etc/modules-load.d/uinput.conf to load it at every boot; `mien run` waits for it"
    } else {
        "set up the USB gadget, for example with docs/examples/usb_keyboard; `mien run` waits for it"
    };
    let forbidden = "for the service, install mien-keys.conf as described in docs/gestures.md; otherwise add a udev rule that lets the user write to it";
    device(lines, "keys", path, [absent, forbidden]);
}

fn targets(lines: &mut Lines, settings: &Settings) {
    let unknown = "does not resolve; check the name, or give an address like 192.168.1.20:9130";
    for row in table::enabled(&settings.outputs) {
        let targets = (row.targets)(&settings.outputs);
        match row.section {
            "serial" => {}
            "keys" => keys(lines, &settings.outputs.keys.device),
            section => {
                for target in targets {
                    let found = target.to_socket_addrs().ok().and_then(|mut all| all.next());
                    let receivers = found.map(|address| receivers(address.ip()));
                    let verdict = if receivers.is_some() { OK } else { WARN };
                    let text = receivers.unwrap_or(unknown);
                    lines.say(verdict, section, format_args!("{target} {text}"));
                }
            }
        }
    }
}

/// The receivers of data sent to an address.
fn receivers(address: IpAddr) -> &'static str {
    let last = match address {
        IpAddr::V4(address) => address.octets()[3],
        IpAddr::V6(_) => 0,
    };
    if address.is_loopback() {
        "resolves; only programs on this machine receive it"
    } else if address.is_multicast() {
        "resolves; every computer that joins this multicast group receives it"
    } else if last == u8::MAX {
        "resolves; as a broadcast address it reaches every computer on its network"
    } else {
        "resolves; that computer receives it"
    }
}

fn status(lines: &mut Lines, path: &Path) {
    if path.as_os_str().is_empty() {
        return lines.say(OK, "status", "no status files configured");
    }
    let folder = path.parent().unwrap_or(Path::new("."));
    let probe = folder.join(".mien-doctor");
    // Created only to test write access.
    let found = std::fs::File::create(&probe).inspect(|_| drop(std::fs::remove_file(&probe)));
    let folder = folder.display();
    let advice = "the service creates it; otherwise set status.path to another folder";
    let found = found.map(|_| format!("status files go to {folder}"));
    let found = found
        .map_err(|problem| format!("{folder} is not writable ({}); {advice}", reason(problem)));
    lines.judge(WARN, "status", found);
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_outputs::gesture::ENABLED;

    fn verdicts(text: &str) -> Vec<&str> {
        text.lines().map(|line| &line[..4]).collect()
    }

    #[test]
    fn a_valid_configuration_has_one_line_per_check_and_no_fail() {
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("mien.toml");
        let status = folder.path().join("status.json");
        let text = format!("[sensor]\nsource = \"simulated\"\n[status]\npath = {status:?}\n");
        std::fs::write(&config, text).unwrap();
        let (text, code) = report(Some(&config));
        assert_eq!(code, 0, "{text}");
        assert_eq!(verdicts(&text).len(), 6, "{text}");
        assert!(verdicts(&text).iter().all(|word| *word == "OK  "), "{text}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_configured_turn_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("mien.toml");
        let text = "[sensor]\nsource = \"simulated\"\nturned = 270\n";
        std::fs::write(&config, text).unwrap();
        let (text, _) = report(Some(&config));
        assert!(
            text.contains("OK    sensor: turned by 270 degrees"),
            "{text}"
        );
    }

    #[test]
    fn each_target_is_listed_with_its_receivers() {
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("mien.toml");
        let text = "[sensor]\nsource = \"simulated\"\n[osc]\ntarget = [\"127.0.0.1:1\", \"192.0.2.255:1\", \"239.0.0.1:1\", \"192.0.2.7:1\"]\n";
        std::fs::write(&config, text).unwrap();
        let (text, _) = report(Some(&config));
        for who in [
            "127.0.0.1:1 resolves; only programs on this machine",
            "192.0.2.255:1 resolves; as a broadcast address",
            "239.0.0.1:1 resolves; every computer that joins",
            "192.0.2.7:1 resolves; that computer",
        ] {
            assert!(text.contains(who), "{who}: {text}");
        }
    }

    #[test]
    fn each_problem_is_reported_with_its_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("mien.toml");
        let text = "[sensor]\nsource = \"simulated\"\nmodel = \"/nowhere/face.model\"\n\
                    [serial]\nport = \"/dev/nowhere\"\n[osc]\ntarget = \"nowhere.invalid:9130\"\n\
                    [status]\npath = \"/nowhere/status.json\"\n";
        std::fs::write(&config, text).unwrap();
        let (text, code) = report(Some(&config));
        assert_eq!(code, 2);
        assert!(
            text.contains("mien.toml:3:9: /nowhere/face.model: "),
            "{text}"
        );
        let expected = ["FAIL", "FAIL", "OK  ", "WARN", "WARN", "WARN"];
        assert_eq!(verdicts(&text), expected, "{text}");
        for remedy in [
            "mien-studio train",
            "mien devices",
            "192.168.1.20",
            "status.path",
        ] {
            assert!(text.contains(remedy), "{remedy}: {text}");
        }
        if ENABLED {
            let text = "[keys]\ndevice = \"/nowhere/uinput\"\n[[gesture]]\nname = \"smile\"\nkey = \"a\"\n";
            std::fs::write(&config, text).unwrap();
            let (text, _) = report(Some(&config));
            let line = text.lines().find(|line| line.contains("keys: ")).unwrap();
            assert!(
                line.starts_with("WARN") && line.contains("modprobe uinput"),
                "{line}"
            );
            assert!(!text.contains("does not resolve"), "{text}");
        }
        std::fs::write(&config, "[osc]\nnonsense = 1\n").unwrap();
        let (text, code) = report(Some(&config));
        assert!(
            code == 2 && text.starts_with("FAIL  configuration: "),
            "{text}"
        );
    }
}
