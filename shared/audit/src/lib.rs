//! The audit of detections. It checks that the input is what stgdat expects: metres, radians and seconds of
//! agents with plausible motion.
//!
//! Faulty inputs produce no error. A heading in degrees is a valid number, and so is a stamp in milliseconds.
//! A tracker makes wrong tracks of them, or none. The content reveals such faults: headings that never follow
//! the motion, speeds that differ from the positions by the factor 3.6, or agents that jump and come back.
//!
//! An [`Audit`] reads detections one by one, in the order of their stamps, from a recording or from a running
//! producer. It follows each agent by its identity or, without an identity, from place to place. Its memory
//! is bounded, and it does not allocate after its construction.
//!
//! 1. **Reach.** A detection is out of reach if its agent would exceed the highest speed of its type. The
//!    next detection decides: if it returns to the old path, the detection was an outlier; if it agrees with
//!    the detection, the identity has jumped.
//! 2. **Repetition.** Detections at exactly the previous place count as repeated once the agent moves again,
//!    if it had moved before. On a coarse grid, such as pixels, slow agents also stay at a place. However, x
//!    and y then do not change together, so only detections without a grid count.
//! 3. **Chords.** A *chord* joins two detections of an agent that are at least a second apart. Its direction
//!    is compared with the headings (`headings`), and its speed with reported and usual speeds (`speeds`).
//!
//! A [`Finding`] is a fault with the number of its rows and the place of the first row. It is a doubt if it
//! concerns more than [`DOUBT_SHARE`] of the rows. [`LiveAudit`] keeps the doubts of a run as bits.
//!
//! [`Clock`] watches the stamps: it tells a late frame from a clock that was set.
//!
//! [`Noise`] watches the detector's noise that the tracker learns. A change by a factor of three is a doubt.

mod agent;
mod agents;
mod clock;
mod column;
mod displacements;
mod doubt;
mod echoes;
mod finding;
mod handovers;
mod headings;
mod histogram;
mod live;
mod motion;
mod noise;
mod positions;
mod sizes;
mod speeds;
mod stamps;
mod tally;

use wire::{AgentType, Detection, detection_flags};

pub use agent::NEAR_ZERO_MPS;
use agent::{Constant, Repeated, Spot, Step, limit_mps};
use agents::Agents;
pub use clock::{Clock, ClockSet, Stamped, StampedFrame};
use column::{Column, Unknown};
use displacements::Displacements;
pub use doubt::Doubt;
use echoes::Echoes;
use finding::Detail;
pub use finding::{DOUBT_SHARE, Finding, Found};
use handovers::Handovers;
use headings::{Convention, Headings};
pub use live::LiveAudit;
pub use noise::{Noise, SensorNoise, TypeNoise, noise_words};
use positions::{Extent, Stacks};
use sizes::Sizes;
use speeds::{Speeds, Unit};
use stamps::Stamps;
pub use tally::Place;
use tally::Tally;

/// Smallest number of rows for the check that all positions are whole numbers.
const WHOLE_MIN: u64 = 100;
/// Smallest number of detections without identities at a placeholder's position.
const PLACEHOLDERS_MIN: u64 = 3;
/// Smallest share of the rows that a second sensor has: 1 / 5. Moving queues have fewer.
const TWICE_OF: u64 = 5;
const TYPES: [AgentType; 3] = [AgentType::Vehicle, AgentType::Cyclist, AgentType::Pedestrian];

/// Figures of the detections of a type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TypeFigures {
    /// The type.
    pub agent_type: AgentType,
    /// Number of detections.
    pub rows: u64,
    /// Number of agents: identities, or paths without an identity.
    pub agents: u64,
    /// Median and 95th percentile of the speeds of moving agents, over a second or more.
    pub moving_mps: Option<[f64; 2]>,
    /// Median ratio between this speed and the reported one.
    pub reported_ratio: Option<f64>,
    /// Median length.
    pub length_m: Option<f64>,
}

