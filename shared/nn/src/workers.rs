//! A small pool of threads that run as long as their stage and share a step's rows.
//!
//! Each worker owns a job: inputs, outputs and scratch memory. The caller fills the jobs, [`Workers::run`]
//! runs them all at once (the first on the caller's own thread) and returns when the last is done. Nothing is
//! allocated by a run.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use thiserror::Error;

use crate::WeightsError;

/// Most threads that a stage may share its rows over.
pub const WORKERS_MAX: usize = 64;

/// Why a stage that runs the network on workers can't start.
#[derive(Debug, Error)]
pub enum StartError {
    /// The weights do not hold the model.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// The operating system refused a thread.
    #[error("can't start a worker: {0}")]
    Thread(#[from] std::io::Error),
}

/// A share of a step's work with all the memory that it needs.
pub trait Job: Send + 'static {
    /// Does the work.
    fn run(&mut self);
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    Idle,
    Ready,
    Stopping,
    /// The job panicked.
    Broken,
}

struct Slot<J> {
    state: Mutex<(J, Phase)>,
    changed: Condvar,
}

/// Jobs and the threads that run them.
pub struct Workers<J: Job> {
    slots: Vec<Arc<Slot<J>>>,
    threads: Vec<JoinHandle<()>>,
}

/// Marks the job as panicked unless it ended.
struct Watch<'a, J> {
    slot: &'a Slot<J>,
    finished: bool,
}

impl<J> Drop for Watch<'_, J> {
    fn drop(&mut self) {
        if !self.finished {
            self.slot.lock().1 = Phase::Broken;
            self.slot.changed.notify_all();
        }
    }
}

impl<J> Slot<J> {
    /// A panic is reported by the phase, not by a poisoned lock.
    fn lock(&self) -> MutexGuard<'_, (J, Phase)> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait_while(&self, phase: Phase) -> MutexGuard<'_, (J, Phase)> {
        let state = self.lock();
        self.changed.wait_while(state, |(_, now)| *now == phase).unwrap_or_else(PoisonError::into_inner)
    }
}

fn serve<J: Job>(slot: &Slot<J>) {
    loop {
        let mut watch = Watch { slot, finished: false };
        let mut state = slot.wait_while(Phase::Idle);
        if state.1 == Phase::Ready {
            state.0.run();
            state.1 = Phase::Idle;
        }
        let stopping = state.1 == Phase::Stopping;
        drop(state);
        watch.finished = true;
        slot.changed.notify_all();
        if stopping {
            return;
        }
    }
}

impl<J: Job> Workers<J> {
    /// A pool with a worker for each job; the first job runs on the caller's thread.
    ///
    /// # Errors
    /// Where the operating system refuses a thread.
    ///
    /// # Panics
    /// Where there is no job.
    pub fn new(jobs: impl IntoIterator<Item = J>) -> std::io::Result<Self> {
        let slot = |job| Arc::new(Slot { state: Mutex::new((job, Phase::Idle)), changed: Condvar::new() });
        let slots: Vec<_> = jobs.into_iter().map(slot).collect();
        assert!(!slots.is_empty(), "a pool needs a job");
        let mut pool = Self { slots, threads: Vec::new() };
        for (number, slot) in pool.slots.iter().enumerate().skip(1) {
            let slot = Arc::clone(slot);
            let name = format!("worker-{number}");
            pool.threads.push(std::thread::Builder::new().name(name).spawn(move || serve(&slot))?);
        }
        Ok(pool)
    }

    /// Jobs of the pool.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "a pool is never empty")]
    pub fn len(&self) -> usize {
        self.slots.len()
    }

    /// Calls `visit` with each job and its number, one after the other on this thread.
    pub fn each(&mut self, mut visit: impl FnMut(usize, &mut J)) {
        for (number, slot) in self.slots.iter().enumerate() {
            visit(number, &mut slot.lock().0);
        }
    }

    /// Runs all jobs and returns when the last is done.
    ///
    /// # Panics
    /// Where a job panicked.
    pub fn run(&mut self) {
        let (first, others) = self.slots.split_first().expect("a pool has a job");
        for slot in others {
            slot.lock().1 = Phase::Ready;
            slot.changed.notify_all();
        }
        first.lock().0.run();
        for slot in others {
            let broken = slot.wait_while(Phase::Ready).1 == Phase::Broken;
            assert!(!broken, "a worker panicked");
        }
    }
}

impl<J: Job> Drop for Workers<J> {
    fn drop(&mut self) {
        for slot in &self.slots {
            slot.lock().1 = Phase::Stopping;
            slot.changed.notify_all();
        }
        for thread in self.threads.drain(..) {
            // The panic of a worker has been reported already.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Square(Vec<u64>, bool);

    impl Job for Square {
        fn run(&mut self) {
            assert!(!self.1, "asked to break");
            self.0.iter_mut().for_each(|x| *x *= *x);
        }
    }

    #[test]
    fn every_job_runs_once_a_call() {
        let mut pool = Workers::new((0..3).map(|i| Square(vec![i + 2; 4], false))).unwrap();
        pool.run();
        pool.run();
        let mut seen = Vec::new();
        pool.each(|_, job| seen.extend_from_slice(&job.0[..1]));
        assert_eq!(seen, [16, 81, 256]);
    }

    #[test]
    #[should_panic(expected = "a worker panicked")]
    fn a_panic_of_a_worker_reaches_the_caller() {
        let mut pool = Workers::new((0..2).map(|i| Square(Vec::new(), i == 1))).unwrap();
        pool.run();
    }
}
