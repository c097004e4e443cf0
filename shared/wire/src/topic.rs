use bytemuck::Pod;

use crate::limits::schema;
use crate::table::{Layout, Record, TopicEntry, Type};
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
    /// Sender, receivers and content.
    const DOC: &'static str;
    /// Name of the element type with [`crate::SCHEMA`]: ports of other versions do not connect.
    const TYPE_NAME: &'static str;
    /// Maximum number of elements in a frame.
    const ELEMENTS_MAX: usize;
    /// Elements of the initial memory; it grows in powers of two.
    const ELEMENTS_START: usize;
    /// Maximum number of processes that publish at a time.
    const PUBLISHERS_MAX: usize = 1;
    /// Maximum number of processes that subscribe at a time: the consumers, the recorder, the command line
    /// and spares.
    const SUBSCRIBERS_MAX: usize = 4;
    /// Maximum depth of a subscriber's queue.
    const DEPTH_MAX: usize = 2;

    /// Elements of a frame with these sizes in its header.
    #[must_use]
    fn elements_len(counts: &Counts) -> usize {
        counts.agents_len as usize
    }
}

macro_rules! topic {
    ($(#[doc = $doc:literal])+ $topic:ident, $name:literal, $element:ty, $max:expr, $start:expr $(, $limit:ident = $value:expr)* $(; $len:expr)?) => {
        $(#[doc = $doc])+
        #[derive(Clone, Copy, Debug)]
        pub enum $topic {}

        impl Topic for $topic {
            type Element = $element;
            const NAME: &'static str = $name;
            const DOC: &'static str = concat!($($doc, "\n"),+);
            const TYPE_NAME: &'static str = concat!("stgdat.", $name, ".", schema!());
            const ELEMENTS_MAX: usize = $max;
            const ELEMENTS_START: usize = $start;
            $(const $limit: usize = $value;)*
            $(fn elements_len(counts: &Counts) -> usize { ($len)(counts) })?
        }
    };
}

topic!(
    /// Source → tracker: the sensor's detections.
    DetectionsTopic, "detections", Detection, DETECTIONS_MAX, DETECTIONS_MAX, SUBSCRIBERS_MAX = 6, DEPTH_MAX = 8
);
topic!(
    /// Tracker → localiser, sampler, users: confirmed and coasting tracks.
    TracksTopic, "tracks", Track, AGENTS_MAX, AGENTS_MAX, SUBSCRIBERS_MAX = 6, DEPTH_MAX = 8
);
topic!(
    /// Localiser → extractor: tracks and their local patches of the context map.
    ContextTopic, "context", Row,
    context_rows(&ContextShape { agents_len: AGENTS_MAX, history_len: HISTORY_MAX, patch_side: PATCH_SIDE_MAX }),
    context_rows(&ContextShape { agents_len: 16, history_len: HISTORY_MAX, patch_side: 16 });
    |counts| context_rows(&ContextShape::of(counts))
);
topic!(
    /// Extractor → encoder: node and edge attributes of the history graph.
    FeaturesTopic, "features", Row,
    feature_rows(&FeatureShape { agents_len: AGENTS_MAX, edges_len: EDGES_MAX }),
    feature_rows(&FeatureShape { agents_len: 16, edges_len: 2_048 });
    |counts| feature_rows(&FeatureShape::of(counts))
);
topic!(
    /// Encoder → decoder: the temporal summary of each agent.
    EncodingsTopic, "encodings", AgentEncoding, AGENTS_MAX, AGENTS_MAX
);
topic!(
    /// Decoder → sampler: control Gaussians per agent, mode and step.
    ControlsTopic, "controls", AgentControls, AGENTS_MAX, AGENTS_MAX
);
topic!(
    /// Sampler → tracker, users: trajectories with probabilities and moments.
    ForecastsTopic, "forecasts", Forecast, AGENTS_MAX, AGENTS_MAX, SUBSCRIBERS_MAX = 6, DEPTH_MAX = 8
);
topic!(
    /// Source → recorder: the agents' true positions, for the accuracy in the report.
    TruthTopic, "truth", Truth, DETECTIONS_MAX, DETECTIONS_MAX, DEPTH_MAX = 8
);
topic!(
    /// All stages → launcher, source, recorder: signs of life.
    HeartbeatsTopic, "heartbeats", Heartbeat, 1, 1, PUBLISHERS_MAX = 16, SUBSCRIBERS_MAX = 6, DEPTH_MAX = 16
);

/// The topics in the order in which a tick passes them.
pub(crate) const TOPICS: [TopicEntry; 9] = [
    entry::<DetectionsTopic>(),
    entry::<TracksTopic>(),
    entry::<ContextTopic>(),
    entry::<FeaturesTopic>(),
    entry::<EncodingsTopic>(),
    entry::<ControlsTopic>(),
    entry::<ForecastsTopic>(),
    entry::<TruthTopic>(),
    entry::<HeartbeatsTopic>(),
];

const fn entry<T: Topic<Element: Layout>>() -> TopicEntry {
    TopicEntry {
        name: T::NAME,
        doc: T::DOC,
        type_name: T::TYPE_NAME,
        element: element_record(&T::Element::TYPE),
        elements_max: T::ELEMENTS_MAX,
        elements_start: T::ELEMENTS_START,
        publishers_max: T::PUBLISHERS_MAX,
        subscribers_max: T::SUBSCRIBERS_MAX,
        depth_max: T::DEPTH_MAX,
    }
}

const fn element_record(of: &Type) -> &'static Record {
    match of {
        Type::Record(record) => record,
        Type::Primitive(_) | Type::Array(..) => panic!("the elements of a topic are records"),
    }
}
