use std::path::PathBuf;

use clap::{Args, ValueEnum};
use configuration::{Pipeline, Stage};
use run::Exit;

use configuration::pipeline_file;
use console::failure::Failure;
use console::show::show;

/// Arguments of `stgdat graph`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The pipeline.toml; by default the built-in one
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// The same, as `run` takes it
    #[arg(long, value_name = "FILE", conflicts_with = "file")]
    pipeline: Option<PathBuf>,
    /// Language of the graph
    #[arg(long, value_enum, default_value = "mermaid")]
    format: Format,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    Mermaid,
    Dot,
}

/// Prints the graph of a pipeline.toml.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let pipeline = pipeline_file::load(arguments.file.as_deref().or(arguments.pipeline.as_deref()))?;
    show(&match arguments.format {
        Format::Mermaid => mermaid(&pipeline),
        Format::Dot => dot(&pipeline),
    })
}

fn mermaid(pipeline: &Pipeline) -> String {
    let mut text = String::from("flowchart LR\n");
    for stage in &pipeline.stages {
        text += &format!("    {}[\"{}\"]\n", stage.id.name(), label(stage, "<br/>"));
    }
    for (producer, topic, consumer) in pipeline.edges() {
        text += &format!("    {} -->|{topic}| {}\n", producer.name(), consumer.name());
    }
    text
}

fn dot(pipeline: &Pipeline) -> String {
    let mut text = String::from("digraph stgdat {\n    rankdir = LR;\n    node [shape = box];\n");
    for stage in &pipeline.stages {
        text += &format!("    {} [label = \"{}\"];\n", stage.id.name(), label(stage, "\\n"));
    }
    for (producer, topic, consumer) in pipeline.edges() {
        text += &format!("    {} -> {} [label = \"{topic}\"];\n", producer.name(), consumer.name());
    }
    text + "}\n"
}

/// Name, budget, real-time settings and, if external, program of a stage.
fn label(stage: &Stage, line_break: &str) -> String {
    let mut label = stage.id.name().to_owned();
    if let Some(budget_ms) = stage.budget_ms {
        label += &format!("{line_break}{budget_ms} ms");
    }
    if let Some(priority) = stage.scheduling.priority {
        label += &format!("{line_break}priority {priority}");
    }
    if let Some(cpus) = stage.scheduling.cpu_list() {
        label += &format!("{line_break}cpu {cpus}");
    }
    if let Some(program) = stage.command.as_ref().and_then(|command| command.first()) {
        label += &format!("{line_break}{}", program.replace(['"', '\\'], "'"));
    }
    label
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_stage_and_connection_is_drawn() {
        let pipeline = pipeline_file::load(None).unwrap();
        for text in [mermaid(&pipeline), dot(&pipeline)] {
            assert!(pipeline.stages.iter().all(|stage| text.contains(stage.id.name())), "{text}");
            assert_eq!(text.matches("->").count(), pipeline.edges().len(), "{text}");
        }
        assert!(mermaid(&pipeline).contains("sampler -->|forecasts| tracker\n"));
        assert!(dot(&pipeline).contains("sampler -> tracker [label = \"forecasts\"];\n"));
        let text = format!("[realtime]\npriority = 9\ncpu = [1]\n{}", pipeline_file::SHIPPED);
        let pipeline = Pipeline::parse("p.toml", &text, &configuration::stages::declared()).unwrap();
        assert!(mermaid(&pipeline).contains("tracker<br/>6 ms<br/>priority 10<br/>cpu 1\"]"));
        assert!(mermaid(&pipeline).contains("recorder[\"recorder\"]"), "not on a tick's way");
    }
}
