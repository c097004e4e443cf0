//! Selects scenes of a recording and forecasts them for drawing.

use std::collections::{BTreeMap, BTreeSet};

use data::{RecordedTrack, Recording};
use drawing::{AgentDrawing, ForecastDrawing};
use evaluator::{Agent, Cut, Forecast, Forecaster, MOVING_MPS, MapInput, Scene};
use metrics::{Displacement, Point};
use scene::{ContextMap, MapBuilder, State};
use thiserror::Error;

/// Maximum number of a recording's scenes that are ranked, evenly spread.
pub const RANKED_MAX: usize = 240;

/// A recording, cut into scenes that can be forecast.
pub struct Storyboard<'a> {
    forecaster: &'a Forecaster,
    map: MapInput<'a>,
    scenes: Vec<Scene>,
    recording: Recording,
    tracks: BTreeMap<u64, RecordedTrack>,
    start_ns: i64,
    threads: usize,
}

/// One time of a recording with its forecasts.
#[derive(Clone, Debug)]
pub struct Shot {
    /// Time since the recording's first frame.
    pub time_s: f64,
    /// Index of the recording's frame.
    pub frame: usize,
    /// The agents whose forecasts are drawn.
    pub about: Vec<u64>,
    /// All agents; those in `about` have a forecast.
    pub agents: Vec<AgentDrawing>,
    /// Mean errors over the agents with a forecast and a known future.
    pub errors: Option<ShotErrors>,
    /// The map of the recording up to this time, if forecasts read the online map.
    pub online_map: Option<ContextMap>,
}

/// Errors of a shot's forecasts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShotErrors {
    /// Number of agents.
    pub agents_len: usize,
    /// Modes per forecast.
    pub modes_len: usize,
    /// ADE and FDE of the best mode, which is chosen separately for each.
    pub best: [f64; 2],
    /// ADE and FDE of the most probable mode.
    pub likeliest: [f64; 2],
}

/// A time or an agent that can't be drawn.
#[derive(Debug, Error, PartialEq)]
pub enum StoryboardError {
    /// No scene can be cut from the recording.
    #[error("the recording has no agents with identities")]
    NoScenes,
    /// The time is outside the recording.
    #[error(
        "no scene at {time_s} s: the recording has agents that can be forecast from {first_s} s to {last_s} s"
    )]
    Outside {
        /// The requested time.
        time_s: f64,
        /// Time of the first scene.
        first_s: f64,
        /// Time of the last scene.
        last_s: f64,
    },
    /// The agent can't be forecast at this time.
    #[error(
        "agent {agent} can't be forecast at {time_s} s: it needs two states; those that have them: {able}"
    )]
    Agent {
        /// The requested agent.
        agent: u64,
        /// The time of the scene.
        time_s: f64,
        /// The agents that can be forecast at this time.
        able: String,
    },
    /// No agent can be ranked.
    #[error("no agent moves and is seen over a whole history and horizon")]
    NothingToRank,
}

impl<'a> Storyboard<'a> {
    /// Cuts a recording into scenes one step of the model apart.
    ///
    /// # Errors
    /// [`StoryboardError::NoScenes`] if there are none.
    pub fn new(
        forecaster: &'a Forecaster,
        recording: &Recording,
        map: MapInput<'a>,
        threads: usize,
    ) -> Result<Self, StoryboardError> {
        let scenes = Cut::of(forecaster.config()).scenes(recording);
        let first = recording.frames.first().filter(|_| !scenes.is_empty());
        let start_ns = first.ok_or(StoryboardError::NoScenes)?.stamp_ns;
        let tracks = data::tracks(recording).into_iter().map(|track| (track.id, track)).collect();
        Ok(Self { forecaster, map, scenes, recording: recording.clone(), tracks, start_ns, threads })
    }