/// Examines detections, see the [crate].
#[derive(Clone, Debug)]
pub struct Audit {
    agents: Agents,
    /// Rate by which frames are numbered, if the stamps come from frame numbers.
    frame_rate: Option<f64>,
    frames: u64,
    rows: u64,
    by_type: [(u64, u64); TYPES.len()],
    speeds: [Speeds; TYPES.len()],
    headings: Headings,
    /// Speeds and headings as numbers.
    columns: [Column; 2],
    stamps: Stamps,
    whole: Tally,
    backwards: Tally,
    repeated: Tally,
    /// Repeated detections of agents that are not on a grid.
    repeated_off_grid: Tally,
    on_grid_rows: u64,
    outliers: Tally,
    placeholders: Tally,
    loose_placeholders: Tally,
    jumps: Tally,
    extent: Extent,
    stacks: Stacks,
    echoes: Echoes,
    displacements: Displacements,
    handovers: Handovers,
    /// Whether detections count as detections without identities.
    ignores_ids: bool,
    /// Detections of agents that are too fast for their type, and their speed.
    fast: [(Tally, f64); TYPES.len()],
    /// Detections without identities.
    loose: Tally,
    sizes: Sizes,
}

impl Audit {
    /// An audit that follows up to this number of identities at a time. `frame_rate` is given for recordings
    /// that number their frames.
    #[must_use]
    pub fn new(identities: usize, frame_rate: Option<f64>) -> Self {
        Self {
            agents: Agents::with_capacity(identities),
            frame_rate,
            frames: 0,
            rows: 0,
            by_type: Default::default(),
            speeds: std::array::from_fn(|_| Speeds::new()),
            headings: Headings::default(),
            columns: Default::default(),
            stamps: Stamps::default(),
            whole: Tally::default(),
            backwards: Tally::default(),
            repeated: Tally::default(),
            repeated_off_grid: Tally::default(),
            on_grid_rows: 0,
            outliers: Tally::default(),
            placeholders: Tally::default(),
            loose_placeholders: Tally::default(),
            jumps: Tally::default(),
            extent: Extent::default(),
            stacks: Stacks::new(),
            echoes: Echoes::new(),
            displacements: Displacements::new(),
            handovers: Handovers::default(),
            ignores_ids: false,
            fast: Default::default(),
            loose: Tally::default(),
            sizes: Sizes::new(),
        }
    }

    /// Discards the findings and continues with the same agents.
    pub fn restart(&mut self) {
        self.speeds.iter_mut().for_each(Speeds::clear);
        (self.frames, self.rows) = (0, 0);
        self.by_type = Default::default();
        self.columns = Default::default();
        (self.headings, self.stamps) = (Headings::default(), Stamps::default());
        (self.whole, self.backwards) = Default::default();
        (self.repeated, self.repeated_off_grid, self.on_grid_rows) = Default::default();
        (self.outliers, self.placeholders, self.jumps) = Default::default();
        self.loose_placeholders = Tally::default();
        self.sizes.clear();
        (self.extent, self.fast, self.loose) = Default::default();
        self.stacks.clear();
        self.echoes.clear();
        self.displacements.clear();
        self.handovers.clear();
    }

    /// Forgets the agents: their stamps have no meaning any more.
    pub fn end_session(&mut self) {
        self.agents.clear();
        self.echoes.clear();
        self.displacements.end_session();
        self.handovers.end_session();
    }

    /// Discards the counts of changed identities: nobody uses the identities.
    pub(crate) fn forget_handovers(&mut self) {
        self.handovers.clear();
    }

    /// Whether the identities change while their agents continue: they are none.
    #[must_use]
    pub fn identities_change(&self) -> bool {
        self.handovers.doubt().is_some()
    }

    /// Examines the detections from here on as if they had no identities. Of the findings so far only the one about
    /// identities remains, because the others rest on them.
    pub fn ignore_identities(&mut self) {
        let handovers = std::mem::take(&mut self.handovers);
        self.restart();
        self.end_session();
        (self.handovers, self.ignores_ids) = (handovers, true);
    }

