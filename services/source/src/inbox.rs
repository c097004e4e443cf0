//! Messages on their way from a network's threads to the stage.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A queue that never delays its writers: when it is full, the oldest message is dropped.
#[derive(Debug)]
pub struct Inbox<T> {
    state: Mutex<State<T>>,
    arrived: Condvar,
    len_max: usize,
}

#[derive(Debug)]
struct State<T> {
    messages: VecDeque<T>,
    dropped: u64,
    is_closed: bool,
}

impl<T> Inbox<T> {
    /// An empty queue for at most `len_max` messages.
    #[must_use]
    pub fn new(len_max: usize) -> Self {
        let state = State { messages: VecDeque::with_capacity(len_max), dropped: 0, is_closed: false };
        Self { state: Mutex::new(state), arrived: Condvar::new(), len_max }
    }

    fn state(&self) -> MutexGuard<'_, State<T>> {
        // Every change is whole before a panic can happen.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a message; `false` if the queue is closed.
    pub fn push(&self, message: T) -> bool {
        let mut state = self.state();
        if state.is_closed {
            return false;
        }
        if state.messages.len() == self.len_max {
            state.messages.pop_front();
            state.dropped += 1;
        }
        state.messages.push_back(message);
        drop(state);
        self.arrived.notify_all();
        true
    }

    /// Takes all messages. Waits at most `timeout` for the first.
    pub fn take(&self, timeout: Duration) -> VecDeque<T> {
        let is_idle = |state: &mut State<T>| state.messages.is_empty() && !state.is_closed;
        let waited = self.arrived.wait_timeout_while(self.state(), timeout, is_idle);
        std::mem::take(&mut waited.unwrap_or_else(PoisonError::into_inner).0.messages)
    }

    /// Number of messages that were dropped.
    pub fn dropped(&self) -> u64 {
        self.state().dropped
    }

    /// Whether further messages are refused.
    pub fn is_closed(&self) -> bool {
        self.state().is_closed
    }

    /// Waits until the queue is closed, at most `timeout`.
    pub fn wait_closed(&self, timeout: Duration) {
        let is_open = |state: &mut State<T>| !state.is_closed;
        drop(self.arrived.wait_timeout_while(self.state(), timeout, is_open));
    }

    /// Refuses further messages.
    pub fn close(&self) {
        self.state().is_closed = true;
        self.arrived.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_queue_drops_and_counts_the_oldest() {
        let inbox = Inbox::new(2);
        assert!((1..=5).all(|number| inbox.push(number)));
        assert_eq!((inbox.take(Duration::ZERO), inbox.dropped()), (VecDeque::from([4, 5]), 3));
        inbox.push(6);
        inbox.close();
        assert!(!inbox.push(7));
        assert_eq!(inbox.take(Duration::MAX), [6]);
        assert!(inbox.take(Duration::MAX).is_empty());
    }
}
