//! Where the faces that serve over sockets listen, and the token that clients of other machines need.

use std::fmt::Write as _;
use std::io::{ErrorKind, Read as _};
use std::net::{TcpListener, ToSocketAddrs as _};

use super::WatchError;

/// An address to listen on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct WebAddress {
    host: String,
    port: u16,
    /// Whether any other free port will do as well.
    any_port: bool,
}

impl std::fmt::Display for WebAddress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}", self.host, self.port)
    }
}

impl WebAddress {
    /// Reads `HOST:PORT`, `PORT`, or nothing: then it is `usual_port` of this machine, or another that is free.
    pub fn parse(text: &str, usual_port: u16) -> Result<Self, WatchError> {
        let wrong = |cause: &str| WatchError::Address { address: text.to_owned(), cause: cause.to_owned() };
        if text.is_empty() {
            return Ok(Self { host: "127.0.0.1".to_owned(), port: usual_port, any_port: true });
        }
        let (host, port) = text.rsplit_once(':').unwrap_or(("127.0.0.1", text));
        let port = port.parse().map_err(|_| wrong("it does not end with a port, a number up to 65535"))?;
        if host.is_empty() || (host.contains(':') && !host.starts_with('[')) {
            return Err(wrong("it is not HOST:PORT; an address of version 6 stands in brackets"));
        }
        Ok(Self { host: host.to_owned(), port, any_port: false })
    }

    /// Listens.
    pub fn listen(&self) -> Result<TcpListener, WatchError> {
        let failed = |error: std::io::Error| {
            let cause = match error.kind() {
                ErrorKind::AddrInUse => "another program uses the port".to_owned(),
                ErrorKind::AddrNotAvailable => "this machine does not have that address".to_owned(),
                ErrorKind::PermissionDenied => "ports below 1024 are for the administrator".to_owned(),
                _ => error.to_string(),
            };
            WatchError::Address { address: self.to_string(), cause }
        };
        let addresses = self.to_string().to_socket_addrs().map_err(failed)?.collect::<Vec<_>>();
        match TcpListener::bind(&addresses[..]) {
            Err(error) if self.any_port && error.kind() == ErrorKind::AddrInUse => {
                TcpListener::bind((self.host.as_str(), 0)).map_err(failed)
            }
            bound => bound.map_err(failed),
        }
    }
}

/// A token that cannot be guessed: 32 hexadecimal digits.
///
/// # Errors
/// When the operating system has no random bytes.
pub(super) fn token() -> std::io::Result<String> {
    let mut bytes = [0; 16];
    std::fs::File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes.iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_and_wrong_ones_refused() {
        let shown =
            ["", "8080", "0.0.0.0:1", "[::1]:80", "localhost:0"].map(|text| WebAddress::parse(text, 8417).unwrap());
        let shown = shown.map(|address| address.to_string());
        assert_eq!(shown, ["127.0.0.1:8417", "127.0.0.1:8080", "0.0.0.0:1", "[::1]:80", "localhost:0"]);
        for text in ["x", "1.2.3.4", "localhost:", ":80", "::1:80", "h:70000"] {
            let error = WebAddress::parse(text, 8417).unwrap_err().to_string();
            assert!(error.contains(text) && error.lines().count() == 1, "{error}");
        }
        let taken = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = taken.local_addr().unwrap().port();
        let error = WebAddress::parse(&port.to_string(), 8417).unwrap().listen().unwrap_err().to_string();
        assert!(error.contains("another program uses the port"), "{error}");
        assert!(token().unwrap() != token().unwrap());
    }
}
