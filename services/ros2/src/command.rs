//! The command line of `stgdat ros2`.

use std::path::PathBuf;

use clap::Parser;

use crate::options::Options;

/// Publish the tracks and forecasts of a running pipeline in ROS 2 (stgdat-ros2).
///
/// In pipeline.toml the program is a stage instead. In place of the source it also reads detections.
#[derive(Debug, Parser)]
#[command(name = "stgdat ros2")]
pub struct Arguments {
    /// Name or folder of the run; not needed if only one is running
    #[arg(long, value_name = "RUN")]
    pub run: Option<PathBuf>,
    /// What is published, and where.
    #[command(flatten)]
    pub options: Options,
}