    /// Starts a frame. The detections that follow were made at about the same time.
    pub const fn frame(&mut self) {
        self.frames += 1;
    }

    /// Adds rows that go back in time, in the order in which they were written.
    pub fn went_back(&mut self, rows: u64, place: Place) {
        self.backwards.add(rows, place);
    }

    /// Adds a detection made at this time. Its heading is as written and not wrapped.
    pub fn detection(&mut self, stamp_ns: i64, detection: &Detection, place: Place) {
        let Ok(agent_type) = detection.agent_type() else { return };
        let of_type = agent_type as usize;
        self.rows += 1;
        self.by_type[of_type].0 += 1;
        let spot = Spot::new(stamp_ns, detection, place);
        self.stamps.row(stamp_ns, self.frames);
        self.extent.row(&spot);
        self.stacks.row(self.frames, detection, place);
        self.displacements.detection(self.frames, stamp_ns, detection, place);
        if let Some(heading) = spot.heading {
            self.headings.row(heading, place);
        }
        for (column, value) in self.columns.iter_mut().zip([spot.speed_mps, spot.heading]) {
            value.into_iter().for_each(|value| column.row(value));
        }
        if detection.x_m.fract() == 0.0 && detection.y_m.fract() == 0.0 {
            self.whole.add(1, place);
        }
        if agent_type == AgentType::Vehicle && detection.has(detection_flags::HAS_SIZE) {
            self.sizes.row([detection.length_m, detection.width_m].map(f64::from), place);
        }
        let step = if detection.has(detection_flags::HAS_ID) && !self.ignores_ids {
            self.handovers.detection(self.frames, stamp_ns, detection, place);
            self.agents.identified(detection.id, agent_type, spot)
        } else {
            if spot.is_placeholder() {
                self.loose_placeholders.add(1, place);
            }
            self.speeds[of_type].is_loose();
            self.loose.add(1, place);
            self.agents.loose(self.frames, agent_type, spot)
        };
        match step {
            Some(Step { too_fast_mps: Some(speed_mps), .. }) => {
                self.by_type[of_type].1 += 1;
                self.fast[of_type].0.add(1, place);
                self.fast[of_type].1 = speed_mps;
            }
            Some(step) => self.step(of_type, &step, place),
            None => self.by_type[of_type].1 += 1,
        }
    }

    fn step(&mut self, of_type: usize, step: &Step, place: Place) {
        if let Some(interval_ns) = step.interval_ns {
            self.stamps.interval(interval_ns, place);
        }
        if let Some(Repeated { first, rows, on_grid }) = step.repeated {
            match on_grid {
                Some(true) => self.on_grid_rows += rows,
                Some(false) => self.repeated_off_grid.add(rows, first),
                None => {}
            }
            if on_grid != Some(true) {
                self.repeated.add(rows, first);
            }
        }
        let events = [
            (step.outlier, &mut self.outliers),
            (step.placeholder, &mut self.placeholders),
            (step.jump, &mut self.jumps),
        ];
        for (place, tally) in events {
            place.into_iter().for_each(|place| tally.add(1, place));
        }
        if let Some(chord) = step.chord {
            self.extent.way(chord.way_m / chord.elapsed_s, chord.steady, chord.rows);
            self.speeds[of_type].chord(TYPES[of_type], chord);
            let speed_mps = chord.way_m / chord.elapsed_s;
            if chord.steady && speed_mps > limit_mps(TYPES[of_type]) {
                self.fast[of_type].0.add(chord.rows, chord.place);
                self.fast[of_type].1 = speed_mps;
            }
        }
        if let Some(directed) = &step.directed {
            self.headings.chord(directed, TYPES[of_type]);
        }
        if let Some(Constant { speed, heading, way, direction_rad, steady }) = &step.constant {
            self.echoes.add(of_type, way);
            let (rows, place, steady) = (way.rows, way.place, *steady);
            let [speeds, headings] = &mut self.columns;
            let is_off = |speed| steady && speeds::differs(speed, way.speed_mps());
            speeds.chord((*speed, NEAR_ZERO_MPS), is_off, rows, place);
            let is_off = |heading| steady && headings::differs(heading, *direction_rad);
            headings.chord((*heading, 0.0), is_off, rows, place);
        }
    }

