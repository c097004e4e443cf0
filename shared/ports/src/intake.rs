//! The memory of an input between its frames, and the decision about the next frame. Nothing here touches the
//! transport.
//!
//! Each frame is accepted, refused with a reason, or skipped because the process before this one has answered
//! it. Accepted ticks show by their numbers which ticks are missing. In lockstep a refused tick is declared
//! lost, because its sender waits for an answer and does not send it again.

use wire::{Counts, Header, REFUSALS_MAX, RefusalCause, Refusals, Rejected, SCHEMA, StageId, flags};

/// One more than the maximum stage number.
const STAGES_LEN: usize = StageId::NUMBER_MAX as usize + 1;

/// Maximum number of frames in a row that are refused because a replaced process sent them: twice the depth
/// of the deepest queue. More frames show that the newer incarnation was a flipped bit, on a topic without
/// check values.
const OLD_MAX: u32 = 16;

/// Maximum lead, in ticks, of a stage over another that waits for its frames: more than the deepest queue.
const AHEAD_MAX: u64 = 16;

/// What a run and a topic require of frames.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rules {
    pub run_id: u64,
    /// Whether frames without a check value are refused.
    pub protected: bool,
    /// Whether every stage waits for every tick.
    pub lockstep: bool,
    /// Whether the topic has one writer at a time. Otherwise each writer has its own numbers.
    pub one_writer: bool,
    /// Number of elements of a frame with these counts.
    pub elements_len: fn(&Counts) -> usize,
}

/// The decision about a frame.
#[derive(Debug, PartialEq)]
pub(crate) enum Decision {
    Accepted,
    Refused(Rejected),
    /// The previous process has answered this tick.
    Answered,
}

/// The place of a frame relative to an awaited tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    /// An older tick, or a frame that is not a tick.
    Before,
    Awaited,
    After,
    /// Waiting for this tick would never end.
    TooFar,
}

impl Place {
    pub fn of(header: &Header, awaited: u64) -> Self {
        match header.seq {
            seq if !header.is_tick() || seq < awaited => Self::Before,
            seq if seq == awaited => Self::Awaited,
            seq if seq - awaited <= AHEAD_MAX => Self::After,
            _ => Self::TooFar,
        }
    }
}

/// The memory of an input.
#[derive(Debug)]
pub(crate) struct Intake {
    rules: Rules,
    /// Whether a frame has been accepted.
    seen: bool,
    /// Number and stamp of the newest accepted or lost tick.
    newest: Option<(u64, i64)>,
    /// In lockstep: the header of this tick, and the header of a tick that was refused since the last question.
    last: Option<Header>,
    lost: Option<Header>,
    losses: Losses,
    /// Sender, incarnation and counter of the newest protected frame.
    counter: Option<(u32, u32, u32)>,
    incarnations: Incarnations,
    takeover: Takeover,
}

/// The counts of frames that did not reach the stage.
#[derive(Debug, Default)]
struct Losses {
    rejected_len: u64,
    refusals: [Refusals; REFUSALS_MAX],
    dropped_len: u64,
}

/// The state after this process has replaced a running one.
#[derive(Debug, Default)]
struct Takeover {
    /// The replaced process has answered the ticks up to this one.
    answered: Option<u64>,
    /// Whether nothing has arrived since: missing ticks were lost with the replaced process.
    is_fresh: bool,
}

/// The newest incarnation of each stage that has processed a tick, by stage number.
#[derive(Debug)]
struct Incarnations {
    newest: [u32; STAGES_LEN],
    /// Frames of an older incarnation in a row.
    old_count: u32,
}

impl Intake {
    pub fn new(rules: Rules) -> Self {
        Self {
            rules,
            seen: false,
            newest: None,
            last: None,
            lost: None,
            losses: Losses::default(),
            counter: None,
            incarnations: Incarnations { newest: [0; STAGES_LEN], old_count: 0 },
            takeover: Takeover::default(),
        }
    }

    /// Decides about a frame of `elements_len` elements and counts it. `check_value` compares its check value.
    pub fn decide(
        &mut self,
        header: &Header,
        elements_len: usize,
        check_value: impl FnOnce() -> Result<(), Rejected>,
    ) -> Decision {
        if self.is_answered(header) {
            return Decision::Answered;
        }
        match self.check(header, elements_len, check_value) {
            Ok(()) => {
                self.count(header);
                Decision::Accepted
            }
            Err(why) => {
                self.refuse(self.sender_of(header, &why), &why);
                self.declare_lost(header, &why);
                Decision::Refused(why)
            }
        }
    }

