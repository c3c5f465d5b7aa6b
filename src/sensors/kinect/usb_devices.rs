//! The Kinects on USB: listing, matching, opening, claiming.
//!
//! A Kinect is a hub with separate devices: camera, audio, and (first series) motor. A part belongs to the camera with the same hub,
//! or if it is the only one on the same bus, or the only one at all. Cameras of later models all report the serial
//! `0000000000000000`; then the audio device's serial is used, or if that cannot be read, the bus and port numbers, which identify
//! a USB port instead of a sensor.

use std::path::Path;
use std::time::Duration;

use rusb::{Context, Device, DeviceHandle, Speed, UsbContext};

use super::device::{DeviceError, Model, Stream};
use super::motor;
use mien_stages::turn::Turn;

/// Product id of the motor device.
const MOTOR: u16 = 0x02b0;
/// Product ids of the audio device.
const AUDIO: [u16; 4] = [0x02ad, 0x02be, 0x02c3, 0x02bb];
/// Product id of the later models' hub.
const HUB: u16 = 0x02c2;
/// Folder of Linux's device nodes.
const NODES: &str = "/dev/bus/usb";
/// Folder in which Linux lists devices and their drivers.
const SYSFS: &str = "/sys/bus/usb/devices";

/// Current user of the camera's interface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Driver {
    /// None.
    Free,
    /// A kernel driver, which is detached on opening: its name.
    Kernel(String),
    /// Another program.
    Program,
}

/// One camera on USB.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Listed {
    /// Model of the sensor.
    pub model: Model,
    /// Serial number for `kinect:SERIAL`; see the module's header.
    pub serial: String,
    /// Speed of the connection; the streams need `480 Mbit/s`.
    pub speed: &'static str,
    /// Number of the bus.
    pub bus: u8,
    /// Address on the bus.
    pub address: u8,
    /// Current user of its interface.
    pub driver: Driver,
    /// Why it could not be opened, if so.
    pub trouble: Option<DeviceError>,
    /// Whether LED and tilt are available: through a motor device, or an audio device with firmware.
    pub motor: bool,
    /// Its turn, by the accelerometer behind a motor device; upright if it has none or cannot be asked.
    pub turn: Turn,
}

/// One line, without the trouble.
impl core::fmt::Display for Listed {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(
            f,
            "kinect:{} {}, {}, bus {} address {}, ",
            self.serial, self.model, self.speed, self.bus, self.address
        )?;
        match &self.driver {
            Driver::Free => f.write_str("free")?,
            Driver::Kernel(name) => write!(f, "driver {name} (detached while mien runs)")?,
            Driver::Program => f.write_str("in use by a program")?,
        }
        f.write_str(if self.motor { "" } else { ", no motor" })?;
        match self.turn {
            Turn::Upright => Ok(()),
            turn => write!(f, ", turned by {} degrees", turn.degrees()),
        }
    }
}

/// All cameras on USB, by bus and address.
///
/// # Errors
/// [`DeviceError::NoUsb`] if programs have no access to USB; [`DeviceError::NoPower`] if there are parts of a Kinect but no camera;
/// [`DeviceError::Absent`] if there is no part of a Kinect.
pub fn devices() -> Result<Vec<Listed>, DeviceError> {
    let bus = Bus::scan()?;
    let cameras = bus.cameras();
    let cameras: Vec<_> = cameras
        .map(|(device, model)| bus.list(device, model))
        .collect();
    if cameras.is_empty() {
        return Err(bus.missing_camera());
    }
    Ok(cameras)
}

/// A camera, opened and claimed, with its other devices.
pub(super) struct Opened {
    pub(super) model: Model,
    pub(super) serial: String,
    // Handles before the context, so that they are dropped first.
    pub(super) camera: DeviceHandle<Context>,
    pub(super) motor: Option<DeviceHandle<Context>>,
    pub(super) audio: Option<DeviceHandle<Context>>,
    pub(super) context: Context,
}

