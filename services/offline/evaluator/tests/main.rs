//! The evaluator: golden vectors, windows of recordings, figures and reports.

mod support {
    pub mod weights;
}

mod forecaster;
mod golden;
mod golden_tracking;
mod kitti;
mod report;
mod shipped;
mod windows;
