//! A small pool of threads that run as long as their stage and share a step's work.
//!
//! A step's work is cut into blocks that depend on nothing but the step's input. Each worker, the stage's own
//! thread first among them, takes the next block until there is none left: a worker whose processor is busy
//! with something else takes fewer, or none, and nobody waits for more than the block that it has begun.
//! Nothing is allocated by a run.
//!
//! A worker that has nothing to do sleeps, and spins no longer than the lock that it sleeps on (about a
//! microsecond): stages outnumber processors on most machines, and who spins there takes the processor from
//! the one that is waited for.

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

/// Most threads that a stage may share its work over.
pub const WORKERS_MAX: usize = 64;
/// Most threads of a stage that was not told how many.
const DEFAULT_MAX: usize = 4;

/// Why a stage that runs the network on workers can't start.
#[derive(Debug, Error)]
pub enum StartError {
    /// The weights do not hold the model.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// This process can't compute in the precision that was asked for.
    #[error(transparent)]
    Precision(#[from] PrecisionError),
    /// The operating system refused a thread.
    #[error("can't start a worker: {0}")]
    Thread(#[from] std::io::Error),
}

/// Threads of a stage that was not told how many: the processors that this process may use by its affinity
/// and the quota of its cgroup, at most 4.
#[must_use]
pub fn default_workers() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from).min(DEFAULT_MAX)
}

/// A worker's own memory: scratch, and the results of the blocks that it did.
pub trait Job: Send + 'static {
    /// What all workers read in a step.
    type Input: Send + Sync;

    /// Does a block of the step's work, and remembers with its results which.
    fn run(&mut self, input: &Self::Input, block: usize);
}

/// Until when blocks are begun, and the clock that tells.
#[derive(Clone, Copy, Debug)]
pub struct Deadline {
    /// The time on `clock`.
    pub until_ns: u64,
    /// Returns the time; never goes back.
    pub clock: fn() -> u64,
}

/// The step in hand.
struct Step<I> {
    input: RwLock<I>,
    deadline: RwLock<Option<Deadline>>,
    /// The longest that a block of the step has taken.
    block_ns: AtomicU64,
    /// The next block to be taken, and how many there are.
    next: AtomicUsize,
    blocks_len: AtomicUsize,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// The thread is not there yet.
    Starting,
    Idle,
    Ready,
    Stopping,
    /// The job panicked.
    Broken,
}

struct Slot<J> {
    /// Held by the worker while it works.
    state: Mutex<(J, Phase)>,
    changed: Condvar,
    /// The worker's thread, once it is there.
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

/// Marks the job as panicked unless it ended.
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

    /// Does blocks until there is none left, or no time.
    fn work<J: Job<Input = I>>(&self, job: &mut J) {
        let input = self.read();
        let deadline = *self.deadline.read().unwrap_or_else(PoisonError::into_inner);
        let blocks_len = self.blocks_len.load(Ordering::Relaxed);
        loop {
            let block = self.next.fetch_add(1, Ordering::Relaxed);
            if block >= blocks_len {
                return;
            }
            match deadline {
                Some(deadline) if !self.run_in_time(job, &input, block, deadline) => {
                    // Nobody else is to begin one: those that follow count for less.
                    self.next.store(blocks_len, Ordering::Relaxed);
                    return;
                }
                Some(_) => {}
                None => job.run(&input, block),
            }
        }
    }

    /// Does a block if one as long as the longest so far ends in time, and the first in any case.
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
    /// A panic is reported by the phase, not by a poisoned lock.
    fn lock(&self) -> MutexGuard<'_, (J, Phase)> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn serve<J: Job>(slot: &Slot<J>, step: &Step<J::Input>) {
    // Empty before: a thread begins once.
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
            blocks_len: AtomicUsize::new(0),
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
            // A thread that starts allocates: that is not to happen in a step.
            let starting = |(_, phase): &mut (J, Phase)| *phase == Phase::Starting;
            drop(slot.changed.wait_while(slot.lock(), starting).unwrap_or_else(PoisonError::into_inner));
        }
        pool.placement =
            Placement::new(pool.slots.iter().filter_map(|slot| slot.thread.get().copied()).collect());
        Ok(pool)
    }

    /// Jobs of the pool.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "a pool is never empty")]
    pub fn len(&self) -> usize {
        1 + self.slots.len()
    }

    /// What the workers will read in the next step.
    pub fn input(&mut self) -> RwLockWriteGuard<'_, J::Input> {
        self.step.write()
    }

    /// Calls `visit` with each job, one after the other on this thread.
    pub fn each(&mut self, mut visit: impl FnMut(&mut J)) {
        visit(&mut self.own);
        for slot in &self.slots {
            visit(&mut slot.lock().0);
        }
    }

    /// Does the blocks below `blocks_len` and returns when the last is done.
    ///
    /// # Panics
    /// If a job panicked.
    pub fn run(&mut self, blocks_len: usize) {
        self.run_until(blocks_len, None);
    }

    /// The same, but from the deadline on no block is begun, nor one that would not end before it if it took as
    /// long as the longest of the step so far. Blocks are begun in their order, and the first is always done.
    ///
    /// # Panics
    /// If a job panicked.
    pub fn run_until(&mut self, blocks_len: usize, deadline: Option<Deadline>) {
        *self.step.deadline.write().unwrap_or_else(PoisonError::into_inner) = deadline;
        self.step.block_ns.store(0, Ordering::Relaxed);
        self.step.next.store(0, Ordering::Relaxed);
        self.step.blocks_len.store(blocks_len, Ordering::Relaxed);
        // One block is this thread's: no more are woken than can find another.
        let woken = &self.slots[..self.slots.len().min(blocks_len.saturating_sub(1))];
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
            // A worker that has begun holds the lock to its end; one that has not is too late.
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
            // The panic of a worker has been reported already.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Squares numbers, a block each.
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
        for workers_len in 1..=4 {
            let mut pool = Workers::new(Vec::new(), (0..workers_len).map(|_| Square::default())).unwrap();
            for blocks_len in (0..200).map(|i| i % 9) {
                *pool.input() = (0..blocks_len as u64).map(|i| i + 2).collect();
                pool.run(blocks_len);
                let expected = (0..blocks_len).map(|i| (i, (i as u64 + 2).pow(2)));
                assert_eq!(squares(&mut pool), expected.collect::<Vec<_>>());
            }
        }
    }

    #[test]
    fn no_block_is_begun_that_would_end_too_late() {
        /// A clock that goes on by one with each look, so by two with each block.
        fn clock() -> u64 {
            static NOW: AtomicU64 = AtomicU64::new(0);
            NOW.fetch_add(1, Ordering::Relaxed)
        }
        let mut pool = Workers::new((2..22).collect(), [Square::default()]).unwrap();
        // Blocks begin at 0, 2, 4 … and are expected to take 1.
        pool.run_until(20, Some(Deadline { until_ns: 10, clock }));
        assert_eq!(
            squares(&mut pool).into_iter().map(|(block, _)| block).collect::<Vec<_>>(),
            [0, 1, 2, 3, 4]
        );
        // It is too late for all: the first is done, so that there is progress.
        pool.run_until(20, Some(Deadline { until_ns: 3, clock }));
        assert_eq!(squares(&mut pool), [(0, 4)]);
        pool.run(20);
        assert_eq!(squares(&mut pool).len(), 20, "without a deadline all are done");
    }

    /// Holds the first block until another worker has done the second.
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
        // The worker may come too late for a run, but not for all of them.
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
