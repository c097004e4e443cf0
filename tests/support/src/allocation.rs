//! An allocator that counts.
#![expect(unsafe_code, reason = "a counting allocator")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Maximum number of threads with separate counts.
pub const THREADS_MAX: usize = 8;

/// The system's allocator with counters.
///
/// ```
/// #[global_allocator]
/// static ALLOCATOR: testing::CountingAllocator = testing::CountingAllocator;
///
/// assert_eq!(testing::allocations(|| drop(Vec::<u8>::with_capacity(3))), 1);
/// ```
///
/// A test that counts must be the only test of its program, because allocations of other tests would count
/// too.
#[derive(Clone, Copy, Debug)]
pub struct CountingAllocator;

/// Allocations of all threads.
static ALL: AtomicUsize = AtomicUsize::new(0);
/// Allocations of registered threads: \[separate size, all other sizes\].
static OF_THREADS: [[AtomicUsize; 2]; THREADS_MAX] =
    [const { [const { AtomicUsize::new(0) }; 2] }; THREADS_MAX];
/// The size whose allocations are counted separately.
static APART: AtomicUsize = AtomicUsize::new(usize::MAX);
/// Size of a registered thread's last allocation that did not have the separate size.
static LAST: AtomicUsize = AtomicUsize::new(0);

thread_local! {
    /// The index of the thread's count, if the thread is registered.
    static PLACE: Cell<Option<usize>> = const { Cell::new(None) };
}

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALL.fetch_add(1, Ordering::Relaxed);
        // A thread that is about to end has no index any more.
        if let Some(place) = PLACE.try_with(Cell::get).ok().flatten() {
            let is_apart = layout.size() == APART.load(Ordering::Relaxed);
            OF_THREADS[place][usize::from(!is_apart)].fetch_add(1, Ordering::Relaxed);
            if !is_apart {
                LAST.store(layout.size(), Ordering::Relaxed);
            }
        }
        // SAFETY: the caller keeps the contract of `GlobalAlloc`, which is also the contract of the system's
        // allocator.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above. The pointer came from `alloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// Returns the number of allocations of all threads while `work` runs; 0 if the program's allocator is not
/// [`CountingAllocator`].
pub fn allocations(work: impl FnOnce()) -> usize {
    let before = ALL.load(Ordering::Relaxed);
    work();
    ALL.load(Ordering::Relaxed) - before
}

/// Separate counts of the registered threads.
#[derive(Clone, Copy, Debug)]
pub struct AllocationCounts;

impl AllocationCounts {
    /// Registers this thread under an index below [`THREADS_MAX`].
    pub fn count_as(place: usize) {
        PLACE.set(Some(place));
    }

    /// Counts allocations of this size separately from now on.
    pub fn count_apart(bytes: usize) {
        APART.store(bytes, Ordering::Relaxed);
    }

    /// Size of the newest allocation that did not have the separate size.
    #[must_use]
    pub fn newest_bytes() -> usize {
        LAST.load(Ordering::Relaxed)
    }

    /// Returns the allocations of the registered threads while `work` runs, by index: \[separate size, all
    /// other sizes\].
    pub fn during(work: impl FnOnce()) -> [[usize; 2]; THREADS_MAX] {
        let now = || OF_THREADS.each_ref().map(|of| of.each_ref().map(|count| count.load(Ordering::Relaxed)));
        let before = now();
        work();
        let after = now();
        std::array::from_fn(|place| [0, 1].map(|kind| after[place][kind] - before[place][kind]))
    }
}
