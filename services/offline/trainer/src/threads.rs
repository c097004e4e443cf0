//! Shares parts of work among threads.

use crate::TrainError;

/// Calls `work` with the number and the part of every part, each on its own thread, the first on this one.
/// The results are in the order of the parts.
pub(crate) fn each<T: Sync, R: Send>(
    parts: &[T],
    work: impl Fn(usize, &T) -> Result<R, TrainError> + Sync,
) -> Result<Vec<R>, TrainError> {
    let work = &work;
    std::thread::scope(|scope| {
        let mut numbered = parts.iter().enumerate();
        let first = numbered.next();
        let others: Vec<_> = numbered.map(|(number, part)| scope.spawn(move || work(number, part))).collect();
        let first = first.map(|(number, part)| work(number, part));
        let others = others.into_iter().map(|thread| thread.join().expect("the part's thread panicked"));
        first.into_iter().chain(others).collect()
    })
}
