//! Forecasts every counted agent in a recording's scenes and sums the errors.

use std::sync::Arc;

use data::Recording;
use lanes::LaneMap;
use metrics::{Disc, Limits, Point, collisions, highest_density_level, kde_log_density};
use nn::ModelConfig;
use retrieval::RetrievalMemory;
use scene::AgentType;

use super::{Baselines, Method, Tally};
use crate::forecaster::{Decoded, Forecast, Forecaster, MapInput, Samplers, Session, TOGETHER, Variants};
use crate::lines::{Candidate, ForecastLine, ForecastLines, text};
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
pub struct Judge<'a> {
    /// The model.
    pub forecaster: &'a Forecaster,
    /// The baselines.
    pub baselines: &'a Baselines,
    /// Numbers of steps up to which errors are summed, in ascending order.
    pub horizons: &'a [usize],
    /// The subsets that are tallied.
    pub subsets: &'a [Subset],
    /// The type of the counted agents; `None` counts all types.
    pub of_type: Option<AgentType>,
    /// The lanes of the site, which our forecasts follow.
    pub lanes: Option<Arc<LaneMap>>,
    /// Threads that share the scenes; results do not depend on their number.
    pub threads: usize,
    /// Where all forecasts are written, and the name of their part.
    pub lines: Option<(&'a ForecastLines, String)>,
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
        let mut session = Session::new(self.forecaster, recording, map, self.threads);
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
        let forecasts = samplers.forecast(&decoded, self.threads);
        let all = scenes.iter().zip(&decoded).zip(&forecasts);
        let cases: Vec<_> = all.filter(|(_, forecasts)| !forecasts.is_empty()).collect();
        let tally = |((scene, decoded), forecasts): &((&Scene, &Decoded), &Vec<(usize, Variants)>),
                     (): &mut ()| {
            let (mut tallies, lines) = self.scene(recording, scene, forecasts);
            let counting = tallies.iter_mut().filter(|tally| !tally.is_empty());
            counting.for_each(|tally| tally.crowding = decoded.crowding());
            (tallies, lines)
        };
        let made = threads::each(&cases, self.threads, tally).into_iter();
        let tallies = made.map(|(tallies, lines)| {
            self.lines.iter().for_each(|(file, _)| file.write(&lines));
            tallies
        });
        cases.iter().map(|((scene, _), _)| scene.stamp_ns).zip(tallies).collect()
    }

    /// Places of the complete agents of the evaluated type.
    fn complete(&self, scene: &Scene) -> Vec<usize> {
        let is_of_type =
            |&place: &usize| self.of_type.is_none_or(|of_type| scene.agents[place].agent_type == of_type);
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
            self.subsets.iter().map(|subset| subset.of(scene, &complete)).collect();
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
        let line = |(place, judged): (&usize, &Judged<'_>), part: &str| {
            let counts = self.subsets.iter().zip(&members).filter(|(_, members)| members.contains(place));
            let subsets = counts.map(|(subset, _)| subset.name()).collect();
            self.line(recording, scene, judged, part, subsets)
        };
        let lines = self.lines.iter().flat_map(|(_, part)| {
            complete.iter().zip(&judged).map(|agent| line(agent, part)).collect::<Vec<_>>()
        });
        (tallies, lines.collect())
    }

    fn line(
        &self,
        recording: &Recording,
        scene: &Scene,
        judged: &Judged<'_>,
        part: &str,
        subsets: Vec<&'static str>,
    ) -> String {
        let Judged { agent, candidates, .. } = judged;
        let forecasts = Method::ALL.iter().map(|method| method.name()).zip(candidates);
        let line = ForecastLine {
            part,
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

    fn agent<'b>(&self, scene: &Scene, agent: &'b Agent, forecast: &Variants) -> Judged<'b> {
        let candidates = self.baselines.candidates(scene, agent, forecast);
        let mut tally = Tally::new(self.horizons.len());
        tally.add_agent(agent, &candidates, self.horizons);
        let others =
            [&forecast.retrieved, &forecast.warm_started, &forecast.with_evidence].map(Option::as_ref);
        let variants = std::iter::once(Some(&forecast.network)).chain(others);
        for (ours, of_method) in variants.enumerate() {
            let Some(of_method) = of_method else { continue };
            self.add_calibration(scene, agent, of_method, ours, &mut tally);
            let Some(now) = agent.newest() else { continue };
            let config = self.forecaster.config();
            let (limits, dt_s) = (limits(agent, config), config.dt_s as f32);
            for trajectory in of_method.modes.iter().map(Vec::as_slice).chain([&of_method.best[..]]) {
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
        forecast: &Forecast,
        ours: usize,
        tally: &mut Tally,
    ) {
        let seed = agent.id.rotate_left(32) ^ scene.stamp_ns as u64;
        let mut first = 0;
        for (horizon, &steps) in self.horizons.iter().enumerate() {
            let calibration = tally.calibration_mut(ours, horizon);
            for step in first..steps {
                let Some(truth) = agent.future[step] else { continue };
                let means: Vec<Point> = forecast.modes.iter().map(|mode| mode[step]).collect();
                let covariances: Vec<[f32; 3]> =
                    forecast.covariance.iter().map(|covariance| covariance[step]).collect();
                calibration.kde_nll.add(-kde_log_density(&means, &forecast.probability, truth));
                let level = highest_density_level(
                    &means,
                    &covariances,
                    &forecast.probability,
                    truth,
                    seed ^ (step as u64) << 48,
                );
                calibration.covered_50.add(level <= 0.5);
                calibration.covered_90.add(level <= 0.9);
            }
            let truth = &agent.future[..steps];
            let misses = |errors: metrics::Displacement| errors.is_miss().unwrap_or_default();
            calibration.missed_best.add(misses(metrics::min_displacement(&forecast.modes, truth)));
            calibration.missed_single.add(misses(metrics::displacement(&forecast.best, truth)));
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