    /// Number of detections so far.
    pub const fn rows(&self) -> u64 {
        self.rows
    }

    /// Share of the headings that agree with the motion; `None` if no moving agent has a heading.
    pub fn agreeing_headings(&self) -> Option<f64> {
        self.headings.agreeing()
    }

    /// The figures of each type that occurs.
    pub fn types(&self) -> impl Iterator<Item = TypeFigures> {
        TYPES
            .into_iter()
            .map(|agent_type| {
                let speeds = &self.speeds[agent_type as usize];
                let (rows, agents) = self.by_type[agent_type as usize];
                TypeFigures {
                    agent_type,
                    rows,
                    agents,
                    moving_mps: speeds.moving_mps(),
                    reported_ratio: speeds.ratio(),
                    length_m: (agent_type == AgentType::Vehicle).then(|| self.sizes.length_m()).flatten(),
                }
            })
            .filter(|figures| figures.rows > 0)
    }

    /// All findings so far, whether they are doubts or not, in the order of their kinds.
    pub fn findings(&self) -> Vec<Finding> {
        let mut findings = Vec::new();
        self.visit(|finding| findings.push(finding));
        findings.sort_by_key(|finding: &Finding| finding.doubt);
        findings
    }

    /// The speed and the heading that stand for "unknown": the motion contradicts them in more than
    /// [`DOUBT_SHARE`] of the rows.
    pub fn unknown(&self) -> [Option<f32>; 2] {
        self.unknown_numbers().map(|unknown| unknown.map(|unknown| unknown.value as f32))
    }

    fn unknown_numbers(&self) -> [Option<Unknown>; 2] {
        // A unit explains a constant speed better.
        let has_unit =
            self.speeds.iter().any(|speeds| speeds.reported().is_some_and(|found| found.unit.is_some()));
        let [speed, heading] = [0, 1].map(|column| {
            let unknown = self.columns[column].unknown();
            unknown.filter(|found| found.tally.rows as f64 > DOUBT_SHARE * found.of as f64)
        });
        [speed.filter(|_| !has_unit), heading]
    }

    /// Bits of the kinds that are doubts.
    pub fn doubts(&self) -> u32 {
        let mut bits = 0;
        self.visit(|finding| bits |= if finding.is_doubt() { finding.doubt.bit() } else { 0 });
        bits
    }

    /// Passes every finding to `take`. Does not allocate.
    fn visit(&self, mut take: impl FnMut(Finding)) {
        let [speed, heading] = self.unknown_numbers();
        for (unknown, doubt) in [(speed, Doubt::SpeedsDiffer), (heading, Doubt::HeadingsUnrelated)] {
            if let Some(Unknown { value, tally, of }) = unknown {
                take(Finding::new(doubt, tally, of, Detail::Unknown { value }));
            }
        }
        if heading.is_none()
            && let Some((reading, tally, of)) = self.headings.doubt()
        {
            let doubt = match reading {
                None => Doubt::HeadingsUnrelated,
                Some(reading) if reading.degrees => Doubt::HeadingsInDegrees,
                Some(reading) => match reading.convention {
                    Convention::FromNorth => Doubt::HeadingsFromNorth,
                    Convention::Mirrored | Convention::FromWest => Doubt::HeadingsMirrored,
                    _ => Doubt::HeadingsTurned,
                },
            };
            take(Finding::new(doubt, tally, of, Detail::Heading(reading)));
        }
        for agent_type in TYPES {
            self.visit_speeds(agent_type, &mut take);
        }
        self.visit_positions(&mut take);
        let knows_speeds = self.speeds.iter().any(|speeds| speeds.agree() == Some(true));
        let walking = &self.speeds[AgentType::Pedestrian as usize];
        let walks = walking.moving_mps().is_some() && walking.unusual(AgentType::Pedestrian).is_none();
        self.stamps.visit(knows_speeds || walks, self.rows, &mut take);
        if let Some(interval_s) = self.stamps.sparse_s() {
            take(Finding::new(Doubt::Sparse, self.loose, self.rows, Detail::Interval { interval_s }));
        }
        self.handovers.doubt().into_iter().for_each(&mut take);
        let is_grid = self.on_grid_rows > self.repeated_off_grid.rows;
        let repeated = if is_grid { self.repeated_off_grid } else { self.repeated };
        for (doubt, tally) in [
            (Doubt::StampsGoBack, self.backwards),
            (Doubt::Repeated, repeated),
            (Doubt::Outliers, self.outliers),
            (Doubt::IdentitiesJump, self.jumps),
            (Doubt::AllDisplaced, self.displacements.displaced()),
        ] {
            if tally.rows > 0 {
                take(Finding::new(doubt, tally, self.rows, Detail::None));
            }
        }
    }

