use crate::declare::{constants, numbers, record};
use crate::limits::schema;
use crate::{
    AGENT_TYPES, AGENTS_MAX, HISTORY_MAX, HOPS_MAX, HORIZON_MAX, INTERVAL_MAX_NS, INTERVAL_MIN_NS, MODES_MAX,
    Rejected, SCHEMA, SEQ_MAX, SHED_WORDS, StageId,
};

/// Bits of [`Header::flags`].
pub mod flags {
    use super::constants;

    constants! {
        /// The frame links the pipeline before the first tick: no agents, not counted anywhere.
        pub const WARM_UP: u32 = 1;
        /// The last frame of a recording: no agents; no frame follows.
        pub const END: u32 = 1 << 1;
        /// The detections have identities that the tracker may trust instead of associating.
        pub const HAS_IDENTITIES: u32 = 1 << 2;
        /// The tick runs in lockstep: no stage may give up waiting.
        pub const LOCKSTEP: u32 = 1 << 3;
        /// No agents: a stage has refused this tick, or it was a late measurement that was processed out of
        /// sequence. The frame is still passed on, so that no stage waits for it.
        pub const VOID: u32 = 1 << 4;
        /// A sensor made the detections from [`Header::ego_m`](super::Header::ego_m), and objects occlude its
        /// view. Not set for a view from above, or if the sensor's position is unknown.
        pub const SEEN_FROM_EGO: u32 = 1 << 5;
        /// No detections arrived for this tick: its tracks are predicted. Its number and stamp follow the
        /// previous tick's by one interval. Its time of release is the time of the tracker's prediction.
        pub const PREDICTED: u32 = 1 << 6;
        /// The tick begins a session: the clock of the stamps was set. Tracks of earlier ticks have ended, and
        /// the stamps may be older. The tracker sets it; a producer that knows may set it as well.
        pub const NEW_SESSION: u32 = 1 << 7;
    }
}

/// Bits of [`InputCounts::doubts`]; new ones are appended.
pub mod doubts {
    use super::constants;

    constants! {
        /// Headings are in degrees.
        pub const HEADINGS_IN_DEGREES: u32 = 1;
        /// Headings are clockwise from north, or x and y are swapped.
        pub const HEADINGS_FROM_NORTH: u32 = 1 << 1;
        /// Headings mirror the motion: clockwise from +x, or y is flipped.
        pub const HEADINGS_MIRRORED: u32 = 1 << 2;
        /// Headings are turned against the motion by a quarter or half turn.
        pub const HEADINGS_TURNED: u32 = 1 << 3;
        /// Headings and motion do not agree.
        pub const HEADINGS_UNRELATED: u32 = 1 << 4;
        /// Speeds are in km/h.
        pub const SPEEDS_IN_KMH: u32 = 1 << 5;
        /// Speeds are in mph.
        pub const SPEEDS_IN_MPH: u32 = 1 << 6;
        /// Speeds from positions differ from the reported ones.
        pub const SPEEDS_DIFFER: u32 = 1 << 7;
        /// Agents of a type move at unusual speeds.
        pub const SPEEDS_UNUSUAL: u32 = 1 << 8;
        /// Lengths or positions are in feet.
        pub const FEET: u32 = 1 << 9;
        /// Positions are in pixels.
        pub const PIXELS: u32 = 1 << 10;
        /// Stamps are in another unit than seconds.
        pub const STAMPS_IN_OTHER_UNIT: u32 = 1 << 11;
        /// Stamps are the numbers of frames.
        pub const STAMPS_ARE_FRAMES: u32 = 1 << 12;
        /// Stamps decrease.
        pub const STAMPS_GO_BACK: u32 = 1 << 13;
        /// Detections repeat the previous one of a moving agent.
        pub const REPEATED: u32 = 1 << 14;
        /// Positions that their agent can't have reached.
        pub const OUTLIERS: u32 = 1 << 15;
        /// Positions that are placeholders for missing ones.
        pub const PLACEHOLDERS: u32 = 1 << 16;
        /// Identities jump from one agent to another.
        pub const IDENTITIES_JUMP: u32 = 1 << 17;
        /// The noise of the positions has changed by a factor of three.
        pub const NOISE_CHANGED: u32 = 1 << 18;
        /// Positions are degrees of longitude and latitude.
        pub const GEOGRAPHIC: u32 = 1 << 20;
        /// Boxes are on top of each other.
        pub const STACKED: u32 = 1 << 21;
        /// Frames are too far apart for agents without identities.
        pub const SPARSE: u32 = 1 << 22;
        /// Agents take the same paths twice, by two clocks.
        pub const SEEN_TWICE: u32 = 1 << 23;
        /// Identities change while their agents continue.
        pub const IDENTITIES_CHANGE: u32 = 1 << 24;
        /// All agents are displaced at once.
        pub const ALL_DISPLACED: u32 = 1 << 25;
        /// Vehicles are wider than they are long.
        pub const SIZES_SWAPPED: u32 = 1 << 26;
    }
}

