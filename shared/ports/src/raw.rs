use std::os::fd::{AsFd, BorrowedFd};

use iceoryx2::port::listener::Listener;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::ipc;
use wire::Topic;

use crate::element::{Element, Head};
use crate::node::subscriber_of;
use crate::relay::RawFrame;
use crate::wait::{Wakes, descriptor, drain};
use crate::{Node, PortError};

/// Reads a topic as an additional consumer and checks nothing; dropping it frees the reader's place.
#[derive(Debug)]
pub struct RawSubscriber<T: Topic> {
    subscriber: Subscriber<ipc::Service, [Element<T>], Head>,
    listener: Listener<ipc::Service>,
}

impl Node {
    /// Opens a topic for reading unchecked frames, with a queue of `depth` frames.
    ///
    /// # Errors
    /// As [`Node::subscriber`].
    pub fn raw_subscriber<T: Topic>(&self, depth: usize) -> Result<RawSubscriber<T>, PortError> {
        let (subscriber, listener) = subscriber_of::<T>(&self.services::<T>(T::NAME)?, depth)?;
        Ok(RawSubscriber { subscriber, listener })
    }
}

impl<T: Topic> RawSubscriber<T> {
    /// The oldest frame of the queue, if there is one.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn receive(&self) -> Result<Option<RawFrame<T>>, PortError> {
        let sample = self.subscriber.receive().map_err(PortError::of("receiving", T::NAME))?;
        Ok(sample.map(RawFrame::of))
    }

    /// Drains the pending events, so that the descriptor becomes readable only when another event arrives.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn drain(&self) -> Result<(), PortError> {
        drain(&self.listener)
    }
}

impl<T: Topic> Wakes for RawSubscriber<T> {
    fn listener(&self) -> &Listener<ipc::Service> {
        &self.listener
    }
}

/// Readable when an event of the topic has arrived, for programs that also wait for other things.
impl<T: Topic> AsFd for RawSubscriber<T> {
    fn as_fd(&self) -> BorrowedFd<'_> {
        descriptor(self)
    }
}
