use wire::AgentType;

/// Share of detections with the right type.
const RIGHT: f64 = 0.9;
/// Share of detections with one of the two wrong types.
const WRONG: f64 = 0.05;
/// Bound of the log-odds between two types, so that a few detections can change the belief.
const LOG_ODDS_MAX: f64 = 6.0;
/// Log-odds against its current type at which a track changes to another type.
const CHANGE_LOG_ODDS: f64 = 2.0;

/// The belief about an agent's type, from the types of its detections.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Class {
    current: AgentType,
    /// Natural logarithms of the probabilities, the largest 0.
    log_weight: [f64; 3],
    /// Derived values, stored because most detections change nothing: the probabilities, and the cost of each
    /// type.
    probability: [f64; 3],
    disagreement: [f64; 3],
}

impl Class {
    /// The belief after one detection.
    #[must_use]
    pub fn new(detected: AgentType) -> Self {
        let mut class =
            Self { current: detected, log_weight: [0.0; 3], probability: [0.0; 3], disagreement: [0.0; 3] };
        class.observe(detected);
        class
    }

    /// The belief with these probabilities, for a track of type `current`.
    #[must_use]
    pub fn of(current: AgentType, probability: [f64; 3]) -> Self {
        let log_weight = probability.map(|p| p.max(f64::MIN_POSITIVE).ln());
        let most = log_weight.iter().fold(f64::NEG_INFINITY, |most, &w| most.max(w));
        let log_weight = log_weight.map(|w| (w - most).max(-LOG_ODDS_MAX));
        let mut class = Self { current, log_weight, probability: [0.0; 3], disagreement: [0.0; 3] };
        class.derive_costs();
        class
    }

    /// The current type of the track.
    #[must_use]
    pub const fn current(&self) -> AgentType {
        self.current
    }

    /// Updates the belief by the type of a detection. Returns whether the track's type has changed.
    pub fn observe(&mut self, detected: AgentType) -> bool {
        let before = self.log_weight;
        for (index, log_weight) in self.log_weight.iter_mut().enumerate() {
            *log_weight += if index == detected.index() { RIGHT.ln() } else { WRONG.ln() };
        }
        let most = self.log_weight.iter().fold(f64::NEG_INFINITY, |most, &w| most.max(w));
        for log_weight in &mut self.log_weight {
            *log_weight = (*log_weight - most).max(-LOG_ODDS_MAX);
        }
        if self.log_weight != before {
            self.derive_costs();
        }
        let log_odds = self.log_weight[detected.index()] - self.log_weight[self.current.index()];
        let changed = detected != self.current && log_odds > CHANGE_LOG_ODDS;
        if changed {
            self.current = detected;
        }
        changed
    }

    /// Probability of each type.
    #[must_use]
    pub const fn probability(&self) -> &[f64; 3] {
        &self.probability
    }

    /// −2 ln of the probability that a detection of this agent has this type.
    #[must_use]
    pub const fn disagreement(&self, detected: AgentType) -> f64 {
        self.disagreement[detected.index()]
    }

    fn derive_costs(&mut self) {
        let weight = self.log_weight.map(f64::exp);
        let sum: f64 = weight.iter().sum();
        self.probability = weight.map(|w| w / sum);
        self.disagreement = self.probability.map(|right| -2.0 * (right * RIGHT + (1.0 - right) * WRONG).ln());
    }
}
