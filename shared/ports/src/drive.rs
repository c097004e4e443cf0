//! Runs a step as a process of a run.

use run::{Declaration, Run};
use wire::{Header, Rejected, Topic};

use crate::executor::{Executor, Frames, Outcome, Readable, Wanted, has_work};
use crate::missing::Missing;
use crate::shedding::{Allowance, Shedder};
use crate::step::{Room, SecondInput, Step};
use crate::{
    Awaited, Frame, Loan, Passage, PortError, Publisher, Stage, StageError, Subscriber, monotonic_ns,
};

/// Runs a stage until the process is asked to end. `open` sets up the step, which answers every tick.
///
/// # Errors
/// [`StageError`] if the step can't be set up or ended, or the run's shared memory can't be used.
///
/// # Panics
/// If the declaration has other topics than the step.
pub fn drive<S: Step, O>(
    run: &Run,
    declaration: &Declaration<O>,
    open: impl FnOnce(&Run) -> Result<S, StageError>,
) -> Result<(), StageError> {
    let mut executor = Executor::new(declaration, open(run)?);
    let answered =
        Ports::open(run, declaration, &mut executor).and_then(|mut ports| ports.answer_all(&mut executor));
    let ended = executor.end(run);
    answered.and(ended)
}

/// The ports of a stage, and the tick that it is answering.
struct Ports<S: Step> {
    stage: Stage,
    input: Subscriber<S::Input>,
    second: Option<Subscriber<S::Second>>,
    output: Publisher<S::Output>,
    shedder: Shedder,
    passage: Option<Passage>,
    begun_ns: u64,
    loan: Option<Loan<S::Output>>,
    /// Why there is no memory. The process can't continue then.
    fault: Option<PortError>,
}

impl<S: Step> Ports<S> {
    fn open<O>(
        run: &Run,
        declaration: &Declaration<O>,
        executor: &mut Executor<S, Frame<S::Second>>,
    ) -> Result<Self, StageError> {
        let mut stage = Stage::open(run, declaration)?;
        let input = stage.subscribe()?;
        let second = match S::SECOND {
            SecondInput::None => None,
            SecondInput::SameTick => Some(stage.subscribe()?),
            SecondInput::Newest => Some(stage.subscribe_feedback(S::Second::DEPTH_MAX)?),
        };
        let output = stage.publish_after(|header, sent| executor.step.follow(header, sent))?;
        executor.begin(run, stage.incarnation());
        let shedder = Shedder::new(run, declaration.id());
        let (passage, begun_ns, loan, fault) = (None, 0, None, None);
        Ok(Self { stage, input, second, output, shedder, passage, begun_ns, loan, fault })
    }

    fn answer_all(&mut self, executor: &mut Executor<S, Frame<S::Second>>) -> Result<(), StageError> {
        let mut missing = Missing::default();
        loop {
            let until_ns = if S::ANSWERS_MISSING { missing.until_ns() } else { None };
            let (header, frame) = match self.stage.next_until(&self.input, until_ns)? {
                Awaited::Frame(frame) | Awaited::Void(frame) => (*frame.header(), Some(frame)),
                Awaited::Late => match missing.predict(self.input.has_no_publisher(), monotonic_ns()) {
                    Some(header) => (header, None),
                    None => continue,
                },
                Awaited::Lost(header) => (header, None),
                Awaited::Stopped => return Ok(()),
            };
            match &frame {
                Some(frame) if has_work(&header) => missing.arrive(&header, frame.received_ns()),
                Some(_) => missing.take_other(&header),
                None => {}
            }
            if !executor.tick(&header, frame.as_ref(), self)? {
                return Ok(());
            }
        }
    }
}

impl<S: Step> Frames<'static, S> for Ports<S> {
    type Input = Frame<S::Input>;
    type Second = Frame<S::Second>;
    type Fault = PortError;

    const LOGS: bool = true;

    fn pass(&mut self, header: Header, input: Option<&Frame<S::Input>>) -> Result<(), PortError> {
        let passage = match input {
            Some(frame) => self.stage.begin(frame),
            None => self.stage.begin_lost::<S::Input>(header),
        };
        self.stage.pass_empty(passage, &self.output)
    }

    fn second(&mut self, wanted: Wanted) -> Result<Awaited<Frame<S::Second>>, PortError> {
        let Self { stage, second, .. } = self;
        let Some(second) = second else { return Ok(Awaited::Late) };
        match wanted {
            Wanted::OfTick { seq, until_ns } => stage.wait_for(second, seq, until_ns),
            Wanted::Newest => Ok(second.newest()?.map_or(Awaited::Late, Awaited::Frame)),
        }
    }

    fn begin(
        &mut self,
        header: Header,
        input: Option<&Frame<S::Input>>,
        last: Option<&Frame<S::Second>>,
    ) -> Header {
        let mut passage = match (last, input) {
            (Some(last), _) => self.stage.begin(last),
            (None, Some(input)) => self.stage.begin(input),
            (None, None) => return self.passage.insert(self.stage.release(header)).header,
        };
        passage.header = header;
        self.passage.insert(passage).header
    }

    fn allowance(&mut self, header: &Header) -> Allowance<'static> {
        self.begun_ns = monotonic_ns();
        self.shedder.allow(header, self.begun_ns, monotonic_ns)
    }

    fn refuse(&mut self, header: &Header, topic: &'static str, why: &Rejected) {
        self.stage.refuse(header, topic, why);
    }

    fn send(&mut self, header: Header, outcome: Outcome, served: Option<usize>) -> Result<(), PortError> {
        self.shedder.took(monotonic_ns() - self.begun_ns, served);
        // A tick has one loan at a time: a VOID frame needs its own.
        let loan = self.loan.take().filter(|_| matches!(outcome, Outcome::Answered));
        if let Some(fault) = self.fault.take() {
            return Err(fault);
        }
        let Self { stage, output, .. } = self;
        let Some(mut passage) = self.passage.take() else { return Ok(()) };
        passage.header = header;
        match outcome {
            Outcome::Answered => {
                let loan = loan.map_or_else(|| output.loan(0), Ok)?;
                stage.finish(passage, output, Ok(loan))
            }
            Outcome::Empty => {
                stage.done(header.seq);
                stage.pass_empty(passage, output)
            }
            Outcome::Refused(why) => stage.finish(passage, output, Err(why)),
        }
    }
}

impl<S: Step> Room<S::Output> for Ports<S> {
    fn elements(&mut self, count: usize) -> Result<&mut [<S::Output as Topic>::Element], Rejected> {
        let most = S::Output::ELEMENTS_MAX as u64;
        let refused = Rejected::TooMany { field: S::Output::NAME, found: count as u64, most };
        match self.output.loan(count) {
            Ok(loan) => Ok(self.loan.insert(loan)),
            Err(fault) => {
                self.fault = Some(fault);
                Err(refused)
            }
        }
    }
}

impl<T: Topic> Readable<T> for Frame<T> {
    fn header(&self) -> &Header {
        self.header()
    }

    fn elements(&self) -> &[T::Element] {
        self
    }
}
