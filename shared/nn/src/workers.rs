//! A small pool of threads that live as long as their stage and share a step's work.
//!
//! A step's work is split into blocks that depend only on the step's input. Each worker, including the
//! stage's own thread, takes the next block until none remains. A worker whose processor is busy takes fewer
//! blocks, or none. The step waits at most for the blocks that workers have already started. A run allocates
//! nothing.
//!
//! An idle worker sleeps. It spins only as long as its lock does (about a microsecond). Most machines have
//! fewer processors than stages, and a spinning worker would take the processor from the thread that it waits
//! for.

mod placement;

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{
    Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard,
};
use std::thread::JoinHandle;

use rustix::thread::{Pid, gettid};
use thiserror::Error;

use crate::{PrecisionError, WeightsError};
use placement::Placement;

/// Maximum number of threads that share a stage's work.
pub const WORKERS_MAX: usize = 64;
/// Maximum number of threads of a stage without a configured number.
const DEFAULT_MAX: usize = 4;

/// Why a stage with workers for the network can't start.
#[derive(Debug, Error)]
pub enum StartError {
    /// The weights do not contain the model.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// This process can't compute in the requested precision.
    #[error(transparent)]
    Precision(#[from] PrecisionError),
    /// The operating system refused a thread.
    #[error("can't start a worker: {0}")]
    Thread(#[from] std::io::Error),
}

/// Threads of a stage without a configured number: the processors that this process may use by its affinity
/// and its cgroup's quota, at most 4.
#[must_use]
pub fn default_workers() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from).min(DEFAULT_MAX)
}

/// A worker's own memory: scratch, and the results of its blocks.
pub trait Job: Send + 'static {
    /// The input of a step, which all workers read.
    type Input: Send + Sync;

    /// Processes a block of the step's work, and stores the block's number with its results.
    fn run(&mut self, input: &Self::Input, block: usize);
}

/// The time until which blocks are started, and the clock to compare it with.
#[derive(Clone, Copy, Debug)]
pub struct Deadline {
    /// The time on `clock`.
    pub until_ns: u64,
    /// Returns the time; must be monotonic.
    pub clock: fn() -> u64,
}

/// The current step.
struct Step<I> {
    input: RwLock<I>,
    deadline: RwLock<Option<Deadline>>,
    /// The longest duration of a block in this step.
    block_ns: AtomicU64,
    /// The next block, and the number of blocks.
    next: AtomicUsize,
    block_count: AtomicUsize,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// The thread has not started yet.
    Starting,
    Idle,
    Ready,
    Stopping,
    /// The job panicked.
    Broken,
}

struct Slot<J> {
    /// Locked by the worker while it works.
    state: Mutex<(J, Phase)>,
    changed: Condvar,
    /// The worker's thread, once it has started.
    thread: OnceLock<Pid>,
}

/// Jobs and the threads that run them.
pub struct Workers<J: Job> {
    step: Arc<Step<J::Input>>,
    /// The job of the caller's thread.
    own: J,
    slots: Vec<Arc<Slot<J>>>,
    threads: Vec<JoinHandle<()>>,
    placement: Placement,
}

/// Marks the job as panicked unless it has finished.
struct Watch<'a, J> {
    state: MutexGuard<'a, (J, Phase)>,
    finished: bool,
}

impl<J> Drop for Watch<'_, J> {
    fn drop(&mut self) {
        self.state.1 = if self.finished { Phase::Idle } else { Phase::Broken };
    }
}

impl<I> Step<I> {
    fn read(&self) -> RwLockReadGuard<'_, I> {
        self.input.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, I> {
        self.input.write().unwrap_or_else(PoisonError::into_inner)
    }

    /// Processes blocks until none remains or the time is over.
    fn work<J: Job<Input = I>>(&self, job: &mut J) {
        let input = self.read();
        let deadline = *self.deadline.read().unwrap_or_else(PoisonError::into_inner);
        let block_count = self.block_count.load(Ordering::Relaxed);
        loop {
            let block = self.next.fetch_add(1, Ordering::Relaxed);
            if block >= block_count {
                return;
            }
            match deadline {
                Some(deadline) if !self.run_in_time(job, &input, block, deadline) => {
                    // No other block may start: later blocks have lower priority.
                    self.next.store(block_count, Ordering::Relaxed);
                    return;
                }
                Some(_) => {}
                None => job.run(&input, block),
            }
        }
    }

