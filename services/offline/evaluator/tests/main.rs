//! Tests of the evaluator: windows of recordings, forecasts, figures and reports.

mod support {
    pub mod weights;
}

mod driving;
mod forecaster;
mod kitti;
mod lines;
mod report;
mod shipped;
mod states;
mod windows;