    /// The first scene at or after a time with an agent that can be forecast. It shows the forecasts of the
    /// given agents, or of all if none are given.
    ///
    /// # Errors
    /// [`StoryboardError`] if there is no such scene, or if one of the agents can't be forecast in it.
    pub fn at(&self, time_s: f64, agents: &[u64]) -> Result<Shot, StoryboardError> {
        let is_then = |scene: &Scene| self.time_s(scene) >= time_s - 1e-6 && !able(scene).is_empty();
        let number = self.scenes.iter().position(is_then);
        let mut usable_s = self.usable_s();
        let first_s = usable_s.next().unwrap_or_default();
        let outside =
            || StoryboardError::Outside { time_s, first_s, last_s: usable_s.last().unwrap_or(first_s) };
        let number = number.filter(|_| time_s >= 0.0).ok_or_else(outside)?;
        let scene = &self.scenes[number];
        let able = able(scene);
        let ids = |places: &[usize]| places.iter().map(|&place| scene.agents[place].id).collect::<Vec<u64>>();
        let able_ids = ids(&able);
        if let Some(&agent) = agents.iter().find(|agent| !able_ids.contains(agent)) {
            let able = able_ids.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
            return Err(StoryboardError::Agent { agent, time_s: self.time_s(scene), able });
        }
        let is_wanted = |place: &usize| agents.is_empty() || agents.contains(&scene.agents[*place].id);
        let wanted: Vec<usize> = able.into_iter().filter(is_wanted).collect();
        let forecasts = self.forecasts(&[number]);
        Ok(self.shot(number, &wanted, &forecasts[&number]))
    }

    /// The time of the middle one of the scenes with an agent that can be forecast; `None` if there are none.
    #[must_use]
    pub fn middle_s(&self) -> Option<f64> {
        let usable_s: Vec<f64> = self.usable_s().collect();
        usable_s.get(usable_s.len() / 2).copied()
    }

    /// Times of the scenes with an agent that can be forecast.
    fn usable_s(&self) -> impl Iterator<Item = f64> {
        self.scenes.iter().filter(|scene| !able(scene).is_empty()).map(|scene| self.time_s(scene))
    }

    /// The agents with the best and the worst forecasts, `len` of each, the extreme ones first. Each agent
    /// has its own shot.
    ///
    /// Agents are ranked by the ADE of the best mode. Ranked agents keep moving and are present over a whole
    /// history and horizon. At most [`RANKED_MAX`] scenes are ranked, and no agent is shown twice.
    ///
    /// # Errors
    /// [`StoryboardError::NothingToRank`] if there are no such agents.
    pub fn extremes(&self, len: usize) -> Result<[Vec<Shot>; 2], StoryboardError> {
        let spacing = self.scenes.len().div_ceil(RANKED_MAX).max(1);
        let numbers: Vec<usize> = (0..self.scenes.len()).step_by(spacing).collect();
        let forecasts = self.forecasts(&numbers);
        let mut ranked: Vec<Ranked> =
            forecasts.iter().flat_map(|(&number, forecasts)| self.ranked(number, forecasts)).collect();
        if ranked.is_empty() {
            return Err(StoryboardError::NothingToRank);
        }
        ranked.sort_by(|a, b| a.ade_m.total_cmp(&b.ade_m));
        let mut shown = BTreeSet::new();
        let mut take = |ranked: &mut dyn Iterator<Item = &Ranked>| -> Vec<Shot> {
            let fresh = ranked.filter(|entry| shown.insert(entry.agent)).take(len);
            fresh.map(|entry| self.shot(entry.scene, &[entry.place], &forecasts[&entry.scene])).collect()
        };
        let best = take(&mut ranked.iter());
        let worst = take(&mut ranked.iter().rev());
        Ok([best, worst])
    }

    fn ranked(&self, number: usize, forecasts: &[Option<Forecast>]) -> Vec<Ranked> {
        let scene = &self.scenes[number];
        let horizon_s = scene.agents.first().map_or(0, |agent| agent.future.len()) as f32
            * self.forecaster.config().dt_s as f32;
        let moves = |agent: &Agent| {
            let (Some(now), Some(Some(end))) = (agent.newest(), agent.future.last()) else { return false };
            let way_m = (end[0] - now.position_m[0]).hypot(end[1] - now.position_m[1]);
            now.speed_mps() >= MOVING_MPS && way_m >= MOVING_MPS * horizon_s
        };
        let wanted: Vec<usize> =
            scene.complete().into_iter().filter(|&place| moves(&scene.agents[place])).collect();
        let rank = |&place: &usize| {
            let forecast = forecasts[place].as_ref()?;
            let agent = &scene.agents[place];
            let ade_m = metrics::min_displacement(&forecast.modes, &agent.future).ade_m?;
            Some(Ranked { ade_m, agent: agent.id, scene: number, place })
        };
        wanted.iter().filter_map(rank).collect()
    }

    /// The forecasts of scenes with these numbers, in ascending order. Each scene has one entry per agent;
    /// `None` if the agent is absent.
    fn forecasts(&self, numbers: &[usize]) -> BTreeMap<usize, Vec<Option<Forecast>>> {
        let len = numbers.last().map_or(0, |last| last + 1);
        let scenes = &self.scenes[..len];
        let is_wanted = |number: usize| numbers.binary_search(&number).is_ok();
        let forecasts = self.forecaster.forecast(&self.recording, scenes, self.map, self.threads, is_wanted);
        forecasts.into_iter().enumerate().filter(|(number, _)| is_wanted(*number)).collect()
    }

