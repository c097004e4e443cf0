use std::path::PathBuf;

use clap::{Args, ValueEnum};
use configuration::{Pipeline, Stage, pipeline_file};
use console::failure::Failure;
use console::show::show;
use recorder::report::{Percentiles, StageReport};
use recorder::{PARTNERS, Report};
use run::Exit;
use telemetry::top::Client;
use wire::{ForecastsTopic, StageId, Topic as _};

use crate::runs;

/// Arguments of `stgdat graph`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The pipeline.toml; by default the built-in one
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// The same, as `run` takes it
    #[arg(long, value_name = "FILE", conflicts_with = "file")]
    pipeline: Option<PathBuf>,
    /// Draw a run with its times, losses and restarts. The file is a report (`run --report`); without it, the
    /// running pipeline is drawn
    #[arg(long, value_name = "REPORT", num_args = 0..=1, conflicts_with_all = ["file", "pipeline"])]
    run: Option<Option<PathBuf>>,
    /// Language of the graph
    #[arg(long, value_enum, default_value = "mermaid")]
    format: Format,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Format {
    Mermaid,
    Dot,
}

/// The boxes and arrows of a graph.
struct Graph {
    /// Name and lines of each stage.
    stages: Vec<(String, Vec<String>)>,
    /// Producer, topic and consumer.
    edges: Vec<(String, String, String)>,
}

/// Prints the graph of a pipeline.toml or of a run.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let graph = match &arguments.run {
        None => {
            let file = arguments.file.as_deref().or(arguments.pipeline.as_deref());
            of_pipeline(&pipeline_file::load(file)?)
        }
        Some(Some(path)) => of_report(&Report::read(path).map_err(Failure::data)?)
            .ok_or_else(|| Failure::file(path, "the report does not have the topics of its stages"))?,
        Some(None) => {
            let run = runs::find(None)?;
            of_report(&Client::new(&run.root).ask()?.report)
                .ok_or_else(|| Failure::unavailable(format!("{}: there is no tick yet", run.name)))?
        }
    };
    show(&match arguments.format {
        Format::Mermaid => graph.mermaid(),
        Format::Dot => graph.dot(),
    })
}

fn of_pipeline(pipeline: &Pipeline) -> Graph {
    let edges = pipeline.edges().into_iter();
    Graph {
        stages: pipeline.stages.iter().map(|stage| (stage.id.name().to_owned(), lines_of(stage))).collect(),
        edges: edges
            .map(|(producer, topic, consumer)| {
                (producer.name().to_owned(), topic.to_owned(), consumer.name().to_owned())
            })
            .collect(),
    }
}

/// The graph of a run, with its partners outside and the time from the stamp to the publication; `None` if the report
/// does not have the topics of the stages.
fn of_report(report: &Report) -> Option<Graph> {
    let mut edges = Vec::new();
    for producer in &report.stages {
        for topic in &producer.writes {
            let reads = report.stages.iter().filter(|stage| stage.reads.contains(topic));
            edges.extend(reads.map(|consumer| (producer.name.clone(), topic.clone(), consumer.name.clone())));
        }
    }
    if edges.is_empty() {
        return None;
    }
    let mut stages: Vec<_> =
        report.stages.iter().map(|stage| (stage.name.clone(), measured_lines(stage))).collect();
    for stage in &report.stages {
        let Some((_, words)) = PARTNERS.iter().find(|(program, _)| *program == stage.program) else {
            continue;
        };
        let (name, own) = (format!("{words} of {}", stage.name).replace(' ', "_"), stage.name.clone());
        let counts = report.links.get(&stage.name).into_iter().flatten();
        stages.push((name.clone(), counts.map(|(kind, count)| format!("{count} {kind}")).collect()));
        edges.push(match stage.name == StageId::Source.name() {
            true => (name, "in".to_owned(), own),
            false => (own, "out".to_owned(), name),
        });
    }
    if report.since_stamp_ms.p50.is_some() {
        let line = format!("{} ms since the stamp", pair(&report.since_stamp_ms));
        stages.push(("publication".to_owned(), vec![line]));
        let (from, to) = (StageId::Sampler.name().to_owned(), "publication".to_owned());
        edges.push((from, ForecastsTopic::NAME.to_owned(), to));
    }
    Some(Graph { stages, edges })
}

impl Graph {
    fn mermaid(&self) -> String {
        let mut text = String::from("flowchart LR\n");
        for (name, lines) in &self.stages {
            text += &format!("    {name}[\"{}\"]\n", label(name, lines, "<br/>"));
        }
        for (producer, topic, consumer) in &self.edges {
            text += &format!("    {producer} -->|{topic}| {consumer}\n");
        }
        text
    }

    fn dot(&self) -> String {
        let mut text = String::from("digraph stgdat {\n    rankdir = LR;\n    node [shape = box];\n");
        for (name, lines) in &self.stages {
            text += &format!("    {name} [label = \"{}\"];\n", label(name, lines, "\\n"));
        }
        for (producer, topic, consumer) in &self.edges {
            text += &format!("    {producer} -> {consumer} [label = \"{topic}\"];\n");
        }
        text + "}\n"
    }
}

