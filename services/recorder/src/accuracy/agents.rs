use std::collections::{BTreeMap, BTreeSet};

use metrics::{Displacement, DisplacementMean};
use serde::{Deserialize, Serialize};
use wire::AgentType;

use super::forecast::{Scored, Waiting, rounded};
use crate::report::{AgentErrors, WorstForecast};

/// Largest number of agents whose errors are kept: the first ones. Up to the same number of further agents is
/// only counted.
const AGENTS_MAX: usize = 512;

/// Errors of single agents, by their identity in the truth.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Agents {
    agents: BTreeMap<u64, Agent>,
    unlisted: BTreeSet<u64>,
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Agent {
    agent_type: u32,
    best_mode: DisplacementMean,
    worst: WorstForecast,
}

impl Agents {
    /// Adds the error of a forecast of agent `id`.
    pub fn add(&mut self, id: u64, tick: &Waiting, forecast: &Scored, error: Displacement) {
        if self.agents.len() >= AGENTS_MAX && !self.agents.contains_key(&id) {
            if self.unlisted.len() < AGENTS_MAX {
                self.unlisted.insert(id);
            }
            return;
        }
        let agent = self.agents.entry(id).or_default();
        agent.agent_type = forecast.agent_type;
        agent.best_mode.add(error);
        if let Some(fde_m) = error.fde_m.filter(|fde_m| *fde_m >= agent.worst.fde_m) {
            let [x_m, y_m] = forecast.position_m;
            agent.worst = WorstForecast { tick: tick.seq, stamp_ns: tick.stamp_ns, x_m, y_m, fde_m };
        }
    }

    /// The errors by identity.
    pub fn errors(&self) -> Vec<AgentErrors> {
        let errors = |(id, agent): (&u64, &Agent)| AgentErrors {
            agent: *id,
            agent_type: AgentType::try_from(agent.agent_type).map_or("unknown", AgentType::name).to_owned(),
            forecasts: agent.best_mode.ade_m.len(),
            ade_m: rounded(agent.best_mode.ade_m.value()),
            fde_m: rounded(agent.best_mode.fde_m.value()),
            worst: WorstForecast {
                fde_m: rounded(Some(agent.worst.fde_m)).unwrap_or_default(),
                ..agent.worst
            },
        };
        self.agents.iter().map(errors).collect()
    }

    /// Number of agents that are not listed.
    pub fn unlisted(&self) -> u64 {
        self.unlisted.len() as u64
    }
}
