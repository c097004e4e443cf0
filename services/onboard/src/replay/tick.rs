use ports::Allowance;
use recording::{Frame, FrameError};
use wire::{
    ControlsTopic, EncodingsTopic, FeatureShape, Features, FeaturesTopic, ForecastsTopic, Header, StageId,
    Topic,
};

use crate::OwnFrame;

/// The recorded frames of one tick.
#[derive(Debug, Default)]
pub struct Tick {
    frames: Vec<Frame>,
    /// Topics whose frames precede the file. The file keeps only the data of them that a replay needs.
    before: Vec<&'static str>,
}

impl Tick {
    /// Adds a frame. Only the first frame of a topic counts.
    pub fn add(&mut self, frame: Frame, is_before: bool) {
        let topic = frame.topic().name;
        if self.frame(topic).is_none() {
            self.frames.push(frame);
            if is_before {
                self.before.push(topic);
            }
        }
    }

    /// Whether some of its frames precede the file. Others may then be missing.
    pub fn is_before(&self) -> bool {
        !self.before.is_empty()
    }

    /// The time of its detections; all frames of a tick have the same.
    pub fn stamp_ns(&self) -> i64 {
        self.frames.first().map_or(0, |frame| frame.header().stamp_ns)
    }

    /// Whether the file contains the frame of a topic as it was sent.
    pub fn is_recorded(&self, topic: &str) -> bool {
        self.frame(topic).is_some() && !self.before.contains(&topic)
    }

    /// The frame of a topic.
    pub fn frame(&self, topic: &str) -> Option<&Frame> {
        self.frames.iter().find(|frame| frame.topic().name == topic)
    }

    /// The header of a topic's frame; `None` if there is none or, as in [`Tick::own`], the frame is impossible.
    pub fn sound<T: Topic>(&self, impossible: &mut Option<FrameError>) -> Option<&Header> {
        self.own::<T>(impossible)?;
        self.frame(T::NAME).map(Frame::header)
    }

    /// The frame of a topic with its elements. `None` if the frame is impossible, which means that its sender
    /// is faulty. Stages refuse an impossible frame before they read it. `impossible` holds the first
    /// impossible frame.
    pub fn own<T: Topic>(&self, impossible: &mut Option<FrameError>) -> Option<OwnFrame<T>> {
        let frame = self.frame(T::NAME)?;
        match frame.elements::<T>() {
            Ok(elements) => Some(OwnFrame { header: *frame.header(), elements }),
            Err(error) => {
                impossible.get_or_insert(error);
                None
            }
        }
    }

    /// The incarnation of a stage that had the tick, from its output or the forecasts' hops; `None` if
    /// neither is recorded.
    pub fn incarnation(&self, stage: StageId, writes: &str) -> Option<u32> {
        let by_output = self.frame(writes).map(|frame| frame.header().incarnation);
        let by_hop = || Some(self.frame(ForecastsTopic::NAME)?.header().hop(stage)?.incarnation);
        by_output.or_else(by_hop)
    }

    /// The agents that a stage of the run had time to serve.
    pub fn allowance(&self, stage: StageId) -> Allowance<'_> {
        match stage {
            StageId::Extractor => self.extracted(),
            StageId::Encoder => self.encoded(),
            StageId::Decoder => self.decoded(),
            _ => Allowance::All,
        }
    }

    /// The agents that the decoder served: those that the recorded header does not list as shed.
    fn decoded(&self) -> Allowance<'_> {
        let frame = self.frame(ControlsTopic::NAME).or_else(|| self.frame(ForecastsTopic::NAME));
        frame.map_or(Allowance::All, |frame| Allowance::AsRecorded(frame.header()))
    }

    /// The agents for which the extractor had time, from its features. All if it did not have to choose or
    /// its features were not recorded.
    fn extracted(&self) -> Allowance<'static> {
        let served = self.own::<FeaturesTopic>(&mut None).and_then(|features| {
            let counts = &features.header.counts;
            let shape = FeatureShape::of(counts);
            let read = Features::read(&features.elements, shape, counts.history_len as usize).ok()?;
            let has_turns = read.agents.iter().any(|agent| agent.turn > 0);
            let served = read.agents.iter().filter(|agent| agent.forecastable != 0 && agent.shed == 0);
            has_turns.then(|| served.count())
        });
        served.map_or(Allowance::All, Allowance::AtMost)
    }

    /// The agents for which the encoder had time, from its encodings. All if they were not recorded.
    fn encoded(&self) -> Allowance<'static> {
        let Some(encodings) = self.own::<EncodingsTopic>(&mut None) else { return Allowance::All };
        let served = encodings.elements.iter().filter(|agent| agent.forecastable != 0 && agent.shed == 0);
        Allowance::AtMost(served.count())
    }

    /// When its last frame was received.
    pub fn received_ns(&self) -> u64 {
        self.frames.iter().map(Frame::received_ns).max().unwrap_or(0)
    }
}
