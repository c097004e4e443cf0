use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use iceoryx2::port::subscriber::SubscriberCreateError;
use iceoryx2::prelude::*;
use iceoryx2::service::builder::event::{EventCreateError, EventOpenError, EventOpenOrCreateError};
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeCreateError, PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::port_factory::event;
use run::{Run, SpareRun};
use wire::StageId;

use crate::added::Added;
use crate::half_made::{half_made_services, remove_half_made_services};
use crate::limits::Limits;
use crate::names::Names;
use crate::nodes::{self, NodeNumber, NodeProcess, transport_config};
use crate::private::has_private_segment;
use crate::{PortError, Stop};

/// Frames that one reader may hold at a time: one for a long time, and two more while it looks for the
/// newest.
pub(crate) const BORROWED_MAX: usize = 3;
/// Frames that a publisher may prepare at a time.
pub(crate) const LOANED_MAX: usize = 1;
/// Number of earlier frames that a new reader receives.
pub(crate) const HISTORY: usize = 1;
/// A payload starts at a cache line, which is aligned for every vector load.
pub(crate) const ALIGNMENT: usize = 64;

/// Maximum time for retrying a half-created service: the default start time of a stage.
const OPEN_LIMIT: Duration = Duration::from_secs(10);
/// Pause between two tries. Each try itself waits for up to a second.
const OPEN_PAUSE: Duration = Duration::from_millis(50);

/// Maximum wait for a reader's place: the place of a dead reader is free within a second.
const PLACE_LIMIT: Duration = Duration::from_secs(2);
/// Prefix of the names of a topic's services.
pub(crate) const SERVICES: &str = "stgdat/";

/// If a service or a connection stays half created for this time, a killed process left it.
pub const HALF_MADE_LIMIT: Duration = Duration::from_millis(500);

/// Meanings of the events that wake a topic's readers.
pub(crate) mod event_id {
    pub const FRAME: usize = 0;
    pub const CREATED: usize = 1;
    pub const DROPPED: usize = 2;
    pub const DEAD: usize = 3;
}

/// The sender in the headers; zeros if it is not a stage.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sender {
    /// The stage's number.
    pub stage: u32,
    /// The stage's number of earlier starts.
    pub incarnation: u32,
}

/// This process's place in a run's shared memory.
#[derive(Debug)]
pub struct Node {
    pub(crate) node: iceoryx2::node::Node<ipc::Service>,
    pub(crate) run_id: u64,
    pub(crate) interval: Duration,
    stop: Stop,
    pub(crate) sender: Sender,
    pub(crate) names: Names,
    pub(crate) protected: Vec<String>,
    pub(crate) lockstep: bool,
    spares: Vec<SpareRun>,
    readers: BTreeMap<String, u32>,
    pub(crate) added: Added,
}

impl Node {
    /// Joins a run under a name that tools display.
    ///
    /// # Errors
    /// [`PortError`] if the run's files can't be created or the signal handlers can't be installed.
    pub fn open(run: &Run, name: &str) -> Result<Self, PortError> {
        let stop = Stop::on_signals().map_err(PortError::of_node("taking over the signals to end"))?;
        let node_name = NodeName::new(name).map_err(PortError::of_node("name of the node"))?;
        let config =
            transport_config(&run.prefix, &run.root).map_err(PortError::of_node("paths of the run"))?;
        let node = NodeBuilder::new()
            .name(&node_name)
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<ipc::Service>()
            .map_err(PortError::of_node("node"))?;
        if !has_private_segment(&run.prefix) {
            return Err(PortError::NotPrivate(run.prefix.clone()));
        }
        let (interval, sender) = (Duration::from_nanos(run.interval_ns), Sender::default());
        let (names, protected) = (Names::default(), run.protected.clone());
        let (run_id, lockstep, spares, readers) =
            (run.id, run.lockstep, run.spares.clone(), run.readers.clone());
        let added = Added::of(run);
        Ok(Self { node, run_id, interval, stop, sender, names, protected, lockstep, spares, readers, added })
    }

    /// The same node for a stage. The headers of all frames that it sends name the stage, and its topics have
    /// the names that this process maps them to.
    pub(crate) fn of_stage(mut self, id: StageId, incarnation: u32) -> Self {
        self.sender = Sender { stage: id.number(), incarnation };
        self.names = Names::of_process();
        self
    }

    /// The signals that ask the process to end.
    #[must_use]
    pub const fn stop(&self) -> &Stop {
        &self.stop
    }

    /// The run's number.
    #[must_use]
    pub const fn run_id(&self) -> u64 {
        self.run_id
    }

    /// Opens or creates the event service of a topic.
    pub(crate) fn events(
        &self,
        name: &ServiceName,
        limits: Limits,
        interval: Duration,
        topic: &'static str,
    ) -> Result<event::PortFactory<ipc::Service>, PortError> {
        let events = || {
            self.node
                .service_builder(name)
                .event()
                .deadline(2 * interval)
                .max_notifiers(limits.publishers_max)
                .max_listeners(limits.subscribers_max)
                .max_nodes(limits.nodes_max)
                .notifier_created_event(EventId::new(event_id::CREATED))
                .notifier_dropped_event(EventId::new(event_id::DROPPED))
                .notifier_dead_event(EventId::new(event_id::DEAD))
                .open_or_create()
        };
        self.patiently(events, is_half_made_event).map_err(PortError::of("events", topic))
    }

