//! Shares work among threads. Results are in the order of the items.

/// Calls `work` on each item and returns the results. Each thread has its own memory.
///
/// A result must not depend on the memory's earlier contents. Then any number of threads gives the same
/// results.
pub fn each<T: Sync, R: Send, M: Default + Send>(
    items: &[T],
    threads: usize,
    work: impl Fn(&T, &mut M) -> R + Sync,
) -> Vec<R> {
    let mut memories: Vec<M> = (0..threads.clamp(1, items.len().max(1))).map(|_| M::default()).collect();
    each_with(items, &mut memories, work)
}

/// As [`each`], with one thread per memory; at least one is needed.
pub fn each_with<T: Sync, R: Send, M: Send>(
    items: &[T],
    memories: &mut [M],
    work: impl Fn(&T, &mut M) -> R + Sync,
) -> Vec<R> {
    let threads = memories.len();
    let share = |number: usize, memory: &mut M| {
        items.iter().skip(number).step_by(threads).map(|item| work(item, memory)).collect::<Vec<R>>()
    };
    let share = &share;
    let (first, others) = memories.split_first_mut().expect("a thread's memory");
    let mut shares: Vec<_> = std::thread::scope(|scope| {
        let others = (1..).zip(others);
        let handles: Vec<_> =
            others.map(|(number, memory)| scope.spawn(move || share(number, memory))).collect();
        let first = share(0, first);
        std::iter::once(first).chain(handles.into_iter().map(joined)).map(Vec::into_iter).collect()
    });
    (0..items.len()).filter_map(|item| shares[item % threads].next()).collect()
}

/// The thread's result; resumes its panic if it panicked.
pub(crate) fn joined<R>(handle: std::thread::ScopedJoinHandle<'_, R>) -> R {
    handle.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_keep_the_order_of_items_for_any_thread_count() {
        let items: Vec<u64> = (0..37).collect();
        let expected: Vec<u64> = items.iter().map(|x| x * x).collect();
        for threads in [0, 1, 2, 3, 64] {
            assert_eq!(each(&items, threads, |x, _: &mut ()| x * x), expected, "{threads} threads");
        }
        assert!(each(&[] as &[u64], 2, |x, _: &mut ()| *x).is_empty());
    }
}
