//! A stage's computation, apart from the way in which its frames arrive and leave.

use run::{Declaration, Run};
use wire::{Header, Rejected, StageId, Topic};

use crate::StageError;
use crate::executor::reads;
use crate::shedding::Allowance;

/// A stage: computes its answer to a tick from the tick's frames.
///
/// [`Step::answer`] opens no file and sends nothing. It reads no clock except that of its [`Allowance`]. One
/// [`Executor`](crate::Executor) runs the steps, so their answers have the same bytes in a process of a run, in
/// one process with all stages, and in a replay.
///
/// The executor itself passes on frames that are not ticks, and frames that an earlier stage has refused (VOID).
pub trait Step {
    /// The topic whose frame begins a tick.
    type Input: Topic;
    /// The topic of the second input, [`NoTopic`] if there is only one.
    type Second: Topic;
    /// The topic of the answers.
    type Output: Topic;

    /// The frame of the second input that belongs to a tick.
    const SECOND: SecondInput = SecondInput::None;
    /// Whether the stage also answers ticks that never arrive, once the sender of its input is gone.
    const ANSWERS_MISSING: bool = false;

    /// Computes the answer to a tick.
    ///
    /// # Errors
    /// [`Rejected`] if an input is impossible. The executor counts the tick as refused and sends a VOID frame;
    /// later stages answer without it.
    fn answer(
        &mut self,
        tick: &Tick<'_, Self::Input, Self::Second>,
        out: &mut Answer<'_, Self::Output>,
    ) -> Result<(), Rejected>;

    /// Does the part of the work for which no later stage waits. Called after the answer was sent, even if
    /// the tick was refused.
    fn after(&mut self, _tick: &Tick<'_, Self::Input, Self::Second>) {}

    /// Logs new findings. Called after [`Step::after`], and only in a process of a run.
    fn log(&mut self) {}

    /// Time after a tick's release for which the stage waits for its second input. Not used in lockstep.
    fn second_deadline_ns(&self) -> u64 {
        u64::MAX
    }

    /// Called for each answer that the previous process sends while this process waits to take over.
    fn follow(&mut self, _header: &Header, _sent: &[<Self::Output as Topic>::Element]) {}

    /// Called once before the first tick, when the previous process has ended. `incarnation` counts the
    /// earlier starts of the stage.
    fn begin(&mut self, _run: &Run, _incarnation: u32) {}

    /// Called once at the end, also after an error.
    ///
    /// # Errors
    /// [`StageError`] if a file of the stage can't be written.
    fn end(&mut self, _run: &Run) -> Result<(), StageError> {
        Ok(())
    }
}

/// The frame of a second input that belongs to a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SecondInput {
    /// There is no second input.
    None,
    /// The frame of the same tick, if it arrives in time.
    SameTick,
    /// The newest frame that a later stage has sent; in lockstep, the frame of the previous tick.
    Newest,
}

/// The topic of a second input that does not exist.
#[derive(Clone, Copy, Debug)]
pub enum NoTopic {}

impl Topic for NoTopic {
    type Element = u8;
    const NAME: &'static str = "";
    const DOC: &'static str = "";
    const TYPE_NAME: &'static str = "";
    const ELEMENTS_MAX: usize = 0;
    const ELEMENTS_START: usize = 0;
}

/// Declares a stage whose topics are its step's.
#[must_use]
pub const fn declare<S: Step, O>(id: StageId) -> Declaration<O> {
    Declaration::new(id, reads::<S>(), const { &[<S::Output as Topic>::NAME] })
}

/// A tick's inputs.
#[derive(Debug)]
pub struct Tick<'a, I: Topic, S: Topic = NoTopic> {
    /// The header of the input's frame. If the tick never arrived, the header has the flag PREDICTED.
    pub header: &'a Header,
    /// The input's elements.
    pub input: &'a [I::Element],
    /// The second input.
    pub second: Second<'a, S>,
    /// The agents that the step may serve.
    pub allowance: Allowance<'a>,
}

/// The second input of a tick.
#[derive(Debug)]
pub enum Second<'a, S: Topic> {
    /// Header and elements of its frame.
    Frame(&'a Header, &'a [S::Element]),
    /// An earlier stage refused the tick, or this process refused the frame.
    Refused,
    /// There is no frame, or it is late.
    None,
}

impl<S: Topic> Clone for Second<'_, S> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<S: Topic> Copy for Second<'_, S> {}

impl<'a, S: Topic> Second<'a, S> {
    /// Header and elements, if there is a frame.
    #[must_use]
    pub const fn frame(self) -> Option<(&'a Header, &'a [S::Element])> {
        match self {
            Self::Frame(header, elements) => Some((header, elements)),
            Self::Refused | Self::None => None,
        }
    }
}

/// A step's answer.
pub struct Answer<'a, O: Topic> {
    /// The header to be sent. It starts as the header of the input's frame, and the step sets the sizes of
    /// its own elements.
    pub header: Header,
    pub(crate) served: Option<usize>,
    pub(crate) refused: Option<(&'static str, Rejected)>,
    pub(crate) is_empty: bool,
    room: &'a mut dyn Room<O>,
}

/// The memory for a frame's elements.
pub trait Room<O: Topic> {
    /// Returns memory for `count` elements. It may contain an earlier frame.
    ///
    /// # Errors
    /// [`Rejected`] if there is not enough memory.
    fn elements(&mut self, count: usize) -> Result<&mut [O::Element], Rejected>;
}

impl<'a, O: Topic> Answer<'a, O> {
    /// An answer without elements.
    pub fn new(header: Header, room: &'a mut dyn Room<O>) -> Self {
        Self { header, served: None, refused: None, is_empty: false, room }
    }

    /// Returns the memory of the frame to be sent, for `count` elements. The step writes all of them, because
    /// the memory may contain an earlier frame. A step calls this at most once per tick.
    ///
    /// # Errors
    /// [`Rejected`] if a frame of the topic has no room for this many.
    pub fn elements(&mut self, count: usize) -> Result<&mut [O::Element], Rejected> {
        self.room.elements(count)
    }

    /// Reports the number of served agents. The shedder learns the cost of an agent from it.
    pub const fn served(&mut self, agents: usize) {
        self.served = Some(agents);
    }

    /// Counts a frame as refused although the tick is answered.
    pub const fn refuse(&mut self, topic: &'static str, why: Rejected) {
        self.refused = Some((topic, why));
    }

    /// Leaves the tick without an answer: a VOID frame is sent.
    pub const fn leave_empty(&mut self) {
        self.is_empty = true;
    }
}
