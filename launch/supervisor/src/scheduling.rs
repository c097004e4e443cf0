//! Real-time settings of the stages, as set in pipeline.toml: processors, priority and limits.
#![expect(
    unsafe_code,
    reason = "calls between fork and exec, and the scheduling class, which rustix does not know"
)]

use std::os::unix::process::CommandExt;
use std::process::Command;

use rustix::process::{Pid, Resource, Rlimit, getrlimit, setrlimit};
use rustix::thread::{CapabilitySet, CpuSet, capabilities, sched_getaffinity, sched_setaffinity};
use wire::StageId;

/// Number of processors from which on `cpu = "auto"` leaves one to the other programs.
const SHARED_MIN: usize = 4;

/// The settings of one stage for the kernel. The default sets nothing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Scheduling {
    /// Numbers of the processors for all its threads, in increasing order. Empty means all processors.
    pub cpus: Vec<u32>,
    /// The priority in the real-time class SCHED_FIFO; `None` for the normal class.
    pub priority: Option<u8>,
    /// Most private memory of the process, MiB (`RLIMIT_DATA`); `None` without a limit. A process that needs more
    /// ends, and its stage is started again.
    pub memory_mib: Option<u64>,
    /// Whether its memory is not locked. By default a stage locks as much as its limit permits.
    pub unlocked: bool,
}

impl Scheduling {
    /// Largest number of a processor. The kernel's processor sets have 1024 entries.
    pub const CPU_MAX: u32 = 1023;
    /// Largest priority of SCHED_FIFO on Linux. 0 is the normal class.
    pub const PRIORITY_MAX: u8 = 99;

    /// Whether nothing is set.
    #[must_use]
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// The processors as text, such as `2+3`; `None` if none are set.
    #[must_use]
    pub fn cpu_list(&self) -> Option<String> {
        let cpus: Vec<String> = self.cpus.iter().map(u32::to_string).collect();
        (!cpus.is_empty()).then(|| cpus.join("+"))
    }
}

/// Starts a program on its processors and with its priority. Settings that the system refuses stay unchanged;
/// see [`refused`].
pub fn set_at_start(command: &mut Command, scheduling: &Scheduling) {
    if scheduling.is_default() {
        return;
    }
    if scheduling.unlocked {
        command.env(ports::UNLOCKED_VARIABLE, "1");
    }
    let cpus = (!scheduling.cpus.is_empty()).then(|| set_of(&scheduling.cpus));
    let priority = scheduling.priority.map(i32::from);
    let memory = scheduling.memory_mib.map(|mib| {
        let bytes = Some(mib.saturating_mul(1 << 20));
        Rlimit { current: bytes, maximum: bytes }
    });
    // SAFETY: between fork and exec the closure makes system calls and touches no memory but its own copies.
    unsafe {
        command.pre_exec(move || {
            if let Some(cpus) = &cpus {
                let _ = sched_setaffinity(None, cpus);
            }
            if let Some(sched_priority) = priority {
                let parameters = libc::sched_param { sched_priority };
                libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters);
            }
            if let Some(memory) = memory {
                let _ = setrlimit(Resource::Data, memory);
            }
            Ok(())
        });
    }
}

/// Whether this machine has a processor that this process may use.
pub fn has_cpu(cpu: u32) -> bool {
    // Tested in a separate thread, so the setting does not affect this one.
    let tried = std::thread::spawn(move || {
        let is_held = cpu <= Scheduling::CPU_MAX;
        is_held && sched_setaffinity(None, &set_of(&[cpu])).is_ok()
    });
    tried.join().unwrap_or(false)
}

/// Raises this process's limits of real-time priority and, if `lock`, of locked memory as far as the system
/// permits. Stages inherit them. Returns a note if memory keeps a limit.
pub fn raise_limits(lock: bool) -> Option<String> {
    let raise = |resource: Resource| {
        let hard = getrlimit(resource).maximum;
        let unlimited = Rlimit { current: None, maximum: None };
        if setrlimit(resource, unlimited).is_ok() {
            return None;
        }
        // The soft limit may always be raised to the hard one.
        let _ = setrlimit(resource, Rlimit { current: hard, maximum: hard });
        hard
    };
    raise(Resource::Rtprio);
    let bytes = lock.then(|| raise(Resource::Memlock)).flatten()?;
    let may = capabilities(None).is_ok_and(|sets| sets.effective.contains(CapabilitySet::IPC_LOCK));
    (!may).then(|| {
        format!("memory is locked up to {} KiB a process: CAP_IPC_LOCK or ulimit -l unlimited", bytes >> 10)
    })
}

