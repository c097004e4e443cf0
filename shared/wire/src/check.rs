use thiserror::Error;

/// Why a frame was refused. The stage counts it and goes on.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Rejected {
    /// The sender is of another version.
    #[error("schema {found}, expected {expected}")]
    Schema {
        /// The sender's version.
        found: u32,
        /// Ours.
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
    /// The frame's sender has been replaced since by a newer process.
    #[error("incarnation {found} of its sender, the newest is {newest}")]
    OldIncarnation {
        /// The frame's.
        found: u32,
        /// The newest that was received.
        newest: u32,
    },
    /// The frame has no check value, and the run asks for one on its topic.
    #[error(
        "no check value: fill in the header's protection (`stgdat wire --c` and `--python` have the function), \
         or leave the topic out of `protect` in pipeline.toml"
    )]
    Unprotected,
    /// Header and payload are not those that the sender protected.
    #[error("check value {found:016x}, header and payload have {expected:016x}")]
    CheckValue {
        /// The header's check value.
        found: u64,
        /// That of header and payload as they came.
        expected: u64,
    },
    /// The frame was protected for another topic.
    #[error("protected for the topic of number {found:08x}, this one has {expected:08x}")]
    Misdirected {
        /// The frame's topic.
        found: u32,
        /// The topic that it came on.
        expected: u32,
    },
    /// The frame has come before, or a newer one has overtaken it.
    #[error("frame {counter} of its sender is repeated or late, the newest is {newest}")]
    Repeated {
        /// The frame's counter.
        counter: u32,
        /// The counter of the newest one.
        newest: u32,
    },
    /// Two elements have one number.
    #[error("{field} {id} appears twice")]
    Twice {
        /// What the number stands for.
        field: &'static str,
        /// The number.
        id: u64,
    },
    /// Elements are not in the order that the payload demands.
    #[error("{field} are out of order at element {at}")]
    OutOfOrder {
        /// The elements.
        field: &'static str,
        /// The first element that must come before the one before it.
        at: usize,
    },
    /// A count is beyond its limit.
    #[error("{field} = {found}, at most {most} allowed")]
    TooMany {
        /// The header's field.
        field: &'static str,
        /// Its value.
        found: u64,
        /// The limit.
        most: u64,
    },
    /// The payload does not have the length that its header gives.
    #[error("payload of {found} elements, header gives {expected}")]
    Length {
        /// Elements in the payload.
        found: usize,
        /// Elements by the header.
        expected: usize,
    },
    /// A number is not finite.
    #[error("{field} is not finite")]
    NotFinite {
        /// What the number stands for.
        field: &'static str,
    },
    /// A number is finite but can't be.
    #[error("{field} = {value} is impossible")]
    Impossible {
        /// What the number stands for.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// The frame is not newer than one that was processed before.
    #[error("stamp {stamp_ns} ns is not after {last_ns} ns")]
    NotNewer {
        /// The frame's stamp.
        stamp_ns: i64,
        /// The stamp of the newest frame processed.
        last_ns: i64,
    },
    /// The frame's elements are those of the frames before it, though something moves in them.
    #[error("the same {field} for {frames} frames, and something moves in them")]
    Frozen {
        /// The elements.
        field: &'static str,
        /// Frames with these elements, this one included.
        frames: u32,
    },
    /// The frame's sizes are not those of the loaded model.
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

/// Refuses numbers that are not finite.
///
/// # Errors
/// [`Rejected::NotFinite`] with the field's name.
pub fn finite(field: &'static str, values: &[f32]) -> Result<(), Rejected> {
    const EXPONENT: u32 = 0x7F80_0000;
    // Infinities and NaNs have all bits of the exponent. Whole numbers and no early end: it vectorises.
    let found = values.iter().fold(false, |found, x| found | (x.to_bits() & EXPONENT == EXPONENT));
    if found { Err(Rejected::NotFinite { field }) } else { Ok(()) }
}
