//! Readers that come and go: processes beside the pipeline, such as a planner, that read its topics.
//!
//! The places of a dead reader on its topics stay occupied until a clean-up. The launcher did not start the
//! reader, so no exit status reports its death. [`Readers`] detects the death from the files of the reader's
//! node. The clean-up helper may find a dead node first, so it reports each node before it removes the files.
//! Each death is therefore counted exactly once.

use std::collections::BTreeMap;
use std::time::Duration;

use ports::{NodeNumber, NodeProcess, NodeWatch};
use run::Run;

use crate::cleaner::Cleaner;
use crate::error::Error;

/// Interval between checks. With the clean-up, a dead reader's places are free within a second.
const LOOK: Duration = Duration::from_millis(200);
/// Maximum number of clean-ups after one death. Some must wait until half-made files are old enough.
const TRIES_MAX: u32 = 8;
/// Pause before the second clean-up after a death. It doubles with each further one.
const PAUSE: Duration = Duration::from_millis(500);
/// Time for which a node is remembered after its files are gone. A killed helper may leave some files behind.
const KEPT: Duration = Duration::from_secs(10);
/// Time for which a process of the launcher is remembered after its end.
const OWN_KEPT: Duration = Duration::from_secs(60);
/// Deaths that are logged one by one.
const LOGGED_MAX: u64 = 10;
/// Of further deaths, one in this many is logged.
const LOGGED_EVERY: u64 = 100;

/// The dead readers of a run.
#[derive(Debug)]
pub struct Readers {
    watch: NodeWatch,
    looked: Duration,
    /// Dead nodes whose files are still there, or were a short time ago.
    dead: BTreeMap<NodeNumber, CleanUp>,
    /// Processes that the launcher has started, and when each was last seen. Their deaths do not count as deaths of
    /// readers.
    own: BTreeMap<u32, Duration>,
    deaths: u64,
}

/// The clean-up after a dead node.
#[derive(Clone, Copy, Debug)]
struct CleanUp {
    ticket: u64,
    tries: u32,
    next: Duration,
    /// When the node was last seen.
    seen: Duration,
    is_counted: bool,
}

/// A reader that has died.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeadReader {
    /// A description of the process, such as "planner (python3, process 4711)".
    pub process: String,
    /// Number among the run's dead readers, from 1.
    pub number: u64,
}

impl DeadReader {
    /// Whether this death is logged. Most deaths of a repeatedly dying reader are not.
    pub const fn is_logged(&self) -> bool {
        self.number <= LOGGED_MAX || self.number.is_multiple_of(LOGGED_EVERY)
    }
}

impl std::fmt::Display for DeadReader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "a reader has died: {}; dead readers of this run: {}", self.process, self.number)
    }
}

impl Readers {
    /// Creates the readers of a run.
    pub fn new(run: &Run) -> Result<Self, Error> {
        let (dead, own) = (BTreeMap::new(), BTreeMap::new());
        Ok(Self { watch: NodeWatch::new(run)?, looked: Duration::ZERO, dead, own, deaths: 0 })
    }

    /// Registers processes that the launcher has started and not replaced.
    pub fn own(&mut self, pids: impl IntoIterator<Item = u32>, now: Duration) {
        self.own.extend(pids.into_iter().map(|pid| (pid, now)));
    }

    /// Returns the number of dead readers.
    pub const fn deaths(&self) -> u64 {
        self.deaths
    }

    /// Returns the number of the clean-up that the dead nodes need.
    pub fn wanted(&self) -> u64 {
        self.dead.values().map(|clean_up| clean_up.ticket).max().unwrap_or(0)
    }

    /// Looks for dead nodes. Returns the readers among those that were not counted yet.
    pub fn look(&mut self, cleaner: &mut Cleaner, now: Duration) -> Vec<DeadReader> {
        let mut processes = cleaner.met();
        for &(number, _) in &processes {
            // The clean-up is over. If it failed, the next check retries.
            let clean_up = CleanUp { ticket: 0, tries: 0, next: now, seen: now, is_counted: false };
            self.dead.entry(number).or_insert(clean_up).seen = now;
        }
        if now.saturating_sub(self.looked) >= LOOK {
            self.looked = now;
            let dead = self.watch.dead();
            let new: Vec<NodeNumber> =
                dead.iter().copied().filter(|number| !self.dead.contains_key(number)).collect();
            self.request_clean_ups(&dead, cleaner, now);
            self.dead.retain(|_, clean_up| now.saturating_sub(clean_up.seen) < KEPT);
            self.own.retain(|_, seen| now.saturating_sub(*seen) < OWN_KEPT);
            if !new.is_empty() {
                processes.extend(self.watch.processes(&new));
            }
        }
        processes.into_iter().filter_map(|(number, process)| self.count(number, &process)).collect()
    }

    /// Requests a clean-up for each dead node without one, and for each node whose last clean-up failed.
    fn request_clean_ups(&mut self, dead: &[NodeNumber], cleaner: &Cleaner, now: Duration) {
        let ticket = cleaner.ticket();
        for &number in dead {
            let first = CleanUp { ticket, tries: 1, next: now + PAUSE, seen: now, is_counted: false };
            let clean_up = self.dead.entry(number).or_insert(first);
            clean_up.seen = now;
            if cleaner.is_done(clean_up.ticket) && now >= clean_up.next && clean_up.tries < TRIES_MAX {
                clean_up.next = now + PAUSE * 2_u32.pow(clean_up.tries);
                (clean_up.ticket, clean_up.tries) = (ticket, clean_up.tries + 1);
            }
        }
    }

    /// Counts a dead node, unless it was counted before or belongs to the launcher.
    fn count(&mut self, number: NodeNumber, process: &NodeProcess) -> Option<DeadReader> {
        let clean_up = self.dead.get_mut(&number)?;
        if std::mem::replace(&mut clean_up.is_counted, true) || self.own.contains_key(&process.pid) {
            return None;
        }
        self.deaths += 1;
        let process = format!("{} ({}, process {})", process.name, process.program, process.pid);
        Some(DeadReader { process, number: self.deaths })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reader_that_dies_again_and_again_has_few_lines() {
        let reader = |number| DeadReader { process: "planner (python3, process 7)".to_owned(), number };
        let logged: Vec<u64> = (1..=300).filter(|&number| reader(number).is_logged()).collect();
        assert_eq!(logged, [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 100, 200, 300]);
        assert_eq!(
            reader(23).to_string(),
            "a reader has died: planner (python3, process 7); dead readers of this run: 23"
        );
    }
}
