use bytemuck::{Pod, Zeroable};

use crate::{AGENT_TYPES, AGENTS_MAX, HISTORY_MAX, HORIZON_MAX, Rejected};

/// Version of headers and payloads; a frame of another version is refused.
pub const SCHEMA: u32 = 1;
/// Most stages that a tick can pass.
pub const HOPS_MAX: usize = 8;

/// Bits of [`Header::flags`].
pub mod flags {
    /// The frame links the pipeline before the first tick: no agents, not counted anywhere.
    pub const WARM_UP: u32 = 1;
    /// The last frame of a recording: no agents, tells every stage that nothing follows.
    pub const END: u32 = 1 << 1;
    /// The detections carry identities that the tracker may trust instead of associating.
    pub const HAS_IDENTITIES: u32 = 1 << 2;
    /// The tick runs in lockstep: no stage may give up waiting.
    pub const LOCKSTEP: u32 = 1 << 3;
    /// A stage has refused this tick, or it came late and was taken in where it belongs: no agents. It passes on so that nobody waits for it.
    pub const VOID: u32 = 1 << 4;
    /// The detections were made from [`Header::ego_m`](super::Header::ego_m), by a sensor that can't see past what stands in its way. Not set for a
    /// view from above, or where nobody knows where the sensor stood.
    pub const SEEN_FROM_EGO: u32 = 1 << 5;
}

/// A stage of the pipeline, by number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u32)]
pub enum StageId {
    /// Releases detections.
    Source = 1,
    /// Makes tracks of detections.
    Tracker = 2,
    /// Samples local patches of the context map.
    Localiser = 3,
    /// Computes node and edge attributes.
    Extractor = 4,
    /// Graph dual attention: the temporal summary of each agent.
    Encoder = 5,
    /// Control Gaussians of each agent, draw and step.
    Decoder = 6,
    /// Trajectories through the kinematic layer.
    Sampler = 7,
    /// Keeps what the report needs.
    Recorder = 8,
}

impl StageId {
    /// All stages in the order in which a tick passes them.
    pub const ALL: [Self; 8] = [
        Self::Source,
        Self::Tracker,
        Self::Localiser,
        Self::Extractor,
        Self::Encoder,
        Self::Decoder,
        Self::Sampler,
        Self::Recorder,
    ];

    /// The name used on the command line, in pipeline.toml and in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Source => "source",
            Self::Tracker => "tracker",
            Self::Localiser => "localiser",
            Self::Extractor => "extractor",
            Self::Encoder => "encoder",
            Self::Decoder => "decoder",
            Self::Sampler => "sampler",
            Self::Recorder => "recorder",
        }
    }

    /// The stage of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|s| s.name() == name)
    }

    /// The stage of that number.
    #[must_use]
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|&s| s as u32 == number)
    }
}

/// When one stage had a tick in hand; `CLOCK_MONOTONIC`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Hop {
    /// The stage's [`StageId`] as a number.
    pub stage: u32,
    /// How often the stage had been started before.
    pub incarnation: u32,
    /// The input was taken from its queue.
    pub received_ns: u64,
    /// The computation began.
    pub started_ns: u64,
    /// The computation ended.
    pub finished_ns: u64,
    /// The output was handed to the transport.
    pub sent_ns: u64,
}

/// The sizes of a frame's tensors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Counts {
    /// Agents (or detections, or truths) in the frame.
    pub agents_len: u32,
    /// Steps of the history window, T_h.
    pub history_len: u32,
    /// Steps of the forecast, T_f.
    pub horizon_len: u32,
    /// Latent draws, K.
    pub modes_len: u32,
    /// Side of the context patches, P, in cells.
    pub patch_side: u32,
    /// Edges of all history steps.
    pub edges_len: u32,
}