    /// Refuses an accepted tick that is too far after the awaited one.
    pub fn refuse_far(&mut self, header: &Header, awaited: u64) -> Rejected {
        let why = Rejected::Impossible { field: "seq", value: header.seq as f64 };
        self.refuse(header.sender, &why);
        // The tick was counted as the newest, and all ticks from the awaited one on as missing.
        self.losses.dropped_len = self.losses.dropped_len.saturating_sub(header.seq - awaited);
        self.newest = awaited.checked_sub(1).map(|before| (before, i64::MIN));
        why
    }

    /// In lockstep: the VOID header of a tick that was refused since the last call. The tick will not be sent
    /// again.
    pub fn take_lost(&mut self) -> Option<Header> {
        self.lost.take()
    }

    /// Skips the ticks up to this one: another process has answered them.
    pub fn resume_after(&mut self, seq: u64) {
        self.takeover = Takeover { answered: Some(seq), is_fresh: true };
        self.newest = Some((seq, i64::MIN));
    }

    pub fn seen(&self) -> bool {
        self.seen
    }

    pub fn rejected_len(&self) -> u64 {
        self.losses.rejected_len
    }

    pub fn refusals(&self) -> [Refusals; REFUSALS_MAX] {
        self.losses.refusals
    }

    pub fn dropped_len(&self) -> u64 {
        self.losses.dropped_len
    }

    fn check(
        &mut self,
        header: &Header,
        elements_len: usize,
        check_value: impl FnOnce() -> Result<(), Rejected>,
    ) -> Result<(), Rejected> {
        let Rules { run_id, protected, one_writer, elements_len: expected_len, .. } = self.rules;
        // The order matters: if a frame is damaged, its other fields do not show the cause.
        header.check_schema()?;
        if protected {
            check_value()?;
        }
        header.check()?;
        if header.run_id != run_id {
            return Err(Rejected::ForeignRun { found: header.run_id, expected: run_id });
        }
        if one_writer {
            self.incarnations.check(header.sender, header.incarnation)?;
        }
        self.check_repetition(header)?;
        let expected = expected_len(&header.counts);
        if elements_len != expected {
            return Err(Rejected::Length { found: elements_len, expected });
        }
        if protected {
            self.check_counter(header)?;
        }
        Ok(())
    }

    /// The sender that a refused frame is counted for. If the header is not credible, it is the sender of the
    /// newest credible frame.
    fn sender_of(&self, header: &Header, why: &Rejected) -> u32 {
        match (self.counter, why.cause()) {
            (Some((sender, ..)), RefusalCause::CheckValue) if self.rules.one_writer => sender,
            _ => header.sender,
        }
    }

    /// In lockstep, declares the tick of a refused frame lost. It is the tick after the newest, because
    /// lockstep has no gaps. If the frame is an extra one, no tick is lost with it.
    fn declare_lost(&mut self, header: &Header, why: &Rejected) {
        let Rules { run_id, lockstep, one_writer, .. } = self.rules;
        let is_extra = matches!(
            why.cause(),
            RefusalCause::Repeated | RefusalCause::Order | RefusalCause::OldIncarnation
        );
        if !lockstep || !one_writer || is_extra || !header.is_tick() {
            return;
        }
        let seq = self.newest.map_or(0, |(newest, _)| newest + 1);
        let is_believed = !matches!(
            why.cause(),
            RefusalCause::Schema | RefusalCause::CheckValue | RefusalCause::Unprotected
        ) && header.check().is_ok()
            && (header.run_id, header.seq) == (run_id, seq);
        let next = |last: Header| Header {
            stamp_ns: last.stamp_ns.saturating_add_unsigned(last.interval_ns),
            released_ns: last.released_ns.saturating_add(last.interval_ns),
            ..last
        };
        let base = match self.last {
            _ if is_believed => *header,
            Some(last) => next(last).with_hops_of(&Header::default()),
            None => Header::default(),
        };
        let lost = Header {
            run_id,
            seq,
            flags: base.flags | flags::VOID | flags::LOCKSTEP,
            counts: Counts::default(),
            ..Header { schema: SCHEMA, ..base }
        };
        self.newest = Some((seq, lost.stamp_ns));
        self.last = Some(lost);
        self.lost = Some(lost);
    }

    /// Refuses a repeated tick from a stage that was restarted since. The restarted stage's first input frame
    /// is the last frame of its predecessor, which may have passed it on.
    fn check_repetition(&self, header: &Header) -> Result<(), Rejected> {
        let Some((newest, last_ns)) = self.newest else { return Ok(()) };
        let is_answer = header.is_tick() && !header.has(flags::VOID);
        // The frame of a tick that was declared lost: another tick's frame had arrived in its place.
        let is_lost = self.last.is_some_and(|last| last.has(flags::VOID) && last.seq == header.seq);
        let is_repeated = self.rules.one_writer && header.seq <= newest && self.incarnations.is_newer(header);
        if is_answer && (self.rules.lockstep && is_lost || is_repeated) {
            return Err(Rejected::NotNewer { stamp_ns: header.stamp_ns, last_ns });
        }
        Ok(())
    }

