//! What others send, handed to the hub: OSC datagrams, a serial line in any style, and the CSV of a run.
//!
//! The parsers stand beside the encoders in [`mien_outputs`]. An absent serial port is retried every second. Every row of a
//! table is sent as it is read and kept by the hub, so that the page can scrub back; damaged rows are counted and skipped. From
//! standard input (`-`) rows are shown as they arrive.

use std::io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
use std::io::{BufRead, Read};
use std::net::{TcpStream, UdpSocket};
use std::path::Path;
use std::time::Duration;

use super::hub::Hub;
use mien_outputs::csv::columns::Columns;
use mien_outputs::received::Receive as _;
use mien_outputs::{osc, serial};
use mien_workbench::fault::Fault;
use mien_workbench::text_files::decoded;

/// Largest datagram, bytes.
const DATAGRAM_BYTES: usize = 65_536;

/// Receives OSC until the process ends.
pub(super) fn receive_datagrams(socket: &UdpSocket, hub: &Hub) {
    let mut receiver = osc::receiver::Receiver::default();
    let mut bytes = vec![0; DATAGRAM_BYTES];
    loop {
        match socket.recv_from(&mut bytes) {
            Ok((length, from)) => {
                let before = hub.counts().received;
                receiver.take(&bytes[..length], hub);
                if hub.counts().received > before {
                    hub.set_sender(from.ip());
                }
            }
            // Such as an ICMP refusal from elsewhere; never loops at full speed.
            Err(error) => {
                hub.note(&format!("socket error: {error}"));
                std::thread::sleep(Duration::from_millis(100));
            }
        }
    }
}

const RETRY: Duration = Duration::from_secs(1);
/// Timeout of a read.
const READ_TIMEOUT: Duration = Duration::from_millis(500);

/// A serial line.
pub(super) struct Port {
    /// A device, or `tcp:host:port`.
    pub(super) name: String,
    /// Bits per second.
    pub(super) baud: u32,
    /// Value of a weight of 1.
    pub(super) full: f32,
}

fn open_line(port: &Port) -> std::io::Result<Box<dyn Read>> {
    if let Some(address) = port.name.strip_prefix("tcp:") {
        let stream = TcpStream::connect(address)?;
        stream.set_read_timeout(Some(READ_TIMEOUT))?;
        return Ok(Box::new(stream));
    }
    let line = serialport::new(&port.name, port.baud);
    Ok(Box::new(line.timeout(READ_TIMEOUT).open()?))
}

/// Receives a serial line until the process ends.
pub(super) fn receive_line(port: &Port, hub: &Hub) {
    let mut receiver = serial::receiver::Receiver::new(port.full);
    let mut bytes = [0; 1024];
    loop {
        match open_line(port) {
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

/// Longest line, bytes: a row has some 3 kB.
const MAX_LINE: u64 = 1 << 16;

/// Opens the table and reads its header.
///
/// # Errors
/// If it cannot be read or is another kind of table.
pub(super) fn open_table(path: &Path) -> Result<(Columns, Box<dyn BufRead + Send>), Fault> {
    let unreadable = Fault::cannot("read", path, "");
    let file: Box<dyn Read + Send> = match path.as_os_str() == "-" {
        true => Box::new(std::io::stdin()),
        false => Box::new(std::fs::File::open(path).map_err(&unreadable)?),
    };
    let mut reader = std::io::BufReader::new(file);
    let mut header = Vec::new();
    let mut first = reader.by_ref().take(MAX_LINE);
    first.read_until(b'\n', &mut header).map_err(unreadable)?;
    let header = decoded(&header);
    let table = Columns::new(&header).ok_or_else(|| {
        let found: String = header.trim_end().chars().take(60).collect();
        Fault::within(path)(format!(
            "line 1: expected a header with time_us, user and w_<unit> columns, found {found:?}; mien run --csv writes one"
        ))
    })?;
    Ok((table, Box::new(reader)))
}

/// Sends all rows to the hub.
pub(super) fn play_table(mut table: Columns, mut reader: Box<dyn BufRead + Send>, hub: &Hub) {
    let mut line = Vec::new();
    loop {
        line.clear();
        match reader.by_ref().take(MAX_LINE).read_until(b'\n', &mut line) {
            Ok(0) => break,
            Ok(_) if line.trim_ascii().is_empty() => {}
            Ok(_) => match table.row(&String::from_utf8_lossy(&line)) {
                Some(sample) => {
                    hub.sample(&sample);
                    hub.count(1, 0);
                }
                None => hub.count(0, 1),
            },
            Err(error) => {
                hub.note(&format!("the CSV ends early: {error}"));
                break;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_kind_of_table_is_refused_with_its_first_line() {
        let path = std::env::temp_dir().join(format!("mien-table-{}.csv", std::process::id()));
        std::fs::write(&path, "a,b\n1,2\n").unwrap();
        let wrong = open_table(&path).err().unwrap().to_string();
        std::fs::remove_file(&path).unwrap();
        assert!(wrong.contains("time_us") && wrong.contains("\"a,b\""));
    }
}
