//! Keys and mouse buttons that gestures press: through the kernel's `uinput`, or on the wire of a USB HID gadget, where the
//! box is a keyboard for any computer.
//!
//! Sources: Linux `uinput.h` and `input-event-codes.h`; USB HID 1.11, appendix B.1 (boot keyboard); HID Usage Tables 1.5,
//! page 7. With `uinput` the kernel itself releases what is pressed when this process ends, however it ends. A path that is
//! neither gets `uinput`'s events as they are, for tests.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use super::gesture::Switch;
use super::{Output, OutputError, Report, Tally};
use crate::base::capacity::USERS;

/// Keys by name: Linux code, HID usage (0 = none: a mouse button).
#[rustfmt::skip]
const KEYS: [(&str, u16, u8); 66] = [
    ("a", 30, 4), ("b", 48, 5), ("c", 46, 6), ("d", 32, 7), ("e", 18, 8), ("f", 33, 9), ("g", 34, 10), ("h", 35, 11),
    ("i", 23, 12), ("j", 36, 13), ("k", 37, 14), ("l", 38, 15), ("m", 50, 16), ("n", 49, 17), ("o", 24, 18), ("p", 25, 19),
    ("q", 16, 20), ("r", 19, 21), ("s", 31, 22), ("t", 20, 23), ("u", 22, 24), ("v", 47, 25), ("w", 17, 26), ("x", 45, 27),
    ("y", 21, 28), ("z", 44, 29), ("1", 2, 30), ("2", 3, 31), ("3", 4, 32), ("4", 5, 33), ("5", 6, 34), ("6", 7, 35),
    ("7", 8, 36), ("8", 9, 37), ("9", 10, 38), ("0", 11, 39), ("enter", 28, 40), ("escape", 1, 41), ("backspace", 14, 42),
    ("tab", 15, 43), ("space", 57, 44), ("f1", 59, 58), ("f2", 60, 59), ("f3", 61, 60), ("f4", 62, 61), ("f5", 63, 62),
    ("f6", 64, 63), ("f7", 65, 64), ("f8", 66, 65), ("f9", 67, 66), ("f10", 68, 67), ("f11", 87, 68), ("f12", 88, 69),
    ("home", 102, 74), ("page_up", 104, 75), ("delete", 111, 76), ("end", 107, 77), ("page_down", 109, 78),
    ("right", 106, 79), ("left", 105, 80), ("down", 108, 81), ("up", 103, 82),
    ("mouse_left", 0x110, 0), ("mouse_right", 0x111, 0), ("mouse_middle", 0x112, 0), ("play_pause", 164, 0),
];

const EV_KEY: u16 = 1;
const UI_SET_EVBIT: libc::Ioctl = 0x4004_5564;
const UI_SET_KEYBIT: libc::Ioctl = 0x4004_5565;
const UI_DEV_CREATE: libc::Ioctl = 0x5501;
/// Bytes of `struct uinput_user_dev`: the name, bus and ids, then limits of axes that we have none of.
const DEVICE_BYTES: usize = 1116;
/// Bytes of an event.
const EVENT_BYTES: usize = size_of::<libc::timeval>() + 8;
const NAME: &[u8] = b"mien gestures";
/// Keys of a HID report.
const REPORT_KEYS: usize = 6;

/// Whether there is a key of that name.
#[must_use]
pub fn is_key(name: &str) -> bool {
    names().any(|key| key == name)
}

/// Names of all keys.
pub fn names() -> impl Iterator<Item = &'static str> {
    KEYS.iter().map(|key| key.0)
}

/// Where presses go.
enum Way {
    /// Events of the kernel.
    Events,
    /// Reports of a boot keyboard.
    Reports,
}

/// Presses keys.
pub struct Keys {
    device: File,
    way: Way,
    /// Gestures that hold each key, a bit each, and whether the device was told that it is down.
    held: [u128; KEYS.len()],
    is_down: [bool; KEYS.len()],
    sent: u64,
    dropped: u64,
}

impl Keys {
    /// Opens the device.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn new(path: &str) -> Result<Self, OutputError> {
        let failed = |source| OutputError::Keys {
            path: path.to_owned(),
            source,
        };
        let mut device = OpenOptions::new()
            .write(true)
            .custom_flags(libc::O_NONBLOCK)
            .open(path)
            .map_err(failed)?;
        let about = device.metadata().map_err(failed)?;
        let name = Path::new(path).file_name().unwrap_or_default();
        let way = if name.to_string_lossy().starts_with("hidg") {
            Way::Reports
        } else {
            Way::Events
        };
        if about.file_type().is_char_device() && matches!(way, Way::Events) {
            create(&mut device).map_err(failed)?;
        }
        Ok(Self {
            device,
            way,
            held: [0; KEYS.len()],
            is_down: [false; KEYS.len()],
            sent: 0,
            dropped: 0,
        })
    }

    /// Tells the device what changed; what it does not take at once is told again with the next frame.
    fn sync(&mut self) {
        for i in 0..KEYS.len() {
            let is_down = self.held[i] != 0;
            if is_down == self.is_down[i] {
                continue;
            }
            let before = std::mem::replace(&mut self.is_down[i], is_down);
            let written = match self.way {
                Way::Events => self.device.write_all(&press(KEYS[i].1, is_down)),
                Way::Reports => self.device.write_all(&self.report()),
            };
            if written.is_ok() {
                self.sent += 1;
            } else {
                self.dropped += 1;
                self.is_down[i] = before;
            }
        }
    }

    /// The keys that are down, in a boot keyboard's report.
    fn report(&self) -> [u8; 2 + REPORT_KEYS] {
        let mut report = [0; 2 + REPORT_KEYS];
        let down = (0..KEYS.len()).filter(|&i| self.is_down[i] && KEYS[i].2 > 0);
        for (slot, i) in report[2..].iter_mut().zip(down) {
            *slot = KEYS[i].2;
        }
        report
    }
}

