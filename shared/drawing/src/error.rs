use thiserror::Error;

/// Why a picture can't be drawn.
#[derive(Debug, Error)]
pub enum PictureError {
    /// There is nothing to draw.
    #[error("a picture without panels")]
    Empty,
    /// An option or a size that no picture can have.
    #[error("{what} is {value}, which is not within {least} and {most}")]
    OutOfRange {
        /// What it is.
        what: &'static str,
        /// Its value.
        value: f64,
        /// The least that is possible.
        least: f64,
        /// The most that is possible.
        most: f64,
    },
    /// A number of an agent is not finite.
    #[error("agent {agent}: its {what} is not finite")]
    NotFinite {
        /// The agent.
        agent: u64,
        /// What is not finite.
        what: &'static str,
    },
    /// The parts of a forecast don't belong together.
    #[error("agent {agent}: {what} has length {len}, expected {expected}")]
    Length {
        /// The agent.
        agent: u64,
        /// Which part.
        what: &'static str,
        /// Its length.
        len: usize,
        /// The length that it must have.
        expected: usize,
    },
    /// A covariance that belongs to no Gaussian.
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

/// Refuses a value outside of its range.
pub(crate) fn within(what: &'static str, value: f64, least: f64, most: f64) -> Result<(), PictureError> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    Err(PictureError::OutOfRange { what, value, least, most })
}
