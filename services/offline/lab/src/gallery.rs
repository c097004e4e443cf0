//! Plays a recording through the stages and keeps the ticks to be drawn, with their published forecasts.

use std::collections::BTreeSet;
use std::rc::Rc;

use console::failure::Failure;
use data::Recording;
use drawing::AgentDrawing;
use evaluator::{MOVING_MPS, Truth};
use metrics::{Displacement, Point};
use nn::ModelConfig;
use onboard::Chain;
use run::Run;
use scene::{ContextMap, State};
use source::Playback;
use thiserror::Error;
use wire::tick_view::{AgentView, ForecastView, TickView};
use wire::{Detection, WorldOrigin, detection_flags};

use crate::published::Published;

/// Maximum number of ticks whose agents are ranked, evenly spread.
const RANKED_MAX: u64 = 240;
/// Largest distance between a track without an identity and its truth.
const MATCH_MAX_M: f32 = 2.0;

/// The ticks of a recording to be drawn.
#[derive(Clone, Debug)]
pub enum Wanted {
    /// The tick nearest to each of these times, in seconds from the first tick.
    At(Vec<f64>),
    /// The tick in the middle of the recording.
    Middle,
    /// The ticks of this number of agents with the smallest errors, and of the same number with the largest
    /// errors.
    Extremes(usize),
}

/// A tick to be drawn.
#[derive(Clone, Debug)]
pub struct Shot {
    /// The tick's number.
    pub tick: u64,
    /// Time since the first tick.
    pub time_s: f64,
    /// The agents whose forecasts are drawn, by their identities in the recording.
    pub about: Vec<u64>,
    /// All agents; only those in `about` have a forecast.
    pub agents: Vec<AgentDrawing>,
    /// Mean errors over the agents with a forecast and a known future.
    pub errors: Option<ShotErrors>,
    /// The map of all agents' places up to this tick.
    pub visits: Option<ContextMap>,
}

/// Errors of a shot's forecasts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShotErrors {
    /// Number of agents.
    pub agents: usize,
    /// Modes per forecast.
    pub modes: usize,
    /// ADE and FDE of the single best forecast.
    pub best: [f64; 2],
    /// Smallest ADE and FDE of all modes, each chosen in hindsight.
    pub hindsight: [f64; 2],
}

/// A time or an agent that can't be drawn.
#[derive(Debug, Error, PartialEq)]
pub enum GalleryError {
    /// No tick has an agent.
    #[error("no agent is tracked in this recording")]
    NoAgents,
    /// The time is outside the recording.
    #[error("no tick at {time_s} s: the ticks are from 0 s to {last_s} s")]
    Outside {
        /// The requested time.
        time_s: f64,
        /// Time of the last tick.
        last_s: f64,
    },
    /// The agent has no forecast at this time.
    #[error("agent {agent} has no forecast at {time_s} s, tick {tick}; agents with a forecast: {able}")]
    Agent {
        /// The requested agent.
        agent: u64,
        /// The time of the tick.
        time_s: f64,
        /// The tick.
        tick: u64,
        /// The agents that have a forecast.
        able: String,
    },
    /// No agent can be ranked.
    #[error("no agent moves and is seen over a whole horizon")]
    NothingToRank,
}

/// The original recording, for the truth and the map.
#[derive(Default)]
struct Past {
    truth: Truth,
    first_ns: i64,
}

/// The error of an agent's forecast in a tick.
struct Ranked {
    ade_m: f64,
    agent: u64,
    view: Rc<TickView>,
}

/// Plays a recording and returns the wanted ticks. They show the forecasts of `agents`, by their identities
/// in the recording, or of all if none are given.
///
/// # Errors
/// [`Failure`] if the stages can't be set up; [`GalleryError`], as [`Failure::Data`], if a tick or an agent
/// can't be drawn.
pub fn shots(
    mut playback: Playback,
    (run, model): (&Run, &ModelConfig),
    wanted: &Wanted,
    agents: &[u64],
) -> Result<Vec<Shot>, Failure> {
    let recording = playback.recording();
    let past = Past::of_recording(recording);
    let last_ns = recording.frames.last().map_or(0, |frame| frame.stamp_ns);
    let (interval_ns, tick_count) = (playback.interval_ns(), playback.tick_count());
    let mut search = Search::new(&past, wanted, (last_ns, interval_ns, tick_count))?;
    let mut chain = Chain::new(run, model)?;
    while let Some(tick) = playback.next_tick() {
        chain.tick(&tick.header, tick.detections, |_| ());
        let (tracks, forecasts) = chain.frames();
        if tracks.is_void() {
            continue;
        }
        let view = || TickView::new(tracks.parts(), forecasts.parts());
        if !search.offer(tick.header.seq, tick.header.stamp_ns, view) {
            break;
        }
    }
    search.shots(agents)
}

