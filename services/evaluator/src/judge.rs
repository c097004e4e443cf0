//! The judge: forecasts every agent that counts in a recording's scenes and sums up how far off it was.

use data::Recording;
use metrics::{Disc, Limits, Point, collisions, highest_density_level, kde_log_density};
use nn::ModelConfig;
use scene::{AgentType, Moment, PlaceMemory, Recall};
use wire::{CONTEXT_EMBEDDING, HORIZON_MAX};

use crate::baselines::{Baselines, Candidate};
use crate::forecaster::{Forecast, ForecasterMemory, Recalls};
use crate::maps::{ContextTable, MapInput};
use crate::{Agent, Forecaster, Method, Scene, Tally, motion, threads};

/// Speed from which on an agent counts as moving, at its last observed step.
pub const MOVING_MPS: f32 = 0.5;

/// Which of a scene's complete agents count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Subset {
    /// All.
    All,
    /// All where there are two or more, otherwise none: the rule of S-GAN.
    Company,
    /// Those that moved at their last observed step.
    Moving,
}

impl Subset {
    /// The name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Company => "2 or more",
            Self::Moving => "moving",
        }
    }

    /// Those of the complete agents that count.
    fn of(self, scene: &Scene, complete: &[usize]) -> Vec<usize> {
        let moves = |agent: &Agent| agent.newest().is_some_and(|state| state.speed_mps() >= MOVING_MPS);
        match self {
            Self::All => complete.to_vec(),
            Self::Company => {
                if complete.len() > 1 {
                    complete.to_vec()
                } else {
                    Vec::new()
                }
            }
            Self::Moving => complete.iter().copied().filter(|&agent| moves(&scene.agents[agent])).collect(),
        }
    }
}

/// What happened over a stretch of a recording as long as one window: the unit that intervals resample.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// A tally for each subset.
    pub tallies: Vec<Tally>,
}

/// What forecasts are judged by.
pub struct Judge<'a> {
    /// The model.
    pub forecaster: &'a Forecaster,
    /// The others.
    pub baselines: &'a Baselines,
    /// Numbers of steps up to which errors are summed, growing.
    pub horizons: &'a [usize],
    /// Which agents count.
    pub subsets: &'a [Subset],
    /// The type whose agents count; all types where it is `None`.
    pub of_type: Option<AgentType>,
    /// Threads that share the scenes; results do not depend on it.
    pub threads: usize,
}

/// Scenes that are forecast before the memory of the place goes on.
const TOGETHER: usize = 128;

/// The memories of a place that take part.
struct Memories<'a> {
    /// Of what the recording itself showed.
    fresh: Option<PlaceMemory>,
    /// Of what earlier recordings showed as well.
    visited: Option<&'a mut PlaceMemory>,
}

impl Memories<'_> {
    const fn are_none(&self) -> bool {
        self.fresh.is_none() && self.visited.is_none()
    }
}

/// An agent at a moment that can be remembered.
struct Departing {
    /// Its place in the scene.
    agent: usize,
    moment: Moment,
    /// The single best forecast.
    forecast: Vec<Point>,
}

/// What a memory tells of all agents of a scene, which it then takes in, with those who depart; nothing without a memory.
fn recall(memory: Option<&mut PlaceMemory>, scene: &Scene, departing: &[Departing]) -> Vec<Recall> {
    let Some(memory) = memory else { return Vec::new() };
    let mut recalls = vec![Recall::default(); scene.agents.len()];
    memory.advance(scene.stamp_ns);
    for agent in &scene.agents {
        agent.newest().iter().for_each(|now| memory.observe(agent.id, now.position_m));
    }
    for Departing { agent, moment, forecast } in departing {
        let id = scene.agents[*agent].id;
        memory.recall(id, moment, &mut recalls[*agent]);
        memory.remember(id, moment, forecast, &recalls[*agent]);
    }
    recalls
}

/// A scene with the agents that are forecast.
struct Case<'a> {
    scene: &'a Scene,
    complete: Vec<usize>,
    recalls: Recalls,
}

