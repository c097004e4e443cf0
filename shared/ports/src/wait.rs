//! Sleeping until a topic has something to read: poll(2) on the sockets by which its events come in.
//!
//! The transport's own wait set attaches every listener anew for each wait and keeps what is attached on the heap; a stage
//! waits several times a tick.
#![expect(unsafe_code, reason = "the transport tells the descriptor of a listener as a number")]

use std::os::fd::BorrowedFd;
use std::time::Duration;

use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::prelude::{FileDescriptorBased, ipc};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use crate::PortError;

/// A topic that can wake who waits for it.
pub(crate) trait Wakes {
    /// What its events come in by.
    fn listener(&self) -> &Listener<ipc::Service>;
}

/// Sleeps until a topic wakes it, a signal comes or the time is up. May return early; queues tell what came.
pub(crate) fn wait<const N: usize>(topics: [&dyn Wakes; N], timeout: Duration) -> Result<(), PortError> {
    let failed = |reason: String| PortError { what: "waiting", topic: "(several)", reason };
    // More than a few hundred years is for ever.
    let timeout = Timespec::try_from(timeout).ok();
    let mut ready = topics.map(|topic| PollFd::from_borrowed_fd(descriptor(topic), PollFlags::IN));
    match poll(&mut ready, timeout.as_ref()) {
        // A signal ends the wait too; whether it asks to end the process, `Stop` tells.
        Ok(0) | Err(Errno::INTR) => return Ok(()),
        Ok(_) => {}
        Err(error) => return Err(failed(error.to_string())),
    }
    for (topic, ready) in topics.into_iter().zip(&ready) {
        let events = ready.revents();
        if events.contains(PollFlags::IN) {
            // Events that stay would wake the next wait at once, for ever.
            drain(topic.listener()).map_err(failed)?;
        } else if !events.is_empty() {
            return Err(failed(format!("a listener's socket is unusable: {events:?}")));
        }
    }
    Ok(())
}

fn descriptor(topic: &dyn Wakes) -> BorrowedFd<'_> {
    let descriptor = topic.listener().file_descriptor();
    // SAFETY: the listener owns the descriptor, does not close it before it is dropped, and is borrowed for as long.
    unsafe { BorrowedFd::borrow_raw(descriptor.native_handle()) }
}

fn drain(listener: &Listener<ipc::Service>) -> Result<(), String> {
    match listener.try_wait(|_| ()) {
        Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
        Err(error) => Err(format!("{error:?}")),
    }
}
