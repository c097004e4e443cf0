//! Readers that come and go: processes beside the pipeline, such as a planner, that read its topics.
//!
//! A reader that dies leaves its places on the topics taken until somebody cleans up after it. The launcher
//! did not start it, so that no exit status reports its death: [`Readers`] finds the death by the files of
//! its node. The clean-up's helper may meet a dead node first, and reports each one before it removes the
//! files. So every death is counted, and once.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use ports::{NodeNumber, NodeProcess, NodeWatch};
use run::Run;

use crate::cleaner::Cleaner;
use crate::failure::Failure;

/// Interval between looks. With the clean-up, a dead reader's places are free within a second.
const LOOK: Duration = Duration::from_millis(200);
/// Clean-ups that are tried after one death; some of them have to wait until half-made files are old.
const TRIES_MAX: u32 = 8;
/// Pause before the second clean-up after a death. It doubles with each further one.
const PAUSE: Duration = Duration::from_millis(500);
/// Time for which a node is remembered whose files are gone: a helper that was killed may leave some behind.
const KEPT: Duration = Duration::from_secs(10);
/// Deaths that are logged one by one.
const LOGGED_MAX: u64 = 10;
/// Of further deaths, one in so many is logged.
const LOGGED_EVERY: u64 = 100;

/// The dead readers of a run.
#[derive(Debug)]
pub struct Readers {
    watch: NodeWatch,
    looked: Duration,
    /// Dead nodes whose files are still there, or were a short time ago.
    dead: BTreeMap<NodeNumber, CleanUp>,
    /// Processes that the launcher has started: their deaths are no readers'.
    own: BTreeSet<u32>,
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
    /// The process in words, such as "planner (python3, process 4711)".
    pub process: String,
    /// Its number among the dead readers of the run, from 1.
    pub number: u64,
}

impl DeadReader {
    /// Whether it has a line in the log: one that dies again and again has few.
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
    /// Those of a run.
    pub fn new(run: &Run) -> Result<Self, Failure> {
        let (dead, own) = (BTreeMap::new(), BTreeSet::new());
        Ok(Self { watch: NodeWatch::new(run)?, looked: Duration::ZERO, dead, own, deaths: 0 })
    }

    /// Takes note of processes that the launcher has started.
    pub fn own(&mut self, pids: impl IntoIterator<Item = u32>) {
        self.own.extend(pids);
    }

    /// How many have died.
    pub const fn deaths(&self) -> u64 {
        self.deaths
    }

    /// The number of the clean-up that is wanted for the dead nodes.
    pub fn wanted(&self) -> u64 {
        self.dead.values().map(|clean_up| clean_up.ticket).max().unwrap_or(0)
    }

    /// Looks for nodes that have died; returns the readers among those that were not counted yet.
    pub fn look(&mut self, cleaner: &mut Cleaner, now: Duration) -> Vec<DeadReader> {
        let mut processes = cleaner.met();
        for &(number, _) in &processes {
            // Its clean-up is over. If that has failed, the next look tries again.
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
            if !new.is_empty() {
                processes.extend(self.watch.processes(&new));
            }
        }
        processes.into_iter().filter_map(|(number, process)| self.count(number, &process)).collect()
    }

    /// Requests a clean-up for each dead node that has none, and for each whose last one has failed.
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

    /// Counts a dead node, unless it was counted before or is a process of the launcher's.
    fn count(&mut self, number: NodeNumber, process: &NodeProcess) -> Option<DeadReader> {
        let clean_up = self.dead.get_mut(&number)?;
        if std::mem::replace(&mut clean_up.is_counted, true) || self.own.contains(&process.pid) {
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
