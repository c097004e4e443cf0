//! The user at the other end of a Unix socket.

#![expect(
    unsafe_code,
    reason = "rustix has no answer for a peer in another PID namespace, whose number is 0"
)]

use std::os::fd::AsRawFd as _;
use std::os::unix::net::UnixStream;

use rustix::process::geteuid;

/// Whether the process at the other end of a Unix socket belongs to this user or to root. The process may be in
/// another container.
#[must_use]
pub fn is_own_user(socket: &UnixStream) -> bool {
    user(socket).is_some_and(|user| user == geteuid().as_raw() || user == 0)
}

fn user(socket: &UnixStream) -> Option<u32> {
    let mut peer = libc::ucred { pid: 0, uid: 0, gid: 0 };
    let mut size = libc::socklen_t::try_from(size_of_val(&peer)).ok()?;
    // SAFETY: the kernel writes at most `size` bytes to `peer`, which outlives the call.
    let result = unsafe {
        let (level, name) = (libc::SOL_SOCKET, libc::SO_PEERCRED);
        libc::getsockopt(socket.as_raw_fd(), level, name, (&raw mut peer).cast(), &raw mut size)
    };
    (result == 0).then_some(peer.uid)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peer_of_a_pair_is_this_user() {
        let (one, other) = UnixStream::pair().unwrap();
        assert_eq!(user(&one), Some(geteuid().as_raw()));
        assert!(is_own_user(&other));
    }
}