/// The processors that a chain should keep to: those that the kernel isolates, or all but the first if there
/// are at least four. Empty means all.
pub fn reserved_cpus() -> Vec<u32> {
    let isolated = std::fs::read_to_string("/sys/devices/system/cpu/isolated").unwrap_or_default();
    let set = sched_getaffinity(None).ok();
    let is_allowed = |&cpu: &u32| set.as_ref().is_some_and(|set| set.is_set(cpu as usize));
    let allowed: Vec<u32> = (0..=Scheduling::CPU_MAX).filter(is_allowed).collect();
    reserved(&cpu_list(&isolated), &allowed, has_cpu)
}

fn reserved(isolated: &[u32], allowed: &[u32], has_cpu: impl Fn(u32) -> bool) -> Vec<u32> {
    let isolated: Vec<u32> = isolated.iter().copied().filter(|&cpu| has_cpu(cpu)).collect();
    match isolated[..] {
        [] if allowed.len() >= SHARED_MIN => allowed[1..].to_vec(),
        _ => isolated,
    }
}

/// Parses the kernel's list of processors, such as `1-3,6`.
pub fn cpu_list(text: &str) -> Vec<u32> {
    let range = |part: &str| {
        let (first, last) = part.split_once('-').unwrap_or((part, part));
        Some(first.parse().ok()?..=last.parse::<u32>().ok()?.min(Scheduling::CPU_MAX))
    };
    text.trim().split(',').filter_map(range).flatten().collect()
}

/// Describes the settings that the started processes did not get. Each refused limit has one note.
pub fn refused<'a>(processes: impl Iterator<Item = (StageId, Pid, &'a Scheduling)>) -> Vec<String> {
    let mut without_cpus: Vec<(Vec<u32>, bool, Vec<StageId>)> = Vec::new();
    let mut without_priority: Vec<(StageId, u8)> = Vec::new();
    for (stage, pid, scheduling) in processes {
        let missing = missing_cpus(pid, scheduling);
        let all = missing.len() == scheduling.cpus.len();
        let is_same =
            |(cpus, to_all, _): &&mut (Vec<u32>, bool, Vec<StageId>)| *cpus == missing && *to_all == all;
        match without_cpus.iter_mut().find(is_same) {
            _ if missing.is_empty() => {}
            Some((.., stages)) => stages.push(stage),
            None => without_cpus.push((missing, all, vec![stage])),
        }
        if let Some(priority) = scheduling.priority {
            // SAFETY: the call reads the class of a process by its number and writes no memory.
            let class = unsafe { libc::sched_getscheduler(pid.as_raw_nonzero().get()) };
            if class != libc::SCHED_FIFO {
                without_priority.push((stage, priority));
            }
        }
    }
    let of_cpus = without_cpus.iter().map(|(cpus, all, stages)| {
        let cpus: Vec<String> = cpus.iter().map(u32::to_string).collect();
        let [it, run, its] = if stages.len() == 1 { ["it", "runs", "its"] } else { ["they", "run", "their"] };
        let rest = if *all { "any".to_owned() } else { format!("the others of {its} `cpu`") };
        format!("the {} can't have processor {}: {it} {run} on {rest}", names(stages), cpus.join(", "))
    });
    of_cpus.chain(priority_note(&without_priority)).collect()
}

fn priority_note(without: &[(StageId, u8)]) -> Option<String> {
    let stages: Vec<StageId> = without.iter().map(|(stage, _)| *stage).collect();
    let priorities = || without.iter().map(|(_, priority)| *priority);
    let (least, most) = (priorities().min()?, priorities().max()?);
    let which =
        if least == most { format!("priority {most}") } else { format!("priorities {least} to {most}") };
    Some(format!("the {} can't have {which}: CAP_SYS_NICE or ulimit -r {most}", names(&stages)))
}

