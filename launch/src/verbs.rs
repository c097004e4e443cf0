//! The verbs of `stgdat`, one module each.

pub mod bench;
pub mod check;
pub mod clean;
pub mod completions;
pub mod diff;
pub mod doctor;
pub mod export;
pub mod graph;
pub mod health;
pub mod inspect;
pub mod lab;
pub mod mark;
pub mod predict;
pub mod record;
pub mod replay;
pub mod report;
pub mod run;
pub mod stage;
pub mod sweep;
pub mod tap;
pub mod tick;
pub mod top;
pub mod trace;
pub mod track;
pub mod verify;
pub mod view;
pub mod wire;

use std::path::Path;

use ::run::Exit;
use clap::error::{ContextKind, ContextValue};
use clap::{Command, Subcommand};

use console::failure::Failure;

/// A verb with its arguments.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Start the pipeline, play a recording or a generated scene, and report
    Run(Box<run::Arguments>),
    /// Run a recording through all stages in one process; write forecasts as JSON lines
    Predict(predict::Arguments),
    /// Run a recording through the tracker in one process; write tracks as CSV, KITTI or MOT results
    Track(track::Arguments),
    /// Audit a recording: rates, agents, speeds and probable errors; draw it
    Inspect(inspect::Arguments),
    /// Run one stage of a run (started by `run`)
    Stage(stage::Arguments),
    /// Check a pipeline.toml
    Check(check::Arguments),
    /// Print the graph of stages and topics
    Graph(graph::Arguments),
    /// Recompute golden vectors on this machine and compare them, one row per tensor
    Verify(verify::Arguments),
    /// Measure compute per stage and the overhead of the pipeline
    Bench(bench::Arguments),
    /// Record a running pipeline: frames, events and log lines in one MCAP file
    Record(record::Arguments),
    /// Mark this moment in the recordings of a run
    Mark(mark::Arguments),
    /// Run a recorded run through the stages again, and compare the results
    Replay(replay::Arguments),
    /// Compare two recordings of runs: the first number that differs, and how the difference grows
    Diff(diff::Arguments),
    /// Write the messages of a recorded run for other tools: Foxglove, Autoware
    Export(export::Arguments),
    /// Show a running pipeline in the terminal: latency, losses, quality and processes of each stage
    Top(top::Arguments),
    /// Check that a running pipeline is healthy: the exit code is 0 if forecasts arrive and every stage is
    /// alive
    Health(health::Arguments),
    /// Write the report of a run, or of two runs side by side, as one HTML page
    Report(report::Arguments),
    /// Show a running pipeline in a browser: the moving scene, the stages and the quality of forecasts
    View(view::Arguments),
    /// Publish the tracks and forecasts of a running pipeline in ROS 2 (stgdat-ros2)
    #[command(disable_help_flag = true)]
    Ros2(lab::Arguments),
    /// Connect two boxes: send forecasts, receive forecasts or detections (stgdat-bridge)
    #[command(disable_help_flag = true)]
    Bridge(lab::Arguments),
    /// Write the trace of a recorded run for Perfetto
    Trace(trace::Arguments),
    /// Explain one tick of a recorded run: the time of each stage, and the result of each agent
    Tick(tick::Arguments),
    /// Check this machine: shared memory, limits, CPU, leftovers
    Doctor(doctor::Arguments),
    /// Remove files that dead runs left in shared memory
    Clean(clean::Arguments),
    /// Print the payload layouts of the topics for programs in other languages
    Wire(wire::Arguments),
    /// Print completions for a shell
    Completions(completions::Arguments),
    /// Clean up after dead stages of a living run (started by `run`)
    #[command(hide = true)]
    Sweep(sweep::Arguments),
    /// Hand the frames of a run on to its tools (started by `run`)
    #[command(hide = true)]
    Tap(tap::Arguments),
    #[command(flatten)]
    Lab(lab::Verb),
}

/// Returns the failure for a first argument that is neither a verb of `program` nor a file; `None`
/// if it looks like a path.
pub fn mistaken(word: &str, mut program: Command) -> Option<Failure> {
    program.build();
    let is_verb = program.find_subcommand(word).is_some();
    if is_verb || word.starts_with('-') || word.contains(['.', '/']) || Path::new(word).exists() {
        return None;
    }
    // The parser suggests names only if the first argument must be a verb.
    let verbs = Command::new("stgdat").subcommands(program.get_subcommands().cloned());
    let suggested = verbs.try_get_matches_from(["stgdat", word]).err().and_then(|error| {
        match error.get(ContextKind::SuggestedSubcommand) {
            // The most similar name is the last.
            Some(ContextValue::Strings(names)) => names.last().cloned(),
            _ => None,
        }
    });
    let hint = suggested.map_or_else(
        || "`stgdat --help` lists the verbs".to_owned(),
        |name| format!("did you mean `stgdat {name}`?"),
    );
    Some(Failure::Usage(format!("{word}: there is no such verb and no such file; {hint}")))
}

impl Verb {
    /// Executes the verb of the program that `command` describes.
    pub fn execute(self, command: fn() -> Command) -> Result<Exit, Failure> {
        match self {
            Self::Run(arguments) => run::execute(&arguments),
            Self::Predict(arguments) => predict::execute(&arguments),
            Self::Track(arguments) => track::execute(&arguments),
            Self::Inspect(arguments) => inspect::execute(&arguments),
            Self::Stage(arguments) => stage::execute(&arguments),
            Self::Check(arguments) => check::execute(&arguments),
            Self::Graph(arguments) => graph::execute(&arguments),
            Self::Verify(arguments) => verify::execute(&arguments),
            Self::Bench(arguments) => bench::execute(&arguments),
            Self::Record(arguments) => record::execute(&arguments),
            Self::Mark(arguments) => mark::execute(&arguments),
            Self::Replay(arguments) => replay::execute(&arguments),
            Self::Diff(arguments) => diff::execute(&arguments),
            Self::Export(arguments) => export::execute(&arguments),
            Self::Top(arguments) => top::execute(&arguments),
            Self::Health(arguments) => health::execute(&arguments),
            Self::Report(arguments) => report::execute(&arguments),
            Self::View(arguments) => view::execute(&arguments),
            Self::Ros2(arguments) => arguments.execute("stgdat-ros2", " --features ros2"),
            Self::Bridge(arguments) => arguments.execute("stgdat-bridge", ""),
            Self::Trace(arguments) => trace::execute(&arguments),
            Self::Tick(arguments) => tick::execute(&arguments),
            Self::Doctor(arguments) => doctor::execute(&arguments),
            Self::Clean(arguments) => clean::execute(&arguments),
            Self::Wire(arguments) => wire::execute(&arguments),
            Self::Completions(arguments) => completions::execute(&arguments, command()),
            Self::Sweep(arguments) => sweep::execute(&arguments),
            Self::Tap(arguments) => tap::execute(&arguments),
            Self::Lab(verb) => verb.execute(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_misspelt_verb_is_not_taken_for_a_file() {
        let message = |word: &str| mistaken(word, crate::command()).map(|failure| failure.to_string());
        assert!(message("evalute").is_some_and(|text| text.contains("did you mean `stgdat evaluate`?")));
        assert!(message("qqq").is_some_and(|text| text.contains("stgdat --help")));
        for word in ["evaluate", "help", "mine.csv", "./mine", "--agents", "src"] {
            assert_eq!(message(word), None, "{word}");
        }
    }
}