/// Opens and claims the camera with `serial`, or the first free one, and selects the alternate setting with the streams.
///
/// # Errors
/// If there is none, or it cannot be opened.
pub(super) fn open(serial: Option<&str>, reset_audio: bool) -> Result<Opened, DeviceError> {
    let bus = Bus::scan()?;
    let cameras: Vec<_> = bus.cameras().collect();
    let mut failure = match serial {
        Some(wanted) if !cameras.is_empty() => {
            DeviceError::OtherSerial(wanted.to_owned(), cameras.len())
        }
        _ => bus.missing_camera(),
    };
    for (device, model) in cameras {
        let own = bus.serial(device, model);
        if serial.is_some_and(|wanted| wanted != own) {
            continue;
        }
        match bus.claim(device, model) {
            Ok(camera) => {
                // Some units stop streaming without it; others lose their audio device for seconds. A failure is not fatal.
                if reset_audio && model != Model::Xbox1414 {
                    bus.reset_audio(device);
                }
                let motor = bus.find_part(device, &[MOTOR]);
                return Ok(Opened {
                    model,
                    serial: own,
                    camera,
                    motor: motor.and_then(|device| device.open().ok()),
                    audio: (bus.audio_with_firmware(device)).and_then(|it| open_and_claim(it).ok()),
                    context: bus.context.clone(),
                });
            }
            Err(problem) => failure = problem,
        }
    }
    Err(failure)
}

/// Opens a device and claims its first interface; the kernel's driver gets it back at the end.
fn open_and_claim(device: &Device<Context>) -> rusb::Result<DeviceHandle<Context>> {
    let handle = device.open()?;
    // Fails on hosts without kernel drivers, where there is nothing to detach.
    let _ = handle.set_auto_detach_kernel_driver(true);
    handle.claim_interface(0)?;
    Ok(handle)
}

struct Bus {
    context: Context,
    devices: Vec<(Device<Context>, u16, u16)>,
}

impl Bus {
    /// The error if there is no camera.
    fn missing_camera(&self) -> DeviceError {
        if self.has_parts() {
            DeviceError::NoPower
        } else {
            DeviceError::Absent
        }
    }

    /// Lists Microsoft's devices on USB.
    fn scan() -> Result<Self, DeviceError> {
        let no_usb = |problem: rusb::Error| {
            if problem == rusb::Error::Other || !Path::new(NODES).exists() {
                DeviceError::NoUsb
            } else {
                device_error(problem)
            }
        };
        let context = Context::new().map_err(no_usb)?;
        let list = context.devices().map_err(no_usb)?;
        if list.is_empty() && cfg!(target_os = "linux") && !Path::new(NODES).exists() {
            return Err(DeviceError::NoUsb);
        }
        let found = list.iter().filter_map(|device| {
            let descriptor = device.device_descriptor().ok()?;
            let version = descriptor.device_version();
            let release =
                u16::from(version.0) << 8 | u16::from(version.1) << 4 | u16::from(version.2);
            (descriptor.vendor_id() == Model::VENDOR)
                .then(|| (device, descriptor.product_id(), release))
        });
        let place = |device: &Device<Context>| (device.bus_number(), device.address());
        // In order; the library's sort would be 4 kB for a few devices.
        let mut devices: Vec<(Device<Context>, u16, u16)> = Vec::new();
        for one in found {
            let before = devices.partition_point(|(other, ..)| place(other) <= place(&one.0));
            devices.insert(before, one);
        }
        Ok(Self { context, devices })
    }

    fn cameras(&self) -> impl Iterator<Item = (&Device<Context>, Model)> {
        self.devices
            .iter()
            .filter_map(|(device, product, release)| {
                Some((device, Model::from_camera(*product, *release)?))
            })
    }

    fn has_parts(&self) -> bool {
        let mut products = self.devices.iter().map(|(_, product, _)| *product);
        products.any(|product| [MOTOR, HUB].contains(&product))
    }