fn missing_cpus(pid: Pid, scheduling: &Scheduling) -> Vec<u32> {
    if scheduling.cpus.is_empty() {
        return Vec::new();
    }
    let allowed = sched_getaffinity(Some(pid)).ok();
    let is_missing = |cpu: &&u32| !allowed.as_ref().is_some_and(|set| set.is_set(**cpu as usize));
    scheduling.cpus.iter().filter(is_missing).copied().collect()
}

/// Names stages in a sentence.
fn names(stages: &[StageId]) -> String {
    let names: Vec<&str> = stages.iter().map(|stage| stage.name()).collect();
    match &names[..] {
        [before @ .., last] if !before.is_empty() => format!("{} and {last}", before.join(", ")),
        names => names.join(""),
    }
}

fn set_of(cpus: &[u32]) -> CpuSet {
    let mut set = CpuSet::new();
    cpus.iter().for_each(|&cpu| set.set(cpu as usize));
    set
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_begins_on_its_processor_and_a_missing_one_is_told() {
        let here = sched_getaffinity(None).unwrap();
        let cpu = (0..=Scheduling::CPU_MAX).find(|&cpu| here.is_set(cpu as usize)).unwrap();
        let start = |scheduling: &Scheduling| {
            let mut command = Command::new("sleep");
            set_at_start(command.arg("60"), scheduling);
            let mut process = command.spawn().unwrap();
            let pid = Pid::from_child(&process);
            let notes = refused([(StageId::Encoder, pid, scheduling)].into_iter());
            let found = (sched_getaffinity(Some(pid)).unwrap(), notes);
            process.kill().unwrap();
            process.wait().unwrap();
            found
        };
        let (allowed, notes) = start(&Scheduling { cpus: vec![cpu], ..Scheduling::default() });
        assert!(allowed.count() == 1 && allowed.is_set(cpu as usize) && notes.is_empty(), "{notes:?}");
        let (_, notes) = start(&Scheduling { cpus: vec![Scheduling::CPU_MAX], ..Scheduling::default() });
        assert_eq!(notes, ["the encoder can't have processor 1023: it runs on any"]);
        let (_, notes) = start(&Scheduling { priority: Some(1), ..Scheduling::default() });
        let told = "the encoder can't have priority 1: CAP_SYS_NICE or ulimit -r 1";
        assert!(notes.iter().all(|note| note.starts_with(told)), "{notes:?}");
    }

    #[test]
    fn a_limit_that_all_stages_miss_has_one_note() {
        let [first, last] =
            [30, 31].map(|priority| Scheduling { priority: Some(priority), ..Scheduling::default() });
        let without = [(StageId::Source, 30), (StageId::Tracker, 31), (StageId::Sampler, 36)];
        let note =
            "the source, tracker and sampler can't have priorities 30 to 36: CAP_SYS_NICE or ulimit -r 36";
        assert_eq!(priority_note(&without).as_deref(), Some(note));
        assert_eq!(priority_note(&[]), None);
        // This process is in the normal class unless the tests run in the real-time class.
        let own = rustix::process::getpid();
        let of = |stage, scheduling| (stage, own, scheduling);
        let notes = refused([of(StageId::Source, &first), of(StageId::Tracker, &last)].into_iter());
        assert!(notes.len() <= 1, "{notes:?}");
        let cpus = Scheduling { cpus: vec![Scheduling::CPU_MAX], ..Scheduling::default() };
        let notes = refused([of(StageId::Source, &cpus), of(StageId::Tracker, &cpus)].into_iter());
        assert_eq!(notes, ["the source and tracker can't have processor 1023: they run on any"]);
    }

    #[test]
    fn the_chain_gets_the_isolated_processors_or_leaves_one_to_the_others() {
        assert_eq!(cpu_list("1-3,6\n"), [1, 2, 3, 6]);
        assert_eq!(cpu_list("\n"), Vec::<u32>::new());
        assert_eq!(cpu_list("2\n"), [2]);
        let all = |_| true;
        assert_eq!(reserved(&[2, 3], &[0, 1], all), [2, 3]);
        assert_eq!(reserved(&[2, 3], &[0, 1], |cpu| cpu == 3), [3], "one is not allowed");
        assert_eq!(reserved(&[], &[0, 1, 2, 3], all), [1, 2, 3]);
        assert_eq!(reserved(&[], &[0, 1], all), Vec::<u32>::new(), "two are too few to leave one out");
    }
}
