mod arguments;
mod chain;
mod cost;
mod handover;
mod jitter;
mod modes;
mod percentile;
mod pipe;
mod stages;
mod work;

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use configuration::options::{Setting, StageOptions};
use console::failure::Failure;
use console::program::this_program;
use console::show::show;
use console::tables;
use nn::kernels;
use run::{Exit, Run};
use wire::StageId;

use crate::fail_if;
use crate::version;

pub use arguments::Arguments;
pub use percentile::percentile;

/// Duration of each peak measurement.
const PEAK_TIME: Duration = Duration::from_millis(400);

/// Measures compute per stage, the overhead of the pipeline and this machine's peaks in one run, or only the
/// requested part.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    if (arguments.jitter || !arguments.fail_if.is_empty()) && arguments.seconds == 0 {
        return Err(Failure::Usage(
            "--fail-if and --jitter are about the run of --seconds, which is 0".to_owned(),
        ));
    }
    let mut report = None;
    let (mark, text) = if arguments.cost {
        ("bench cost", cost::table(arguments)?)
    } else if arguments.jitter {
        ("bench jitter", jitter::table(arguments)?)
    } else {
        let mut text = speed(arguments)?;
        if arguments.seconds > 0 {
            let (run, measured) = chain::table(arguments)?;
            text += &run;
            report = Some(measured);
        }
        ("bench", text)
    };
    let heading = machine(&arguments.set.set)?;
    show(&format!("### {heading}\n\n{text}"))?;
    if let Some(path) = &arguments.table {
        tables::replace_section(path, mark, &heading, &text)?;
    }
    report.map_or(Ok(()), |report| fail_if::check(&arguments.fail_if, &report))?;
    Ok(Exit::Done)
}

/// Returns a command that runs the pipeline and writes its report.
fn pipeline_run(arguments: &Arguments, agents: u16, ticks: u64, report: &Path) -> Command {
    let mut command = Command::new(this_program());
    command.args(["run", "--quiet", "--agents", &agents.to_string(), "--ticks", &ticks.to_string()]);
    command.arg("--report").arg(report);
    if let Some(weights) = &arguments.model.weights {
        command.arg("--weights").arg(weights);
    }
    command.args(arguments.set.set.iter().flat_map(Setting::arguments));
    command.stdin(Stdio::null()).stdout(Stdio::null());
    command
}

/// Measures peaks, compute per stage and the hand-over to workers.
fn speed(arguments: &Arguments) -> Result<String, Failure> {
    let peak = kernels::peak::product_gflops(PEAK_TIME);
    let mut text = format!(
        "Matrix product {peak:.0} GFLOP/s and multiply-adds in registers {:.0} GFLOP/s on one thread.\n\n",
        kernels::peak::fma_gflops(PEAK_TIME),
    );
    text += &stages::table(arguments, peak)?;
    text += &handover::line()?.unwrap_or_default();
    Ok(text)
}

/// Describes the machine as a heading: the processor, its cores, the kernels, and the precision unless it is
/// f32.
///
/// # Errors
/// [`Failure`] if a setting can't be used.
pub fn machine(set: &[Setting]) -> Result<String, Failure> {
    let mut options = StageOptions::defaults(&[StageId::Decoder]);
    let of_decoder = set.iter().filter(|set| set.is_of(StageId::Decoder, "precision"));
    options.apply(&of_decoder.cloned().collect::<Vec<_>>())?;
    let kernels = version::kernels(&Run { stages: options.stage_runs(), ..Run::default() });
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let cpus = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = processor(&cpus).unwrap_or("unknown processor").to_owned();
    Ok(format!("{model}, {cores} cores, {kernels}"))
}

/// Finds the processor's name in /proc/cpuinfo. Arm processors have no name there.
fn processor(cpus: &str) -> Option<&str> {
    let named = |line: &'_ str| line.starts_with("model name");
    let line = cpus.lines().find(|line| named(line))?;
    line.split_once(':').map(|(_, name)| name.trim())
}