    /// Processes a block if the longest duration so far still fits before the deadline. The first block is
    /// always processed.
    fn run_in_time<J: Job<Input = I>>(
        &self,
        job: &mut J,
        input: &I,
        block: usize,
        deadline: Deadline,
    ) -> bool {
        let Deadline { until_ns, clock } = deadline;
        let begin_ns = clock();
        let expected_ns = self.block_ns.load(Ordering::Relaxed);
        if block > 0 && begin_ns.saturating_add(expected_ns) >= until_ns {
            return false;
        }
        job.run(input, block);
        self.block_ns.fetch_max(clock().saturating_sub(begin_ns), Ordering::Relaxed);
        true
    }
}

impl<J> Slot<J> {
    /// The phase reports a panic, not a poisoned lock.
    fn lock(&self) -> MutexGuard<'_, (J, Phase)> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn serve<J: Job>(slot: &Slot<J>, step: &Step<J::Input>) {
    // The slot is empty: a thread starts once.
    let _ = slot.thread.set(gettid());
    let mut state = slot.lock();
    if state.1 == Phase::Starting {
        state.1 = Phase::Idle;
    }
    drop(state);
    slot.changed.notify_all();
    loop {
        let idle = |(_, phase): &mut (J, Phase)| *phase == Phase::Idle;
        let state = slot.changed.wait_while(slot.lock(), idle).unwrap_or_else(PoisonError::into_inner);
        if state.1 != Phase::Ready {
            return;
        }
        let mut watch = Watch { state, finished: false };
        step.work(&mut watch.state.0);
        watch.finished = true;
    }
}

impl<J: Job> Workers<J> {
    /// A pool with a worker for each job; the first job runs on the caller's thread.
    ///
    /// # Errors
    /// If the operating system refuses a thread.
    ///
    /// # Panics
    /// If there is no job.
    pub fn new(input: J::Input, jobs: impl IntoIterator<Item = J>) -> std::io::Result<Self>
    where
        J::Input: 'static,
    {
        let mut jobs = jobs.into_iter();
        let own = jobs.next().expect("a pool has a job");
        let slot = |job| {
            Arc::new(Slot {
                state: Mutex::new((job, Phase::Starting)),
                changed: Condvar::new(),
                thread: OnceLock::new(),
            })
        };
        let step = Step {
            input: RwLock::new(input),
            deadline: RwLock::new(None),
            block_ns: AtomicU64::new(0),
            next: AtomicUsize::new(0),
            block_count: AtomicUsize::new(0),
        };
        let slots = jobs.map(slot).collect();
        let placement = Placement::new(Vec::new());
        let mut pool = Self { step: Arc::new(step), own, slots, threads: Vec::new(), placement };
        for (number, slot) in pool.slots.iter().enumerate() {
            let (slot, step) = (Arc::clone(slot), Arc::clone(&pool.step));
            let name = format!("worker-{}", number + 1);
            pool.threads.push(std::thread::Builder::new().name(name).spawn(move || serve(&slot, &step))?);
        }
        for slot in &pool.slots {
            // A starting thread allocates, which must not happen within a step.
            let starting = |(_, phase): &mut (J, Phase)| *phase == Phase::Starting;
            drop(slot.changed.wait_while(slot.lock(), starting).unwrap_or_else(PoisonError::into_inner));
        }
        pool.placement =
            Placement::new(pool.slots.iter().filter_map(|slot| slot.thread.get().copied()).collect());
        Ok(pool)
    }

    /// The input of the next step, for writing.
    pub fn input(&mut self) -> RwLockWriteGuard<'_, J::Input> {
        self.step.write()
    }

    /// Calls `visit` with each job in turn, on this thread.
    pub fn each(&mut self, mut visit: impl FnMut(&mut J)) {
        visit(&mut self.own);
        for slot in &self.slots {
            visit(&mut slot.lock().0);
        }
    }

    /// Processes the blocks below `block_count`; returns when the last is finished.
    ///
    /// # Panics
    /// If a job has panicked.
    pub fn run(&mut self, block_count: usize) {
        self.run_until(block_count, None);
    }

    /// As [`Workers::run`], but starts no block after the deadline, and no block that would end after it. The
    /// estimate for a block is the longest duration in this step so far. Blocks start in order, and the first
    /// is always processed.
    ///
    /// # Panics
    /// If a job has panicked.
    pub fn run_until(&mut self, block_count: usize, deadline: Option<Deadline>) {
        *self.step.deadline.write().unwrap_or_else(PoisonError::into_inner) = deadline;
        self.step.block_ns.store(0, Ordering::Relaxed);
        self.step.next.store(0, Ordering::Relaxed);
        self.step.block_count.store(block_count, Ordering::Relaxed);
        // One block is for this thread, so at most one worker per other block is woken.
        let woken = &self.slots[..self.slots.len().min(block_count.saturating_sub(1))];
        if !woken.is_empty() {
            self.placement.keep_off();
        }
        for slot in woken {
            let mut state = slot.lock();
            assert!(state.1 == Phase::Idle, "a worker panicked");
            state.1 = Phase::Ready;
            drop(state);
            slot.changed.notify_one();
        }
        self.step.work(&mut self.own);
        for slot in woken {
            // A worker that has started holds the lock until it ends; one that has not is too late.
            let mut state = slot.lock();
            assert!(state.1 != Phase::Broken, "a worker panicked");
            state.1 = Phase::Idle;
        }
    }
}

