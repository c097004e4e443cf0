//! A tracker, and frames for it.

use bytemuck::Zeroable;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use tracker::{InputModel, Tracked, Tracker, TrackerOptions};
use wire::{AGENTS_MAX, AgentType, Detection, Forecast, Header, Rejected, Track, detection_flags};

pub const TICK_NS: i64 = 80_000_000;
pub const ALL_TYPES: u32 = 0b111;

/// Options without a steady motion and without smoothing: histories hold the states as they were published.
pub fn without_smoothing() -> TrackerOptions {
    let options = TrackerOptions::default();
    TrackerOptions { detector: InputModel { steadiness: [0.0; 3], ..options.detector }, ..options }
}

/// A tracker that processes frames at a steady rate.
pub struct Harness {
    pub tracker: Tracker,
    pub tracks: Vec<Track>,
    pub flags: u32,
    pub ego_heading_rad: f32,
    pub observed_types: u32,
    pub tick_ns: i64,
    pub stamp_ns: i64,
    /// Forecasts for the next frame.
    pub prior: Option<(Header, Vec<Forecast>)>,
}

impl Harness {
    pub fn new(options: TrackerOptions, flags: u32) -> Self {
        Self {
            tracker: Tracker::new(options),
            tracks: vec![Track::zeroed(); AGENTS_MAX],
            flags,
            ego_heading_rad: 0.0,
            observed_types: ALL_TYPES,
            tick_ns: TICK_NS,
            stamp_ns: 1_000_000_000,
            prior: None,
        }
    }

    pub fn header(&self) -> Header {
        let Self { flags, ego_heading_rad, observed_types, stamp_ns, .. } = *self;
        Header { flags, ego_heading_rad, observed_types, ..Header::new(1, 0, stamp_ns) }
    }

    pub fn step(&mut self, detections: &[Detection]) -> &[Track] {
        self.try_step(detections).expect("a good frame");
        self.published()
    }

    pub fn try_step(&mut self, detections: &[Detection]) -> Result<Tracked, Rejected> {
        self.stamp_ns += self.tick_ns;
        let prior = self.prior.take();
        let prior = prior.as_ref().map(|(header, forecasts)| (header, &forecasts[..]));
        let header = self.header();
        let tracked = self.tracker.step(&header, detections, prior, &mut self.tracks);
        self.tracker.audit(&header, detections);
        let tracked = tracked?;
        for track in &self.tracks[..tracked.track_count] {
            track.check().expect("a track fit for the wire");
        }
        Ok(tracked)
    }

    pub fn published(&self) -> &[Track] {
        let agents_len = self.tracker.header(&self.header()).counts.agents_len;
        &self.tracks[..agents_len as usize]
    }
}

/// A detection with only a position. The id identifies the agent for the test. The tracker uses it only if a
/// header sets `HAS_IDENTITIES`.
pub fn detected_at(agent_type: AgentType, id: u64, x_m: f64, y_m: f64) -> Detection {
    Detection {
        id,
        x_m: x_m as f32,
        y_m: y_m as f32,
        score: 1.0,
        agent_type: agent_type as u32,
        flags: detection_flags::HAS_ID,
        ..Detection::zeroed()
    }
}

pub fn with_heading(detection: Detection, heading_rad: f64) -> Detection {
    let flags = detection.flags | detection_flags::HAS_HEADING;
    Detection { heading_rad: filters::wrapped(heading_rad) as f32, flags, ..detection }
}

/// Two agents with crossing paths. Each starts with a velocity and swerves slightly.
pub struct Meeting {
    pub name: &'static str,
    pub agent_type: AgentType,
    /// Position of each agent at the crossing, and its velocity.
    pub agents: [([f64; 2], [f64; 2]); 2],
}

/// Crossings at right angles and head on.
pub const MEETINGS: [Meeting; 3] = [
    Meeting {
        name: "pedestrians at right angles",
        agent_type: AgentType::Pedestrian,
        agents: [([0.0, 0.0], [1.4, 0.0]), ([0.3, 0.0], [0.0, 1.4])],
    },
    Meeting {
        name: "pedestrians head on, 0.6 m apart",
        agent_type: AgentType::Pedestrian,
        agents: [([0.0, 0.0], [1.4, 0.0]), ([0.0, 0.6], [-1.2, 0.0])],
    },
    Meeting {
        name: "vehicles at right angles",
        agent_type: AgentType::Vehicle,
        agents: [([0.0, 0.0], [8.0, 0.0]), ([3.0, 0.0], [0.0, 9.0])],
    },
];

impl Meeting {
    /// Position and velocity of each agent this time before the crossing.
    pub fn states(&self, before_s: f64) -> [[f64; 4]; 2] {
        self.agents.map(|([x, y], [vx, vy])| [x - before_s * vx, y - before_s * vy, vx, vy])
    }

    /// Moves an agent on by a tick, and changes its velocity at random.
    pub fn swerve(state: &mut [f64; 4], rng: &mut ChaCha8Rng) {
        let tick_s = TICK_NS as f64 / 1e9;
        for axis in 0..2 {
            state[2 + axis] += noise(rng, 0.3) * tick_s.sqrt();
            state[axis] += state[2 + axis] * tick_s;
        }
    }
}

/// Normal noise with this standard deviation.
pub fn noise(rng: &mut ChaCha8Rng, sigma: f64) -> f64 {
    Normal::new(0.0, sigma).expect("a finite sigma").sample(rng)
}
