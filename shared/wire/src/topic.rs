use bytemuck::Pod;

use crate::{
    AGENTS_MAX, AgentControls, AgentEncoding, ContextShape, Counts, DETECTIONS_MAX, Detection, EDGES_MAX,
    FeatureShape, Forecast, HISTORY_MAX, Heartbeat, PATCH_SIDE_MAX, Row, Track, Truth, context_rows,
    feature_rows,
};

/// A stream of frames with one element type and bounded queues.
pub trait Topic: std::fmt::Debug + 'static {
    /// Element of the payload slice.
    type Element: Pod + Send + Sync + std::fmt::Debug;
    /// The topic's name, as in pipeline.toml.
    const NAME: &'static str;
    /// Name of the element type with its version: ports of other versions do not connect.
    const TYPE_NAME: &'static str;
    /// Most elements of a frame.
    const ELEMENTS_MAX: usize;
    /// Elements for which memory is set aside at first; it grows in powers of two.
    const ELEMENTS_START: usize;
    /// Most processes that publish at once.
    const PUBLISHERS_MAX: usize = 1;
    /// Most processes that subscribe at once: the consumers, the recorder, the command line and spares.
    const SUBSCRIBERS_MAX: usize = 4;
    /// Deepest queue that a subscriber may ask for.
    const DEPTH_MAX: usize = 2;

    /// Elements of a frame whose header tells these sizes.
    #[must_use]
    fn elements_len(counts: &Counts) -> usize {
        counts.agents_len as usize
    }
}

macro_rules! topic {
    ($(#[$doc:meta])* $topic:ident, $name:literal, $version:literal, $element:ty, $max:expr, $start:expr $(, $limit:ident = $value:expr)* $(; $len:expr)?) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug)]
        pub enum $topic {}

        impl Topic for $topic {
            type Element = $element;
            const NAME: &'static str = $name;
            const TYPE_NAME: &'static str = concat!("stgdat.", $name, ".", $version);
            const ELEMENTS_MAX: usize = $max;
            const ELEMENTS_START: usize = $start;
            $(const $limit: usize = $value;)*
            $(fn elements_len(counts: &Counts) -> usize { ($len)(counts) })?
        }
    };
}

topic!(
    /// Source → tracker: what the sensor saw.
    DetectionsTopic, "detections", "v1", Detection, DETECTIONS_MAX, DETECTIONS_MAX, SUBSCRIBERS_MAX = 6, DEPTH_MAX = 8
);
topic!(
    /// Tracker → localiser, sampler, users: confirmed and coasting tracks.
    TracksTopic, "tracks", "v2", Track, AGENTS_MAX, AGENTS_MAX, SUBSCRIBERS_MAX = 6, DEPTH_MAX = 8
);
topic!(
    /// Localiser → extractor: tracks and their local patches of the context map.
    ContextTopic, "context", "v2", Row,
    context_rows(&ContextShape { agents_len: AGENTS_MAX, history_len: HISTORY_MAX, patch_side: PATCH_SIDE_MAX }),
    context_rows(&ContextShape { agents_len: 16, history_len: HISTORY_MAX, patch_side: 16 });
    |counts| context_rows(&ContextShape::of(counts))
);
topic!(
    /// Extractor → encoder: node and edge attributes of the history graph.
    FeaturesTopic, "features", "v1", Row,
    feature_rows(&FeatureShape { agents_len: AGENTS_MAX, edges_len: EDGES_MAX }),
    feature_rows(&FeatureShape { agents_len: 16, edges_len: 2_048 });
    |counts| feature_rows(&FeatureShape::of(counts))
);
topic!(
    /// Encoder → decoder: the temporal summary of each agent.
    EncodingsTopic, "encodings", "v1", AgentEncoding, AGENTS_MAX, AGENTS_MAX
);
topic!(
    /// Decoder → sampler: control Gaussians per agent, mode and step.
    ControlsTopic, "controls", "v1", AgentControls, AGENTS_MAX, AGENTS_MAX
);
topic!(
    /// Sampler → tracker, users: trajectories with probabilities and moments.
    ForecastsTopic, "forecasts", "v2", Forecast, AGENTS_MAX, AGENTS_MAX, SUBSCRIBERS_MAX = 6, DEPTH_MAX = 8
);
topic!(
    /// Source → recorder: where the agents really were, for the report's accuracy.
    TruthTopic, "truth", "v1", Truth, DETECTIONS_MAX, DETECTIONS_MAX, DEPTH_MAX = 8
);
topic!(
    /// All stages → launcher, source, recorder: signs of life.
    HeartbeatsTopic, "heartbeats", "v1", Heartbeat, 1, 1, PUBLISHERS_MAX = 16, SUBSCRIBERS_MAX = 6, DEPTH_MAX = 16
);
