//! Errors of the forecasts against the recording's later truth.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Accuracy of the forecasts as published, against the recording's later truth.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Accuracy {
    /// Errors of all forecasts.
    #[serde(flatten)]
    pub errors: Errors,
    /// Largest number of modes of a forecast, K.
    pub draws: Option<u32>,
    /// Time from the stamp to the last step.
    pub horizon_s: Option<f64>,
    /// Distance between the last position of a forecast and the truth above which the forecast is a miss.
    pub miss_radius_m: f64,
    /// Errors of the learned forecasts alone.
    pub learned: Errors,
    /// Errors by agent type.
    pub by_type: BTreeMap<String, Errors>,
    /// Errors of each agent, by its identity in the truth.
    #[serde(default)]
    pub agents: Vec<AgentErrors>,
    /// Number of agents that are not listed.
    #[serde(default)]
    pub agents_unlisted: u64,
    /// Number of forecasts whose agent lacks truth for the whole horizon. It left the scene, or the run
    /// ended.
    pub uncovered: u64,
    /// Number of forecasts that match no agent of the truth. They are false alarms, or no truth was near.
    pub unmatched: u64,
}

/// Errors of the forecasts of one agent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct AgentErrors {
    /// Identity in the truth.
    pub agent: u64,
    /// Type in the agent's last forecast.
    #[serde(rename = "type")]
    pub agent_type: String,
    /// Number of forecasts compared.
    pub forecasts: u64,
    /// minADE_K.
    pub ade_m: Option<f64>,
    /// minFDE_K.
    pub fde_m: Option<f64>,
    /// The forecast whose best mode ends farthest from the truth.
    pub worst: WorstForecast,
}

/// The worst forecast of an agent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WorstForecast {
    /// Tick.
    pub tick: u64,
    /// The tick's stamp.
    pub stamp_ns: i64,
    /// Position of the agent, x.
    pub x_m: f32,
    /// Position of the agent, y.
    pub y_m: f32,
    /// minFDE_K of this forecast.
    pub fde_m: f64,
}

/// Errors of a group of forecasts, and errors of constant velocity for the same agents.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Number of forecasts compared.
    pub forecasts: u64,
    /// minADE_K: mean distance over the horizon of each forecast's best mode.
    pub ade_m: Option<f64>,
    /// minFDE_K: distance at the end of the horizon of each forecast's best mode.
    pub fde_m: Option<f64>,
    /// Miss rate: share of forecasts in which no mode ends within the miss radius.
    pub miss_rate: Option<f64>,
    /// ADE of the single best forecast (K = 1).
    pub single_ade_m: Option<f64>,
    /// FDE of the single best forecast.
    pub single_fde_m: Option<f64>,
    /// Miss rate of the single best forecast.
    pub single_miss_rate: Option<f64>,
    /// ADE of constant velocity.
    pub cv_ade_m: Option<f64>,
    /// FDE of constant velocity.
    pub cv_fde_m: Option<f64>,
    /// Miss rate of constant velocity.
    pub cv_miss_rate: Option<f64>,
    /// Share of the 50 % regions at the end of the horizon that contained the truth.
    #[serde(default)]
    pub held_50: Option<f64>,
    /// Share of the 90 % regions that contained it.
    #[serde(default)]
    pub held_90: Option<f64>,
}
