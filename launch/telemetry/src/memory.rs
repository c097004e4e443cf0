//! Page faults and locked memory of the stages, read from /proc for the report.

use std::collections::BTreeMap;

use recorder::StageMemory;
use wire::{Heartbeat, StageId};

/// Ticks of a process before its faults count. Until then its history and caches fill.
pub const WARM_UP: u64 = 100;
/// Ticks between two checks of a process.
const INTERVAL: u64 = 12;

/// The memory of all stages.
#[derive(Debug, Default)]
pub struct Memory(BTreeMap<StageId, Process>);

/// The measurements of a stage's newest process.
#[derive(Debug)]
struct Process {
    pid: u32,
    /// The tick of the first heartbeat.
    begun: u64,
    first: Option<Look>,
    last: Option<Look>,
    /// The newest measurement, used once another follows. Faults at the end of a process do not belong to a
    /// tick.
    newest: Option<Look>,
}

/// A measurement of a process.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Look {
    seq: u64,
    minor: u64,
    major: u64,
    resident_kib: u64,
    locked_kib: u64,
}

impl Memory {
    /// Measures the process of a heartbeat, if a measurement is due.
    pub fn heartbeat(&mut self, heartbeat: &Heartbeat) {
        let Some(stage) = StageId::from_number(heartbeat.stage) else { return };
        let &Heartbeat { pid, seq, .. } = heartbeat;
        let process = self.0.entry(stage).or_insert_with(|| Process::new(pid, seq));
        if process.pid != pid {
            *process = Process::new(pid, seq);
        }
        if process.is_due(seq)
            && let Some(look) = look(pid, seq)
        {
            process.take(look);
        }
    }

    /// Returns the measurements of each stage. Stages that did not run long enough are left out.
    pub fn into_report(self) -> BTreeMap<String, StageMemory> {
        let counted =
            |(stage, process): (StageId, Process)| Some((stage.name().to_owned(), process.counted()?));
        self.0.into_iter().filter_map(counted).collect()
    }
}

impl Process {
    const fn new(pid: u32, seq: u64) -> Self {
        Self { pid, begun: seq, first: None, last: None, newest: None }
    }

    fn is_due(&self, seq: u64) -> bool {
        self.newest.map_or(seq >= self.begun + WARM_UP, |newest| seq >= newest.seq + INTERVAL)
    }

    fn take(&mut self, look: Look) {
        self.last = self.newest.replace(look);
        self.first = self.first.or(self.last);
    }

    fn counted(&self) -> Option<StageMemory> {
        let (first, last) = self.first.zip(self.last)?;
        Some(StageMemory {
            ticks: last.seq - first.seq,
            minor_faults: last.minor - first.minor,
            major_faults: last.major - first.major,
            resident_kib: last.resident_kib,
            locked_kib: last.locked_kib.min(last.resident_kib),
        })
        .filter(|memory| memory.ticks > 0)
    }
}

fn look(pid: u32, seq: u64) -> Option<Look> {
    let read = |name| std::fs::read_to_string(format!("/proc/{pid}/{name}")).ok();
    let [minor, major] = faults(&read("stat")?)?;
    let status = read("status")?;
    let [resident_kib, locked_kib] = ["VmRSS:", "VmLck:"].map(|key| kib(&status, key));
    Some(Look { seq, minor, major, resident_kib: resident_kib?, locked_kib: locked_kib? })
}

/// Parses minor and major faults from /proc/PID/stat: fields 10 and 12. The second field ends with the last
/// ")".
fn faults(stat: &str) -> Option<[u64; 2]> {
    let mut fields = stat.rsplit_once(") ")?.1.split(' ').skip(7);
    Some([fields.next()?.parse().ok()?, fields.nth(1)?.parse().ok()?])
}

/// Parses a size in /proc/PID/status.
fn kib(status: &str, key: &str) -> Option<u64> {
    let rest = status.lines().find_map(|line| line.strip_prefix(key))?;
    rest.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seq: u64, minor: u64) -> Look {
        Look { seq, minor, resident_kib: 900, locked_kib: 5000, ..Look::default() }
    }

    #[test]
    fn faults_count_after_the_warm_up_and_before_the_end() {
        let mut process = Process::new(7, 0);
        assert!(!process.is_due(WARM_UP - 1) && process.is_due(WARM_UP));
        process.take(at(100, 500));
        assert_eq!(process.counted(), None);
        assert!(!process.is_due(111) && process.is_due(112));
        process.take(at(112, 503));
        process.take(at(124, 504));
        // The newest measurement may come from the end of the process.
        process.take(at(136, 900));
        let counted = process.counted().unwrap();
        assert_eq!((counted.ticks, counted.minor_faults, counted.major_faults), (24, 4, 0));
        assert_eq!((counted.resident_kib, counted.locked_kib), (900, 900));
    }

    #[test]
    fn this_process_can_be_looked_at() {
        let look = look(std::process::id(), 3).unwrap();
        assert!(look.minor > 0 && look.resident_kib > 0 && look.seq == 3);
    }

    #[test]
    fn a_stat_line_is_read_whatever_the_name() {
        let line = "12 (a ) R b) S 1 12 12 0 -1 4194560 100 9 3 8 250 50 0 0 20 0 3 0 100 1 1";
        assert_eq!(faults(line), Some([100, 3]));
        assert_eq!(faults(""), None);
    }
}
