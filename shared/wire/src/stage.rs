use crate::declare::numbers;

numbers! {
    /// A stage of the pipeline, by number. Numbers below 64 are kept for stages of stgdat's own, 0 stands for
    /// none of them; from 64 on they are free for stages that a pipeline file defines.
    #[derive(Hash, PartialOrd, Ord)]
    pub enum StageId {
        /// Releases detections.
        Source = 1 => "source",
        /// Makes tracks of detections.
        Tracker = 2 => "tracker",
        /// Samples local patches of the context map.
        Localiser = 3 => "localiser",
        /// Computes node and edge attributes.
        Extractor = 4 => "extractor",
        /// Graph dual attention: the temporal summary of each agent.
        Encoder = 5 => "encoder",
        /// Control Gaussians of each agent, draw and step.
        Decoder = 6 => "decoder",
        /// Trajectories through the kinematic layer.
        Sampler = 7 => "sampler",
        /// Keeps what the report needs.
        Recorder = 8 => "recorder",
    }
}

impl StageId {
    /// The stage of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|s| s.name() == name)
    }
}
