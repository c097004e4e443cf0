//! The forecasts of filtered agents, as the controls of each mode.

use std::collections::BTreeMap;

use filters::ControlStep;
use onboard::Graph;
use retrieval::RetrievalMemory;
use scene::State;
use wire::{AgentType, Forecast as Payload, ForecastsTopic, Header, Quality, TrackStatus, TracksTopic};

use crate::forecaster::{Forecaster, MapInput, TracksPayload};
use crate::scenes::{Agent, Scene};

/// Controls of all modes of one agent, in the layout of [`filters::Forecast`].
#[derive(Clone, Debug)]
pub(crate) struct Hypotheses {
    pub(crate) heading_rad: f64,
    pub(crate) probability: Vec<f64>,
    pub(crate) controls: Vec<ControlStep>,
}

/// A filter's estimate of an agent.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Estimate {
    pub(crate) id: u64,
    pub(crate) agent_type: AgentType,
    pub(crate) length_m: Option<f32>,
    pub(crate) state: State,
    /// Whether the agent is measured at this instant.
    pub(crate) is_measured: bool,
    /// Whether a forecast of the agent is needed.
    pub(crate) wanted: bool,
}

/// Prior knowledge of a site.
#[derive(Clone, Debug)]
pub(crate) struct Place<'a> {
    /// The map; an online map contains the filters' estimates up to now.
    pub(crate) map: MapInput<'a>,
    /// Retrieval memory with residuals of earlier recordings, if any.
    pub(crate) memory: Option<RetrievalMemory>,
}

/// An agent's estimates by stamp.
type Past = BTreeMap<i64, State>;

/// Forecasts filtered agents with the onboard stages. Each instant has one `tracks` payload with the filters'
/// estimates.
pub(crate) struct OnboardForecasts {
    stages: Graph,
    header: Header,
    history_len: i64,
    horizon_len: usize,
    pasts: BTreeMap<u64, Past>,
}

impl OnboardForecasts {
    /// Stages before their first frame. They retrieve from the site's memory only if `warm_started`.
    pub(crate) fn new(forecaster: &Forecaster, place: &Place<'_>, warm_started: bool) -> Self {
        let memory = place.memory.clone().filter(|_| warm_started);
        Self {
            stages: forecaster.stages(place.map, memory),
            header: forecaster.header(),
            history_len: forecaster.config().history_len as i64,
            horizon_len: forecaster.config().horizon_len,
            pasts: BTreeMap::new(),
        }
    }

    /// Adds the current estimates, with the sensor at `ego_m`, and forecasts the agents that need it.
    ///
    /// As in a run, estimates are never revised. A history consists of the estimates that are whole steps of
    /// the model old.
    pub(crate) fn forecast(
        &mut self,
        now_ns: i64,
        ego_m: [f32; 2],
        estimates: &[Estimate],
    ) -> Vec<(u64, Hypotheses)> {
        for estimate in estimates {
            self.pasts.entry(estimate.id).or_default().insert(now_ns, estimate.state);
        }
        let (step_ns, history_len) = (self.header.step_ns.cast_signed(), self.history_len);
        let stamp_ns = |step: i64| now_ns - (history_len - 1 - step) * step_ns;
        self.pasts.retain(|_, past| {
            past.retain(|&past_ns, _| past_ns >= stamp_ns(0));
            !past.is_empty()
        });
        let past = |estimate: &Estimate, step: i64| self.pasts[&estimate.id].get(&stamp_ns(step)).copied();
        let agents = estimates.iter().map(|estimate| Agent {
            id: estimate.id,
            agent_type: estimate.agent_type,
            length_m: estimate.length_m,
            history: (0..history_len).map(|step| past(estimate, step)).collect(),
            future: Vec::new(),
        });
        let scene = Scene { stamp_ns: now_ns, agents: agents.collect() };
        self.header = Header { seq: self.header.seq + 1, ego_m, ..self.header };
        let TracksPayload { header, mut tracks, places, .. } = TracksPayload::of(&scene, self.header);
        for (track, &place) in tracks.iter_mut().zip(&places) {
            let Estimate { is_measured, wanted, .. } = estimates[place];
            track.forecastable = u32::from(wanted);
            if !is_measured {
                (track.status, track.unseen_ns) = (TrackStatus::Coasting as u32, self.header.step_ns);
            }
        }
        self.stages.put::<TracksTopic>(&header, &tracks);
        self.stages.tick(|_| ());
        let forecasts = &self.stages.frame::<ForecastsTopic>().elements;
        let learned = |payload: &&Payload| payload.quality == Quality::Learned as u32;
        let horizon_len = self.horizon_len;
        let of_agent = |payload: &Payload| (payload.id, Hypotheses::of(payload, horizon_len));
        forecasts.iter().filter(learned).map(of_agent).collect()
    }
}

impl Hypotheses {
    /// The controls in a payload.
    fn of(payload: &Payload, horizon_len: usize) -> Self {
        let modes_len = payload.modes_len as usize;
        let step = |control: &wire::ControlGaussian| ControlStep {
            mean: control.mean.map(f64::from),
            cholesky: control.cholesky.map(f64::from),
        };
        let modes = payload.controls[..modes_len].iter();
        Self {
            heading_rad: f64::from(payload.frame_heading_rad),
            probability: payload.probability[..modes_len].iter().map(|&p| f64::from(p)).collect(),
            controls: modes.flat_map(|steps| steps[..horizon_len].iter().map(step)).collect(),
        }
    }
}
