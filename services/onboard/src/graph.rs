//! The pipeline's graph in the memory of one process.

use std::any::Any;
use std::convert::Infallible;
use std::sync::Arc;

use bytemuck::Zeroable;
use ports::{Allowance, Awaited, Executor, Frames, Outcome, Room, SecondInput, StageError, Step, Wanted};
use recording::{Frame, FrameError};
use run::{Declaration, Run, is_feedback};
use wire::{Header, Rejected, StageId, Topic};

use crate::OwnFrame;
use crate::frame::Slot;

/// Stages that exchange frames in memory. Their declarations determine who reads whose frames.
///
/// A topic that no stage of the graph writes is an input of the graph.
pub struct Graph {
    /// In the order in which a tick passes them.
    nodes: Vec<Box<dyn Node>>,
    slots: Slots,
}

/// A stage of a graph.
pub trait Node: Send {
    /// Which stage it is.
    fn id(&self) -> StageId;
    /// The topics that it reads.
    fn reads(&self) -> &'static [&'static str];
    /// The topics that it writes.
    fn writes(&self) -> &'static [&'static str];
    /// Finds or makes the places of its topics.
    fn bind(&mut self, slots: &mut Slots);
    /// Whether the tick has reached the stage.
    fn has_input(&self, slots: &Slots) -> bool;
    /// Answers the tick that the slots hold. `passed` is called when the answer is complete, before the work
    /// for which no later stage waits.
    fn answer(&mut self, slots: &mut Slots, allowance: Allowance<'_>, passed: &mut dyn FnMut(StageId));
    /// As [`Step::begin`].
    fn begin(&mut self, run: &Run, incarnation: u32);
    /// As [`Step::end`].
    ///
    /// # Errors
    /// As [`Step::end`].
    fn end(&mut self, run: &Run) -> Result<(), StageError>;
    /// Why the stage has refused the last tick, if it has.
    fn refusal(&self) -> Option<&Rejected>;
    /// The step.
    fn step(&self) -> &dyn Any;
    /// The step.
    fn step_mut(&mut self) -> &mut dyn Any;
}

/// The frames of a graph's topics.
#[derive(Default)]
pub struct Slots(Vec<Box<dyn AnySlot>>);

/// A place for the frame of a topic.
trait AnySlot: Any + Send {
    fn name(&self) -> &'static str;
    fn clear(&mut self);
    fn read(&mut self, frame: &Frame) -> Result<(), FrameError>;
    fn recorded(&self, received_ns: u64) -> Option<Frame>;
}

impl<T: Topic> AnySlot for Slot<T> {
    fn name(&self) -> &'static str {
        T::NAME
    }

    fn clear(&mut self) {
        self.clear();
    }

    fn read(&mut self, frame: &Frame) -> Result<(), FrameError> {
        let (header, elements) = (*frame.header(), frame.elements::<T>()?);
        self.put(Arc::new(OwnFrame { header, elements }));
        Ok(())
    }

    fn recorded(&self, received_ns: u64) -> Option<Frame> {
        self.present().map(|frame| Frame::of::<T>(&frame.header, &frame.elements, received_ns))
    }
}

impl Slots {
    fn place<T: Topic>(&mut self) -> usize {
        self.place_of(T::NAME).unwrap_or_else(|| {
            self.0.push(Box::new(Slot::<T>::default()));
            self.0.len() - 1
        })
    }

    fn place_of(&self, topic: &str) -> Option<usize> {
        self.0.iter().position(|slot| slot.name() == topic)
    }

    fn at<T: Topic>(&self, place: usize) -> &Slot<T> {
        let slot: &dyn Any = &*self.0[place];
        slot.downcast_ref().expect("a topic has one type")
    }

    fn at_mut<T: Topic>(&mut self, place: usize) -> &mut Slot<T> {
        let slot: &mut dyn Any = &mut *self.0[place];
        slot.downcast_mut().expect("a topic has one type")
    }

    /// # Panics
    /// If no stage of the graph has the topic.
    fn of<T: Topic>(&self) -> &Slot<T> {
        let place = self.place_of(T::NAME);
        self.at(place.unwrap_or_else(|| panic!("no stage reads or writes \"{}\"", T::NAME)))
    }
}

/// A stage that a step answers.
struct Stage<S: Step> {
    id: StageId,
    reads: &'static [&'static str],
    writes: &'static [&'static str],
    executor: Executor<S, Arc<OwnFrame<S::Second>>>,
    input: usize,
    second: Option<usize>,
    output: usize,
    refusal: Option<Rejected>,
}

/// A stage of a graph.
///
/// # Panics
/// If the declaration has other topics than the step.
pub fn node<S: Step + Send + 'static, O>(declaration: &Declaration<O>, step: S) -> Box<dyn Node> {
    let (reads, writes) = (declaration.reads(), declaration.writes());
    let executor = Executor::new(declaration, step);
    let (input, second, output) = (0, None, 0);
    Box::new(Stage { id: declaration.id(), reads, writes, executor, input, second, output, refusal: None })
}

