use kinematics::{Belief, Bicycle, BicycleState, ControlGaussian, ControlLimits, Integrator, Vehicle};
use nn::{BurnIn, Decoder, DecoderMemory, Draws, RAW_CONTROL, control_gaussian};
use wire::{AGENT_TYPES, AgentType, LATENT};

use super::folder::Folder;
use super::graphs::Summary;
use super::ledger::Ledger;
use crate::VerifyError;

/// Units of the GRU's hidden state.
const HIDDEN: usize = 128;

/// The controls of all agents, \[draw, agent, step\].
pub(super) struct Controls {
    gaussians: Vec<wire::ControlGaussian>,
    draw_count: usize,
}

/// Compares the decoder's output with the folder's latent draws, and the control Gaussians.
pub(super) fn controls(
    folder: &Folder,
    decoder: &Decoder,
    history: &Summary,
    ledger: &mut Ledger<'_>,
) -> Result<Controls, VerifyError> {
    let (agents_len, horizon_len) = (folder.types.len(), folder.config().horizon_len);
    let latents = folder.rows::<LATENT>("latent.z")?;
    if latents.is_empty() || !latents.len().is_multiple_of(agents_len) {
        return Err(folder.malformed(format!("latent.z: {} rows for {agents_len} agents", latents.len())));
    }
    let draw_count = latents.len() / agents_len;
    let mut raw = vec![[0.0; RAW_CONTROL]; latents.len() * horizon_len];
    for agent_type in AGENT_TYPES {
        decode(folder, decoder, agent_type, history, &latents, &mut raw);
    }
    ledger.compare("decoder.raw", raw.as_flattened())?;
    let gaussians: Vec<_> = raw.into_iter().map(control_gaussian).collect();
    ledger.compare("control.mean", &gaussians.iter().flat_map(|g| g.mean).collect::<Vec<_>>())?;
    let factor = |g: &wire::ControlGaussian| [g.cholesky[0], 0.0, g.cholesky[1], g.cholesky[2]];
    ledger.compare("control.cholesky", &gaussians.iter().flat_map(factor).collect::<Vec<_>>())?;
    Ok(Controls { gaussians, draw_count })
}

/// Runs the agents of one type and places their rows, \[draw, agent, step\].
fn decode(
    folder: &Folder,
    decoder: &Decoder,
    agent_type: AgentType,
    history: &Summary,
    latents: &[[f32; LATENT]],
    raw: &mut [[f32; RAW_CONTROL]],
) {
    let (all_count, horizon_len) = (folder.types.len(), folder.config().horizon_len);
    let agents: Vec<usize> = (0..all_count).filter(|agent| folder.types[*agent] == agent_type).collect();
    let draw_count = latents.len() / all_count;
    let rows = |step: usize| agents.iter().map(move |agent| step * all_count + agent);
    let steps = 0..folder.config().history_len;
    let states: Vec<_> = steps.clone().flat_map(|step| rows(step).map(|row| history.states[row])).collect();
    let present: Vec<_> = steps.flat_map(|step| rows(step).map(|row| history.present[row])).collect();
    let temporal: Vec<_> = agents.iter().map(|agent| history.temporal[*agent]).collect();
    let draws: Vec<_> =
        agents.iter().flat_map(|a| (0..draw_count).map(move |draw| latents[draw * all_count + a])).collect();

    let mut memory = DecoderMemory::default();
    let mut hidden = vec![[0.0; HIDDEN]; agents.len()];
    let burn_in = BurnIn { agents_len: agents.len(), states: &states, present: &present };
    decoder.of(agent_type).burn_in(&burn_in, &mut memory, &mut hidden);
    let mut out = vec![[0.0; RAW_CONTROL]; draws.len() * horizon_len];
    decoder.of(agent_type).forecast(&hidden, &temporal, Draws::Given(&draws), &mut memory, &mut out);
    for (number, steps) in out.chunks_exact(horizon_len).enumerate() {
        let (agent, draw) = (agents[number / draw_count], number % draw_count);
        raw[(draw * all_count + agent) * horizon_len..][..horizon_len].copy_from_slice(steps);
    }
}

/// Compares the linearised Gaussians of the vehicles under both integrators.
///
/// The folder's bicycles start without slip and have no slip limit. Their other limits come from
/// `scene.json`.
pub(super) fn bicycles(
    folder: &Folder,
    controls: &Controls,
    ledger: &mut Ledger<'_>,
) -> Result<(), VerifyError> {
    let now = folder.config().history_len - 1;
    let start = |agent: &usize| {
        let state = folder.state(now, *agent).ok_or_else(|| {
            folder.malformed(format!("vehicle {agent} is absent at the last observed step"))
        })?;
        let [x, y] = state.position_m;
        Ok(BicycleState::from([x, y, state.heading_rad, state.speed_mps(), 0.0]))
    };
    let starts = folder.scene.vehicles.iter().map(start).collect::<Result<Vec<_>, VerifyError>>()?;
    ledger.compare("bicycle.initial", &starts.iter().flat_map(|s| s.iter().copied()).collect::<Vec<_>>())?;
    for (integrator, prefix) in [(Integrator::Euler, ""), (Integrator::Midpoint, "midpoint_")] {
        let vehicle = Vehicle {
            bicycle: Bicycle { rear_axle_m: folder.scene.rear_axle_m, slip_limit_rad: None, integrator },
            limits: ControlLimits {
                accel_mps2: folder.scene.accel_limit_mps2,
                slip_rate_radps: folder.scene.slip_rate_limit_radps,
            },
            dt_s: folder.config().dt_s as f32,
        };
        let (means, covariances) = propagate(folder, controls, &starts, &vehicle);
        ledger.compare(&format!("bicycle.{prefix}mean"), &means)?;
        ledger.compare_blocks(&format!("bicycle.{prefix}covariance"), &covariances, 25)?;
    }
    Ok(())
}

/// Means \[draw, vehicle, step, 5\] and covariances \[draw, vehicle, step, 5, 5\].
fn propagate(
    folder: &Folder,
    controls: &Controls,
    starts: &[BicycleState<f32>],
    vehicle: &Vehicle,
) -> (Vec<f32>, Vec<f32>) {
    let (agents_len, horizon_len) = (folder.types.len(), folder.config().horizon_len);
    let (mut means, mut covariances) = (Vec::new(), Vec::new());
    for draw in 0..controls.draw_count {
        for (start, agent) in starts.iter().zip(&folder.scene.vehicles) {
            let mut belief = Belief::certain(*start);
            for gaussian in &controls.gaussians[(draw * agents_len + agent) * horizon_len..][..horizon_len] {
                belief.advance(vehicle, &ControlGaussian::new(gaussian.mean, gaussian.cholesky));
                means.extend(belief.mean.iter());
                // Symmetric, so column-major equals row-major.
                covariances.extend(belief.covariance.iter());
            }
        }
    }
    (means, covariances)
}
