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
    edges: Vec<Edge>,
}

/// An arrow from a producer to a consumer.
struct Edge {
    from: String,
    to: String,
    /// The topic, then times and losses.
    lines: Vec<String>,
    /// Whether frames were lost on it.
    is_faulty: bool,
}

impl Edge {
    fn new(from: &str, topic: &str, to: &str) -> Self {
        let [from, to] = [from, to].map(str::to_owned);
        Self { from, to, lines: vec![topic.to_owned()], is_faulty: false }
    }
}

/// The colour of losses.
const RED: &str = "#c2361f";

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
        edges: edges.map(|(from, topic, to)| Edge::new(from.name(), topic, to.name())).collect(),
    }
}

/// The graph of a run, with its partners outside and the time from the stamp to the publication; `None` if the report
/// does not have the topics of the stages.
fn of_report(report: &Report) -> Option<Graph> {
    let mut edges = Vec::new();
    for producer in &report.stages {
        for topic in &producer.writes {
            let reads = report.stages.iter().filter(|stage| stage.reads.contains(topic));
            edges.extend(reads.map(|consumer| Edge::new(&producer.name, topic, &consumer.name)));
        }
    }
    if edges.is_empty() {
        return None;
    }
    let mut stages = Vec::new();
    for (place, stage) in report.stages.iter().enumerate() {
        // The last arrow on the way of a tick into a stage has the times and losses of the stage's input.
        let is_before = |name: &str| report.stages[..place].iter().any(|earlier| earlier.name == name);
        let entry = edges.iter_mut().rfind(|edge| edge.to == stage.name && is_before(&edge.from));
        stages.push((stage.name.clone(), measured_lines(stage, entry.is_some())));
        if let Some(edge) = entry {
            edge.lines.extend(entry_lines(stage));
            edge.is_faulty = lost_before(stage) > 0;
        }
    }
    for stage in &report.stages {
        let Some((_, words)) = PARTNERS.iter().find(|(program, _)| *program == stage.program) else {
            continue;
        };
        let name = format!("{words} of {}", stage.name).replace(' ', "_");
        let counts = report.links.get(&stage.name).into_iter().flatten();
        let is_input = stage.name == StageId::Source.name();
        let mut edge = match is_input {
            true => Edge::new(&name, "in", &stage.name),
            false => Edge::new(&stage.name, "out", &name),
        };
        edge.lines.extend(since_stamp(&stage.since_stamp_ms));
        edges.push(edge);
        stages.push((name, counts.map(|(kind, count)| format!("{count} {kind}")).collect()));
    }
    if let Some(line) = since_stamp(&report.since_stamp_ms) {
        stages.push(("publication".to_owned(), vec![line]));
        edges.push(Edge::new(StageId::Sampler.name(), ForecastsTopic::NAME, "publication"));
    }
    Some(Graph { stages, edges })
}

/// The time since the sensor's stamp, if it was measured.
fn since_stamp(of: &Percentiles) -> Option<String> {
    of.p50.map(|_| format!("{} ms since the stamp", pair(of)))
}

impl Graph {
    fn mermaid(&self) -> String {
        let mut text = String::from("flowchart LR\n");
        for (name, lines) in &self.stages {
            text += &format!("    {name}[\"{}\"]\n", label(name, lines, "<br/>"));
        }
        for Edge { from, to, lines, .. } in &self.edges {
            text += &match &lines[..] {
                [topic] => format!("    {from} -->|{topic}| {to}\n"),
                lines => format!("    {from} -->|\"{}\"| {to}\n", lines.join("<br/>")),
            };
        }
        for (place, _) in self.edges.iter().enumerate().filter(|(_, edge)| edge.is_faulty) {
            text += &format!("    linkStyle {place} stroke:{RED},color:{RED}\n");
        }
        text
    }

