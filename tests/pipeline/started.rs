//! `stgdat` as a process, and the files of a run in shared memory.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, kill_process};

/// Time limit of a wait, far longer than needed, so that no test fails on a busy machine.
const LIMIT: Duration = Duration::from_secs(60);
/// Processes of a run without the launcher.
const STAGES: usize = 8;

/// The program, with its output captured.
pub fn stgdat() -> Command {
    piped(env!("CARGO_BIN_EXE_stgdat"))
}

/// Another program, with its output captured.
pub fn piped(program: impl AsRef<std::ffi::OsStr>) -> Command {
    let mut command = Command::new(program);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// Runs `stgdat` to its end.
pub fn run(arguments: &[&str]) -> Output {
    Started::spawn(stgdat().args(arguments)).output()
}

/// Runs `stgdat` to its end and asserts success.
pub fn run_well(arguments: &[&str]) -> Output {
    let output = run(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", stderr(&output));
    output
}

/// Standard error of a process.
pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Standard output of a process.
pub fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Asserts that `stgdat` with these arguments ends with this code and a message that contains these texts.
/// Returns its output.
pub fn assert_refused(arguments: &[&str], code: i32, texts: &[&str]) -> Output {
    let output = run(arguments);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", stderr(&output));
    for text in texts {
        assert!(
            stderr(&output).contains(text),
            "{arguments:?} does not contain {text:?}: {}",
            stderr(&output)
        );
    }
    output
}

/// Waits for a value; panics with `what` after the limit.
pub fn wait_for<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(start.elapsed() < LIMIT, "{what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// A started process, killed when the test ends.
pub struct Started(Child);

impl Started {
    /// Starts a program.
    pub fn spawn(command: &mut Command) -> Self {
        Self(command.spawn().unwrap_or_else(|error| panic!("{command:?}: {error}")))
    }

    /// Starts `stgdat run`.
    pub fn run(arguments: &[&str]) -> Self {
        Self::spawn(stgdat().arg("run").args(arguments))
    }

    /// The child processes, with their command lines.
    fn children(&self) -> Vec<(Pid, Vec<String>)> {
        // Each thread of the launcher has its own children.
        let threads = std::fs::read_dir(format!("/proc/{}/task", self.0.id())).into_iter().flatten();
        let lists = threads.filter_map(|of| std::fs::read_to_string(of.ok()?.path().join("children")).ok());
        let children: String = lists.collect();
        let pids = children.split_whitespace().filter_map(|pid| pid.parse().ok());
        pids.filter_map(|pid: i32| {
            let line = std::fs::read_to_string(format!("/proc/{pid}/cmdline")).ok()?;
            Some((Pid::from_raw(pid)?, line.split('\0').map(str::to_owned).collect()))
        })
        .collect()
    }

    /// The processes of the run's stages, with their command lines.
    pub fn stages(&self) -> Vec<(Pid, Vec<String>)> {
        // The tap, a recording and a page belong to the run, but they are not stages.
        let is_stage = |line: &[String]| {
            line.get(1).is_none_or(|verb| !["tap", "record", "view"].contains(&verb.as_str()))
        };
        self.children().into_iter().filter(|(_, line)| is_stage(line)).collect()
    }

    /// Number of open descriptors of the run's process with a verb, such as `tap`.
    pub fn descriptors(&self, verb: &str) -> usize {
        let children = self.children();
        let found = children.iter().find(|(_, line)| line.get(1).is_some_and(|word| word == verb));
        let (pid, _) = found.unwrap_or_else(|| panic!("no process {verb}"));
        std::fs::read_dir(format!("/proc/{}/fd", pid.as_raw_nonzero())).expect("the process runs").count()
    }

    /// The run's directory, once the recorder has started.
    pub fn root(&self) -> PathBuf {
        wait_for("the recorder is not started", || {
            let stages = self.stages();
            let (_, line) = stages.iter().find(|(_, line)| line.iter().any(|word| word == "recorder"))?;
            let record = line.iter().skip_while(|word| *word != "--run").nth(1)?;
            Some(Path::new(record).parent()?.to_owned())
        })
    }

    /// Waits until all stages run and have their files in shared memory. Returns the run's directory.
    pub fn wait_until_it_runs(&self) -> PathBuf {
        wait_for("the run does not get going", || {
            let (root, stages) = (self.root(), self.stages());
            let has_data = shared_files(&root).iter().any(|name| name.ends_with(".data"));
            (has_data && stages.len() >= STAGES).then_some(root)
        })
    }

    /// Waits until the recorder has saved its first second, so that forecasts come. Returns the run's directory.
    pub fn wait_until_it_forecasts(&self) -> PathBuf {
        let root = self.wait_until_it_runs();
        let saved = root.join("recorder-checkpoint.json");
        wait_for("no forecasts come", || saved.exists().then_some(()));
        root
    }

    /// The next line of the process's output.
    pub fn line(&mut self) -> String {
        use std::io::Read as _;
        let output = self.0.stdout.as_mut().expect("the output is captured");
        let (mut line, mut byte) = (Vec::new(), [0]);
        // A larger block would take some of the next line.
        while output.read(&mut byte).is_ok_and(|len| len == 1) && byte != *b"\n" {
            line.extend(byte);
        }
        String::from_utf8_lossy(&line).into_owned()
    }

    /// Writes to the process's standard input, which is a pipe.
    pub fn press(&mut self, keys: &[u8]) {
        let input = self.0.stdin.as_mut().expect("the input is piped");
        std::io::Write::write_all(input, keys).expect("the process reads");
    }

    /// Whether the process has not ended yet.
    pub fn is_running(&mut self) -> bool {
        self.0.try_wait().expect("a child can be waited for").is_none()
    }

    /// The process number.
    pub fn pid(&self) -> Pid {
        Pid::from_child(&self.0)
    }

    /// Sends the process a signal.
    pub fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.0), signal).expect("the process runs");
    }

    /// Sends one of the run's stages a signal.
    pub fn signal_stage(&self, name: &str, signal: Signal) {
        let stages = self.stages();
        let (pid, _) =
            stages.iter().find(|(_, line)| line.iter().any(|word| word == name)).expect("the stage runs");
        kill_process(*pid, signal).expect("the stage runs");
    }

    /// The process's output, after its end.
    pub fn output(mut self) -> Output {
        // The pipes are read during the wait, because a process with full pipes would never end.
        let pipes = (self.0.stdout.take(), self.0.stderr.take());
        let readers = (std::thread::spawn(|| read(pipes.0)), std::thread::spawn(|| read(pipes.1)));
        let status =
            wait_for("the process does not end", || self.0.try_wait().expect("a child can be waited for"));
        let of = |reader: std::thread::JoinHandle<Vec<u8>>| reader.join().expect("a reader does not panic");
        Output { status, stdout: of(readers.0), stderr: of(readers.1) }
    }
}

