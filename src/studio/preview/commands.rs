//! The page's commands: executed here if this process does the tracking, otherwise sent to
//! the box that streams, in the format of [`mien_outputs::osc::commands`].

use std::net::{SocketAddr, UdpSocket};
use std::sync::mpsc::SyncSender;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use mien_outputs::Command;
use mien_outputs::osc::packet::{Argument, Packet};

/// Default port for commands of a box.
pub const PORT: u16 = 9131;
/// How long the system's refusal of a datagram is awaited.
const REFUSAL: Duration = Duration::from_millis(150);

/// Recipient of commands.
pub enum CommandTarget {
    /// The pipeline of this process.
    Here(Mutex<SyncSender<Command>>),
    /// A box: at a given address, else the streaming host at [`PORT`].
    Box(Option<SocketAddr>),
    /// Nobody: the source is recorded, or a one-way line.
    Nobody,
}

impl CommandTarget {
    /// Executes a command; the text says what was done, or why not. `sender` is the streaming host.
    ///
    /// # Errors
    /// If there is no recipient.
    pub fn execute(
        &self,
        command: Command,
        sender: Option<std::net::IpAddr>,
    ) -> Result<String, String> {
        match self {
            Self::Nobody => Err(
                "this source is a recording or a one-way line and cannot receive commands".into(),
            ),
            Self::Here(pipeline) => {
                let pipeline = pipeline.lock().unwrap_or_else(PoisonError::into_inner);
                let busy = |_| "the tracker has stopped or is busy; try again".to_owned();
                pipeline.try_send(command).map_err(busy)?;
                Ok(done(command).to_owned())
            }
            Self::Box(named) => {
                let found = named.or_else(|| Some(SocketAddr::new(sender?, PORT)));
                let address = found.ok_or("the address of the box is unknown, because nothing has arrived from it yet; give it with --box ADDRESS:PORT")?;
                send(command, address)?;
                Ok(format!("command sent to {address}: {}", done(command)))
            }
        }
    }
}

fn done(command: Command) -> &'static str {
    match command {
        Command::Forget(_) => "learned ranges are forgotten",
        Command::Neutral(_) => "the current face is now neutral",
        Command::Freeze(_, true) => "learning is frozen",
        Command::Freeze(_, false) => "learning is resumed",
        Command::Level(..) => "the gesture's level is changed",
        Command::Hold(..) => "the gesture's hold time is changed",
        Command::Teach(_, true) => "the gesture is being set up",
        Command::Teach(_, false) => "the set-up is stopped",
        Command::Undo(_) => "the gesture's last change is undone",
    }
}

fn send(command: Command, to: SocketAddr) -> Result<(), String> {
    let (name, index, number) = command.parts();
    let numbers = [Some(index as i32), number.map(Into::into)];
    let numbers = numbers.into_iter().flatten().map(Argument::Int);
    let mut packet = Packet::default();
    packet.push("/face/cmd/", format_args!("{name}"), numbers);
    // The message alone, without the bundle's header and its length field.
    let datagram = &packet.bytes()[20..];
    let cannot = |error: std::io::Error| format!("cannot send the command to {to}: {error}");
    let here = if to.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
    let socket = UdpSocket::bind(here).map_err(cannot)?;
    socket.connect(to).map_err(cannot)?;
    socket.set_read_timeout(Some(REFUSAL)).map_err(cannot)?;
    socket.send(datagram).map_err(cannot)?;
    // Commands are not answered; a closed port is reported by the system.
    match socket.recv(&mut [0]) {
        Err(error) if error.kind() == std::io::ErrorKind::ConnectionRefused => Err(format!(
            "nothing accepts commands at {to}: is mien running there? On another machine it needs listen = \"0.0.0.0:{}\" under [osc]",
            to.port()
        )),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mien_outputs::osc::commands::{Request, requests};

    #[test]
    fn a_box_understands_what_it_is_asked() {
        let listener = UdpSocket::bind("127.0.0.1:0").unwrap();
        listener
            .set_read_timeout(Some(Duration::from_secs(30)))
            .unwrap();
        let boxed = CommandTarget::Box(listener.local_addr().ok());
        for (words, wanted) in [
            (vec!["forget", "2"], Command::Forget(2)),
            (vec!["neutral", "0"], Command::Neutral(0)),
            (vec!["freeze", "1", "1"], Command::Freeze(1, true)),
            (vec!["freeze", "1", "0"], Command::Freeze(1, false)),
            (vec!["level", "2", "85"], Command::Level(2, 85)),
            (vec!["hold", "2", "40"], Command::Hold(2, 40)),
            (vec!["teach", "15", "1"], Command::Teach(15, true)),
            (vec!["undo", "0"], Command::Undo(0)),
        ] {
            let command = Command::from_words(words[0], words[1..].iter().copied()).unwrap();
            assert!(boxed.execute(command, None).is_ok());
            let mut bytes = [0; 1024];
            let length = listener.recv(&mut bytes).unwrap();
            let mut found = None;
            let refused = requests(&bytes[..length], "/face", &mut |request| {
                found = Some(request);
                true
            });
            assert_eq!((found, refused), (Some(Request::Command(wanted)), 0));
        }
    }

    #[test]
    fn an_absent_box_is_reported() {
        let gone = UdpSocket::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap();
        let said = CommandTarget::Box(Some(gone))
            .execute(Command::Forget(0), None)
            .unwrap_err();
        assert!(said.contains("is mien running there?"), "{said}");
        assert!(
            CommandTarget::Box(None)
                .execute(Command::Forget(0), None)
                .unwrap_err()
                .contains("--box")
        );
        assert!(
            CommandTarget::Nobody
                .execute(Command::Forget(0), None)
                .is_err()
        );
    }
}
