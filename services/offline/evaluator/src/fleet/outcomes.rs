//! Every forecast of a recording beside what its agent then did: a row for each agent and tick.

use data::Recording;
use evidence::{KNOTS, MotionNow, Prior};
use metrics::{Errors, displacement, min_displacement};
use nn::ModelConfig;
use onboard::Chain;
use run::Run;
use scene::AgentType;
use wire::{Forecast, Header, MODES_MAX};

use crate::driving::{LEARNED_MIN, nll_at, residuals_m};
use crate::error::EvaluateError;
use crate::fleet::footprint::{Contact, Footprint, contacts};
use crate::playback::{Truth, playback, type_of};

/// Contacts after more than this time are left out.
const CONTACT_S: f32 = 3.0;
/// Time between two looks at whether a pair really touches.
const LOOK_NS: i64 = 200_000_000;

/// The forecast of an agent at a tick, with its errors and contacts.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Number of the tick.
    pub seq: u64,
    /// Time of the tick.
    pub stamp_ns: i64,
    /// The track.
    pub track: u64,
    /// Identity of the agent in the recording; 0 without one.
    pub agent: u64,
    /// Type of the agent.
    pub agent_type: AgentType,
    /// Tracked position.
    pub position_m: [f32; 2],
    /// Tracked speed.
    pub speed_mps: f32,
    /// Quality of the forecast ([`wire::Quality`]).
    pub quality: u32,
    /// Cause of the quality ([`wire::Cause`]).
    pub cause: u32,
    /// `None` if the recording does not have the agent over the whole horizon.
    pub errors: Option<OutcomeErrors>,
    /// The recorded agent that it would touch if both kept their velocities, but does not.
    pub contact: Option<Contact>,
    /// The single best forecast.
    pub(crate) best_m: Vec<[f32; 2]>,
}

/// The errors of a forecast over the whole horizon.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutcomeErrors {
    /// Errors of the single best forecast.
    pub best: Errors,
    /// Errors of the mode with the least error.
    pub best_of: Errors,
    /// Errors of constant velocity.
    pub steady: Errors,
    /// Negative logarithm of the forecast's density at the agent's place at the end: the surprise.
    pub nll: f64,
    /// Residual of the truth to the mean of constant velocity and the best forecast, along and across the course
    /// at the knots, m.
    pub(crate) residuals_m: [[f32; 2]; KNOTS],
}

/// The forecasts of a recording beside its motion.
#[derive(Debug)]
pub struct Outcomes {
    truth: Truth,
    /// In the order of ticks.
    pub rows: Vec<Outcome>,
}

impl Outcomes {
    /// Without a forecast yet.
    #[must_use]
    pub fn of(recording: &Recording) -> Self {
        Self { truth: Truth::of(recording), rows: Vec::new() }
    }

    /// Adds the forecasts of a tick.
    pub fn add(&mut self, header: &Header, forecasts: &[Forecast]) {
        let agents: Vec<Option<Footprint>> =
            forecasts.iter().map(|forecast| self.footprint(header.stamp_ns, forecast.source_id)).collect();
        let present: Vec<Footprint> = agents.iter().copied().flatten().collect();
        let do_touch = |a: u64, b: u64| self.do_touch(header.stamp_ns, a, b);
        let mut contacts = contacts(&present, CONTACT_S, do_touch).into_iter();
        for (forecast, agent) in forecasts.iter().zip(agents) {
            let contact = agent.and_then(|_| contacts.next().flatten());
            let Some(agent_type) = type_of(forecast) else { continue };
            let horizon_len = header.counts.horizon_len as usize;
            self.rows.push(Outcome {
                seq: header.seq,
                stamp_ns: header.stamp_ns,
                track: forecast.id,
                agent: forecast.source_id,
                agent_type,
                position_m: [forecast.x_m, forecast.y_m],
                speed_mps: forecast.vx_mps.hypot(forecast.vy_mps),
                quality: forecast.quality,
                cause: forecast.cause,
                errors: self.errors(header, forecast),
                contact,
                best_m: forecast.best[..horizon_len.min(forecast.best.len())].to_vec(),
            });
        }
    }

