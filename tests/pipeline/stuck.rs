//! Outputs that nobody reads and processes that do not end: the launcher restarts stages and ends nevertheless.

use std::fs::File;
use std::io::{ErrorKind, PipeReader, Write as _};
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use recording::tap::{Client, Request};
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use testing::Scratch;

use crate::endings::ignores;
use crate::started::{Started, assert_nothing_left, stgdat, wait_for};

/// Limit for a restart and for the end of a run, far above the two seconds that are promised. With an output that
/// blocks, neither comes at all.
const LIMIT: Duration = Duration::from_secs(10);
/// The same for a run with a process that can't be killed: the time for stages to end comes first.
const UNDEAD_LIMIT: Duration = Duration::from_secs(20);
/// Most resident memory of the launcher.
const MEMORY_MAX_KIB: u64 = 64 << 10;
/// Time for a flood to fill every queue.
const FLOOD: Duration = Duration::from_secs(3);

/// A pipe that is full and that nobody reads.
fn full_pipe() -> (PipeReader, Stdio) {
    let (reader, mut writer) = std::io::pipe().expect("there are descriptors");
    let flags = fcntl_getfl(&writer).expect("it is open");
    fcntl_setfl(&writer, flags | OFlags::NONBLOCK).expect("it is open");
    for block in [4096, 1] {
        while writer.write(&vec![b'x'; block]).map_err(|error| error.kind()) != Err(ErrorKind::WouldBlock) {}
    }
    fcntl_setfl(&writer, flags).expect("it is open");
    (reader, writer.into())
}

/// A pipeline whose decoder prints lines, and one line without end, as fast as they are read.
fn flood(scratch: &Scratch) -> String {
    let script = format!("yes & cat /dev/zero & exec {} stage decoder", env!("CARGO_BIN_EXE_stgdat"));
    scratch.pipeline_with("decoder", &["sh", "-c", &script])
}

/// The process of a stage.
fn pid_of(run: &Started, stage: &str) -> Option<Pid> {
    let stages = run.stages();
    stages.iter().find(|(_, line)| line.iter().any(|word| word == stage)).map(|(pid, _)| *pid)
}

/// Kills the tracker, and asserts that another one is started.
fn assert_restarts(run: &Started) {
    let killed = pid_of(run, "tracker").expect("the tracker runs");
    let begun = Instant::now();
    kill_process(killed, Signal::KILL).expect("the tracker runs");
    wait_for("the tracker is not started again", || pid_of(run, "tracker").filter(|pid| *pid != killed));
    println!("restarted after {} ms", begun.elapsed().as_millis());
    assert!(begun.elapsed() < LIMIT, "{:?}", begun.elapsed());
}

/// Interrupts a run, and asserts that it ends with its report.
fn assert_ends(run: Started, report: &str, limit: Duration) -> Value {
    let (signal, code) = if ignores(Signal::INT) { (Signal::TERM, 143) } else { (Signal::INT, 130) };
    let begun = Instant::now();
    run.signal(signal);
    assert_eq!(run.output().status.code(), Some(code));
    println!("ended after {} ms", begun.elapsed().as_millis());
    assert!(begun.elapsed() < limit, "{:?}", begun.elapsed());
    let report = std::fs::read(report).expect("there is a report");
    serde_json::from_slice(&report).expect("the report is JSON")
}

/// Highest resident memory of a process.
fn peak_kib(pid: Pid) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", pid.as_raw_nonzero()));
    let status = status.expect("the process runs");
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("the kernel counts it");
    line.split_whitespace().next().and_then(|kib| kib.parse().ok()).expect("a number")
}

fn lost_lines(report: &Value, origin: &str) -> u64 {
    report["supervision"]["lost_lines"][origin].as_u64().unwrap_or(0)
}

#[test]
fn a_stage_that_prints_without_end_blocks_nobody() {
    let scratch = Scratch::new("flood");
    let (pipeline, report) = (flood(&scratch), scratch.path("report.json"));
    let log = File::create(scratch.path("log")).expect("the folder is ours");
    let mut command = stgdat();
    command.args(["run", "--agents", "6", "--pipeline", &pipeline, "--report", &report]).stderr(log);
    let run = Started::spawn(&mut command);
    let root = run.wait_until_it_forecasts();
    std::thread::sleep(FLOOD);
    assert_restarts(&run);
    let peak_kib = peak_kib(run.pid());
    println!("the launcher had at most {peak_kib} KiB");
    assert!(peak_kib < MEMORY_MAX_KIB, "{peak_kib} KiB");
    let report = assert_ends(run, &report, LIMIT);
    assert!(lost_lines(&report, "decoder") > 0, "{:#}", report["supervision"]);
    assert_nothing_left(&root);
}

