//! The executor: takes a stage's step through a tick, wherever the tick's frames are.
//!
//! For each frame of the input, in order:
//!
//! 1. A frame that is no tick, or that an earlier stage has refused (VOID), is passed on without elements.
//! 2. The frame of the second input is chosen: that of the same tick, or the newest one that a later stage has
//!    sent. In lockstep the latter is that of the previous tick. If it is VOID, the step gets the older one.
//! 3. The step answers the tick. If it refuses the tick or leaves it empty, a VOID frame is sent.
//! 4. [`Step::after`] and [`Step::log`] follow when the answer is sent.
//!
//! [`Frames`] is the place of the frames: shared memory ([`drive`](crate::drive)), or the memory of one process
//! (`onboard::Graph`), which a recording can fill (`onboard::Replay`).

use run::{Declaration, Run};
use wire::{Counts, Header, Rejected, StageId, Topic, flags};

use crate::shedding::Allowance;
use crate::step::{Answer, Room, Second, SecondInput, Step, Tick};
use crate::{Awaited, StageError};

/// A frame that an executor can read.
pub trait Readable<T: Topic> {
    /// Its header.
    fn header(&self) -> &Header;
    /// Its elements.
    fn elements(&self) -> &[T::Element];
}

impl<T: Topic, F: Readable<T>> Readable<T> for std::sync::Arc<F> {
    fn header(&self) -> &Header {
        (**self).header()
    }

    fn elements(&self) -> &[T::Element] {
        (**self).elements()
    }
}

/// The frame of a second input that a tick waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wanted {
    /// The frame of this tick. It is late after `until_ns` on `CLOCK_MONOTONIC`, if there is such a time.
    OfTick {
        /// The tick.
        seq: u64,
        /// The end of the wait.
        until_ns: Option<u64>,
    },
    /// The newest frame that is not VOID, without a wait.
    Newest,
}

/// How a tick has ended.
#[derive(Debug)]
pub enum Outcome {
    /// The step has written the elements of a frame.
    Answered,
    /// The step has left the tick empty.
    Empty,
    /// The step has refused the tick.
    Refused(Rejected),
}

/// The place that the frames of a stage come from, and that its answers go to.
pub trait Frames<'a, S: Step>: Room<S::Output> {
    /// A frame of the input.
    type Input: Readable<S::Input>;
    /// A frame of the second input.
    type Second: Readable<S::Second>;
    /// Why frames can't be received or sent.
    type Fault;

    /// Whether the step logs its findings.
    const LOGS: bool;

    /// Passes on a frame without work. The frame is `None` if it was refused on its way here.
    ///
    /// # Errors
    /// If the frame can't be sent.
    fn pass(&mut self, header: Header, input: Option<&Self::Input>) -> Result<(), Self::Fault>;

    /// Waits for a frame of the second input.
    ///
    /// # Errors
    /// If the frame can't be received.
    fn second(&mut self, wanted: Wanted) -> Result<Awaited<Self::Second>, Self::Fault>;

    /// Starts a tick whose frames have arrived; the frame of a second input of the same tick arrives last.
    /// Returns the header that the answer starts with. A tick without frames is predicted.
    fn begin(&mut self, header: Header, input: Option<&Self::Input>, last: Option<&Self::Second>) -> Header;

    /// The agents that the step may serve.
    fn allowance(&mut self, header: &Header) -> Allowance<'a>;

    /// Counts a frame as refused although the tick is answered.
    fn refuse(&mut self, header: &Header, topic: &'static str, why: &Rejected);

    /// Sends the answer. If the step has not asked for elements, it has none. `served` is the number of served
    /// agents, if the step reports it.
    ///
    /// # Errors
    /// If the answer can't be sent.
    fn send(&mut self, header: Header, outcome: Outcome, served: Option<usize>) -> Result<(), Self::Fault>;
}

/// A step with the state that its ticks share.
#[derive(Debug)]
pub struct Executor<S, F> {
    /// The step.
    pub step: S,
    id: StageId,
    /// The newest frame of a second input that a later stage writes.
    newest: Option<F>,
}

impl<S: Step, F: Readable<S::Second>> Executor<S, F> {
    /// A step before its first tick.
    ///
    /// # Panics
    /// If the declaration has other topics than the step.
    pub fn new<O>(declaration: &Declaration<O>, step: S) -> Self {
        let (reads, writes) = (reads::<S>(), [S::Output::NAME]);
        let id = declaration.id();
        assert_eq!((declaration.reads(), declaration.writes()), (reads, &writes[..]), "topics of the {id:?}");
        Self { step, id, newest: None }
    }

    /// Begins with the first tick; `incarnation` counts the earlier starts of the stage.
    pub fn begin(&mut self, run: &Run, incarnation: u32) {
        self.step.begin(run, incarnation);
    }

    /// Ends after the last tick.
    ///
    /// # Errors
    /// As [`Step::end`].
    pub fn end(&mut self, run: &Run) -> Result<(), StageError> {
        self.step.end(run)
    }

