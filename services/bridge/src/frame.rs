//! The layout of a link: greetings, frames and confirmations. Numbers are little-endian.
//!
//! | who | sends | bytes |
//! |---|---|---|
//! | sender | [`SenderHello`] | 24 |
//! | receiver | [`ReceiverHello`], code | 32 + 16 |
//! | sender | frames: [`Envelope`], body, code | 48 + body + 16 |
//! | receiver | for each frame: [`Ack`], code | 16 + 16 |
//!
//! The body of a frame is a [`TickHead`] with [`forecasts`] or [`detections`]. A frame of
//! [`Kind::Alive`] has no body.

pub mod detections;
pub mod forecasts;

use bytemuck::{Pod, Zeroable, bytes_of, bytes_of_mut, pod_read_unaligned};
use thiserror::Error;
use wire::{HORIZON_MAX, Header, Rejected, WorldOrigin};

use crate::auth::{CODE_BYTES, NONCE_BYTES, Session, is_equal};

/// The first bytes of greetings and frames.
pub const MAGIC: [u8; 4] = *b"STGB";
/// Version of the layout. Another version is refused.
pub const VERSION: u16 = 1;
/// Most bytes of a frame, code included. A longer one is refused before memory is taken for it.
pub const FRAME_BYTES_MAX: usize = 65_536;
/// Bytes of the envelope that its check value does not cover.
const UNCHECKED_BYTES: usize = 16;

/// What a frame contains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Nothing: the sender is alive, and there is no newer frame.
    Alive = 0,
    /// The forecasts of a tick.
    Forecasts = 1,
    /// The detections of a sensor's frame.
    Detections = 2,
}

/// The sender's greeting.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct SenderHello {
    /// [`MAGIC`].
    pub magic: [u8; 4],
    /// [`VERSION`].
    pub version: u16,
    /// The [`Kind`] of the frames that follow.
    pub kind: u16,
    /// A number that the sender has not used before.
    pub nonce: [u8; NONCE_BYTES],
}

/// The receiver's greeting.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct ReceiverHello {
    /// [`MAGIC`].
    pub magic: [u8; 4],
    /// [`VERSION`].
    pub version: u16,
    /// The expected [`Kind`] of frames.
    pub kind: u16,
    /// A number that the receiver has not used before.
    pub nonce: [u8; NONCE_BYTES],
    /// As [`Ack::token`].
    pub token: u64,
}

/// The head of a frame.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Envelope {
    /// [`MAGIC`].
    pub magic: [u8; 4],
    /// [`VERSION`].
    pub version: u16,
    /// [`Kind`] as a number.
    pub kind: u16,
    /// Bytes of the whole frame, code included.
    pub length: u32,
    /// CRC-32 (as in zlib) of all bytes after this field, without the code.
    pub crc: u32,
    /// Number of the frame in this session, from 1, without gaps.
    pub counter: u64,
    /// The token of the newest confirmation that the sender has received, or of the greeting.
    pub token: u64,
    /// Time from the arrival of this token to the sending of this frame, in µs.
    pub held_us: u32,
    /// Time from the release of the tick to the sending of this frame, in µs, on the sender's clock.
    pub waited_us: u32,
    /// Unix time of the sender at the sending of this frame. Only for hosts whose clocks are synchronised.
    pub sent_unix_ns: i64,
}

/// The confirmation of a frame.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
pub struct Ack {
    /// The counter of the frame.
    pub counter: u64,
    /// Any number. The sender returns it, with the time that it has held it. A receiver uses its own clock,
    /// and knows then how long the frame was on its way at most.
    pub token: u64,
}

/// Flags of a [`TickHead`]: bits of [`wire::flags`] that describe the input.
pub const FLAGS: u32 = wire::flags::HAS_IDENTITIES | wire::flags::SEEN_FROM_EGO;