    /// Whether the recording shows the pair in one place within [`CONTACT_S`].
    fn do_touch(&self, stamp_ns: i64, a: u64, b: u64) -> bool {
        let looks = 1..=((CONTACT_S * 1e9) as i64 / LOOK_NS);
        looks.map(|look| stamp_ns.saturating_add(look * LOOK_NS)).any(|at_ns| {
            let pair = self.footprint(at_ns, a).zip(self.footprint(at_ns, b));
            pair.is_some_and(|(a, b)| a.overlaps(&b))
        })
    }

    fn footprint(&self, stamp_ns: i64, agent: u64) -> Option<Footprint> {
        let state = self.truth.state(agent, stamp_ns)?;
        let reported = self.truth.track(agent)?.reported_at(stamp_ns);
        let own_m = [reported.length_m, reported.width_m];
        let is_known = own_m.iter().all(|size_m| *size_m > 0.0);
        Some(Footprint {
            agent,
            agent_type: reported.agent_type,
            position_m: state.position_m,
            velocity_mps: state.velocity_mps,
            heading_rad: state.heading_rad,
            size_m: if is_known { own_m } else { reported.agent_type.usual_size_m() },
        })
    }

    fn errors(&self, header: &Header, forecast: &Forecast) -> Option<OutcomeErrors> {
        let len = (header.counts.horizon_len as usize).min(forecast.best.len());
        let step_ns = header.step_ns.cast_signed() as f64;
        let truth = self.truth.ahead(forecast.source_id, header.stamp_ns, step_ns, len)?;
        let end = (*truth.last()?)?;
        let now = MotionNow::since([forecast.x_m, forecast.y_m], [forecast.vx_mps, forecast.vy_mps], None);
        let mut steady = vec![[0.0; 2]; len];
        now.steady((step_ns * 1e-9) as f32, &mut steady);
        let modes = &forecast.modes[..(forecast.modes_len as usize).min(MODES_MAX)];
        Some(OutcomeErrors {
            best: Errors::of(displacement(&forecast.best[..len], &truth)),
            best_of: Errors::of(min_displacement(modes, &truth)),
            steady: Errors::of(displacement(&steady, &truth)),
            nll: nll_at(forecast, len - 1, end),
            residuals_m: residuals_m(now.course(forecast.heading_rad), &truth, &steady, forecast),
        })
    }
}

/// Plays a recording through the stages of a run with this model. If a prior is given, the sampler starts
/// from it. Returns the outcomes, and the sampler's evidence as a prior for others.
///
/// # Errors
/// [`EvaluateError`] if the stages can't be set up.
pub fn outcomes(
    recording: Recording,
    run: &Run,
    model: &ModelConfig,
    prior: Option<Prior>,
) -> Result<(Outcomes, Option<Prior>), EvaluateError> {
    let mut outcomes = Outcomes::of(&recording);
    let mut playback = playback(recording);
    let run = Run { interval_ns: playback.interval_ns(), ..run.clone() };
    let mut chain = Chain::new(&run, model)?;
    if let Some(prior) = prior {
        chain.expect(prior);
    }
    while let Some(tick) = playback.next_tick() {
        let (header, forecasts) = chain.tick(&tick.header, tick.detections, |_| ());
        outcomes.add(&header, forecasts);
    }
    let learned = chain.evidence().map(|evidence| evidence.as_prior(LEARNED_MIN));
    Ok((outcomes, learned))
}

#[cfg(test)]
impl Outcome {
    /// A vehicle's forecast for tests: its errors are `errors` at the mean and at the end, m.
    pub(crate) fn example(agent: u64, stamp_ns: i64, errors: Option<[f64; 2]>) -> Self {
        let errors = errors.map(|[ade_m, fde_m]| {
            let best = Errors { ade_m, fde_m };
            OutcomeErrors { best, best_of: best, steady: best, nll: 0.0, residuals_m: Default::default() }
        });
        Self {
            seq: 0,
            stamp_ns,
            track: 90 + agent,
            agent,
            agent_type: AgentType::Vehicle,
            position_m: [0.0; 2],
            speed_mps: 1.0,
            quality: 0,
            cause: 0,
            errors,
            contact: None,
            best_m: Vec::new(),
        }
    }
}
