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
    /// An agent can't be drawn: a number is not finite, the parts of its forecast differ in length, or a
    /// covariance is not positive semi-definite.
    #[error("agent {agent}: {problem}")]
    Agent {
        /// The agent.
        agent: u64,
        /// What is wrong.
        problem: String,
    },
}

/// Refuses a value outside its range.
pub(crate) fn within(what: &'static str, value: f64, least: f64, most: f64) -> Result<(), PictureError> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    Err(PictureError::OutOfRange { what, value, least, most })
}