    /// The device with one of these product ids that belongs to the camera.
    fn find_part(&self, camera: &Device<Context>, products: &[u16]) -> Option<&Device<Context>> {
        let parts = self.devices.iter();
        let parts = parts.filter(|(_, product, _)| products.contains(product));
        let parts: Vec<_> = parts.map(|(device, ..)| device).collect();
        let hub = |device: &Device<Context>| {
            let hub = device.get_parent()?;
            Some((hub.bus_number(), hub.address()))
        };
        let only = |is_near: &dyn Fn(&Device<Context>) -> bool| {
            let mut near = parts.iter().copied().filter(|one| is_near(one));
            near.next().filter(|_| near.next().is_none())
        };
        let of_hub = |one: &&&Device<Context>| hub(camera).is_some() && hub(one) == hub(camera);
        let of_hub = parts.iter().find(of_hub).copied();
        of_hub
            .or_else(|| only(&|one| one.bus_number() == camera.bus_number()))
            .or_else(|| only(&|_| true))
    }

    /// The audio device, if its firmware is running: only then does it have two or more interfaces.
    fn audio_with_firmware(&self, camera: &Device<Context>) -> Option<&Device<Context>> {
        self.find_part(camera, &AUDIO).filter(|device| {
            device
                .active_config_descriptor()
                .is_ok_and(|configuration| configuration.num_interfaces() >= 2)
        })
    }

    /// Resets the audio device ([`super::driver::Settings::reset_audio`]). The handles of the other parts stay valid.
    fn reset_audio(&self, camera: &Device<Context>) {
        let Some(audio) = self.find_part(camera, &AUDIO) else {
            return;
        };
        if let Err(problem) = audio.open().and_then(|handle| handle.reset()) {
            tracing::info!("the Kinect's audio device was not reset: {problem}");
        }
    }

    fn serial(&self, camera: &Device<Context>, model: Model) -> String {
        // Linux has read it when the device was plugged in; readable without permissions.
        let from_sysfs = |device: &Device<Context>| {
            let file = Path::new(SYSFS).join(port_path(device)).join("serial");
            Some(std::fs::read_to_string(file).ok()?.trim().to_owned())
        };
        let from_device = |device: &Device<Context>| {
            let descriptor = device.device_descriptor().ok()?;
            let handle = device.open().ok()?;
            handle.read_serial_number_string_ascii(&descriptor).ok()
        };
        let read = |device: &Device<Context>| {
            let mut serial = from_sysfs(device).or_else(|| from_device(device))?;
            // The text may be printed on a terminal, so control characters are removed.
            serial.retain(|c| c.is_ascii_graphic());
            Some(serial).filter(|serial| serial.chars().any(|c| c != '0'))
        };
        let own = match model {
            Model::Xbox1414 => read(camera),
            _ => read(camera).or_else(|| self.find_part(camera, &AUDIO).and_then(read)),
        };
        own.unwrap_or_else(|| port_path(camera))
    }

    fn list(&self, device: &Device<Context>, model: Model) -> Listed {
        let (bus, address) = (device.bus_number(), device.address());
        let driver = driver(device);
        let trouble = match device.open() {
            Err(problem) => Some(open_error(problem, bus, address)),
            Ok(_) if driver == Driver::Program => Some(DeviceError::Busy(bus, address)),
            Ok(_) => usable_setting(device, model).err(),
        };
        Listed {
            model,
            serial: self.serial(device, model),
            speed: speed(device.speed()),
            bus,
            address,
            driver,
            trouble,
            motor: match model {
                Model::Xbox1414 => self.find_part(device, &[MOTOR]).is_some(),
                _ => self.audio_with_firmware(device).is_some(),
            },
            turn: match model {
                Model::Xbox1414 => self.turn(device).unwrap_or_default(),
                _ => Turn::Upright,
            },
        }
    }

    /// Turn of a camera by its motor device, which answers whoever uses the camera.
    fn turn(&self, camera: &Device<Context>) -> Option<Turn> {
        let motor = self.find_part(camera, &[MOTOR])?.open().ok()?;
        let mut state = [0; motor::STATE_BYTES];
        let read = motor.read_control(0xc0, motor::STATE, 0, 0, &mut state, REQUEST);
        let is_whole = read.is_ok_and(|read| read == state.len());
        is_whole.then(|| Turn::from_acceleration(motor::acceleration(&state)))
    }

