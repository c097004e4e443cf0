//! How the stages meet: topics in shared memory, and what all stages do alike.
//!
//! A *topic* is one iceoryx2 publish-subscribe service with its bounded queues and one event service of the same name
//! that wakes the readers. A payload is written once, by its [`Publisher`], straight into shared memory ([`Loan`]), and
//! read there by every [`Subscriber`] ([`Frame`]); nothing is copied or encoded on the way.
//!
//! A *run* keeps to its own files ([`Space`]): every name in shared memory starts with the run's prefix, and removing
//! them all by that prefix needs no help of the processes that made them, whatever they died of.
//!
//! [`Stage`] is one process's side: it waits, asleep, until a frame comes, sends heartbeats in between, passes frames
//! on that are no ticks, stamps its passage into the header and ends on SIGTERM. *Linking*: before the first tick the
//! source sends empty warm-up frames, which every stage passes on, because a connection carries frames only once the
//! reader has mapped it. A stage is *linked* when a frame has come in on each of its inputs and one has gone out.

mod clock;
mod element;
mod error;
mod node;
mod peers;
mod program;
mod publisher;
mod space;
mod stage;
mod stop;
mod subscriber;
mod wait;

pub use clock::monotonic_ns;
pub use error::{Awaiting, PortError, StageError};
pub use node::Node;
pub use peers::Peers;
pub use program::{LAUNCHER_VARIABLE, RUN_VARIABLE, begin_logging, die_with_launcher, stage_main};
pub use publisher::{Loan, Publisher};
pub use space::{Leftover, Space, SpaceError, leftovers, shared_memory_free};
pub use stage::{Awaited, HEARTBEAT, Passage, Stage};
pub use stop::Stop;
pub use subscriber::{Frame, Subscriber};
