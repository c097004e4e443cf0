use std::cell::{Cell, RefCell};
use std::marker::PhantomData;
use std::ops::Deref;
use std::os::fd::BorrowedFd;
use std::rc::Rc;
use std::time::Duration;

use bytemuck::cast_slice;
use iceoryx2::port::listener::Listener;
use iceoryx2::prelude::ipc;
use wire::{
    Counts, Header, Protection, REFUSALS_MAX, RefusalCause, Refusals, Rejected, SCHEMA, StageId, Topic, flags,
};

use crate::error::log_refused;
use crate::transport::{Reader, Received};
use crate::wait::{Wakes, wait, wait_also};
use crate::{PortError, monotonic_ns};

/// The reading end of a topic.
#[derive(Debug)]
pub struct Subscriber<T: Topic>(Rc<Port<T>>);

#[derive(Debug)]
struct Port<T: Topic> {
    reader: Reader,
    run_id: u64,
    /// Whether frames without a check value are refused.
    protected: bool,
    /// Whether every stage waits for every tick. A tick that is refused here is then declared lost.
    lockstep: bool,
    /// Number and stamp of the newest received tick.
    newest: Cell<Option<(u64, i64)>>,
    /// A frame of a later tick than the awaited one.
    early: RefCell<Option<Frame<T>>>,
    seen: Cell<bool>,
    rejected_len: Cell<u64>,
    refusals: Cell<[Refusals; REFUSALS_MAX]>,
    /// Sender, incarnation and counter of the newest protected frame.
    counter: Cell<Option<(u32, u32, u32)>>,
    dropped_len: Cell<u64>,
    /// The newest incarnation of each stage that has processed a tick, by stage number.
    incarnations: Cell<[u32; STAGES_LEN]>,
    /// Frames of an older incarnation in a row.
    old_count: Cell<u32>,
    /// In lockstep: the newest tick's header, and the header of a tick that was refused since.
    last: Cell<Option<Header>>,
    lost: Cell<Option<Header>>,
    /// The replaced process has answered the ticks up to this one.
    answered: Cell<Option<u64>>,
    /// Whether nothing has arrived since the takeover: missing ticks were lost with the old process.
    resumed: Cell<bool>,
}

/// One more than the maximum stage number.
const STAGES_LEN: usize = StageId::NUMBER_MAX as usize + 1;

/// Maximum number of frames in a row that are refused because a replaced process sent them: twice the depth
/// of the deepest queue. More frames show that the newer incarnation was a flipped bit, on a topic without
/// check values.
const OLD_MAX: u32 = 16;

/// Maximum lead, in ticks, of a stage over another that waits for its frames: more than the deepest queue.
const AHEAD_MAX: u64 = 16;

/// One frame in shared memory; dropping it frees the memory.
#[derive(Debug)]
pub struct Frame<T: Topic> {
    frame: Received,
    received_ns: u64,
    topic: PhantomData<T>,
}

impl<T: Topic> Frame<T> {
    /// The frame's header, checked.
    #[must_use]
    pub fn header(&self) -> &Header {
        self.frame.header()
    }

    /// When the frame was taken from its queue, on `CLOCK_MONOTONIC`.
    #[must_use]
    pub const fn received_ns(&self) -> u64 {
        self.received_ns
    }
}

impl<T: Topic> Deref for Frame<T> {
    type Target = [T::Element];

    fn deref(&self) -> &[T::Element] {
        cast_slice(self.frame.bytes())
    }
}

impl<T: Topic> Subscriber<T> {
    pub(crate) fn new(reader: Reader, run_id: u64, protected: bool, lockstep: bool) -> Self {
        let (newest, early) = (Cell::new(None), RefCell::new(None));
        let (seen, rejected_len, dropped_len) = (Cell::new(false), Cell::new(0), Cell::new(0));
        let (refusals, counter) = (Cell::default(), Cell::new(None));
        let incarnations = Cell::new([0; STAGES_LEN]);
        let (last, lost, old_count) = (Cell::new(None), Cell::new(None), Cell::new(0));
        Self(Rc::new(Port {
            reader,
            run_id,
            protected,
            lockstep,
            newest,
            early,
            seen,
            rejected_len,
            refusals,
            counter,
            dropped_len,
            incarnations,
            old_count,
            last,
            lost,
            answered: Cell::new(None),
            resumed: Cell::new(false),
        }))
    }

