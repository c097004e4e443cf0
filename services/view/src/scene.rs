//! A tick as JSON for the pages, and the pairing of a run's frames to ticks.
//!
//! Lengths are whole centimetres. `p` is a position in the world frame; all other positions of an agent are
//! relative to its `p`, as flat lists x, y, x, y, …

use std::collections::{BTreeMap, VecDeque};

use recording::Frame;
use serde::Serialize;
use wire::tick_view::{AgentView, ForecastView, Point, TickView};
use wire::{ForecastsTopic, Topic as _, TracksTopic};

use crate::foresight::{Conflict, Foreseen};

/// Number of modes in a scene of the live page: all of them. The page draws the probable ones.
pub const MODES_DRAWN: usize = wire::MODES_MAX;
/// Number of frames of tracks that wait for their forecasts.
const WAITING_MAX: usize = 16;

/// A tick as the pages read it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Scene {
    seq: u64,
    /// Time of validity.
    t: f64,
    /// Δt.
    dt: f64,
    /// Position in m and heading of the ego vehicle.
    ego: Option<[f64; 3]>,
    /// End-to-end latency, ms.
    l: Option<f64>,
    /// Stages that were restarted, with the number of their earlier starts.
    r: BTreeMap<&'static str, u32>,
    /// Doubts about the input so far: bits of [`wire::doubts`].
    d: u32,
    agents: Vec<Agent>,
    /// The ego vehicle's path, relative to its position.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    g: Vec<i64>,
    /// Conflicts: places of both agents in `agents`, -1 for the ego vehicle; probability and probability if nobody
    /// reacts in thousandths; time, ms; position.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    k: Vec<[i64; 7]>,
}

/// A track.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Agent {
    /// Track number and the identity that users see, as text: JSON numbers have 53 bits.
    i: String,
    n: String,
    /// Type by its number.
    t: u32,
    p: [i64; 2],
    /// Velocity, cm/s.
    v: [i64; 2],
    /// Heading, mrad.
    h: i64,
    /// Length and width; 0 if unknown.
    s: [i64; 2],
    /// Time since the last detection, ms.
    u: u64,
    /// Positions before the stamp, oldest first; `None` if the track did not exist.
    y: Vec<Option<i64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    f: Option<Forecast>,
}

/// A published forecast.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Forecast {
    /// Quality and cause by number, and age of the controls, ms.
    q: u32,
    c: u32,
    a: u64,
    /// The single best forecast.
    b: Vec<i64>,
    /// The most probable modes: probability in thousandths, positions.
    m: Vec<(i64, Vec<i64>)>,
    /// The mixture at the last step: of each mode its probability in thousandths, x, y, xx, xy, yy in cm².
    e: Vec<[i64; 6]>,
    /// Weights of the experts in thousandths, by number.
    x: Vec<i64>,
    /// Distance from the training data, in hundredths.
    o: i64,
}

fn scaled(value: f32, scale: f64) -> i64 {
    (f64::from(value) * scale).round() as i64
}

fn centimetres(point_m: Point) -> [i64; 2] {
    point_m.map(|value| scaled(value, 1e2))
}

fn relative(points_m: &[Point], origin: [i64; 2]) -> Vec<i64> {
    points_m
        .iter()
        .flat_map(|point_m| {
            let [x, y] = centimetres(*point_m);
            [x - origin[0], y - origin[1]]
        })
        .collect()
}

impl Scene {
    /// The scene of a tick. `modes` is the number of drawn modes. Regions belong to modes, so 0 leaves out
    /// both.
    #[must_use]
    pub fn new(view: &TickView, modes: usize) -> Self {
        let ego = view.ego.map(|([x_m, y_m], heading_rad)| [x_m, y_m, heading_rad].map(f64::from));
        Self {
            seq: view.seq,
            t: view.stamp_ns as f64 / 1e9,
            dt: view.step_ns as f64 / 1e9,
            ego,
            l: view.end_to_end_ns.map(|time_ns| (time_ns as f64 / 1e4).round() / 1e2),
            r: view.starts.iter().filter(|(_, starts)| *starts > 0).map(|(id, n)| (id.name(), *n)).collect(),
            d: view.doubts,
            agents: view.agents.iter().map(|agent| Agent::new(agent, modes)).collect(),
            g: Vec::new(),
            k: Vec::new(),
        }
    }

