//! `mien devices`: connected sensors with their state and the remedy, and serial ports by the name to use.

use std::path::{Path, PathBuf};

use serialport::{SerialPortInfo, SerialPortType};

use crate::log::one_line;
use mien_outputs::serial::{STABLE_NAMES, stable_name};
use mien_sensors::sensor::{Found, Missing};
use mien_sensors::table::SENSORS;

/// Folder in which Linux lists its terminals.
const TERMINALS: &str = "/sys/class/tty";

/// `mien devices`: one line for each sensor and serial port; a sensor's problem is in an indented line below.
pub fn report() -> String {
    let sensors = SENSORS.iter().map(|kind| (kind.list)());
    text(sensors, &serial_ports())
}

fn text(
    sensors: impl Iterator<Item = Result<Vec<Found>, Missing>>,
    ports: &[(PathBuf, String)],
) -> String {
    let mut lines = Vec::new();
    for kind in sensors {
        match kind {
            Ok(found) => {
                for sensor in found {
                    lines.push(sensor.line);
                    lines.extend(sensor.trouble.map(|trouble| format!("  {trouble}")));
                }
            }
            Err(missing) => lines.push(missing.text),
        }
    }
    for (name, about) in ports {
        lines.push(format!("serial port {}{about}", name.display()));
    }
    if ports.is_empty() {
        lines.push("no serial port".to_owned());
    }
    lines.push(String::new());
    // Device names are untrusted text.
    let lines: Vec<String> = lines.iter().map(one_line).collect();
    lines.join("\n")
}

/// Serial ports: path, a stable one if available, and a description that begins with a comma, empty if unknown.
fn serial_ports() -> Vec<(PathBuf, String)> {
    // `available_ports` requires this folder.
    if cfg!(target_os = "linux") && !Path::new(TERMINALS).exists() {
        return Vec::new();
    }
    let ports = serialport::available_ports().unwrap_or_default();
    let described = |port: SerialPortInfo| {
        let plain = PathBuf::from(&port.port_name);
        let name = stable_name(&plain, Path::new(STABLE_NAMES));
        let about = match port.port_type {
            SerialPortType::UsbPort(usb) => {
                let product = usb.product.map(|product| format!(" {product}"));
                let product = product.unwrap_or_default();
                format!(", USB {:04x}:{:04x}{product}", usb.vid, usb.pid)
            }
            SerialPortType::BluetoothPort => ", Bluetooth".to_owned(),
            SerialPortType::PciPort | SerialPortType::Unknown => String::new(),
        };
        (name.map_or(plain, PathBuf::from), about)
    };
    let mut ports: Vec<_> = ports.into_iter().map(described).collect();
    ports.sort();
    ports
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(line: &str, trouble: Option<&str>) -> Found {
        Found {
            line: line.to_owned(),
            serial: String::new(),
            name: String::new(),
            trouble: trouble.map(str::to_owned),
        }
    }

    #[test]
    fn every_sensor_and_port_is_one_line_and_trouble_one_sentence_below() {
        let sensors = Ok(vec![
            found("a:1, free", None),
            found("a:2", Some("it is in use; stop the other program")),
        ]);
        let none = Err(Missing {
            is_absent: true,
            text: "no b; plug it in".to_owned(),
        });
        let ports = [("/dev/ttyACM0".into(), ", USB 2341:0043 Uno".into())];
        assert_eq!(
            text([sensors, none].into_iter(), &ports),
            "a:1, free\na:2\n  it is in use; stop the other program\nno b; plug it in\n\
             serial port /dev/ttyACM0, USB 2341:0043 Uno\n"
        );
        assert_eq!(text([].into_iter(), &[]), "no serial port\n");
    }

    #[test]
    fn devices_of_this_machine_are_listed() {
        assert!(report().ends_with('\n'));
    }

    #[test]
    fn control_characters_in_device_names_are_replaced() {
        let odd = found("A\n\x1b[2Jkinect:B\u{9b}1m", None);
        let ports = [("/dev/ttyACM0".into(), ", USB 2341:0043 Uno\r\u{7f}".into())];
        let text = text([Ok(vec![odd])].into_iter(), &ports);
        assert_eq!(text.lines().count(), 2, "{text:?}");
        assert!(
            !text.chars().any(|c| c.is_control() && c != '\n'),
            "{text:?}"
        );
    }
}
