//! Keeps the memory that a tick uses resident, so that no tick waits for a page.
//!
//! The first touch of a page causes a *page fault*: the kernel finds and clears memory while the tick waits.
//! This takes a microsecond or, under pressure, milliseconds. A steady stage still causes some faults: memory
//! reserved for later (the retrieval memory, caches) is touched page by page as it fills. If faults have
//! occurred since the last heartbeat, the stage *populates* its writable memory between two ticks: the heap,
//! other private memory, and the used pages of the topics' segments. A stage without faults does nothing.
//!
//! Memory is *locked*, so that it is not swapped out. If the process may lock everything, each page is locked
//! when it is touched. Otherwise the mappings that the ticks use most are locked, within the limit (`ulimit
//! -l`).
#![expect(unsafe_code, reason = "populating and locking take addresses of mappings")]

mod maps;

use std::ffi::c_void;
use std::fs::File;
use std::os::unix::fs::FileExt;

use rustix::fs::SeekFrom;
use rustix::mm::{Advice, MlockAllFlags, MlockFlags, madvise, mlock_with, mlockall};
use rustix::process::{Resource, getrlimit};
use rustix::thread::{CapabilitySet, capabilities};

use crate::{LAUNCHER_VARIABLE, UNLOCKED_VARIABLE};
use maps::{Kind, Mapping};

/// Maximum number of heartbeats between two checks of the faults. It is reached if populating does not help.
const PAUSE_MAX: u32 = 16;
/// Heartbeats before the memory use of ticks is measured: the history is full by then.
const SETTLED: u32 = 60;
/// Heartbeats of that measurement. The number of ticks is about the same.
const OBSERVED: u32 = 12;

/// The memory of this process.
#[derive(Debug)]
pub(crate) struct ResidentMemory {
    /// /proc/self/stat; `None` if this process is not a stage of a launcher.
    stat: Option<File>,
    /// Faults at the last check.
    faults: u64,
    /// Heartbeats so far.
    beats: u32,
    /// Heartbeats until the next check, and the pause after it if it finds faults again.
    pause: [u32; 2],
    locked: Locked,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Locked {
    /// The process has no limit, or the locking within its limit is finished.
    Done,
    /// The measurement starts at this heartbeat.
    From(u32),
    /// The measurement has been running since this heartbeat.
    Since(u32),
}

impl ResidentMemory {
    /// The memory of a stage that a launcher has started; other processes are unchanged.
    pub fn of_stage() -> Self {
        let stat = std::env::var_os(LAUNCHER_VARIABLE).and_then(|_| File::open("/proc/self/stat").ok());
        let all = MlockAllFlags::CURRENT | MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT;
        let locked = match &stat {
            _ if std::env::var_os(UNLOCKED_VARIABLE).is_some() => Locked::Done,
            // Within a limit, later allocations would be refused once the limit is reached.
            Some(_) if !is_unlimited() || mlockall(all).is_err() => Locked::From(SETTLED),
            _ => Locked::Done,
        };
        Self { stat, faults: 0, beats: 0, pause: [0, 1], locked }
    }

    /// Checks the memory at each heartbeat, between two ticks.
    pub fn tend(&mut self) {
        let Some(stat) = &self.stat else { return };
        self.beats = self.beats.saturating_add(1);
        self.pause[0] = self.pause[0].saturating_sub(1);
        if self.pause[0] == 0 {
            let now = faults(stat).unwrap_or(self.faults);
            if now > self.faults {
                populate();
                // Populating itself has caused faults.
                self.faults = faults(stat).unwrap_or(now);
                let next = self.pause[1];
                self.pause = [next, (2 * next).min(PAUSE_MAX)];
            } else {
                self.pause = [0, 1];
            }
        }
        self.locked = match self.locked {
            Locked::From(beat) if self.beats >= beat && maps::forget_use() => Locked::Since(self.beats),
            Locked::From(beat) if self.beats >= beat => Locked::Done,
            Locked::Since(beat) if self.beats >= beat + OBSERVED => {
                lock_used();
                Locked::Done
            }
            locked => locked,
        };
    }
}

/// Whether this process may lock as much as it likes.
fn is_unlimited() -> bool {
    let may = capabilities(None).is_ok_and(|sets| sets.effective.contains(CapabilitySet::IPC_LOCK));
    may || getrlimit(Resource::Memlock).current.is_none()
}

/// Minor and major page faults of this process and its threads.
fn faults(stat: &File) -> Option<u64> {
    let mut line = [0; 1024];
    let len = stat.read_at(&mut line, 0).ok()?;
    let (_, fields) = std::str::from_utf8(&line[..len]).ok()?.rsplit_once(") ")?;
    // The state is field 3; minor faults are field 10, major ones 12.
    let mut fields = fields.split(' ').skip(7).step_by(2).map_while(|field| field.parse::<u64>().ok());
    Some(fields.next()? + fields.next()?)
}

/// Touches the memory that ticks may write, and the memory that others have written for them.
fn populate() {
    for mapping in maps::read("/proc/self/maps") {
        match mapping.kind {
            Kind::Own => advise(&mapping.range(), Advice::LinuxPopulateWrite),
            Kind::Segment { writable } => {
                let advice = if writable { Advice::LinuxPopulateWrite } else { Advice::LinuxPopulateRead };
                segments_in_use(&mapping).iter().for_each(|range| advise(range, advice));
            }
            Kind::Other => {}
        }
    }
}

/// Populating is best effort: with an old kernel or full shared memory a page waits for its first touch.
fn advise(range: &std::ops::Range<usize>, advice: Advice) {
    // SAFETY: the advice changes no content, and a range that is no longer mapped is refused.
    let _ = unsafe { madvise(std::ptr::without_provenance_mut::<c_void>(range.start), range.len(), advice) };
}

/// The parts of a segment that are in memory. Space for frames that were never sent uses no memory, and stays
/// that way.
fn segments_in_use(mapping: &Mapping) -> Vec<std::ops::Range<usize>> {
    let mut ranges = Vec::new();
    let Ok(file) = File::open(&mapping.path) else { return ranges };
    let end = mapping.offset + mapping.len as u64;
    let mut at = mapping.offset;
    while let Ok(from) = rustix::fs::seek(&file, SeekFrom::Data(at)) {
        let Ok(to) = rustix::fs::seek(&file, SeekFrom::Hole(from)) else { break };
        if from >= end || to <= from {
            break;
        }
        let to = to.min(end).next_multiple_of(rustix::param::page_size() as u64).min(end);
        let address = |offset: u64| mapping.start + (offset - mapping.offset) as usize;
        ranges.push(address(from)..address(to));
        at = to;
    }
    ranges
}

/// Locks the most-used mappings of the last ticks, within the limit, and logs the rest once.
fn lock_used() {
    let Some(limit) = getrlimit(Resource::Memlock).current else { return };
    let used: Vec<Mapping> =
        maps::read("/proc/self/smaps").into_iter().filter(|mapping| mapping.used > 0).collect();
    let (locked, left) = maps::within(used, usize::try_from(limit).unwrap_or(usize::MAX), |mapping| {
        let start = std::ptr::without_provenance_mut::<c_void>(mapping.start);
        // SAFETY: locking changes no content, and a range that is no longer mapped is refused.
        unsafe { mlock_with(start, mapping.len, MlockFlags::ONFAULT) }.is_ok()
    });
    tracing::info!(
        "memory: locked mappings of which a tick uses {} KiB, left {} KiB: the limit is {} KiB (ulimit -l)",
        locked >> 10,
        left >> 10,
        limit >> 10
    );
}