numbers! {
    /// The clock of a frame's [`Header::stamp_ns`].
    pub enum StampSource {
        /// The source did not report it.
        Unknown = 0 => "unknown",
        /// A recording.
        Recording = 1 => "recording",
        /// The sensor's own clock, at its measurement.
        SensorClock = 2 => "sensor clock",
        /// The receiving computer's clock when the measurement arrived: later than the measurement by the
        /// transmission time.
        Receipt = 3 => "time of receipt",
        /// A generated scene.
        Generated = 4 => "generated",
    }
}

record! {
    /// The end-to-end protection of a frame, in the order of AUTOSAR's E2E profile 7. All zeros if the frame
    /// is not protected.
    #[derive(Eq)]
    pub struct Protection: 24 bytes {
        /// CRC-64/XZ of the header after this field, and of the payload.
        0 => crc: u64,
        /// Total bytes of header and payload.
        8 => length: u32,
        /// Counts the frames of the sender; wraps around.
        12 => counter: u32,
        /// Identifies the topic: FNV-1a of its name, in 32 bits.
        16 => data_id: u32,
        /// Zero.
        20 => reserved: [u8; 4],
    }
}

record! {
    /// When one stage processed a tick, on `CLOCK_MONOTONIC`.
    #[derive(Eq)]
    pub struct Hop: 40 bytes {
        /// The stage's [`StageId`] as a number.
        0 => stage: u32,
        /// Number of the stage's earlier starts.
        4 => incarnation: u32,
        /// When the input was taken from its queue.
        8 => received_ns: u64,
        /// When the computation started.
        16 => started_ns: u64,
        /// When the computation ended.
        24 => finished_ns: u64,
        /// When the output was passed to the transport.
        32 => sent_ns: u64,
    }
}

record! {
    /// The sizes of a frame's tensors.
    #[derive(Eq)]
    pub struct Counts: 24 bytes {
        /// Number of agents (or detections, or truths) in the frame.
        0 => agents_len: u32,
        /// Steps of the history window, T_h.
        4 => history_len: u32,
        /// Steps of the forecast, T_f.
        8 => horizon_len: u32,
        /// Latent draws, K.
        12 => modes_len: u32,
        /// Side of the context patches, P, in cells.
        16 => patch_side: u32,
        /// Edges of all history steps.
        20 => edges_len: u32,
    }
}

