//! Receives OSC datagrams over UDP; [`Receiver`] parses them.

use std::net::UdpSocket;

use super::hub::Hub;
use mien_outputs::osc::Receiver;

/// Largest datagram, bytes.
const MAX_DATAGRAM: usize = 65_536;

/// Receives until the process ends.
pub fn listen(socket: &UdpSocket, hub: &Hub) {
    let mut receiver = Receiver::default();
    let mut bytes = vec![0; MAX_DATAGRAM];
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
                std::thread::sleep(std::time::Duration::from_millis(100));
            }
        }
    }
}
