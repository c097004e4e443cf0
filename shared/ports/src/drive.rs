//! Runs a step as a process of a run.

use crate::shedding::Shedder;
use run::{Declaration, Run};
use wire::{Header, Rejected, Topic, flags};

use crate::missing::Missing;
use crate::step::{Answer, Room, Second, SecondInput, Step, Tick};
use crate::{
    Awaited, Frame, Loan, Passage, PortError, Publisher, Stage, StageError, Subscriber, monotonic_ns,
};

/// Runs a stage until the process is asked to end. `open` sets up the step, which answers every tick.
///
/// # Errors
/// [`StageError`] if the step can't be set up or ended, or the run's shared memory can't be used.
pub fn drive<S: Step, O>(
    run: &Run,
    declaration: &Declaration<O>,
    open: impl FnOnce(&Run) -> Result<S, StageError>,
) -> Result<(), StageError> {
    let mut step = open(run)?;
    let answered = Driver::open(run, declaration, &mut step).and_then(|driver| driver.answer_all(&mut step));
    let ended = step.end(run);
    answered.and(ended)
}

/// The ports of a stage, and the driver's state between ticks.
struct Driver<S: Step> {
    stage: Stage,
    input: Subscriber<S::Input>,
    second: Option<Subscriber<S::Second>>,
    output: Publisher<S::Output>,
    shedder: Shedder,
    missing: Missing,
    /// The newest frame of a second input that a later stage writes.
    newest: Option<Frame<S::Second>>,
}

impl<S: Step> Driver<S> {
    fn open<O>(run: &Run, declaration: &Declaration<O>, step: &mut S) -> Result<Self, StageError> {
        let mut stage = Stage::open(run, declaration)?;
        let input = stage.subscribe()?;
        let second = match S::SECOND {
            SecondInput::None => None,
            SecondInput::SameTick => Some(stage.subscribe()?),
            SecondInput::Newest => Some(stage.subscribe_feedback(S::Second::DEPTH_MAX)?),
        };
        let output = stage.publish_after(|header, sent| step.follow(header, sent))?;
        step.begin(run, stage.incarnation());
        let (shedder, missing) = (Shedder::new(run, declaration.id()), Missing::default());
        Ok(Self { stage, input, second, output, shedder, missing, newest: None })
    }

    fn answer_all(mut self, step: &mut S) -> Result<(), StageError> {
        loop {
            let until_ns = if S::ANSWERS_MISSING { self.missing.until_ns() } else { None };
            let (header, frame) = match self.stage.next_until(&self.input, &self.output, until_ns)? {
                Awaited::Frame(frame) => (*frame.header(), Some(frame)),
                Awaited::Late => match self.missing.predict(self.input.has_no_publisher(), monotonic_ns()) {
                    Some(header) => (header, None),
                    None => continue,
                },
                Awaited::Void(frame) => {
                    self.pass_void(frame.header())?;
                    continue;
                }
                Awaited::Lost => continue,
                Awaited::Stopped => return Ok(()),
            };
            if let Some(frame) = &frame {
                self.missing.came(&header, frame.received_ns());
            }
            if !self.answer(step, &header, frame.as_ref())? {
                return Ok(());
            }
        }
    }

    fn pass_void(&mut self, header: &Header) -> Result<(), PortError> {
        self.missing.is_no_tick(header);
        // The second input's frame of the tick is VOID as well. In the queue it would push out later frames,
        // which would then count as lost.
        if let Some(second) = self.second.as_ref().filter(|_| S::SECOND == SecondInput::SameTick)
            && header.is_tick()
        {
            second.of_tick(header.seq)?;
        }
        Ok(())
    }

