use std::marker::PhantomData;
use std::os::fd::{AsFd, BorrowedFd};

use iceoryx2::port::listener::Listener;
use iceoryx2::prelude::ipc;
use wire::Topic;

use crate::relay::RawFrame;
use crate::transport::Reader;
use crate::wait::{Wakes, descriptor};
use crate::{Node, PortError};

/// Reads a topic as an additional consumer and checks nothing; dropping it frees the reader's place.
#[derive(Debug)]
pub struct RawSubscriber<T: Topic>(Reader, PhantomData<T>);

impl Node {
    /// Opens a topic for reading unchecked frames, with a queue of `depth` frames.
    ///
    /// # Errors
    /// As [`Node::subscriber`].
    pub fn raw_subscriber<T: Topic>(&self, depth: usize) -> Result<RawSubscriber<T>, PortError> {
        Ok(RawSubscriber(self.reader::<T>(T::NAME, depth)?, PhantomData))
    }
}

impl<T: Topic> RawSubscriber<T> {
    /// The oldest frame of the queue, if there is one.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn receive(&self) -> Result<Option<RawFrame<T>>, PortError> {
        Ok(self.0.receive()?.map(RawFrame::of))
    }

    /// Drains the pending events, so that the descriptor becomes readable only when another event arrives.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn drain(&self) -> Result<(), PortError> {
        self.0.drain()
    }
}

impl<T: Topic> Wakes for RawSubscriber<T> {
    fn listener(&self) -> &Listener<ipc::Service> {
        self.0.listener()
    }
}

/// Readable when an event of the topic has arrived, for programs that also wait for other things.
impl<T: Topic> AsFd for RawSubscriber<T> {
    fn as_fd(&self) -> BorrowedFd<'_> {
        descriptor(self)
    }
}
