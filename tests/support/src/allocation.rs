//! An allocator that counts.
#![expect(unsafe_code, reason = "a counting allocator")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Most threads that can be counted apart.
pub const THREADS_MAX: usize = 8;

/// The system's allocator, which counts.
///
/// ```
/// #[global_allocator]
/// static ALLOCATOR: testing::CountingAllocator = testing::CountingAllocator;
///
/// assert_eq!(testing::allocations(|| drop(Vec::<u8>::with_capacity(3))), 1);
/// ```
///
/// A test that counts must be the only one of its program, as others would count as well.
#[derive(Clone, Copy, Debug)]
pub struct CountingAllocator;

/// Allocations of all threads.
static ALL: AtomicUsize = AtomicUsize::new(0);
/// Allocations of chosen threads: those of the size that is counted apart, and all others.
static OF_THREADS: [[AtomicUsize; 2]; THREADS_MAX] =
    [const { [const { AtomicUsize::new(0) }; 2] }; THREADS_MAX];
/// The size that is counted apart.
static APART: AtomicUsize = AtomicUsize::new(usize::MAX);
/// Size of the last allocation of a chosen thread that was not of that size.
static LAST: AtomicUsize = AtomicUsize::new(0);

thread_local! {
    /// Which count a thread adds to, if it is a chosen one.
    static PLACE: Cell<Option<usize>> = const { Cell::new(None) };
}

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALL.fetch_add(1, Ordering::Relaxed);
        // A thread that is about to end has no place any more.
        if let Some(place) = PLACE.try_with(Cell::get).ok().flatten() {
            let is_apart = layout.size() == APART.load(Ordering::Relaxed);
            OF_THREADS[place][usize::from(!is_apart)].fetch_add(1, Ordering::Relaxed);
            if !is_apart {
                LAST.store(layout.size(), Ordering::Relaxed);
            }
        }
        // SAFETY: the caller keeps the contract of `GlobalAlloc`, which is that of the system's allocator.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above; the pointer came from `alloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// Allocations of all threads while `work` runs; 0 in a program whose allocator is not [`CountingAllocator`].
pub fn allocations(work: impl FnOnce()) -> usize {
    let before = ALL.load(Ordering::Relaxed);
    work();
    ALL.load(Ordering::Relaxed) - before
}

/// Counts by thread, of the threads that registered.
#[derive(Clone, Copy, Debug)]
pub struct AllocationCounts;

impl AllocationCounts {
    /// From now on this thread is counted, at that place below [`THREADS_MAX`].
    pub fn count_as(place: usize) {
        PLACE.set(Some(place));
    }

    /// Allocations of that many bytes are counted apart from now on.
    pub fn count_apart(bytes: usize) {
        APART.store(bytes, Ordering::Relaxed);
    }

    /// Bytes of the newest allocation that was not counted apart.
    #[must_use]
    pub fn newest_bytes() -> usize {
        LAST.load(Ordering::Relaxed)
    }

    /// Allocations of the counted threads while `work` runs, by place: those counted apart, and all others.
    pub fn during(work: impl FnOnce()) -> [[usize; 2]; THREADS_MAX] {
        let now = || OF_THREADS.each_ref().map(|of| of.each_ref().map(|count| count.load(Ordering::Relaxed)));
        let before = now();
        work();
        let after = now();
        std::array::from_fn(|place| [0, 1].map(|kind| after[place][kind] - before[place][kind]))
    }
}