impl Drop for Started {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn read(pipe: Option<impl std::io::Read>) -> Vec<u8> {
    let mut bytes = Vec::new();
    if let Some(mut pipe) = pipe {
        pipe.read_to_end(&mut bytes).expect("a pipe can be read");
    }
    bytes
}

/// Names in shared memory that belong to the run with this directory.
pub fn shared_files(root: &Path) -> Vec<String> {
    let name = root.file_name().and_then(|name| name.to_str()).expect("a run's directory has a name");
    let prefix = format!("{name}_");
    let entries = std::fs::read_dir("/dev/shm").expect("there is shared memory");
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    names.filter(|name| name.starts_with(&prefix)).collect()
}

/// Asserts that a run has removed all its files.
pub fn assert_nothing_left(root: &Path) {
    let name = root.file_name().and_then(|name| name.to_str()).expect("a run's directory has a name");
    let folder = root.parent().expect("it is in a folder");
    let is_left = |entry: &String| entry.trim_start_matches('.').starts_with(name);
    let entries = std::fs::read_dir(folder).expect("the folder can be listed");
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    assert_eq!(names.filter(is_left).collect::<Vec<_>>(), Vec::<String>::new());
    assert_eq!(shared_files(root), Vec::<String>::new());
}

/// Watches for files of dead runs, for runs that end before their directory is known.
pub struct LeftoverWatch {
    before: Vec<String>,
    /// Other tests must not leave files meanwhile.
    _alone: MutexGuard<'static, ()>,
}

impl LeftoverWatch {
    /// Lists the dead runs before the test.
    pub fn begin() -> Self {
        static ALONE: Mutex<()> = Mutex::new(());
        let alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
        Self { before: dead_runs(), _alone: alone }
    }

    /// Asserts that there are no further dead runs.
    pub fn assert_nothing_new(&self) {
        // A run that is about to end briefly has a process but no lock.
        wait_for("a run left files behind: see `stgdat clean --dry-run`", || {
            dead_runs().iter().all(|run| self.before.contains(run)).then_some(())
        });
    }
}

fn dead_runs() -> Vec<String> {
    let leftovers = ports::leftovers().expect("shared memory can be listed");
    leftovers.into_iter().map(|leftover| leftover.name).collect()
}
