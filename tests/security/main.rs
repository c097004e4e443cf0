//! Attempts of a second user on the machine to read, change, replace or end a run. None succeeds.
//!
//! The tests need root: they run the pipeline as one user and the attacker as another one, in a namespace
//! with its own processes, `/dev/shm` and `/tmp`. Without root, or without the right to create namespaces,
//! they print that they are skipped.

mod attacker;

use std::io::{BufRead as _, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use attacker::Seen;

/// The user who runs the pipeline, and the attacker.
const OWNER: u32 = 61_001;
const ATTACKER: u32 = 61_002;
/// Repetitions of the races, spread over the umasks.
const RACES: usize = 51;
const UMASKS: [&str; 3] = ["022", "002", "000"];
const PATIENCE: Duration = Duration::from_secs(60);

/// Runs the test `name` in its own namespace. Returns whether this process is in the namespace.
fn is_inside(name: &str) -> bool {
    if std::env::var_os("STGDAT_SECURITY").is_some() {
        return true;
    }
    let mounts = "mount -t tmpfs -o size=192m,nr_inodes=4000,mode=1777 none /dev/shm && \
                  mount -t tmpfs -o size=256m,nr_inodes=4000,mode=1777 none /tmp";
    let unshared = |words: &str| {
        let mut command = Command::new("unshare");
        command.args(["-m", "-p", "-f", "--mount-proc", "--propagation", "private", "sh", "-c", words]);
        command
    };
    let this = std::env::current_exe().expect("/proc is there");
    let is_hidden = this.starts_with("/tmp") || program().starts_with("/tmp");
    if is_hidden || !unshared(mounts).output().is_ok_and(|output| output.status.success()) {
        println!("{name}: skipped, it needs root, mount namespaces and programs outside of /tmp");
        return false;
    }
    let words = format!("{mounts} && exec \"$0\" --exact {name} --nocapture");
    let mut command = unshared(&words);
    for variable in ["XDG_RUNTIME_DIR", "RUNTIME_DIRECTORY", "TMPDIR"] {
        command.env_remove(variable);
    }
    let status = command.arg(this).env("STGDAT_SECURITY", name).status().expect("it starts");
    assert!(status.success(), "{name}: {status}");
    false
}

/// The program under test.
fn program() -> PathBuf {
    env!("CARGO_BIN_EXE_stgdat").into()
}

/// Copies a program to a place where every user can start it.
fn public(program: &Path) -> PathBuf {
    let copy = Path::new("/tmp").join(program.file_name().expect("a program is a file"));
    if !copy.exists() {
        std::fs::copy(program, &copy).expect("there is room");
        std::fs::set_permissions(&copy, PermissionsExt::from_mode(0o755)).expect("the copy is ours");
    }
    copy
}

/// A run of the owner under a umask.
fn run(umask: &str, arguments: &[&str]) -> Command {
    let mut command = Command::new("sh");
    command.args(["-c", &format!("umask {umask}; exec \"$0\" run \"$@\"")]).arg(public(&program()));
    command.args(arguments).uid(OWNER).gid(OWNER).current_dir("/");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// The attacker's process.
struct Attack(Child);

impl Attack {
    fn start(what: &str) -> Self {
        let this = public(&std::env::current_exe().expect("/proc is there"));
        let mut command = Command::new(this);
        command.args(["--exact", "attacker_process", "--nocapture"]).env(attacker::VARIABLE, what);
        command.uid(ATTACKER).gid(ATTACKER).current_dir("/").stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut process = command.spawn().expect("it starts");
        // It prints a line when it has begun.
        let mut lines = BufReader::new(process.stdout.take().expect("it is captured"));
        let mut line = String::new();
        while !line.contains(attacker::READY) {
            line.clear();
            assert!(lines.read_line(&mut line).expect("it prints text") > 0, "the attacker has ended");
        }
        process.stdout = Some(lines.into_inner());
        Self(process)
    }

    /// Ends the attack. Returns what the attacker could do.
    fn end(mut self) -> Seen {
        drop(self.0.stdin.take());
        let output = self.0.wait_with_output().expect("a child can be waited for");
        let text = String::from_utf8(output.stdout).expect("it prints text");
        let line = text.lines().find_map(|line| line.split_once(attacker::RESULT)).expect(&text);
        serde_json::from_str(line.1).expect("it prints JSON")
    }
}

#[test]
fn attacker_process() {
    attacker::attack();
}

/// Asserts that a run ended well.
fn assert_well(output: &Output, about: &str) {
    let (stdout, stderr) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{about}: {}\n{stdout}\n{stderr}", output.status);
    assert!(stdout.contains(" OK"), "{about}:\n{stdout}");
}

/// Waits for the process of a stage of a run.
fn stage(run: &Child, name: &str, but: Option<u32>) -> u32 {
    let begun = Instant::now();
    loop {
        // Each thread of the launcher has its own children.
        let threads = std::fs::read_dir(format!("/proc/{}/task", run.id())).expect("the run lasts longer");
        let lists = threads.filter_map(|of| std::fs::read_to_string(of.ok()?.path().join("children")).ok());
        let children: String = lists.collect();
        let is_it = |pid: &u32| {
            let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            line.split(|&byte| byte == 0).any(|word| word == name.as_bytes())
        };
        let pids = children.split_whitespace().filter_map(|pid| pid.parse().ok());
        if let Some(pid) = pids.filter(|pid| Some(*pid) != but).find(is_it) {
            return pid;
        }
        assert!(begun.elapsed() < PATIENCE, "no process of the {name}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn kill(pid: u32) {
    let pid = rustix::process::Pid::from_raw(pid.cast_signed()).expect("it is not 0");
    rustix::process::kill_process(pid, rustix::process::Signal::KILL).expect("the process runs");
}

#[test]
fn names_taken_in_advance_cost_nothing() {
    if !is_inside("names_taken_in_advance_cost_nothing") {
        return;
    }
    let attack = Attack::start("race");
    for race in 0..RACES {
        let umask = UMASKS[race % UMASKS.len()];
        let output = run(umask, &["--ticks", "40", "--agents", "2", "--speed", "max"]).output().unwrap();
        assert_well(&output, &format!("race {race}, umask {umask}"));
    }
    let seen = attack.end();
    println!("{seen:?}");
    assert!(seen.taken > RACES, "the attacker was awake: {seen:?}");
    assert_eq!(seen.successes(), 0, "{seen:?}");
}

#[test]
fn a_running_pipeline_is_closed_and_restarts_its_stages() {
    if !is_inside("a_running_pipeline_is_closed_and_restarts_its_stages") {
        return;
    }
    for umask in UMASKS {
        let attack = Attack::start("intrude");
        let victim = run(umask, &["--ticks", "100", "--agents", "2"]).spawn().unwrap();
        let before = stage(&victim, "decoder", None);
        std::thread::sleep(Duration::from_secs(3));
        kill(before);
        stage(&victim, "decoder", Some(before));
        let output = victim.wait_with_output().unwrap();
        let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(
            output.status.success(),
            "umask {umask}: {stdout}\n{}",
            String::from_utf8_lossy(&output.stderr)
        );
        assert!(!stdout.contains("given up"), "umask {umask}: {stdout}");
        let seen = attack.end();
        println!("umask {umask}: {seen:?}");
        assert!(seen.tried > 1_000, "the attacker was awake: {seen:?}");
        assert_eq!(seen.successes(), 0, "{seen:?}");
    }
}

#[test]
fn a_consumer_learns_that_a_run_belongs_to_another_user() {
    if !is_inside("a_consumer_learns_that_a_run_belongs_to_another_user") {
        return;
    }
    let victim = run("022", &["--ticks", "60", "--agents", "2"]).spawn().unwrap();
    stage(&victim, "sampler", None);
    let top = Command::new(public(&program())).args(["top", "--once"]).uid(ATTACKER).gid(ATTACKER).output();
    let top = top.unwrap();
    let stderr = String::from_utf8_lossy(&top.stderr).into_owned();
    assert!(!top.status.success() && stderr.contains(&format!("of user {OWNER}")), "{stderr}");
    assert!(victim.wait_with_output().unwrap().status.success());
}

#[test]
fn a_tool_in_another_pid_namespace_sees_the_run() {
    if !is_inside("a_tool_in_another_pid_namespace_sees_the_run") {
        return;
    }
    let owned = run("022", &["--ticks", "150", "--agents", "2"]).spawn().unwrap();
    stage(&owned, "sampler", None);
    // As from another container of the same user.
    let user = OWNER.to_string();
    let mut health = Command::new("unshare");
    health
        .args(["--pid", "--fork", "--setgid", &user, "--setuid", &user])
        .arg(public(&program()))
        .arg("health");
    let begun = Instant::now();
    let seen = loop {
        let output = health.current_dir("/").output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        if output.status.success() || begun.elapsed() > PATIENCE || !stderr.contains("starting") {
            break (output.status.code(), stderr);
        }
    };
    assert_eq!(seen, (Some(0), String::new()));
    assert!(owned.wait_with_output().unwrap().status.success());
}

#[test]
fn full_memory_stops_nothing_for_good() {
    if !is_inside("full_memory_stops_nothing_for_good") {
        return;
    }
    for what in ["fill /dev/shm", "inodes /dev/shm", "fill /tmp", "inodes /tmp"] {
        let victim = run("022", &["--ticks", "150", "--agents", "8"]).spawn().unwrap();
        let before = stage(&victim, "decoder", None);
        std::thread::sleep(Duration::from_secs(3));
        let attack = Attack::start(what);
        // A stage that dies now has no room to start, until the attacker is gone.
        kill(before);
        std::thread::sleep(Duration::from_secs(3));
        let seen = attack.end();
        assert!(seen.taken > 0, "{what}: it was full: {seen:?}");
        stage(&victim, "decoder", Some(before));
        let output = victim.wait_with_output().unwrap();
        let stdout = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{what}: {stdout}\n{}", String::from_utf8_lossy(&output.stderr));
        assert!(!stdout.contains("given up"), "{what}: {stdout}");
    }
}
