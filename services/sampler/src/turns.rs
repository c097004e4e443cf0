//! The learned forecasts of a tick, shared over workers. Each agent is one turn.

use std::sync::{Mutex, PoisonError};

use bytemuck::Zeroable;
use evidence::Traffic;
use kinematics::Normals;
use nn::Job;
use retrieval::{Bucket, ControlChanges, Key, Query, Retrieval, RetrievalMemory, Unstored};
use scene::{AgentType, track_history};
use wire::{AGENTS_MAX, AgentControls, Cause, Forecast, Quality, Track};

use crate::SamplerOptions;
use crate::experts::{Blended, Experts, road_user};
use crate::guidance::Guidance;
use crate::learned::LearnedControls;
use crate::motion::{certain_motion, with_track_covariance};
use crate::published::{begin, is_within_the_world, limit_steps};
use crate::tick::Tick;

/// Number of turns that a worker takes at a time. A hand-over is worthwhile for 40 µs or more, so two turns
/// suffice.
const BLOCK: usize = 2;

/// The inputs and outputs of a tick's forecasts.
pub(crate) struct Turns {
    options: SamplerOptions,
    tick: Tick,
    /// Lent for the tick; `None` if nothing is to be retrieved.
    pub(crate) memory: Option<Box<RetrievalMemory>>,
    /// Lent for the tick; `None` if evidence is off.
    pub(crate) experts: Option<Box<Experts>>,
    /// All agents of the tick, whether they have controls or not.
    traffic: Traffic,
    turns: Vec<Turn>,
    /// Buckets of the agents that are to be stored in the retrieval memory, in their order.
    stored: Vec<Bucket>,
    made: Vec<Mutex<Made>>,
}

/// An agent with controls.
struct Turn {
    track: Track,
    /// Its place among the tracks.
    place: usize,
    agent_type: AgentType,
    controls: AgentControls,
    /// `None` if nothing is retrieved for the agent.
    key: Option<Key>,
    /// Number of agents that are stored before it.
    stored_count: usize,
}

/// The results of a turn.
pub(crate) struct Made {
    pub(crate) forecast: Forecast,
    /// Whether it can be published.
    pub(crate) is_possible: bool,
    /// To be kept by the evidence until the forecast matures.
    pub(crate) blended: Option<Blended>,
    /// To be stored in the retrieval memory.
    pub(crate) unstored: Option<Unstored>,
}

impl Turns {
    pub(crate) fn new(options: SamplerOptions) -> Self {
        let made =
            || Made { forecast: Forecast::zeroed(), is_possible: false, blended: None, unstored: None };
        Self {
            options,
            tick: Tick::default(),
            memory: None,
            experts: None,
            traffic: Traffic::default(),
            turns: Vec::with_capacity(AGENTS_MAX),
            stored: Vec::with_capacity(AGENTS_MAX),
            made: (0..AGENTS_MAX).map(|_| Mutex::new(made())).collect(),
        }
    }

    /// Prepares for the turns of a tick with these agents.
    pub(crate) fn begin(&mut self, tick: Tick, tracks: &[Track]) {
        self.tick = tick;
        self.traffic.clear();
        tracks
            .iter()
            .for_each(|track| self.traffic.push(road_user(track, self.options.history_len, tick.dt_s())));
        self.turns.clear();
        self.stored.clear();
    }

    /// Adds the turn of an agent, and returns its number.
    pub(crate) fn push(
        &mut self,
        place: usize,
        track: &Track,
        controls: &AgentControls,
    ) -> Result<usize, Cause> {
        let agent_type = track.agent_type().map_err(|_| Cause::Rejected)?;
        LearnedControls::check(controls).map_err(|_| Cause::Rejected)?;
        let stored_count = self.stored.len();
        let key = self.memory.as_deref().and_then(|memory| {
            let kind = self.options.kind_of(agent_type);
            let history = &track_history(track)[..self.options.history_len];
            let key = Key::new(kind, history, self.tick.dt_s())?;
            if memory.would_store(self.tick.stamp_ns, track.id) {
                self.stored.push(key.bucket());
            }
            Some(key)
        });
        self.turns.push(Turn { track: *track, place, agent_type, controls: *controls, key, stored_count });
        Ok(self.turns.len() - 1)
    }

