//! Processors and real-time priority of the stages, as set in pipeline.toml.
#![expect(
    unsafe_code,
    reason = "calls between fork and exec, and the scheduling class, which rustix does not know"
)]

use std::os::unix::process::CommandExt;
use std::process::Command;

use crate::config::Scheduling;
use rustix::process::Pid;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use wire::StageId;

/// Starts a program on its processors and with its priority. Settings that the system refuses stay unchanged;
/// see [`refused`].
pub fn set_at_start(command: &mut Command, scheduling: &Scheduling) {
    if scheduling.is_default() {
        return;
    }
    let cpus = (!scheduling.cpus.is_empty()).then(|| set_of(&scheduling.cpus));
    let priority = scheduling.priority.map(i32::from);
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

/// Describes the settings that a started process did not get.
pub fn refused(stage: StageId, pid: Pid, scheduling: &Scheduling) -> Vec<String> {
    let (mut notes, name) = (Vec::new(), stage.name());
    if !scheduling.cpus.is_empty() {
        let allowed = sched_getaffinity(Some(pid)).ok();
        let missing = scheduling.cpus.iter().filter(|&&cpu| {
            let is_set = |allowed: &CpuSet| allowed.is_set(cpu as usize);
            !allowed.as_ref().is_some_and(is_set)
        });
        let missing: Vec<String> = missing.map(u32::to_string).collect();
        if !missing.is_empty() {
            let all = missing.len() == scheduling.cpus.len();
            let how = if all { "it runs on any" } else { "it runs on the others of its `cpu`" };
            notes.push(format!("the {name} can't have processor {}: {how}", missing.join(", ")));
        }
    }
    if let Some(priority) = scheduling.priority {
        // SAFETY: the call reads the class of a process by its number and writes no memory.
        let class = unsafe { libc::sched_getscheduler(pid.as_raw_nonzero().get()) };
        if class != libc::SCHED_FIFO {
            notes.push(format!(
                "the {name} can't have priority {priority}: CAP_SYS_NICE or ulimit -r {priority}"
            ));
        }
    }
    notes
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
            let found = (sched_getaffinity(Some(pid)).unwrap(), refused(StageId::Encoder, pid, scheduling));
            process.kill().unwrap();
            process.wait().unwrap();
            found
        };
        let (allowed, notes) = start(&Scheduling { cpus: vec![cpu], priority: None });
        assert!(allowed.count() == 1 && allowed.is_set(cpu as usize) && notes.is_empty(), "{notes:?}");
        let (_, notes) = start(&Scheduling { cpus: vec![Scheduling::CPU_MAX], priority: None });
        assert_eq!(notes, ["the encoder can't have processor 1023: it runs on any"]);
        let (_, notes) = start(&Scheduling { cpus: Vec::new(), priority: Some(1) });
        let told = "the encoder can't have priority 1: CAP_SYS_NICE or ulimit -r 1";
        assert!(notes.iter().all(|note| note.starts_with(told)), "{notes:?}");
    }
}
