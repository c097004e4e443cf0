use thiserror::Error;

/// Why a picture cannot be drawn.
#[derive(Debug, Error)]
pub enum PictureError {
    /// There is nothing to draw.
    #[error("a picture without panels")]
    Empty,
    /// An option or a size is outside its range.
    #[error("{what} is {value}, which is not within {least} and {most}")]
    OutOfRange {
        /// Name of the option or size.
        what: &'static str,
        /// The value.
        value: f64,
        /// The smallest valid value.
        least: f64,
        /// The largest valid value.
        most: f64,
    },
    /// A number of an agent is not finite.
    #[error("agent {agent}: its {what} is not finite")]
    NotFinite {
        /// The agent.
        agent: u64,
        /// The name of the number.
        what: &'static str,
    },
    /// The parts of a forecast differ in length.
    #[error("agent {agent}: {what} has length {len}, expected {expected}")]
    Length {
        /// The agent.
        agent: u64,
        /// The name of the part.
        what: &'static str,
        /// Length.
        len: usize,
        /// The expected length.
        expected: usize,
    },
    /// A covariance is not positive semi-definite.
    #[error("agent {agent}: mode {mode}, step {step}: covariance {covariance:?} is not positive")]
    Covariance {
        /// The agent.
        agent: u64,
        /// The mode.
        mode: usize,
        /// The step.
        step: usize,
        /// The covariance (xx, xy, yy), m².
        covariance: [f32; 3],
    },
}

/// Refuses a value outside its range.
pub(crate) fn within(what: &'static str, value: f64, least: f64, most: f64) -> Result<(), PictureError> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    Err(PictureError::OutOfRange { what, value, least, most })
}
