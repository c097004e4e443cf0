mod topics;

use std::time::Duration;

use run::{Declaration, Run};
use wire::{Counts, Header, Heartbeat, HeartbeatsTopic, Hop, LinkCount, Rejected, StageId, Topic, flags};

use crate::error::log_refused;
use crate::executor::has_work;
use crate::log::{log_run, log_tick};
use crate::memory::ResidentMemory;
use crate::points::{self, Point};
use crate::tally::{Inputs, Tally};
use crate::wait::{Wakes, wait};
use crate::{Frame, Loan, Node, Peers, PortError, Publisher, SideOutputs, Stop, Subscriber, monotonic_ns};
use topics::Topics;

/// One process of the pipeline: the work that all stages share, on one thread.
#[derive(Debug)]
pub struct Stage {
    id: StageId,
    incarnation: u32,
    node: Node,
    declared: Topics,
    heartbeats: Publisher<HeartbeatsTopic>,
    inputs: Inputs,
    tally: Tally,
    memory: ResidentMemory,
    /// Number of the newest tick of the process that this one has replaced.
    taken_over: Option<u64>,
}

/// A tick that a stage is processing.
#[derive(Debug)]
#[must_use = "a tick that is not finished is lost for all stages that follow"]
pub struct Passage {
    /// The header of the frame to be sent: the input's, unless the stage changes it.
    pub header: Header,
    hop: Hop,
    /// The topic of the input frame.
    input: &'static str,
}

/// Result of waiting for one tick's frame.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "a header in a box would be allocated")]
pub enum Awaited<F> {
    /// The frame.
    Frame(F),
    /// The frame of a tick that an earlier stage refused, or a frame that is not a tick.
    Void(F),
    /// Nothing arrived until the deadline.
    Late,
    /// In lockstep: the frame arrived and was refused, and it will not be sent again. The header is VOID.
    Lost(Header),
    /// The process has been asked to end.
    Stopped,
}

impl Stage {
    /// Joins the run as the stage of `declaration`. The stage must open all declared topics before it first
    /// waits, and no other topics.
    ///
    /// # Errors
    /// [`PortError`] if the run's shared memory can't be used.
    pub fn open<O>(run: &Run, declaration: &Declaration<O>) -> Result<Self, PortError> {
        let (id, incarnation) = (declaration.id(), crate::incarnation());
        points::arm(id, incarnation);
        log_run(&run.root);
        let node = Node::open(run, id.name())?.of_stage(id, incarnation);
        let heartbeats = node.publisher()?;
        let (reads, writes) = (declaration.reads(), declaration.writes());
        let declared = Topics { reads, writes, opened: Vec::new(), complete: false };
        Ok(Self {
            id,
            incarnation,
            node,
            declared,
            heartbeats,
            inputs: Inputs::default(),
            tally: Tally::new(id, incarnation),
            memory: ResidentMemory::of_stage(),
            taken_over: None,
        })
    }

    /// The heartbeats of all stages; they do not count as an input.
    ///
    /// # Errors
    /// As [`Node::subscriber`].
    pub fn peers(&self, run: &Run) -> Result<Peers, PortError> {
        Ok(Peers::new(self.node.subscriber(HeartbeatsTopic::DEPTH_MAX)?, run))
    }

    /// The headers of added stages whose output no forecast waits for; they do not count as an input.
    ///
    /// # Errors
    /// As [`Node::raw_subscriber`].
    pub fn side_outputs(&self, run: &Run) -> Result<SideOutputs, PortError> {
        SideOutputs::open(&self.node, run)
    }

    /// Which stage it is.
    #[must_use]
    pub const fn id(&self) -> StageId {
        self.id
    }

    /// The stage's number of earlier starts.
    #[must_use]
    pub const fn incarnation(&self) -> u32 {
        self.incarnation
    }

    /// The signals that ask the process to end.
    #[must_use]
    pub const fn stop(&self) -> &Stop {
        self.node.stop()
    }