#[test]
fn an_output_that_nobody_reads_blocks_nobody() {
    let refuses = || File::options().write(true).open("/dev/full").expect("Linux has the file");
    for case in ["standard error", "standard output", "full disk"] {
        let scratch = Scratch::new(&format!("stuck-{}", case.replace(' ', "-")));
        let (pipeline, report) = (flood(&scratch), scratch.path("report.json"));
        let mut command = stgdat();
        command.args(["run", "--agents", "6", "--pipeline", &pipeline, "--report", &report]);
        let (_reader, full) = full_pipe();
        match case {
            "standard error" => command.stderr(full),
            "standard output" => command.stdout(full).stderr(Stdio::null()),
            _ => command.stderr(refuses()),
        };
        println!("{case}");
        let run = Started::spawn(&mut command);
        // The command's copy of a full pipe would keep its own file open.
        drop(command);
        let root = run.wait_until_it_forecasts();
        std::thread::sleep(FLOOD);
        assert_restarts(&run);
        assert!(peak_kib(run.pid()) < MEMORY_MAX_KIB, "{} KiB", peak_kib(run.pid()));
        let report = assert_ends(run, &report, LIMIT);
        assert!(lost_lines(&report, "decoder") > 0, "{case}: {:#}", report["supervision"]);
        if case == "full disk" {
            assert!(lost_lines(&report, "launcher") > 0, "{:#}", report["supervision"]);
        }
        assert_nothing_left(&root);
    }
}

#[test]
fn a_tool_that_stops_reading_blocks_nobody() {
    let scratch = Scratch::new("stuck-tool");
    let (pipeline, report) = (flood(&scratch), scratch.path("report.json"));
    let mut command = stgdat();
    command.args(["run", "--agents", "6", "--pipeline", &pipeline, "--report", &report]);
    let run = Started::spawn(command.stderr(Stdio::null()));
    let root = run.wait_until_it_forecasts();
    let topics = ["detections", "tracks", "context", "forecasts"].map(str::to_owned).to_vec();
    let request = Request { tool: "stuck".to_owned(), topics, events: true, mark: None, recording: None };
    let _tool = Client::attach(&root, &request).expect("the tap listens");
    std::thread::sleep(FLOOD);
    assert_restarts(&run);
    let peak_kib = peak_kib(run.pid());
    assert!(peak_kib < MEMORY_MAX_KIB, "{peak_kib} KiB");
    assert_ends(run, &report, LIMIT);
    assert_nothing_left(&root);
}

/// Makes a process unable to die before this thread ends. A process that is killed under this option stops in its
/// exit and waits for the tracer, with all its files open, as in a system call that does not end.
#[expect(unsafe_code, reason = "neither std nor rustix has ptrace")]
fn hold_in_exit(pid: Pid) -> std::io::Result<()> {
    let options: libc::c_long = libc::PTRACE_O_TRACEEXIT.into();
    let none: libc::c_long = 0;
    // SAFETY: the call touches no memory of this process.
    match unsafe { libc::ptrace(libc::PTRACE_SEIZE, pid.as_raw_nonzero().get(), none, options) } {
        -1 => Err(std::io::Error::last_os_error()),
        _ => Ok(()),
    }
}

#[test]
fn a_process_that_cannot_be_killed_is_reported_and_left_behind() {
    let scratch = Scratch::new("undead");
    let report = scratch.path("report.json");
    let mut command = stgdat();
    command.args(["run", "--agents", "6", "--report", &report]);
    let log = scratch.path("log");
    let run = Started::spawn(command.stderr(File::create(&log).expect("the folder is ours")));
    let root = run.wait_until_it_forecasts();
    let decoder = pid_of(&run, "decoder").expect("it runs");
    if let Err(error) = hold_in_exit(decoder) {
        testing::skip(format_args!("this process may not trace another one: {error}"));
        return;
    }
    kill_process(decoder, Signal::KILL).expect("it runs");
    assert_restarts(&run);
    let report = assert_ends(run, &report, UNDEAD_LIMIT);
    let pid = decoder.as_raw_nonzero().get();
    assert!(Path::new(&format!("/proc/{pid}/exe")).exists(), "it is alive: no other process waited for it");
    assert_eq!(report["supervision"]["not_ended"]["decoder"], pid, "{:#}", report["supervision"]);
    let log = std::fs::read_to_string(log).expect("it is text");
    assert!(log.contains(&format!("the decoder (process {pid}) was killed but does not end")), "{log}");
    assert_nothing_left(&root);
}
