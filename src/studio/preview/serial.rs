//! Receives a serial line in any of the three styles ([`crate::output::serial`]) at a port. An absent port is retried
//! every second.

use std::io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
use std::io::Read;
use std::net::TcpStream;
use std::time::Duration;

use super::hub::Hub;
use crate::output::serial::Receiver;

const RETRY: Duration = Duration::from_secs(1);
/// How long a read waits before the port is asked again.
const PATIENCE: Duration = Duration::from_millis(500);

/// Which port.
#[derive(Clone, Debug)]
pub struct Port {
    /// A device, or `tcp:host:port`.
    pub name: String,
    /// Bits per second.
    pub baud: u32,
    /// What a weight of 1 is on the line.
    pub full: f32,
}

fn open(port: &Port) -> std::io::Result<Box<dyn Read>> {
    if let Some(address) = port.name.strip_prefix("tcp:") {
        let stream = TcpStream::connect(address)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        return Ok(Box::new(stream));
    }
    let line = serialport::new(&port.name, port.baud);
    Ok(Box::new(line.timeout(PATIENCE).open()?))
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
                        // A port that ends is one that was unplugged.
                        Ok(0) => break,
                        Ok(length) => receiver.take(&bytes[..length], hub),
                        Err(error)
                            if matches!(error.kind(), TimedOut | WouldBlock | Interrupted) => {}
                        Err(_) => break,
                    }
                }
                hub.note(&format!("{} was disconnected; waiting for it", port.name));
            }
            Err(error) => hub.note(&format!("waiting for {}: {error}", port.name)),
        }
        std::thread::sleep(RETRY);
    }
}