    /// The next frame. Sleeps until it arrives or until `until_ns` on `CLOCK_MONOTONIC`.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn next_until<I: Topic>(
        &mut self,
        input: &Subscriber<I>,
        until_ns: Option<u64>,
    ) -> Result<Awaited<Frame<I>>, PortError> {
        self.check_topics();
        while !self.stop().requested() {
            match input.receive()? {
                Some(frame) if has_work(frame.header()) => return Ok(Awaited::Frame(frame)),
                Some(frame) => return Ok(Awaited::Void(frame)),
                None => {
                    if let Some(header) = input.take_lost() {
                        return Ok(Awaited::Lost(header));
                    }
                    if until_ns.is_some_and(|until_ns| monotonic_ns() >= until_ns) {
                        return Ok(Awaited::Late);
                    }
                    self.sleep([input], until_ns)?;
                }
            }
        }
        Ok(Awaited::Stopped)
    }

    /// The next frame of any kind. Sleeps until it arrives; `None` if the process has been asked to end.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    ///
    /// # Panics
    /// If a topic that the stage has declared is not open.
    pub fn take<I: Topic>(&mut self, input: &Subscriber<I>) -> Result<Option<Frame<I>>, PortError> {
        self.check_topics();
        while !self.stop().requested() {
            if let Some(frame) = input.receive()? {
                return Ok(Some(frame));
            }
            if let Some(header) = input.take_lost() {
                // The source waits for this stage's answer: that it has none.
                self.tally.skip(header.seq);
                self.beat()?;
            }
            self.sleep([input], None)?;
        }
        Ok(None)
    }

    /// Waits for the frame of tick `seq`, until `deadline_ns` on `CLOCK_MONOTONIC` if there is a deadline.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn wait_for<I: Topic>(
        &mut self,
        input: &Subscriber<I>,
        seq: u64,
        deadline_ns: Option<u64>,
    ) -> Result<Awaited<Frame<I>>, PortError> {
        self.check_topics();
        while !self.stop().requested() {
            match input.of_tick(seq)? {
                Some(frame) if has_work(frame.header()) => return Ok(Awaited::Frame(frame)),
                Some(frame) => return Ok(Awaited::Void(frame)),
                None if let Some(header) = input.take_lost().filter(|header| header.seq >= seq) => {
                    return Ok(Awaited::Lost(header));
                }
                None if deadline_ns.is_some_and(|deadline_ns| monotonic_ns() >= deadline_ns) => {
                    return Ok(Awaited::Late);
                }
                None => self.sleep([input], deadline_ns)?,
            }
        }
        Ok(Awaited::Stopped)
    }

    /// Sleeps until `until_ns` on `CLOCK_MONOTONIC`; `false` if the process has been asked to end.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn sleep_until(&mut self, until_ns: u64) -> Result<bool, PortError> {
        while !self.stop().requested() && monotonic_ns() < until_ns {
            self.sleep([], Some(until_ns))?;
        }
        Ok(!self.stop().requested())
    }

    /// Sleeps until a frame of `input` arrives, at most until `until_ns`; `false` if the process has been
    /// asked to end.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn sleep_on<I: Topic>(&mut self, input: &Subscriber<I>, until_ns: u64) -> Result<bool, PortError> {
        self.sleep([input], Some(until_ns))?;
        Ok(!self.stop().requested())
    }

    /// Starts the work on a tick.
    pub fn begin<I: Topic>(&self, frame: &Frame<I>) -> Passage {
        self.start(*frame.header(), frame.received_ns(), I::NAME)
    }

    /// Starts the passage of a tick whose frame was refused.
    pub(crate) fn begin_lost<I: Topic>(&self, header: Header) -> Passage {
        self.start(header, monotonic_ns(), I::NAME)
    }

    fn start(&self, header: Header, received_ns: u64, input: &'static str) -> Passage {
        log_tick(header.seq);
        let hop = Hop {
            stage: self.id.number(),
            incarnation: self.incarnation,
            received_ns,
            started_ns: monotonic_ns(),
            ..Hop::default()
        };
        Passage { header, hop, input }
    }

    /// Starts a tick without an input, at the source.
    pub fn release(&self, header: Header) -> Passage {
        let now_ns = monotonic_ns();
        self.start(Header { released_ns: now_ns, ..header }, now_ns, "none")
    }

    /// Ends the work on a tick. Sends the output or, if the input was refused, a VOID frame to the following
    /// stages.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn finish<O: Topic>(
        &mut self,
        mut passage: Passage,
        output: &Publisher<O>,
        result: Result<Loan<O>, Rejected>,
    ) -> Result<(), PortError> {
        passage.hop.finished_ns = monotonic_ns();
        match result {
            Ok(loan) => {
                self.done(passage.header.seq);
                self.send(passage, output, loan)
            }
            Err(why) => {
                self.refuse(&passage.header, passage.input, &why);
                passage.header.flags |= flags::VOID;
                self.pass_empty(passage, output)
            }
        }
    }

    /// Counts and logs a refused frame whose tick gets a substitute.
    pub fn refuse(&mut self, header: &Header, topic: &'static str, why: &Rejected) {
        self.tally.refuse(header, why);
        log_refused(topic, header.seq, why);
    }

    /// States the counts of a link to other boxes so far, which the next heartbeats contain. There is room for
    /// eight kinds, less the refused frames.
    pub fn set_link(&mut self, counts: impl IntoIterator<Item = (LinkCount, u64)>) {
        self.tally.set_link(counts);
    }

    /// Counts a tick as finished.
    pub fn done(&mut self, seq: u64) {
        points::finished(seq);
        self.tally.finish(seq);
    }

    /// Sends a frame without elements.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn pass_empty<O: Topic>(
        &mut self,
        mut passage: Passage,
        output: &Publisher<O>,
    ) -> Result<(), PortError> {
        passage.header.counts = Counts::default();
        passage.hop.finished_ns = monotonic_ns();
        let loan = output.loan(0)?;
        self.send(passage, output, loan)
    }

    fn send<O: Topic>(
        &mut self,
        mut passage: Passage,
        output: &Publisher<O>,
        loan: Loan<O>,
    ) -> Result<(), PortError> {
        if passage.header.has(flags::END) {
            // Sends the counts since the last heartbeat: the report is written after the end frame has
            // passed.
            self.beat()?;
        }
        passage.hop.sent_ns = monotonic_ns();
        passage.header.push_hop(passage.hop);
        output.send(loan, passage.header)?;
        self.tally.has_passed = true;
        // In lockstep the source waits for this heartbeat before it releases the next tick.
        if self.id.is_added() && passage.header.has(flags::LOCKSTEP) && passage.header.is_tick() {
            return self.beat();
        }
        self.beat_if_due()
    }

    /// Sends a heartbeat now.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn beat(&mut self) -> Result<(), PortError> {
        let heartbeat = self.tally.beat(&self.inputs, monotonic_ns());
        let mut header = Header::new(self.node.run_id(), heartbeat.beat, 0);
        header.counts.agents_len = 1;
        self.heartbeats.send_copy(&[heartbeat], header)?;
        self.memory.tend();
        Ok(())
    }

    /// The stage's current counters.
    #[must_use]
    pub fn heartbeat(&self) -> Heartbeat {
        self.tally.heartbeat(&self.inputs, monotonic_ns())
    }

    fn beat_if_due(&mut self) -> Result<(), PortError> {
        if monotonic_ns() >= self.tally.next_beat_ns() { self.beat() } else { Ok(()) }
    }

    /// Sleeps until a topic wakes the stage, a heartbeat is due or `until_ns` is reached.
    fn sleep<const N: usize>(
        &mut self,
        topics: [&dyn Wakes; N],
        until_ns: Option<u64>,
    ) -> Result<(), PortError> {
        self.check_topics();
        self.beat_if_due()?;
        let beat_ns = self.tally.next_beat_ns();
        let end_ns = until_ns.map_or(beat_ns, |until_ns| until_ns.min(beat_ns));
        let left = Duration::from_nanos(end_ns.saturating_sub(monotonic_ns()));
        points::reach(Point::Idle);
        if left.is_zero() { Ok(()) } else { wait(topics, left) }
    }
}
