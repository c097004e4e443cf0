//! Forecasts every counted agent in a recording's scenes and sums the errors.

use std::sync::Arc;

use data::Recording;
use lanes::LaneMap;
use metrics::{Disc, Limits, Point, collisions, highest_density_level, kde_log_density};
use nn::ModelConfig;
use retrieval::RetrievalMemory;
use scene::AgentType;

use super::{Baselines, Method, Rules, Tally};
use crate::forecaster::{Decoded, Forecaster, MapInput, Samplers, Session, TOGETHER, Variants};
use crate::lines::{Candidate, ForecastLine, text};
use crate::scenes::{Agent, MOVING_MPS, Scene};
use crate::threads;

/// Which of a scene's complete agents count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Subset {
    /// All.
    All,
    /// All if there are two or more, otherwise none: the rule of S-GAN.
    Company,
    /// Agents that move at their last observed step.
    Moving,
    /// Agents of a type.
    Of(AgentType),
}

impl Subset {
    /// The name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Company => "2 or more",
            Self::Moving => "moving",
            Self::Of(agent_type) => agent_type.name(),
        }
    }

    /// The counted agents among the complete ones.
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
            Self::Of(agent_type) => {
                let is_of_type = |agent: &usize| scene.agents[*agent].agent_type == agent_type;
                complete.iter().copied().filter(is_of_type).collect()
            }
        }
    }
}

/// The errors over one window's length of a recording. Intervals resample blocks.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// One tally per subset.
    pub tallies: Vec<Tally>,
}

/// An evaluation: the model, the baselines and the rules that select agents.
pub(crate) struct Judge<'a> {
    pub(crate) forecaster: &'a Forecaster,
    pub(crate) baselines: &'a Baselines,
    pub(crate) rules: Rules<'a>,
    /// The lanes of the site, which our forecasts follow.
    pub(crate) lanes: Option<Arc<LaneMap>>,
    /// Name of the part in the lines of forecasts.
    pub(crate) part: String,
}

