//! The greetings of both ends.

use std::time::{Duration, Instant};

use bytemuck::{Zeroable as _, bytes_of, bytes_of_mut};

use crate::auth::{CODE_BYTES, Key, Session, is_equal, nonce};
use crate::counts::LinkError;
use crate::frame::{Kind, MAGIC, ReceiverHello, Refused, SenderHello, VERSION, check_hello};
use crate::socket::Socket;

/// Time limit of a sender for the greeting of a receiver, which holds one of few places meanwhile. A receiver
/// whose packet was lost connects again.
const RECEIVER_LIMIT: Duration = Duration::from_millis(500);
/// Time limit of a receiver for the greeting of its sender. Loss may delay it by a second.
pub(crate) const GREETING_LIMIT: Duration = Duration::from_secs(3);

/// A receiver that is authenticated.
pub(crate) struct Greeted {
    pub session: Session,
    pub token: u64,
    pub arrived: Instant,
}

/// Greets a receiver.
pub(crate) fn greet(socket: &mut Socket, kind: Kind, key: &Key) -> Result<Greeted, LinkError> {
    let until = Instant::now() + RECEIVER_LIMIT;
    let mine = SenderHello { magic: MAGIC, version: VERSION, kind: kind as u16, nonce: nonce()? };
    socket.write_until(bytes_of(&mine), until)?;
    let (mut other, mut code) = (ReceiverHello::zeroed(), [0; CODE_BYTES]);
    socket.read_until(bytes_of_mut(&mut other), Some(until))?;
    check_hello(other.magic, other.version, other.kind, kind)?;
    socket.read_until(&mut code, Some(until))?;
    let arrived = Instant::now();
    let (mine, token, other) = (bytes_of(&mine), other.token, bytes_of(&other));
    if !is_equal(&code, &key.receiver_code(mine, other)) {
        return Err(Refused::Code.into());
    }
    Ok(Greeted { session: key.session(mine, other), token, arrived })
}

/// Greets a sender, which the first frame authenticates.
pub(crate) fn answer(socket: &mut Socket, kind: Kind, key: &Key, token: u64) -> Result<Session, LinkError> {
    let until = Instant::now() + GREETING_LIMIT;
    let mut other = SenderHello::zeroed();
    socket.read_until(bytes_of_mut(&mut other), Some(until))?;
    check_hello(other.magic, other.version, other.kind, kind)?;
    let mine = ReceiverHello { magic: MAGIC, version: VERSION, kind: kind as u16, nonce: nonce()?, token };
    let (mine, other) = (bytes_of(&mine), bytes_of(&other));
    socket.write_until(mine, until)?;
    socket.write_until(&key.receiver_code(other, mine), until)?;
    Ok(key.session(other, mine))
}