    fn visit_speeds(&self, agent_type: AgentType, take: &mut impl FnMut(Finding)) {
        let speeds = &self.speeds[agent_type as usize];
        let frame_rate = self.frame_rate;
        let (fast, speed_mps) = self.fast[agent_type as usize];
        if fast.rows > 0 {
            take(Finding::new(
                Doubt::SpeedsUnusual,
                fast,
                self.rows,
                Detail::TooFast { agent_type, speed_mps },
            ));
        } else if let Some((speeds_mps, tally)) = speeds.unusual(agent_type) {
            let detail = Detail::Speeds { agent_type, speeds_mps, frame_rate };
            take(Finding::new(Doubt::SpeedsUnusual, tally, self.rows, detail));
        }
        if let Some(found) = speeds.reported() {
            let doubt = match found.unit {
                Some(Unit::Kmh) => Doubt::SpeedsInKmh,
                Some(Unit::Mph) => Doubt::SpeedsInMph,
                Some(Unit::InFeet) => Doubt::Feet,
                Some(Unit::FeetPerSecond) | None => Doubt::SpeedsDiffer,
            };
            let detail = Detail::Reported { agent_type, ratio: found.ratio, unit: found.unit, frame_rate };
            take(Finding::new(doubt, found.tally, found.of, detail));
        }
    }

    fn visit_positions(&self, take: &mut impl FnMut(Finding)) {
        self.sizes.visit(self.rows, take);
        let moves = self.speeds.iter().any(|speeds| speeds.moving_mps().is_some());
        if moves && self.whole.rows >= WHOLE_MIN && self.whole.rows == self.rows {
            take(Finding::new(Doubt::Pixels, self.whole, self.rows, Detail::None));
        }
        let stacked = self.stacks.doubt(self.rows);
        // Stamps without fractions put several places of an agent into one frame.
        let are_whole = stacked.is_some() && self.stamps.are_whole();
        if let Some((lag_s, rows)) = self.echoes.doubt()
            && rows.rows * TWICE_OF >= self.rows
            && !are_whole
        {
            take(Finding::new(Doubt::SeenTwice, rows, self.rows, Detail::Interval { interval_s: lag_s }));
        }
        if let Some(all) = self.extent.degrees(self.frames) {
            take(Finding::new(Doubt::Geographic, all, self.rows, Detail::None));
        } else if let Some(stacked) = stacked {
            let detail = if are_whole { Detail::WholeStamps } else { Detail::None };
            take(Finding::new(Doubt::Stacked, stacked, self.rows, detail));
        }
        let mut placeholders = self.placeholders;
        if let Some(first) = self.loose_placeholders.first
            && self.loose_placeholders.rows >= PLACEHOLDERS_MIN
        {
            placeholders.add(self.loose_placeholders.rows, first);
        }
        if placeholders.rows > 0 {
            take(Finding::new(Doubt::Placeholders, placeholders, self.rows, Detail::None));
        }
    }
}
