//! The topics that a stage opens: its inputs, its outputs, and the hand-over of an output from the process that
//! the stage replaces.

use std::time::Duration;

use wire::{Header, Topic};

use super::Stage;
use crate::{PortError, Publisher, Subscriber, standby};

/// Queue depth of a stage's input: the current tick and the next.
const DEPTH: usize = 2;
/// Maximum wait for the place of an ended process to become free, and the pause between two tries.
const PLACE_LIMIT: Duration = Duration::from_secs(1);
const PLACE_PAUSE: Duration = Duration::from_millis(2);

/// The topics that a stage has declared, and the subset that it has opened.
#[derive(Debug)]
pub(super) struct Topics {
    pub(super) reads: &'static [&'static str],
    pub(super) writes: &'static [&'static str],
    pub(super) opened: Vec<&'static str>,
    /// Whether a check has found all of them open.
    pub(super) complete: bool,
}

impl Stage {
    /// Opens an input. The stage is linked only after a frame has arrived on it.
    ///
    /// # Errors
    /// As [`Node::subscriber`](crate::Node::subscriber).
    ///
    /// # Panics
    /// If the stage has not declared that it reads the topic.
    pub fn subscribe<T: Topic>(&mut self) -> Result<Subscriber<T>, PortError> {
        self.subscribe_deep(DEPTH)
    }

    /// Opens an input with a queue of `depth` frames.
    ///
    /// # Errors
    /// As [`Node::subscriber`](crate::Node::subscriber).
    ///
    /// # Panics
    /// If the stage has not declared that it reads the topic.
    pub fn subscribe_deep<T: Topic>(&mut self, depth: usize) -> Result<Subscriber<T>, PortError> {
        let subscriber = self.open_input::<T>(depth)?;
        self.inputs.add(subscriber.input());
        Ok(subscriber)
    }

    /// Opens an input that a later stage writes, with a queue of `depth` frames. A tick that is missing in
    /// this input was lost, and counted, at an earlier stage.
    ///
    /// # Errors
    /// As [`Node::subscriber`](crate::Node::subscriber).
    ///
    /// # Panics
    /// If the stage has not declared that it reads the topic.
    pub fn subscribe_feedback<T: Topic>(&mut self, depth: usize) -> Result<Subscriber<T>, PortError> {
        let subscriber = self.open_input::<T>(depth)?;
        self.inputs.add_feedback(subscriber.input());
        Ok(subscriber)
    }

    fn open_input<T: Topic>(&mut self, depth: usize) -> Result<Subscriber<T>, PortError> {
        let reads = self.declared.reads;
        assert!(reads.contains(&T::NAME), "the {} declares no input \"{}\"", self.id.name(), T::NAME);
        self.declared.opened.push(T::NAME);
        self.node.subscriber(depth)
    }

    /// Opens an output. The stage is linked only after it has sent a frame.
    ///
    /// A process that replaces a running one waits here until the other one has ended. Open the inputs, and
    /// load anything that takes time, before this call.
    ///
    /// # Errors
    /// As [`Node::publisher`](crate::Node::publisher) and [`await_turn`](crate::await_turn).
    ///
    /// # Panics
    /// If the stage has not declared that it writes the topic.
    pub fn publish<T: Topic>(&mut self) -> Result<Publisher<T>, PortError> {
        self.publish_after::<T>(|_, _| ())
    }

    /// As [`Stage::publish`]. While it waits for its turn, it calls `follow` with each tick that the previous
    /// process has sent.
    ///
    /// # Errors
    /// As [`Stage::publish`].
    ///
    /// # Panics
    /// As [`Stage::publish`].
    pub fn publish_after<T: Topic>(
        &mut self,
        follow: impl FnMut(&Header, &[T::Element]),
    ) -> Result<Publisher<T>, PortError> {
        let writes = self.declared.writes;
        assert!(writes.contains(&T::NAME), "the {} declares no output \"{}\"", self.id.name(), T::NAME);
        self.declared.opened.push(T::NAME);
        self.tally.has_passed = false;
        if standby::is_standby() {
            self.take_over::<T>(follow)?;
        }
        let begun = std::time::Instant::now();
        loop {
            match self.node.publisher() {
                // The place of the previous process is free once the transport notices its end.
                Err(_) if self.taken_over.is_some() && begun.elapsed() < PLACE_LIMIT => {
                    std::thread::sleep(PLACE_PAUSE);
                }
                opened => return opened,
            }
        }
    }

    /// Waits for its turn, and continues after the newest tick that the previous process has sent.
    fn take_over<T: Topic>(
        &mut self,
        mut follow: impl FnMut(&Header, &[T::Element]),
    ) -> Result<(), PortError> {
        // Polled ten times a second: no frame to follow is dropped.
        let sent = self.node.subscriber::<T>(T::DEPTH_MAX)?;
        let mut newest = None;
        let mut look = || {
            while let Some(frame) = sent.receive()? {
                if frame.header().is_tick() {
                    newest = newest.max(Some(frame.header().seq));
                    follow(frame.header(), &frame);
                }
            }
            Ok(())
        };
        self.memory.tend();
        standby::await_turn_and(self.id, self.node.stop(), &mut look)?;
        look()?;
        self.taken_over = newest;
        if let Some(seq) = self.taken_over {
            self.inputs.resume_after(seq);
        }
        Ok(())
    }

    /// Number of the newest tick that the previous process has sent, if this process has replaced it while it
    /// ran.
    #[must_use]
    pub const fn taken_over(&self) -> Option<u64> {
        self.taken_over
    }

    /// Checks, at the first wait, that all declared topics are open: other stages would wait for a missing
    /// one in vain.
    pub(super) fn check_topics(&mut self) {
        let Topics { reads, writes, opened, complete } = &mut self.declared;
        if !*complete {
            let missing = reads.iter().chain(*writes).find(|topic| !opened.contains(topic));
            assert!(missing.is_none(), "the {} declares {missing:?} and has not opened it", self.id.name());
            *complete = true;
        }
    }
}
