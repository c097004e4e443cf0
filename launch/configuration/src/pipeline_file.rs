//! Reads the pipeline.toml of a run: a user's file or the shipped one.

use std::path::Path;

use console::failure::Failure;
use supervisor::scheduling;

use crate::pipeline::Pipeline;
use crate::stages;

/// The default pipeline.toml.
pub const SHIPPED: &str = include_str!("../../pipeline.toml");

/// Reads and checks a pipeline.toml, or the shipped one.
pub fn load(path: Option<&Path>) -> Result<Pipeline, Failure> {
    let declared = stages::declared();
    let text = text(path)?;
    let Some(path) = path else { return Ok(Pipeline::parse("pipeline.toml", &text, &declared)?) };
    let name = path.display().to_string();
    let mut pipeline = Pipeline::parse(&name, &text, &declared)?;
    if !pipeline.realtime.auto_cpu.is_empty() {
        pipeline.choose_cpus(&scheduling::reserved_cpus());
    }
    pipeline.name_stages();
    for warning in &pipeline.warnings {
        tracing::warn!("{name}: {warning}");
    }
    Ok(pipeline)
}

/// Refuses a pipeline.toml whose programs or processors are missing on this machine.
pub fn check_here(path: Option<&Path>) -> Result<(), Failure> {
    let name = path.map_or_else(|| "pipeline.toml".to_owned(), |path| path.display().to_string());
    Ok(Pipeline::check_here(&name, &text(path)?, &find_program, &scheduling::has_cpu)?)
}

/// Searches for a program as the system does when it starts one. The error names the missing program.
fn find_program(program: &str) -> Result<(), String> {
    let is_program =
        |path: &Path| path.is_file() && rustix::fs::access(path, rustix::fs::Access::EXEC_OK).is_ok();
    if program.contains('/') {
        let path = Path::new(program);
        return match path.is_file() {
            _ if is_program(path) => Ok(()),
            true => Err("it is not executable".to_owned()),
            false => Err("there is no such file".to_owned()),
        };
    }
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let is_found = std::env::split_paths(&folders).any(|folder| is_program(&folder.join(program)));
    if is_found { Ok(()) } else { Err("it is not found in PATH".to_owned()) }
}

/// Returns the text of a pipeline.toml, or of the shipped one.
pub fn text(path: Option<&Path>) -> Result<String, Failure> {
    let Some(path) = path else { return Ok(SHIPPED.to_owned()) };
    std::fs::read_to_string(path).map_err(|error| Failure::config_about(path.display(), error))
}

#[cfg(test)]
mod tests {
    use wire::StageId;

    use super::*;

    #[test]
    fn programs_are_found_as_the_system_finds_them() {
        assert_eq!(find_program("sh"), Ok(()));
        assert_eq!(find_program("/bin/sh"), Ok(()));
        assert_eq!(find_program("no-such-program"), Err("it is not found in PATH".to_owned()));
        assert_eq!(find_program("./no-such-program"), Err("there is no such file".to_owned()));
        assert_eq!(find_program("/dev/null"), Err("there is no such file".to_owned()));
        assert_eq!(find_program("/etc/passwd"), Err("it is not executable".to_owned()));
        assert!(scheduling::has_cpu(0) && !scheduling::has_cpu(1023));
    }

    #[test]
    fn the_shipped_pipeline_has_all_stages_and_the_loop() {
        let pipeline = load(None).unwrap();
        assert_eq!(pipeline.stages.len(), stages::STAGES.len());
        for (stage, declared) in pipeline.stages.iter().zip(stages::declared()) {
            assert_eq!(stage.id, declared.id());
            assert!(stage.reads == declared.reads() && stage.writes == declared.writes(), "{stage:?}");
        }
        assert!(pipeline.edges().contains(&(StageId::Sampler, "forecasts", StageId::Tracker)));
        assert!(pipeline.warnings.is_empty());
    }
}
