//! What of a scene a batch shows: which agents, how much of their history, which way round.

use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use scene::{State, agent_frame};

use crate::batch::{SceneView, View};
use crate::options::TrainOptions;
use crate::samples::{Agent, Patches, Scene};

/// Deviations of the strongest noise: position (m), velocity (m/s), heading (rad).
const NOISE: (f32, f32, f32) = (0.04, 0.12, 0.01);

/// Shows a scene as training does: the agents around a random one, some with a shortened history, and scenes without
/// vehicles, which keep to no side of the road, mirrored half the time.
pub(crate) fn augmented<'a>(
    scene: &'a Scene,
    patches: Option<&'a Patches>,
    options: &TrainOptions,
    random: &mut impl Rng,
) -> SceneView<'a> {
    let counted: Vec<&Agent> = scene.agents.iter().filter(|agent| agent.counts).collect();
    let centre_m = position_m(counted[random.random_range(0..counted.len())]);
    let agents = nearest(scene, centre_m, options.scene_agents);
    let mirrored =
        agents.iter().all(|agent| agent.agent_type != scene::AgentType::Vehicle) && random.random_bool(0.5);
    let history_len = options.model.history_len;
    let agents = agents.into_iter().filter_map(|agent| {
        let shortened = random.random_bool(options.short_history);
        let len = if shortened { random.random_range(2..=history_len) } else { history_len };
        let view = shown(agent, len, mirrored)?;
        Some(if random.random_bool(options.noisy_history) { noisy(view, random) } else { view })
    });
    SceneView { agents: agents.collect(), patches, mirrored }
}

/// Shows a scene as it was recorded; of crowds the `agents_max` nearest to the first agent that counts.
pub(crate) fn plain<'a>(scene: &'a Scene, patches: Option<&'a Patches>, agents_max: usize) -> SceneView<'a> {
    let centre_m = scene.agents.iter().find(|agent| agent.counts).map_or([0.0; 2], position_m);
    let agents = nearest(scene, centre_m, agents_max);
    let agents = agents.into_iter().filter_map(|agent| shown(agent, agent.history.len(), false));
    SceneView { agents: agents.collect(), patches, mirrored: false }
}

/// An agent with its newest `history_len` states; `None` where it has none.
pub(crate) fn shown(agent: &Agent, history_len: usize, mirrored: bool) -> Option<View<'_>> {
    let mut history = agent.history_of(history_len);
    let mut future = agent.future.clone();
    if mirrored {
        history.iter_mut().chain(&mut future).flatten().for_each(mirror);
    }
    let frame = agent_frame(&history)?;
    Some(View { agent, history, future, frame })
}

/// The same agent as a noisy sensor would give it. How noisy is drawn too, up to [`NOISE`].
pub(crate) fn noisy<'a>(mut view: View<'a>, random: &mut impl Rng) -> View<'a> {
    let level: f32 = random.random();
    for state in view.history.iter_mut().flatten() {
        let mut noise =
            |deviation: f32| level * deviation * Distribution::<f32>::sample(&StandardNormal, random);
        state.position_m = state.position_m.map(|value| value + noise(NOISE.0));
        state.velocity_mps = state.velocity_mps.map(|value| value + noise(NOISE.1));
        state.heading_rad += noise(NOISE.2);
    }
    View { frame: agent_frame(&view.history).unwrap_or(view.frame), ..view }
}

fn mirror(state: &mut State) {
    state.position_m[1] = -state.position_m[1];
    state.velocity_mps[1] = -state.velocity_mps[1];
    state.heading_rad = -state.heading_rad;
}

fn position_m(agent: &Agent) -> [f32; 2] {
    agent.history.iter().rev().flatten().next().map_or([0.0; 2], |state| state.position_m)
}

/// The `len` agents nearest to a place, in the scene's order.
fn nearest(scene: &Scene, centre_m: [f32; 2], len: usize) -> Vec<&Agent> {
    let distance = |agent: &Agent| {
        let [x, y] = position_m(agent);
        (x - centre_m[0]).powi(2) + (y - centre_m[1]).powi(2)
    };
    let mut order: Vec<usize> = (0..scene.agents.len()).collect();
    order.sort_by(|&a, &b| distance(&scene.agents[a]).total_cmp(&distance(&scene.agents[b])));
    order.truncate(len);
    order.sort_unstable();
    order.into_iter().map(|agent| &scene.agents[agent]).collect()
}
