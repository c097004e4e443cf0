//! A run of many ticks at full speed. The sensor's clock steps, and the log is rotated.
//!
//! `STGDAT_SOAK_TICKS` sets the number of ticks. 3,240,000 are 72 hours at 12.5 Hz.

use std::fs::File;
use std::path::Path;
use std::time::{Duration, Instant};

use recorder::Report;
use rustix::process::Pid;
use testing::Scratch;

use crate::started::{Started, assert_nothing_left, piped, shared_files, stderr, stgdat, wait_for};

/// Ticks without the variable.
const TICKS: u64 = 6_000;
/// Ticks between two steps of the clock: an hour of the scene in a long run.
const STEP_INTERVAL: [u64; 2] = [1_000, 45_000];
/// Ticks for which a step lasts.
const STEP_TICKS: u64 = 10;
/// Steps of the sensor's clock, in turn.
const STEPS_MS: [i64; 4] = [-1_000, 250, -3_600_000, 30_000];
/// Size at which the log is rotated.
const LOG_BYTES_MAX: u64 = 4 << 10;
/// Growth of a process that is not a leak, KiB: the allocator grows in steps of 1 MiB.
const GROWTH_MAX_KIB: u64 = 8 << 10;

/// Growth of the number of files that is not a leak: the recorder's saved state, and files of a reader that
/// joins.
const FILES_GROWTH_MAX: u64 = 4;

/// Resources of a run at one moment.
#[derive(Clone, Copy, Debug, Default)]
struct Sample {
    launcher_kib: u64,
    stages_kib: u64,
    descriptors: u64,
    files: u64,
    shared_kib: u64,
}

#[test]
fn memory_descriptors_and_files_stay_flat() {
    let ticks = std::env::var("STGDAT_SOAK_TICKS").map_or(TICKS, |ticks| ticks.parse().expect("a number"));
    let scratch = Scratch::new("soak");
    let name = "name = \"source\"\n";
    let renamed = format!("{name}topics = {{ detections = \"detections-injected\" }}\n");
    let pipeline = scratch.pipeline("p.toml", name, &renamed);
    let (plan, steps) = plan(ticks);
    let plan = scratch.file("plan.json", plan);
    let [report, announced, log] = ["report.json", "announced", "log"].map(|name| scratch.path(name));
    let ticks_text = ticks.to_string();
    let append =
        |path: &str| File::options().create(true).append(true).open(path).expect("it can be written");

    let scene = ["run", "--quiet", "--agents", "1", "--ticks", &ticks_text, "--speed", "max"];
    let files = ["--pipeline", &pipeline, "--report", &report, "--announce", &announced, "--log", "json"];
    let begun = Instant::now();
    let mut run = Started::spawn(
        stgdat().args(scene).args(files).stdout(append(&scratch.path("out"))).stderr(append(&log)),
    );
    let record = wait_for("the run does not begin", || std::fs::read_to_string(&announced).ok());
    let injected = scratch.path("injected");
    let inject = ["fault", "inject", "--run", &record, "--plan", &plan];
    let injector = Started::spawn(stgdat().args(inject).stdout(append(&injected)).stderr(append(&injected)));

    let root = Path::new(&record).parent().expect("the record is in the run's folder").to_owned();
    let (mut samples, mut rotated) = (Vec::new(), Vec::new());
    while run.is_running() {
        samples.extend(sample(&run, &root));
        rotate(&log, LOG_BYTES_MAX, &mut rotated);
        std::thread::sleep(Duration::from_millis(if samples.len() < 100 { 50 } else { 1_000 }));
    }
    let seconds = begun.elapsed().as_secs_f64();
    let output = run.output();
    rotate(&log, 0, &mut rotated);
    assert!(
        output.status.success(),
        "{:?}: {}",
        output.status,
        String::from_utf8_lossy(&std::fs::read(&log).unwrap())
    );
    drop(injector);
    assert_nothing_left(&root);

    let report = Report::read(report.as_ref()).unwrap();
    let acted = std::fs::read_to_string(&injected).unwrap().matches("clock-jump").count() as u64;
    let [first, last] = ends(&samples);
    println!("{}", table(&report, seconds, steps, rotated.len(), first, last));
    assert_eq!(acted, steps * STEP_TICKS, "the clock has stepped");
    assert_explained(&report, ticks, acted);
    assert_eq!(last.descriptors, first.descriptors, "{first:?} {last:?}");
    assert!(last.files <= first.files + FILES_GROWTH_MAX, "{first:?} {last:?}");
    for (first, last) in [(first.launcher_kib, last.launcher_kib), (first.stages_kib, last.stages_kib)] {
        assert!(last <= first + GROWTH_MAX_KIB, "{first:?} {last:?}");
    }
    assert!(last.shared_kib <= first.shared_kib + GROWTH_MAX_KIB, "{first:?} {last:?}");
    assert!(!rotated.is_empty(), "the steps are logged");
    for line in rotated.iter().flat_map(|text| text.lines()) {
        assert!(
            serde_json::from_str::<serde_json::Value>(line).is_ok(),
            "a rotation broke the line {line:?}"
        );
    }
    let of_a_step = rotated.iter().map(String::len).sum::<usize>() as u64 / steps.max(1);
    assert!(of_a_step < 4 << 10, "the log of a step of the clock has {of_a_step} bytes");
}

