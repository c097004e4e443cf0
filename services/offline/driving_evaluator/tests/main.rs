//! Driving, judged on recordings whose answers are known.

mod driving;
