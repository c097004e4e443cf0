//! Tests of the driving evaluation on recordings with known answers.

mod driving;
