use crate::Controlled;

/// The processes of a mixture, and its trust in a forecast.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Priors<P> {
    /// Process of the component without a forecast.
    pub kinematic: P,
    /// Process of the hypotheses. Its noise adds to the noise of their controls.
    pub learned: P,
    /// Process of the hypotheses at control gain 0, see [`Controlled::blended`].
    pub uncontrolled: P,
    /// Weight of the component without a forecast when one is adopted, within \[0, 1\].
    pub kinematic_weight: f64,
    /// Factor on the covariances of a forecast's controls.
    pub covariance_scale: f64,
    /// Gain of each component of a forecast's controls, within \[0, 1\], see
    /// [`control_gain`](crate::control_gain).
    pub control_gain: [f64; 2],
    /// Time constant T with which the gain fades in: by 1 − e^(−t/T) at the time t after the forecast's
    /// start. 0 applies the full gain immediately.
    ///
    /// At first the filtered state predicts its motion better than the forecast. This advantage shrinks as
    /// the last measurement ages.
    pub fade_in_s: f64,
}

impl<P: Copy> Priors<P> {
    /// A kinematic component of weight 0.05, and controls at gain 1. At gain 0 the process of the hypotheses
    /// is `kinematic`.
    #[must_use]
    pub const fn new(kinematic: P, learned: P) -> Self {
        Self {
            kinematic,
            learned,
            uncontrolled: kinematic,
            kinematic_weight: 0.05,
            covariance_scale: 1.0,
            control_gain: [1.0; 2],
            fade_in_s: 0.0,
        }
    }

    /// Process of the hypotheses at this gain of their controls.
    pub(crate) fn controlled<const N: usize>(&self, control_gain: [f64; 2]) -> P
    where
        P: Controlled<N>,
    {
        self.learned.blended(&self.uncontrolled, control_gain)
    }
}
