use filters::ControlStep;
use wire::{Forecast, HORIZON_MAX, Header, MODES_MAX, Rejected, SPEED_MAX_MPS, Steering};

/// Largest acceleration, m/s², and slip rate, rad/s, of any road user.
const BICYCLE_MAX: [f32; 2] = [50.0, 10.0];

/// The forecasts of an earlier tick, from which estimates take their priors.
#[derive(Debug)]
pub struct Forecasts<'a> {
    header: &'a Header,
    forecasts: &'a [Forecast],
    /// Start of the next search. Forecasts have the order of the tracks, which is the order of the estimates.
    next: usize,
}

/// The forecast of one agent as controls, mode by mode, in reusable memory.
#[derive(Clone, Debug)]
pub struct Controls {
    probability: [f64; MODES_MAX],
    modes_len: usize,
    steps: Vec<ControlStep>,
}

impl<'a> Forecasts<'a> {
    /// The forecasts of a frame. Returns `None` if the frame is not a tick or has no forecasts.
    ///
    /// # Errors
    /// [`Rejected`] if the header is impossible.
    pub fn new(header: &'a Header, forecasts: &'a [Forecast]) -> Result<Option<Self>, Rejected> {
        if !header.is_tick() || forecasts.is_empty() {
            return Ok(None);
        }
        header.check()?;
        let (field, value) = match (header.step_ns, header.counts.horizon_len) {
            (0, _) => ("step_ns", 0.0),
            (_, 0) => ("horizon_len", 0.0),
            _ => return Ok(Some(Self { header, forecasts, next: 0 })),
        };
        Err(Rejected::Impossible { field, value })
    }

    /// The forecast of a track. It usually follows the one found last.
    pub fn find(&mut self, id: u64) -> Option<&'a Forecast> {
        let len = self.forecasts.len();
        let found = (self.next..len).chain(0..self.next.min(len)).find(|&i| self.forecasts[i].id == id)?;
        self.next = found + 1;
        Some(&self.forecasts[found])
    }

    /// Stamp of a forecast's controls.
    #[must_use]
    pub fn controls_ns(&self, forecast: &Forecast) -> i64 {
        self.header.stamp_ns.saturating_sub_unsigned(forecast.age_ns)
    }

    /// Time between the steps of all forecasts.
    #[must_use]
    pub const fn step_ns(&self) -> u64 {
        self.header.step_ns
    }

    const fn horizon_len(&self) -> usize {
        self.header.counts.horizon_len as usize
    }
}

impl Controls {
    /// Memory for the controls of any forecast.
    #[must_use]
    pub fn new() -> Self {
        Self {
            probability: [0.0; MODES_MAX],
            modes_len: 0,
            steps: Vec::with_capacity(MODES_MAX * HORIZON_MAX),
        }
    }

    /// Reads the controls of a forecast. They fade in: `fade_in_s` after their stamp, their share is 1 − 1/e.
    ///
    /// # Errors
    /// [`Rejected`] if a number is not finite or is impossible.
    pub fn read(
        &mut self,
        of: &Forecasts<'_>,
        forecast: &Forecast,
        steering: Steering,
        fade_in_s: f64,
    ) -> Result<(), Rejected> {
        forecast.check_controls()?;
        self.modes_len = forecast.modes_len as usize;
        if !(1..=MODES_MAX).contains(&self.modes_len) {
            let (found, most) = (u64::from(forecast.modes_len), MODES_MAX as u64);
            return Err(Rejected::TooMany { field: "modes_len", found, most });
        }
        let step_s = of.step_ns() as f64 / 1e9;
        let most = match steering {
            Steering::Bicycle => BICYCLE_MAX,
            Steering::None | Steering::Displacement => [SPEED_MAX_MPS * step_s as f32; 2],
        };
        self.probability = forecast.probability.map(f64::from);
        self.steps.clear();
        for steps in &forecast.controls[..self.modes_len] {
            for (number, control) in steps[..of.horizon_len()].iter().enumerate() {
                if let Some((&value, _)) = control.mean.iter().zip(most).find(|(u, most)| u.abs() > *most) {
                    return Err(Rejected::Impossible { field: "control", value: f64::from(value) });
                }
                let middle_s = (number as f64 + 0.5) * step_s;
                let share = if fade_in_s > 0.0 { 1.0 - (-middle_s / fade_in_s).exp() } else { 1.0 };
                self.steps.push(ControlStep {
                    mean: control.mean.map(|value| share * f64::from(value)),
                    cholesky: control.cholesky.map(f64::from),
                });
            }
        }
        Ok(())
    }

    /// The controls in the form of the filters, `age_ns` after their stamp.
    #[must_use]
    pub fn forecast(&self, age_ns: u64, step_ns: u64, heading_rad: f64) -> filters::Forecast<'_> {
        let probability = &self.probability[..self.modes_len];
        filters::Forecast { age_ns, step_ns, heading_rad, probability, controls: &self.steps }
    }
}
