//! The connection to the broker: TCP, or TLS over it (RFC 8446, RFC 5246; by `rustls`).
//!
//! Neither ever blocks, except in [`Stream::finish`]. TLS allocates for every record, on the broker's thread only.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::os::fd::{AsRawFd, RawFd};
use std::time::Duration;

use crate::output::OutputError;
use crate::output::features::MqttSettings;

/// Connection timeout.
const PATIENCE: Duration = Duration::from_secs(10);
/// Largest certificate file, bytes; a system's bundle has 0.2 MB.
#[cfg(feature = "mqtt-tls")]
const CERTIFICATES_MOST: usize = 4 << 20;
/// Time limit for the last messages.
const FAREWELL: Duration = Duration::from_millis(300);

/// The CAs that may sign the broker's certificate; nothing without TLS.
#[derive(Clone)]
pub(super) struct Trust(#[cfg(feature = "mqtt-tls")] Option<std::sync::Arc<rustls::ClientConfig>>);

impl Trust {
    /// # Errors
    /// If the certificates cannot be read, or TLS is requested but not built in.
    pub(super) fn new(settings: &MqttSettings) -> Result<Self, OutputError> {
        if !settings.tls {
            return Ok(Self(
                #[cfg(feature = "mqtt-tls")]
                None,
            ));
        }
        #[cfg(not(feature = "mqtt-tls"))]
        return Err(OutputError::NotBuilt {
            section: "mqtt",
            feature: "mqtt-tls",
        });
        #[cfg(feature = "mqtt-tls")]
        authorities(&settings.ca_file)
            .map(|roots| {
                // The algorithms are named: no other part of the program chooses them.
                let provider = std::sync::Arc::new(rustls::crypto::ring::default_provider());
                let config = rustls::ClientConfig::builder_with_provider(provider)
                    .with_safe_default_protocol_versions()
                    .expect("ring knows TLS 1.2 and 1.3")
                    .with_root_certificates(roots)
                    .with_no_client_auth();
                Self(Some(std::sync::Arc::new(config)))
            })
            .map_err(|source| OutputError::Certificates {
                path: settings.ca_file.clone(),
                source,
            })
    }
}

/// The certificates of a PEM file.
#[cfg(feature = "mqtt-tls")]
fn authorities(path: &str) -> io::Result<rustls::RootCertStore> {
    use rustls::pki_types::{CertificateDer, pem::PemObject};
    let text = crate::base::bounded_read::read(std::path::Path::new(path), CERTIFICATES_MOST)?;
    let mut roots = rustls::RootCertStore::empty();
    for certificate in CertificateDer::pem_slice_iter(&text) {
        let certificate =
            certificate.map_err(|error| io::Error::new(ErrorKind::InvalidData, error))?;
        // A system's bundle has some that are older than the rules; one is enough.
        let _ = roots.add(certificate);
    }
    if roots.is_empty() {
        let what = "expected certificates in PEM, found none";
        return Err(io::Error::new(ErrorKind::InvalidData, what));
    }
    Ok(roots)
}

pub(super) enum Stream {
    Plain(TcpStream),
    #[cfg(feature = "mqtt-tls")]
    Sealed(Box<rustls::StreamOwned<rustls::ClientConnection, TcpStream>>),
}

impl Stream {
    /// Connects to `host:port`. With TLS the certificate must be the host's; it is checked during the handshake, with the first
    /// data.
    pub(super) fn connect(broker: &str, trust: &Trust) -> io::Result<Self> {
        let socket = reach(broker)?;
        #[cfg(feature = "mqtt-tls")]
        if let Some(config) = &trust.0 {
            let host = broker.rsplit_once(':').map_or(broker, |(host, _)| host);
            let host = host.trim_matches(['[', ']']).to_owned();
            let host = rustls::pki_types::ServerName::try_from(host)
                .map_err(|error| io::Error::new(ErrorKind::InvalidInput, error))?;
            let tls = rustls::ClientConnection::new(config.clone(), host)
                .map_err(|error| io::Error::new(ErrorKind::InvalidData, error))?;
            let sealed = rustls::StreamOwned::new(tls, socket);
            return Ok(Self::Sealed(Box::new(sealed)));
        }
        let _ = trust;
        Ok(Self::Plain(socket))
    }

    fn socket(&self) -> &TcpStream {
        match self {
            Self::Plain(socket) => socket,
            #[cfg(feature = "mqtt-tls")]
            Self::Sealed(sealed) => &sealed.sock,
        }
    }

    /// Whether to wait until the socket accepts more; `pending` is whether the caller has unsent data.
    pub(super) fn waits_to_write(&self, pending: bool) -> bool {
        match self {
            Self::Plain(_) => pending,
            // While hands are shaken, writing waits for what is read.
            #[cfg(feature = "mqtt-tls")]
            Self::Sealed(sealed) => {
                sealed.conn.wants_write() || pending && !sealed.conn.is_handshaking()
            }
        }
    }

    /// Sends the last messages, for a moment, and closes.
    pub(super) fn finish(&mut self, words: &[u8]) {
        let _ = self.socket().set_nonblocking(false);
        let _ = self.socket().set_write_timeout(Some(FAREWELL));
        let _ = self.write_all(words);
        #[cfg(feature = "mqtt-tls")]
        if let Self::Sealed(sealed) = self {
            sealed.conn.send_close_notify();
            let _ = sealed.conn.write_tls(&mut sealed.sock);
        }
        let _ = self.socket().shutdown(Shutdown::Write);
    }
}

impl AsRawFd for Stream {
    fn as_raw_fd(&self) -> RawFd {
        self.socket().as_raw_fd()
    }
}

impl Read for Stream {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Plain(socket) => socket.read(into),
            #[cfg(feature = "mqtt-tls")]
            Self::Sealed(sealed) => sealed.read(into),
        }
    }
}

impl Write for Stream {
    fn write(&mut self, words: &[u8]) -> io::Result<usize> {
        let taken = match self {
            Self::Plain(socket) => socket.write(words),
            #[cfg(feature = "mqtt-tls")]
            Self::Sealed(sealed) => sealed.write(words),
        }?;
        if taken == 0 {
            return Err(ErrorKind::WouldBlock.into());
        }
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Plain(socket) => socket.flush(),
            #[cfg(feature = "mqtt-tls")]
            Self::Sealed(sealed) => sealed.flush(),
        }
    }
}

fn reach(broker: &str) -> io::Result<TcpStream> {
    let reach = |address| {
        let socket = TcpStream::connect_timeout(&address, PATIENCE)?;
        socket.set_nonblocking(true)?;
        let _ = socket.set_nodelay(true);
        Ok(socket)
    };
    // Only a name is looked up, which asks for memory.
    if let Ok(address) = broker.parse() {
        return reach(address);
    }
    let mut last = io::Error::from(ErrorKind::NotFound);
    for address in broker.to_socket_addrs()? {
        match reach(address) {
            Ok(socket) => return Ok(socket),
            Err(error) => last = error,
        }
    }
    Err(last)
}
