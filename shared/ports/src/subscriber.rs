use std::cell::RefCell;
use std::marker::PhantomData;
use std::ops::Deref;
use std::os::fd::BorrowedFd;
use std::rc::Rc;
use std::time::Duration;

use bytemuck::cast_slice;
use iceoryx2::port::listener::Listener;
use iceoryx2::prelude::ipc;
use wire::{Header, Protection, REFUSALS_MAX, Refusals, Topic, flags};

use crate::error::log_refused;
use crate::intake::{Decision, Intake, Place, Rules};
use crate::transport::{Reader, Received};
use crate::wait::{Wakes, wait, wait_also};
use crate::{PortError, monotonic_ns};

/// The reading end of a topic.
#[derive(Debug)]
pub struct Subscriber<T: Topic>(Rc<Port<T>>);

#[derive(Debug)]
struct Port<T: Topic> {
    reader: Reader,
    /// A frame of a later tick than the awaited one.
    early: RefCell<Option<Frame<T>>>,
    intake: RefCell<Intake>,
}

/// One frame in shared memory; dropping it frees the memory.
#[derive(Debug)]
pub struct Frame<T: Topic> {
    frame: Received,
    received_ns: u64,
    topic: PhantomData<T>,
}

impl<T: Topic> Frame<T> {
    /// The frame's header, checked.
    #[must_use]
    pub fn header(&self) -> &Header {
        self.frame.header()
    }

    /// When the frame was taken from its queue, on `CLOCK_MONOTONIC`.
    #[must_use]
    pub const fn received_ns(&self) -> u64 {
        self.received_ns
    }
}

impl<T: Topic> Deref for Frame<T> {
    type Target = [T::Element];

    fn deref(&self) -> &[T::Element] {
        cast_slice(self.frame.bytes())
    }
}

impl<T: Topic> Subscriber<T> {
    pub(crate) fn new(reader: Reader, run_id: u64, protected: bool, lockstep: bool) -> Self {
        let (one_writer, elements_len) = (T::PUBLISHERS_MAX == 1, T::elements_len);
        let rules = Rules { run_id, protected, lockstep, one_writer, elements_len };
        let (early, intake) = (RefCell::new(None), RefCell::new(Intake::new(rules)));
        Self(Rc::new(Port { reader, early, intake }))
    }

    /// The oldest frame of the queue; `None` if the queue is empty. Frames with an impossible header or a
    /// wrong check value are counted and skipped.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn receive(&self) -> Result<Option<Frame<T>>, PortError> {
        if let Some(frame) = self.0.early.take() {
            return Ok(Some(frame));
        }
        while let Some(frame) = self.0.reader.receive()? {
            let frame = Frame { frame, received_ns: monotonic_ns(), topic: PhantomData };
            let check_value = || Protection::check::<T>(frame.header(), &frame);
            let decision = self.0.intake.borrow_mut().decide(frame.header(), frame.len(), check_value);
            match decision {
                Decision::Accepted => return Ok(Some(frame)),
                Decision::Refused(why) => log_refused(T::NAME, frame.header().seq, &why),
                Decision::Answered => {}
            }
        }
        Ok(None)
    }

    /// In lockstep: the VOID header of a tick that was refused since the last call. The tick will not be sent
    /// again.
    pub(crate) fn take_lost(&self) -> Option<Header> {
        self.0.intake.borrow_mut().take_lost()
    }

    /// The newest tick of the queue that is not VOID, if there is one; all other frames are dropped.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn newest(&self) -> Result<Option<Frame<T>>, PortError> {
        let mut newest = None;
        while let Some(frame) = self.receive()? {
            if frame.header().is_tick() && !frame.header().has(flags::VOID) {
                newest = Some(frame);
            }
        }
        Ok(newest)
    }

    /// The frame of tick `seq`, if it is in the queue. Older frames are dropped, newer ones stay for later.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn of_tick(&self, seq: u64) -> Result<Option<Frame<T>>, PortError> {
        while let Some(frame) = self.receive()? {
            match Place::of(frame.header(), seq) {
                Place::Awaited => return Ok(Some(frame)),
                Place::After => {
                    self.0.early.replace(Some(frame));
                    return Ok(None);
                }
                Place::TooFar => {
                    let why = self.0.intake.borrow_mut().refuse_far(frame.header(), seq);
                    log_refused(T::NAME, frame.header().seq, &why);
                }
                Place::Before => {}
            }
        }
        Ok(None)
    }

    /// Whether no process has the topic open for writing. A dead writer counts until the launcher has cleaned
    /// up after it.
    #[must_use]
    pub fn has_no_publisher(&self) -> bool {
        !self.0.reader.has_publisher()
    }

    /// Sleeps until the topic has an event, a signal arrives or `timeout` has passed. May return early: check
    /// the queue.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn sleep(&self, timeout: Duration) -> Result<(), PortError> {
        wait([self], timeout)
    }

    /// As [`Subscriber::sleep`], and also until one of `others` is readable, such as the descriptor of an
    /// ended process.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn sleep_or(&self, others: &[BorrowedFd<'_>], timeout: Duration) -> Result<(), PortError> {
        wait_also(self, others, timeout)
    }

    /// The input in the form that its stage counts.
    pub(crate) fn input(&self) -> Rc<dyn Input> {
        self.0.clone()
    }
}

/// An input in the form that its stage counts, independent of the element type.
pub(crate) trait Input: std::fmt::Debug {
    /// Whether a frame has arrived, taken from the queue or not.
    fn linked(&self) -> bool;
    /// Number of refused frames.
    fn rejected_len(&self) -> u64;
    /// Refused frames by sender and cause.
    fn refusals(&self) -> [Refusals; REFUSALS_MAX];
    /// Number of frames that never arrived.
    fn dropped_len(&self) -> u64;
    /// Skips the ticks up to this one: another process has answered them.
    fn resume_after(&self, seq: u64);
}

impl<T: Topic> Input for Port<T> {
    fn linked(&self) -> bool {
        self.intake.borrow().seen() || self.reader.has_frames()
    }

    fn rejected_len(&self) -> u64 {
        self.intake.borrow().rejected_len()
    }

    fn refusals(&self) -> [Refusals; REFUSALS_MAX] {
        self.intake.borrow().refusals()
    }

    fn dropped_len(&self) -> u64 {
        self.intake.borrow().dropped_len()
    }

    fn resume_after(&self, seq: u64) {
        self.intake.borrow_mut().resume_after(seq);
    }
}

impl<T: Topic> Wakes for Subscriber<T> {
    fn listener(&self) -> &Listener<ipc::Service> {
        self.0.reader.listener()
    }
}
