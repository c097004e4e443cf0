//! Sleeps until a topic has something to read: poll(2) on the sockets that receive its events.
//!
//! The transport's own wait set attaches every listener again for each wait and allocates on the heap. A
//! stage waits several times per tick.
#![expect(unsafe_code, reason = "the transport gives the descriptor of a listener as a number")]

use std::io;
use std::os::fd::BorrowedFd;
use std::time::Duration;

use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::prelude::{FileDescriptorBased, ipc};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use crate::PortError;

/// A topic whose events can end a wait.
pub(crate) trait Wakes {
    /// The port that receives the topic's events.
    fn listener(&self) -> &Listener<ipc::Service>;
}

/// Sleeps until a topic has an event, a signal arrives or `timeout` has passed. May return early: check the
/// queues.
pub(crate) fn wait<const N: usize>(topics: [&dyn Wakes; N], timeout: Duration) -> Result<(), PortError> {
    let mut ready = topics.map(|topic| PollFd::from_borrowed_fd(descriptor(topic), PollFlags::IN));
    let is_ready = poll_for(&mut ready, timeout)?;
    take(topics, &ready, is_ready)
}

/// The same for one topic and further descriptors, which are not read. Allocates.
pub(crate) fn wait_also(
    topic: &dyn Wakes,
    others: &[BorrowedFd<'_>],
    timeout: Duration,
) -> Result<(), PortError> {
    let all = [descriptor(topic)].into_iter().chain(others.iter().copied());
    let mut ready: Vec<PollFd<'_>> =
        all.map(|descriptor| PollFd::from_borrowed_fd(descriptor, PollFlags::IN)).collect();
    let is_ready = poll_for(&mut ready, timeout)?;
    take([topic], &ready, is_ready)
}

/// Whether a descriptor is ready; `false` after a signal or the timeout.
fn poll_for(ready: &mut [PollFd<'_>], timeout: Duration) -> Result<bool, PortError> {
    // A timeout of more than a few hundred years has no limit.
    let timeout = Timespec::try_from(timeout).ok();
    match poll(ready, timeout.as_ref()) {
        // A signal ends the wait too; `Stop` holds whether the signal asks the process to end.
        Ok(0) | Err(Errno::INTR) => Ok(false),
        Ok(_) => Ok(true),
        Err(error) => Err(PortError::Wait(error.into())),
    }
}

/// Drains the events of topics. The topics' descriptors are the first ones of `ready`.
///
/// A listener is also drained if no descriptor is ready. With several senders, the transport (0.10) can take the
/// event of one sender while another marks the listener as notified. No sender writes to its socket from then on,
/// until the listener is drained.
fn take<const N: usize>(
    topics: [&dyn Wakes; N],
    ready: &[PollFd<'_>],
    is_ready: bool,
) -> Result<(), PortError> {
    for (topic, ready) in topics.into_iter().zip(ready) {
        let events = ready.revents();
        if !is_ready || events.contains(PollFlags::IN) {
            // A pending event would end every later wait at once.
            drain(topic.listener())?;
        } else if !events.is_empty() {
            return Err(PortError::Socket { events: events.bits() });
        }
    }
    Ok(())
}

pub(crate) fn descriptor(topic: &dyn Wakes) -> BorrowedFd<'_> {
    let descriptor = topic.listener().file_descriptor();
    // SAFETY: the listener owns the descriptor, closes it only when it is dropped, and is borrowed for as
    // long.
    unsafe { BorrowedFd::borrow_raw(descriptor.native_handle()) }
}

pub(crate) fn drain(listener: &Listener<ipc::Service>) -> Result<(), PortError> {
    match listener.try_wait(|_| ()) {
        Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
        Err(error) => Err(PortError::Wait(io::Error::other(error))),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixDatagram;

    use iceoryx2::prelude::{NodeBuilder, SignalHandlingMode};

    use super::*;
    use crate::nodes::transport_config;

    struct Topic(Listener<ipc::Service>);

    impl Wakes for Topic {
        fn listener(&self) -> &Listener<ipc::Service> {
            &self.0
        }
    }

    #[test]
    fn a_wait_that_missed_an_event_does_not_miss_the_next_one() {
        let folder = tempfile::tempdir().unwrap();
        let config = transport_config(&format!("stgdat_{:08x}_", std::process::id()), folder.path()).unwrap();
        let builder = NodeBuilder::new().config(&config).signal_handling_mode(SignalHandlingMode::Disabled);
        let node = builder.create::<ipc::Service>().unwrap();
        let events = node.service_builder(&"events".try_into().unwrap()).event().create().unwrap();
        let topic = Topic(events.listener_builder().create().unwrap());
        let notifier = events.notifier_builder().create().unwrap();
        let socket = UnixDatagram::from(descriptor(&topic).try_clone_to_owned().unwrap());
        let mut byte = [0];

        // As if the listener had taken the event of another sender.
        notifier.notify().unwrap();
        socket.recv(&mut byte).unwrap();
        notifier.notify().unwrap();
        socket.set_nonblocking(true).unwrap();
        assert!(socket.recv(&mut byte).is_err(), "the transport writes every event to the socket");
        for with_others in [false, true] {
            let waited = if with_others {
                wait_also(&topic, &[], Duration::ZERO)
            } else {
                wait([&topic], Duration::ZERO)
            };
            waited.unwrap();
            notifier.notify().unwrap();
            assert_eq!(socket.recv(&mut byte).unwrap(), 1);
            notifier.notify().unwrap();
            assert!(socket.recv(&mut byte).is_err());
        }
    }
}
