use std::fmt::Display;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use clap::Args;
use nn::kernels::{self, Isa};
use run::Exit;
use rustix::process::{Resource, Rlimit, getrlimit};

use crate::failure::Failure;

/// Shared memory below which a run of many agents may not fit.
const SHARED_BYTES: u64 = 128 << 20;
/// Open files below which the transport may run out.
const FILES: u64 = 1024;

/// Arguments of `stgdat doctor`.
#[derive(Debug, Args)]
pub struct Arguments {}

/// One check of the machine.
struct Finding {
    what: &'static str,
    found: String,
    /// What to do, where something is wrong.
    advice: Option<String>,
}

/// Checks what a run needs of this machine, and advises where something is missing.
pub fn execute(_: &Arguments) -> Result<Exit, Failure> {
    let findings = [
        shared_memory(),
        rights(),
        leftovers(),
        files(),
        locked_memory(),
        cores(),
        instruction_set(),
        weights(),
    ];
    let mut well = true;
    for Finding { what, found, advice } in findings {
        well &= advice.is_none();
        println!("{} {what:<16} {found}", if advice.is_none() { "ok  " } else { "fix " });
        if let Some(advice) = advice {
            println!("     {:<16} {advice}", "");
        }
    }
    if well {
        Ok(Exit::Done)
    } else {
        Err(Failure::unavailable("this machine lacks what a run needs, see above"))
    }
}

fn finding(what: &'static str, found: impl Display, advice: Option<String>) -> Finding {
    Finding { what, found: found.to_string(), advice }
}

fn shared_memory() -> Finding {
    match ports::shared_memory_free() {
        Ok(free) => {
            let advice = (free < SHARED_BYTES).then(|| {
                format!(
                    "a run may need {} MiB: docker run --shm-size=1g, mount -o remount,size=1G",
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
            finding("leftovers", found, (!leftovers.is_empty()).then(|| "stgdat clean removes them".into()))
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
    // For information: memory is locked only with real-time priority.
    finding("locked memory", limit(getrlimit(Resource::Memlock).current), None)
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

fn weights() -> Finding {
    let weights = nn::Weights::onboard();
    finding("weights", format!("onboard, SHA-256 {}", weights.sha256()), None)
}
