//! The scene over the whole run, packed.
//!
//! All numbers are integers (cm, mrad, ms), zigzag varints in separate streams, then deflated. Varints have no
//! limit, so positions far from the origin need no special treatment. The streams, each with its length in front:
//!
//! | stream | content |
//! |---|---|
//! | tracks | per track: number, identity (as text), type, length, width |
//! | ticks | per tick: number and time as differences, number of agents |
//! | agents | per agent: place of its track as a difference to the agent before it, 4 × cause + quality, or -1 without a forecast |
//! | poses | per agent: differences of x, y and heading to the track's last kept tick |
//! | steps | per forecast: number of steps, then second differences of the single best forecast |

use std::collections::BTreeMap;

use wire::tick_view::{AgentView, Point, TickView};

/// Maximum number of kept ticks; of longer runs every second, fourth, … tick is kept.
const TICKS_MAX: usize = 1_500;
/// Number of streams.
const STREAMS: usize = 5;

/// The kept ticks of a run.
#[derive(Debug, Default)]
pub struct Scrub {
    tracks: Vec<Track>,
    places: BTreeMap<u64, usize>,
    ticks: Vec<Kept>,
    /// One tick in this many is kept.
    every: usize,
    seen: usize,
}

#[derive(Debug)]
struct Track {
    id: u64,
    known_as: u64,
    agent_type: u32,
    size: [i64; 2],
}

#[derive(Debug)]
struct Kept {
    seq: u64,
    stamp_ms: i64,
    agents: Vec<KeptAgent>,
}

#[derive(Debug)]
struct KeptAgent {
    track: usize,
    pose: [i64; 3],
    /// Quality and cause.
    kind: Option<[i64; 2]>,
    best: Vec<[i32; 2]>,
}

fn centimetres(point_m: Point) -> [i64; 2] {
    point_m.map(|value| (f64::from(value) * 1e2).round() as i64)
}

impl Scrub {
    pub fn add(&mut self, view: &TickView) {
        self.every = self.every.max(1);
        self.seen += 1;
        if !(self.seen - 1).is_multiple_of(self.every) {
            return;
        }
        let agents = view.agents.iter().map(|agent| self.agent(agent)).collect();
        self.ticks.push(Kept { seq: view.seq, stamp_ms: view.stamp_ns / 1_000_000, agents });
        if self.ticks.len() > TICKS_MAX {
            let mut place = 0;
            self.ticks.retain(|_| {
                place += 1;
                place % 2 == 1
            });
            self.every *= 2;
        }
    }

    fn agent(&mut self, agent: &AgentView) -> KeptAgent {
        let [length, width] = centimetres([agent.length_m.unwrap_or(0.0), agent.width_m.unwrap_or(0.0)]);
        let track = *self.places.entry(agent.id).or_insert_with(|| {
            let (id, known_as, agent_type) = (agent.id, agent.known_as(), agent.agent_type as u32);
            self.tracks.push(Track { id, known_as, agent_type, size: [length, width] });
            self.tracks.len() - 1
        });
        let [x, y] = centimetres(agent.position_m);
        let forecast = agent.forecast.as_ref();
        let step = |point_m: &Point| {
            let [px, py] = centimetres(*point_m);
            [px - x, py - y].map(|value| value as i32)
        };
        KeptAgent {
            track,
            pose: [x, y, (f64::from(agent.heading_rad) * 1e3).round() as i64],
            kind: forecast.map(|forecast| [forecast.quality as i64, i64::from(forecast.cause)]),
            best: forecast.map(|forecast| forecast.best.iter().map(step).collect()).unwrap_or_default(),
        }
    }

    /// The packed ticks in at most about `limit` bytes.
    pub fn packed(&self, limit: usize) -> Vec<u8> {
        self.fitting(limit).0
    }

    /// One tick in this many is in [`Scrub::packed`].
    pub fn every(&self, limit: usize) -> usize {
        self.fitting(limit).1
    }

    fn fitting(&self, limit: usize) -> (Vec<u8>, usize) {
        let mut stride = 1;
        loop {
            let packed = deflate(&self.encoded(stride));
            if packed.len() <= limit || stride > self.ticks.len() {
                return (packed, self.every.max(1) * stride);
            }
            // The size is about inversely proportional to the stride.
            stride = (stride + 1).max(stride * packed.len() / limit);
        }
    }