    /// Takes a frame of the input through the stage. Without a frame, `header` is that of a tick that never
    /// arrived. Returns `false` if the process has been asked to end.
    ///
    /// # Errors
    /// If frames can't be received or sent.
    pub fn tick<'a, L: Frames<'a, S, Second = F>>(
        &mut self,
        header: &Header,
        input: Option<&L::Input>,
        frames: &mut L,
    ) -> Result<bool, L::Fault> {
        if !has_work(header) {
            frames.pass(void(*header, header.flags), input)?;
            // The second input's frame of the tick is VOID as well. In the queue it would push out later frames,
            // which would then count as lost.
            if S::SECOND == SecondInput::SameTick && header.is_tick() {
                frames.second(Wanted::OfTick { seq: header.seq, until_ns: Some(0) })?;
            }
            return Ok(true);
        }
        let wanted = wanted(S::SECOND, header, self.step.second_deadline_ns());
        let awaited = wanted.map(|wanted| frames.second(wanted)).transpose()?;
        let Some(awaited) = keep(S::SECOND, awaited, &mut self.newest) else { return Ok(false) };
        let last = match &awaited {
            Awaited::Frame(frame) | Awaited::Void(frame) => Some(frame),
            _ => None,
        };
        let second = match (&awaited, &self.newest) {
            (Awaited::Frame(frame), _) | (Awaited::Late, Some(frame)) => {
                Second::Frame(frame.header(), frame.elements())
            }
            (Awaited::Void(_) | Awaited::Lost(_), _) => Second::Refused,
            (Awaited::Late | Awaited::Stopped, _) => Second::None,
        };
        let begun = last.map_or(*header, |frame| header.with_hops_of(frame.header()));
        let begun = frames.begin(begun, input, last);
        let _span = tracing::debug_span!("step", stage = self.id.name(), tick = header.seq).entered();
        let allowance = frames.allowance(header);
        let tick = Tick { header, input: input.map_or(&[], |frame| frame.elements()), second, allowance };
        let mut out = Answer::new(begun, frames);
        let result = self.step.answer(&tick, &mut out);
        let Answer { header: answered, served, refused, is_empty, .. } = out;
        if let Some((topic, why)) = refused {
            let of = second.frame().filter(|_| topic == S::Second::NAME);
            frames.refuse(of.map_or(header, |(header, _)| header), topic, &why);
        }
        let voided = void(answered, answered.flags | flags::VOID);
        match result {
            Ok(()) if is_empty => frames.send(voided, Outcome::Empty, served),
            Ok(()) => frames.send(answered, Outcome::Answered, served),
            Err(why) => frames.send(voided, Outcome::Refused(why), None),
        }?;
        self.step.after(&tick);
        if L::LOGS {
            self.step.log();
        }
        Ok(true)
    }
}

/// The topics that a step reads.
pub(crate) const fn reads<S: Step>() -> &'static [&'static str] {
    match S::SECOND {
        SecondInput::None => const { &[<S::Input as Topic>::NAME] },
        _ => const { &[<S::Input as Topic>::NAME, <S::Second as Topic>::NAME] },
    }
}

/// Whether a step answers a frame: a tick that no earlier stage has refused.
pub(crate) fn has_work(header: &Header) -> bool {
    header.is_tick() && !header.has(flags::VOID)
}

/// The header of a frame without elements.
fn void(header: Header, flags: u32) -> Header {
    Header { flags, counts: Counts::default(), ..header }
}

/// The frame of the second input that a tick waits for; `None` if there is no second input.
fn wanted(rule: SecondInput, header: &Header, deadline_ns: u64) -> Option<Wanted> {
    let is_lockstep = header.has(flags::LOCKSTEP);
    match rule {
        SecondInput::None => None,
        SecondInput::SameTick => {
            let until_ns = (!is_lockstep).then(|| header.released_ns.saturating_add(deadline_ns));
            Some(Wanted::OfTick { seq: header.seq, until_ns })
        }
        SecondInput::Newest if is_lockstep && header.seq > 0 => {
            Some(Wanted::OfTick { seq: header.seq - 1, until_ns: None })
        }
        SecondInput::Newest => Some(Wanted::Newest),
    }
}

/// Moves a frame that a later stage has sent to `newest`, unless it is VOID or there is none. What is returned
/// belongs to the tick; `None` if the process has been asked to end.
fn keep<F>(rule: SecondInput, awaited: Option<Awaited<F>>, newest: &mut Option<F>) -> Option<Awaited<F>> {
    match (rule, awaited) {
        (_, Some(Awaited::Stopped)) => None,
        (SecondInput::Newest, Some(Awaited::Frame(frame))) => {
            *newest = Some(frame);
            Some(Awaited::Late)
        }
        (SecondInput::SameTick, Some(awaited)) => Some(awaited),
        _ => Some(Awaited::Late),
    }
}

#[cfg(test)]
mod tests;
