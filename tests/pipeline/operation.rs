//! Operation as a service: a detector that is not ready, a log that is JSON throughout, saved state, hostile names.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use testing::Scratch;

use crate::started::{run, run_well, stderr, stdout};

#[test]
fn a_run_waits_for_its_detector_and_every_line_is_json() {
    let scratch = Scratch::new("waits");
    let count = scratch.path("count");
    let program = env!("CARGO_BIN_EXE_stgdat");
    // More failures than a policy of restarts allows.
    let words = format!(
        "echo x >>{count}; [ $(wc -l <{count}) -gt 7 ] || {{ echo no camera >&2; exit 1; }}; \
         exec {program} stage source --run \"$STGDAT_RUN\""
    );
    let pipeline = scratch.pipeline_with("source", &["sh", "-c", &words]);
    let report = scratch.path("report.json");
    let output =
        run_well(&["run", "--pipeline", &pipeline, "--ticks", "20", "--log", "json", "--report", &report]);
    let lines = format!("{}{}", stdout(&output), stderr(&output));
    let lines: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).expect(line)).collect();
    let waits =
        |line: &&Value| line["message"].as_str().is_some_and(|text| text.starts_with("WAITING for source"));
    let waiting: Vec<&Value> = lines.iter().filter(waits).collect();
    assert_eq!(waiting.len(), 1, "{waiting:?}");
    assert_eq!(waiting[0]["message"], "WAITING for source: the source ended with exit code 1: no camera");
    assert_eq!(lines.iter().filter(|line| line["target"] == "report").count(), 1);
    let report: Value = serde_json::from_slice(&scratch.read("report.json")).expect("a report");
    assert_eq!(report["supervision"]["early_starts"], 7);
    assert_eq!(report["supervision"]["outages"], Value::Array(Vec::new()), "no restart of the run");
}

/// A group of processes with a limit of memory for all of them together, removed at the end.
struct MemoryGroup(PathBuf);

impl MemoryGroup {
    /// A group with this limit, of cgroup v2 or else v1; `None` if this process can't make one.
    fn new(limit_mib: u64) -> Option<Self> {
        let kinds = [("/sys/fs/cgroup", "memory.max"), ("/sys/fs/cgroup/memory", "memory.limit_in_bytes")];
        kinds.into_iter().find_map(|(root, limit)| {
            let folder = Path::new(root).join(format!("stgdat-test-{}", std::process::id()));
            std::fs::create_dir(&folder).ok()?;
            let group = Self(folder);
            let limit = group.0.join(limit);
            let is_limited = limit.exists() && std::fs::write(limit, (limit_mib << 20).to_string()).is_ok();
            is_limited.then_some(group)
        })
    }
}

impl Drop for MemoryGroup {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir(&self.0);
    }
}

#[test]
fn of_a_group_without_memory_only_the_stage_that_leaks_is_restarted() {
    let Some(group) = MemoryGroup::new(1024) else {
        testing::skip("it needs root and a cgroup with the memory controller");
        return;
    };
    let scratch = Scratch::new("leak");
    let (leaked, program) = (scratch.path("leaked"), env!("CARGO_BIN_EXE_stgdat"));
    // The first decoder takes all memory.
    let words = format!(
        "[ -e {leaked} ] || {{ >{leaked}; exec tail /dev/zero; }}; exec {program} stage decoder --run \"$STGDAT_RUN\""
    );
    let pipeline = scratch.pipeline_with("decoder", &["sh", "-c", &words]);
    let report = scratch.path("report.json");
    let inside = "echo $$ >\"$0\"/cgroup.procs && exec \"$@\"";
    let output = Command::new("sh")
        .args(["-c", inside])
        .arg(&group.0)
        .args([program, "run", "--pipeline", &pipeline, "--ticks", "100", "--report", &report])
        .output()
        .expect("sh starts");
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("decoder was killed by signal 9"), "{}", stderr(&output));
    let report: Value = serde_json::from_slice(&scratch.read("report.json")).expect("a report");
    for stage in report["stages"].as_array().expect("stages") {
        assert_eq!(stage["restarts"], u64::from(stage["name"] == "decoder"), "{stage:#}");
    }
    assert!(report["forecasts"]["learned"].as_u64() > Some(0), "{:#}", report["forecasts"]);
}

