//! Presses keys and mouse buttons for gestures: through the kernel's `uinput`, or as a USB HID gadget that is a keyboard for
//! another computer.
//!
//! A tapped key goes up with the frame after it went down. With `uinput` the kernel releases pressed keys when this process ends.
//! A gadget's host is not informed of that, so an empty report is sent when the gadget is opened.
//!
//! Sources: Linux `uinput.h` and `input-event-codes.h`; USB HID 1.11, appendix B.1 (boot keyboard); HID Usage Tables 1.5,
//! page 7. Any other path receives `uinput`'s events, for tests.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;
use std::time::{Duration, Instant};

use super::gesture::{Gesture, Press, Switch};
use super::key_codes::KEYS;
use super::limits::BackOff;
use super::{Output, OutputError, Report, Tally};
use mien_stages::base::capacity::USERS;

const EV_KEY: u16 = 1;
const UI_SET_EVBIT: libc::Ioctl = 0x4004_5564;
const UI_SET_KEYBIT: libc::Ioctl = 0x4004_5565;
const UI_DEV_CREATE: libc::Ioctl = 0x5501;
/// Bytes of `struct uinput_user_dev`: name, bus and ids, then limits of axes (unused).
const DEVICE_BYTES: usize = 1116;
/// Bytes of an event's time: two kernel words, independent of the C library's `time_t`.
const TIME_BYTES: usize = 2 * size_of::<libc::c_ulong>();
/// Bytes of an event.
const EVENT_BYTES: usize = TIME_BYTES + 8;
/// Key codes that a device must have to be taken for a keyboard.
const KEYBOARD: core::ops::Range<u16> = 1..89;
const NAME: &[u8] = b"mien gestures";
/// Attempts to release the last keys at the end.
const RELEASE_TRIES: u32 = 100;
/// Pause between these attempts.
const RELEASE_PAUSE: Duration = Duration::from_millis(2);
/// First and longest pause before reopening the device.
const PAUSES: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(5)];
/// Keys in a HID report.
const REPORT_KEYS: usize = 6;

/// An output that presses keys.
pub struct Keys {
    path: String,
    /// `None` while it is missing or may not be used.
    device: Option<File>,
    /// Time of the next attempt to open it.
    retry_at: Instant,
    back_off: BackOff,
    /// Whether the device takes boot-keyboard reports instead of kernel events.
    is_gadget: bool,
    /// Gestures that hold each key, one bit each.
    held: [u128; KEYS.len()],
    /// Whether each key is being tapped.
    tapped: [bool; KEYS.len()],
    /// Whether each key was last sent as pressed.
    is_down: [bool; KEYS.len()],
    tally: Tally,
}

impl Keys {
    /// Opens the device at `path`; if that fails, retries with later frames.
    pub fn new(path: &str) -> Self {
        let mut keys = Self {
            path: path.to_owned(),
            device: None,
            retry_at: Instant::now(),
            back_off: BackOff::new(PAUSES),
            is_gadget: is_gadget(path),
            held: [0; KEYS.len()],
            tapped: [false; KEYS.len()],
            is_down: [false; KEYS.len()],
            tally: Tally::empty("keys"),
        };
        if let Err(problem) = keys.open() {
            tracing::warn!("{problem} Retrying every {} s", PAUSES[1].as_secs());
        }
        keys
    }

    /// Opens the device; held keys are pressed with the next frame.
    ///
    /// # Errors
    /// If the device is missing or may not be used.
    fn open(&mut self) -> Result<(), OutputError> {
        self.retry_at = Instant::now() + self.back_off.pause();
        let opened = open_device(&self.path, self.is_gadget);
        let mut device = opened.map_err(|problem| OutputError::Keys(self.path.clone(), problem))?;
        self.is_down = [false; KEYS.len()];
        if self.is_gadget {
            // Fails without a host, which does not matter.
            let _ = device.write_all(&self.report());
        }
        self.device = Some(device);
        self.back_off.reset();
        Ok(())
    }