    fn dot(&self) -> String {
        let mut text = String::from("digraph stgdat {\n    rankdir = LR;\n    node [shape = box];\n");
        for (name, lines) in &self.stages {
            text += &format!("    {name} [label = \"{}\"];\n", label(name, lines, "\\n"));
        }
        for Edge { from, to, lines, is_faulty } in &self.edges {
            let color = if *is_faulty {
                format!(", color = \"{RED}\", fontcolor = \"{RED}\"")
            } else {
                String::new()
            };
            text += &format!("    {from} -> {to} [label = \"{}\"{color}];\n", lines.join("\\n"));
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

/// Frames that did not arrive at a stage, or that it refused.
const fn lost_before(stage: &StageReport) -> u64 {
    stage.drops.gap + stage.drops.refused
}

fn count(count: u64, what: &str) -> Option<String> {
    (count > 0).then(|| format!("{count} {what}"))
}

/// Median and 99th percentile of a stage's waiting and of its wake-up, and the losses before it.
fn entry_lines(stage: &StageReport) -> Vec<String> {
    let is_measured = stage.compute_ms.p50.is_some();
    let times = [("waiting", &stage.waiting_ms), ("wake-up", &stage.wake_up_ms)];
    let times = times.map(|(name, of)| is_measured.then(|| format!("{name} {}", pair(of))));
    times.into_iter().chain([count(lost_before(stage), "lost")]).flatten().collect()
}

/// Median and 99th percentile of the compute against the budget, and faults. Losses before a stage without an arrow
/// are among them.
fn measured_lines(stage: &StageReport, has_entry: bool) -> Vec<String> {
    let budget = stage.budget_ms.map_or(String::new(), |budget_ms| format!(" of {budget_ms}"));
    let lost = stage.drops.restart + if has_entry { 0 } else { lost_before(stage) };
    let lines = [
        stage.compute_ms.p50.map(|_| format!("{}{budget} ms", pair(&stage.compute_ms))),
        (stage.compute_ms.p50.is_none() && !stage.program.is_empty()).then(|| stage.program.clone()),
        count(stage.restarts.into(), "restarts"),
        count(lost, "lost"),
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
        report.stages = vec![
            stage("source", "", "detections"),
            stage("tracker", "detections", "tracks"),
            stage("sampler", "tracks", "forecasts"),
        ];
        report.stages[1].reads.push("forecasts".into());
        report.stages[1].restarts = 2;
        report.stages[1].drops.restart = 4;
        let text = of_report(&report).unwrap().mermaid();
        let label = "tracker<br/>1.00 / 7.25 of 6 ms<br/>2 restarts<br/>4 lost\"]";
        assert!(text.contains(label) && !text.contains("linkStyle"), "{text}");
        // Waiting, wake-up and losses are at the last arrow of the tick's way, which is red.
        report.stages[1].drops.gap = 3;
        let arrow = "    source -->|\"detections<br/>waiting - / -<br/>wake-up - / -<br/>3 lost\"| tracker\n";
        let graph = of_report(&report).unwrap();
        let text = graph.mermaid();
        for part in
            [arrow, "    sampler -->|forecasts| tracker\n", "    linkStyle 0 stroke:#c2361f,color:#c2361f\n"]
        {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert_eq!(text.matches("linkStyle").count(), 1, "{text}");
        assert!(graph.dot().contains("\\n3 lost\", color = \"#c2361f\", fontcolor = \"#c2361f\"];\n"));
        // Detections from another box, forecasts to ROS.
        report.stages[0].program = "stgdat-bridge".into();
        report.links = [("source".to_owned(), [("frames".to_owned(), 12)].into())].into();
        let times = |p50, p99| Percentiles { p50: Some(p50), p99: Some(p99), ..Percentiles::default() };
        report.stages.push(StageReport {
            program: "stgdat-ros2".into(),
            budget_ms: None,
            compute_ms: Percentiles::default(),
            since_stamp_ms: times(21.0, 33.0),
            ..stage("ros2", "tracks", "")
        });
        report.since_stamp_ms = times(20.0, 31.5);
        let text = of_report(&report).unwrap().mermaid();
        for part in [
            "other_box_of_source[\"other_box_of_source<br/>12 frames\"]",
            "other_box_of_source -->|in| source",
            "ros2[\"ros2<br/>stgdat-ros2\"]",
            "tracker -->|tracks| ros2",
            "ros2 -->|\"out<br/>21.00 / 33.00 ms since the stamp\"| ROS_2_of_ros2",
            "publication[\"publication<br/>20.00 / 31.50 ms since the stamp\"]",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
    }
}
