//! Log lines about links, at most one in ten seconds.

use std::time::{Duration, Instant};

use crate::counts::Counts;

/// Time between two lines.
const INTERVAL: Duration = Duration::from_secs(10);

/// Logs the counts when connections were refused or lost.
#[derive(Debug)]
pub struct Report {
    next: Instant,
    troubles: u64,
}

impl Report {
    /// Nothing has been logged.
    #[must_use]
    pub fn new(now: Instant) -> Self {
        Self { next: now + INTERVAL, troubles: 0 }
    }

    /// Logs the counts and what `more` adds, if there is something new.
    pub fn log(&mut self, counts: &Counts, more: impl FnOnce() -> String) {
        let troubles = counts.troubles();
        if troubles > self.troubles && Instant::now() >= self.next {
            (self.troubles, self.next) = (troubles, Instant::now() + INTERVAL);
            tracing::warn!("{counts}{}", more());
        }
    }
}