/// Returns the wanted ticks of a run that has ended, as it has published them. What happened after a forecast
/// is the agent's later track.
///
/// # Errors
/// As [`shots`], and if the file can't be read.
pub fn published_shots(
    published: &Published,
    origin: WorldOrigin,
    wanted: &Wanted,
    agents: &[u64],
) -> Result<Vec<Shot>, Failure> {
    let (mut past, mut tick_count, mut span_ns) = (Past::default(), 0, None);
    published.each(origin, |view| {
        let [first_ns, _] = *span_ns.get_or_insert([view.stamp_ns; 2]);
        span_ns = Some([first_ns, view.stamp_ns]);
        tick_count += 1;
        past.add(&view);
    })?;
    let [first_ns, last_ns] = span_ns.ok_or_else(|| Failure::data(GalleryError::NoAgents))?;
    past.first_ns = first_ns;
    let interval_ns = last_ns.abs_diff(first_ns) / (tick_count - 1).max(1);
    let mut search = Search::new(&past, wanted, (last_ns, interval_ns, tick_count))?;
    published.each(origin, |view| {
        search.offer(view.seq, view.stamp_ns, || view);
    })?;
    search.shots(agents)
}

/// Searches the ticks of a run for the wanted ones.
struct Search<'a> {
    past: &'a Past,
    wanted: &'a Wanted,
    times_s: Vec<f64>,
    /// One tick in this many is ranked.
    spacing: u64,
    /// For each time, the nearest tick so far and its distance.
    nearest: Vec<Option<(f64, Rc<TickView>)>>,
    ranked: Vec<Ranked>,
}

impl<'a> Search<'a> {
    /// Begins a search in a run with this last stamp, interval and number of ticks.
    fn new(
        past: &'a Past,
        wanted: &'a Wanted,
        (last_ns, interval_ns, tick_count): (i64, u64, u64),
    ) -> Result<Self, Failure> {
        let last_s = past.time_s(last_ns);
        let half_s = 0.5 * interval_ns as f64 / 1e9;
        let times_s = match wanted {
            Wanted::At(times_s) => times_s.clone(),
            Wanted::Middle => vec![0.5 * last_s],
            Wanted::Extremes(_) => Vec::new(),
        };
        let is_inside = |time_s: &f64| (-half_s..=last_s + half_s).contains(time_s);
        if let Some(&time_s) = times_s.iter().find(|time_s| !is_inside(time_s)) {
            return Err(Failure::data(GalleryError::Outside { time_s, last_s }));
        }
        let (nearest, spacing) = (vec![None; times_s.len()], tick_count.div_ceil(RANKED_MAX).max(1));
        Ok(Self { past, wanted, times_s, spacing, nearest, ranked: Vec::new() })
    }

    /// Takes a tick. Returns false if all wanted ticks have passed.
    fn offer(&mut self, seq: u64, stamp_ns: i64, view: impl FnOnce() -> TickView) -> bool {
        let time_s = self.past.time_s(stamp_ns);
        let apart_s = |number: usize| (time_s - self.times_s[number]).abs();
        let is_nearer = |number: &usize| {
            self.nearest[*number].as_ref().is_none_or(|(least_s, _)| apart_s(*number) < *least_s)
        };
        let nearer: Vec<usize> = (0..self.times_s.len()).filter(is_nearer).collect();
        let ranks = matches!(self.wanted, Wanted::Extremes(_)) && seq.is_multiple_of(self.spacing);
        if nearer.is_empty() && !ranks {
            let end_s = self.times_s.iter().copied().fold(f64::MIN, f64::max);
            return self.times_s.is_empty() || time_s <= end_s;
        }
        let view = Rc::new(view());
        for number in nearer {
            self.nearest[number] = Some(((time_s - self.times_s[number]).abs(), Rc::clone(&view)));
        }
        if ranks {
            self.ranked.extend(self.past.rank(&view));
        }
        true
    }

