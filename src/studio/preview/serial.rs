//! Receives a serial line in any style; [`Receiver`] parses it. An absent port is retried every second.

use std::io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
use std::io::Read;
use std::net::TcpStream;
use std::time::Duration;

use super::hub::Hub;
use mien_outputs::serial::Receiver;

const RETRY: Duration = Duration::from_secs(1);
/// Timeout of a read.
const READ_TIMEOUT: Duration = Duration::from_millis(500);

/// A serial line.
pub struct Port {
    /// A device, or `tcp:host:port`.
    pub name: String,
    /// Bits per second.
    pub baud: u32,
    /// Value of a weight of 1.
    pub full: f32,
}

fn open(port: &Port) -> std::io::Result<Box<dyn Read>> {
    if let Some(address) = port.name.strip_prefix("tcp:") {
        let stream = TcpStream::connect(address)?;
        stream.set_read_timeout(Some(READ_TIMEOUT))?;
        return Ok(Box::new(stream));
    }
    let line = serialport::new(&port.name, port.baud);
    Ok(Box::new(line.timeout(READ_TIMEOUT).open()?))
}

/// Receives until the process ends.
pub fn listen(port: &Port, hub: &Hub) {
    let mut receiver = Receiver::new(port.full);
    let mut bytes = [0; 1024];
    loop {
        match open(port) {
            Ok(mut reader) => {
                hub.note("");
                loop {
                    match reader.read(&mut bytes) {
                        // End of file: the port was unplugged.
                        Ok(0) => break,
                        Ok(length) => receiver.take(&bytes[..length], hub),
                        Err(error) => match error.kind() {
                            TimedOut | WouldBlock | Interrupted => {}
                            _ => break,
                        },
                    }
                }
                hub.note(&format!("{} was disconnected; waiting for it", port.name));
            }
            Err(error) => hub.note(&format!("waiting for {}: {error}", port.name)),
        }
        std::thread::sleep(RETRY);
    }
}
