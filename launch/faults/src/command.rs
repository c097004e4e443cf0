use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use console::failure::Failure;
use console::show::show;
use console::tables;
use run::Exit;
use wire::StageId;

use crate::runner::{Options, Verdict};
use crate::spec::Spec;
use crate::table::{self, Row, Series};
use crate::{checker, follow, inject, output, runner, scenarios};

/// The verbs of `stgdat fault`, with their arguments.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Run pipelines with injected faults and check the expectations
    Run(RunArguments),
    /// List the specifications of a folder, by default the built-in scenarios
    List(ListArguments),
    /// Check specifications without running them
    Check(CheckArguments),
    /// Measure the cost of killing and stopping each stage, as a table
    Table(TableArguments),
    /// Check the guarantees of a run in a history written by `fault run --keep`
    Verify(VerifyArguments),
    /// Write the history of a run (started by `fault run`)
    #[command(hide = true)]
    Follow(FollowArguments),
    /// Inject faults between a topic's writer and its readers (started by `fault run`)
    #[command(hide = true)]
    Inject(InjectArguments),
    /// Read a topic and give its frames back late or never (started by `fault run`)
    #[command(hide = true)]
    Consume(ConsumeArguments),
}

/// Arguments of `stgdat fault run`.
#[derive(Debug, Args)]
pub struct RunArguments {
    /// Specifications, folders of them, or names of built-in scenarios
    #[arg(value_name = "SPEC", required = true)]
    specs: Vec<PathBuf>,
    /// Seed of the scene and of all faults, instead of the specification's seeds
    #[arg(long)]
    seed: Option<u64>,
    /// Number of runs of each specification; each run increments the seed
    #[arg(long, value_name = "N", default_value_t = 1)]
    repeat: u64,
    /// Check causes and counts, but not numbers of ticks: for busy machines
    #[arg(long)]
    no_timing: bool,
    /// Keep log, report, forecasts and history of all runs in this folder; by default only failed runs are
    /// kept, in the temporary folder
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
    /// Write the verdicts as JUnit's XML
    #[arg(long, value_name = "FILE")]
    junit: Option<PathBuf>,
    /// Write the verdicts as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Arguments of `stgdat fault list`.
#[derive(Debug, Args)]
pub struct ListArguments {
    /// The folder
    #[arg(value_name = "DIR")]
    folder: Option<PathBuf>,
}

/// Arguments of `stgdat fault check`.
#[derive(Debug, Args)]
pub struct CheckArguments {
    /// Specifications, folders of them, or names of built-in scenarios
    #[arg(value_name = "SPEC", required = true)]
    specs: Vec<PathBuf>,
}

/// Arguments of `stgdat fault table`.
#[derive(Debug, Args)]
pub struct TableArguments {
    /// Stage to measure; by default all
    #[arg(long = "stage", value_name = "STAGE", value_parser = stage)]
    stages: Vec<StageId>,
    /// Number of kills of each stage at each point of its step, and of stops of each duration
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..=100))]
    turns: u64,
    /// Seed of the scene and of the moments
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Agents of the scene
    #[arg(long, value_name = "N", default_value_t = 8)]
    agents: u64,
    /// Markdown file whose marks `stgdat fault table` get the table
    #[arg(long, value_name = "FILE")]
    table: Option<PathBuf>,
    /// Write the rows as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Arguments of `stgdat fault verify`.
#[derive(Debug, Args)]
pub struct VerifyArguments {
    /// The history
    #[arg(value_name = "HISTORY")]
    history: PathBuf,
}

fn stage(name: &str) -> Result<StageId, String> {
    StageId::from_name(name).ok_or_else(|| format!("one of {}", StageId::ALL.map(StageId::name).join(", ")))
}

/// Arguments of `stgdat fault follow`.
#[derive(Debug, Args)]
pub struct FollowArguments {
    /// The run's record
    #[arg(long)]
    run: PathBuf,
}

/// Arguments of `stgdat fault inject`.
#[derive(Debug, Args)]
pub struct InjectArguments {
    /// The run's record
    #[arg(long)]
    run: PathBuf,
    /// The faults of one topic as JSON
    #[arg(long)]
    plan: PathBuf,
}

/// Arguments of `stgdat fault consume`.
#[derive(Debug, Args)]
pub struct ConsumeArguments {
    /// The topic
    topic: String,
    /// Time for which a frame is held; for ever if not given
    #[arg(long)]
    hold_ms: Option<u64>,
    /// The run's record
    #[arg(long)]
    run: PathBuf,
}