/// Clocks at which a number of another width would wrap: seconds since the machine's start.
const UPTIMES_S: [u64; 3] = [(1 << 32) / 1_000, (1 << 53) / 1_000_000_000, 4_600_000_000];

/// A time namespace has its own `CLOCK_MONOTONIC`. Users without the permission to make one skip this.
#[test]
fn forecasts_do_not_depend_on_the_uptime() {
    let scratch = Scratch::new("uptime");
    let forecasts = |name: &str, ahead_s: Option<u64>| {
        let file = scratch.path(name);
        let scene =
            ["run", "--quiet", "--agents", "4", "--ticks", "150", "--speed", "max", "--forecasts", &file];
        let mut command = match ahead_s {
            Some(ahead_s) => {
                let mut command = piped("unshare");
                let [monotonic, boottime] =
                    ["monotonic", "boottime"].map(|clock| format!("--{clock}={ahead_s}"));
                command.args(["--time", "--fork", &monotonic, &boottime, env!("CARGO_BIN_EXE_stgdat")]);
                command
            }
            None => stgdat(),
        };
        let output = Started::spawn(command.args(scene)).output();
        assert!(output.status.success(), "{ahead_s:?}: {}", stderr(&output));
        std::fs::read(&file).unwrap()
    };
    let may_move = piped("unshare").args(["--time", "--fork", "--monotonic=9", "true"]).status();
    if !may_move.is_ok_and(|status| status.success()) {
        return;
    }
    let now_s = ports::monotonic_ns() / 1_000_000_000;
    let expected = forecasts("now", None);
    for uptime_s in UPTIMES_S.into_iter().filter(|&uptime_s| uptime_s > now_s) {
        // The clock passes the number during the run.
        let ahead_s = uptime_s - ports::monotonic_ns() / 1_000_000_000;
        assert!(forecasts(&uptime_s.to_string(), Some(ahead_s)) == expected, "after {uptime_s} s");
    }
}

/// The steps of the clock as the injector reads them, and their number.
fn plan(ticks: u64) -> (String, u64) {
    let [least, most] = STEP_INTERVAL;
    let interval = (ticks / 8).clamp(least, most);
    let starts =
        (1..).map(|i| i * interval).take_while(|start| start + 2 * STEP_TICKS < ticks - interval / 2);
    let steps: Vec<_> = starts
        .zip(STEPS_MS.iter().cycle())
        .map(|(start, jump_ms)| {
            serde_json::json!({
                "topic": "detections", "effect": { "clock-jump": { "jump_ms": jump_ms } },
                "ticks": [start, start + STEP_TICKS - 1], "probability": 1.0, "seed": 1,
            })
        })
        .collect();
    (serde_json::to_string(&steps).expect("it is JSON"), steps.len() as u64)
}

/// Every tick has forecasts, or its stamp was not newer than the stamp of the tick before. Every forecast is
/// learned or has a counted cause.
fn assert_explained(report: &Report, ticks: u64, acted: u64) {
    let refusals = &report.refusals;
    let is_of_order = refusals.iter().all(|of| of.reader == "tracker" && of.cause == "order");
    let refused: u64 = refusals.iter().map(|of| of.frames).sum();
    assert!(is_of_order && refused > 0 && refused <= report.unpublished_ticks, "{refusals:?}");
    let unexplained = ticks - report.ticks - report.unpublished_ticks;
    assert_eq!(unexplained, 0, "the clock was wrong for {acted} ticks: {refusals:?}");
    let forecasts = &report.forecasts;
    let causes: u64 = forecasts.causes.values().sum();
    assert_eq!(causes, forecasts.held + forecasts.kinematic, "unexplained forecasts: {:?}", forecasts.causes);
    let supervision = &report.supervision;
    assert!(supervision.outages.is_empty() && supervision.given_up.is_empty(), "{supervision:?}");
    assert_eq!(report.files_unwritten, 0);
}

