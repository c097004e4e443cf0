use crate::declare::constants;

/// [`SCHEMA`] as a literal, for `concat!`.
macro_rules! schema {
    () => {
        2
    };
}

pub(crate) use schema;

constants! {
    /// Version of the whole wire: of the header, of every payload and of the topics' type names.
    pub const SCHEMA: u32 = schema!();
    /// Maximum number of agents in a frame. If the tracker holds more, the nearest to the ego or the scene's
    /// centre are kept.
    pub const AGENTS_MAX: usize = 128;
    /// Number of 32-bit words that hold a bit for each agent of a frame.
    pub const SHED_WORDS: usize = AGENTS_MAX / 32;
    /// Maximum number of detections in a frame.
    pub const DETECTIONS_MAX: usize = 512;
    /// Maximum time between a measurement and its frame's stamp, in either direction.
    pub const OFFSET_MAX_NS: u64 = 1_000_000_000;
    /// Largest number of a sensor in a detection.
    pub const SENSORS_MAX: usize = 8;
    /// Largest number of a tick. A sum of it and a few ticks does not overflow.
    pub const SEQ_MAX: u64 = 1 << 62;
    /// Shortest interval between the frames of ticks. A shorter one is a time in another unit.
    pub const INTERVAL_MIN_NS: u64 = 1_000_000;
    /// Longest interval between the frames of ticks.
    pub const INTERVAL_MAX_NS: u64 = 3_600_000_000_000;
    /// Maximum number of stages on a tick's path.
    pub const HOPS_MAX: usize = 12;
    /// Maximum number of stages that a pipeline file can add to stgdat's own.
    pub const ADDED_STAGES_MAX: usize = 16;
    /// Maximum number of topics that a pipeline file can declare.
    pub const ADDED_TOPICS_MAX: usize = 16;
    /// Largest element of a topic that a pipeline file declares, in bytes.
    pub const ELEMENT_SIZE_MAX: usize = 65_536;
    /// Longest history, T_h, in steps.
    pub const HISTORY_MAX: usize = 8;
    /// Longest forecast, T_f, in steps.
    pub const HORIZON_MAX: usize = 12;
    /// Maximum number of latent draws (modes), K, of an agent.
    pub const MODES_MAX: usize = 20;
    /// Maximum number of conflicts in a forecast.
    pub const CONFLICTS_MAX: usize = 2;
    /// Maximum number of experts in a forecast's weights.
    pub const EXPERTS_MAX: usize = 8;
    /// Maximum number of pairs of sender and cause for which a heartbeat counts refused frames.
    pub const REFUSALS_MAX: usize = 8;
    /// Maximum number of edges of all steps of the history graph together, including the self edges.
    pub const EDGES_MAX: usize = 32_768;
    /// Channels of a local context patch: density and the two components of the mean velocity.
    pub const PATCH_CHANNELS: usize = 3;
    /// Largest side of a local context patch, in cells.
    pub const PATCH_SIDE_MAX: usize = 32;
    /// Components of the state features s.
    pub const STATE_FEATURES: usize = 6;
    /// Components of the relation features φ.
    pub const RELATION_FEATURES: usize = 6;
    /// Components of the state embedding SE.
    pub const STATE_EMBEDDING: usize = 32;
    /// Components of the context embedding CE.
    pub const CONTEXT_EMBEDDING: usize = 32;
    /// Components of a node attribute v = \[SE ‖ CE\].
    pub const NODE_ATTRIBUTES: usize = STATE_EMBEDDING + CONTEXT_EMBEDDING;
    /// Components of an edge attribute e.
    pub const EDGE_ATTRIBUTES: usize = 16;
    /// Components of the temporal summary ṽ.
    pub const TEMPORAL: usize = 64;
    /// Components of the latent variable z.
    pub const LATENT: usize = 32;
    /// Largest magnitude of a world coordinate; beyond it f32 resolves less than 4 mm.
    pub const POSITION_MAX_M: f32 = 32_768.0;
    /// Maximum credible speed of an agent.
    pub const SPEED_MAX_MPS: f32 = 120.0;
}
