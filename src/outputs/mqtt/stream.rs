//! The connection to the broker: TCP, or TLS over it (RFC 8446, RFC 5246; by `rustls`).
//!
//! Does not block, except when connecting and in [`Stream::finish`]. TLS allocates for every record, on the broker's thread only.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::time::Duration;

use rustls::crypto::ring;
use rustls::pki_types::{CertificateDer, ServerName, pem::PemObject};
use rustls::{ClientConfig, ClientConnection, RootCertStore};

use crate::OutputError;
use crate::features::MqttSettings;

/// Connection timeout.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);
/// Largest certificate file, bytes; a system's bundle has 0.2 MB.
const CERTIFICATES_MAX: usize = 4 << 20;
/// Time limit for the last messages.
const FINISH_TIMEOUT: Duration = Duration::from_millis(300);

/// TLS settings that check the broker's certificate; `None` without TLS.
pub(super) type Trust = Option<Arc<ClientConfig>>;

/// TLS settings that trust the CAs of the configured file; `None` without TLS.
///
/// # Errors
/// If the certificates cannot be read.
pub(super) fn trust(settings: &MqttSettings) -> Result<Trust, OutputError> {
    if !settings.tls {
        return Ok(None);
    }
    let path = &settings.ca_file;
    let roots =
        read_authorities(path).map_err(|source| OutputError::Certificates(path.clone(), source))?;
    // The provider is named here, because no other part of the program installs one.
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .expect("ring knows TLS 1.2 and 1.3")
        .with_root_certificates(roots)
        .with_no_client_auth();
    Ok(Some(Arc::new(config)))
}

/// The certificates of a PEM file.
///
/// # Errors
/// If the file cannot be read or has no usable certificate.
fn read_authorities(path: &str) -> io::Result<RootCertStore> {
    let text = mien_stages::base::bounded_read::read(std::path::Path::new(path), CERTIFICATES_MAX)?;
    let mut roots = RootCertStore::empty();
    for certificate in CertificateDer::pem_slice_iter(&text) {
        let certificate = certificate.map_err(io::Error::other)?;
        // A system's bundle has some that rustls rejects as outdated; one accepted is enough.
        let _ = roots.add(certificate);
    }
    if roots.is_empty() {
        return Err(io::Error::other("expected certificates in PEM, found none"));
    }
    Ok(roots)
}

/// A connection, plain or TLS.
pub(super) struct Stream {
    pub(super) socket: TcpStream,
    tls: Option<Box<ClientConnection>>,
}

impl Stream {
    /// Connects to `host:port`. With TLS the certificate is checked during the handshake, with the first data.
    ///
    /// # Errors
    /// If the host is unknown or unreachable.
    pub(super) fn connect(broker: &str, trust: &Trust) -> io::Result<Self> {
        let socket = connect_tcp(broker)?;
        let Some(config) = trust else {
            return Ok(Self { socket, tls: None });
        };
        let host = broker.rsplit_once(':').map_or(broker, |(host, _)| host);
        let host = ServerName::try_from(host.trim_matches(['[', ']']).to_owned());
        let host = host.map_err(io::Error::other)?;
        let tls = ClientConnection::new(config.clone(), host).map_err(io::Error::other)?;
        Ok(Self {
            socket,
            tls: Some(Box::new(tls)),
        })
    }

    /// Whether to poll the socket for writing; `pending`: whether the caller has unsent data.
    pub(super) fn waits_to_write(&self, pending: bool) -> bool {
        // During the handshake, writing waits for data from the broker.
        self.tls.as_ref().map_or(pending, |tls| {
            tls.wants_write() || pending && !tls.is_handshaking()
        })
    }

    /// Sends the last messages within [`FINISH_TIMEOUT`] and closes.
    pub(super) fn finish(&mut self, bytes: &[u8]) {
        let _ = self.socket.set_nonblocking(false);
        let _ = self.socket.set_write_timeout(Some(FINISH_TIMEOUT));
        let _ = self.write_all(bytes);
        if let Some(tls) = &mut self.tls {
            tls.send_close_notify();
            let _ = tls.write_tls(&mut self.socket);
        }
        let _ = self.socket.shutdown(Shutdown::Write);
    }
}

impl Read for Stream {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        match &mut self.tls {
            None => self.socket.read(into),
            Some(tls) => rustls::Stream::new(&mut **tls, &mut self.socket).read(into),
        }
    }
}

impl Write for Stream {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let taken = match &mut self.tls {
            None => self.socket.write(bytes),
            Some(tls) => rustls::Stream::new(&mut **tls, &mut self.socket).write(bytes),
        }?;
        if taken == 0 {
            return Err(ErrorKind::WouldBlock.into());
        }
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn connect_tcp(broker: &str) -> io::Result<TcpStream> {
    let open = |address| {
        let socket = TcpStream::connect_timeout(&address, CONNECT_TIMEOUT)?;
        socket.set_nonblocking(true)?;
        let _ = socket.set_nodelay(true);
        Ok(socket)
    };
    // A look-up allocates, so it is done for names only.
    if let Ok(address) = broker.parse() {
        return open(address);
    }
    let none = Err(io::Error::other("its name has no address"));
    let addresses = broker.to_socket_addrs()?;
    addresses.fold(none, |before, address| before.or_else(|_| open(address)))
}