impl<S: Step + Send + 'static> Node for Stage<S> {
    fn id(&self) -> StageId {
        self.id
    }

    fn reads(&self) -> &'static [&'static str] {
        self.reads
    }

    fn writes(&self) -> &'static [&'static str] {
        self.writes
    }

    fn bind(&mut self, slots: &mut Slots) {
        self.input = slots.place::<S::Input>();
        self.second = (S::SECOND != SecondInput::None).then(|| slots.place::<S::Second>());
        self.output = slots.place::<S::Output>();
    }

    fn has_input(&self, slots: &Slots) -> bool {
        slots.at::<S::Input>(self.input).present().is_some()
    }

    fn answer(&mut self, slots: &mut Slots, allowance: Allowance<'_>, passed: &mut dyn FnMut(StageId)) {
        self.refusal = None;
        let input = slots.at::<S::Input>(self.input).present().cloned();
        let second = self.second.and_then(|second| slots.at::<S::Second>(second).present().cloned());
        let output = slots.at_mut::<S::Output>(self.output);
        let Some(input) = input else { return output.clear() };
        output.write(|out| {
            let (id, refusal) = (self.id, &mut self.refusal);
            let mut memory = Memory::<S> { id, second, out, count: 0, allowance, refusal, passed };
            let Ok(_) = self.executor.tick(&input.header, Some(&input), &mut memory);
        });
    }

    fn begin(&mut self, run: &Run, incarnation: u32) {
        self.executor.begin(run, incarnation);
    }

    fn end(&mut self, run: &Run) -> Result<(), StageError> {
        self.executor.end(run)
    }

    fn refusal(&self) -> Option<&Rejected> {
        self.refusal.as_ref()
    }

    fn step(&self) -> &dyn Any {
        &self.executor.step
    }

    fn step_mut(&mut self) -> &mut dyn Any {
        &mut self.executor.step
    }
}

/// The frames of a stage and a tick.
struct Memory<'a, S: Step> {
    id: StageId,
    second: Option<Arc<OwnFrame<S::Second>>>,
    out: &'a mut OwnFrame<S::Output>,
    /// Number of elements that the step has asked for.
    count: usize,
    allowance: Allowance<'a>,
    refusal: &'a mut Option<Rejected>,
    passed: &'a mut dyn FnMut(StageId),
}

impl<'a, S: Step> Frames<'a, S> for Memory<'a, S> {
    type Input = Arc<OwnFrame<S::Input>>;
    type Second = Arc<OwnFrame<S::Second>>;
    type Fault = Infallible;

    const LOGS: bool = false;

    fn pass(&mut self, header: Header, _: Option<&Self::Input>) -> Result<(), Infallible> {
        self.out.header = header;
        self.out.elements.clear();
        Ok(())
    }

    fn second(&mut self, _: Wanted) -> Result<Awaited<Self::Second>, Infallible> {
        // What the slot holds is the frame that the tick waits for.
        Ok(match self.second.take() {
            Some(frame) if frame.is_void() => Awaited::Void(frame),
            Some(frame) => Awaited::Frame(frame),
            None => Awaited::Late,
        })
    }

    fn begin(&mut self, header: Header, _: Option<&Self::Input>, _: Option<&Self::Second>) -> Header {
        header
    }

    fn allowance(&mut self, _: &Header) -> Allowance<'a> {
        self.allowance
    }

    fn refuse(&mut self, _: &Header, _: &'static str, _: &Rejected) {}

    fn send(&mut self, header: Header, outcome: Outcome, _: Option<usize>) -> Result<(), Infallible> {
        self.out.header = header;
        let count = if matches!(outcome, Outcome::Answered) { self.count } else { 0 };
        self.out.elements.truncate(count);
        if let Outcome::Refused(why) = outcome {
            *self.refusal = Some(why);
        }
        (self.passed)(self.id);
        Ok(())
    }
}

impl<S: Step> Room<S::Output> for Memory<'_, S> {
    fn elements(&mut self, count: usize) -> Result<&mut [<S::Output as Topic>::Element], Rejected> {
        self.count = count;
        self.out.elements.resize(count, Zeroable::zeroed());
        Ok(&mut self.out.elements)
    }
}

impl Graph {
    /// Joins stages by their topics.
    ///
    /// # Panics
    /// If stages need each other's answers.
    pub fn new(mut nodes: Vec<Box<dyn Node>>) -> Self {
        let (mut ordered, mut slots): (Vec<Box<dyn Node>>, _) = (Vec::new(), Slots::default());
        while !nodes.is_empty() {
            let is_written = |topic: &&&str| nodes.iter().any(|other| other.writes().contains(topic));
            let waits = |node: &dyn Node| {
                let mut reads = node.reads().iter().filter(|topic| !is_feedback(node.id(), topic));
                reads.any(|topic| is_written(&topic))
            };
            let ready = nodes.iter().position(|node| !waits(&**node)).expect("the graph has no cycle");
            let mut node = nodes.remove(ready);
            node.bind(&mut slots);
            ordered.push(node);
        }
        Self { nodes: ordered, slots }
    }