    /// Answers a tick. Returns `false` if the process has been asked to end.
    fn answer(
        &mut self,
        step: &mut S,
        header: &Header,
        frame: Option<&Frame<S::Input>>,
    ) -> Result<bool, StageError> {
        let awaited = self.await_second(step, header)?;
        let second = match (&awaited, &self.newest) {
            (Some(Awaited::Stopped), _) => return Ok(false),
            (Some(Awaited::Frame(frame)), _) | (None, Some(frame)) => Second::Frame(frame.header(), frame),
            (Some(Awaited::Void(_) | Awaited::Lost), _) => Second::Refused,
            (Some(Awaited::Late), _) | (None, None) => Second::None,
        };
        let Self { stage, output, shedder, .. } = self;
        let mut passage = begin(stage, header, frame, awaited.as_ref());
        let _span = tracing::debug_span!("step", stage = stage.id().name(), tick = header.seq).entered();
        let begun_ns = monotonic_ns();
        let allowance = shedder.allow(header, begun_ns, monotonic_ns);
        let tick = Tick { header, input: frame.map_or(&[], |frame| &frame[..]), second, allowance };
        let mut lent = Lent { output, loan: None, fault: None };
        let mut out = Answer::new(passage.header, &mut lent);
        let result = step.answer(&tick, &mut out);
        let Answer { header: answered, served, refused, is_empty, .. } = out;
        let Lent { loan, fault, .. } = lent;
        shedder.took(monotonic_ns() - begun_ns, served.filter(|_| result.is_ok()));
        if let Some(fault) = fault {
            return Err(fault.into());
        }
        if let Some((topic, why)) = refused {
            let of = tick.second.frame().filter(|_| topic == S::Second::NAME);
            stage.refuse(of.map_or(header, |(header, _)| header), topic, &why);
        }
        passage.header = answered;
        send(stage, output, passage, result.map(|()| loan), is_empty)?;
        step.after(&tick);
        step.log();
        Ok(true)
    }

    /// Waits for the second input's frame of the same tick. `None` if the step has no such input. If a later
    /// stage writes the second input, its newest frame is stored in `newest`.
    fn await_second(&mut self, step: &S, header: &Header) -> Result<Option<Awaited<S::Second>>, PortError> {
        let Self { stage, second, newest, .. } = self;
        let Some(second) = second else { return Ok(None) };
        let is_lockstep = header.has(flags::LOCKSTEP);
        if S::SECOND == SecondInput::SameTick {
            let until_ns =
                (!is_lockstep).then(|| header.released_ns.saturating_add(step.second_deadline_ns()));
            return stage.wait_for(second, header.seq, until_ns).map(Some);
        }
        let newer = if !is_lockstep || header.seq == 0 {
            second.newest()?
        } else if let Awaited::Frame(frame) = stage.wait_for(second, header.seq - 1, None)? {
            Some(frame)
        } else {
            None
        };
        if newer.is_some() {
            *newest = newer;
        }
        Ok(None)
    }
}

/// Begins the passage of a tick with the frame that arrives last: the second input's frame of the same tick
/// or, without one, the input's frame. The header is the input's, with the hops of both.
fn begin<I: Topic, T: Topic>(
    stage: &Stage,
    header: &Header,
    frame: Option<&Frame<I>>,
    second: Option<&Awaited<T>>,
) -> Passage {
    let mut passage = match (second, frame) {
        (Some(Awaited::Frame(second) | Awaited::Void(second)), _) => stage.begin(second),
        (_, Some(frame)) => stage.begin(frame),
        (_, None) => return stage.release(*header),
    };
    passage.header = header.with_hops_of(&passage.header);
    passage
}

fn send<O: Topic>(
    stage: &mut Stage,
    output: &Publisher<O>,
    mut passage: Passage,
    result: Result<Option<Loan<O>>, Rejected>,
    is_empty: bool,
) -> Result<(), PortError> {
    if is_empty && result.is_ok() {
        passage.header.flags |= flags::VOID;
        stage.done(passage.header.seq);
        return stage.pass_empty(passage, output);
    }
    let result = match result {
        Ok(Some(loan)) => Ok(loan),
        Ok(None) => Ok(output.loan(0)?),
        Err(why) => Err(why),
    };
    stage.finish(passage, output, result)
}

/// Lends elements in shared memory.
struct Lent<'a, O: Topic> {
    output: &'a Publisher<O>,
    loan: Option<Loan<O>>,
    /// Why there is no memory. The process can't continue then.
    fault: Option<PortError>,
}

impl<O: Topic> Room<O> for Lent<'_, O> {
    fn elements(&mut self, count: usize) -> Result<&mut [O::Element], Rejected> {
        let refused = Rejected::TooMany { field: O::NAME, found: count as u64, most: O::ELEMENTS_MAX as u64 };
        match self.output.loan(count) {
            Ok(loan) => Ok(self.loan.insert(loan)),
            Err(fault) => {
                self.fault = Some(fault);
                Err(refused)
            }
        }
    }
}
