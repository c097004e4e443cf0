//! Work shared among threads, with results in the order of the items.

/// What `work` makes of each item; every thread has a memory of its own.
///
/// The result of an item must not depend on what its memory saw before: then it is the same for any number of threads.
pub(crate) fn each<T: Sync, R: Send, M: Default>(
    items: &[T],
    threads: usize,
    work: impl Fn(&T, &mut M) -> R + Sync,
) -> Vec<R> {
    let threads = threads.clamp(1, items.len().max(1));
    let share = |number: usize| {
        let mut memory = M::default();
        items.iter().skip(number).step_by(threads).map(|item| work(item, &mut memory)).collect::<Vec<R>>()
    };
    let share = &share;
    let mut shares: Vec<_> = std::thread::scope(|scope| {
        let handles: Vec<_> = (1..threads).map(|number| scope.spawn(move || share(number))).collect();
        let first = share(0);
        let others = handles.into_iter().map(|handle| match handle.join() {
            Ok(results) => results,
            Err(panic) => std::panic::resume_unwind(panic),
        });
        std::iter::once(first).chain(others).map(Vec::into_iter).collect()
    });
    (0..items.len()).filter_map(|item| shares[item % threads].next()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_come_in_the_order_of_the_items_for_any_number_of_threads() {
        let items: Vec<u64> = (0..37).collect();
        let expected: Vec<u64> = items.iter().map(|x| x * x).collect();
        for threads in [0, 1, 2, 3, 64] {
            assert_eq!(each(&items, threads, |x, _: &mut ()| x * x), expected, "{threads} threads");
        }
        assert!(each(&[] as &[u64], 2, |x, _: &mut ()| *x).is_empty());
    }
}