    fn shots(self, agents: &[u64]) -> Result<Vec<Shot>, Failure> {
        let shots: Result<Vec<Shot>, GalleryError> = match self.wanted {
            Wanted::Extremes(count) => self.past.extremes(self.ranked, *count),
            Wanted::At(_) | Wanted::Middle => self
                .nearest
                .into_iter()
                .map(|found| self.past.shot(&found.ok_or(GalleryError::NoAgents)?.1, agents))
                .collect(),
        };
        let shots = shots.map_err(Failure::data)?;
        if shots.iter().all(|shot| shot.agents.is_empty()) {
            return Err(Failure::data(GalleryError::NoAgents));
        }
        Ok(shots)
    }
}

impl Past {
    fn of_recording(recording: &Recording) -> Self {
        let truth = match recording.frames.iter().any(|frame| !frame.truth.is_empty()) {
            true => Truth::of(&of_truth(recording)),
            false => Truth::of(recording),
        };
        Self { truth, first_ns: recording.frames.first().map_or(0, |frame| frame.stamp_ns) }
    }

    /// Adds the tracks of a tick that a run has published.
    fn add(&mut self, view: &TickView) {
        for agent in view.agents.iter().filter(|agent| agent.unseen_ns == 0) {
            let AgentView { position_m, velocity_mps, heading_rad, .. } = *agent;
            let state = State { position_m, velocity_mps, heading_rad };
            self.truth.add(agent.known_as(), view.stamp_ns, state);
        }
    }

    fn time_s(&self, stamp_ns: i64) -> f64 {
        (stamp_ns - self.first_ns) as f64 / 1e9
    }