    /// The scene with the next seconds of its tick.
    #[must_use]
    pub fn foreseen(mut self, view: &TickView, foreseen: &Foreseen) -> Self {
        if let Some((ego_m, _)) = view.ego {
            self.g = relative(&foreseen.ego_path_m, centimetres(ego_m));
        }
        self.k = foreseen.conflicts.iter().map(numbers).collect();
        self
    }

    /// The JSON, on one line.
    #[must_use]
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }
}

fn numbers(Conflict { places, pair }: &Conflict) -> [i64; 7] {
    let [a, b] = places.map(|place| place.map_or(-1, |place| place as i64));
    let [p, m, t] = [pair.probability, pair.if_nobody_reacts, pair.in_s].map(|value| scaled(value, 1e3));
    let [x, y] = centimetres(pair.at_m);
    [a, b, p, m, t, x, y]
}

impl Agent {
    fn new(agent: &AgentView, modes: usize) -> Self {
        let p = centimetres(agent.position_m);
        let past = agent.history.iter().flat_map(|point_m| match point_m {
            Some(point_m) => relative(&[*point_m], p).into_iter().map(Some).collect(),
            None => vec![None, None],
        });
        Self {
            i: agent.id.to_string(),
            n: agent.known_as().to_string(),
            t: agent.agent_type as u32,
            p,
            v: centimetres(agent.velocity_mps),
            h: scaled(agent.heading_rad, 1e3),
            s: centimetres([agent.length_m.unwrap_or(0.0), agent.width_m.unwrap_or(0.0)]),
            u: agent.unseen_ns / 1_000_000,
            y: past.collect(),
            f: agent.forecast.as_ref().map(|forecast| Forecast::new(forecast, p, modes)),
        }
    }
}

impl Forecast {
    fn new(forecast: &ForecastView, origin: [i64; 2], modes: usize) -> Self {
        let mut order: Vec<usize> = (0..forecast.modes.len()).collect();
        order.sort_by(|a, b| forecast.probability[*b].total_cmp(&forecast.probability[*a]));
        let probability = |mode: usize| scaled(forecast.probability[mode], 1e3);
        let drawn = order.iter().take(modes).filter(|&&mode| probability(mode) > 0);
        let drawn = drawn.map(|&mode| (probability(mode), relative(&forecast.modes[mode], origin)));
        let end = |&mode: &usize| {
            let (mean, covariance) = (forecast.modes[mode].last()?, forecast.covariance[mode].last()?);
            let [x, y] = centimetres(*mean);
            let [xx, xy, yy] = covariance.map(|value| scaled(value, 1e4));
            (probability(mode) > 0).then_some([probability(mode), x - origin[0], y - origin[1], xx, xy, yy])
        };
        let mixture = if modes == 0 { Vec::new() } else { order.iter().filter_map(end).collect() };
        Self {
            q: forecast.quality as u32,
            c: forecast.cause,
            a: forecast.age_ns / 1_000_000,
            b: relative(&forecast.best, origin),
            m: drawn.collect(),
            e: mixture,
            x: forecast.experts.iter().map(|weight| scaled(*weight, 1e3)).collect(),
            o: scaled(forecast.out_of_distribution, 1e2),
        }
    }
}

/// Pairs the tracks and forecasts of a run to ticks.
#[derive(Debug, Default)]
pub struct Pairing {
    tracks: VecDeque<Frame>,
    unpaired: u64,
}

