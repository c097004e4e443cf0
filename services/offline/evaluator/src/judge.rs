//! The judge: forecasts every agent that counts in a recording's scenes and sums up how far off it was.

use data::Recording;
use metrics::{Disc, Limits, Point, collisions, highest_density_level, kde_log_density};
use nn::ModelConfig;
use retrieval::{RetrievalMemory, Retrieved};
use scene::AgentType;

use crate::baselines::{Baselines, Candidate};
use crate::forecaster::{Forecast, Paths, Recalled};
use crate::maps::{ContextTable, MapInput};
use crate::speaker::{Speaker, Spoken, TOGETHER, recall};
use crate::{Agent, Forecaster, Method, Scene, Tally, threads};

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

/// The memories of a place that take part.
struct Memories<'a> {
    /// Of what the recording itself showed.
    fresh: Option<RetrievalMemory>,
    /// Of what earlier recordings showed as well.
    visited: Option<&'a mut RetrievalMemory>,
}

/// What memories tell of an agent: of what the recording showed, and of that and what earlier ones showed.
type Recalls = [Option<Retrieved>; 2];

/// A scene with its agents and what is remembered for them.
struct Case<'a> {
    scene: &'a Scene,
    complete: Vec<usize>,
    spoken: Vec<(Spoken, Recalls)>,
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
        visited: Option<&mut RetrievalMemory>,
    ) -> Vec<Block> {
        let table = ContextTable::new(self.forecaster, recording, scenes, map, self.threads);
        let config = self.forecaster.config();
        let mut memories = Memories { fresh: self.speaker().memory(), visited };
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

    /// The model over whole recordings.
    pub(crate) const fn speaker(&self) -> Speaker<'_> {
        Speaker { forecaster: self.forecaster, threads: self.threads }
    }

    /// The tallies of the scenes, with their stamps, that have an agent to count.
    fn part(
        &self,
        scenes: &[Scene],
        table: &ContextTable,
        memories: &mut Memories<'_>,
    ) -> Vec<(i64, Vec<Tally>)> {
        let spoken = self.speaker().spoken(scenes, table);
        let recalls = self.recalls(scenes, &spoken, memories);
        let cases = scenes.iter().zip(spoken.into_iter().zip(recalls)).map(|(scene, (spoken, recalls))| {
            let complete = self.complete(scene);
            let counts = |(spoken, _): &(Spoken, Recalls)| complete.contains(&spoken.place);
            let spoken = spoken.into_iter().zip(recalls).filter(counts).collect();
            Case { scene, complete, spoken }
        });
        let cases: Vec<Case<'_>> = cases.filter(|case| !case.complete.is_empty()).collect();
        let tallies = threads::each(&cases, self.threads, |case, (): &mut ()| self.scene(case));
        cases.iter().map(|case| case.scene.stamp_ns).zip(tallies).collect()
    }

    /// What memories of the place tell of each agent of each scene, as far as all had gone at the scene's time.
    fn recalls(
        &self,
        scenes: &[Scene],
        spoken: &[Vec<Spoken>],
        memories: &mut Memories<'_>,
    ) -> Vec<Vec<Recalls>> {
        let of_scene = |(scene, spoken): (&Scene, &Vec<Spoken>)| {
            let fresh = recall(memories.fresh.as_mut(), scene, spoken);
            let visited = recall(memories.visited.as_deref_mut(), scene, spoken);
            fresh.into_iter().zip(visited).map(Recalls::from).collect()
        };
        scenes.iter().zip(spoken).map(of_scene).collect()
    }

    /// Places of the agents that can count.
    fn complete(&self, scene: &Scene) -> Vec<usize> {
        let is_of_type =
            |&place: &usize| self.of_type.is_none_or(|of_type| scene.agents[place].agent_type == of_type);
        scene.complete().into_iter().filter(is_of_type).collect()
    }

    /// A tally of the scene for each subset.
    fn scene(&self, case: &Case<'_>) -> Vec<Tally> {
        let Case { scene, complete, spoken } = case;
        let judged = |(Spoken { place, said, .. }, recalls): &(Spoken, Recalls)| {
            let agent = &scene.agents[*place];
            let forecast = self.forecaster.lead(agent, said, recalls.each_ref().map(Option::as_ref));
            self.agent(scene, agent, &forecast)
        };
        let judged: Vec<Judged<'_>> = spoken.iter().map(judged).collect();
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
        for (ours, of_method) in Certain::all(forecast).into_iter().enumerate() {
            let Some(of_method) = of_method else { continue };
            self.add_sureness(scene, agent, &of_method, ours, &mut tally);
            let Some(now) = agent.newest() else { continue };
            let config = self.forecaster.config();
            let (limits, dt_s) = (limits(agent, config), config.dt_s as f32);
            for trajectory in of_method.modes.iter().map(Vec::as_slice).chain([of_method.best]) {
                tally.broken[ours].add(limits.violated_by(&now, trajectory, dt_s));
            }
        }
        Judged { agent, candidates, tally }
    }

    /// `ours` is the place of the method in [`Method::OURS`].
    fn add_sureness(
        &self,
        scene: &Scene,
        agent: &Agent,
        forecast: &Certain<'_>,
        ours: usize,
        tally: &mut Tally,
    ) {
        let seed = agent.id.rotate_left(32) ^ scene.stamp_ns as u64;
        let mut first = 0;
        for (horizon, &steps) in self.horizons.iter().enumerate() {
            let sureness = tally.sureness_mut(ours, horizon);
            for step in first..steps {
                let Some(truth) = agent.future[step] else { continue };
                let means: Vec<Point> = forecast.modes.iter().map(|mode| mode[step]).collect();
                let covariances: Vec<[f32; 3]> =
                    forecast.covariance.iter().map(|covariance| covariance[step]).collect();
                sureness.kde_nll.add(-kde_log_density(&means, forecast.probability, truth));
                let level = highest_density_level(
                    &means,
                    &covariances,
                    forecast.probability,
                    truth,
                    seed ^ (step as u64) << 48,
                );
                sureness.covered_50.add(level <= 0.5);
                sureness.covered_90.add(level <= 0.9);
            }
            let truth = &agent.future[..steps];
            let misses = |errors: metrics::Displacement| errors.is_miss().unwrap_or_default();
            sureness.missed_best.add(misses(metrics::min_displacement(forecast.modes, truth)));
            sureness.missed_single.add(misses(metrics::displacement(forecast.best, truth)));
            first = steps;
        }
    }
}

/// What a forecast of ours says, and how sure it is.
struct Certain<'a> {
    modes: &'a [Vec<Point>],
    covariance: &'a [Vec<[f32; 3]>],
    probability: &'a [f32],
    best: &'a [Point],
}

impl<'a> Certain<'a> {
    /// Those of [`Method::OURS`].
    fn all(forecast: &'a Forecast) -> [Option<Self>; Method::OURS.len()] {
        let Forecast { modes, covariance, probability, best, recalled, revisited, .. } = forecast;
        let with = |recalled: &'a Recalled| {
            let Recalled { paths: Paths { modes, best }, covariance, probability } = recalled;
            Self { modes, covariance, probability, best }
        };
        [
            Some(Self { modes, covariance, probability, best }),
            recalled.as_ref().map(with),
            revisited.as_ref().map(with),
        ]
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
