//! USB devices that exist only on a socket: the device side of the usbredir protocol, for QEMU's `usb-redir`.

#![allow(dead_code, reason = "each device uses some of it")]

mod session;
pub(crate) mod wire;

use std::error::Error;
use std::os::unix::net::UnixListener;
use std::time::Duration;

pub(crate) use session::serve;
use wire::Wire;

pub(crate) type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Setup packet of a control transfer.
pub(crate) struct Setup {
    /// `bmRequestType`
    pub(crate) kind: u8,
    pub(crate) request: u8,
    pub(crate) value: u16,
    pub(crate) index: u16,
}

/// State of a device after a millisecond.
pub(crate) enum Next {
    Continues,
    /// It is pulled out for this time.
    Unplugged(Duration),
    /// It has nothing more to send.
    Ended,
}

/// A USB device: its descriptors, and what it does when it is asked.
pub(crate) trait UsbDevice {
    /// Vendor, product, release.
    fn ids(&self) -> [u16; 3];
    /// Class, subclass and protocol.
    fn class(&self) -> [u8; 3];
    fn configuration(&self) -> Vec<u8>;
    /// Strings 1 to 3 are the manufacturer, the product and the serial number.
    fn string(&self, index: u8) -> Option<&str>;
    /// Answer to a request of its class or vendor; `None` stalls.
    fn request(&mut self, setup: &Setup, data: &[u8]) -> Option<Vec<u8>>;
    /// Sends what is due in the next millisecond.
    fn millisecond(&mut self, wire: &mut Wire) -> Next;

    /// Whether it ever shows on the bus.
    fn is_present(&self) -> bool {
        true
    }
    fn reset(&mut self) {}
    /// An isochronous endpoint is switched on or off.
    fn isochronous(&mut self, _endpoint: u8, _on: bool) {}
    /// The host requests at most `_length` bytes from a bulk endpoint. Returns whether the device will answer this transfer.
    fn bulk(&mut self, _endpoint: u8, _id: u64, _length: usize) -> bool {
        false
    }
    /// A bulk transfer is withdrawn; returns its endpoint if it was not answered yet.
    fn cancel(&mut self, _id: u64) -> Option<u8> {
        None
    }
    /// Drivers clear a halt of a bulk endpoint to end its stream.
    fn clear_halt(&mut self, _endpoint: u8) {}
}

/// The options of a command line, `--NAME VALUE` or `--NAME`.
pub(crate) struct Options(Vec<String>);

impl Options {
    pub(crate) fn of_process() -> Self {
        Self(std::env::args().skip(1).collect())
    }

    pub(crate) fn has(&self, name: &str) -> bool {
        self.0.iter().any(|argument| argument == name)
    }

    pub(crate) fn text(&self, name: &str) -> Option<String> {
        let at = self.0.iter().position(|argument| argument == name)?;
        self.0.get(at + 1).cloned()
    }

    pub(crate) fn number(&self, name: &str, default: f64) -> Result<f64> {
        Ok(self.text(name).map_or(Ok(default), |text| text.parse())?)
    }

    /// The frame at which the device is unplugged, and for how long: `--unplug-at FRAME --unplugged-for SECONDS`.
    pub(crate) fn unplug(&self) -> Result<Option<(u64, Duration)>> {
        let during = Duration::from_secs_f64(self.number("--unplugged-for", 2.0)?);
        let at = self.number("--unplug-at", f64::MAX)? as u64;
        Ok((at < u64::MAX).then_some((at, during)))
    }

    /// Binds the socket that this option names.
    pub(crate) fn listener(&self, name: &str) -> Result<Option<UnixListener>> {
        Ok(self.text(name).map(UnixListener::bind).transpose()?)
    }
}
