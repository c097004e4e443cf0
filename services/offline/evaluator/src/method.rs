//! The methods that are evaluated on the same agents.

wire::named! {
    /// A forecasting method.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Method {
        /// The model.
        Network => "ours",
        /// The model with a retrieval memory that begins empty. Residuals of forecasts earlier in the recording
        /// correct new ones.
        OnlineRetrieval => "ours, online retrieval",
        /// The same, but the memory begins with the residuals of earlier recordings of the site.
        WarmStartedRetrieval => "ours, warm-started retrieval",
        /// The model with a retrieval memory that begins empty, and with evidence: the default of a run.
        Evidence => "ours, online retrieval, evidence",
        /// The model's base control with the network switched off: ridge regression and anchors, B*.
        Base => "B* (ridge + anchors)",
        /// Constant velocity plus 20 typical residuals.
        Anchors => "20 anchors",
        /// Constant velocity in 20 directions, drawn around the observed one.
        SampledVelocity => "CVM-S",
        /// Constant velocity.
        ConstantVelocity => "constant velocity",
        /// Constant acceleration.
        ConstantAcceleration => "constant acceleration",
        /// Constant turn rate and speed.
        TurnRate => "CTRV",
        /// Decaying turn rate and acceleration.
        TurnRateAcceleration => "CTRA, decaying",
    }
}

impl Method {
    /// The methods that the stages forecast, which are the first ones.
    pub(crate) const STAGES: usize = Self::Base.index() + 1;
    /// The variants of the model, whose forecasts have covariances and can be calibrated.
    pub const OURS: [Self; 4] =
        [Self::Network, Self::OnlineRetrieval, Self::WarmStartedRetrieval, Self::Evidence];

    /// Place in [`Method::ALL`].
    pub const fn index(self) -> usize {
        self as usize
    }
}
