use kinematics::{ControlGaussian, Moments, MotionKind, MotionModel, Normals, mixture};
use retrieval::{ControlChanges, ForecastControls};
use wire::{AgentControls, Expert, Forecast, HORIZON_MAX, MODES_MAX, Rejected, Steering};

use crate::Propagation;
use crate::motion::LateralLimit;
use crate::spread::Spread;

/// Largest deviation of the sum of an agent's mode probabilities from 1.
const PROBABILITY_SLACK: f32 = 1e-3;

/// Checked controls of an agent.
pub(crate) struct LearnedControls<'a> {
    controls: &'a AgentControls,
    horizon_len: usize,
}

impl<'a> LearnedControls<'a> {
    /// Refuses controls that are not finite, and probabilities that are negative or do not sum to 1.
    pub(crate) fn check(controls: &AgentControls) -> Result<(), Rejected> {
        controls.check()?;
        let probability = &controls.probability[..controls.modes_len as usize];
        let sum: f32 = probability.iter().sum();
        let impossible =
            |value: f32| Rejected::Impossible { field: "mode probability", value: f64::from(value) };
        if let Some(negative) = probability.iter().find(|p| **p < 0.0) {
            return Err(impossible(*negative));
        }
        if (sum - 1.0).abs() > PROBABILITY_SLACK {
            return Err(impossible(sum));
        }
        Ok(())
    }

    /// Controls that have passed [`LearnedControls::check`].
    pub(crate) const fn of_checked(controls: &'a AgentControls, horizon_len: usize) -> Self {
        Self { controls, horizon_len }
    }

    /// The probability of each mode.
    pub(crate) fn probability(&self) -> &'a [f32] {
        &self.controls.probability[..self.controls.modes_len as usize]
    }

    pub(crate) fn as_decoded(&self) -> ForecastControls<'a, [wire::ControlGaussian; HORIZON_MAX]> {
        ForecastControls {
            modes: &self.controls.modes[..self.controls.modes_len as usize],
            probability: self.probability(),
            best: &self.controls.best[..self.horizon_len],
        }
    }

    /// The distance of the agent from the model's training data.
    pub(crate) const fn out_of_distribution(&self) -> f32 {
        self.controls.out_of_distribution
    }

    /// The controls of the model's base only.
    pub(crate) fn base(&self) -> impl Iterator<Item = [f32; 2]> {
        self.controls.base[..self.horizon_len].iter().copied()
    }

    /// Writes the modes with their changed controls, the best forecast and the moments.
    ///
    /// With a spread, the modes' covariances come from the spread instead of the controls. Vehicles are
    /// limited to the grip of their tyres. The best forecast is left to the
    /// [experts](crate::experts::Experts::sign).
    pub(crate) fn forecast(
        &self,
        changes: &ControlChanges,
        spread: Option<&Spread>,
        model: &MotionModel,
        propagation: Propagation,
        normals: &mut Normals,
        out: &mut Forecast,
    ) {
        let (modes_len, controls) = (self.controls.modes_len as usize, self.as_decoded());
        let mode_steps = |mode: usize| {
            let steps = changes.mode(mode, &controls);
            steps.map(|control| ControlGaussian::new(control.mean, control.cholesky))
        };
        let mut moments = [[Moments::default(); HORIZON_MAX]; MODES_MAX];
        let modes = out.controls.iter_mut().zip(&mut moments).enumerate();
        for (mode, (published_steps, moments)) in modes.take(modes_len) {
            let moments = &mut moments[..self.horizon_len];
            let mut acting = [ControlGaussian::centred([0.0; 2]); HORIZON_MAX];
            let mut limit = spread.and_then(|_| LateralLimit::new(model));
            for ((control, acting), out) in mode_steps(mode).zip(&mut acting).zip(published_steps) {
                *acting = model.acting(&control);
                if let Some(limit) = &mut limit {
                    limit.cut(acting);
                }
                *out = published(&model.relative_to_start(acting));
            }
            match (spread, propagation) {
                (Some(_), _) => model.means(acting.into_iter(), moments),
                (None, Propagation::Linearised) => model.moments(acting.into_iter(), moments),
                (None, Propagation::MonteCarlo { particles }) => {
                    model.particle_moments(mode_steps(mode), particles, normals, moments);
                }
            }
        }
        if let Some(spread) = spread {
            let present_m2 = model.position_covariance();
            (0..self.horizon_len).for_each(|step| spread.widen(step, &mut moments[..modes_len], present_m2));
        }
        out.steering = match model.kind() {
            MotionKind::Bicycle => Steering::Bicycle,
            MotionKind::Displacement => Steering::Displacement,
        } as u32;
        out.frame_heading_rad = model.frame_heading_rad();
        if spread.is_none() {
            model.positions(changes.best(&controls), &mut out.best[..self.horizon_len]);
        }
        out.modes_len = self.controls.modes_len;
        out.probability[..modes_len].copy_from_slice(changes.probability());

        for (mode, expert) in out.mode_expert.iter_mut().enumerate().take(modes_len) {
            *expert = if changes.is_replaced(mode) { Expert::Retrieval } else { Expert::Network } as u8;
        }
        for step in 0..self.horizon_len {
            let parts =
                out.probability.iter().zip(&moments).take(modes_len).map(|(p, mode)| (*p, mode[step]));
            let mixed = mixture(parts.clone());
            (out.mean[step], out.covariance[step]) = (mixed.mean, mixed.covariance);
            let modes = out.modes.iter_mut().zip(&mut out.mode_covariance);
            for ((mode, covariance), (_, part)) in modes.zip(parts) {
                (mode[step], covariance[step]) = (part.mean, part.covariance);
            }
        }
    }
}

fn published(control: &ControlGaussian) -> wire::ControlGaussian {
    let factor = &control.cholesky;
    wire::ControlGaussian { mean: control.mean.into(), cholesky: [factor.m11, factor.m21, factor.m22] }
}