    /// Sends changed keys to the device; changes it does not accept at once are sent again with the next frame.
    fn sync(&mut self) {
        if self.device.is_none() {
            // A tap that cannot be sent is not made up for.
            self.tapped = [false; KEYS.len()];
            return;
        }
        for i in 0..KEYS.len() {
            let is_down = self.held[i] != 0 || self.tapped[i];
            if is_down == self.is_down[i] {
                continue;
            }
            let before = std::mem::replace(&mut self.is_down[i], is_down);
            let report = self.report();
            let events = key_events(KEYS[i].1, is_down);
            let bytes: &[u8] = if self.is_gadget { &report } else { &events };
            let written = self.device.as_mut().map(|device| device.write_all(bytes));
            if let Some(Ok(())) = written {
                self.tally.sent += 1;
                continue;
            }
            self.tally.dropped += 1;
            self.is_down[i] = before;
            // The device is gone, not just busy or without a host.
            let problem = written.and_then(Result::err);
            if problem.is_some_and(|problem| problem.raw_os_error() == Some(libc::ENODEV)) {
                let (path, pause_s) = (&self.path, PAUSES[1].as_secs());
                tracing::warn!("{path} is gone; retrying every {pause_s} s");
                self.device = None;
                return;
            }
        }
    }

    /// Boot-keyboard report of the keys that are down.
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
        if self.device.is_none() && Instant::now() >= self.retry_at && self.open().is_ok() {
            tracing::info!("pressing keys through {}", self.path);
        }
        for (tapped, is_down) in self.tapped.iter_mut().zip(self.is_down) {
            *tapped &= !is_down;
        }
        self.sync();
        Ok(())
    }

    fn switch(&mut self, switch: &Switch<'_>) {
        if let Some(key) = KEYS.iter().position(|key| key.0 == switch.gesture.key) {
            let bit = 1 << (switch.index * (USERS + 1) + switch.user.unwrap_or(USERS));
            match switch.gesture.press {
                Press::Tap => self.tapped[key] |= switch.is_on && switch.is_new,
                Press::Hold if switch.is_on => self.held[key] |= bit,
                Press::Hold => self.held[key] &= !bit,
            }
            self.sync();
        }
    }

    fn tally(&self) -> Tally {
        Tally {
            connected: self.device.is_some(),
            ..self.tally
        }
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        (self.held, self.tapped) = ([0; KEYS.len()], [false; KEYS.len()]);
        // A gadget takes one report at a time, and its host may be gone.
        for _ in 0..RELEASE_TRIES {
            self.sync();
            if self.device.is_none() || !self.is_down.contains(&true) {
                return;
            }
            std::thread::sleep(RELEASE_PAUSE);
        }
    }
}

/// Checks that the device at `path` has the gestures' keys.
///
/// # Errors
/// The first key that it lacks.
pub fn check(path: &str, gestures: &[Gesture]) -> Result<(), OutputError> {
    let lacks = |key: &&str| is_gadget(path) && KEYS.iter().any(|one| one.0 == *key && one.2 == 0);
    let mut keys = gestures.iter().map(|gesture| gesture.key.as_str());
    let missing = keys.find(lacks).map(str::to_owned);
    missing.map_or(Ok(()), |key| Err(OutputError::NotOverUsb(key)))
}

/// Whether the path is that of a USB HID gadget.
fn is_gadget(path: &str) -> bool {
    let name = Path::new(path).file_name().unwrap_or_default();
    name.to_string_lossy().starts_with("hidg")
}

/// Opens a device for non-blocking writes; makes a keyboard of `uinput`.
fn open_device(path: &str, is_gadget: bool) -> io::Result<File> {
    let mut mode = OpenOptions::new();
    let mode = mode.write(true).custom_flags(libc::O_NONBLOCK);
    let mut device = mode.open(path)?;
    if device.metadata()?.file_type().is_char_device() && !is_gadget {
        create_uinput(&mut device)?;
    }
    Ok(device)
}

/// Two kernel events, a key and the end of the report; the kernel fills in their times.
fn key_events(code: u16, is_down: bool) -> [u8; 2 * EVENT_BYTES] {
    let mut bytes = [0; 2 * EVENT_BYTES];
    let at = TIME_BYTES;
    bytes[at..at + 2].copy_from_slice(&EV_KEY.to_ne_bytes());
    bytes[at + 2..at + 4].copy_from_slice(&code.to_ne_bytes());
    bytes[at + 4..at + 8].copy_from_slice(&i32::from(is_down).to_ne_bytes());
    bytes
}