fn label(name: &str, lines: &[String], line_break: &str) -> String {
    std::iter::once(name).chain(lines.iter().map(String::as_str)).collect::<Vec<_>>().join(line_break)
}

/// Budget, real-time settings and, if external, program of a stage.
fn lines_of(stage: &Stage) -> Vec<String> {
    let program = stage.command.as_ref().and_then(|command| command.first());
    let lines = [
        stage.budget_ms.map(|budget_ms| format!("{budget_ms} ms")),
        stage.scheduling.priority.map(|priority| format!("priority {priority}")),
        stage.scheduling.cpu_list().map(|cpus| format!("cpu {cpus}")),
        program.map(|program| program.replace(['"', '\\'], "'")),
    ];
    lines.into_iter().flatten().collect()
}

fn pair(of: &Percentiles) -> String {
    let number = |value_ms: Option<f64>| value_ms.map_or("-".to_owned(), |value_ms| format!("{value_ms:.2}"));
    format!("{} / {}", number(of.p50), number(of.p99))
}

/// Median and 99th percentile of the compute against the budget, of the waiting and of the wake-up, and faults.
fn measured_lines(stage: &StageReport) -> Vec<String> {
    if stage.ticks == 0 && !stage.program.is_empty() {
        return vec![stage.program.clone()];
    }
    let budget = stage.budget_ms.map_or(String::new(), |budget_ms| format!(" of {budget_ms}"));
    let count = |count: u64, what: &str| (count > 0).then(|| format!("{count} {what}"));
    let lines = [
        Some(format!("{}{budget} ms", pair(&stage.compute_ms))),
        Some(format!("waiting {}", pair(&stage.waiting_ms))),
        Some(format!("wake-up {}", pair(&stage.wake_up_ms))),
        count(stage.drops.total(), "lost"),
        count(stage.restarts.into(), "restarts"),
    ];
    lines.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_stage_and_connection_is_drawn() {
        let pipeline = pipeline_file::load(None).unwrap();
        let graph = of_pipeline(&pipeline);
        for text in [graph.mermaid(), graph.dot()] {
            assert!(pipeline.stages.iter().all(|stage| text.contains(stage.id.name())), "{text}");
            assert_eq!(text.matches("->").count(), pipeline.edges().len(), "{text}");
        }
        assert!(graph.mermaid().contains("sampler -->|forecasts| tracker\n"));
        assert!(graph.dot().contains("sampler -> tracker [label = \"forecasts\"];\n"));
        let text = format!("[realtime]\npriority = 9\ncpu = [1]\n{}", pipeline_file::SHIPPED);
        let pipeline = Pipeline::parse("p.toml", &text, &configuration::stages::declared()).unwrap();
        let mermaid = of_pipeline(&pipeline).mermaid();
        assert!(mermaid.contains("tracker<br/>6 ms<br/>priority 10<br/>cpu 1\"]"));
        assert!(mermaid.contains("recorder[\"recorder\"]"), "not on a tick's way");
    }

    #[test]
    fn a_run_is_drawn_with_its_times_and_faults() {
        let stage = |name: &str, reads: &str, writes: &str| StageReport {
            name: name.into(),
            reads: vec![reads.into()],
            writes: vec![writes.into()],
            compute_ms: Percentiles { p50: Some(1.0), p99: Some(7.25), ..Percentiles::default() },
            budget_ms: Some(6.0),
            ..StageReport::default()
        };
        let mut report = Report::default();
        assert!(of_report(&report).is_none());
        report.stages = vec![stage("source", "", "detections"), stage("tracker", "detections", "tracks")];
        report.stages[1].restarts = 2;
        let text = of_report(&report).unwrap().mermaid();
        assert!(text.contains("    source -->|detections| tracker\n"), "{text}");
        let label = "tracker<br/>1.00 / 7.25 of 6 ms<br/>waiting - / -<br/>wake-up - / -<br/>2 restarts\"]";
        assert!(text.contains(label) && !text.contains("lost"), "{text}");
        // Detections from another box, forecasts to ROS.
        report.stages[0].program = "stgdat-bridge".into();
        report.links = [("source".to_owned(), [("frames".to_owned(), 12)].into())].into();
        report.stages.push(StageReport {
            program: "stgdat-ros2".into(),
            budget_ms: None,
            ..stage("ros2", "tracks", "")
        });
        report.since_stamp_ms = Percentiles { p50: Some(20.0), p99: Some(31.5), ..Percentiles::default() };
        let text = of_report(&report).unwrap().mermaid();
        for part in [
            "other_box_of_source[\"other_box_of_source<br/>12 frames\"]",
            "other_box_of_source -->|in| source",
            "ros2[\"ros2<br/>stgdat-ros2\"]",
            "ros2 -->|out| ROS_2_of_ros2",
            "publication[\"publication<br/>20.00 / 31.50 ms since the stamp\"]",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
    }
}
