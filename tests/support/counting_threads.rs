//! An allocator that counts what some threads allocate, each for itself; allocations of one size apart from all others.
#![expect(unsafe_code, reason = "a counting allocator")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Most threads that are counted.
const THREADS_MAX: usize = 8;

struct Counting;

/// Allocations of the size that is counted apart, and of all others.
static ALLOCATIONS: [[AtomicUsize; 2]; THREADS_MAX] =
    [const { [const { AtomicUsize::new(0) }; 2] }; THREADS_MAX];
/// The size that is counted apart.
static APART: AtomicUsize = AtomicUsize::new(usize::MAX);
/// Size of the last allocation that was not.
static LAST: AtomicUsize = AtomicUsize::new(0);

thread_local! {
    /// Which count a thread adds to, if it is counted.
    static PLACE: Cell<Option<usize>> = const { Cell::new(None) };
}

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // A thread that is about to end has no place any more.
        if let Some(place) = PLACE.try_with(Cell::get).ok().flatten() {
            let is_apart = layout.size() == APART.load(Ordering::Relaxed);
            ALLOCATIONS[place][usize::from(!is_apart)].fetch_add(1, Ordering::Relaxed);
            if !is_apart {
                LAST.store(layout.size(), Ordering::Relaxed);
            }
        }
        // SAFETY: the caller's promises are those that the system's allocator asks for.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above; the pointer came from `alloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// From now on this thread is counted, at that place.
pub fn count_as(place: usize) {
    PLACE.set(Some(place));
}

/// Allocations of that many bytes are counted apart from now on.
pub fn count_apart(bytes: usize) {
    APART.store(bytes, Ordering::Relaxed);
}

/// Bytes of the newest allocation that was not counted apart.
pub fn newest_bytes() -> usize {
    LAST.load(Ordering::Relaxed)
}

/// Allocations of the counted threads while `work` runs, by place: those counted apart, and all others.
pub fn allocations(work: impl FnOnce()) -> [[usize; 2]; THREADS_MAX] {
    let now = || ALLOCATIONS.each_ref().map(|of| of.each_ref().map(|count| count.load(Ordering::Relaxed)));
    let before = now();
    work();
    let after = now();
    std::array::from_fn(|place| [0, 1].map(|kind| after[place][kind] - before[place][kind]))
}
