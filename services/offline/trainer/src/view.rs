//! Augmentation: which agents of a scene a batch shows, how much of their history, and with which
//! transformations.
//!
//! **In:** a recorded [`Scene`]. **Out:** a [`SceneView`] of the same window, with cut, mirrored, scaled,
//! differenced or noisy histories. Futures are mirrored and scaled in the same way.

use std::sync::Arc;

use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use scene::{State, agent_frame};

use crate::agent_view::{AgentView, SceneView};
use crate::options::TrainOptions;
use crate::samples::{Agent, MapView, Scene};

/// Standard deviations of the strongest noise: position (m), velocity (m/s), heading (rad).
const NOISE: (f32, f32, f32) = (0.04, 0.12, 0.01);
/// The same for a vehicle: the residual noise of filtered detections.
const VEHICLE_NOISE: (f32, f32, f32) = (0.1, 0.4, 0.03);
/// Speed below which an agent that moves less than [`STANDING_M`] counts as standing.
const STANDING_MPS: f32 = 0.3;
/// See [`STANDING_MPS`].
const STANDING_M: f32 = 0.5;
/// Speed from which a vehicle is fast. At a larger scale, roads with such speeds resemble a motorway.
const FAST_MPS: f32 = 9.0;
/// Largest scale of fast roads.
const FASTER_MAX: f32 = 2.5;

/// How a clip of consecutive scenes is shown; the same for all of them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clip {
    /// The agent in the middle.
    centre: u64,
    centre_m: [f32; 2],
    mirrored: bool,
    /// Factor on all lengths.
    scale: f32,
    /// Whether this factor makes a fast road faster.
    faster: bool,
    /// Whether motion is differenced from positions.
    differenced: bool,
}

impl Clip {
    /// Draws the view of scenes around a random agent. Scenes without vehicles are scaled, and mirrored half
    /// of the time: pedestrians keep to neither side of the road, and slow and fast pedestrians walk in the
    /// same way.
    pub(crate) fn draw(scenes: &[Scene], options: &TrainOptions, random: &mut impl Rng) -> Self {
        let counted: Vec<&Arc<Agent>> =
            scenes.iter().flat_map(|scene| &scene.agents).filter(|agent| agent.counts).collect();
        let centre = counted[random.random_range(0..counted.len())];
        let mut agents = scenes.iter().flat_map(|scene| &scene.agents);
        let free = agents.all(|agent| agent.agent_type != scene::AgentType::Vehicle);
        let mirrored = free && random.random_bool(0.5);
        let deviation: f32 = Distribution::<f32>::sample(&StandardNormal, random);
        let faster = !free && options.faster > 0.0 && is_fast(centre) && random.random_bool(options.faster);
        let scale = match (free, faster) {
            (true, _) => (deviation * options.scale_deviation as f32).exp(),
            (_, true) => faster_scale(random),
            _ => 1.0,
        };
        let differenced = random.random_bool(options.differenced_history);
        Self { centre: centre.id, centre_m: position_m(centre), mirrored, scale, faster, differenced }
    }

    /// Shows a scene: the agents around the middle, some with a shortened or noisy history.
    pub(crate) fn show<'a>(
        &self,
        scene: &Scene,
        map: Option<MapView<'a>>,
        options: &TrainOptions,
        random: &mut impl Rng,
    ) -> SceneView<'a> {
        let centre = scene.agents.iter().find(|agent| agent.id == self.centre);
        let agents = nearest(scene, centre.map_or(self.centre_m, position_m), options.scene_agents);
        let history_len = options.model.history_len;
        let agents = agents.into_iter().filter_map(|agent| {
            let shortened = random.random_bool(options.short_history);
            let len = if shortened { random.random_range(2..=history_len) } else { history_len };
            let mut view = shown(agent, len, self.mirrored)?;
            if self.differenced {
                view = differenced(view, options.model.dt_s);
            }
            if self.scale != 1.0 {
                view.scale(self.scale);
            }
            if random.random_bool(options.noisy_history) {
                view = noisy(view, random);
            }
            view.counts &= moves(&view) || random.random_bool(options.standing);
            Some(view)
        });
        // A map is not scaled, so a road that is shown faster has no map.
        let map = map.filter(|_| !self.faster);
        SceneView { agents: agents.collect(), map, mirrored: self.mirrored }
    }
}

/// Whether an agent is a fast vehicle.
pub(crate) fn is_fast(agent: &Agent) -> bool {
    let newest = agent.history.iter().rev().flatten().next();
    agent.agent_type == scene::AgentType::Vehicle && newest.is_some_and(|state| state.speed_mps() > FAST_MPS)
}

/// A random scale for a fast road.
pub(crate) fn faster_scale(random: &mut impl Rng) -> f32 {
    random.random_range(0.0..FASTER_MAX.ln()).exp()
}

/// Whether an agent moves at the end of its history or in its future.
fn moves(view: &AgentView) -> bool {
    let newest = view.history.last().copied().flatten().unwrap_or_default();
    let last = view.future.last().copied().flatten().unwrap_or(newest);
    let [x, y] = [0, 1].map(|axis| last.position_m[axis] - newest.position_m[axis]);
    newest.speed_mps() > STANDING_MPS || x.hypot(y) > STANDING_M
}

/// Shows a scene as recorded. A crowd is reduced to the `agents_max` agents nearest to the first counted one.
pub(crate) fn plain<'a>(scene: &Scene, map: Option<MapView<'a>>, agents_max: usize) -> SceneView<'a> {
    let centre_m = scene.agents.iter().find(|agent| agent.counts).map_or([0.0; 2], position_m);
    let agents = nearest(scene, centre_m, agents_max);
    let agents = agents.into_iter().filter_map(|agent| shown(agent, agent.history.len(), false));
    SceneView { agents: agents.collect(), map, mirrored: false }
}

