mod files;
mod realtime;

use std::fmt::Display;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use clap::Args;
use console::failure::Failure;
use console::say;
use nn::Precision;
use nn::kernels::{self, Isa};
use run::Exit;
use rustix::process::{Resource, Rlimit, getrlimit};
use rustix::thread::{CapabilitySet, capabilities};

use crate::awake;
use crate::prediction::{self, LIMIT_MS, Prediction};
use crate::verbs::run::SHARED_BYTES;

/// Number of open files below which the transport may fail.
const FILES: u64 = 1024;

/// Arguments of `stgdat doctor`.
#[derive(Debug, Args)]
pub struct Arguments {
    /// Also check whether this many agents fit this machine
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=wire::AGENTS_MAX as i64))]
    agents: Option<u32>,
    /// Check the settings of the kernel that delay a tick instead, and print the command of each change
    #[arg(long, conflicts_with = "agents")]
    realtime: bool,
}

/// One check of the machine.
struct Finding {
    what: &'static str,
    found: String,
    /// The advice, if something is wrong.
    advice: Option<String>,
    /// Whether a run works without it.
    is_optional: bool,
}

/// Checks this machine's support for a run, and advises if something is missing.
pub fn execute(arguments: &Arguments) -> Result<Exit, Failure> {
    if arguments.realtime {
        return realtime::execute();
    }
    let findings = [
        shared_memory(),
        rights(),
        leftovers(),
        files(),
        locked_memory(),
        cores(),
        instruction_set(),
        precision(),
        real_time(),
        idle_states(),
        weights(),
    ];
    let slow = speed(arguments.agents)?;
    let mut well = true;
    for Finding { what, found, advice, is_optional } in findings {
        well &= advice.is_none() || is_optional;
        let mark = match advice {
            None => "ok  ",
            Some(_) if is_optional => "warn",
            Some(_) => "fix ",
        };
        say!("{mark} {what:<16} {found}");
        if let Some(advice) = advice {
            say!("     {:<16} {advice}", "");
        }
    }
    // A busy machine lacks nothing, because a run continues with degraded quality.
    say!("{} {:<16} {}", if slow.advice.is_none() { "ok  " } else { "slow" }, slow.what, slow.found);
    if let Some(advice) = slow.advice {
        say!("     {:<16} {advice}", "");
    }
    if well {
        Ok(Exit::Done)
    } else {
        Err(Failure::unavailable("this machine lacks what a run needs, see above"))
    }
}

fn finding(what: &'static str, found: impl Display, advice: Option<String>) -> Finding {
    Finding { what, found: found.to_string(), advice, is_optional: false }
}

fn shared_memory() -> Finding {
    match ports::shared_memory_free() {
        Ok(free) => {
            let advice = (free < SHARED_BYTES).then(|| {
                format!(
                    "a run needs {} MiB: docker run --shm-size=1g, mount -o remount,size=1G",
                    SHARED_BYTES >> 20
                )
            });
            finding("shared memory", format!("{} MiB free", free >> 20), advice)
        }
        Err(error) => finding("shared memory", error, Some("mount a tmpfs on /dev/shm".into())),
    }
}

fn rights() -> Finding {
    let path = Path::new("/dev/shm");
    let mode = std::fs::metadata(path).map_or(0, |metadata| metadata.permissions().mode() & 0o7777);
    let writable = rustix::fs::access(path, rustix::fs::Access::WRITE_OK).is_ok();
    let advice = (!writable).then(|| format!("this user can't write there: chmod 1777 {}", path.display()));
    finding("rights", format!("{} has mode {mode:o}", path.display()), advice)
}

fn leftovers() -> Finding {
    match ports::leftovers() {
        Ok(leftovers) => {
            let bytes: u64 = leftovers.iter().map(|leftover| leftover.bytes).sum();
            let found = format!("{} dead runs, {} MiB", leftovers.len(), bytes >> 20);
            let advice = (!leftovers.is_empty()).then(|| "stgdat clean removes them".into());
            // A run with too little shared memory is refused by its own check.
            Finding { is_optional: true, ..finding("leftovers", found, advice) }
        }
        Err(error) => finding("leftovers", error, Some("can't be listed".into())),
    }
}

fn files() -> Finding {
    let Rlimit { current, .. } = getrlimit(Resource::Nofile);
    let advice = current.is_some_and(|n| n < FILES).then(|| format!("ulimit -n {FILES}"));
    finding("open files", limit(current), advice)
}

