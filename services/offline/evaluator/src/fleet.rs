//! Every forecast of one recording beside the motion, for jobs over many recordings.
//!
//! [`worst`] ranks the ticks of a recording, [`differences`] compares two builds, and [`learn`] and [`priors`] make a
//! prior.

mod differences;
mod footprint;
mod learned;
mod outcomes;
mod worst;

pub use differences::{Difference, DifferenceCounts, count_differences, differences};
pub use footprint::Contact;
pub use learned::{Learned, learn, priors};
pub use outcomes::{Outcome, OutcomeErrors, Outcomes, outcomes};
pub use worst::{Criterion, WorstTick, worst};