/// The header of every frame.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Header {
    /// [`SCHEMA`] of the sender.
    pub schema: u32,
    /// Bits of [`flags`].
    pub flags: u32,
    /// Identifies the run; frames of other runs are refused.
    pub run_id: u64,
    /// The tick's number, from 0, without gaps at the source.
    pub seq: u64,
    /// Time of validity of the detections on the recording's or sensor's clock; the time of all algorithms.
    pub stamp_ns: i64,
    /// When the source released the tick, `CLOCK_MONOTONIC`; for latency and age only.
    pub released_ns: u64,
    /// The interval between frames as planned by the source.
    pub interval_ns: u64,
    /// Spacing of history and forecast steps, Δt; 0 before the tracker.
    pub step_ns: u64,
    /// Bits of the agent types that the sensor looked for in this frame.
    pub observed_types: u32,
    /// Agents left out because the frame was full.
    pub left_out_len: u32,
    /// Position of the ego vehicle, or of the scene's centre, in the world frame.
    pub ego_m: [f32; 2],
    /// Heading of the ego vehicle, 0 for a fixed sensor.
    pub ego_heading_rad: f32,
    /// Valid entries of `hops`.
    pub hops_len: u32,
    /// Sizes of the frame's tensors.
    pub counts: Counts,
    /// The stages that the tick has passed, the source first.
    pub hops: [Hop; HOPS_MAX],
}

const _: () = assert!(size_of::<Hop>() == 40 && size_of::<Counts>() == 24 && size_of::<Header>() == 424);

impl Header {
    /// The header of a new tick, without hops.
    #[must_use]
    pub fn new(run_id: u64, seq: u64, stamp_ns: i64) -> Self {
        Self { schema: SCHEMA, run_id, seq, stamp_ns, ..Self::zeroed() }
    }

    /// The stages that the tick has passed.
    #[must_use]
    pub fn hops(&self) -> &[Hop] {
        &self.hops[..(self.hops_len as usize).min(HOPS_MAX)]
    }

    /// The passage of one stage, if the tick has passed it.
    #[must_use]
    pub fn hop(&self, stage: StageId) -> Option<&Hop> {
        self.hops().iter().find(|hop| hop.stage == stage as u32)
    }

    /// Appends a stage's passage; a tick that has passed [`HOPS_MAX`] stages already keeps the first ones.
    pub fn push_hop(&mut self, hop: Hop) {
        if let Some(free) = self.hops.get_mut(self.hops_len as usize) {
            *free = hop;
            self.hops_len += 1;
        }
    }

    /// Whether all bits of `flag` are set.
    #[must_use]
    pub const fn has(&self, flag: u32) -> bool {
        self.flags & flag == flag
    }

    /// Whether the frame belongs to a tick, not to the linking or ending of the pipeline.
    #[must_use]
    pub const fn is_tick(&self) -> bool {
        self.flags & (flags::WARM_UP | flags::END) == 0
    }

    /// Refuses what no stage may work on: another schema, sizes beyond the limits, impossible numbers.
    ///
    /// # Errors
    /// [`Rejected`] names the first field that is off.
    pub fn check(&self) -> Result<(), Rejected> {
        if self.schema != SCHEMA {
            return Err(Rejected::Schema { found: self.schema, expected: SCHEMA });
        }
        let known = AGENT_TYPES.iter().fold(0, |bits, t| bits | t.bit());
        let limits = [
            ("agents_len", self.counts.agents_len, crate::DETECTIONS_MAX.max(AGENTS_MAX) as u32),
            ("history_len", self.counts.history_len, HISTORY_MAX as u32),
            ("horizon_len", self.counts.horizon_len, HORIZON_MAX as u32),
            ("modes_len", self.counts.modes_len, crate::MODES_MAX as u32),
            ("patch_side", self.counts.patch_side, crate::PATCH_SIDE_MAX as u32),
            ("edges_len", self.counts.edges_len, crate::EDGES_MAX as u32),
            ("hops_len", self.hops_len, HOPS_MAX as u32),
            ("observed_types", self.observed_types, known),
        ];
        for (field, found, most) in limits {
            if found > most {
                return Err(Rejected::TooMany { field, found: u64::from(found), most: u64::from(most) });
            }
        }
        crate::finite("ego", &[self.ego_m[0], self.ego_m[1], self.ego_heading_rad])
    }
}