impl Judge<'_> {
    /// Evaluates a recording's scenes block by block. With `visited`, there is another variant that is warm-started
    /// from this retrieval memory. The recording extends the memory, whose previous session must have ended.
    pub(crate) fn recording(
        &self,
        recording: &Recording,
        scenes: &[Scene],
        map: MapInput<'_>,
        visited: Option<&mut RetrievalMemory>,
    ) -> Vec<Block> {
        let config = self.forecaster.config();
        let mut session = Session::new(self.forecaster, recording, map, self.rules.threads);
        let mut samplers = Samplers::new(self.forecaster, visited.as_deref().cloned(), self.lanes.as_ref());
        let parts = scenes
            .chunks(TOGETHER)
            .flat_map(|scenes| self.part(recording, scenes, &mut session, &mut samplers));
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
        if let (Some(visited), Some(memory)) = (visited, samplers.memory()) {
            *visited = memory.clone();
        }
        blocks.into_iter().map(|(_, block)| block).collect()
    }

    /// The tallies of the scenes with counted agents, with the scenes' stamps.
    fn part(
        &self,
        recording: &Recording,
        scenes: &[Scene],
        session: &mut Session,
        samplers: &mut Samplers,
    ) -> Vec<(i64, Vec<Tally>)> {
        let decoded = session.decode(scenes, |scene| self.complete(scene));
        let forecasts = samplers.forecast(&decoded, self.rules.threads);
        let all = scenes.iter().zip(&decoded).zip(&forecasts);
        let cases: Vec<_> = all.filter(|(_, forecasts)| !forecasts.is_empty()).collect();
        let tally = |((scene, decoded), forecasts): &((&Scene, &Decoded), &Vec<(usize, Variants)>),
                     (): &mut ()| {
            let (mut tallies, lines) = self.scene(recording, scene, forecasts);
            let counting = tallies.iter_mut().filter(|tally| !tally.is_empty());
            counting.for_each(|tally| tally.crowding = decoded.crowding());
            (tallies, lines)
        };
        let made = threads::each(&cases, self.rules.threads, tally).into_iter();
        let tallies = made.map(|(tallies, lines)| {
            self.rules.lines.iter().for_each(|file| file.write(&lines));
            tallies
        });
        cases.iter().map(|((scene, _), _)| scene.stamp_ns).zip(tallies).collect()
    }

    /// Places of the complete agents of the evaluated type.
    fn complete(&self, scene: &Scene) -> Vec<usize> {
        let is_of_type = |&place: &usize| {
            self.rules.of_type.is_none_or(|of_type| scene.agents[place].agent_type == of_type)
        };
        scene.complete().into_iter().filter(is_of_type).collect()
    }

    /// One tally per subset, and the lines of the forecasts if they are written. `forecasts` has the agents'
    /// places in the scene.
    fn scene(
        &self,
        recording: &Recording,
        scene: &Scene,
        forecasts: &[(usize, Variants)],
    ) -> (Vec<Tally>, String) {
        let complete: Vec<usize> = forecasts.iter().map(|(place, _)| *place).collect();
        let judged =
            |(place, variants): &(usize, Variants)| self.agent(scene, &scene.agents[*place], variants);
        let judged: Vec<Judged<'_>> = forecasts.iter().map(judged).collect();
        let members: Vec<Vec<usize>> =
            self.rules.subsets.iter().map(|subset| subset.of(scene, &complete)).collect();
        let tally = |members: &Vec<usize>| {
            let members: Vec<&Judged<'_>> = complete
                .iter()
                .zip(&judged)
                .filter(|(place, _)| members.contains(place))
                .map(|(_, j)| j)
                .collect();
            self.together(scene, &members)
        };
        let tallies = members.iter().map(tally).collect();
        let line = |(place, judged): (&usize, &Judged<'_>)| {
            let counts =
                self.rules.subsets.iter().zip(&members).filter(|(_, members)| members.contains(place));
            self.line(recording, scene, judged, counts.map(|(subset, _)| subset.name()).collect())
        };
        let lines =
            self.rules.lines.iter().flat_map(|_| complete.iter().zip(&judged).map(line).collect::<Vec<_>>());
        (tallies, lines.collect())
    }

    fn line(
        &self,
        recording: &Recording,
        scene: &Scene,
        judged: &Judged<'_>,
        subsets: Vec<&'static str>,
    ) -> String {
        let Judged { agent, candidates, .. } = judged;
        let forecasts = Method::ALL.iter().map(|method| method.name()).zip(candidates);
        let line = ForecastLine {
            part: &self.part,
            recording: &recording.name,
            stamp_ns: scene.stamp_ns,
            agent: agent.id,
            agent_type: agent.agent_type.name(),
            speed_mps: agent.newest().map_or(f32::NAN, |state| state.speed_mps()),
            subsets,
            pixel_m: recording.pixel_m,
            truth_m: &agent.future,
            forecasts: forecasts.filter(|(_, forecast)| !forecast.is_empty()).collect(),
        };
        text(&line)
    }

    /// The sums of these agents of a scene. Joint futures depend on all agents that are present, complete or
    /// not.
    fn together(&self, scene: &Scene, members: &[&Judged<'_>]) -> Tally {
        let mut tally = Tally::new(self.rules.horizons.len());
        if members.is_empty() {
            return tally;
        }
        members.iter().for_each(|judged| tally.merge(&judged.tally));
        let candidates: Vec<_> = members.iter().map(|judged| (judged.agent, &judged.candidates)).collect();
        let present = scene.agents.iter().filter(|agent| agent.newest().is_some()).count();
        tally.add_scene(&candidates, present, self.rules.horizons);
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

    fn agent<'b>(&self, scene: &Scene, agent: &'b Agent, forecast: &Variants) -> Judged<'b> {
        let candidates = self.baselines.candidates(scene, agent, forecast);
        let mut tally = Tally::new(self.rules.horizons.len());
        tally.add_agent(agent, &candidates, self.rules.horizons);
        for (ours, of_method) in candidates.iter().take(Method::OURS.len()).enumerate() {
            let (Some(probability), Some(best)) = (&of_method.probability, &of_method.single) else {
                continue;
            };
            self.add_calibration(scene, agent, (of_method, probability, best), ours, &mut tally);
            let Some(now) = agent.newest() else { continue };
            let config = self.forecaster.config();
            let (limits, dt_s) = (limits(agent, config), config.dt_s as f32);
            for trajectory in of_method.modes.iter().map(Vec::as_slice).chain([&best[..]]) {
                tally.broken[ours].add(limits.violated_by(&now, trajectory, dt_s));
            }
        }
        Judged { agent, candidates, tally }
    }

    /// `ours` is the index of the method in [`Method::OURS`].
    fn add_calibration(
        &self,
        scene: &Scene,
        agent: &Agent,
        (forecast, probability, best): (&Candidate, &[f32], &[Point]),
        ours: usize,
        tally: &mut Tally,
    ) {
        let seed = agent.id.rotate_left(32) ^ scene.stamp_ns as u64;
        let mut first = 0;
        for (horizon, &steps) in self.rules.horizons.iter().enumerate() {
            let calibration = tally.calibration_mut(ours, horizon);
            for step in first..steps {
                let Some(truth) = agent.future[step] else { continue };
                let means: Vec<Point> = forecast.modes.iter().map(|mode| mode[step]).collect();
                let covariances: Vec<[f32; 3]> =
                    forecast.covariance.iter().map(|covariance| covariance[step]).collect();
                calibration.kde_nll.add(-kde_log_density(&means, probability, truth));
                let level = highest_density_level(
                    &means,
                    &covariances,
                    probability,
                    truth,
                    seed ^ (step as u64) << 48,
                );
                calibration.covered_50.add(level <= 0.5);
                calibration.covered_90.add(level <= 0.9);
            }
            let truth = &agent.future[..steps];
            let misses = |errors: metrics::Displacement| errors.is_miss().unwrap_or_default();
            calibration.missed_best.add(misses(metrics::min_displacement(&forecast.modes, truth)));
            calibration.missed_single.add(misses(metrics::displacement(best, truth)));
            first = steps;
        }
    }
}

/// An agent with the forecasts and errors of all methods.
struct Judged<'a> {
    agent: &'a Agent,
    candidates: [Candidate; Method::ALL.len()],
    tally: Tally,
}

/// Physical limits of an agent. A vehicle of unknown length has the default length.
fn limits(agent: &Agent, config: &ModelConfig) -> Limits {
    match agent.agent_type {
        AgentType::Vehicle => {
            Limits::vehicle(config.rear_axle_ratio * agent.length_m.unwrap_or(config.default_length_m))
        }
        other => Limits::of(other),
    }
}

/// Half the width that an agent of a type certainly occupies.
const fn radius_m(agent_type: AgentType) -> f32 {
    match agent_type {
        AgentType::Vehicle => 0.9,
        AgentType::Cyclist => 0.3,
        AgentType::Pedestrian => 0.2,
    }
}

#[cfg(test)]
mod tests;