impl Pairing {
    /// Takes a frame. Returns the view of a tick and its forecasts if the frame completes it.
    pub fn take(&mut self, frame: Frame) -> Option<(TickView, Vec<wire::Forecast>)> {
        if !frame.header().is_tick() {
            return None;
        }
        if frame.topic().name == TracksTopic::NAME {
            self.tracks.push_back(frame);
            while self.tracks.len() > WAITING_MAX {
                self.tracks.pop_front();
            }
            return None;
        }
        if frame.topic().name != ForecastsTopic::NAME {
            return None;
        }
        let seq = frame.header().seq;
        while self.tracks.front().is_some_and(|tracks| tracks.header().seq < seq) {
            self.tracks.pop_front();
        }
        let paired = || {
            let tracks = self.tracks.front().filter(|tracks| tracks.header().seq == seq)?;
            let elements = tracks.elements::<TracksTopic>().ok()?;
            let forecasts = frame.elements::<ForecastsTopic>().ok()?;
            Some((TickView::new((tracks.header(), &elements), (frame.header(), &forecasts)), forecasts))
        };
        let tick = paired();
        self.unpaired += u64::from(tick.is_none());
        tick
    }

    /// Number of forecasts whose tracks were not received.
    #[must_use]
    pub const fn unpaired(&self) -> u64 {
        self.unpaired
    }
}

#[cfg(test)]
mod tests {
    use bytemuck::Zeroable;
    use wire::{Header, Quality, Track};

    use super::*;

    fn frames(seq: u64) -> [Frame; 2] {
        let mut header = Header { step_ns: 400_000_000, ..Header::new(1, seq, 1_500_000_000) };
        (header.counts.agents_len, header.counts.history_len, header.counts.horizon_len) = (1, 2, 2);
        let mut track = Track { id: 5, source_id: 1 << 60, x_m: 400.0, y_m: -3.0, ..Track::zeroed() };
        track.history[0] = wire::HistoryState { x_m: 399.5, y_m: -3.0, present: 1, ..Zeroable::zeroed() };
        let mut forecast =
            wire::Forecast { id: 5, modes_len: 2, quality: Quality::Held as u32, ..Zeroable::zeroed() };
        forecast.best[..2].copy_from_slice(&[[400.5, -3.0], [401.0, -3.25]]);
        forecast.modes[0][..2].copy_from_slice(&[[400.0, -3.0], [400.0, -3.0]]);
        forecast.modes[1][..2].copy_from_slice(&[[400.5, -3.0], [401.23, -3.0]]);
        forecast.mode_covariance[1][1] = [0.25, 0.0, 0.01];
        forecast.probability[..2].copy_from_slice(&[0.25, 0.75]);
        [Frame::of::<TracksTopic>(&header, &[track], 1), Frame::of::<ForecastsTopic>(&header, &[forecast], 2)]
    }

    #[test]
    fn a_scene_has_the_published_numbers_to_a_centimetre() {
        let mut pairing = Pairing::default();
        let [tracks, forecasts] = frames(7);
        assert_eq!(pairing.take(tracks), None);
        let (view, _) = pairing.take(forecasts).unwrap();
        let scene: serde_json::Value = serde_json::from_str(&Scene::new(&view, 1).to_json()).unwrap();
        assert_eq!((&scene["seq"], &scene["t"], &scene["dt"]), (&7.into(), &1.5.into(), &0.4.into()));
        let agent = &scene["agents"][0];
        let expected = serde_json::json!({
            "i": "5", "n": "1152921504606846976", "t": 0, "p": [40_000, -300], "v": [0, 0], "h": 0, "s": [0, 0],
            "u": 0, "y": [-50, 0],
            "f": {
                "q": 1, "c": 0, "a": 0, "b": [50, 0, 100, -25], "m": [[750, [50, 0, 123, 0]]],
                "e": [[750, 123, 0, 2500, 0, 100], [250, 0, 0, 0, 0, 0]], "x": [0, 0, 0, 0, 0, 0, 0, 0], "o": 0
            }
        });
        assert_eq!(*agent, expected);
    }

    #[test]
    fn forecasts_without_their_tracks_are_counted() {
        let mut pairing = Pairing::default();
        let [tracks, _] = frames(1);
        let [_, late] = frames(2);
        assert_eq!((pairing.take(tracks), pairing.take(late), pairing.unpaired()), (None, None, 1));
        for seq in 3..100 {
            assert_eq!(pairing.take(frames(seq)[0].clone()), None);
        }
        assert_eq!(pairing.tracks.len(), WAITING_MAX, "tracks without forecasts are bounded");
    }
}