/// Measures the processes and files of a run; `None` while it starts or ends.
fn sample(run: &Started, root: &Path) -> Option<Sample> {
    let stages = run.stages();
    let descriptors =
        |pid: Pid| Some(std::fs::read_dir(format!("/proc/{}/fd", pid.as_raw_nonzero())).ok()?.count());
    let pids: Vec<Pid> = stages.iter().map(|(pid, _)| *pid).collect();
    let launcher = run.pid();
    let mut sample = Sample { launcher_kib: resident_kib(launcher)?, ..Sample::default() };
    sample.descriptors = descriptors(launcher)? as u64;
    for pid in &pids {
        sample.stages_kib += resident_kib(*pid)?;
        sample.descriptors += descriptors(*pid)? as u64;
    }
    let shared = shared_files(root);
    let kib = |name: &String| {
        let blocks = std::fs::metadata(Path::new("/dev/shm").join(name))
            .map(|file| std::os::unix::fs::MetadataExt::blocks(&file));
        blocks.unwrap_or(0) / 2
    };
    sample.shared_kib = shared.iter().map(kib).sum();
    sample.files = (shared.len() + std::fs::read_dir(root).ok()?.count()) as u64;
    (pids.len() == 8).then_some(sample)
}

fn resident_kib(pid: Pid) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{}/status", pid.as_raw_nonzero())).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.split_whitespace().next()?.parse().ok()
}

/// The medians of a tenth of the samples, after the first fifth of the run and at its end.
fn ends(samples: &[Sample]) -> [Sample; 2] {
    let tenth = (samples.len() / 10).max(1);
    let median = |part: &[Sample]| {
        let of = |value: fn(&Sample) -> u64| {
            let mut values: Vec<u64> = part.iter().map(value).collect();
            values.sort_unstable();
            values.get(values.len() / 2).copied().unwrap_or(0)
        };
        Sample {
            launcher_kib: of(|sample| sample.launcher_kib),
            stages_kib: of(|sample| sample.stages_kib),
            descriptors: of(|sample| sample.descriptors),
            files: of(|sample| sample.files),
            shared_kib: of(|sample| sample.shared_kib),
        }
    };
    let end = samples.len().saturating_sub(tenth / 2);
    [median(&samples[2 * tenth..3 * tenth]), median(&samples[end.saturating_sub(tenth)..end])]
}

/// Copies the log and truncates it, as `copytruncate` of logrotate does.
fn rotate(log: &str, bytes_max: u64, rotated: &mut Vec<String>) {
    if std::fs::metadata(log).is_ok_and(|file| file.len() > bytes_max) {
        rotated.push(std::fs::read_to_string(log).expect("the log is text"));
        File::options().write(true).open(log).and_then(|file| file.set_len(0)).expect("it can be truncated");
    }
}

fn table(report: &Report, seconds: f64, steps: u64, rotated: usize, first: Sample, last: Sample) -> String {
    let mib = |kib: u64| format!("{:.1}", kib as f64 / 1024.0);
    let rows = [
        ("resident memory of the launcher, MiB", mib(first.launcher_kib), mib(last.launcher_kib)),
        ("resident memory of all stages, MiB", mib(first.stages_kib), mib(last.stages_kib)),
        ("open descriptors", first.descriptors.to_string(), last.descriptors.to_string()),
        ("files of the run", first.files.to_string(), last.files.to_string()),
        ("shared memory, MiB", mib(first.shared_kib), mib(last.shared_kib)),
    ];
    let rows = rows.map(|(what, first, last)| format!("| {what} | {first} | {last} |\n"));
    format!(
        "{} ticks with forecasts and {} unpublished ones in {seconds:.0} s, {steps} steps of the clock, {rotated} \
         rotations of the log.\n\n| | first | last |\n|---|---:|---:|\n{}",
        report.ticks,
        report.unpublished_ticks,
        rows.concat(),
    )
}
