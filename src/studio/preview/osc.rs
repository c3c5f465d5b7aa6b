//! Receives the native OSC schema ([`crate::output::osc`]) over UDP.

use std::net::UdpSocket;

use super::hub::Hub;
use crate::output::osc::Receiver;

/// Longest datagram there is.
const LARGEST: usize = 65_536;

/// Receives until the process ends.
pub fn listen(socket: &UdpSocket, hub: &Hub) {
    let mut receiver = Receiver::default();
    let mut bytes = vec![0; LARGEST];
    loop {
        match socket.recv_from(&mut bytes) {
            Ok((length, from)) => {
                let before = hub.counts().received;
                receiver.take(&bytes[..length], hub);
                if hub.counts().received > before {
                    hub.set_sender(from.ip());
                }
            }
            // Such as an ICMP refusal that is not ours; never at full speed.
            Err(error) => {
                hub.note(&format!("socket error: {error}"));
                std::thread::sleep(std::time::Duration::from_millis(100));
            }
        }
    }
}
