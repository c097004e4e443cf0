//! Cuts recordings into scenes and map patches.

use std::collections::BTreeMap;
use std::sync::Arc;

use data::{Recording, Window, WindowOptions};
use nn::ModelConfig;
use scene::{OnlineMap, PatchOptions};

use super::Selection;
use super::agents::{Agent, Scene};
use super::ground::{Ground, GroundSpooling};
use crate::TrainError;
use crate::spool::Spooling;

/// The scenes of a recording, one per window, and its ground, whose patches are written to the spool.
pub(crate) fn cut<'a>(
    recording: &Recording,
    selection: Selection<'_>,
    config: &'a ModelConfig,
    spooling: &mut Spooling,
) -> Result<(impl Iterator<Item = Scene> + use<'a>, Ground), TrainError> {
    let Selection { from_positions, whole_history, .. } = selection;
    let step_ns = config.step_ns() as i64;
    let options = WindowOptions {
        from_positions,
        ..WindowOptions::new(config.history_len, config.horizon_len, step_ns)
    };
    let windows = data::windows(recording, &options);
    let (ground, numbers) = cut_patches(recording, &windows, config, spooling)?;
    let scene = move |window: Window| {
        let agents = window.agents.iter().map(|agent| {
            let steps = (config.history_len + config.horizon_len) as i64;
            let first_ns = window.stamp_ns - (config.history_len as i64 - 1) * step_ns;
            let stamps = (0..steps).map(|step| first_ns + step * step_ns);
            let patches = stamps.map(|stamp_ns| numbers.get(&(agent.id, stamp_ns)).copied()).collect();
            let mut agent = Agent::new(agent, patches, from_positions, config);
            agent.counts &= !whole_history || agent.history.iter().all(Option::is_some);
            Arc::new(agent)
        });
        Scene { agents: agents.collect() }
    };
    Ok((windows.into_iter().map(scene), ground))
}

/// Indices of the patches by (identity, stamp).
type Numbers = BTreeMap<(u64, i64), u32>;

/// Writes the patches of every agent and window.
fn cut_patches(
    recording: &Recording,
    windows: &[Window],
    config: &ModelConfig,
    spooling: &mut Spooling,
) -> Result<(Ground, Numbers), TrainError> {
    let options =
        PatchOptions { side: config.patch_size, cell_m: config.patch_cell_m, ahead_m: config.patch_ahead_m };
    let mut ground = GroundSpooling::new(spooling);
    let mut numbers = Numbers::new();
    if !config.context {
        return Ok((ground.finish()?, numbers));
    }
    let egos: BTreeMap<i64, [f32; 2]> =
        recording.frames.iter().map(|frame| (frame.stamp_ns, frame.ego.position_m)).collect();
    let mut map = OnlineMap::new();
    let mut patch = vec![0.0; options.len()];
    for window in windows {
        let newest = || window.agents.iter().filter_map(|agent| Some((agent, (*agent.history.last()?)?)));
        for (agent, state) in newest() {
            map.patch(&state, options, &mut patch);
            numbers.insert((agent.id, window.stamp_ns), numbers.len() as u32);
            ground.push(&state, &patch)?;
        }
        let ego_m = egos.get(&window.stamp_ns).copied().unwrap_or_default();
        map.observe(ego_m, newest().map(|(_, state)| (state.position_m, state.velocity_mps)));
    }
    Ok((ground.finish()?, numbers))
}