/// An agent with its newest `history_len` states; `None` if it has none.
pub(crate) fn shown(agent: &Arc<Agent>, history_len: usize, mirrored: bool) -> Option<AgentView> {
    let mut history = agent.history_of(history_len);
    let mut future = agent.future.clone();
    if mirrored {
        history.iter_mut().chain(&mut future).flatten().for_each(mirror);
    }
    let frame = agent_frame(&history)?;
    Some(AgentView { agent: Arc::clone(agent), history, future, frame, counts: agent.counts })
}

/// The same agent as from a sensor that reports only positions.
pub(crate) fn differenced(mut view: AgentView, dt_s: f64) -> AgentView {
    let positions_m: Vec<_> = view.history.iter().map(|state| state.map(|state| state.position_m)).collect();
    scene::states_from_positions(&positions_m, positions_m.len(), dt_s as f32, &mut view.history);
    AgentView { frame: agent_frame(&view.history).unwrap_or(view.frame), ..view }
}

/// The same agent as from a noisy sensor. The strength is also random and rarely as large as [`NOISE`].
pub(crate) fn noisy(mut view: AgentView, random: &mut impl Rng) -> AgentView {
    let level = random.random::<f32>().powi(2);
    let is_vehicle = view.agent.agent_type == scene::AgentType::Vehicle;
    let (position_m, velocity_mps, heading_rad) = if is_vehicle { VEHICLE_NOISE } else { NOISE };
    for state in view.history.iter_mut().flatten() {
        let mut noise =
            |deviation: f32| level * deviation * Distribution::<f32>::sample(&StandardNormal, random);
        state.position_m = state.position_m.map(|value| value + noise(position_m));
        state.velocity_mps = state.velocity_mps.map(|value| value + noise(velocity_mps));
        state.heading_rad += noise(heading_rad);
    }
    AgentView { frame: agent_frame(&view.history).unwrap_or(view.frame), ..view }
}

impl AgentView {
    /// Multiplies all lengths about the world's origin.
    pub(crate) fn scale(&mut self, factor: f32) {
        for state in self.history.iter_mut().chain(&mut self.future).flatten() {
            state.position_m = state.position_m.map(|value| value * factor);
            state.velocity_mps = state.velocity_mps.map(|value| value * factor);
        }
        self.frame = agent_frame(&self.history).unwrap_or(self.frame);
    }
}

fn mirror(state: &mut State) {
    state.position_m[1] = -state.position_m[1];
    state.velocity_mps[1] = -state.velocity_mps[1];
    state.heading_rad = -state.heading_rad;
}

fn position_m(agent: &Arc<Agent>) -> [f32; 2] {
    agent.history.iter().rev().flatten().next().map_or([0.0; 2], |state| state.position_m)
}

/// The `len` agents nearest to a place, in the scene's order.
fn nearest(scene: &Scene, centre_m: [f32; 2], len: usize) -> Vec<&Arc<Agent>> {
    let distance = |agent: &Arc<Agent>| {
        let [x, y] = position_m(agent);
        (x - centre_m[0]).powi(2) + (y - centre_m[1]).powi(2)
    };
    let mut order: Vec<usize> = (0..scene.agents.len()).collect();
    order.sort_by(|&a, &b| distance(&scene.agents[a]).total_cmp(&distance(&scene.agents[b])));
    order.truncate(len);
    order.sort_unstable();
    order.into_iter().map(|agent| &scene.agents[agent]).collect()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    /// A vehicle at 2, 4, 7 and 11 m. Its recording always reports 3 m/s northward.
    fn vehicle() -> Arc<Agent> {
        let state = |x: f32| State { position_m: [x, 5.0], velocity_mps: [0.0, 3.0], heading_rad: 1.5 };
        Arc::new(Agent {
            id: 1,
            agent_type: scene::AgentType::Vehicle,
            length_m: None,
            history: [2.0, 4.0, 7.0, 11.0].map(|x| Some(state(x))).to_vec(),
            future: vec![Some(state(12.0))],
            patches: vec![None; 5],
            counts: true,
        })
    }

    #[test]
    fn differenced_motion_follows_the_shown_positions() {
        let view = differenced(shown(&vehicle(), 3, false).unwrap(), 0.5);
        let velocities: Vec<_> =
            view.history.iter().map(|state| state.map(|state| state.velocity_mps)).collect();
        assert_eq!(velocities, [None, Some([6.0, 0.0]), Some([6.0, 0.0]), Some([8.0, 0.0])]);
        let newest = view.history[3].unwrap();
        assert_eq!((newest.position_m, newest.heading_rad), ([11.0, 5.0], 0.0));
        assert_eq!(view.frame, agent_frame(&view.history).unwrap());
        assert_eq!(view.future, vehicle().future);
    }

    #[test]
    fn clips_have_the_requested_share_of_differenced_motion() {
        let scene = Scene { agents: vec![vehicle()] };
        let differenced_of = |share: f64| {
            let mut options = TrainOptions { differenced_history: share, ..TrainOptions::default() };
            (options.short_history, options.noisy_history) = (0.0, 0.0);
            options.model.history_len = 4;
            let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
            let mut is_differenced = || {
                let clip = Clip::draw(std::slice::from_ref(&scene), &options, &mut random);
                let shown = clip.show(&scene, None, &options, &mut random);
                shown.agents[0].history[3].unwrap().velocity_mps != [0.0, 3.0]
            };
            (0..200).filter(|_| is_differenced()).count()
        };
        assert_eq!((differenced_of(0.0), differenced_of(1.0)), (0, 200));
        assert!((70..130).contains(&differenced_of(0.5)));
    }
}
