//! Sockets of both families, with a time limit for each whole read and write.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{IpAddr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::{Duration, Instant};

use ports::is_own_user;
use rustix::net::sockopt::{set_socket_linger, set_socket_send_buffer_size, set_tcp_user_timeout};
use serde::{Deserialize, Deserializer};
use thiserror::Error;

use crate::frame::FRAME_BYTES_MAX;

/// Where a sender listens.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// An address and a port, for TCP.
    Tcp(SocketAddr),
    /// The path of a Unix socket.
    Unix(PathBuf),
}

/// The text is not an address.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("`{0}`: expected an address and a port as in 192.168.10.2:4780, or the path of a Unix socket")]
pub struct UnknownAddress(String);

impl FromStr for Address {
    type Err = UnknownAddress;

    fn from_str(text: &str) -> Result<Self, UnknownAddress> {
        if text.contains('/') {
            return Ok(Self::Unix(text.into()));
        }
        text.parse().map(Self::Tcp).map_err(|_| UnknownAddress(text.to_owned()))
    }
}

impl std::fmt::Display for Address {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Tcp(address) => address.fmt(f),
            Self::Unix(path) => path.display().fmt(f),
        }
    }
}

impl<'de> Deserialize<'de> for Address {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

/// A connection.
#[derive(Debug)]
pub enum Socket {
    /// Over TCP.
    Tcp(TcpStream),
    /// On this machine.
    Unix(UnixStream),
}

impl Socket {
    /// Connects within a time limit.
    ///
    /// # Errors
    /// The system's error; [`ErrorKind::PermissionDenied`] if another user listens on a Unix socket.
    pub fn connect(address: &Address, limit: Duration) -> io::Result<Self> {
        match address {
            Address::Tcp(address) => TcpStream::connect_timeout(address, limit).map(Self::Tcp),
            Address::Unix(path) => Self::own(UnixStream::connect(path)?),
        }
    }

    fn own(socket: UnixStream) -> io::Result<Self> {
        if is_own_user(&socket) { Ok(Self::Unix(socket)) } else { Err(ErrorKind::PermissionDenied.into()) }
    }

    /// Makes the connection quick to send and quick to fail. The buffer holds the frames that are on their
    /// way, and no others.
    ///
    /// # Errors
    /// The system's error.
    pub fn tune(&self, timeout: Duration) -> io::Result<()> {
        set_socket_send_buffer_size(self, FRAME_BYTES_MAX)?;
        if let Self::Tcp(socket) = self {
            socket.set_nodelay(true)?;
            let timeout_ms = u32::try_from(timeout.as_millis()).unwrap_or(u32::MAX);
            set_tcp_user_timeout(socket, timeout_ms)?;
        }
        Ok(())
    }

    /// A second handle of the connection.
    ///
    /// # Errors
    /// The system's error.
    pub fn try_clone(&self) -> io::Result<Self> {
        match self {
            Self::Tcp(socket) => socket.try_clone().map(Self::Tcp),
            Self::Unix(socket) => socket.try_clone().map(Self::Unix),
        }
    }

    /// The address of the other end, without its port; `None` for a Unix socket.
    #[must_use]
    pub fn source(&self) -> Option<IpAddr> {
        match self {
            Self::Tcp(socket) => socket.peer_addr().ok().map(|address| address.ip()),
            Self::Unix(_) => None,
        }
    }

    fn set_read_timeout(&self, limit: Option<Duration>) -> io::Result<()> {
        match self {
            Self::Tcp(socket) => socket.set_read_timeout(limit),
            Self::Unix(socket) => socket.set_read_timeout(limit),
        }
    }

    fn set_write_timeout(&self, limit: Option<Duration>) -> io::Result<()> {
        match self {
            Self::Tcp(socket) => socket.set_write_timeout(limit),
            Self::Unix(socket) => socket.set_write_timeout(limit),
        }
    }

    /// Fills `bytes`. Without a time limit it waits until the connection ends.
    ///
    /// # Errors
    /// The system's error; [`ErrorKind::TimedOut`] after `until`, [`ErrorKind::UnexpectedEof`] at the end.
    pub fn read_until(&mut self, mut bytes: &mut [u8], until: Option<Instant>) -> io::Result<()> {
        while !bytes.is_empty() {
            self.set_read_timeout(until.map(left).transpose()?)?;
            let read = match self {
                Self::Tcp(socket) => socket.read(bytes),
                Self::Unix(socket) => socket.read(bytes),
            };
            match read {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                Ok(len) => bytes = &mut bytes[len..],
                Err(error) => again(error)?,
            }
        }
        Ok(())
    }

    /// Writes all of `bytes`.
    ///
    /// # Errors
    /// The system's error; [`ErrorKind::TimedOut`] after `until`.
    pub fn write_until(&mut self, mut bytes: &[u8], until: Instant) -> io::Result<()> {
        while !bytes.is_empty() {
            self.set_write_timeout(Some(left(until)?))?;
            let written = match self {
                Self::Tcp(socket) => socket.write(bytes),
                Self::Unix(socket) => socket.write(bytes),
            };
            match written {
                Ok(len) => bytes = &bytes[len..],
                Err(error) => again(error)?,
            }
        }
        Ok(())
    }