#[test]
fn learned_state_is_saved_and_a_damaged_file_is_ignored() {
    let scratch = Scratch::new("state");
    let state = scratch.path("learned-state");
    let set = format!("sampler.state={state}");
    let arguments = ["run", "--ticks", "40", "--set", &set];
    assert!(!stderr(&run_well(&arguments)).contains("started with"));
    assert!(stderr(&run_well(&arguments)).contains("entries of the retrieval memory and the evidence of"));
    let whole = scratch.read("learned-state");
    for damaged in [&b"foreign"[..], &whole[..whole.len() / 3], &[]] {
        scratch.file("learned-state", damaged);
        let log = stderr(&run_well(&arguments));
        assert!(log.contains("the saved state is ") && log.contains("so it is ignored"), "{log}");
        assert_eq!(scratch.read("learned-state").len(), whole.len(), "replaced at the end");
    }
}

#[test]
fn names_from_outside_are_no_commands_to_the_terminal() {
    let scratch = Scratch::new("escapes");
    let hostile = "a\u{1b}]0;title\u{7}\u{1b}[2J\r\u{9b}31m\u{202e}.csv";
    let recording = scratch.recording(hostile, 10);
    let missing = format!("{recording}\u{1b}[31m");
    let out = scratch.path("out");
    for path in [&recording, &missing] {
        for arguments in [
            &["inspect", path][..],
            &["inspect", path, "--json"],
            &["predict", path, "--out", &out],
            &["track", path, "--out", &out],
            &["run", "--recording", path, "--ticks", "5"],
            &["run", "--recording", path, "--ticks", "5", "--log", "json"],
            &["report", path],
            &["replay", path],
            &["export", path, &out],
            &["trace", path, &out],
            &["tick", path, "3"],
            &["diff", path, path],
            &["check", path],
            &["graph", path],
            &["view", "--run", path],
            &["top", "--run", path],
            &["health", "--run", path],
            &["fault", path],
            &["stage", path],
            &["verify", path],
            &[path],
        ] {
            let output = run(arguments);
            let text = format!("{}{}", stdout(&output), stderr(&output));
            let is_command = |c: char| (c.is_control() && c != '\n') || c == '\u{202e}';
            assert!(!text.contains(is_command), "{arguments:?}: {text:?}");
        }
    }
}

#[test]
fn a_pipe_and_standard_input_are_recordings() {
    let scratch = Scratch::new("pipes");
    let recording = scratch.recording("scene.csv", 10);
    let expected = run(&["track", &recording]);
    assert!(expected.status.success() && !expected.stdout.is_empty(), "{}", stderr(&expected));
    for arguments in
        [&["track"][..], &["predict"], &["inspect"], &["run", "--ticks", "5", "--quiet", "--recording"]]
    {
        // A shell makes `<(cat file)` a pipe.
        for (shell, what) in [("exec cat \"$0\" | \"$@\" -", "-"), ("\"$@\" <(cat \"$0\")", "a pipe")] {
            let output = Command::new("bash")
                .args(["-c", shell, &recording, env!("CARGO_BIN_EXE_stgdat")])
                .args(arguments)
                .output()
                .expect("bash starts");
            assert!(output.status.success(), "{arguments:?} {what}: {}", stderr(&output));
            if arguments == ["track"] {
                assert_eq!(output.stdout, expected.stdout, "{what}");
            }
        }
    }
}

#[test]
fn a_full_output_and_too_few_descriptors_are_failures_that_name_the_cause() {
    let program = env!("CARGO_BIN_EXE_stgdat");
    let of = |shell: &str| Command::new("bash").args(["-c", shell, program]).output().expect("bash starts");
    let full = of("\"$0\" doctor >/dev/full");
    assert_eq!(full.status.code(), Some(65), "{}", stderr(&full));
    assert!(stderr(&full).contains("standard output: "), "{}", stderr(&full));
    let few = of("ulimit -n 64; \"$0\" run --ticks 5 --quiet");
    assert!(!few.status.success() && stderr(&few).contains("ulimit -n 1024"), "{}", stderr(&few));
}

#[test]
fn lines_in_the_journal_have_priorities() {
    use std::os::unix::fs::MetadataExt as _;
    let scratch = Scratch::new("journal");
    let journal = std::fs::File::create(scratch.path("journal")).expect("the folder can be written");
    let about = journal.metadata().expect("it is open");
    let mut command = Command::new(env!("CARGO_BIN_EXE_stgdat"));
    command.args(["inspect", "no-such-file"]).stderr(journal);
    command.env("JOURNAL_STREAM", format!("{}:{}", about.dev(), about.ino()));
    assert!(!command.status().expect("it starts").success());
    let text = String::from_utf8(scratch.read("journal")).expect("it is text");
    assert!(text.starts_with("<3>error: "), "{text}");
}
