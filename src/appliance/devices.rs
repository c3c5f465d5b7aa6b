//! `mien devices`: connected sensors with their state and the remedy, and serial ports by the name to use.

use std::path::{Path, PathBuf};

use serialport::SerialPortType;

use crate::log::one_line;
use mien_outputs::serial::{STABLE_NAMES, stable_name};
pub(super) use mien_sensors::kinect::device::DeviceError;
pub(super) use mien_sensors::kinect::usb_devices::{self, Listed};

/// Where Linux lists its terminals.
const TERMINALS: &str = "/sys/class/tty";

/// `mien devices`: one line for each sensor and each serial port; below a sensor, a sentence saying what is wrong, if anything.
pub fn report() -> String {
    text(&usb_devices::devices(), &serial_ports())
}

fn text(sensors: &Result<Vec<Listed>, DeviceError>, ports: &[(PathBuf, String)]) -> String {
    let mut lines = Vec::new();
    match sensors {
        Ok(sensors) => {
            for sensor in sensors {
                lines.push(sensor.to_string());
                let trouble = sensor.trouble.iter();
                lines.extend(trouble.map(|trouble| format!("  {trouble}")));
            }
        }
        Err(problem) => lines.push(problem.to_string()),
    }
    for (name, about) in ports {
        lines.push(format!("serial port {}{about}", name.display()));
    }
    if ports.is_empty() {
        lines.push("no serial port".to_owned());
    }
    lines.push(String::new());
    // What a device calls itself is its own invention.
    let lines: Vec<String> = lines.iter().map(one_line).collect();
    lines.join("\n")
}

/// The machine's serial ports by their stable names where they have one, and what they are, if that is known, after a comma.
fn serial_ports() -> Vec<(PathBuf, String)> {
    // The crate's search takes it for granted that this is there.
    if cfg!(target_os = "linux") && !Path::new(TERMINALS).exists() {
        return Vec::new();
    }
    let ports = serialport::available_ports().unwrap_or_default();
    let mut ports: Vec<(PathBuf, String)> = ports
        .into_iter()
        .map(|port| {
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
        })
        .collect();
    ports.sort();
    ports
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_sensors::kinect::device::Model;
    use mien_sensors::kinect::usb_devices::Driver;

    fn listed(model: Model, driver: Driver, trouble: Option<DeviceError>) -> Listed {
        Listed {
            model,
            serial: "A00366A08793039A".into(),
            speed: "480 Mbit/s",
            bus: 1,
            address: 5,
            driver,
            trouble,
            motor: true,
        }
    }

    #[test]
    fn every_sensor_and_port_is_one_line_and_trouble_one_sentence_below() {
        let sensors = Ok(vec![
            listed(Model::Xbox1414, Driver::Kernel("gspca_kinect".into()), None),
            listed(
                Model::Windows1517,
                Driver::Program,
                Some(DeviceError::Busy(1, 5)),
            ),
        ]);
        let ports = [("/dev/ttyACM0".into(), ", USB 2341:0043 Uno".into())];
        assert_eq!(
            text(&sensors, &ports),
            "kinect:A00366A08793039A Kinect for Xbox 360 (1414), 480 Mbit/s, bus 1 address 5, \
             driver gspca_kinect (detached while mien runs)\n\
             kinect:A00366A08793039A Kinect for Windows (1517), 480 Mbit/s, bus 1 address 5, in use by a program\n  \
             the Kinect at bus 1 address 5 is in use; stop the other program that reads it, or unload its driver with \
             `rmmod gspca_kinect`\n\
             serial port /dev/ttyACM0, USB 2341:0043 Uno\n"
        );
    }

    #[test]
    fn nothing_plugged_in_is_said_with_what_to_do() {
        assert_eq!(
            text(&Err(DeviceError::Absent), &[]),
            "no Kinect on USB (expected a camera 045e:02ae or 045e:02bf); plug in the Kinect and its power supply\n\
             no serial port\n"
        );
        let unpowered = text(&Err(DeviceError::NoPower), &[]);
        assert!(
            unpowered.contains("no 12 V; plug in its power supply\n"),
            "{unpowered}"
        );
        let bare = text(&Err(DeviceError::NoUsb), &[]);
        assert!(bare.contains("/dev/bus/usb is missing"), "{bare}");
    }

    #[test]
    fn whatever_this_machine_has_is_listed_without_panic() {
        assert!(report().ends_with('\n'));
    }

    /// The rule that the permission sentence names covers every part of every model.
    #[test]
    fn the_udev_rule_opens_every_part_of_a_kinect() {
        let rule = include_str!("../../systemd/mien.rules");
        // Cameras, motor, audio devices, the hub of the later models.
        for product in [
            0x02ae, 0x02bf, 0x02b0, 0x02ad, 0x02be, 0x02c3, 0x02bb, 0x02c2,
        ] {
            assert!(rule.contains(&format!("{product:04x}")), "{product:04x}");
        }
        let sentence = DeviceError::Access(1, 5).to_string();
        assert!(sentence.contains("systemd/mien.rules") && rule.contains("60-mien.rules"));
    }

    #[test]
    fn what_a_device_calls_itself_cannot_write_lines_of_its_own() {
        let mut odd = listed(Model::Xbox1414, Driver::Program, None);
        odd.serial = "A\n\x1b[2Jkinect:B\u{9b}1m".into();
        let ports = [("/dev/ttyACM0".into(), ", USB 2341:0043 Uno\r\u{7f}".into())];
        let text = text(&Ok(vec![odd]), &ports);
        assert_eq!(text.lines().count(), 2, "{text:?}");
        assert!(
            !text.chars().any(|c| c.is_control() && c != '\n'),
            "{text:?}"
        );
    }
}