impl Output for Keys {
    fn send(&mut self, _: &Report) -> Result<(), OutputError> {
        self.sync();
        Ok(())
    }

    fn switch(&mut self, switch: &Switch<'_>) {
        if let Some(key) = KEYS.iter().position(|key| key.0 == switch.gesture.key) {
            let bit = 1 << (switch.index * (USERS + 1) + switch.user.unwrap_or(USERS));
            if switch.is_on {
                self.held[key] |= bit;
            } else {
                self.held[key] &= !bit;
            }
            self.sync();
        }
    }

    fn tally(&self) -> Tally {
        Tally {
            sent: self.sent,
            dropped: self.dropped,
            ..Tally::of("keys")
        }
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        self.held = [0; KEYS.len()];
        self.sync();
    }
}

/// Two events of the kernel, whose time it fills in: a key, and that this is all.
fn press(code: u16, is_down: bool) -> [u8; 2 * EVENT_BYTES] {
    let mut bytes = [0; 2 * EVENT_BYTES];
    let at = size_of::<libc::timeval>();
    bytes[at..at + 2].copy_from_slice(&EV_KEY.to_ne_bytes());
    bytes[at + 2..at + 4].copy_from_slice(&code.to_ne_bytes());
    bytes[at + 4..at + 8].copy_from_slice(&i32::from(is_down).to_ne_bytes());
    bytes
}

/// Makes a keyboard and mouse of an open `uinput`.
#[expect(unsafe_code, reason = "uinput is set up by ioctl")]
fn create(device: &mut File) -> io::Result<()> {
    let fd = device.as_raw_fd();
    let set = |request: libc::Ioctl, value: u16| {
        // SAFETY: these requests take a number, and the descriptor is open as long as `device` is.
        match unsafe { libc::ioctl(fd, request, libc::c_int::from(value)) } {
            0 => Ok(()),
            _ => Err(io::Error::last_os_error()),
        }
    };
    set(UI_SET_EVBIT, EV_KEY)?;
    KEYS.iter().try_for_each(|key| set(UI_SET_KEYBIT, key.1))?;
    let mut about = [0; DEVICE_BYTES];
    about[..NAME.len()].copy_from_slice(NAME);
    // BUS_VIRTUAL.
    about[80..82].copy_from_slice(&6_u16.to_ne_bytes());
    device.write_all(&about)?;
    set(UI_DEV_CREATE, 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::gesture::Gesture;

    /// What is written for a smile and a brow that press the same key, and for one that presses none.
    fn written(name: &str) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, []).unwrap();
        let gesture = |name: &str, key: &str| Gesture {
            key: key.into(),
            ..Gesture::named(name)
        };
        let all = [
            gesture("smile", "space"),
            gesture("brows", "space"),
            gesture("kiss", ""),
        ];
        let mut keys = Keys::new(path.to_str().unwrap()).unwrap();
        for (index, is_on) in [(0, true), (0, true), (1, true), (2, true), (0, false)] {
            keys.switch(&Switch {
                index,
                gesture: &all[index],
                user: None,
                is_on,
            });
        }
        // The brow is still up.
        assert_eq!(
            std::fs::read(&path).unwrap().len(),
            keys.sent as usize * if name == "hidg0" { 8 } else { 48 }
        );
        assert_eq!(keys.sent, 1);
        drop(keys);
        std::fs::read(&path).unwrap()
    }

    #[test]
    fn a_key_is_down_while_any_gesture_holds_it_and_up_at_the_end() {
        let events = written("events");
        let words: Vec<(u16, u16, i32)> = events
            .chunks(EVENT_BYTES)
            .map(|event| {
                let at = EVENT_BYTES - 8;
                let word = |i: usize| u16::from_ne_bytes([event[at + i], event[at + i + 1]]);
                (word(0), word(2), i32::from(event[at + 4]))
            })
            .collect();
        // KEY_SPACE is 57.
        assert_eq!(words, [(1, 57, 1), (0, 0, 0), (1, 57, 0), (0, 0, 0)]);
    }

    #[test]
    fn a_gadget_gets_the_reports_of_a_boot_keyboard() {
        // Usage 0x2C is the space bar.
        let reports = [[0, 0, 0x2C, 0, 0, 0, 0, 0], [0; 8]].concat();
        assert_eq!(written("hidg0"), reports);
    }

    #[test]
    fn a_device_that_is_not_there_is_named() {
        let error = Keys::new("/dev/none/uinput").err().unwrap().to_string();
        assert!(
            error.starts_with("cannot press keys through \"/dev/none/uinput\": "),
            "{error}"
        );
    }
}
