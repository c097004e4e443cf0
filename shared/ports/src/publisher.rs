#![expect(unsafe_code, reason = "a loan hands out shared memory that was never written by this process")]

use std::cell::Cell;
use std::ops::{Deref, DerefMut};

use bytemuck::TransparentWrapper;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::prelude::ipc;
use iceoryx2::sample_mut::SampleMut;
use wire::{Header, Protection, Topic};

use crate::PortError;
use crate::element::{Element, Head};
use crate::points::{self, Point};

/// The writing end of a topic.
#[derive(Debug)]
pub struct Publisher<T: Topic> {
    publisher: iceoryx2::port::publisher::Publisher<ipc::Service, [Element<T>], Head>,
    notifier: Notifier<ipc::Service>,
    sender: Sender,
    protects: bool,
    /// Frames sent, for [`Protection::counter`].
    counter: Cell<u32>,
}

/// The sender in the headers; zeros if it is not a stage.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sender {
    /// The stage's number.
    pub stage: u32,
    /// The stage's number of earlier starts.
    pub incarnation: u32,
}

/// Space for one frame in shared memory, to be written and sent.
#[derive(Debug)]
pub struct Loan<T: Topic>(SampleMut<ipc::Service, [Element<T>], Head>);

impl<T: Topic> Publisher<T> {
    pub(crate) const fn new(
        publisher: iceoryx2::port::publisher::Publisher<ipc::Service, [Element<T>], Head>,
        notifier: Notifier<ipc::Service>,
        sender: Sender,
        protects: bool,
    ) -> Self {
        Self { publisher, notifier, sender, protects, counter: Cell::new(0) }
    }

    /// Space for `len` elements. Until they are written they hold an earlier frame or zeros.
    ///
    /// # Errors
    /// [`PortError`] if `len` is beyond [`Topic::ELEMENTS_MAX`] or shared memory is full.
    pub fn loan(&self, len: usize) -> Result<Loan<T>, PortError> {
        if len > T::ELEMENTS_MAX {
            return Err(PortError::TooMany { topic: T::NAME, found: len, most: T::ELEMENTS_MAX });
        }
        if T::PUBLISHERS_MAX == 1 {
            points::reach(Point::BeforeLoan);
        }
        let sample = self.publisher.loan_slice_uninit(len).map_err(PortError::of("loan", T::NAME))?;
        // SAFETY: the memory is a mapping that the kernel zeroed, or holds an earlier frame: its bytes are
        // defined, and any bit pattern is a value of a `Pod` element.
        Ok(Loan(unsafe { sample.assume_init() }))
    }

    /// Sends a frame in the name of this process to all readers, and wakes them.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn send(&self, mut loan: Loan<T>, header: Header) -> Result<(), PortError> {
        let is_ours = T::PUBLISHERS_MAX == 1;
        let at = |point| {
            if is_ours {
                points::sending(point, &header);
            }
        };
        at(Point::MidWrite);
        let Sender { stage: sender, incarnation } = self.sender;
        // The protection of the received frame does not cover the frame that is sent.
        let mut header = Header { protection: Protection::default(), sender, incarnation, ..header };
        if self.protects {
            header.protection = Protection::of::<T>(&header, &loan, self.counter.get());
            self.counter.set(self.counter.get().wrapping_add(1));
        }
        *loan.0.user_header_mut() = Head(header);
        loan.0.send().map_err(PortError::of("sending", T::NAME))?;
        at(Point::BeforeNotify);
        // Errors here are late notifications, which were delivered all the same, and readers that have ended.
        let _ = self.notifier.notify();
        at(Point::AfterSend);
        Ok(())
    }

    /// A frame with a copy of `elements`, for results whose count is unknown before they are computed.
    ///
    /// # Errors
    /// As [`Publisher::loan`].
    pub fn copy(&self, elements: &[T::Element]) -> Result<Loan<T>, PortError> {
        let mut loan = self.loan(elements.len())?;
        loan.copy_from_slice(elements);
        Ok(loan)
    }

    /// Sends a copy of `elements`.
    ///
    /// # Errors
    /// As [`Publisher::loan`] and [`Publisher::send`].
    pub fn send_copy(&self, elements: &[T::Element], header: Header) -> Result<(), PortError> {
        self.send(self.copy(elements)?, header)
    }
}

impl<T: Topic> Deref for Loan<T> {
    type Target = [T::Element];

    fn deref(&self) -> &[T::Element] {
        Element::<T>::peel_slice(self.0.payload())
    }
}

impl<T: Topic> DerefMut for Loan<T> {
    fn deref_mut(&mut self) -> &mut [T::Element] {
        Element::<T>::peel_slice_mut(self.0.payload_mut())
    }
}
