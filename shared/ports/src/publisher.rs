use std::cell::Cell;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};

use bytemuck::{cast_slice, cast_slice_mut};
use wire::{Header, Protection, Topic};

use crate::PortError;
use crate::node::Sender;
use crate::points::{self, Point};
use crate::transport::{Loaned, Writer};

/// The writing end of a topic.
#[derive(Debug)]
pub struct Publisher<T: Topic> {
    writer: Writer,
    sender: Sender,
    protects: bool,
    topic: PhantomData<T>,
    /// Frames sent, for [`Protection::counter`].
    counter: Cell<u32>,
}

/// Space for one frame in shared memory, to be written and sent.
#[derive(Debug)]
pub struct Loan<T: Topic>(Loaned, PhantomData<T>);

impl<T: Topic> Publisher<T> {
    pub(crate) const fn new(writer: Writer, sender: Sender, protects: bool) -> Self {
        Self { writer, sender, protects, topic: PhantomData, counter: Cell::new(0) }
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
        Ok(Loan(self.writer.loan(len)?, PhantomData))
    }

    /// Sends a frame in the name of this process to all readers, and wakes them.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn send(&self, loan: Loan<T>, header: Header) -> Result<(), PortError> {
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
        self.writer.send(loan.0, &header)?;
        at(Point::BeforeNotify);
        self.writer.notify();
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
        cast_slice(self.0.bytes())
    }
}

impl<T: Topic> DerefMut for Loan<T> {
    fn deref_mut(&mut self) -> &mut [T::Element] {
        cast_slice_mut(self.0.bytes_mut())
    }
}