impl Verb {
    /// Executes the verb.
    pub fn execute(self) -> Result<Exit, Failure> {
        match self {
            Self::Run(arguments) => run_all(&arguments),
            Self::List(arguments) => list(&arguments),
            Self::Check(arguments) => check(&arguments),
            Self::Table(arguments) => measure(&arguments),
            Self::Verify(VerifyArguments { history }) => verify(&history),
            Self::Follow(FollowArguments { run }) => follow::follow(&run),
            Self::Inject(InjectArguments { run, plan }) => inject::inject(&run, &plan),
            Self::Consume(ConsumeArguments { topic, hold_ms, run }) => inject::consume(&run, &topic, hold_ms),
        }
    }
}

fn run_all(arguments: &RunArguments) -> Result<Exit, Failure> {
    let specs = scenarios::find_all(&arguments.specs)?;
    let mut verdicts: Vec<Verdict> = Vec::new();
    for spec in &specs {
        for turn in 0..arguments.repeat {
            let first = arguments.seed.or((arguments.repeat > 1).then_some(spec.run.seed));
            let seed = first.map(|first| first + turn);
            let options = Options { timing: !arguments.no_timing, seed, keep: arguments.keep.clone() };
            let verdict = runner::run(spec, &options)?;
            show(&output::table(&verdict))?;
            verdicts.push(verdict);
        }
    }
    let failed: Vec<&str> = verdicts.iter().filter(|v| !v.passed).map(|v| v.name.as_str()).collect();
    show(&format!("{} of {} passed\n", verdicts.len() - failed.len(), verdicts.len()))?;
    if let Some(path) = &arguments.junit {
        write(path, &output::junit(&verdicts))?;
    }
    if let Some(path) = &arguments.json {
        write(path, &(serde_json::to_string_pretty(&verdicts).map_err(Failure::data)? + "\n"))?;
    }
    Ok(if failed.is_empty() { Exit::Done } else { Exit::Failed })
}

fn measure(arguments: &TableArguments) -> Result<Exit, Failure> {
    let TableArguments { turns, seed, agents, .. } = *arguments;
    let stages = if arguments.stages.is_empty() { StageId::ALL.to_vec() } else { arguments.stages.clone() };
    let load_before = table::load_average();
    let mut rows = Vec::new();
    let head = tables::head(&table::COLUMNS);
    show(&head)?;
    for stage in stages {
        for series in [Series::Kills, Series::Stops] {
            let measured = table::measure(&table::Plan { stage, series, turns, seed, agents })?;
            show(&measured.iter().map(Row::line).collect::<String>())?;
            rows.extend(measured);
        }
    }
    if let Some(path) = &arguments.json {
        write(path, &(serde_json::to_string_pretty(&rows).map_err(Failure::data)? + "\n"))?;
    }
    if let Some(path) = &arguments.table {
        let conditions = format!(
            "{turns} turns of each, seed {seed}, {agents} agents at 12.5 Hz, {} processors, load average {load_before} \
             before and {} after.\n\n",
            std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            table::load_average(),
        );
        let lines: String = rows.iter().map(Row::line).collect();
        tables::replace(path, "fault table", &(conditions + &head + &lines))?;
    }
    Ok(Exit::Done)
}

fn verify(path: &Path) -> Result<Exit, Failure> {
    let findings = checker::check(&checker::read(path).map_err(Failure::data)?);
    let mut is_kept = true;
    for checker::Finding { promise, count, first } in findings {
        is_kept &= count == 0;
        let first = if count == 0 { String::new() } else { format!(", first {first}") };
        show(&format!("{count:6}  {}{first}\n", promise.name()))?;
    }
    Ok(if is_kept { Exit::Done } else { Exit::Failed })
}

fn write(path: &Path, text: &str) -> Result<(), Failure> {
    std::fs::write(path, text).map_err(|error| Failure::output(path, error))
}

fn list(arguments: &ListArguments) -> Result<Exit, Failure> {
    let specs = match &arguments.folder {
        Some(folder) => scenarios::find_all(std::slice::from_ref(folder))?,
        None => scenarios::built_in()?,
    };
    let width = specs.iter().map(|spec| spec.name.chars().count()).max().unwrap_or(0);
    let lines = specs.iter().map(|Spec { name, shows, .. }| format!("{name:width$}  {shows}\n"));
    show(&lines.collect::<String>())
}

fn check(arguments: &CheckArguments) -> Result<Exit, Failure> {
    for spec in scenarios::find_all(&arguments.specs)? {
        let (path, faults, ticks) = (spec.path.display(), spec.faults.count, spec.run.ticks);
        show(&format!("{path}: ok, {faults} faults in {ticks} ticks\n"))?;
    }
    Ok(Exit::Done)
}
