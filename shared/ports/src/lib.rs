//! Connects the stages: topics in shared memory, and the loop that all stages share.
//!
//! A *topic* is one iceoryx2 publish-subscribe service with bounded queues, and one event service of the same
//! name that wakes the readers. Its [`Publisher`] writes a payload once, directly into shared memory
//! ([`Loan`]). Every [`Subscriber`] reads it there ([`Frame`]). Nothing is copied or encoded.
//!
//! A *run* uses only its own files ([`Space`]). Every name in shared memory starts with the run's prefix. All
//! of them can therefore be removed by that prefix after the processes have ended, killed or not.
//!
//! [`Stage`] is one process of the pipeline. It sleeps until a frame arrives and sends heartbeats in between.
//! It passes on frames that are not ticks, stamps its passage into the header and ends on SIGTERM.
//!
//! *Linking*: a connection carries frames only after the reader has mapped it. Before the first tick the
//! source therefore sends empty warm-up frames, which every stage passes on. A stage is *linked* when each of
//! its inputs has received a frame and one frame has been sent.
//!
//! A frame from one end of a topic to the other, within one process:
//!
//! ```
//! use ports::{Node, Space};
//! use run::Run;
//! use wire::{Header, Track, TracksTopic};
//!
//! // The launcher makes the run's files; dropping `space` removes them.
//! let space = Space::create(None, 1 << 20)?;
//! let run = Run { id: space.id(), prefix: space.prefix().into(), root: space.root().into(), ..Run::default()
//! };
//!
//! let node = Node::open(&run, "example")?;
//! let subscriber = node.subscriber::<TracksTopic>(2)?;
//! let publisher = node.publisher::<TracksTopic>()?;
//!
//! let mut header = Header::new(run.id, 0, 80_000_000);
//! header.counts.agents_len = 1;
//! let mut loan = publisher.loan(1)?;
//! loan[0] = Track { id: 9, x_m: 2.5, ..bytemuck::Zeroable::zeroed() };
//! publisher.send(loan, header)?;
//!
//! let frame = subscriber.receive()?.expect("the frame is in the queue");
//! assert_eq!((frame.header().seq, frame[0].id, frame[0].x_m), (0, 9, 2.5));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod added;
mod clock;
mod color;
mod drive;
mod element;
mod error;
mod escape;
mod executor;
mod half_made;
mod intake;
mod keep;
mod kept;
mod limits;
mod living;
mod log;
mod memory;
mod missing;
mod names;
mod node;
mod nodes;
mod peer;
mod peers;
mod places;
mod points;
mod private;
mod program;
mod publisher;
mod raw;
mod removal;
mod runs;
pub mod shedding;
mod side_outputs;
mod space;
mod stage;
mod standby;
mod step;
mod stop;
mod subscriber;
mod tally;
mod temporary;
mod topics;
mod transport;
mod wait;

pub use crate::shedding::Allowance;
pub use clock::{clock_offset_ns, monotonic_ns};
pub use color::{COLOR_VARIABLE, Color};
pub use drive::drive;
pub use error::{Awaiting, PortError, StageError};
pub use escape::escaped;
pub use executor::{Executor, Frames, Outcome, Readable, Wanted};
pub use half_made::remove_half_made_connections;
pub use kept::KeptMemory;
pub use limits::HEARTBEAT;
pub use living::choose_run;
pub use log::{
    LOG_VARIABLE, LogFormat, OUTPUT_TARGET, begin_command_logging, begin_logging, log_run, log_tick, now,
    priority,
};
pub use names::TOPICS_VARIABLE;
pub use node::{HALF_MADE_LIMIT, Node, clean_dead_nodes};
pub use nodes::{NodeNumber, NodeProcess, NodeWatch};
pub use peer::is_own_user;
pub use peers::{Peers, TAP};
pub use places::{is_full, shared_memory_free};
pub use points::{POINTS_VARIABLE, Point};
pub use program::{
    INCARNATION_VARIABLE, LAUNCHER_VARIABLE, RECORD, RUN_VARIABLE, UNLOCKED_VARIABLE, die_with_launcher,
    incarnation, stage_main,
};
pub use publisher::{Loan, Publisher};
pub use raw::{RawFrame, RawSubscriber, RawTopic, Relay};
pub use runs::{ForeignRun, Leftover, LivingRun, files_left, foreign_runs, leftovers, living_runs};
pub use side_outputs::SideOutputs;
pub use space::{Space, SpaceError};
pub use stage::{Awaited, Passage, Stage};
pub use standby::{GO, STANDBY_VARIABLE, await_turn};
pub use step::{Answer, NoTopic, Room, Second, SecondInput, Step, Tick, declare};
pub use stop::{Asked, Stop};
pub use subscriber::{Frame, Subscriber};
pub use temporary::TemporaryFolder;
pub use topics::Topics;
