use std::path::Path;

use config::Pipeline;

use crate::failure::Failure;
use crate::stages;

/// The default pipeline.
pub const SHIPPED: &str = include_str!("../pipeline.toml");

/// Reads and checks a pipeline.toml, or the shipped one.
pub fn load(path: Option<&Path>) -> Result<Pipeline, Failure> {
    let declared = stages::declared();
    let text = text(path)?;
    let Some(path) = path else { return Ok(Pipeline::parse("pipeline.toml", &text, &declared)?) };
    let name = path.display().to_string();
    let pipeline = Pipeline::parse(&name, &text, &declared)?;
    pipeline.name_stages();
    for warning in &pipeline.warnings {
        note!("warning: {name}: {warning}");
    }
    Ok(pipeline)
}

/// The text of a pipeline.toml, or of the shipped one.
pub fn text(path: Option<&Path>) -> Result<String, Failure> {
    let Some(path) = path else { return Ok(SHIPPED.to_owned()) };
    std::fs::read_to_string(path).map_err(|error| Failure::config_about(path.display(), error))
}

#[cfg(test)]
mod tests {
    use wire::StageId;

    use super::*;

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
