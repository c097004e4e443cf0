//! Files of states: a line with version and checksum, then the state in bincode.

use bincode::config::standard;
use serde::Serialize;
use thiserror::Error;
use wire::crc64;

use super::State;

/// First word of a file.
const MAGIC: &str = "stgdat-evaluation ";
/// Version of the layout.
const SCHEMA: u32 = 2;
/// Version of the program: another one may forecast differently.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Why states can't be read or merged.
#[derive(Debug, Error)]
pub enum StateError {
    /// There is no state.
    #[error("no state of an evaluation is given")]
    None,
    /// The file can't be read.
    #[error("{name}: {source}")]
    File {
        /// The file.
        name: String,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not a state.
    #[error("{name}: not a state of an evaluation; `evaluate FILE… --state OUT` writes one")]
    Foreign {
        /// The state.
        name: String,
    },
    /// The state is of another version of the program or of its layout.
    #[error("{name}: a state of stgdat {version}, layout {layout}, and this is {VERSION}, layout {SCHEMA}")]
    Version {
        /// The state.
        name: String,
        /// The version that wrote it.
        version: String,
        /// Its layout.
        layout: u32,
    },
    /// The checksum does not match, or the content has another layout.
    #[error("{name}: the state is damaged or incomplete")]
    Damaged {
        /// The state.
        name: String,
    },
    /// Two states have different weights or options, so that their figures can't be added.
    #[error("{name}: {option} {found}, but {first} has {expected}")]
    Other {
        /// The state.
        name: String,
        /// The state that it differs from.
        first: String,
        /// What is different.
        option: &'static str,
        /// The state's value.
        found: String,
        /// The first state's value.
        expected: String,
    },
}

impl State {
    /// The state as the bytes of a file.
    pub fn to_bytes(&self) -> Vec<u8> {
        let body = encode(self);
        let first = format!("{MAGIC}{SCHEMA} {VERSION} {:016x}\n", crc64(&[&body]));
        [first.as_bytes(), &body].concat()
    }

    /// Reads the bytes of [`State::to_bytes`]. `name` is the state's name in errors.
    ///
    /// # Errors
    /// [`StateError`] if the bytes are not a state of this version.
    pub fn from_bytes(name: &str, bytes: &[u8]) -> Result<Self, StateError> {
        let name = name.to_owned();
        let parsed = bytes.iter().position(|&byte| byte == b'\n').and_then(|end| {
            let first = std::str::from_utf8(&bytes[..end]).ok()?.strip_prefix(MAGIC)?;
            let mut words = first.split(' ');
            let layout: u32 = words.next()?.parse().ok()?;
            Some((layout, words.next()?.to_owned(), words.next()?.to_owned(), &bytes[end + 1..]))
        });
        let Some((layout, version, checksum, body)) = parsed else {
            return Err(StateError::Foreign { name });
        };
        if layout != SCHEMA || version != VERSION {
            return Err(StateError::Version { name, version, layout });
        }
        if checksum != format!("{:016x}", crc64(&[body])) {
            return Err(StateError::Damaged { name });
        }
        match bincode::serde::decode_from_slice(body, standard()) {
            Ok((state, used)) if used == body.len() && Self::is_whole(&state) => Ok(state),
            _ => Err(StateError::Damaged { name }),
        }
    }
}

/// # Panics
/// Never: the sizes of all lists are known.
pub(super) fn encode(value: &impl Serialize) -> Vec<u8> {
    bincode::serde::encode_to_vec(value, standard()).expect("lists have known sizes")
}