    fn encoded(&self, stride: usize) -> Vec<u8> {
        let mut streams: [Vec<u8>; STREAMS] = Default::default();
        let [tracks, ticks, agents, poses, steps] = &mut streams;
        for track in &self.tracks {
            for text in [track.id.to_string(), track.known_as.to_string()] {
                put(tracks, text.len() as i64);
                tracks.extend(text.bytes());
            }
            [i64::from(track.agent_type), track.size[0], track.size[1]]
                .into_iter()
                .for_each(|v| put(tracks, v));
        }
        let mut last = vec![[0_i64; 3]; self.tracks.len()];
        let mut before = [0, 0];
        for tick in self.ticks.iter().step_by(stride) {
            let now = [tick.seq as i64, tick.stamp_ms];
            [now[0] - before[0], now[1] - before[1], tick.agents.len() as i64]
                .into_iter()
                .for_each(|v| put(ticks, v));
            before = now;
            let mut place = 0;
            for agent in &tick.agents {
                put(agents, agent.track as i64 - place);
                place = agent.track as i64;
                put(agents, agent.kind.map_or(-1, |[quality, cause]| 4 * cause + quality));
                let last = &mut last[agent.track];
                (0..3).for_each(|axis| put(poses, agent.pose[axis] - last[axis]));
                *last = agent.pose;
                if agent.kind.is_some() {
                    put(steps, agent.best.len() as i64);
                    second_differences(steps, &agent.best);
                }
            }
        }
        let mut bytes = Vec::new();
        put(&mut bytes, self.tracks.len() as i64);
        put(&mut bytes, self.ticks.len().div_ceil(stride) as i64);
        streams.iter().for_each(|stream| put(&mut bytes, stream.len() as i64));
        bytes.extend(streams.concat());
        bytes
    }
}

fn second_differences(stream: &mut Vec<u8>, points: &[[i32; 2]]) {
    let (mut last, mut speed) = ([0_i64; 2], [0_i64; 2]);
    for point in points {
        for axis in 0..2 {
            let value = i64::from(point[axis]);
            let difference = value - last[axis];
            put(stream, difference - speed[axis]);
            (last[axis], speed[axis]) = (value, difference);
        }
    }
}

/// Appends a zigzag varint.
fn put(bytes: &mut Vec<u8>, value: i64) {
    let mut rest = (value << 1 ^ value >> 63) as u64;
    while rest >= 0x80 {
        bytes.push(rest as u8 | 0x80);
        rest >>= 7;
    }
    bytes.push(rest as u8);
}

/// Compresses as zlib without a header.
pub(super) fn deflate(bytes: &[u8]) -> Vec<u8> {
    miniz_oxide::deflate::compress_to_vec(bytes, 9)
}

#[cfg(test)]
mod tests {
    use wire::tick_view::ForecastView;
    use wire::{AgentType, Cause, Quality};

    use super::*;

    fn tick(seq: u64, agents: u64) -> TickView {
        let agent = |id: u64| {
            let x_m = 40_000.0 + seq as f32 * 0.5 + id as f32 * 3.0;
            let bend = (seq.wrapping_mul(id + 7) % 97) as f32;
            let best = (1..=12).map(|k| [x_m + k as f32, bend * k as f32 / 30.0]).collect();
            AgentView {
                id,
                source_id: 0,
                agent_type: AgentType::Vehicle,
                position_m: [x_m, 0.0],
                velocity_mps: [1.0, 0.0],
                heading_rad: 0.1,
                length_m: None,
                width_m: None,
                unseen_ns: 0,
                history: Vec::new(),
                forecast: Some(ForecastView {
                    quality: Quality::Held,
                    cause: Cause::Late as u32,
                    age_ns: 0,
                    experts: [0.0; wire::EXPERTS_MAX],
                    out_of_distribution: 0.0,
                    best,
                    modes: Vec::new(),
                    probability: Vec::new(),
                    covariance: Vec::new(),
                }),
            }
        };
        TickView {
            seq,
            stamp_ns: seq as i64 * 80_000_000,
            agents: (0..agents).map(agent).collect(),
            ..TickView::default()
        }
    }

    #[test]
    fn numbers_are_zigzag_varints() {
        let bytes = |value| {
            let mut bytes = Vec::new();
            put(&mut bytes, value);
            bytes
        };
        assert_eq!((bytes(0), bytes(-1), bytes(1)), (vec![0], vec![1], vec![2]));
        assert_eq!((bytes(64), bytes(-4_000_000).len(), bytes(i64::MIN).len()), (vec![0x80, 1], 4, 10));
    }

    #[test]
    fn a_run_of_any_length_fits_its_share() {
        let mut scrub = Scrub::default();
        for seq in 0..6_500 {
            scrub.add(&tick(seq, 16));
        }
        assert!(scrub.ticks.len() <= TICKS_MAX && scrub.every == 8, "{} {}", scrub.ticks.len(), scrub.every);
        assert!(scrub.ticks.iter().all(|tick| tick.seq % 8 == 0));
        for limit in [300_000, 20_000] {
            let (packed, every) = scrub.fitting(limit);
            assert!(packed.len() <= limit, "{} bytes of {limit}", packed.len());
            assert_eq!(every % 8, 0);
        }
    }
}
