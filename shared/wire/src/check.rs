use thiserror::Error;

/// Why a frame was refused. The stage counts it and goes on.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Rejected {
    /// The sender speaks another version.
    #[error("schema {found}, expected {expected}")]
    Schema {
        /// The sender's version.
        found: u32,
        /// Ours.
        expected: u32,
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
    /// The payload does not have the length that its header tells.
    #[error("payload of {found} elements, header tells {expected}")]
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
    // x · 0 is 0 for finite x and NaN otherwise, so one sum tells of all of them and vectorises.
    let sum: f32 = values.iter().map(|x| x * 0.0).sum();
    if sum == 0.0 { Ok(()) } else { Err(Rejected::NotFinite { field }) }
}