    /// The oldest frame of the queue; `None` if the queue is empty. Frames with an impossible header or a
    /// wrong check value are counted and skipped.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn receive(&self) -> Result<Option<Frame<T>>, PortError> {
        if let Some(frame) = self.0.early.take() {
            return Ok(Some(frame));
        }
        while let Some(frame) = self.0.reader.receive()? {
            let frame = Frame { frame, received_ns: monotonic_ns(), topic: PhantomData };
            if self.0.is_answered(frame.header()) {
                continue;
            }
            match self.0.check(&frame) {
                Ok(()) => {
                    self.0.count(frame.header());
                    return Ok(Some(frame));
                }
                Err(why) => {
                    self.0.refuse(self.0.sender_of(frame.header(), &why), &why);
                    log_refused(T::NAME, frame.header().seq, &why);
                    self.0.lose(frame.header(), &why);
                }
            }
        }
        Ok(None)
    }

    /// In lockstep: the VOID header of a tick that was refused since the last call. The tick will not be sent
    /// again.
    pub(crate) fn take_lost(&self) -> Option<Header> {
        self.0.lost.take()
    }

    /// The newest tick of the queue that is not VOID, if there is one; all other frames are dropped.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn newest(&self) -> Result<Option<Frame<T>>, PortError> {
        let mut newest = None;
        while let Some(frame) = self.receive()? {
            if frame.header().is_tick() && !frame.header().has(flags::VOID) {
                newest = Some(frame);
            }
        }
        Ok(newest)
    }

    /// The frame of tick `seq`, if it is in the queue. Older frames are dropped, newer ones stay for later.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn of_tick(&self, seq: u64) -> Result<Option<Frame<T>>, PortError> {
        while let Some(frame) = self.receive()? {
            match (frame.header().is_tick(), frame.header().seq) {
                (true, found) if found == seq => return Ok(Some(frame)),
                (true, found) if found > seq + AHEAD_MAX => {
                    // Waiting for that tick would never end.
                    let why = Rejected::Impossible { field: "seq", value: found as f64 };
                    self.0.refuse(frame.header().sender, &why);
                    self.0.uncount(found, seq);
                    log_refused(T::NAME, found, &why);
                }
                (true, found) if found > seq => {
                    self.0.early.replace(Some(frame));
                    return Ok(None);
                }
                _ => {}
            }
        }
        Ok(None)
    }

    /// Whether no process has the topic open for writing. A dead writer counts until the launcher has cleaned
    /// up after it.
    #[must_use]
    pub fn has_no_publisher(&self) -> bool {
        !self.0.reader.has_publisher()
    }

    /// Sleeps until the topic has an event, a signal arrives or `timeout` has passed. May return early: check
    /// the queue.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn sleep(&self, timeout: Duration) -> Result<(), PortError> {
        wait([self], timeout)
    }

    /// As [`Subscriber::sleep`], and also until one of `others` is readable, such as the descriptor of an
    /// ended process.
    ///
    /// # Errors
    /// [`PortError`] if the transport fails.
    pub fn sleep_or(&self, others: &[BorrowedFd<'_>], timeout: Duration) -> Result<(), PortError> {
        wait_also(self, others, timeout)
    }

    /// The input in the form that its stage counts.
    pub(crate) fn input(&self) -> Rc<dyn Input> {
        self.0.clone()
    }
}

/// An input in the form that its stage counts, independent of the element type.
pub(crate) trait Input: std::fmt::Debug {
    /// Whether a frame has arrived, taken from the queue or not.
    fn linked(&self) -> bool;
    /// Number of refused frames.
    fn rejected_len(&self) -> u64;
    /// Refused frames by sender and cause.
    fn refusals(&self) -> [Refusals; REFUSALS_MAX];
    /// Number of frames that never arrived.
    fn dropped_len(&self) -> u64;
    /// Skips the ticks up to this one: another process has answered them.
    fn resume_after(&self, seq: u64);
}

impl<T: Topic> Input for Port<T> {
    fn linked(&self) -> bool {
        self.seen.get() || self.reader.has_frames()
    }

    fn rejected_len(&self) -> u64 {
        self.rejected_len.get()
    }

    fn refusals(&self) -> [Refusals; REFUSALS_MAX] {
        self.refusals.get()
    }

    fn dropped_len(&self) -> u64 {
        self.dropped_len.get()
    }

    fn resume_after(&self, seq: u64) {
        self.answered.set(Some(seq));
        self.newest.set(Some((seq, i64::MIN)));
        self.resumed.set(true);
    }
}