/// The head of a tick: first part of a body.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct TickHead {
    /// Identifies the sender's run.
    pub run_id: u64,
    /// Number of the tick in that run.
    pub seq: u64,
    /// Time of validity on the clock of the sensor or recording.
    pub stamp_ns: i64,
    /// Of forecasts: Δt, step k is (k + 1) Δt after the stamp. Of detections: the planned interval between
    /// frames.
    pub interval_ns: u64,
    /// Origin of all positions of the frame, in the frame of map and detections, m.
    pub origin_m: [f64; 2],
    /// Position of the ego vehicle or of the scene's centre, from the origin, m.
    pub ego_m: [f32; 2],
    /// Heading of the ego vehicle.
    pub ego_heading_rad: f32,
    /// Bits of [`FLAGS`].
    pub flags: u32,
    /// Number of agents or detections that follow.
    pub elements_len: u16,
    /// Number of agents or detections that the frame lacks: it was full, or they can't be written.
    pub left_out_len: u16,
    /// Steps of each forecast.
    pub horizon_len: u8,
    /// Bits of the agent types that the sensor looked for.
    pub observed_types: u8,
    /// [`wire::StampSource`] of the stamp as a number.
    pub stamp_source: u8,
    /// Zero.
    pub reserved: u8,
}

impl TickHead {
    /// The head of a run's tick. A tick has no Δt before the tracker. Its interval is the interval of the
    /// source.
    #[must_use]
    pub fn of(header: &Header, origin: WorldOrigin) -> Self {
        Self {
            run_id: header.run_id,
            seq: header.seq,
            stamp_ns: header.stamp_ns,
            interval_ns: if header.step_ns > 0 { header.step_ns } else { header.interval_ns },
            origin_m: origin.position_m(),
            ego_m: header.ego_m,
            ego_heading_rad: header.ego_heading_rad,
            flags: header.flags & FLAGS,
            left_out_len: u16::try_from(header.left_out_len).unwrap_or(u16::MAX),
            horizon_len: header.counts.horizon_len.min(HORIZON_MAX as u32) as u8,
            observed_types: header.observed_types as u8,
            stamp_source: header.stamp_source as u8,
            ..Self::default()
        }
    }
}

const _: () = assert!(size_of::<SenderHello>() == 24 && size_of::<ReceiverHello>() == 32);
const _: () = assert!(size_of::<Envelope>() == 48 && size_of::<Ack>() == 16 && size_of::<TickHead>() == 72);
const _: () = assert!(forecasts::BODY_BYTES_MAX + size_of::<Envelope>() + CODE_BYTES <= FRAME_BYTES_MAX);
const _: () = assert!(detections::BODY_BYTES_MAX + size_of::<Envelope>() + CODE_BYTES <= FRAME_BYTES_MAX);

/// Why bytes are refused.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Refused {
    /// The bytes do not begin with the mark of this protocol.
    #[error("this is not a bridge of stgdat")]
    Magic,
    /// The other end has another version.
    #[error("version {0} of the bridge, expected {VERSION}")]
    Version(u16),
    /// The other end offers or expects other frames.
    #[error("frames of kind {found}, expected {expected}")]
    Kind {
        /// The other end's kind.
        found: u16,
        /// The expected kind.
        expected: u16,
    },
    /// The code is wrong.
    #[error("the code is wrong: the other end has another key")]
    Code,
    /// The check value is wrong.
    #[error("check value {found:08x}, the frame has {expected:08x}")]
    CheckValue {
        /// The envelope's check value.
        found: u32,
        /// The check value of the received bytes.
        expected: u32,
    },
    /// The frame is not the next one of its session.
    #[error("frame {found} of the session, expected {expected}")]
    Counter {
        /// The frame's number.
        found: u64,
        /// The expected number.
        expected: u64,
    },
    /// A length is impossible.
    #[error("{field} = {found} is impossible")]
    Length {
        /// The field.
        field: &'static str,
        /// Its value.
        found: u64,
    },
    /// An element has an impossible value.
    #[error(transparent)]
    Value(#[from] Rejected),
}

/// Refuses greetings of another protocol or version, or about other frames.
///
/// # Errors
/// [`Refused::Magic`], [`Refused::Version`] or [`Refused::Kind`].
pub fn check_hello(magic: [u8; 4], version: u16, found: u16, expected: Kind) -> Result<(), Refused> {
    check_start(magic, version)?;
    let expected = expected as u16;
    if found == expected { Ok(()) } else { Err(Refused::Kind { found, expected }) }
}

fn check_start(magic: [u8; 4], version: u16) -> Result<(), Refused> {
    match (magic == MAGIC, version == VERSION) {
        (false, _) => Err(Refused::Magic),
        (true, false) => Err(Refused::Version(version)),
        (true, true) => Ok(()),
    }
}