    fn shot(&self, number: usize, wanted: &[usize], forecasts: &[Option<Forecast>]) -> Shot {
        let scene = &self.scenes[number];
        let of_agents: Vec<(&Agent, &Forecast)> = wanted
            .iter()
            .filter_map(|&place| Some((&scene.agents[place], forecasts[place].as_ref()?)))
            .collect();
        let errors = ShotErrors::of(&of_agents);
        let forecasts: BTreeMap<u64, &Forecast> =
            of_agents.into_iter().map(|(agent, forecast)| (agent.id, forecast)).collect();
        let online_map = match self.map {
            MapInput::Online => self.ground_before(scene.stamp_ns),
            MapInput::None | MapInput::Site(_) => None,
        };
        Shot {
            time_s: self.time_s(scene),
            frame: self.recording.frames.partition_point(|frame| frame.stamp_ns < scene.stamp_ns),
            about: forecasts.keys().copied().collect(),
            agents: scene
                .agents
                .iter()
                .filter_map(|agent| self.drawing(agent, scene.stamp_ns, forecasts.get(&agent.id).copied()))
                .collect(),
            errors,
            online_map,
        }
    }

    fn drawing(&self, agent: &Agent, stamp_ns: i64, forecast: Option<&Forecast>) -> Option<AgentDrawing> {
        let now = agent.newest()?;
        let (_, past) = agent.history.split_last()?;
        let reported = self.tracks.get(&agent.id).map(|track| track.reported_at(stamp_ns));
        Some(AgentDrawing {
            id: agent.id,
            agent_type: agent.agent_type,
            length_m: agent.length_m,
            width_m: reported.map(|reported| reported.width_m).filter(|width_m| *width_m > 0.0),
            heading_rad: now.heading_rad,
            now: now.position_m,
            history: past.iter().map(|state| state.map(|state| state.position_m)).collect(),
            truth: agent.future.clone(),
            forecast: forecast.map(|forecast| ForecastDrawing {
                modes: forecast.modes.clone(),
                probability: forecast.probability.clone(),
                covariance: forecast.covariance.clone(),
            }),
        })
    }

    /// The map of all places where agents were detected up to this time, also between steps.
    fn ground_before(&self, stamp_ns: i64) -> Option<ContextMap> {
        let states: Vec<State> = self
            .tracks
            .values()
            .flat_map(|track| track.states.iter().take_while(|(seen_ns, _)| *seen_ns <= stamp_ns))
            .map(|(_, state)| *state)
            .collect();
        let first = states.first()?.position_m;
        let extreme = |pick: fn(f32, f32) -> f32| {
            states
                .iter()
                .fold(first, |so_far, state| [0, 1].map(|axis| pick(so_far[axis], state.position_m[axis])))
        };
        let origin_m = extreme(f32::min).map(f32::floor);
        let high_m = extreme(f32::max);
        let [cols, rows] = [0, 1].map(|axis| (high_m[axis] - origin_m[axis]) as usize + 1);
        let mut builder = MapBuilder::new(origin_m, rows, cols)?;
        for state in states {
            builder.visit(state.position_m, state.velocity_mps);
        }
        Some(builder.build())
    }

    fn time_s(&self, scene: &Scene) -> f64 {
        (scene.stamp_ns - self.start_ns) as f64 / 1e9
    }
}

/// The error of an agent's forecast in a scene.
#[derive(Clone, Copy, Debug)]
struct Ranked {
    ade_m: f64,
    agent: u64,
    scene: usize,
    place: usize,
}

/// Places of the agents that have the two newest states.
fn able(scene: &Scene) -> Vec<usize> {
    let has_two =
        |agent: &Agent| agent.history.len() >= 2 && agent.history.iter().rev().take(2).all(Option::is_some);
    (0..scene.agents.len()).filter(|&place| has_two(&scene.agents[place])).collect()
}