    /// The stages, in the order in which a tick passes them, with the topics that they read, and write.
    pub(crate) fn stages(&self) -> Vec<(StageId, &'static [&'static str], &'static str)> {
        self.nodes.iter().map(|node| (node.id(), node.reads(), node.writes()[0])).collect()
    }

    /// As [`Step::begin`], for all stages.
    pub fn begin(&mut self, run: &Run, incarnation: u32) {
        self.nodes.iter_mut().for_each(|node| node.begin(run, incarnation));
    }

    /// As [`Step::end`], for all stages.
    ///
    /// # Errors
    /// The first error, after all stages have ended.
    pub fn end(&mut self, run: &Run) -> Result<(), StageError> {
        self.nodes.iter_mut().map(|node| node.end(run)).fold(Ok(()), Result::and)
    }

    /// Copies a frame into the graph.
    ///
    /// # Panics
    /// If no stage of the graph has the topic.
    pub fn put<T: Topic>(&mut self, header: &Header, elements: &[T::Element]) {
        let place = self.slots.place::<T>();
        self.slots.at_mut::<T>(place).write(|frame| {
            frame.header = *header;
            frame.elements.clear();
            frame.elements.extend_from_slice(elements);
        });
    }

    /// Puts a frame into the graph that others may read as well.
    pub fn put_shared<T: Topic>(&mut self, frame: Arc<OwnFrame<T>>) {
        let place = self.slots.place::<T>();
        self.slots.at_mut::<T>(place).put(frame);
    }

    /// Takes the frames of a tick through all stages; `passed` is called after each stage that answers it.
    pub fn tick(&mut self, mut passed: impl FnMut(StageId)) {
        for node in &mut self.nodes {
            node.answer(&mut self.slots, Allowance::All, &mut passed);
        }
    }

    /// Takes the frames of a tick through one stage.
    pub(crate) fn answer(&mut self, stage: StageId, allowance: Allowance<'_>) {
        for node in self.nodes.iter_mut().filter(|node| node.id() == stage) {
            node.answer(&mut self.slots, allowance, &mut |_| ());
        }
    }

    /// Whether the tick has reached a stage.
    pub(crate) fn has_input(&self, stage: StageId) -> bool {
        self.nodes.iter().any(|node| node.id() == stage && node.has_input(&self.slots))
    }

    /// Puts a recorded frame into the graph; `None` if the tick has none.
    ///
    /// # Errors
    /// [`FrameError`] if the frame is impossible. The tick then has none.
    pub(crate) fn put_recorded(&mut self, topic: &str, frame: Option<&Frame>) -> Result<(), FrameError> {
        let Some(place) = self.slots.place_of(topic) else { return Ok(()) };
        let slot = &mut self.slots.0[place];
        slot.clear();
        frame.map_or(Ok(()), |frame| slot.read(frame))
    }

    /// Takes the frame of a topic out of the tick.
    pub(crate) fn clear(&mut self, topic: &str) {
        self.slots.0.iter_mut().filter(|slot| slot.name() == topic).for_each(|slot| slot.clear());
    }

    /// The frame of a topic in the form of a recorded one, if the tick has the frame.
    pub(crate) fn recorded(&self, topic: &str, received_ns: u64) -> Option<Frame> {
        self.slots.0[self.slots.place_of(topic)?].recorded(received_ns)
    }

    /// The newest frame of a topic; an empty VOID frame before the first.
    ///
    /// # Panics
    /// If no stage of the graph has the topic.
    pub fn frame<T: Topic>(&self) -> &OwnFrame<T> {
        self.slots.of().frame()
    }

    /// The frame of a topic, if the tick has it. It stays as it is for as long as it is held.
    ///
    /// # Panics
    /// If no stage of the graph has the topic.
    pub fn shared<T: Topic>(&self) -> Option<Arc<OwnFrame<T>>> {
        self.slots.of().present().cloned()
    }

    /// A stage's step, if the graph has it.
    pub fn step<S: Step + 'static>(&self) -> Option<&S> {
        self.nodes.iter().find_map(|node| node.step().downcast_ref())
    }

    /// A stage's step, if the graph has it.
    pub fn step_mut<S: Step + 'static>(&mut self) -> Option<&mut S> {
        self.nodes.iter_mut().find_map(|node| node.step_mut().downcast_mut())
    }

    /// Replaces a stage's step, if the graph has it.
    pub(crate) fn replace<S: Step + 'static>(&mut self, step: S) {
        if let Some(old) = self.step_mut() {
            *old = step;
        }
    }

    /// Why a stage has refused the last tick, if it has.
    pub fn refusal(&self, stage: StageId) -> Option<&Rejected> {
        self.nodes.iter().find(|node| node.id() == stage)?.refusal()
    }
}