    /// Number of blocks of turns.
    pub(crate) fn block_count(&self) -> usize {
        self.turns.len().div_ceil(BLOCK)
    }

    /// The results of a turn.
    pub(crate) fn made(&mut self, turn: usize) -> &mut Made {
        self.made[turn].get_mut().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A worker's scratch memory.
#[derive(Default)]
pub(crate) struct Forecaster {
    retrieval: Retrieval,
    /// `None` without a lane map.
    pub(crate) guidance: Option<Guidance>,
    /// The changes to the controls of the current agent.
    changes: ControlChanges,
}

impl Job for Forecaster {
    type Input = Turns;

    fn run(&mut self, turns: &Turns, block: usize) {
        let begin = block * BLOCK;
        let made = turns.made[begin..].iter();
        for (turn, made) in turns.turns[begin..].iter().zip(made).take(BLOCK) {
            self.forecast(turns, turn, &mut made.lock().unwrap_or_else(PoisonError::into_inner));
        }
    }
}

impl Forecaster {
    fn forecast(&mut self, turns: &Turns, turn: &Turn, made: &mut Made) {
        let Turns { options, tick, memory, experts, traffic, stored, .. } = turns;
        let Turn { track, place, agent_type, key, stored_count, .. } = turn;
        let controls = LearnedControls::of_checked(&turn.controls, options.horizon_len);
        let mut model = certain_motion(track, *agent_type, options, tick.dt_s());
        made.unstored = match (memory, *key) {
            (Some(memory), Some(key)) => {
                let query = Query { stamp_ns: tick.stamp_ns, agent: track.id, key };
                let ahead = &stored[..*stored_count];
                let decoded = controls.as_decoded();
                Some(self.retrieval.adapt((memory, ahead), &query, &model, &decoded, &mut self.changes))
            }
            _ => {
                self.changes.reset(controls.probability());
                None
            }
        };
        let lanes = self.guidance.as_mut().map_or(0, |guidance| {
            let decoded = controls.as_decoded();
            guidance.change((track, *agent_type), &model, &decoded, tick.dt_s(), &mut self.changes)
        });
        made.blended = experts.as_ref().map(|experts| {
            let decoded = controls.as_decoded();
            let network = self.changes.best(&decoded);
            let paths = (network, controls.base());
            let start_m = [track.x_m, track.y_m];
            let guidance = self.guidance.as_ref().filter(|_| lanes == Forecast::ALONG_LANES);
            let lane = |path: &[[f32; 2]]| guidance.and_then(|guidance| guidance.nearest(start_m, path));
            let mut blended =
                experts.blend(traffic.of(*place), *agent_type, traffic, lane, &model, paths, tick.dt_s());
            experts.change(&model, &decoded, &mut blended, &mut self.changes);
            blended
        });
        if options.initial_covariance {
            model = with_track_covariance(model, track);
        }
        let mut normals = Normals::new(options.seed, track.id, tick.seq);
        let out = &mut made.forecast;
        begin(track, Quality::Learned, Cause::None, out);
        out.lanes = lanes;
        out.out_of_distribution = controls.out_of_distribution();
        let spread = made.blended.as_ref().map(|blended| &blended.spread);
        controls.forecast(&self.changes, spread, &model, options.propagation, &mut normals, out);
        if let Some((experts, blended)) = experts.as_ref().zip(made.blended.as_ref()) {
            experts.sign(blended, out);
        }
        // Controls that lead out of the world are refused, not cut.
        made.is_possible = is_within_the_world(out);
        limit_steps(out, options.horizon_len, options.step_max_m(*agent_type, tick.dt_s()));
    }
}
