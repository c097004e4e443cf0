//! The methods that are judged, side by side on the same agents.

/// A forecaster that is judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Method {
    /// The model.
    Network,
    /// The model with the memory of the place: how those who came by earlier in the recording departed from its forecasts.
    Recalling,
    /// The same with a memory that begins with what earlier recordings of the place showed.
    Revisiting,
    /// The model's base control with the network switched off: ridge regression and anchors, B*.
    Base,
    /// Constant velocity plus 20 typical residuals.
    Anchors,
    /// Constant velocity in 20 directions drawn around the true one.
    SampledVelocity,
    /// Constant velocity.
    ConstantVelocity,
    /// Constant acceleration.
    ConstantAcceleration,
    /// Constant turn rate and speed.
    TurnRate,
    /// Turn rate and acceleration that die away.
    TurnRateAcceleration,
}

impl Method {
    /// All methods, in the order of the reports.
    pub const ALL: [Self; 10] = [
        Self::Network,
        Self::Recalling,
        Self::Revisiting,
        Self::Base,
        Self::Anchors,
        Self::SampledVelocity,
        Self::ConstantVelocity,
        Self::ConstantAcceleration,
        Self::TurnRate,
        Self::TurnRateAcceleration,
    ];

    /// Those that are the model's: they say how sure they are.
    pub const OURS: [Self; 3] = [Self::Network, Self::Recalling, Self::Revisiting];

    /// The name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Network => "ours",
            Self::Recalling => "ours, recalling",
            Self::Revisiting => "ours, revisiting",
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
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }
}
