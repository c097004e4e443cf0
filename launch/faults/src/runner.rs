//! Runs a specification: starts the run, injects the faults and judges the outcome.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufRead as _, BufReader, Write as _};
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use crate::checker::Line;
use console::failure::Failure;
use ports::{POINTS_VARIABLE, TemporaryFolder};
use recorder::Report;
use run::Run;
use rustix::process::{Pid, Signal, kill_process};
use serde::Serialize;
use supervisor::end_within;
use wire::StageId;

use crate::effect::TopicFault;
use crate::plan::{arguments, pipeline, points};
use crate::processes::{Launcher, Mortal, Writer, is_alive, limit, resident_bytes, use_cpu};
use crate::program::{start_stgdat, stgdat};
use crate::spec::{Action, Consumer, Due, Spec, Target, What};
use crate::verdict::{Check, Cost, Observation, Outcome, judge};

/// Ticks at the end of a run in which consumers are neither killed nor started again.
const LAST_TICKS: u64 = 25;
/// Interval between checks of the run.
const LOOK: Duration = Duration::from_millis(2);
/// Most lines of the history that wait for the runner. Their writers wait then.
const WAITING_MAX: usize = 1 << 14;
/// Most lines of a history: the ticks of a day with two lines of each stage. Further lines are not kept, so the
/// run fails.
const HISTORY_MAX: usize = 16 << 20;
/// Time for a killed launcher, and for a command that waits for the launcher, to end.
const KILL_LIMIT: Duration = Duration::from_secs(10);
/// Time without a sign of life, in addition to injected pauses, after which the run is killed.
const SILENCE_LIMIT: Duration = Duration::from_secs(120);
/// Interval between measurements of the run's resources.
const RESOURCES_INTERVAL: Duration = Duration::from_secs(1);
/// Time after the launcher's death in which all stages must have ended.
const SURVIVAL_LIMIT: Duration = Duration::from_secs(2);

/// The outcome of a specification.
#[derive(Debug, Serialize)]
pub struct Verdict {
    /// Name.
    pub name: String,
    /// The property that it demonstrates.
    pub shows: String,
    /// Whether all expectations are met.
    pub passed: bool,
    /// The expectations with the findings.
    pub checks: Vec<Check>,
    /// What the faults cost.
    pub cost: Cost,
    /// Duration of the run in seconds.
    pub seconds: f64,
    /// The command that repeats the run.
    pub repeat: String,
    /// The folder with log, report, forecasts and history, if it is kept.
    pub kept: Option<PathBuf>,
}

/// How specifications are run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Whether expected tick counts are asserted.
    pub timing: bool,
    /// Seed in place of the specification's.
    pub seed: Option<u64>,
    /// The folder in which all runs are kept. If `None`, only failed runs are kept, in the temporary folder.
    pub keep: Option<PathBuf>,
}

/// Creates a folder with a random name for the files of a run. It stays if the run fails.
pub fn temporary_folder(prefix: &str) -> Result<PathBuf, Failure> {
    Ok(TemporaryFolder::create(prefix).map_err(Failure::unavailable)?.keep())
}

/// Runs a specification to its end.
pub fn run(spec: &Spec, options: &Options) -> Result<Verdict, Failure> {
    let seeded = options.seed.map(|seed| spec.seeded(seed)).transpose()?;
    let spec = seeded.as_ref().unwrap_or(spec);
    let folder = match &options.keep {
        Some(keep) if options.seed.is_some() => keep.join(format!("{}-{}", spec.name, spec.run.seed)),
        Some(keep) => keep.join(&spec.name),
        None => {
            // The name contains the seed, so a repetition that passes does not remove a failed run.
            let name = format!("stgdat-fault-{}-{}-", spec.name, spec.run.seed);
            temporary_folder(&name)?
        }
    };
    std::fs::create_dir_all(&folder).map_err(|error| Failure::file(&folder, error))?;
    let begun = Instant::now();
    let seen = observe(spec, &folder)?;
    let checks = judge(spec, &seen, options.timing);
    let passed = checks.iter().all(|check| check.outcome != Outcome::Failed);
    let seed = options.seed.map_or_else(String::new, |seed| format!(" --seed {seed}"));
    let verdict = Verdict {
        name: spec.name.clone(),
        shows: spec.shows.clone(),
        passed,
        checks,
        cost: seen.cost(spec),
        seconds: begun.elapsed().as_secs_f64(),
        repeat: format!("stgdat fault run {}{seed}", spec.path.display()),
        kept: (!passed || options.keep.is_some()).then(|| folder.clone()),
    };
    if verdict.kept.is_none() {
        let _ = std::fs::remove_dir_all(&folder);
    }
    Ok(verdict)
}

