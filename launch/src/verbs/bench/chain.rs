//! The whole pipeline as separate processes at 12.5 Hz: latency, overhead and memory.

use std::path::Path;
use std::process::Child;
use std::time::Duration;

use console::failure::Failure;
use console::tables;
use ports::TemporaryFolder;
use recorder::Report;
use rustix::process::Pid;
use supervisor::children;

use super::percentile::percentile;
use super::{Arguments, pipe, pipeline_run};

/// Number of ticks in two seconds.
const RATE: u64 = 25;
/// Agents of the scene.
const AGENTS: u16 = 32;
/// Interval between samples of the memory of the processes.
const SAMPLE_INTERVAL: Duration = Duration::from_millis(500);

/// Largest memory observed.
#[derive(Default)]
struct Memory {
    processes: usize,
    resident_kib: u64,
    /// Resident memory with shared pages divided among their processes.
    proportional_kib: u64,
    shared_kib: u64,
}

/// Measures latency, overhead and memory in a real-time run of `seconds`, and a pipe's latency in the same
/// run. Also returns the run's report.
pub(super) fn table(arguments: &Arguments) -> Result<(String, Report), Failure> {
    let unavailable = |error: std::io::Error| Failure::unavailable(error);
    let folder = TemporaryFolder::create("stgdat-bench-").map_err(unavailable)?;
    let report = folder.path().join("report.json");
    let ticks = (arguments.seconds * RATE).div_ceil(2);
    let mut launcher = pipeline_run(arguments, AGENTS, ticks, &report).spawn().map_err(unavailable)?;
    let memory = watch(&mut launcher).map_err(unavailable)?;
    let status = launcher.wait().map_err(unavailable)?;
    if !status.success() {
        return Err(Failure::Failed(format!("stgdat run: {status}")));
    }
    let result = Report::read(&report).map_err(Failure::data)?;
    let mut hops_ms = pipe::hops_ms(100)?;
    let hops = [percentile(&mut hops_ms, 0.5), percentile(&mut hops_ms, 0.99)];
    Ok((text(&result, &memory, hops), result))
}

fn text(report: &Report, memory: &Memory, [hop_p50, hop_p99]: [f64; 2]) -> String {
    let ms = |value: Option<f64>| value.map_or("–".to_owned(), |v| format!("{v:.2}"));
    let mib = |kib: u64| format!("{:.0}", kib as f64 / 1024.0);
    let scene = format!("{AGENTS} agents, 12.5 Hz, {} processes", memory.processes);
    let mut text = "\n".to_owned() + &tables::head(&[&scene, "p50:", "p99:"]);
    let rows = [
        ["end to end, ms".to_owned(), ms(report.end_to_end_ms.p50), ms(report.end_to_end_ms.p99)],
        [
            "overhead (end to end less compute), ms".to_owned(),
            ms(report.overhead_ms.p50),
            ms(report.overhead_ms.p99),
        ],
        ["a pipe's hop in the same run, ms".to_owned(), format!("{hop_p50:.3}"), format!("{hop_p99:.3}")],
    ];
    rows.into_iter().for_each(|cells| text += &tables::row(cells));
    text + &format!(
        "\n{} ticks, {} late. Resident memory of all processes {} MiB ({} MiB with shared pages counted once), files in \
         /dev/shm {} MiB.\n",
        report.ticks,
        report.late_ticks,
        mib(memory.resident_kib),
        mib(memory.proportional_kib),
        mib(memory.shared_kib),
    )
}

/// Samples the memory of the run's processes until it ends.
fn watch(launcher: &mut Child) -> std::io::Result<Memory> {
    let mut most = Memory::default();
    while launcher.try_wait()?.is_none() {
        std::thread::sleep(SAMPLE_INTERVAL);
        let now = sample(Pid::from_child(launcher));
        most.processes = most.processes.max(now.processes);
        most.resident_kib = most.resident_kib.max(now.resident_kib);
        most.proportional_kib = most.proportional_kib.max(now.proportional_kib);
        most.shared_kib = most.shared_kib.max(now.shared_kib);
    }
    Ok(most)
}

/// Returns the current memory of a launcher's stages, and the shared memory that they map. Ended processes
/// count as 0.
fn sample(launcher: Pid) -> Memory {
    let mut memory = Memory::default();
    let mut files = std::collections::BTreeMap::new();
    for pid in children(launcher) {
        let process = Path::new("/proc").join(pid.as_raw_nonzero().to_string());
        let rollup = std::fs::read_to_string(process.join("smaps_rollup")).unwrap_or_default();
        let kib = |key: &str| {
            let line = rollup.lines().find_map(|line| line.strip_prefix(key));
            line.and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok()).unwrap_or(0)
        };
        memory.processes += 1;
        memory.resident_kib += kib("Rss:");
        memory.proportional_kib += kib("Pss:");
        let maps = std::fs::read_to_string(process.join("maps")).unwrap_or_default();
        for file in maps.lines().filter_map(|line| line.find("/dev/shm/").map(|at| line[at..].to_owned())) {
            let blocks =
                std::fs::metadata(&file).map_or(0, |meta| std::os::unix::fs::MetadataExt::blocks(&meta));
            files.insert(file, blocks);
        }
    }
    memory.shared_kib = files.values().sum::<u64>() / 2;
    memory
}