fn locked_memory() -> Finding {
    // For information; a run does not need locked memory.
    let found = match getrlimit(Resource::Memlock).current {
        _ if may(CapabilitySet::IPC_LOCK) => {
            "no limit for this user: all memory of the stages is locked".to_owned()
        }
        None => "no limit: all memory of the stages is locked".to_owned(),
        Some(bytes) => format!(
            "{} KiB a process: of the stages' memory what fits is locked, what ticks use most first (ulimit -l)",
            bytes >> 10
        ),
    };
    finding("locked memory", found, None)
}

/// Whether this process has a privilege.
fn may(capability: CapabilitySet) -> bool {
    capabilities(None).is_ok_and(|sets| sets.effective.contains(capability))
}

fn real_time() -> Finding {
    // For information; only a pipeline.toml with `priority` needs it.
    let found = match getrlimit(Resource::Rtprio).current {
        _ if may(CapabilitySet::SYS_NICE) => "any `priority` of a stage is allowed".to_owned(),
        None => "any `priority` of a stage is allowed".to_owned(),
        Some(0) => "no `priority` of a stage is allowed (CAP_SYS_NICE or ulimit -r)".to_owned(),
        Some(most) => format!("a `priority` of a stage up to {most} is allowed (ulimit -r)"),
    };
    finding("real time", found, None)
}

fn idle_states() -> Finding {
    // For information; only a pipeline.toml with `awake` needs it.
    let may_hold = rustix::fs::access(awake::LATENCY, rustix::fs::Access::WRITE_OK).is_ok();
    let found = if may_hold {
        "`awake = true` keeps the processors from sleeping between ticks".to_owned()
    } else {
        format!("processors may sleep between ticks: `awake` needs write access to {}", awake::LATENCY)
    };
    finding("idle states", found, None)
}

/// Checks whether the default demo and the requested number of agents fit. The prediction comes from a
/// measurement of this machine under its current load.
fn speed(asked: Option<u32>) -> Result<Finding, Failure> {
    let machine = Prediction::measure()?;
    let numbers = [Some(prediction::AGENTS), asked.filter(|&agents| agents != prediction::AGENTS)];
    let numbers: Vec<u32> = numbers.into_iter().flatten().collect();
    let ticks = numbers.iter().map(|&agents| {
        let [p50, p99] = machine.tick_ms(agents);
        let fits = if machine.fits(agents) { "fit" } else { "do not fit" };
        format!("{agents} agents {fits}: about {p50:.0} ms a tick, {p99:.0} at p99, of {LIMIT_MS:.0}")
    });
    let most = machine.agents_max();
    let found = format!("{}; at most {most} fit", ticks.collect::<Vec<_>>().join("; "));
    let advice = numbers.iter().any(|&agents| !machine.fits(agents)).then(|| {
        format!(
            "run fewer agents (--agents {}), close what else computes, or give the stages more cores; `stgdat bench \
             --agents {}` measures it",
            most.max(1),
            numbers[numbers.len() - 1]
        )
    });
    Ok(finding("speed", found, advice))
}

fn limit(current: Option<u64>) -> String {
    current.map_or("no limit".into(), |n| n.to_string())
}

fn cores() -> Finding {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    finding(
        "cores",
        cores,
        (cores < 2).then(|| "the stages will wait for one another: use at least 2".into()),
    )
}

fn instruction_set() -> Finding {
    let (active, available) = (kernels::active(), Isa::available_names());
    let why = match kernels::forced() {
        Some(_) => format!("as --kernels or {} says; this CPU has {available}", kernels::VARIABLE),
        None => format!("the fastest of this CPU, which has {available}"),
    };
    finding("kernels", format!("{active} ({why})"), None)
}

/// Checks whether the decoder can compute in bf16.
fn precision() -> Finding {
    let found = match Precision::Bf16.check() {
        Ok(()) => {
            "f32, or bf16 in the decoder (decoder.precision=bf16), for two thirds of its time".to_owned()
        }
        Err(why) => format!("f32 alone; {why}"),
    };
    finding("precision", found, None)
}

fn weights() -> Finding {
    let weights = nn::Weights::onboard();
    finding("weights", format!("onboard, SHA-256 {}", weights.sha256()), None)
}
