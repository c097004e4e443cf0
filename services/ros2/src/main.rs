//! The bridge to ROS 2 as a program: a stage of pipeline.toml, or `stgdat ros2`.

use std::process::ExitCode;

use wire::StageId;

fn main() -> ExitCode {
    match std::env::var(run::STAGE_VARIABLE) {
        Ok(stage) if stage == StageId::Source.name() => ports::stage_main(ros2::source::run),
        _ => ports::stage_main(ros2::publish::run),
    }
}