/// Runs a specification to its end, with its files in `folder`, and returns the observation.
pub fn observe(spec: &Spec, folder: &Path) -> Result<Observation, Failure> {
    Session::start(spec, folder)?.follow()
}

/// A run with its faults.
struct Session<'a> {
    spec: &'a Spec,
    folder: &'a Path,
    launcher: Launcher,
    begun: Instant,
    /// When the first process of each stage was seen.
    started: BTreeMap<StageId, Instant>,
    sender: SyncSender<Line>,
    lines: Receiver<Line>,
    /// The run once it is announced, with the follower and injectors.
    run: Option<(Run, Vec<Writer>)>,
    /// Prefix of the run's files, set once its launcher was killed.
    name: Option<String>,
    /// Consumers that are repeatedly killed.
    mortals: Vec<Mortal>,
    /// Pending actions at a tick or time.
    due: Vec<Action>,
    /// Stopped processes and the times at which they continue.
    stopped: Vec<(Instant, Pid, &'static str)>,
    /// Running `stage replace` commands.
    replacing: Vec<(StageId, Child)>,
    /// End of the last fault that has no own frames.
    over_at: Option<Instant>,
    /// The newest tick that any stage has reached.
    tick: Option<u64>,
    /// Time of the last resource measurement.
    looked: Instant,
    seen: Observation,
}

impl<'a> Session<'a> {
    /// Starts `stgdat run`.
    fn start(spec: &'a Spec, folder: &'a Path) -> Result<Self, Failure> {
        let file = |name: &str| folder.join(name);
        let pipeline = pipeline(spec)?;
        std::fs::write(file("pipeline.toml"), pipeline).map_err(|error| Failure::file(folder, error))?;
        for name in ["announce", "report.json", "forecasts.jsonl"] {
            let _ = std::fs::remove_file(file(name));
        }
        let log = File::create(file("log.txt")).map_err(|error| Failure::file(folder, error))?;
        let mut command = stgdat();
        arguments(&mut command, spec, folder);
        command
            .env(POINTS_VARIABLE, points(spec))
            .stderr(log.try_clone().map_err(|error| Failure::file(folder, error))?)
            .stdout(log);
        let launcher = Launcher::new(start_stgdat(&mut command)?);
        let (sender, lines) = sync_channel(WAITING_MAX);
        Ok(Self {
            spec,
            folder,
            launcher,
            begun: Instant::now(),
            started: BTreeMap::new(),
            sender,
            lines,
            run: None,
            name: None,
            mortals: Vec::new(),
            due: spec.faults.actions.clone(),
            stopped: Vec::new(),
            replacing: Vec::new(),
            over_at: None,
            tick: None,
            looked: Instant::now(),
            seen: Observation::default(),
        })
    }

    /// Follows the run to its end and collects its results.
    fn follow(mut self) -> Result<Observation, Failure> {
        let mut sign = Instant::now();
        let status = loop {
            if let Some(status) = self.launcher.ended()? {
                break status;
            }
            if self.run.is_none() {
                self.attend()?;
            }
            match self.lines.recv_timeout(LOOK) {
                Ok(line) => {
                    sign = Instant::now();
                    self.take(line);
                }
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {}
            }
            self.act()?;
            self.look();
            if sign.elapsed() > SILENCE_LIMIT {
                let _ = kill_process(self.launcher.pid(), Signal::KILL);
            }
            if sign.elapsed() > SILENCE_LIMIT + KILL_LIMIT {
                return Err(Failure::Failed("the launcher is silent and can't be killed".to_owned()));
            }
        };
        self.gather(status)
    }

