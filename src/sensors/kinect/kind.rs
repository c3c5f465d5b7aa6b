//! The Kinect and its recordings as sensors ([`Sensor`]).

use core::time::Duration;

use super::device::DeviceError;
use super::frame::FrameSink;
use super::live::LiveKinect;
use super::recording::Recording;
use super::registration::Registration;
use super::usb_devices::{self, Listed};
use crate::sensor::{
    Activity, Found, Missing, Opened, Sensor, SensorError, SensorKind, SensorState, Settings,
};
use mien_stages::base::prelude::*;
use mien_stages::camera::Camera;

/// Longest wait for a frame.
const WAIT: Duration = Duration::from_millis(500);
/// Longest wait for the first attempt to open a device.
const FIRST_ATTEMPT: Duration = Duration::from_secs(10);

/// The row of the Kinect v1.
pub(crate) const KIND: SensorKind = SensorKind {
    name: "kinect",
    title: "Kinect",
    open,
    list: || listed(usb_devices::devices()),
    missing: |wanted, found| {
        let is_other = found.iter().all(|device| device.serial != wanted);
        let other = || DeviceError::OtherSerial(wanted.to_owned(), found.len()).to_string();
        is_other.then(other)
    },
};

fn open(serial: Option<&str>, settings: &Settings) -> Opened {
    let mut live = LiveKinect::usb(serial.map(str::to_owned), settings.kinect);
    let status = live.wait_for_first_attempt(FIRST_ATTEMPT);
    let problem = (status.openings == 0)
        .then(|| SensorError::new(status.waiting_for.unwrap_or(DeviceError::TimedOut.into())));
    (Box::new(live), problem)
}

fn listed(devices: Result<Vec<Listed>, DeviceError>) -> Result<Vec<Found>, Missing> {
    let devices = devices.map_err(|problem| Missing {
        is_absent: matches!(problem, DeviceError::Absent),
        text: problem.to_string(),
    })?;
    let found = devices.iter().map(|device| Found {
        line: device.to_string(),
        serial: device.serial.clone(),
        name: String::new(),
        trouble: device.trouble.as_ref().map(ToString::to_string),
    });
    Ok(found.collect())
}

impl Sensor for LiveKinect {
    fn next_frame(&mut self, mut into: &mut dyn FrameSink) -> Result<bool, SensorError> {
        if LiveKinect::next_frame(self, &mut into, WAIT) {
            return Ok(true);
        }
        let problem = self.status().waiting_for;
        Err(SensorError::new(
            problem.unwrap_or_else(|| DeviceError::Gone.into()),
        ))
    }

    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn state(&self) -> SensorState {
        SensorState {
            is_live: true,
            arrived: self.arrived,
            skipped: self.broken_depth_images(),
            ..SensorState::default()
        }
    }

    fn registration(&self) -> Option<&Registration> {
        Some(&self.registration)
    }

    fn acceleration(&self) -> Option<[i16; 3]> {
        self.acceleration
    }

    fn show(&self, activity: Activity) {
        LiveKinect::show(self, activity);
    }
}

impl Sensor for Recording {
    fn next_frame(&mut self, mut into: &mut dyn FrameSink) -> Result<bool, SensorError> {
        Ok(Recording::next_frame(self, &mut into))
    }

    fn camera(&self) -> &Camera {
        &self.camera
    }

    fn state(&self) -> SensorState {
        SensorState {
            frames: self.frames(),
            skipped: self.skipped(),
            ..SensorState::default()
        }
    }

    fn registration(&self) -> Option<&Registration> {
        Some(&self.registration)
    }

    fn acceleration(&self) -> Option<[i16; 3]> {
        self.acceleration
    }

    fn seek(&mut self, number: usize) {
        Recording::seek(self, number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinect::device::Model;
    use crate::kinect::usb_devices::Driver;
    use mien_stages::turn::Turn;

    fn device(model: Model, driver: Driver, trouble: Option<DeviceError>) -> Listed {
        Listed {
            model,
            serial: "A00366A08793039A".into(),
            speed: "480 Mbit/s",
            bus: 1,
            address: 5,
            driver,
            trouble,
            motor: true,
            turn: Turn::Upright,
        }
    }

    #[test]
    fn a_device_is_one_line_and_its_trouble_a_sentence() {
        let kernel = Driver::Kernel("gspca_kinect".into());
        let found = listed(Ok(vec![
            device(Model::Xbox1414, kernel, None),
            device(
                Model::Windows1517,
                Driver::Program,
                Some(DeviceError::Busy(1, 5)),
            ),
            Listed {
                turn: Turn::ThreeQuarters,
                ..device(Model::Xbox1414, Driver::Free, None)
            },
        ]));
        let Ok([first, second, third]) = found.as_deref() else {
            panic!("two devices");
        };
        assert_eq!(
            first.line,
            "kinect:A00366A08793039A Kinect for Xbox 360 (1414), 480 Mbit/s, bus 1 address 5, \
             driver gspca_kinect (detached while mien runs)"
        );
        assert_eq!(
            second.line,
            "kinect:A00366A08793039A Kinect for Windows (1517), 480 Mbit/s, bus 1 address 5, in use by a program"
        );
        assert!(third.line.ends_with(", free, turned by 270 degrees"));
        assert_eq!(first.trouble, None);
        assert_eq!(
            second.trouble.as_deref(),
            Some(
                "the Kinect at bus 1 address 5 is in use; stop the other program that reads it, or unload its driver with \
                 `rmmod gspca_kinect`"
            )
        );
    }

    #[test]
    fn without_a_device_the_remedy_is_named() {
        let text = |problem| listed(Err(problem)).err().map(|missing| missing.text);
        assert_eq!(
            text(DeviceError::Absent).as_deref(),
            Some(
                "no Kinect on USB (expected a camera 045e:02ae or 045e:02bf); plug in the Kinect and its power supply"
            )
        );
        for (problem, words) in [
            (DeviceError::NoPower, "no 12 V; plug in its power supply"),
            (DeviceError::NoUsb, "/dev/bus/usb is missing"),
        ] {
            let text = text(problem).expect("no device");
            assert!(text.contains(words), "{text}");
        }
    }

    /// The rule that the permission sentence names covers every part of every model.
    #[test]
    fn the_udev_rule_opens_every_part_of_a_kinect() {
        let rule = include_str!("../../../systemd/mien.rules");
        // Cameras, motor, audio devices, the hub of the later models.
        for product in [
            0x02ae, 0x02bf, 0x02b0, 0x02ad, 0x02be, 0x02c3, 0x02bb, 0x02c2,
        ] {
            assert!(rule.contains(&format!("{product:04x}")), "{product:04x}");
        }
        let sentence = DeviceError::Access(1, 5).to_string();
        assert!(sentence.contains("systemd/mien.rules") && rule.contains("60-mien.rules"));
    }
}