    /// Adds places for spares and for the further readers of the pipeline file. Each spare may read the
    /// topic, and the place of a dead process is free only after the clean-up.
    pub(crate) fn with_spares_and_readers(&self, name: &str, limits: Limits) -> Limits {
        let spares = self.spares.iter().filter(|spare| spare.opens(name)).count();
        let readers = self.readers.get(name).map_or(0, |&readers| readers as usize);
        Limits {
            publishers_max: limits.publishers_max + if limits.publishers_max > 1 { spares } else { 0 },
            subscribers_max: limits.subscribers_max + spares + readers,
            nodes_max: limits.nodes_max + self.spares.len() + readers,
            ..limits
        }
    }

    /// Retries to open a service while it is half created: either another process is creating it, or that
    /// process was killed and the clean-up follows.
    pub(crate) fn patiently<S, E>(
        &self,
        open: impl Fn() -> Result<S, E>,
        is_half_made: fn(&E) -> bool,
    ) -> Result<S, E> {
        let begun = Instant::now();
        loop {
            match open() {
                Err(error)
                    if is_half_made(&error) && begun.elapsed() < OPEN_LIMIT && !self.stop.requested() =>
                {
                    std::thread::sleep(OPEN_PAUSE);
                }
                opened => return opened,
            }
        }
    }
}

/// Whether the service of a topic is being created, removed, or both in turn.
pub(crate) const fn is_half_made_topic(error: &PublishSubscribeOpenOrCreateError) -> bool {
    use PublishSubscribeOpenOrCreateError as Error;
    matches!(
        error,
        Error::SystemInFlux
            | Error::PublishSubscribeOpenError(
                PublishSubscribeOpenError::HangsInCreation
                    | PublishSubscribeOpenError::IsMarkedForDestruction
                    | PublishSubscribeOpenError::DoesNotExist
            )
            | Error::PublishSubscribeCreateError(
                PublishSubscribeCreateError::HangsInCreation
                    | PublishSubscribeCreateError::AlreadyExists
                    | PublishSubscribeCreateError::IsBeingCreatedByAnotherInstance
            )
    )
}

/// Whether the event service is being created, removed, or both in turn.
const fn is_half_made_event(error: &EventOpenOrCreateError) -> bool {
    use EventOpenOrCreateError as Error;
    matches!(
        error,
        Error::SystemInFlux
            | Error::EventOpenError(
                EventOpenError::HangsInCreation
                    | EventOpenError::IsMarkedForDestruction
                    | EventOpenError::DoesNotExist
            )
            | Error::EventCreateError(
                EventCreateError::AlreadyExists | EventCreateError::IsBeingCreatedByAnotherInstance
            )
    )
}

/// Creates a subscriber. If all places are taken it retries for a while: one of them may belong to a dead
/// reader, and the launcher is about to free it.
pub(crate) fn subscriber<S>(
    create: impl Fn() -> Result<S, SubscriberCreateError>,
    service: &ServiceName,
    most: usize,
    topic: &'static str,
) -> Result<S, PortError> {
    let begun = Instant::now();
    loop {
        match create() {
            Err(SubscriberCreateError::ExceedsMaxSupportedSubscribers) if begun.elapsed() < PLACE_LIMIT => {
                std::thread::sleep(OPEN_PAUSE);
            }
            Err(SubscriberCreateError::ExceedsMaxSupportedSubscribers) => {
                let name = service.as_str();
                let name = name.strip_prefix(SERVICES).unwrap_or(name).to_owned();
                return Err(PortError::NoPlace { name, most });
            }
            created => return created.map_err(PortError::of("subscriber", topic)),
        }
    }
}

/// Frees the resources of a run's dead processes in shared memory: their places on the topics and the frames
/// that they had borrowed. Calls `found` with each process before its files are removed. Returns the number
/// of processes that were cleaned, and the number that could not be. A service is removed if a process was
/// killed while creating it, so that others can create it.
///
/// May block forever on a connection if a process was killed while creating the connection
/// ([`remove_half_made_connections`](crate::remove_half_made_connections)). Call it in a process that can be
/// killed.
///
/// # Errors
/// [`PortError`] if the run's paths can't be used.
pub fn clean_dead_nodes(
    run: &Run,
    mut found: impl FnMut(NodeNumber, &NodeProcess),
) -> Result<(u64, u64), PortError> {
    let config = transport_config(&run.prefix, &run.root).map_err(PortError::of_node("paths of the run"))?;
    let (mut cleaned, mut failed) = nodes::clean(&config, &mut found);
    // A process that is killed early leaves a half-made service that its node does not list yet, so its
    // clean-up succeeds.
    if failed > 0 || !half_made_services(&run.root, Duration::ZERO).is_empty() {
        // Creating a service takes milliseconds: a service that is still half created after this time will
        // stay so.
        std::thread::sleep(HALF_MADE_LIMIT);
        if remove_half_made_services(&run.root, HALF_MADE_LIMIT) > 0 {
            let again = nodes::clean(&config, &mut found);
            (cleaned, failed) = (cleaned + again.0, again.1);
        }
    }
    nodes::remove_fragments(run);
    Ok((cleaned, failed))
}
