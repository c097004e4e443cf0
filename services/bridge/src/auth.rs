//! Authentication by a pre-shared key: HMAC-SHA-256 (RFC 2104), cut to 16 bytes.
//!
//! 1. The sender greets with a random nonce, the receiver answers with its own and with a code under the key K
//!    over both greetings. The sender drops a receiver whose code is wrong.
//! 2. Both derive the key of this session from K and both greetings.
//! 3. Each frame and each confirmation has a code under the session's key. It covers a counter, so a frame that
//!    was repeated, left out or taken from another session is refused.
//!
//! This protects integrity and authenticity. Frames are not encrypted.

use std::io::{self, Read as _};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use hmac::{Hmac, Mac as _};
use rustix::process::geteuid;
use rustix::rand::{GetRandomFlags, getrandom};
use sha2::Sha256;
use subtle::ConstantTimeEq as _;
use thiserror::Error;

/// Bytes of a code.
pub const CODE_BYTES: usize = 16;
/// Bytes of a nonce.
pub const NONCE_BYTES: usize = 16;
/// Least and most bytes of a key.
pub const KEY_BYTES_MIN: usize = 16;
/// Most bytes of a key.
pub const KEY_BYTES_MAX: usize = 1024;

/// What a code is for: a code for one purpose is invalid for all others.
const RECEIVER: &[u8] = b"receiver";
const SESSION: &[u8] = b"session";
const FRAME: &[u8] = b"frame";
const ACK: &[u8] = b"ack";

/// Why a file can't be the key.
#[derive(Debug, Error)]
pub enum KeyError {
    /// The file can't be read.
    #[error("{0}: {1}")]
    File(PathBuf, io::Error),
    /// Others can read the file.
    #[error("{0}: the mode is {1:04o}: expected 0600, so that nobody else can read the key")]
    Mode(PathBuf, u32),
    /// The file belongs to another user.
    #[error("{0}: it belongs to user {1}: expected this user or root")]
    Owner(PathBuf, u32),
    /// The key is too short or too long.
    #[error("{0}: the key has {1} bytes: expected {KEY_BYTES_MIN} to {KEY_BYTES_MAX}")]
    Length(PathBuf, usize),
}

/// A key shared by both ends of a link. Its bytes never appear in messages.
#[derive(Clone)]
pub struct Key(Vec<u8>);

impl std::fmt::Debug for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Key")
    }
}

impl Key {
    /// No key: for a link that a tunnel or a Unix socket protects. The codes then find errors only.
    #[must_use]
    pub const fn none() -> Self {
        Self(Vec::new())
    }

    /// A key of these bytes.
    #[must_use]
    pub const fn new(bytes: Vec<u8>) -> Self {
        Self(bytes)
    }

    /// Reads the key from a file that only this user or root can read. Line ends at its end are not part of
    /// the key.
    ///
    /// # Errors
    /// [`KeyError`] names the file.
    pub fn read(path: &Path) -> Result<Self, KeyError> {
        let failed = |error| KeyError::File(path.to_owned(), error);
        let file = std::fs::File::open(path).map_err(failed)?;
        // Of the open file: the path could name another one by now.
        let found = file.metadata().map_err(failed)?;
        if found.mode() & 0o077 != 0 {
            return Err(KeyError::Mode(path.to_owned(), found.mode() & 0o7777));
        }
        if ![0, geteuid().as_raw()].contains(&found.uid()) {
            return Err(KeyError::Owner(path.to_owned(), found.uid()));
        }
        let mut bytes = Vec::new();
        // Two bytes for a line end, one more to notice a longer file.
        file.take(KEY_BYTES_MAX as u64 + 3).read_to_end(&mut bytes).map_err(failed)?;
        while bytes.last().is_some_and(|byte| [b'\n', b'\r'].contains(byte)) {
            bytes.pop();
        }
        if !(KEY_BYTES_MIN..=KEY_BYTES_MAX).contains(&bytes.len()) {
            return Err(KeyError::Length(path.to_owned(), bytes.len()));
        }
        Ok(Self(bytes))
    }

    /// The code of a receiver's greeting, which follows the sender's.
    #[must_use]
    pub fn receiver_code(&self, sender_hello: &[u8], receiver_hello: &[u8]) -> [u8; CODE_BYTES] {
        cut(&hmac(&self.0, &[RECEIVER, sender_hello, receiver_hello]))
    }

    /// The session that these greetings begin.
    #[must_use]
    pub fn session(&self, sender_hello: &[u8], receiver_hello: &[u8]) -> Session {
        Session(hmac(&self.0, &[SESSION, sender_hello, receiver_hello]))
    }
}

/// The key of one session.
#[derive(Clone)]
pub struct Session([u8; 32]);

impl std::fmt::Debug for Session {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Session")
    }
}

impl Session {
    /// The code of a frame.
    #[must_use]
    pub fn frame_code(&self, frame: &[u8]) -> [u8; CODE_BYTES] {
        cut(&hmac(&self.0, &[FRAME, frame]))
    }

    /// The code of a confirmation.
    #[must_use]
    pub fn ack_code(&self, ack: &[u8]) -> [u8; CODE_BYTES] {
        cut(&hmac(&self.0, &[ACK, ack]))
    }
}

/// Whether two codes are equal, in a time that does not depend on them.
#[must_use]
pub fn is_equal(a: &[u8; CODE_BYTES], b: &[u8; CODE_BYTES]) -> bool {
    a.ct_eq(b).into()
}

/// A nonce that nobody can predict.
///
/// # Errors
/// The system's error.
pub fn nonce() -> io::Result<[u8; NONCE_BYTES]> {
    let mut bytes = [0; NONCE_BYTES];
    getrandom(&mut bytes, GetRandomFlags::empty())?;
    Ok(bytes)
}

fn cut(code: &[u8; 32]) -> [u8; CODE_BYTES] {
    let mut cut = [0; CODE_BYTES];
    cut.copy_from_slice(&code[..CODE_BYTES]);
    cut
}

/// HMAC-SHA-256 of the parts, as if they were one.
fn hmac(key: &[u8], parts: &[&[u8]]) -> [u8; 32] {
    let code = Hmac::<Sha256>::new_from_slice(key).expect("HMAC takes keys of any length");
    parts.iter().fold(code, |code, part| code.chain_update(part)).finalize().into_bytes().into()
}

#[cfg(test)]
mod tests;
