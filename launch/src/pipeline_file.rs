use std::path::Path;

use config::Pipeline;

use crate::failure::Failure;

/// The pipeline that runs where none is named.
const SHIPPED: &str = include_str!("../pipeline.toml");

/// Reads and checks a pipeline.toml, or the shipped one.
pub fn load(path: Option<&Path>) -> Result<Pipeline, Failure> {
    let Some(path) = path else { return Ok(Pipeline::parse("pipeline.toml", SHIPPED)?) };
    let text = std::fs::read_to_string(path)
        .map_err(|error| Failure::Config(format!("{}: {error}", path.display())))?;
    Ok(Pipeline::parse(&path.display().to_string(), &text)?)
}