    /// Starts follower, injectors and consumers once the run has announced itself.
    fn attend(&mut self) -> Result<(), Failure> {
        let Ok(record) = std::fs::read_to_string(self.folder.join("announce")) else { return Ok(()) };
        let record = Path::new(&record);
        // The run may have ended already.
        let Ok(run) = Run::read(record) else { return Ok(()) };
        // A run that can't start its stages is about to remove its files, so no process may create new ones.
        if self.launcher.stages().len() < run.stages.len() {
            return Ok(());
        }
        let mut writers = vec![Writer::start(&["follow"], record, &self.sender)?];
        for topic in self.spec.injected_topics() {
            if !run.is_on_way(topic) {
                self.seen.off_path_topics.push(topic.to_owned());
            }
            let faults: Vec<&TopicFault> =
                self.spec.faults.topics.iter().filter(|fault| fault.topic == topic).collect();
            let plan = self.folder.join(format!("inject-{topic}.json"));
            let text = serde_json::to_vec_pretty(&faults).map_err(Failure::data)?;
            std::fs::write(&plan, text).map_err(|error| Failure::file(&plan, error))?;
            let plan = plan.display().to_string();
            writers.push(Writer::start(&["inject", "--plan", &plan], record, &self.sender)?);
        }
        for Consumer { topic, hold_ms, within_ms, random } in &self.spec.faults.consumers {
            let hold = hold_ms.map(|ms| ms.to_string());
            let mut arguments = vec!["consume", topic];
            arguments.extend(hold.iter().flat_map(|ms| ["--hold-ms", ms.as_str()]));
            if let Some(within_ms) = within_ms {
                let arguments = arguments.into_iter().map(str::to_owned).collect();
                self.mortals.push(Mortal::start(arguments, record, *within_ms, *random, &self.sender)?);
            } else {
                writers.push(Writer::start(&arguments, record, &self.sender)?);
            }
        }
        self.run = Some((run, writers));
        Ok(())
    }

    /// Measures the run's resources once it runs.
    fn look(&mut self) {
        let (Some((run, _)), Some(tick)) = (&self.run, self.tick) else { return };
        if self.looked.elapsed() < RESOURCES_INTERVAL {
            return;
        }
        self.looked = Instant::now();
        let launcher = self.launcher.pid();
        let descriptors = std::fs::read_dir(format!("/proc/{}/fd", launcher.as_raw_nonzero()));
        let in_folder = std::fs::read_dir(&run.root).map_or(0, |entries| entries.count() as u64);
        let [files, shared_bytes] = shared(&name_in(run));
        self.seen.lines.push(Line::Resources {
            tick,
            launcher_bytes: resident_bytes(launcher),
            descriptors: descriptors.map_or(0, |entries| entries.count() as u64),
            stages_bytes: self.launcher.stages().iter().map(|(pid, _)| resident_bytes(*pid)).sum(),
            files: files + in_folder,
            shared_bytes,
        });
    }

    fn take(&mut self, line: Line) {
        let tick = match &line {
            Line::Forecasts(output) => Some(output.tick),
            Line::Reached { tick, .. } => Some(*tick),
            _ => None,
        };
        self.tick = self.tick.max(tick);
        if self.seen.lines.len() < HISTORY_MAX {
            self.seen.lines.push(line);
        }
    }