    fn claim(
        &self,
        device: &Device<Context>,
        model: Model,
    ) -> Result<DeviceHandle<Context>, DeviceError> {
        let (bus, address) = (device.bus_number(), device.address());
        let handle = open_and_claim(device).map_err(|problem| open_error(problem, bus, address))?;
        let alternate = usable_setting(device, model)?;
        if alternate != 0 && handle.set_alternate_setting(0, alternate).is_err() {
            return Err(DeviceError::NoEndpoint(model, Stream::Depth.endpoint(), 0));
        }
        Ok(handle)
    }
}

/// The alternate setting of interface 0 in which both streams have an isochronous endpoint; the model's usual one is preferred.
///
/// # Errors
/// If the connection is too slow, the device is not configured, or there is no such setting.
fn usable_setting(device: &Device<Context>, model: Model) -> Result<u8, DeviceError> {
    if matches!(device.speed(), Speed::Low | Speed::Full) {
        return Err(DeviceError::Slow(speed(device.speed())));
    }
    let usual = model.alternate_setting();
    let configuration = (device.active_config_descriptor())
        .map_err(|_| DeviceError::NotConfigured(device.bus_number(), device.address()))?;
    let carries = |setting: &rusb::InterfaceDescriptor<'_>, stream: Stream| {
        setting.endpoint_descriptors().any(|endpoint| {
            endpoint.address() == stream.endpoint()
                && endpoint.transfer_type() == rusb::TransferType::Isochronous
        })
    };
    let mut interfaces = configuration.interfaces();
    let interface = interfaces.find(|interface| interface.number() == 0);
    let settings = interface.iter().flat_map(rusb::Interface::descriptors);
    settings
        .filter(|setting| (Stream::BOTH.iter()).all(|stream| carries(setting, *stream)))
        .map(|setting| setting.setting_number())
        .min_by_key(|&setting| (setting != usual, setting))
        .ok_or(DeviceError::NoEndpoint(
            model,
            Stream::Depth.endpoint(),
            usual,
        ))
}

/// Bus and port numbers, which identify a unit without a readable serial.
fn port_path(device: &Device<Context>) -> String {
    let ports = device.port_numbers().unwrap_or_default();
    let ports: Vec<_> = ports.iter().map(u8::to_string).collect();
    format!("{}-{}", device.bus_number(), ports.join("."))
}

fn driver(device: &Device<Context>) -> Driver {
    let link = Path::new(SYSFS).join(format!("{}:1.0/driver", port_path(device)));
    let name = std::fs::read_link(link)
        .ok()
        .and_then(|target| Some(target.file_name()?.to_string_lossy().into_owned()));
    match name.as_deref() {
        None => Driver::Free,
        Some("usbfs") => Driver::Program,
        Some("kinect") => Driver::Kernel("gspca_kinect".to_owned()),
        Some(name) => Driver::Kernel(name.to_owned()),
    }
}

const fn speed(speed: Speed) -> &'static str {
    match speed {
        Speed::Low => "1.5 Mbit/s",
        Speed::Full => "12 Mbit/s",
        Speed::High => "480 Mbit/s",
        Speed::Super => "5 Gbit/s",
        Speed::SuperPlus => "10 Gbit/s",
        _ => "unknown speed",
    }
}

/// Time limit of a request on endpoint 0 and of a bulk message.
pub(super) const REQUEST: Duration = Duration::from_millis(500);

/// The error for a failure to open or claim.
fn open_error(problem: rusb::Error, bus: u8, address: u8) -> DeviceError {
    match problem {
        rusb::Error::Access => DeviceError::Access(bus, address),
        rusb::Error::Busy => DeviceError::Busy(bus, address),
        rusb::Error::NotFound => DeviceError::NotConfigured(bus, address),
        other => device_error(other),
    }
}

/// The error for a failed transfer.
pub(super) fn device_error(problem: rusb::Error) -> DeviceError {
    match problem {
        rusb::Error::NoDevice => DeviceError::Gone,
        rusb::Error::Pipe => DeviceError::Stall,
        rusb::Error::Timeout => DeviceError::TimedOut,
        other => DeviceError::Other(other.to_string()),
    }
}