    /// Refuses repeated and overtaken frames. If a topic has several writers, each writer has its own
    /// counter.
    fn check_counter(&mut self, header: &Header) -> Result<(), Rejected> {
        let Header { sender, incarnation, protection, .. } = *header;
        if let Some((last_sender, last_incarnation, newest)) = self.counter
            && self.rules.one_writer
            && (last_sender, last_incarnation) == (sender, incarnation)
        {
            protection.check_counter(newest)?;
        }
        self.counter = Some((sender, incarnation, protection.counter));
        Ok(())
    }

    /// Whether the previous process has answered this tick. Such ticks are at the front of the queue.
    fn is_answered(&mut self, header: &Header) -> bool {
        let Some(answered) = self.takeover.answered else { return false };
        let is_answered = header.is_tick() && header.seq <= answered;
        if header.is_tick() && !is_answered {
            self.takeover.answered = None;
        }
        is_answered
    }

    fn refuse(&mut self, sender: u32, why: &Rejected) {
        self.losses.rejected_len += 1;
        Refusals::count(&mut self.losses.refusals, sender, why.cause(), 1);
    }

    /// Counts dropped ticks. The source numbers ticks in order and without gaps, so a gap is a tick that the
    /// queue dropped. If an earlier stage was restarted in the meantime, the ticks were lost with it and do
    /// not count. A reader that joins a run without a warm-up frame counts from the first tick that it
    /// receives.
    fn count(&mut self, header: &Header) {
        let was_seen = std::mem::replace(&mut self.seen, true);
        // A restarted source sends warm-up frames before its first tick: only ticks show a restart here.
        if !header.is_tick() {
            return;
        }
        let is_restarted = self.rules.one_writer && self.incarnations.learn(header);
        let is_restarted = std::mem::take(&mut self.takeover.is_fresh) || is_restarted;
        let expected = match self.newest {
            Some((newest, _)) => newest + 1,
            None if was_seen => 0,
            None => header.seq,
        };
        if header.seq + 1 < expected {
            // Others have overtaken this tick: it was counted as missing when they arrived.
            self.losses.dropped_len = self.losses.dropped_len.saturating_sub(1);
            return;
        }
        // If a topic has several writers, each writer has its own counter.
        if self.rules.one_writer && !is_restarted {
            self.losses.dropped_len += header.seq.saturating_sub(expected);
        }
        self.newest = Some((header.seq, header.stamp_ns));
        if self.rules.lockstep {
            self.last = Some(*header);
        }
    }
}

impl Incarnations {
    /// Refuses a frame of a replaced process: it must not follow its successor's first frame. After
    /// [`OLD_MAX`] of them the restart is reverted: the process that was taken for dead has sent more frames
    /// than it can have left.
    fn check(&mut self, sender: u32, found: u32) -> Result<(), Rejected> {
        let Some(newest) = self.newest.get_mut(sender as usize) else { return Ok(()) };
        self.old_count = if found < *newest { self.old_count + 1 } else { 0 };
        match self.old_count {
            0 => {}
            1..=OLD_MAX => return Err(Rejected::OldIncarnation { found, newest: *newest }),
            _ => (*newest, self.old_count) = (found, 0),
        }
        Ok(())
    }

    /// The stages in a frame's path with their incarnations; the sender is the last.
    fn path(header: &Header) -> impl Iterator<Item = (u32, u32)> {
        let passed = header.hops().iter().map(|hop| (hop.stage, hop.incarnation));
        passed.chain([(header.sender, header.incarnation)])
    }

    /// Whether a stage in the frame's path was restarted since the previous frame.
    fn is_newer(&self, header: &Header) -> bool {
        let is_new = |(stage, incarnation): (u32, u32)| {
            self.newest.get(stage as usize).is_some_and(|newest| *newest < incarnation)
        };
        Self::path(header).any(is_new)
    }

    /// As [`Incarnations::is_newer`]; the newer incarnations count from now on.
    fn learn(&mut self, header: &Header) -> bool {
        let is_newer = self.is_newer(header);
        for (stage, incarnation) in Self::path(header) {
            if let Some(newest) = self.newest.get_mut(stage as usize) {
                *newest = incarnation.max(*newest);
            }
        }
        is_newer
    }
}

#[cfg(test)]
mod tests;
