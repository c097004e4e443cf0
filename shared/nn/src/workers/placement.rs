use rustix::thread::{CpuSet, Pid, sched_getaffinity, sched_getcpu, sched_setaffinity};

/// Keeps sleeping workers off the processor on which their caller runs.
///
/// A scheduler prefers to wake a thread on the processor on which it ran last. The caller may compute there,
/// and in many virtual machines the processors are not known to share a cache. The two threads then alternate
/// for some milliseconds while other processors are idle.
pub(super) struct Placement {
    /// `None` if the processors are unknown, or there is only one.
    allowed: Option<CpuSet>,
    threads: Vec<Pid>,
    /// The processor that the workers avoid.
    taken: Option<usize>,
}

impl Placement {
    /// The placement of threads on the processors that the caller's thread may use.
    pub(super) fn new(threads: Vec<Pid>) -> Self {
        let allowed = sched_getaffinity(None).ok().filter(|allowed| allowed.count() > 1);
        Self { allowed, threads, taken: None }
    }

    /// Moves the workers off the processor of this thread. If that is not allowed, they stay.
    pub(super) fn keep_off(&mut self) {
        let Some(allowed) = self.allowed.filter(|_| !self.threads.is_empty()) else { return };
        let here = sched_getcpu();
        if self.taken == Some(here) {
            return;
        }
        self.taken = Some(here);
        let mut others = allowed;
        if here < CpuSet::MAX_CPU {
            others.unset(here);
        }
        for &thread in &self.threads {
            let _ = sched_setaffinity(Some(thread), &others);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_is_kept_off_the_callers_processor() {
        let (to_test, tid) = std::sync::mpsc::sync_channel(1);
        let (end, ended) = std::sync::mpsc::sync_channel::<()>(1);
        let thread = std::thread::spawn(move || {
            to_test.send(rustix::thread::gettid()).unwrap();
            // Wait for the end of the test.
            let _ = ended.recv();
        });
        let tid = tid.recv().unwrap();
        let before = sched_getaffinity(None).unwrap();
        let mut placement = Placement::new(vec![tid]);
        placement.keep_off();
        let now = sched_getaffinity(Some(tid)).unwrap();
        if before.count() > 1 {
            assert_eq!(now.count(), before.count() - 1);
            assert!(!now.is_set(placement.taken.unwrap()));
        } else {
            assert_eq!(now.count(), 1);
        }
        drop(end);
        thread.join().unwrap();
    }
}