record! {
    /// Counts of the input's contents since the counting stage was started.
    ///
    /// The source fills `unplayed` and `merged`, the tracker the others.
    #[derive(Eq)]
    pub struct InputCounts: 32 bytes {
        /// Detections that the tracker has processed.
        0 => detections: u32,
        /// Detections identical to the previous one of a moving track: not measurements.
        4 => repeated: u32,
        /// Detections that their track can't have reached: treated as missed.
        8 => misfits: u32,
        /// Detections at a placeholder's position.
        12 => placeholders: u32,
        /// Tracks whose state was restarted because misfits agreed with one another.
        16 => reassigned: u32,
        /// Detections of unplayed frames that are in no played frame.
        20 => unplayed: u32,
        /// Detections of unplayed frames that were sent with another frame.
        24 => merged: u32,
        /// Bits of [`doubts`] about the input; 0 without any.
        28 => doubts: u32,
    }
}

record! {
    /// The header of every frame.
    pub struct Header: 704 bytes {
        /// End-to-end protection of the frame.
        0 => protection: Protection,
        /// [`SCHEMA`] of the sender.
        24 => schema: u32,
        /// Bits of [`flags`].
        28 => flags: u32,
        /// Identifies the run; frames of other runs are refused.
        32 => run_id: u64,
        /// The tick's number, from 0, without gaps at the source.
        40 => seq: u64,
        /// Time of validity of the detections on the recording's or sensor's clock; the time of all
        /// algorithms.
        48 => stamp_ns: i64,
        /// When the source released the tick, on `CLOCK_MONOTONIC`; only for latency and age.
        56 => released_ns: u64,
        /// The interval between frames as planned by the source. It is `INTERVAL_MIN_NS` to `INTERVAL_MAX_NS`,
        /// or 0 if it is unknown: then no tick is predicted when the source is gone.
        64 => interval_ns: u64,
        /// Spacing of history and forecast steps, Δt; 0 before the tracker.
        72 => step_ns: u64,
        /// [`StampSource`] of `stamp_ns` as a number.
        80 => stamp_source: u32,
        /// [`StageId`] of the frame's sender as a number; 0 if the sender is not a stage.
        84 => sender: u32,
        /// Number of the sender's earlier starts.
        88 => incarnation: u32,
        /// Bits of the agent types that the sensor looked for in this frame.
        92 => observed_types: u32,
        /// Number of agents left out because the frame was full.
        96 => left_out_len: u32,
        /// Number of valid entries of `hops`.
        100 => hops_len: u32,
        /// Number of stages on the tick's path that do not fit in `hops`.
        104 => hops_missing_len: u32,
        /// Position of the ego vehicle, or of the scene's centre, in the world frame.
        108 => ego_m: [f32; 2],
        /// Heading of the ego vehicle, 0 for a fixed sensor.
        116 => ego_heading_rad: f32,
        /// Sizes of the frame's tensors.
        120 => counts: Counts,
        /// The stages on the tick's path, the source first.
        144 => hops: [Hop; HOPS_MAX],
        /// Number of agents without a forecast, by the degradation policy.
        624 => silent_len: u32,
        /// In forecasts after a restart of the sampler: number of ticks in the retrieval memory and the
        /// evidence that it resumed with; 0 if it resumed without them.
        628 => resumed_ticks: u32,
        /// Time between the stamp of the tracker's newest forecasts and this frame's; 0 if it has none, or
        /// does not report it. The forecasts' cost and
        /// [`Track::learned_age_ns`](crate::Track::learned_age_ns) are reported with it. They determine which
        /// agents the tick has time for.
        632 => feedback_age_ns: u64,
        /// Processing time of those forecasts' agents, from the extractor's end to the decoder's; 0 if they
        /// did not pass both.
        640 => chain_ns: u64,
        /// Number of those agents that the decoder served.
        648 => chain_len: u32,
        /// Agents of the tick, by their place among its tracks, whose controls were left out to save time: bit
        /// `place % 32` of number `place / 32`.
        652 => shed: [u32; SHED_WORDS],
        /// Processing time of the sampler for those forecasts; 0 if it is unknown.
        668 => sampling_ns: u32,
        /// Findings of source and tracker in the detections so far; all 0 if they do not report.
        672 => input: InputCounts,
    }
}

