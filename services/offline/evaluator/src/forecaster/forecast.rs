use metrics::Point;
use serde::{Deserialize, Serialize};
use wire::Forecast as Payload;

/// The forecast of one agent, read from a `forecasts` payload.
#[derive(Clone, Debug, PartialEq)]
pub struct Forecast {
    /// The K modes.
    pub modes: Vec<Vec<Point>>,
    /// The probability of each mode.
    pub probability: Vec<f32>,
    /// Covariances (xx, xy, yy) of each mode's positions, m².
    pub covariance: Vec<Vec<[f32; 3]>>,
    /// The single best forecast (K = 1).
    pub best: Vec<Point>,
}

/// The forecasts of one agent, from the same controls with different corrections.
#[derive(Clone, Debug, PartialEq)]
pub struct Variants {
    /// Without retrieval.
    pub network: Forecast,
    /// By baseline B*: ridge regression and anchors, with the network switched off. `None` if the model has
    /// no base controls.
    pub base: Option<Forecast>,
    /// With a retrieval memory that contains this recording only.
    pub retrieved: Option<Forecast>,
    /// With a retrieval memory that begins with earlier recordings; `None` if there is none.
    pub warm_started: Option<Forecast>,
    /// With a retrieval memory that contains this recording only, and with evidence.
    pub with_evidence: Option<Forecast>,
}

impl Forecast {
    /// The first `horizon_len` steps of a payload.
    ///
    /// # Panics
    /// If the payload has fewer steps.
    #[must_use]
    pub fn of(payload: &Payload, horizon_len: usize) -> Self {
        let modes = 0..payload.modes_len as usize;
        Self {
            modes: modes.clone().map(|mode| payload.modes[mode][..horizon_len].to_vec()).collect(),
            probability: payload.probability[modes.clone()].to_vec(),
            covariance: modes.map(|mode| payload.mode_covariance[mode][..horizon_len].to_vec()).collect(),
            best: payload.best[..horizon_len].to_vec(),
        }
    }
}

/// Windows that do not fit a payload, and what the stages did not see of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Crowding {
    /// Number of windows.
    pub window_count: u64,
    /// Agents for which the `tracks` payload has no room. They are not seen as neighbours.
    pub agents_len: u64,
    /// Edges for which the `features` payload has no room. They belong to the farthest neighbours.
    pub edges_len: u64,
}

impl Crowding {
    /// Adds the counts of `other`.
    pub(crate) fn merge(&mut self, other: &Self) {
        self.window_count += other.window_count;
        self.agents_len += other.agents_len;
        self.edges_len += other.edges_len;
    }
}
