use thiserror::Error;

/// Why a frame was refused. The stage counts it and continues.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Rejected {
    /// The sender has another version.
    #[error("schema {found}, expected {expected}")]
    Schema {
        /// The sender's version.
        found: u32,
        /// This program's version.
        expected: u32,
    },
    /// The frame belongs to another run.
    #[error("run {found:016x}, this one is {expected:016x}")]
    ForeignRun {
        /// The frame's run.
        found: u64,
        /// The reader's.
        expected: u64,
    },
    /// A newer process has replaced the frame's sender.
    #[error("incarnation {found} of its sender, the newest is {newest}")]
    OldIncarnation {
        /// The frame's.
        found: u32,
        /// The newest received incarnation.
        newest: u32,
    },
    /// The frame has no check value, and the run requires one on its topic.
    #[error(
        "no check value: fill in the header's protection (`stgdat wire --c` and `--python` have the function), \
         or leave the topic out of `protect` in pipeline.toml"
    )]
    Unprotected,
    /// Header and payload do not match the check value.
    #[error("check value {found:016x}, header and payload have {expected:016x}")]
    CheckValue {
        /// The header's check value.
        found: u64,
        /// The check value computed from the received header and payload.
        expected: u64,
    },
    /// The frame was protected for another topic.
    #[error("protected for the topic of number {found:08x}, this one has {expected:08x}")]
    Misdirected {
        /// The frame's topic.
        found: u32,
        /// The topic on which it arrived.
        expected: u32,
    },
    /// The frame is repeated, or a newer one has overtaken it.
    #[error("frame {counter} of its sender is repeated or late, the newest is {newest}")]
    Repeated {
        /// The frame's counter.
        counter: u32,
        /// The newest frame's counter.
        newest: u32,
    },
    /// Two elements have the same number.
    #[error("{field} {id} appears twice")]
    Twice {
        /// The meaning of the number.
        field: &'static str,
        /// The number.
        id: u64,
    },
    /// Elements are not in the order that the payload requires.
    #[error("{field} are out of order at element {at}")]
    OutOfOrder {
        /// The elements.
        field: &'static str,
        /// Index of the first element that belongs before its predecessor.
        at: usize,
    },
    /// A count exceeds its limit.
    #[error("{field} = {found}, at most {most} allowed")]
    TooMany {
        /// The header's field.
        field: &'static str,
        /// Its value.
        found: u64,
        /// The limit.
        most: u64,
    },
    /// The payload's length differs from the header's.
    #[error("payload of {found} elements, header gives {expected}")]
    Length {
        /// Elements in the payload.
        found: usize,
        /// Elements according to the header.
        expected: usize,
    },
    /// A number is not finite.
    #[error("{field} is not finite")]
    NotFinite {
        /// The meaning of the number.
        field: &'static str,
    },
    /// A number is finite but impossible.
    #[error("{field} = {value} is impossible")]
    Impossible {
        /// The meaning of the number.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// The frame is not newer than a processed one.
    #[error("stamp {stamp_ns} ns is not after {last_ns} ns")]
    NotNewer {
        /// The frame's stamp.
        stamp_ns: i64,
        /// The stamp of the newest frame processed.
        last_ns: i64,
    },
    /// The frame's elements repeat those of the previous frames, although something in them moves.
    #[error("the same {field} for {frames} frames, and something moves in them")]
    Frozen {
        /// The elements.
        field: &'static str,
        /// Number of frames with these elements, including this one.
        frames: u32,
    },
    /// The frame's sizes differ from the loaded model's.
    #[error("{field} = {found}, the model has {expected}")]
    Mismatch {
        /// The size's name.
        field: &'static str,
        /// The frame's.
        found: usize,
        /// The model's.
        expected: usize,
    },
}

/// Refuses more than `most` elements.
///
/// # Errors
/// [`Rejected::TooMany`] with the field's name.
pub const fn at_most(field: &'static str, found: usize, most: usize) -> Result<(), Rejected> {
    if found <= most {
        Ok(())
    } else {
        Err(Rejected::TooMany { field, found: found as u64, most: most as u64 })
    }
}

/// Refuses a size that differs from the model's.
///
/// # Errors
/// [`Rejected::Mismatch`] with the size's name.
pub const fn equal(field: &'static str, found: usize, expected: usize) -> Result<(), Rejected> {
    if found == expected { Ok(()) } else { Err(Rejected::Mismatch { field, found, expected }) }
}

/// Refuses numbers that are not finite.
///
/// # Errors
/// [`Rejected::NotFinite`] with the field's name.
pub fn finite(field: &'static str, values: &[f32]) -> Result<(), Rejected> {
    const EXPONENT: u32 = 0x7F80_0000;
    // Infinities and NaNs have all exponent bits set. Integers without an early exit: the loop vectorises.
    let found = values.iter().fold(false, |found, x| found | (x.to_bits() & EXPONENT == EXPONENT));
    if found { Err(Rejected::NotFinite { field }) } else { Ok(()) }
}