impl Header {
    /// The header's type name: ports of other versions do not connect.
    pub const TYPE_NAME: &str = concat!("stgdat.header.", schema!());

    /// The header of a new tick, without hops.
    #[must_use]
    pub fn new(run_id: u64, seq: u64, stamp_ns: i64) -> Self {
        Self { schema: SCHEMA, run_id, seq, stamp_ns, ..Self::default() }
    }

    /// The stages on the tick's path.
    pub fn hops(&self) -> &[Hop] {
        &self.hops[..(self.hops_len as usize).min(HOPS_MAX)]
    }

    /// The hop of one stage, if the tick has passed the stage.
    #[must_use]
    pub fn hop(&self, stage: StageId) -> Option<&Hop> {
        self.hops().iter().find(|hop| hop.stage == stage.number())
    }

    /// Appends a stage's hop; if the tick has [`HOPS_MAX`] hops already, the hop is only counted.
    pub fn push_hop(&mut self, hop: Hop) {
        match self.hops.get_mut(self.hops_len as usize) {
            Some(free) => {
                *free = hop;
                self.hops_len += 1;
            }
            None => self.hops_missing_len = self.hops_missing_len.saturating_add(1),
        }
    }

    /// The same header with the hops of `way`.
    #[must_use]
    pub const fn with_hops_of(self, way: &Self) -> Self {
        Self { hops: way.hops, hops_len: way.hops_len, hops_missing_len: way.hops_missing_len, ..self }
    }

    /// Whether the controls of the track at `place` were left out to save time.
    #[must_use]
    pub fn is_shed(&self, place: usize) -> bool {
        self.shed.get(place / 32).is_some_and(|bits| bits >> (place % 32) & 1 == 1)
    }

    /// Records that the controls of the track at `place`, below [`AGENTS_MAX`], are left out to save time.
    pub fn mark_shed(&mut self, place: usize) {
        if let Some(bits) = self.shed.get_mut(place / 32) {
            *bits |= 1 << (place % 32);
        }
    }

    /// Whether all bits of `flag` are set.
    #[must_use]
    pub const fn has(&self, flag: u32) -> bool {
        self.flags & flag == flag
    }

    /// Whether the frame belongs to a tick, and not to the start or end of the pipeline.
    pub const fn is_tick(&self) -> bool {
        self.flags & (flags::WARM_UP | flags::END) == 0
    }

    /// Whether the tick begins a session, after a tick with this number and stamp. A stage that has missed the
    /// tick with the flag sees that the stamps went back. A VOID tick begins none: its frame was late.
    #[must_use]
    pub const fn begins_session_after(&self, (seq, stamp_ns): (u64, i64)) -> bool {
        let is_set = self.has(flags::NEW_SESSION) || self.stamp_ns <= stamp_ns;
        self.seq > seq && !self.has(flags::VOID) && is_set
    }

    /// Refuses another schema, in which all other fields may have other meanings.
    ///
    /// # Errors
    /// [`Rejected::Schema`].
    pub const fn check_schema(&self) -> Result<(), Rejected> {
        if self.schema == SCHEMA {
            Ok(())
        } else {
            Err(Rejected::Schema { found: self.schema, expected: SCHEMA })
        }
    }