    /// Executes the due actions.
    fn act(&mut self) -> Result<(), Failure> {
        // A consumer started while the run removes its files would leave some behind.
        if self.tick.is_none_or(|tick| tick + LAST_TICKS < self.spec.run.ticks) {
            self.mortals.iter_mut().try_for_each(Mortal::tend)?;
        }
        for (_, pid, name) in self.stopped.extract_if(.., |(until, ..)| Instant::now() >= *until) {
            // The process may be gone, for instance killed because it was stopped.
            let _ = kill_process(pid, Signal::CONT);
            self.seen.lines.push(signalled(name, "continued", self.tick));
            self.seen.over.extend(self.tick);
        }
        if self.over_at.is_some_and(|at| Instant::now() >= at) {
            self.over_at = None;
            self.seen.lines.push(signalled("machine", "has its CPU again", self.tick));
            self.seen.over.extend(self.tick);
        }
        if self.due.iter().any(|action| matches!(action.at, Due::AfterStart(..))) {
            for (_, stage) in self.launcher.stages() {
                self.started.entry(stage).or_insert_with(Instant::now);
            }
        }
        let (tick, begun, started) = (self.tick, self.begun, &self.started);
        let is_due = |action: &mut Action| match action.at {
            Due::Tick(at) => tick.is_some_and(|tick| tick >= at),
            Due::AfterStart(Target::Launcher, after) => begun.elapsed() >= after,
            Due::AfterStart(Target::Stage(stage), after) => {
                started.get(&stage).is_some_and(|started| started.elapsed() >= after)
            }
        };
        let now: Vec<Action> = self.due.extract_if(.., is_due).collect();
        for action in now {
            if !self.inflict(&action.what)? {
                // The process is missing at this moment because it is being replaced.
                self.due.push(action);
            }
        }
        Ok(())
    }

    /// Does one action to a process. Returns false if the process is missing.
    fn inflict(&mut self, what: &What) -> Result<bool, Failure> {
        let find = |target: Target| match target {
            Target::Launcher => Some(self.launcher.pid()),
            Target::Stage(stage) => self.launcher.stage(stage),
        };
        let (target, done) = match what {
            What::Kill(target) => {
                let Some(pid) = find(*target) else { return Ok(false) };
                let stages = self.launcher.stages();
                if *target == Target::Launcher {
                    self.name = name_of(pid);
                }
                let _ = kill_process(pid, Signal::KILL);
                if *target == Target::Launcher {
                    self.seen.survivors = survivors(&stages);
                }
                (target.name(), "killed")
            }
            What::Stop(target, time) => {
                let Some(pid) = find(*target) else { return Ok(false) };
                let _ = kill_process(pid, Signal::STOP);
                self.stopped.push((Instant::now() + *time, pid, target.name()));
                (target.name(), "stopped")
            }
            What::Limit(stage, resource, value) => {
                let Some(pid) = find(Target::Stage(*stage)) else { return Ok(false) };
                limit(pid, *resource, *value)?;
                (stage.name(), "limited")
            }
            What::Replace(stage, command) => {
                let Some((run, _)) = &self.run else { return Ok(false) };
                let mut verb = stgdat();
                verb.args(["stage", "replace", stage.name(), "--run"]).arg(&run.root);
                if !command.is_empty() {
                    verb.arg("--exec").args(command);
                }
                let log = File::options().append(true).open(self.folder.join("log.txt"));
                let log = log.map_err(|error| Failure::file(self.folder, error))?;
                verb.stdout(Stdio::null()).stderr(log);
                self.replacing.push((*stage, start_stgdat(&mut verb)?));
                (stage.name(), "ordered to be replaced")
            }
            What::Cpu(threads, time) => {
                // They end by themselves.
                drop(use_cpu(*threads, *time));
                self.over_at = Some(Instant::now() + *time);
                ("machine", "has no CPU left")
            }
        };
        self.seen.lines.push(signalled(target, done, self.tick));
        Ok(true)
    }