impl ShotErrors {
    fn of(agents: &[(&Agent, &Forecast)]) -> Option<Self> {
        let pair = |errors: Displacement| Some([errors.ade_m?, errors.fde_m?]);
        let errors = |(agent, forecast): &(&Agent, &Forecast)| {
            let truth: &[Option<Point>] = &agent.future;
            let best = pair(metrics::min_displacement(&forecast.modes, truth))?;
            let likeliest = metrics::most_likely(&forecast.probability)?;
            Some([best, pair(metrics::displacement(&forecast.modes[likeliest], truth))?])
        };
        let errors: Vec<[[f64; 2]; 2]> = agents.iter().filter_map(errors).collect();
        let modes_len = agents.first().map_or(0, |(_, forecast)| forecast.modes.len());
        let mean = |which: usize, entry: usize| {
            errors.iter().map(|errors| errors[which][entry]).sum::<f64>() / errors.len() as f64
        };
        (!errors.is_empty()).then(|| Self {
            agents_len: errors.len(),
            modes_len,
            best: [mean(0, 0), mean(0, 1)],
            likeliest: [mean(1, 0), mean(1, 1)],
        })
    }
}

#[cfg(test)]
mod tests {
    use nn::Weights;
    use scene::AgentType;
    use wire::Detection;
    use wire::detection_flags::HAS_ID;

    use super::*;

    /// Two walking pedestrians, and a third one that is observed once.
    fn walkers() -> data::Recording {
        let detection = |id: u64, x_m: f32, y_m: f32| Detection {
            id,
            x_m,
            y_m,
            score: 1.0,
            agent_type: AgentType::Pedestrian as u32,
            flags: HAS_ID,
            ..Detection::default()
        };
        let frame = |number: u64| {
            let way_m = 0.5 * number as f32;
            let mut detections = vec![detection(1, way_m, 0.0), detection(2, 0.3, -way_m)];
            detections.extend((number == 12).then(|| detection(3, 9.0, 9.0)));
            data::Frame {
                stamp_ns: 5_000_000_000 + 400_000_000 * number as i64,
                observed_types: AgentType::Pedestrian.bit(),
                detections,
                ..data::Frame::default()
            }
        };
        data::Recording {
            name: "walkers".to_owned(),
            interval_ns: 400_000_000,
            has_identities: true,
            frames: (0..40).map(frame).collect(),
            ..data::Recording::default()
        }
    }

    #[test]
    fn a_storyboard_finds_moments_and_agents() {
        let forecaster = Forecaster::new(Weights::onboard(), 1).unwrap();
        let recording = walkers();
        let board = Storyboard::new(&forecaster, &recording, MapInput::Online, 1).unwrap();
        let shot = board.at(4.7, &[]).unwrap();
        assert!((shot.time_s - 4.8).abs() < 1e-9, "{} s", shot.time_s);
        assert_eq!((shot.about.as_slice(), shot.agents.len()), (&[1, 2][..], 3));
        assert_eq!(shot.agents[0].now, [6.0, 0.0]);
        assert_eq!(shot.agents[0].truth[0], Some([6.5, 0.0]));
        assert!(shot.errors.unwrap().best[0] < 1.0, "{:?}", shot.errors);
        assert!(shot.online_map.is_some());
        assert_eq!(board.at(4.8, &[2]).unwrap().about, [2]);
        let error = board.at(4.8, &[3]).unwrap_err().to_string();
        assert_eq!(
            error,
            "agent 3 can't be forecast at 4.8 s: it needs two states; those that have them: 1, 2"
        );
        for time_s in [-1.0, 17.0, f64::NAN] {
            assert!(matches!(board.at(time_s, &[]), Err(StoryboardError::Outside { .. })), "{time_s}");
        }
        let [best, worst] = board.extremes(3).unwrap();
        assert_eq!((best.len(), worst.len()), (2, 0), "no agent is shown twice");
        let middle = board.at(board.middle_s().unwrap(), &[]).unwrap();
        assert_eq!(
            recording.frames[middle.frame].stamp_ns - recording.frames[0].stamp_ns,
            (middle.time_s * 1e9) as i64
        );
        let last_s = (recording.frames.len() as f64 - 1.0) * recording.interval_ns as f64 / 1e9;
        assert!((0.3..0.7).contains(&(middle.time_s / last_s)), "{} of {last_s}", middle.time_s);
        let ade_m = |shot: &Shot| shot.errors.unwrap().best[0];
        assert!(ade_m(&best[0]) <= ade_m(&best[1]));
    }

    #[test]
    fn a_storyboard_needs_agents() {
        let forecaster = Forecaster::new(Weights::onboard(), 1).unwrap();
        let empty = Storyboard::new(&forecaster, &data::Recording::default(), MapInput::None, 1);
        assert_eq!(empty.err(), Some(StoryboardError::NoScenes));
    }
}