    /// Refuses headers that no stage may work on: another schema, sizes beyond the limits, impossible
    /// numbers.
    ///
    /// # Errors
    /// [`Rejected`] names the first wrong field.
    pub fn check(&self) -> Result<(), Rejected> {
        self.check_schema()?;
        let known = AGENT_TYPES.iter().fold(0, |bits, t| bits | t.bit());
        let limits = [
            ("agents_len", self.counts.agents_len, crate::DETECTIONS_MAX.max(AGENTS_MAX) as u32),
            ("history_len", self.counts.history_len, HISTORY_MAX as u32),
            ("horizon_len", self.counts.horizon_len, HORIZON_MAX as u32),
            ("modes_len", self.counts.modes_len, MODES_MAX as u32),
            ("patch_side", self.counts.patch_side, crate::PATCH_SIDE_MAX as u32),
            ("edges_len", self.counts.edges_len, crate::EDGES_MAX as u32),
            ("hops_len", self.hops_len, HOPS_MAX as u32),
            ("observed_types", self.observed_types, known),
        ];
        for (field, found, most) in limits {
            crate::at_most(field, found as usize, most as usize)?;
        }
        if self.seq > SEQ_MAX {
            return Err(Rejected::Impossible { field: "seq", value: self.seq as f64 });
        }
        self.check_interval()?;
        crate::finite("ego", &[self.ego_m[0], self.ego_m[1], self.ego_heading_rad])
    }

    /// Refuses an interval in another unit, such as 80 for milliseconds: once the source is gone, the tracker
    /// would predict a tick every 80 ns.
    const fn check_interval(&self) -> Result<(), Rejected> {
        match self.interval_ns {
            0 | INTERVAL_MIN_NS..=INTERVAL_MAX_NS => Ok(()),
            other => Err(Rejected::Impossible { field: "interval_ns", value: other as f64 }),
        }
    }

    /// Refuses an impossible header, or more agents than a frame can hold.
    ///
    /// # Errors
    /// [`Rejected`] names the first wrong field.
    pub fn check_agents(&self, agents: usize) -> Result<(), Rejected> {
        self.check()?;
        crate::at_most("agents_len", agents, AGENTS_MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_place_among_the_tracks_has_a_bit_of_its_own() {
        let mut header = Header::new(1, 2, 3);
        for place in (0..AGENTS_MAX).step_by(3) {
            header.mark_shed(place);
        }
        assert!((0..AGENTS_MAX).all(|place| header.is_shed(place) == (place % 3 == 0)));
        assert!(!header.is_shed(AGENTS_MAX), "there is no such place");
        assert_eq!(header.shed.iter().map(|bits| bits.count_ones()).sum::<u32>(), 43);
    }

    #[test]
    fn an_interval_in_another_unit_is_refused() {
        let of = |interval_ns: u64| Header { interval_ns, ..Header::new(1, 2, 3) }.check();
        for interval_ns in [0, INTERVAL_MIN_NS, crate::TICK_NS, INTERVAL_MAX_NS] {
            assert_eq!(of(interval_ns), Ok(()));
        }
        // Milliseconds, microseconds, and a damaged number.
        for interval_ns in [80, 80_000, INTERVAL_MAX_NS + 1, u64::MAX] {
            let why = Rejected::Impossible { field: "interval_ns", value: interval_ns as f64 };
            assert_eq!(of(interval_ns), Err(why));
        }
    }

    #[test]
    fn a_number_near_the_overflow_is_refused() {
        let of = |seq| Header { interval_ns: crate::TICK_NS, ..Header::new(1, seq, 3) }.check();
        assert_eq!(of(SEQ_MAX), Ok(()));
        for seq in [SEQ_MAX + 1, u64::MAX] {
            assert_eq!(of(seq), Err(Rejected::Impossible { field: "seq", value: seq as f64 }));
        }
    }

    #[test]
    fn passages_beyond_the_room_are_counted_and_the_first_ones_kept() {
        let mut header = Header::new(1, 2, 3);
        (0..HOPS_MAX as u32 + 3).for_each(|stage| header.push_hop(Hop { stage, ..Hop::default() }));
        assert_eq!((header.hops_len as usize, header.hops_missing_len), (HOPS_MAX, 3));
        assert!(header.hops().iter().map(|hop| hop.stage).eq(0..HOPS_MAX as u32));
        let other = Header::new(1, 9, 4).with_hops_of(&header);
        assert_eq!((other.seq, other.hops(), other.hops_missing_len), (9, header.hops(), 3));
    }
}