    /// Ends the connection and discards unsent bytes.
    pub fn abort(&self) {
        if let Self::Tcp(socket) = self {
            let _ = set_socket_linger(socket, Some(Duration::ZERO));
        }
        let _ = match self {
            Self::Tcp(socket) => socket.shutdown(Shutdown::Both),
            Self::Unix(socket) => socket.shutdown(Shutdown::Both),
        };
    }
}

impl AsFd for Socket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Tcp(socket) => socket.as_fd(),
            Self::Unix(socket) => socket.as_fd(),
        }
    }
}

/// The time until `until`; an error after it.
fn left(until: Instant) -> io::Result<Duration> {
    let left = until.saturating_duration_since(Instant::now());
    if left.is_zero() { Err(ErrorKind::TimedOut.into()) } else { Ok(left) }
}

/// Whether a system call is to be repeated: [`left`] checks the time.
fn again(error: io::Error) -> io::Result<()> {
    match error.kind() {
        ErrorKind::Interrupted | ErrorKind::WouldBlock => Ok(()),
        _ => Err(error),
    }
}

/// A socket that accepts connections.
#[derive(Debug)]
pub enum Listener {
    /// Over TCP.
    Tcp(TcpListener),
    /// On this machine, with the file that is removed at the end.
    Unix(UnixListener, PathBuf),
}

impl Listener {
    /// Listens.
    ///
    /// # Errors
    /// The system's error.
    pub fn open(address: &Address) -> io::Result<Self> {
        match address {
            Address::Tcp(address) => TcpListener::bind(address).map(Self::Tcp),
            Address::Unix(path) => {
                // A killed process leaves a socket on which nobody listens.
                if UnixStream::connect(path).is_err_and(|error| error.kind() == ErrorKind::ConnectionRefused)
                {
                    std::fs::remove_file(path)?;
                }
                Ok(Self::Unix(UnixListener::bind(path)?, path.clone()))
            }
        }
    }

    /// The address with the port that the system has chosen.
    ///
    /// # Errors
    /// The system's error.
    pub fn address(&self) -> io::Result<Address> {
        match self {
            Self::Tcp(listener) => listener.local_addr().map(Address::Tcp),
            Self::Unix(_, path) => Ok(Address::Unix(path.clone())),
        }
    }

    /// The next connection.
    ///
    /// # Errors
    /// The system's error; [`ErrorKind::PermissionDenied`] if another user connects to a Unix socket.
    pub fn accept(&self) -> io::Result<Socket> {
        match self {
            Self::Tcp(listener) => Ok(Socket::Tcp(listener.accept()?.0)),
            Self::Unix(listener, _) => Socket::own(listener.accept()?.0),
        }
    }

    /// Ends [`Listener::accept`] in another thread with an error.
    pub fn close(&self) {
        let _ = match self {
            Self::Tcp(listener) => rustix::net::shutdown(listener, rustix::net::Shutdown::Both),
            Self::Unix(listener, path) => {
                let _ = std::fs::remove_file(Path::new(path));
                rustix::net::shutdown(listener, rustix::net::Shutdown::Both)
            }
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_a_port_or_a_path() {
        assert_eq!("127.0.0.1:80".parse(), Ok(Address::Tcp(([127, 0, 0, 1], 80).into())));
        assert_eq!("[::1]:80".parse::<Address>().unwrap().to_string(), "[::1]:80");
        assert_eq!("./a".parse(), Ok(Address::Unix("./a".into())));
        for text in ["", "80", "localhost", "127.0.0.1", "a:80"] {
            assert_eq!(text.parse::<Address>(), Err(UnknownAddress(text.to_owned())));
        }
    }

    #[test]
    fn reads_end_at_their_limit_whatever_drips() {
        let (mine, mut other) = UnixStream::pair().unwrap();
        let mut mine = Socket::Unix(mine);
        other.write_all(&[1, 2, 3]).unwrap();
        let mut bytes = [0; 4];
        let until = Instant::now() + Duration::from_millis(20);
        let late = mine.read_until(&mut bytes, Some(until)).unwrap_err();
        assert_eq!((late.kind(), bytes), (ErrorKind::TimedOut, [1, 2, 3, 0]));
        drop(other);
        assert_eq!(mine.read_until(&mut bytes, None).unwrap_err().kind(), ErrorKind::UnexpectedEof);
    }

    #[test]
    fn a_socket_file_of_a_dead_process_is_replaced_and_removed() {
        let folder = tempfile::tempdir().unwrap();
        let address = Address::Unix(folder.path().join("socket"));
        let Ok(Listener::Unix(dead, path)) = Listener::open(&address) else { panic!("no socket") };
        assert!(Listener::open(&address).is_err(), "somebody listens");
        drop(dead);
        let listener = Listener::open(&address).unwrap();
        listener.close();
        assert!(listener.accept().is_err() && !path.exists());
    }
}