    /// Ends the follower and injectors, and reads the files that the run has left.
    fn gather(mut self, status: ExitStatus) -> Result<Observation, Failure> {
        self.seen.exit = status.code().unwrap_or_else(|| -status.signal().unwrap_or(0));
        self.seen.failed_consumers = self.mortals.drain(..).map(|mortal| mortal.failures).sum();
        let run = self.run.take().map(|(run, writers)| {
            // Their last lines need room.
            let ending = std::thread::spawn(move || drop(writers));
            while !ending.is_finished() {
                if let Ok(line) = self.lines.recv_timeout(LOOK) {
                    self.take(line);
                }
            }
            run
        });
        while let Ok(line) = self.lines.try_recv() {
            self.take(line);
        }
        for (stage, mut verb) in self.replacing.drain(..) {
            // The command ends with the launcher at the latest.
            let status = end_within(&mut verb, KILL_LIMIT);
            let exit = status.and_then(|status| status.code()).unwrap_or(-1);
            let stage = stage.name().to_owned();
            self.seen.lines.push(Line::Replaced { stage, exit });
        }
        // A launcher may be killed before its run is announced.
        if let Some(name) = self.name.take().or_else(|| run.as_ref().map(name_in)) {
            if self.spec.kills_launcher() {
                // As `stgdat clean` does.
                for leftover in ports::leftovers().map_err(Failure::unavailable)? {
                    if leftover.name == name {
                        leftover.remove();
                    }
                }
            }
            self.seen.leftovers = ports::files_left(&name) as u64;
        }
        self.seen.report = Report::read(&self.folder.join("report.json")).ok();
        self.seen.recorded = recorded(&self.folder.join("forecasts.jsonl"));
        self.seen = self.seen.concluded(self.spec);
        let history = self.folder.join("history.jsonl");
        write_lines(&history, &self.seen.lines).map_err(|error| Failure::file(&history, error))?;
        Ok(self.seen)
    }
}

fn signalled(target: &str, what: &str, tick: Option<u64>) -> Line {
    Line::Signalled { target: target.to_owned(), what: what.to_owned(), tick: tick.unwrap_or(0) }
}

/// Counts the stages that are still running a while after their launcher was killed.
fn survivors(stages: &[(Pid, StageId)]) -> u64 {
    let begun = Instant::now();
    loop {
        let alive = stages.iter().filter(|(pid, _)| is_alive(*pid)).count() as u64;
        if alive == 0 || begun.elapsed() > SURVIVAL_LIMIT {
            return alive;
        }
        std::thread::sleep(LOOK);
    }
}

/// The name of a run.
fn name_in(run: &Run) -> String {
    run.root.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Finds the name of a launcher's run by the lock that it holds; `None` before the lock exists.
fn name_of(launcher: Pid) -> Option<String> {
    let descriptors = std::fs::read_dir(format!("/proc/{}/fd", launcher.as_raw_nonzero())).ok()?;
    let files = descriptors.filter_map(|entry| std::fs::read_link(entry.ok()?.path()).ok());
    let mut locks = files
        .filter_map(|file| Some(file.file_name()?.to_str()?.strip_suffix("_lock")?.get(..15)?.to_owned()));
    locks.find(|name| name.starts_with("stgdat_"))
}

/// Counts the run's files in shared memory and their bytes.
fn shared(prefix: &str) -> [u64; 2] {
    use std::os::unix::fs::MetadataExt as _;
    let entries = std::fs::read_dir("/dev/shm").into_iter().flatten().filter_map(Result::ok);
    let ours = entries.filter(|entry| entry.file_name().to_string_lossy().starts_with(prefix));
    ours.fold([0, 0], |[files, bytes], entry| {
        [files + 1, bytes + entry.metadata().map_or(0, |file| 512 * file.blocks())]
    })
}

/// The ticks of a file of forecasts.
fn recorded(path: &Path) -> BTreeSet<u64> {
    #[derive(serde::Deserialize)]
    struct Tick {
        seq: u64,
    }
    let Ok(file) = File::open(path) else { return BTreeSet::new() };
    let lines = BufReader::new(file).lines().map_while(Result::ok);
    lines.filter_map(|line| serde_json::from_str::<Tick>(&line).ok()).map(|tick| tick.seq).collect()
}

fn write_lines(path: &Path, lines: &[Line]) -> std::io::Result<()> {
    let mut file = std::io::BufWriter::new(File::create(path)?);
    for line in lines {
        serde_json::to_writer(&mut file, line)?;
        file.write_all(b"\n")?;
    }
    file.flush()
}
