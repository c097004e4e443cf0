use std::path::PathBuf;

use clap::Args;
use configuration::{BUDGET_MAX_MS, Pipeline, Realtime};
use console::say;
use run::Exit;
use supervisor::Scheduling;

use configuration::pipeline_file;
use console::failure::Failure;

/// Arguments of `stgdat check`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// The pipeline.toml; by default the built-in one
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// The same, as `run` takes it
    #[arg(long, value_name = "FILE", conflicts_with = "file")]
    pipeline: Option<PathBuf>,
}

/// Checks a pipeline.toml and prints a summary.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    let path = arguments.file.as_deref().or(arguments.pipeline.as_deref());
    let pipeline = pipeline_file::load(path)?;
    pipeline_file::check_here(path)?;
    let own = pipeline.stages.iter().filter(|stage| stage.command.is_some()).count();
    say!(
        "ok: {} stages ({own} external), {} connections, budgets {} of {BUDGET_MAX_MS} ms",
        pipeline.stages.len(),
        pipeline.edges().len(),
        pipeline.budget_ms
    );
    realtime(&pipeline).iter().for_each(|line| say!("{line}"));
    Ok(Exit::Done)
}

/// Describes the real-time settings of a pipeline, one line each.
fn realtime(pipeline: &Pipeline) -> Vec<String> {
    let Realtime { awake, lock, .. } = pipeline.realtime;
    let of = |value: &dyn Fn(&Scheduling) -> Option<String>| {
        let set = pipeline.stages.iter().filter_map(|stage| Some((stage, value(&stage.scheduling)?)));
        let set: Vec<String> = set.map(|(stage, value)| format!("{} {value}", stage.name)).collect();
        (!set.is_empty()).then(|| set.join(", "))
    };
    let lines = [
        ("priorities", of(&|scheduling| scheduling.priority.map(|priority| priority.to_string()))),
        ("processors", of(&Scheduling::cpu_list)),
        ("awake", awake.then(|| "the processors do not sleep between ticks".to_owned())),
        ("memory", lock.then(|| "locked, with the limit raised as far as permitted".to_owned())),
        ("not locked", of(&|scheduling| scheduling.unlocked.then(String::new))),
    ];
    lines.into_iter().filter_map(|(what, set)| Some(format!("{what:<11} {}", set?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_settings_of_real_time_are_listed() {
        let parse = |above: &str| {
            let text = format!("{above}\n{}", pipeline_file::SHIPPED);
            Pipeline::parse("p.toml", &text, &configuration::stages::declared()).unwrap()
        };
        assert!(realtime(&parse("")).is_empty());
        let expected = [
            "priorities  source 30, tracker 31, localiser 32, extractor 33, encoder 34, decoder 35, sampler 36",
            "awake       the processors do not sleep between ticks",
            "memory      locked, with the limit raised as far as permitted",
        ];
        let mut vehicle = parse("[realtime]\nprofile = \"vehicle\"");
        assert_eq!(realtime(&vehicle), expected);
        vehicle.choose_cpus(&[2, 3]);
        assert!(realtime(&vehicle)[1].starts_with("processors  source 2+3, tracker 2+3, "));
    }
}