impl Judge<'_> {
    /// Judges a recording's scenes that have an agent to count, block by block.
    #[must_use]
    pub fn recording(&self, recording: &Recording, scenes: &[Scene], map: MapInput<'_>) -> Vec<Block> {
        self.revisit(recording, scenes, map, None)
    }

    /// As [`Judge::recording`], and besides with a memory of the place, which goes on; it is to have left whatever it saw before.
    #[must_use]
    pub fn revisit(
        &self,
        recording: &Recording,
        scenes: &[Scene],
        map: MapInput<'_>,
        visited: Option<&mut PlaceMemory>,
    ) -> Vec<Block> {
        let table = ContextTable::new(self.forecaster, recording, scenes, map, self.threads);
        let config = self.forecaster.config();
        let mut memories = Memories { fresh: self.memory(), visited };
        let parts = scenes.chunks(TOGETHER).flat_map(|scenes| self.part(scenes, &table, &mut memories));
        let block_ns = config.step_ns() as i64 * (config.history_len + config.horizon_len) as i64;
        let mut blocks: Vec<(i64, Block)> = Vec::new();
        for (stamp_ns, tallies) in parts {
            let number = stamp_ns.div_euclid(block_ns);
            match blocks.last_mut().filter(|(last, _)| *last == number) {
                Some((_, block)) => {
                    block.tallies.iter_mut().zip(&tallies).for_each(|(sum, tally)| sum.merge(tally));
                }
                None => blocks.push((number, Block { tallies })),
            }
        }
        blocks.into_iter().map(|(_, block)| block).collect()
    }

    /// A memory of nothing; none for a model that forecasts farther than the pipeline can carry: it recalls nothing.
    #[must_use]
    pub fn memory(&self) -> Option<PlaceMemory> {
        let config = self.forecaster.config();
        (config.horizon_len <= HORIZON_MAX).then(|| PlaceMemory::new(config.horizon_len, config.step_ns()))
    }

    /// Lets a memory take in a recording, as the forecaster would have forecast it, and leave.
    pub fn visit(
        &self,
        recording: &Recording,
        scenes: &[Scene],
        map: MapInput<'_>,
        memory: &mut PlaceMemory,
    ) {
        let table = ContextTable::new(self.forecaster, recording, scenes, map, self.threads);
        let mut memories = Memories { fresh: None, visited: Some(memory) };
        for scenes in scenes.chunks(TOGETHER) {
            self.recalls(scenes, &table, &mut memories);
        }
        memory.leave();
    }

    /// The tallies of the scenes, with their stamps, that have an agent to count.
    fn part(
        &self,
        scenes: &[Scene],
        table: &ContextTable,
        memories: &mut Memories<'_>,
    ) -> Vec<(i64, Vec<Tally>)> {
        let mut recalls = self.recalls(scenes, table, memories);
        let cases = scenes.iter().zip(&mut recalls).map(|(scene, recalls)| {
            let complete = self.complete(scene);
            let recalls = recalls.take(&complete);
            Case { scene, complete, recalls }
        });
        let cases: Vec<Case<'_>> = cases.filter(|case| !case.complete.is_empty()).collect();
        let tallies = threads::each(&cases, self.threads, |case, memory| self.scene(case, table, memory));
        cases.iter().map(|case| case.scene.stamp_ns).zip(tallies).collect()
    }

    /// What memories of the place tell of each agent of each scene: of all who are there, whether they count or not, as far as
    /// they had gone at the scene's time.
    fn recalls(&self, scenes: &[Scene], table: &ContextTable, memories: &mut Memories<'_>) -> Vec<Recalls> {
        if memories.are_none() {
            return vec![Recalls::default(); scenes.len()];
        }
        let config = self.forecaster.config();
        let departing = |scene: &Scene, memory: &mut ForecasterMemory| {
            let present = |&agent: &usize| scene.agents[agent].newest().is_some();
            let wanted: Vec<usize> = (0..scene.agents.len()).filter(present).collect();
            let context = |agent: usize, step: usize| self.context(scene, table, (agent, step));
            let forecasts = self.forecaster.forecast(scene, context, &wanted, memory);
            let departing = |(agent, forecast): (usize, Forecast)| {
                let moment = motion::moment(&scene.agents[agent], config)?;
                Some(Departing { agent, moment, forecast: forecast.best })
            };
            wanted.into_iter().zip(forecasts).filter_map(departing).collect::<Vec<_>>()
        };
        let departing = threads::each(scenes, self.threads, departing);
        let of_scene = |(scene, departing): (&Scene, &Vec<Departing>)| Recalls {
            recalled: recall(memories.fresh.as_mut(), scene, departing),
            revisited: recall(memories.visited.as_deref_mut(), scene, departing),
        };
        scenes.iter().zip(&departing).map(of_scene).collect()
    }

    fn context(
        &self,
        scene: &Scene,
        table: &ContextTable,
        (agent, step): (usize, usize),
    ) -> [f32; CONTEXT_EMBEDDING] {
        let config = self.forecaster.config();
        let back = (config.history_len - 1 - step) as i64;
        table.of(scene.agents[agent].id, scene.stamp_ns - back * config.step_ns() as i64)
    }

    /// Places of the agents that can count.
    fn complete(&self, scene: &Scene) -> Vec<usize> {
        let is_of_type =
            |&place: &usize| self.of_type.is_none_or(|of_type| scene.agents[place].agent_type == of_type);
        scene.complete().into_iter().filter(is_of_type).collect()
    }

    /// A tally of the scene for each subset.
    fn scene(&self, case: &Case<'_>, table: &ContextTable, memory: &mut ForecasterMemory) -> Vec<Tally> {
        let Case { scene, complete, recalls } = case;
        let context = |agent: usize, step: usize| self.context(scene, table, (agent, step));
        let forecasts = self.forecaster.recall(scene, context, (complete, recalls), memory);
        let judged: Vec<Judged<'_>> = complete
            .iter()
            .zip(&forecasts)
            .map(|(&place, forecast)| self.agent(scene, &scene.agents[place], forecast))
            .collect();
        let tally = |subset: &Subset| {
            let members = subset.of(scene, complete);
            let members: Vec<&Judged<'_>> = complete
                .iter()
                .zip(&judged)
                .filter(|(place, _)| members.contains(place))
                .map(|(_, j)| j)
                .collect();
            self.together(scene, &members)
        };
        self.subsets.iter().map(tally).collect()
    }

    /// The sums of some agents of a scene. Its futures are made for all who are there, whether they stay or not.
    fn together(&self, scene: &Scene, members: &[&Judged<'_>]) -> Tally {
        let mut tally = Tally::new(self.horizons.len());
        if members.is_empty() {
            return tally;
        }
        members.iter().for_each(|judged| tally.merge(&judged.tally));
        let candidates: Vec<_> = members.iter().map(|judged| (judged.agent, &judged.candidates)).collect();
        let present = scene.agents.iter().filter(|agent| agent.newest().is_some()).count();
        tally.add_scene(&candidates, present, self.horizons);
        let discs = |of: &dyn Fn(&Judged<'_>) -> Vec<Point>| {
            let trajectories: Vec<Vec<Point>> = members.iter().map(|judged| of(judged)).collect();
            let discs: Vec<Disc<'_>> = members
                .iter()
                .zip(&trajectories)
                .map(|(judged, trajectory)| Disc { trajectory, radius_m: radius_m(judged.agent.agent_type) })
                .collect();
            collisions(&discs)
        };
        let single = |judged: &Judged<'_>| {
            judged.candidates[Method::Network.index()].single.clone().unwrap_or_default()
        };
        tally.collided = discs(&single);
        tally.truly_collided = discs(&|judged| judged.agent.future.iter().copied().flatten().collect());
        tally
    }

    fn agent<'b>(&self, scene: &Scene, agent: &'b Agent, forecast: &Forecast) -> Judged<'b> {
        let candidates = self.baselines.candidates(scene, agent, forecast);
        let mut tally = Tally::new(self.horizons.len());
        tally.add_agent(agent, &candidates, self.horizons);
        self.add_sureness(scene, agent, forecast, &mut tally);
        if let Some(now) = agent.newest() {
            let config = self.forecaster.config();
            let limits = limits(agent, config);
            let dt_s = config.dt_s as f32;
            for trajectory in forecast.modes.iter().chain([&forecast.best]) {
                tally.broken.add(limits.broken_by(&now, trajectory, dt_s));
            }
        }
        Judged { agent, candidates, tally }
    }

    fn add_sureness(&self, scene: &Scene, agent: &Agent, forecast: &Forecast, tally: &mut Tally) {
        let ModelConfig { modes: modes_len, .. } = *self.forecaster.config();
        let seed = agent.id.rotate_left(32) ^ scene.stamp_ns as u64;
        let mut first = 0;
        for (horizon, &steps) in self.horizons.iter().enumerate() {
            let sureness = tally.sureness_mut(horizon);
            for step in first..steps {
                let Some(truth) = agent.future[step] else { continue };
                let means: Vec<Point> = forecast.modes.iter().map(|mode| mode[step]).collect();
                let covariances: Vec<[f32; 3]> =
                    (0..modes_len).map(|mode| forecast.covariance[mode][step]).collect();
                let probability = &forecast.probability[..];
                sureness.kde_nll.add(-kde_log_density(&means, probability, truth));
                let level = highest_density_level(
                    &means,
                    &covariances,
                    probability,
                    truth,
                    seed ^ (step as u64) << 48,
                );
                sureness.covered_50.add(level <= 0.5);
                sureness.covered_90.add(level <= 0.9);
            }
            let truth = &agent.future[..steps];
            let misses = |errors: metrics::Displacement| errors.is_miss().unwrap_or_default();
            sureness.missed_best.add(misses(metrics::best_of(&forecast.modes, truth)));
            sureness.missed_single.add(misses(metrics::displacement(&forecast.best, truth)));
            first = steps;
        }
    }
}

/// An agent with what all methods made of it.
struct Judged<'a> {
    agent: &'a Agent,
    candidates: [Candidate; Method::ALL.len()],
    tally: Tally,
}

/// What an agent can physically do; of a vehicle as far as its length is known.
fn limits(agent: &Agent, config: &ModelConfig) -> Limits {
    match agent.agent_type {
        AgentType::Vehicle => {
            Limits::vehicle(config.rear_axle_ratio * agent.length_m.unwrap_or(config.default_length_m))
        }
        other => Limits::of(other),
    }
}

/// Half the width of an agent of a type: what it surely occupies.
const fn radius_m(agent_type: AgentType) -> f32 {
    match agent_type {
        AgentType::Vehicle => 0.9,
        AgentType::Cyclist => 0.3,
        AgentType::Pedestrian => 0.2,
    }
}

#[cfg(test)]
mod tests;
