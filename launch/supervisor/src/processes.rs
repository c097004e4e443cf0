//! CPU time and memory of the stages' processes, as the kernel reports them.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use rustix::process::Pid;
use wire::StageId;

use crate::health::look;

/// Minimum time between two measurements. A shorter interval does not give a useful CPU share.
const LOOK_LEAST: Duration = Duration::from_millis(400);

/// The resources that a process uses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Used {
    /// CPU time since its start.
    pub cpu_s: f64,
    /// CPU time per time since the previous measurement.
    pub cpu: Option<f64>,
    /// Private memory in RAM.
    pub memory_bytes: u64,
    /// Memory in RAM that is shared or backed by a file.
    pub shared_bytes: u64,
}

/// Measures processes, and compares each measurement with the previous one.
#[derive(Debug, Default)]
pub struct Usage {
    looks: BTreeMap<StageId, Look>,
}

#[derive(Clone, Copy, Debug)]
struct Look {
    pid: Pid,
    at: Instant,
    cpu: Duration,
    /// CPU time per time between the previous measurement and this one.
    share: Option<f64>,
}

impl Usage {
    /// Measures a stage's process; `None` if it is gone.
    pub fn look(&mut self, stage: StageId, pid: Pid) -> Option<Used> {
        let cpu = look(pid)?.cpu;
        let [memory_bytes, shared_bytes] = memory(pid)?;
        let now = Instant::now();
        let before = self.looks.get(&stage).copied().filter(|before| before.pid == pid);
        let next = match before {
            Some(before) if now.duration_since(before.at) < LOOK_LEAST => before,
            Some(before) => {
                let time_s = now.duration_since(before.at).as_secs_f64();
                let share = cpu.saturating_sub(before.cpu).as_secs_f64() / time_s;
                Look { pid, at: now, cpu, share: Some((share * 1e3).round() / 1e3) }
            }
            None => Look { pid, at: now, cpu, share: None },
        };
        self.looks.insert(stage, next);
        Some(Used { cpu_s: cpu.as_secs_f64(), cpu: next.share, memory_bytes, shared_bytes })
    }
}

/// Returns the children of all threads of a process.
pub fn children(pid: Pid) -> Vec<Pid> {
    let threads = std::fs::read_dir(format!("/proc/{}/task", pid.as_raw_nonzero()));
    let threads = threads.into_iter().flatten().filter_map(Result::ok);
    let lists = threads.filter_map(|thread| std::fs::read_to_string(thread.path().join("children")).ok());
    let pids = lists.collect::<String>();
    pids.split_whitespace().filter_map(|pid| Pid::from_raw(pid.parse().ok()?)).collect()
}

/// Returns a process's private and shared memory in RAM, in bytes.
pub fn memory(pid: Pid) -> Option<[u64; 2]> {
    let pages = std::fs::read_to_string(format!("/proc/{}/statm", pid.as_raw_nonzero())).ok()?;
    parse(&pages, rustix::param::page_size() as u64)
}

/// Parses /proc/PID/statm: pages in total, in RAM, and in RAM shared or file-backed.
fn parse(text: &str, page_bytes: u64) -> Option<[u64; 2]> {
    let mut pages = text.split(' ').skip(1).map_while(|field| field.trim().parse::<u64>().ok());
    let (resident, shared) = (pages.next()?, pages.next()?);
    Some([resident.saturating_sub(shared) * page_bytes, shared * page_bytes])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_and_shared_memory_are_told_apart() {
        assert_eq!(parse("9000 500 200 30 0 400 0\n", 4096), Some([300 * 4096, 200 * 4096]));
        assert_eq!(parse("9000", 4096), None);
    }

    #[test]
    fn this_process_uses_memory_and_a_share_is_told_from_the_second_look_on() {
        let mut usage = Usage::default();
        let own = rustix::process::getpid();
        let first = usage.look(StageId::Tracker, own).expect("it is alive");
        assert!(first.memory_bytes + first.shared_bytes > 0 && first.cpu.is_none());
        usage.looks.get_mut(&StageId::Tracker).expect("just looked").at -= LOOK_LEAST;
        assert!(usage.look(StageId::Tracker, own).expect("it is alive").cpu.is_some());
    }
}