impl<T: Topic> Wakes for Subscriber<T> {
    fn listener(&self) -> &Listener<ipc::Service> {
        self.0.reader.listener()
    }
}

impl<T: Topic> Port<T> {
    fn check(&self, frame: &Frame<T>) -> Result<(), Rejected> {
        let header = frame.header();
        // The order matters: if a frame is damaged, its other fields do not show the cause.
        header.check_schema()?;
        if self.protected {
            Protection::check::<T>(header, frame)?;
        }
        header.check()?;
        if header.run_id != self.run_id {
            return Err(Rejected::ForeignRun { found: header.run_id, expected: self.run_id });
        }
        // A topic with one writer: frames of a replaced process must not follow its successor's first frame.
        if T::PUBLISHERS_MAX == 1
            && let Some(&newest) = self.incarnations.get().get(header.sender as usize)
        {
            let found = header.incarnation;
            self.old_count.set(if found < newest { self.old_count.get() + 1 } else { 0 });
            if (1..=OLD_MAX).contains(&self.old_count.get()) {
                return Err(Rejected::OldIncarnation { found, newest });
            }
            if found < newest {
                self.believe(header.sender, found);
            }
        }
        self.check_repetition(header)?;
        let expected = T::elements_len(&header.counts);
        if frame.len() != expected {
            return Err(Rejected::Length { found: frame.len(), expected });
        }
        if self.protected {
            self.check_counter(header)?;
        }
        Ok(())
    }

    /// The sender that a refused frame is counted for. If the header is not credible, it is the sender of the
    /// newest credible frame.
    fn sender_of(&self, header: &Header, why: &Rejected) -> u32 {
        match (self.counter.get(), why.cause()) {
            (Some((sender, ..)), RefusalCause::CheckValue) if T::PUBLISHERS_MAX == 1 => sender,
            _ => header.sender,
        }
    }

    /// In lockstep, declares the tick of a refused frame lost. It is the tick after the newest, because
    /// lockstep has no gaps. If the frame is an extra one, no tick is lost with it.
    fn lose(&self, header: &Header, why: &Rejected) {
        let is_extra = matches!(
            why.cause(),
            RefusalCause::Repeated | RefusalCause::Order | RefusalCause::OldIncarnation
        );
        if !self.lockstep || T::PUBLISHERS_MAX != 1 || is_extra || !header.is_tick() {
            return;
        }
        let seq = self.newest.get().map_or(0, |(newest, _)| newest + 1);
        let is_believed = !matches!(
            why.cause(),
            RefusalCause::Schema | RefusalCause::CheckValue | RefusalCause::Unprotected
        ) && header.check().is_ok()
            && (header.run_id, header.seq) == (self.run_id, seq);
        let next = |last: Header| Header {
            stamp_ns: last.stamp_ns.saturating_add_unsigned(last.interval_ns),
            released_ns: last.released_ns.saturating_add(last.interval_ns),
            ..last
        };
        let base = match self.last.get() {
            _ if is_believed => *header,
            Some(last) => next(last).with_hops_of(&Header::default()),
            None => Header::default(),
        };
        let lost = Header {
            run_id: self.run_id,
            seq,
            flags: base.flags | flags::VOID | flags::LOCKSTEP,
            counts: Counts::default(),
            ..Header { schema: SCHEMA, ..base }
        };
        self.newest.set(Some((seq, lost.stamp_ns)));
        self.last.set(Some(lost));
        self.lost.set(Some(lost));
    }

    /// Reverts the restart of a stage: the process that was taken for dead has sent more frames than it can
    /// have left.
    fn believe(&self, stage: u32, incarnation: u32) {
        let mut incarnations = self.incarnations.get();
        if let Some(newest) = incarnations.get_mut(stage as usize) {
            *newest = incarnation;
        }
        self.incarnations.set(incarnations);
        self.old_count.set(0);
    }

