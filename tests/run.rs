//! `stgdat run` from outside: it ends well, ends at once where it must, and leaves nothing behind.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

/// Longest wait for anything; far beyond what it takes, so that a busy machine fails no test.
const LIMIT: Duration = Duration::from_secs(60);

fn stgdat() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stgdat"));
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn run(arguments: &[&str]) -> Output {
    stgdat().args(arguments).output().expect("stgdat can be started")
}

/// A run that is given up for dead or ended by signal; killed when the test ends.
struct Running(Child);

impl Running {
    fn start(arguments: &[&str]) -> Self {
        Self(stgdat().arg("run").args(arguments).spawn().expect("stgdat can be started"))
    }

    /// The processes of its stages with their command lines.
    fn stages(&self) -> Vec<(Pid, Vec<String>)> {
        let children = format!("/proc/{0}/task/{0}/children", self.0.id());
        let Ok(children) = std::fs::read_to_string(children) else { return Vec::new() };
        let pids = children.split_whitespace().filter_map(|pid| pid.parse().ok());
        pids.filter_map(|pid: i32| {
            let line = std::fs::read_to_string(format!("/proc/{pid}/cmdline")).ok()?;
            Some((Pid::from_raw(pid)?, line.split('\0').map(str::to_owned).collect()))
        })
        .collect()
    }

    /// Waits until its ticks flow, and returns its directory.
    fn wait_until_it_runs(&self) -> PathBuf {
        let start = Instant::now();
        loop {
            assert!(start.elapsed() < LIMIT, "the run does not get going");
            std::thread::sleep(Duration::from_millis(20));
            let stages = self.stages();
            let Some((_, line)) = stages.iter().find(|(_, line)| line.iter().any(|word| word == "recorder"))
            else {
                continue;
            };
            let record = line
                .iter()
                .skip_while(|word| *word != "--run")
                .nth(1)
                .expect("stages are started with --run");
            // The forecasts' own file grows with the first line.
            let root = Path::new(record).parent().expect("a record lies in its run's directory");
            let shared = shared_files(root);
            if shared.iter().any(|name| name.ends_with(".data")) && stages.len() == 8 {
                return root.to_owned();
            }
        }
    }

    fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.0), signal).expect("the launcher runs");
    }

    fn signal_stage(&self, name: &str, signal: Signal) {
        let stages = self.stages();
        let (pid, _) =
            stages.iter().find(|(_, line)| line.iter().any(|word| word == name)).expect("the stage runs");
        kill_process(*pid, signal).expect("the stage runs");
    }

    fn output(mut self) -> Output {
        let start = Instant::now();
        while self.0.try_wait().expect("a child can be waited for").is_none() {
            assert!(start.elapsed() < LIMIT, "stgdat does not end");
            std::thread::sleep(Duration::from_millis(10));
        }
        let child = std::mem::replace(&mut self.0, Command::new("true").spawn().expect("true is there"));
        child.wait_with_output().expect("its output can be read")
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Names in shared memory of the run with that directory.
fn shared_files(root: &Path) -> Vec<String> {
    let prefix = format!(
        "{}_",
        root.file_name().and_then(|name| name.to_str()).expect("a run's directory has a name")
    );
    let entries = std::fs::read_dir("/dev/shm").expect("there is shared memory");
    entries
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .filter(|n| n.starts_with(&prefix))
        .collect()
}

fn assert_nothing_left(root: &Path) {
    assert!(!root.exists(), "{} is left", root.display());
    assert_eq!(shared_files(root), Vec::<String>::new());
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A directory that goes with the test.
struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("stgdat-test-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).expect("the temporary directory can be written to");
        Self(path)
    }

    fn path(&self, name: &str) -> String {
        self.0.join(name).display().to_string()
    }

    fn file(&self, name: &str, content: impl AsRef<[u8]>) -> String {
        std::fs::write(self.0.join(name), content).expect("the temporary directory can be written to");
        self.path(name)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[test]
fn a_run_in_lockstep_loses_nothing_and_repeats_to_the_byte() {
    let scratch = Scratch::new("lockstep");
    let lines: Vec<Vec<u8>> = ["a", "b"]
        .into_iter()
        .map(|name| {
            let (report, forecasts) =
                (scratch.path(&format!("{name}.json")), scratch.path(&format!("{name}.jsonl")));
            let arguments =
                ["run", "--ticks", "25", "--agents", "12", "--seed", "3", "--speed", "max", "--report"];
            let output = run(&[&arguments[..], &[&report, "--forecasts", &forecasts]].concat());
            assert!(output.status.success(), "{}", stderr(&output));
            let report = std::fs::read_to_string(report).expect("the report is written");
            let report: Value = serde_json::from_str(&report).expect("the report is JSON");
            assert_eq!((&report["ticks"], &report["drops"]), (&25.into(), &0.into()));
            assert!(report["forecasts"]["learned"].as_u64().is_some_and(|n| n > 100), "{report}");
            assert_eq!(
                report["stages"].as_array().map(Vec::len),
                Some(7),
                "all stages that a forecast passes"
            );
            std::fs::read(forecasts).expect("the forecasts are written")
        })
        .collect();
    assert_eq!(lines[0].iter().filter(|&&byte| byte == b'\n').count(), 25);
    assert!(lines[0] == lines[1], "two runs of one seed differ");
}

#[test]
fn two_runs_side_by_side_do_not_meet() {
    let runs: Vec<Running> = (0..2)
        .map(|seed| {
            Running::start(&["--ticks", "20", "--agents", "6", "--speed", "max", "--seed", &seed.to_string()])
        })
        .collect();
    for run in runs {
        let output = run.output();
        assert!(output.status.success(), "{}", stderr(&output));
        let report = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(report.contains("20 ticks"), "{report}");
    }
}

#[test]
fn a_signal_ends_all_stages_and_leaves_nothing() {
    for (signal, code) in [(Signal::TERM, 143), (Signal::INT, 130)] {
        let run = Running::start(&["--agents", "6"]);
        let root = run.wait_until_it_runs();
        let stages = run.stages();
        run.signal(signal);
        let output = run.output();
        assert_eq!(output.status.code(), Some(code), "{}", stderr(&output));
        assert_nothing_left(&root);
        for (pid, line) in stages {
            assert!(rustix::process::test_kill_process(pid).is_err(), "{line:?} still runs");
        }
    }
}

#[test]
fn the_death_of_a_stage_ends_the_run_and_is_told() {
    let run = Running::start(&["--agents", "6"]);
    let root = run.wait_until_it_runs();
    run.signal_stage("encoder", Signal::KILL);
    let output = run.output();
    assert_eq!(output.status.code(), Some(70));
    assert!(stderr(&output).contains("the encoder was killed by signal 9"), "{}", stderr(&output));
    assert_nothing_left(&root);
}

#[test]
fn a_stage_that_is_stopped_holds_nothing_up_and_is_ended() {
    let run = Running::start(&["--agents", "6"]);
    let root = run.wait_until_it_runs();
    run.signal_stage("decoder", Signal::STOP);
    std::thread::sleep(Duration::from_millis(500));
    run.signal(Signal::TERM);
    assert_eq!(run.output().status.code(), Some(143));
    assert_nothing_left(&root);
}

#[test]
fn after_the_launcher_is_killed_clean_removes_its_files_and_no_others() {
    let living = Running::start(&["--agents", "6"]);
    let dead = Running::start(&["--agents", "6"]);
    let (living_root, dead_root) = (living.wait_until_it_runs(), dead.wait_until_it_runs());
    let stages = dead.stages();
    dead.signal(Signal::KILL);
    drop(dead);
    let start = Instant::now();
    let runs = |(pid, _): &(Pid, Vec<String>)| {
        let state = std::fs::read_to_string(format!("/proc/{}/stat", pid.as_raw_nonzero()));
        // A zombie runs no more; its new parent has not looked yet.
        state.is_ok_and(|state| state.rsplit(") ").next().is_some_and(|rest| !rest.starts_with('Z')))
    };
    while stages.iter().any(runs) {
        assert!(start.elapsed() < LIMIT, "stages outlive their launcher");
        std::thread::sleep(Duration::from_millis(10));
    }
    assert!(!shared_files(&dead_root).is_empty(), "nobody was there to remove them");
    let output = run(&["clean"]);
    assert!(output.status.success());
    assert_nothing_left(&dead_root);
    assert!(!shared_files(&living_root).is_empty(), "the living run keeps its files");
    living.signal(Signal::TERM);
    assert_eq!(living.output().status.code(), Some(143));
}

#[test]
fn one_line_puts_another_program_in_a_stages_place() {
    let scratch = Scratch::new("swap");
    let shipped = include_str!("../launch/pipeline.toml");
    let own =
        format!("name = \"encoder\"\ncommand = [{:?}, \"stage\", \"encoder\"]", env!("CARGO_BIN_EXE_stgdat"));
    let pipeline = scratch.file("pipeline.toml", shipped.replace("name = \"encoder\"", &own));
    let output = run(&["run", "--ticks", "15", "--agents", "6", "--speed", "max", "--pipeline", &pipeline]);
    assert!(output.status.success(), "{}", stderr(&output));
}

#[test]
fn what_cannot_be_used_is_told_with_its_exit_code() {
    let scratch = Scratch::new("bad");
    let weights = include_bytes!("../shared/weights/onboard.safetensors");
    let truncated = scratch.file("truncated.safetensors", &weights[..weights.len() / 2]);
    let broken = scratch.file("broken.csv", "frame,id,type\n1,2\n");
    let shipped = include_str!("../launch/pipeline.toml");
    let unknown_key = scratch.file("key.toml", shipped.replace("budget_ms = 6", "budget = 6"));
    let no_such_program = scratch.file(
        "program.toml",
        shipped.replace("name = \"encoder\"", "name = \"encoder\"\ncommand = [\"./none\"]"),
    );
    let ends_at_once = scratch
        .file("ends.toml", shipped.replace("name = \"encoder\"", "name = \"encoder\"\ncommand = [\"true\"]"));
    let cases: &[(&[&str], i32, &str)] = &[
        (&["--recording", "no/such/file.txt"], 65, "no/such/file.txt"),
        (&["--recording", &broken], 65, "broken.csv"),
        (&["--weights", &truncated], 65, ""),
        (&["--map", &broken], 65, "broken.csv"),
        (&["--pipeline", "no/such.toml"], 78, "no/such.toml"),
        (&["--pipeline", &unknown_key], 78, "unknown field `budget`"),
        (&["--pipeline", &no_such_program], 78, "./none"),
        (&["--pipeline", &ends_at_once], 70, "the encoder ended with exit code 0"),
        (&["--agents", "0"], 2, "--agents"),
        (&["--agents", "4000"], 2, "--agents"),
        (&["--speed", "fast"], 2, "--speed"),
    ];
    for (arguments, code, told) in cases {
        let output = run(&[&["run"], *arguments].concat());
        assert_eq!(output.status.code(), Some(*code), "{arguments:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(told), "{arguments:?}: {}", stderr(&output));
    }
}