impl<J: Job> Drop for Workers<J> {
    fn drop(&mut self) {
        for slot in &self.slots {
            slot.lock().1 = Phase::Stopping;
            slot.changed.notify_one();
        }
        for thread in self.threads.drain(..) {
            // The worker's panic has already been reported.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Squares numbers, one per block.
    #[derive(Default)]
    struct Square {
        done: Vec<(usize, u64)>,
        breaks: bool,
    }

    impl Job for Square {
        type Input = Vec<u64>;

        fn run(&mut self, input: &Vec<u64>, block: usize) {
            assert!(!self.breaks, "asked to break");
            self.done.push((block, input[block] * input[block]));
        }
    }

    fn squares(pool: &mut Workers<Square>) -> Vec<(usize, u64)> {
        let mut done = Vec::new();
        pool.each(|job| done.append(&mut job.done));
        done.sort_unstable();
        done
    }

    #[test]
    fn every_block_is_done_once_in_every_run() {
        for worker_count in 1..=4 {
            let mut pool = Workers::new(Vec::new(), (0..worker_count).map(|_| Square::default())).unwrap();
            for block_count in (0..200).map(|i| i % 9) {
                *pool.input() = (0..block_count as u64).map(|i| i + 2).collect();
                pool.run(block_count);
                let expected = (0..block_count).map(|i| (i, (i as u64 + 2).pow(2)));
                assert_eq!(squares(&mut pool), expected.collect::<Vec<_>>());
            }
        }
    }

    #[test]
    fn no_block_is_begun_that_would_end_too_late() {
        /// A clock that advances by one per reading, and so by two per block.
        fn clock() -> u64 {
            static NOW: AtomicU64 = AtomicU64::new(0);
            NOW.fetch_add(1, Ordering::Relaxed)
        }
        let mut pool = Workers::new((2..22).collect(), [Square::default()]).unwrap();
        // Blocks start at 0, 2, 4 … and have an estimated duration of 1.
        pool.run_until(20, Some(Deadline { until_ns: 10, clock }));
        assert_eq!(
            squares(&mut pool).into_iter().map(|(block, _)| block).collect::<Vec<_>>(),
            [0, 1, 2, 3, 4]
        );
        // The deadline is too early for all blocks. The first is processed, so that there is progress.
        pool.run_until(20, Some(Deadline { until_ns: 3, clock }));
        assert_eq!(squares(&mut pool), [(0, 4)]);
        pool.run(20);
        assert_eq!(squares(&mut pool).len(), 20, "without a deadline all are done");
    }

    /// Holds the first block until another worker has processed the second.
    struct Meet(Arc<(Mutex<bool>, Condvar)>);

    impl Job for Meet {
        type Input = ();

        fn run(&mut self, (): &(), block: usize) {
            let (met, changed) = &*self.0;
            let met = met.lock().unwrap();
            if block == 0 {
                drop(changed.wait_while(met, |met| !*met).unwrap());
            } else {
                *{ met } = true;
                changed.notify_all();
            }
        }
    }

    #[test]
    fn blocks_are_done_at_the_same_time() {
        let meeting = Arc::new((Mutex::new(false), Condvar::new()));
        Workers::new((), (0..2).map(|_| Meet(Arc::clone(&meeting)))).unwrap().run(2);
        assert!(*meeting.0.lock().unwrap());
    }

    #[test]
    #[should_panic(expected = "a worker panicked")]
    fn a_panic_of_a_worker_reaches_the_caller() {
        let mut pool =
            Workers::new(vec![2; 8], (0..2).map(|i| Square { breaks: i == 1, ..Square::default() })).unwrap();
        // The worker may be late for one run, but not for all of them.
        loop {
            pool.run(8);
            std::thread::yield_now();
        }
    }

    #[test]
    fn the_default_is_what_the_process_may_use() {
        let allowed = std::thread::available_parallelism().unwrap().get();
        assert_eq!(default_workers(), allowed.min(4));
    }
}
