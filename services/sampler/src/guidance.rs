//! Lanes in the sampler: changes a vehicle's controls so that its forecasts follow the lanes it is on.

use std::sync::Arc;

use kinematics::MotionModel;
use lanes::{Guided, GuidedPath, LaneGuide, LaneLine, LaneMap};
use retrieval::{ControlChanges, ForecastControls, Residuals};
use scene::AgentType;
use wire::{ControlGaussian, Forecast, HORIZON_MAX, MODES_MAX, Track};

/// Number of corrections of the controls. One correction leaves an error of some metres at the end, because
/// residuals are of speed and curvature.
const PASSES: usize = 2;
/// Minimum speed at which a vehicle on no lane is reported: parked vehicles are seldom on a lane.
const MOVES_MPS: f32 = 1.0;

/// The lanes of a site, and scratch memory.
pub(crate) struct Guidance {
    guide: LaneGuide,
    modes: Vec<GuidedPath>,
}

impl Guidance {
    pub(crate) fn new(map: Arc<LaneMap>) -> Self {
        Self { guide: LaneGuide::new(map), modes: Vec::with_capacity(MODES_MAX) }
    }

    /// Changes the controls so that modes and best forecast go along lanes, and returns the forecast's
    /// [`Forecast::lanes`]. Only vehicles that do not reverse are guided.
    pub(crate) fn change<M: AsRef<[ControlGaussian]>>(
        &mut self,
        (track, agent_type): (&Track, AgentType),
        model: &MotionModel,
        controls: &ForecastControls<'_, M>,
        step_s: f32,
        changes: &mut ControlChanges,
    ) -> u32 {
        let (sin, cos) = track.heading_rad.sin_cos();
        let speed_mps = cos * track.vx_mps + sin * track.vy_mps;
        if agent_type != AgentType::Vehicle || speed_mps < 0.0 {
            return 0;
        }
        let Self { guide, modes } = self;
        let (modes_len, horizon_len) = (controls.modes.len(), controls.best.len());
        let position_m = [track.x_m, track.y_m];
        modes.clear();
        modes.extend((0..modes_len).map(|mode| mode_path(mode, model, controls, changes)));
        let mut best = best_path(model, controls, changes);
        let agent = Guided { agent_type, position_m, heading_rad: track.heading_rad, step_s };
        if !guide.guide(&agent, horizon_len, modes, changes.probability(), &mut best) {
            return if speed_mps >= MOVES_MPS { Forecast::OFF_LANES } else { 0 };
        }
        let change = |from: &GuidedPath, to: &GuidedPath| {
            let (from, to) = (&from[..horizon_len], &to[..horizon_len]);
            Residuals::between(model.kind(), position_m, from, to, step_s).control_change(model)
        };
        for _ in 0..PASSES {
            for (mode, guided) in modes.iter().enumerate() {
                let by = change(&mode_path(mode, model, controls, changes), guided);
                changes.shift_mode(mode, &by);
            }
            let by = change(&best_path(model, controls, changes), &best);
            changes.shift_best(&by);
        }
        Forecast::ALONG_LANES
    }
}

impl Guidance {
    /// The line nearest to a path of the vehicle that was [guided](Guidance::change) last.
    pub(crate) fn nearest(&self, start_m: [f32; 2], path: &[[f32; 2]]) -> Option<LaneLine<'_>> {
        self.guide.nearest(start_m, path)
    }
}

fn mode_path<M: AsRef<[ControlGaussian]>>(
    mode: usize,
    model: &MotionModel,
    controls: &ForecastControls<'_, M>,
    changes: &ControlChanges,
) -> GuidedPath {
    let mut path = [[0.0; 2]; HORIZON_MAX];
    model.positions(changes.mode(mode, controls).map(|control| control.mean), &mut path);
    path
}

fn best_path<M>(
    model: &MotionModel,
    controls: &ForecastControls<'_, M>,
    changes: &ControlChanges,
) -> GuidedPath {
    let mut path = [[0.0; 2]; HORIZON_MAX];
    model.positions(changes.best(controls), &mut path);
    path
}