/// Begins a frame: an envelope without check value, and the body.
pub fn begin(frame: &mut Vec<u8>, envelope: &Envelope, body: &[u8]) {
    frame.clear();
    frame.extend_from_slice(bytes_of(envelope));
    frame.extend_from_slice(body);
}

/// Completes a frame with its length, check value and code.
pub fn seal(frame: &mut Vec<u8>, session: &Session) {
    let mut envelope: Envelope = pod_read_unaligned(&frame[..size_of::<Envelope>()]);
    envelope.length = (frame.len() + CODE_BYTES) as u32;
    envelope.crc = crc32fast::hash(&frame[UNCHECKED_BYTES..]);
    frame[..size_of::<Envelope>()].copy_from_slice(bytes_of(&envelope));
    let code = session.frame_code(frame);
    frame.extend_from_slice(&code);
}

impl Envelope {
    /// Bytes of an envelope.
    pub const BYTES: usize = size_of::<Self>();

    /// An envelope without length and check value.
    #[must_use]
    pub fn new(kind: Kind, counter: u64) -> Self {
        Self { magic: MAGIC, version: VERSION, kind: kind as u16, counter, ..Zeroable::zeroed() }
    }

    /// Reads an envelope. Refuses a length beyond the limit.
    ///
    /// # Errors
    /// [`Refused`] names the field.
    pub fn read(bytes: &[u8; Self::BYTES]) -> Result<Self, Refused> {
        let mut envelope = Self::zeroed();
        bytes_of_mut(&mut envelope).copy_from_slice(bytes);
        check_start(envelope.magic, envelope.version)?;
        let length = envelope.length as usize;
        if !(Self::BYTES + CODE_BYTES..=FRAME_BYTES_MAX).contains(&length) {
            return Err(Refused::Length { field: "length", found: u64::from(envelope.length) });
        }
        Ok(envelope)
    }
}

/// The body of a whole frame, after all checks. `counter` is the number of the session's next frame.
///
/// # Errors
/// [`Refused`] names what is wrong.
pub fn open<'a>(frame: &'a [u8], session: &Session, counter: u64) -> Result<(Envelope, &'a [u8]), Refused> {
    let short = || Refused::Length { field: "length", found: frame.len() as u64 };
    let (start, _) = frame.split_first_chunk().ok_or_else(short)?;
    let envelope = Envelope::read(start)?;
    let (sealed, code) = frame.split_last_chunk::<CODE_BYTES>().ok_or_else(short)?;
    if frame.len() != envelope.length as usize {
        return Err(short());
    }
    if !is_equal(code, &session.frame_code(sealed)) {
        return Err(Refused::Code);
    }
    let expected = crc32fast::hash(&sealed[UNCHECKED_BYTES..]);
    if envelope.crc != expected {
        return Err(Refused::CheckValue { found: envelope.crc, expected });
    }
    if envelope.counter != counter {
        return Err(Refused::Counter { found: envelope.counter, expected: counter });
    }
    Ok((envelope, &sealed[Envelope::BYTES..]))
}

/// Reads the elements of a body one after another.
#[derive(Debug)]
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn take<T: Pod>(&mut self) -> Result<T, Refused> {
        let short = Refused::Length { field: "length", found: self.0.len() as u64 };
        let (start, rest) = self.0.split_at_checked(size_of::<T>()).ok_or(short)?;
        self.0 = rest;
        Ok(pod_read_unaligned(start))
    }

    /// The head of a tick with at most `elements_max` elements.
    fn head(&mut self, elements_max: usize) -> Result<TickHead, Refused> {
        let head: TickHead = self.take()?;
        at_most("elements_len", head.elements_len.into(), elements_max)?;
        wire::finite("ego", &[head.ego_m[0], head.ego_m[1], head.ego_heading_rad])?;
        if wire::WorldOrigin::new(head.origin_m).is_none() {
            return Err(Rejected::NotFinite { field: "origin" }.into());
        }
        Ok(head)
    }

    /// Refuses bytes after the last element.
    fn end(self) -> Result<(), Refused> {
        at_most("bytes after the last element", self.0.len(), 0)
    }
}

fn at_most(field: &'static str, found: usize, most: usize) -> Result<(), Refused> {
    if found <= most { Ok(()) } else { Err(Refused::Length { field, found: found as u64 }) }
}

#[cfg(test)]
mod tests;
