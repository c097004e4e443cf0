use crate::{Control, ControlStep, Controlled, Forecast, ForecastFault, Priors};

/// The controls of all hypotheses, by time since the forecast's start.
#[derive(Debug, Default)]
pub(crate) struct Plan {
    steps: Vec<ControlStep>,
    /// Number of steps of each hypothesis.
    step_count: usize,
    step_ns: u64,
    heading_rad: f64,
    covariance_scale: f64,
    control_gain: [f64; 2],
    fade_in_s: f64,
    pub horizon_ns: u64,
}

impl Plan {
    /// Copies a forecast and the priors' trust in it.
    ///
    /// # Errors
    /// [`ForecastFault`]; the plan is then unchanged.
    pub fn adopt<P>(&mut self, forecast: &Forecast, priors: &Priors<P>) -> Result<(), ForecastFault> {
        forecast.check()?;
        self.steps.clear();
        self.steps.extend_from_slice(forecast.controls);
        self.step_count = forecast.step_count();
        self.step_ns = forecast.step_ns;
        self.heading_rad = forecast.heading_rad;
        self.covariance_scale = priors.covariance_scale;
        self.control_gain = priors.control_gain;
        self.fade_in_s = priors.fade_in_s;
        self.horizon_ns = forecast.horizon_ns();
        Ok(())
    }

    /// Gain of each component of the controls at a time since the forecast's start.
    pub fn gain(&self, time_ns: u64) -> [f64; 2] {
        let faded_in = -(-(time_ns as f64 / 1e9) / self.fade_in_s).exp_m1();
        self.control_gain.map(|gain| if self.fade_in_s > 0.0 { gain * faded_in } else { gain })
    }

    /// The control input of a hypothesis for the process `P`, at a time since the forecast's start.
    pub fn at<P: Controlled<N>, const N: usize>(&self, hypothesis: usize, time_ns: u64) -> Control {
        let number = match time_ns.checked_sub(P::first_ns(self.step_ns)) {
            None => 0,
            Some(after_ns) => 1 + (after_ns / self.step_ns.max(1)) as usize,
        };
        let steps = &self.steps[hypothesis * self.step_count..][..self.step_count];
        let Control { rate: [first, second], density } =
            P::control(steps, number, self.step_ns as f64 / 1e9, self.heading_rad);
        let [a, b] = self.gain(time_ns);
        let gains = [a * a, a * b, b * b];
        let scaled = |i: usize| self.covariance_scale * gains[i] * density[i];
        Control { rate: [a * first, b * second], density: [scaled(0), scaled(1), scaled(2)] }
    }
}

impl Clone for Plan {
    fn clone(&self) -> Self {
        Self { steps: self.steps.clone(), ..*self }
    }

    /// Reuses the memory of the steps.
    fn clone_from(&mut self, source: &Self) {
        let mut steps = std::mem::take(&mut self.steps);
        steps.clone_from(&source.steps);
        *self = Self { steps, ..*source };
    }
}