    /// The recorded positions of an agent at the steps of its forecast.
    fn truth(&self, view: &TickView, agent: &AgentView, forecast: &ForecastView) -> Vec<Option<Point>> {
        let apart_m = |id: u64| {
            let [x_m, y_m] = self.truth.state(id, view.stamp_ns)?.position_m;
            let apart_m = (x_m - agent.position_m[0]).hypot(y_m - agent.position_m[1]);
            (apart_m <= MATCH_MAX_M).then_some(apart_m)
        };
        let ids = || self.truth.tracks().map(|track| track.id);
        let nearest = || {
            let near = ids().filter_map(|id| Some((apart_m(id)?, id)));
            near.min_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, id)| id)
        };
        let known = ids().find(|id| *id == agent.source_id && *id != 0);
        let Some(id) = known.or_else(nearest) else { return Vec::new() };
        self.truth.positions(id, view.stamp_ns, view.step_ns as f64, forecast.best.len())
    }

    fn shot(&self, view: &TickView, wanted: &[u64]) -> Result<Shot, GalleryError> {
        let time_s = self.time_s(view.stamp_ns);
        let able = || view.agents.iter().filter(|agent| agent.forecast.is_some()).map(AgentView::known_as);
        if let Some(&agent) = wanted.iter().find(|wanted| !able().any(|able| able == **wanted)) {
            let able = able().map(|able| able.to_string()).collect::<Vec<_>>().join(", ");
            return Err(GalleryError::Agent { agent, time_s, tick: view.seq, able });
        }
        let agents: Vec<AgentDrawing> = view
            .agents
            .iter()
            .map(|agent| {
                let mut agent = agent.clone();
                if !wanted.is_empty() && !wanted.contains(&agent.known_as()) {
                    agent.forecast = None;
                }
                let truth = agent.forecast.as_ref().map(|forecast| self.truth(view, &agent, forecast));
                AgentDrawing { truth: truth.unwrap_or_default(), agent }
            })
            .collect();
        let about = agents.iter().filter(|drawing| drawing.agent.forecast.is_some());
        Ok(Shot {
            tick: view.seq,
            time_s,
            about: about.map(|drawing| drawing.agent.known_as()).collect(),
            errors: ShotErrors::of(&agents),
            agents,
            visits: self.visits(view.stamp_ns),
        })
    }

    /// The errors of all agents that keep moving and are present over the whole horizon.
    fn rank(&self, view: &Rc<TickView>) -> Vec<Ranked> {
        let rank = |agent: &AgentView| {
            let forecast = agent.forecast.as_ref()?;
            let truth = self.truth(view, agent, forecast);
            let end_m = truth.iter().all(Option::is_some).then(|| truth.last().copied().flatten())??;
            let [vx_mps, vy_mps] = agent.velocity_mps;
            let way_m = (end_m[0] - agent.position_m[0]).hypot(end_m[1] - agent.position_m[1]);
            let horizon_s = view.step_ns as f32 * 1e-9 * truth.len() as f32;
            let moves = vx_mps.hypot(vy_mps) >= MOVING_MPS && way_m >= MOVING_MPS * horizon_s;
            let ade_m = metrics::displacement(&forecast.best, &truth).ade_m.filter(|_| moves)?;
            Some(Ranked { ade_m, agent: agent.known_as(), view: Rc::clone(view) })
        };
        view.agents.iter().filter_map(rank).collect()
    }

    /// The best shots, then the worst. No agent is shown twice.
    fn extremes(&self, mut ranked: Vec<Ranked>, count: usize) -> Result<Vec<Shot>, GalleryError> {
        if ranked.is_empty() {
            return Err(GalleryError::NothingToRank);
        }
        ranked.sort_by(|a, b| a.ade_m.total_cmp(&b.ade_m));
        let mut shown = BTreeSet::new();
        let mut take = |ranked: &mut dyn Iterator<Item = &Ranked>| -> Result<Vec<Shot>, GalleryError> {
            let fresh = ranked.filter(|entry| shown.insert(entry.agent)).take(count);
            fresh.map(|entry| self.shot(&entry.view, &[entry.agent])).collect()
        };
        let best = take(&mut ranked.iter())?;
        let worst = take(&mut ranked.iter().rev())?;
        Ok([best, worst].concat())
    }

    /// The map of all places where agents were detected up to this time.
    fn visits(&self, stamp_ns: i64) -> Option<ContextMap> {
        let states: Vec<State> = self
            .truth
            .tracks()
            .flat_map(|track| track.states.iter().take_while(|(seen_ns, _)| *seen_ns <= stamp_ns))
            .map(|(_, state)| *state)
            .collect();
        ContextMap::of_visits(&states)
    }
}

/// The recording's truth, as detections with identities.
fn of_truth(recording: &Recording) -> Recording {
    let mut of_truth = recording.clone();
    for frame in &mut of_truth.frames {
        let detections = frame.truth.iter().map(|agent| Detection {
            id: agent.id,
            agent_type: agent.agent_type,
            x_m: agent.x_m,
            y_m: agent.y_m,
            offset_ns: agent.offset_ns,
            score: 1.0,
            flags: detection_flags::HAS_ID,
            ..Detection::default()
        });
        frame.detections = detections.collect();
    }
    of_truth
}

impl ShotErrors {
    fn of(agents: &[AgentDrawing]) -> Option<Self> {
        let pair = |errors: Displacement| Some([errors.ade_m?, errors.fde_m?]);
        let forecasts =
            agents.iter().filter_map(|drawing| Some((drawing.agent.forecast.as_ref()?, &drawing.truth)));
        let errors = |(forecast, truth): (&ForecastView, &Vec<Option<Point>>)| {
            let best = pair(metrics::displacement(&forecast.best, truth))?;
            Some([best, pair(metrics::min_displacement(&forecast.modes, truth))?])
        };
        let modes = forecasts.clone().map(|(forecast, _)| forecast.modes.len()).max().unwrap_or(0);
        let errors: Vec<[[f64; 2]; 2]> = forecasts.filter_map(errors).collect();
        let mean = |which: usize| {
            [0, 1].map(|entry| errors.iter().map(|of| of[which][entry]).sum::<f64>() / errors.len() as f64)
        };
        (!errors.is_empty()).then(|| Self { agents: errors.len(), modes, best: mean(0), hindsight: mean(1) })
    }
}

#[cfg(test)]
mod tests;
