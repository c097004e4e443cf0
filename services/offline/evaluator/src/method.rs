//! The methods that are evaluated on the same agents.

/// A forecasting method.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Method {
    /// The model.
    Network,
    /// The model with a retrieval memory that begins empty. Residuals of forecasts earlier in the recording
    /// correct new ones.
    OnlineRetrieval,
    /// The same, but the memory begins with the residuals of earlier recordings of the site.
    WarmStartedRetrieval,
    /// The model with a retrieval memory that begins empty, and with evidence: the default of a run.
    Evidence,
    /// The model's base control with the network switched off: ridge regression and anchors, B*.
    Base,
    /// Constant velocity plus 20 typical residuals.
    Anchors,
    /// Constant velocity in 20 directions, drawn around the observed one.
    SampledVelocity,
    /// Constant velocity.
    ConstantVelocity,
    /// Constant acceleration.
    ConstantAcceleration,
    /// Constant turn rate and speed.
    TurnRate,
    /// Decaying turn rate and acceleration.
    TurnRateAcceleration,
}

impl Method {
    /// All methods, in the order of the reports.
    pub const ALL: [Self; 11] = [
        Self::Network,
        Self::OnlineRetrieval,
        Self::WarmStartedRetrieval,
        Self::Evidence,
        Self::Base,
        Self::Anchors,
        Self::SampledVelocity,
        Self::ConstantVelocity,
        Self::ConstantAcceleration,
        Self::TurnRate,
        Self::TurnRateAcceleration,
    ];

    /// The variants of the model, whose forecasts have covariances and can be calibrated.
    pub const OURS: [Self; 4] =
        [Self::Network, Self::OnlineRetrieval, Self::WarmStartedRetrieval, Self::Evidence];

    /// The name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Network => "ours",
            Self::OnlineRetrieval => "ours, online retrieval",
            Self::WarmStartedRetrieval => "ours, warm-started retrieval",
            Self::Evidence => "ours, online retrieval, evidence",
            Self::Base => "B* (ridge + anchors)",
            Self::Anchors => "20 anchors",
            Self::SampledVelocity => "CVM-S",
            Self::ConstantVelocity => "constant velocity",
            Self::ConstantAcceleration => "constant acceleration",
            Self::TurnRate => "CTRV",
            Self::TurnRateAcceleration => "CTRA, decaying",
        }
    }

    /// Place in [`Method::ALL`].
    pub const fn index(self) -> usize {
        self as usize
    }
}