/// Creates a keyboard and mouse on an open `uinput`.
#[expect(unsafe_code, reason = "uinput is set up by ioctl")]
fn create_uinput(device: &mut File) -> io::Result<()> {
    let fd = device.as_raw_fd();
    let set = |request: libc::Ioctl, value: u16| {
        // SAFETY: these requests take a number, and the descriptor is open as long as `device` is.
        match unsafe { libc::ioctl(fd, request, libc::c_int::from(value)) } {
            0 => Ok(()),
            _ => Err(io::Error::last_os_error()),
        }
    };
    set(UI_SET_EVBIT, EV_KEY)?;
    for code in KEYBOARD.chain(KEYS.iter().map(|key| key.1)) {
        set(UI_SET_KEYBIT, code)?;
    }
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
    use crate::gesture::{Gestures, Person};
    use mien_stages::base::time::Timestamp;
    use mien_stages::users::TrackingState;

    /// A new state of a gesture.
    fn switch(index: usize, gesture: &Gesture, is_on: bool) -> Switch<'_> {
        Switch {
            index,
            gesture,
            user: None,
            is_on,
            is_new: true,
        }
    }

    /// Bytes written for a smile and a brow that press the same key, and for a gesture without a key.
    fn written(name: &str) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, []).unwrap();
        let gesture = |name: &str, key: &str| Gesture {
            key: key.into(),
            press: Press::Hold,
            ..Gesture::named(name)
        };
        let keys = [("smile", "space"), ("brows", "space"), ("kiss", "")];
        let all = keys.map(|(name, key)| gesture(name, key));
        let mut keys = Keys::new(path.to_str().unwrap());
        for (index, is_on) in [(0, true), (0, true), (1, true), (2, true), (0, false)] {
            keys.switch(&switch(index, &all[index], is_on));
        }
        // The brow is still up.
        assert_eq!(keys.tally.sent, 1);
        drop(keys);
        std::fs::read(&path).unwrap()
    }

    #[test]
    fn a_key_is_down_while_any_gesture_holds_it_and_up_at_the_end() {
        let events = written("events");
        let words = events.chunks(EVENT_BYTES).map(|event| {
            let event = &event[EVENT_BYTES - 8..];
            let word = |i: usize| u16::from_ne_bytes([event[i], event[i + 1]]);
            (word(0), word(2), i32::from(event[4]))
        });
        let words: Vec<(u16, u16, i32)> = words.collect();
        // KEY_SPACE is 57.
        assert_eq!(words, [(1, 57, 1), (0, 0, 0), (1, 57, 0), (0, 0, 0)]);
    }

    #[test]
    fn a_gadget_gets_the_reports_of_a_boot_keyboard() {
        // Usage 0x2C is the space bar.
        let reports = [[0; 8], [0, 0, 0x2C, 0, 0, 0, 0, 0], [0; 8]].concat();
        assert_eq!(written("hidg0"), reports);
    }

    #[test]
    fn keys_that_a_gadget_lacks_are_refused() {
        let gesture = |key: &str| Gesture {
            key: key.into(),
            ..Gesture::named("smile")
        };
        let all = ["", "enter", "mouse_left"].map(gesture);
        assert!(check("/dev/uinput", &all).is_ok() && check("/dev/hidg0", &all[..2]).is_ok());
        let problem = check("/dev/hidg0", &all).unwrap_err().to_string();
        assert!(
            problem.contains("no key \"mouse_left\"; choose another"),
            "{problem}"
        );
    }

    #[test]
    fn a_tap_is_down_until_the_next_frame_whatever_else_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("events");
        std::fs::write(&path, []).unwrap();
        let gesture = Gesture {
            key: "a".into(),
            ..Gesture::named("smile")
        };
        let mut keys = Keys::new(path.to_str().unwrap());
        let mut downs = Vec::new();
        for (is_on, is_new) in [(true, true), (true, false), (false, true), (true, true)] {
            keys.switch(&Switch {
                is_new,
                ..switch(0, &gesture, is_on)
            });
            downs.push(keys.is_down.contains(&true));
            keys.send(&Report::default()).unwrap();
            downs.push(keys.is_down.contains(&true));
        }
        assert_eq!(
            downs,
            [true, false, false, false, false, false, true, false]
        );
    }

    /// Key downs (`true`) and ups.
    fn presses(events: &[u8]) -> Vec<bool> {
        let pairs = events.chunks_exact(2 * EVENT_BYTES);
        pairs.map(|pair| pair[TIME_BYTES + 4] == 1).collect()
    }

    #[test]
    fn a_thousand_random_endings_leave_no_key_down() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("events");
        let gesture = |person, press| Gesture {
            of: "AU26".into(),
            hold_s: 0.0,
            pause_s: 0.0,
            key: "a".into(),
            person,
            press,
            ..Gesture::named("jaw")
        };
        let all = [
            gesture(Person::Any, Press::Hold),
            gesture(Person::Each, Press::Hold),
            gesture(Person::Shown, Press::Tap),
        ];
        let mut random = fastrand::Rng::with_seed(11);
        let mut pressed = 0;
        for round in 0..1000 {
            std::fs::write(&path, []).unwrap();
            let mut keys = Keys::new(path.to_str().unwrap());
            let mut gestures = Gestures::new(&all, &["AU26"]);
            let mut frame = |gestures: &mut Gestures, reports: &mut [Report<'_>]| {
                gestures.observe(reports);
                reports.iter().for_each(|report| keys.send(report).unwrap());
                gestures.for_each_switch(|switch| keys.switch(switch));
            };
            let mut at = Timestamp::from_us(random.u64(..1 << 40));
            for _ in 0..random.usize(1..30) {
                at = Timestamp::from_us(at.as_us() + random.u64(1..400_000));
                let weights = [random.f32(), random.f32()];
                let user = |slot: usize, state| Report {
                    user: Some(slot),
                    state,
                    at,
                    other_is_shown: slot > 0,
                    weights: &weights[slot..=slot],
                    ..Report::default()
                };
                let states = [0, 1].map(|_| match random.u8(..6) {
                    0 => random.choice(TrackingState::ALL).unwrap(),
                    _ => TrackingState::Tracking,
                });
                let mut both = [user(0, states[0]), user(1, states[1])];
                frame(&mut gestures, &mut both[..random.usize(1..3)]);
            }
            let nobody = Report {
                at: Timestamp::from_us(at.as_us() + 500_000),
                ..Report::default()
            };
            match random.u8(..4) {
                // They leave, or the sensor is unplugged: nobody, again and again.
                0 => (0..2).for_each(|_| frame(&mut gestures, &mut [nobody])),
                // The run ends, or reads its configuration again.
                1 => {
                    gestures.release();
                    gestures.for_each_switch(|switch| keys.switch(switch));
                    keys.send(&nobody).unwrap();
                }
                // It ends by an error.
                2 => drop(keys),
                // Another recording begins.
                _ => (0..2).for_each(|_| frame(&mut gestures, &mut [Report::default()])),
            }
            let presses = presses(&std::fs::read(&path).unwrap());
            pressed += presses.len() / 2;
            assert!(
                presses.chunks(2).all(|press| press == [true, false]),
                "round {round}: {presses:?}"
            );
        }
        assert!(pressed > 1000, "{pressed}");
    }

    #[test]
    fn a_device_that_comes_later_is_named_until_then_and_used_from_then_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("uinput");
        let gesture = Gesture {
            key: "a".into(),
            press: Press::Hold,
            ..Gesture::named("smile")
        };
        let mut keys = Keys::new(path.to_str().unwrap());
        let error = keys.open().unwrap_err().to_string();
        assert!(
            error.starts_with(&format!("cannot press keys through {path:?}: ")),
            "{error}"
        );
        keys.switch(&switch(0, &gesture, true));
        keys.send(&Report::default()).unwrap();
        assert!(!keys.tally().connected && keys.tally().dropped == 0);
        std::fs::write(&path, []).unwrap();
        keys.retry_at = Instant::now();
        keys.send(&Report::default()).unwrap();
        assert!(keys.tally().connected);
        drop(keys);
        // What is held at that time goes down, and up at the end.
        assert_eq!(presses(&std::fs::read(&path).unwrap()), [true, false]);
    }
}