    /// Refuses a repeated tick from a stage that was restarted since. The restarted stage's first input frame
    /// is the last frame of its predecessor, which may have passed it on.
    fn check_repetition(&self, header: &Header) -> Result<(), Rejected> {
        let Some((newest, last_ns)) = self.newest.get() else { return Ok(()) };
        // The frame of a tick that was declared lost: another tick's frame had arrived in its place.
        let is_lost = self.last.get().is_some_and(|last| last.has(flags::VOID) && last.seq == header.seq);
        if self.lockstep && is_lost && header.is_tick() && !header.has(flags::VOID) {
            return Err(Rejected::NotNewer { stamp_ns: header.stamp_ns, last_ns });
        }
        let is_new = |(stage, incarnation): (u32, u32)| {
            self.incarnations.get().get(stage as usize).is_some_and(|newest| *newest < incarnation)
        };
        let mut passed = header.hops().iter().map(|hop| (hop.stage, hop.incarnation));
        let restarted = is_new((header.sender, header.incarnation)) || passed.any(is_new);
        let is_repeated = header.is_tick() && !header.has(flags::VOID) && header.seq <= newest;
        if T::PUBLISHERS_MAX == 1 && restarted && is_repeated {
            return Err(Rejected::NotNewer { stamp_ns: header.stamp_ns, last_ns });
        }
        Ok(())
    }

    /// Refuses repeated and overtaken frames. If a topic has several writers, each writer has its own
    /// counter.
    fn check_counter(&self, header: &Header) -> Result<(), Rejected> {
        let Header { sender, incarnation, protection, .. } = *header;
        if let Some((of, in_its, newest)) = self.counter.get()
            && T::PUBLISHERS_MAX == 1
            && (of, in_its) == (sender, incarnation)
        {
            protection.check_counter(newest)?;
        }
        self.counter.set(Some((sender, incarnation, protection.counter)));
        Ok(())
    }

    /// Whether the previous process has answered this tick. Such ticks are at the front of the queue.
    fn is_answered(&self, header: &Header) -> bool {
        let Some(answered) = self.answered.get() else { return false };
        let is_answered = header.is_tick() && header.seq <= answered;
        if header.is_tick() && !is_answered {
            self.answered.set(None);
        }
        is_answered
    }

    fn refuse(&self, sender: u32, why: &Rejected) {
        self.rejected_len.set(self.rejected_len.get() + 1);
        let mut refusals = self.refusals.get();
        Refusals::count(&mut refusals, sender, why.cause(), 1);
        self.refusals.set(refusals);
    }

    /// Counts dropped ticks. The source numbers ticks in order and without gaps, so a gap is a tick that the
    /// queue dropped. If an earlier stage was restarted in the meantime, the ticks were lost with it and do
    /// not count. A reader that joins a run without a warm-up frame counts from the first tick that it
    /// receives.
    fn count(&self, header: &Header) {
        let linked = self.seen.replace(true);
        // A restarted source sends warm-up frames before its first tick: only ticks show a restart here.
        if !header.is_tick() {
            return;
        }
        let restarted = T::PUBLISHERS_MAX == 1 && self.has_new_incarnation(header);
        let restarted = self.resumed.take() || restarted;
        let expected = match self.newest.get() {
            Some((newest, _)) => newest + 1,
            None if linked => 0,
            None => header.seq,
        };
        if header.seq + 1 < expected {
            // Others have overtaken this tick: it was counted as missing when they arrived.
            self.dropped_len.set(self.dropped_len.get().saturating_sub(1));
            return;
        }
        // If a topic has several writers, each writer has its own counter.
        if T::PUBLISHERS_MAX == 1 && !restarted {
            self.dropped_len.set(self.dropped_len.get() + header.seq.saturating_sub(expected));
        }
        self.newest.set(Some((header.seq, header.stamp_ns)));
        if self.lockstep {
            self.last.set(Some(*header));
        }
    }

    /// Reverts a count: a frame was counted as tick `found`, and all ticks from `awaited` on as missing.
    fn uncount(&self, found: u64, awaited: u64) {
        self.dropped_len.set(self.dropped_len.get().saturating_sub(found - awaited));
        self.newest.set(awaited.checked_sub(1).map(|before| (before, i64::MIN)));
    }

    /// Whether a stage in the frame's path was restarted since the previous frame.
    fn has_new_incarnation(&self, header: &Header) -> bool {
        let mut incarnations = self.incarnations.get();
        let passed = header.hops().iter().map(|hop| (hop.stage, hop.incarnation));
        let mut is_new = false;
        for (stage, incarnation) in passed.chain([(header.sender, header.incarnation)]) {
            if let Some(newest) = incarnations.get_mut(stage as usize).filter(|newest| **newest < incarnation)
            {
                *newest = incarnation;
                is_new = true;
            }
        }
        if is_new {
            self.incarnations.set(incarnations);
        }
        is_new
    }
}
