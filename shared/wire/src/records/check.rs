//! The valid values of a record's numbers: stages call `check` on everything that they take from a port.

use super::{AgentControls, AgentEncoding, AgentFeatures, Detection, Forecast, Track};
use crate::{
    AgentType, CONFLICTS_MAX, MODES_MAX, OFFSET_MAX_NS, POSITION_MAX_M, Rejected, SENSORS_MAX, SPEED_MAX_MPS,
    UnknownAgentType, at_most, finite,
};

fn position(field: &'static str, values: &[f32]) -> Result<(), Rejected> {
    finite(field, values)?;
    match values.iter().find(|x| x.abs() > POSITION_MAX_M) {
        Some(&value) => Err(Rejected::Impossible { field, value: f64::from(value) }),
        None => Ok(()),
    }
}

fn speed(field: &'static str, value: f32) -> Result<(), Rejected> {
    finite(field, &[value])?;
    if value.abs() > SPEED_MAX_MPS {
        return Err(Rejected::Impossible { field, value: f64::from(value) });
    }
    Ok(())
}

fn noise(values: [f32; 3]) -> Result<(), Rejected> {
    finite("detector noise", &values)?;
    match values.into_iter().find(|value| *value < 0.0) {
        Some(value) => Err(Rejected::Impossible { field: "detector noise", value: f64::from(value) }),
        None => Ok(()),
    }
}

fn agent_type(number: u32) -> Result<AgentType, Rejected> {
    AgentType::try_from(number)
        .map_err(|UnknownAgentType(_)| Rejected::Impossible { field: "agent_type", value: f64::from(number) })
}

impl Detection {
    /// The kind of object; [`Detection::check`] refuses invalid numbers.
    ///
    /// # Errors
    /// [`Rejected::Impossible`] if the number stands for no type.
    pub fn agent_type(&self) -> Result<AgentType, Rejected> {
        agent_type(self.agent_type)
    }

    /// Whether all bits of `flag` are set.
    #[must_use]
    pub const fn has(&self, flag: u32) -> bool {
        self.flags & flag == flag
    }

    /// Refuses numbers that are not finite or impossible.
    ///
    /// # Errors
    /// [`Rejected`] names the field.
    pub fn check(&self) -> Result<(), Rejected> {
        agent_type(self.agent_type)?;
        position("detection position", &[self.x_m, self.y_m])?;
        speed("detection speed", self.speed_mps)?;
        if self.offset_ns.unsigned_abs() > OFFSET_MAX_NS {
            let value = self.offset_ns as f64;
            return Err(Rejected::Impossible { field: "detection offset_ns", value });
        }
        if usize::from(self.sensor) > SENSORS_MAX {
            return Err(Rejected::Impossible { field: "detection sensor", value: f64::from(self.sensor) });
        }
        finite("detection", &[self.heading_rad, self.length_m, self.width_m, self.score, self.sigma_m])?;
        let negative = [("length_m", self.length_m), ("width_m", self.width_m), ("sigma_m", self.sigma_m)];
        match negative.into_iter().find(|(_, value)| *value < 0.0) {
            Some((field, value)) => Err(Rejected::Impossible { field, value: f64::from(value) }),
            None => Ok(()),
        }
    }
}

impl Track {
    /// Number of states in its history from which a track is forecast: with one, its motion is unknown.
    pub const STATES_MIN: u32 = 2;

    /// The kind of agent.
    ///
    /// # Errors
    /// [`Rejected::Impossible`] if the number stands for no type.
    pub fn agent_type(&self) -> Result<AgentType, Rejected> {
        agent_type(self.agent_type)
    }

    /// The learned noise of position, heading and speed, in m, rad and m/s; 0 if it is unknown.
    #[must_use]
    pub const fn noise(&self) -> [f32; 3] {
        [self.noise_m, self.noise_heading_rad, self.noise_speed_mps]
    }

    /// Refuses numbers that are not finite or impossible.
    ///
    /// # Errors
    /// [`Rejected`] names the field.
    pub fn check(&self) -> Result<(), Rejected> {
        agent_type(self.agent_type)?;
        noise(self.noise())?;
        position("track position", &[self.x_m, self.y_m])?;
        speed("track speed", self.speed_mps)?;
        finite(
            "track",
            &[self.heading_rad, self.slip_rad, self.vx_mps, self.vy_mps, self.length_m, self.width_m],
        )?;
        finite("existence", &[self.existence])?;
        finite("type probabilities", &self.type_probability)?;
        finite("track covariance", &self.covariance)?;
        finite("weights of the prior", &self.prior_weights)?;
        for state in &self.history {
            position("history position", &[state.x_m, state.y_m])?;
            finite("history", &[state.vx_mps, state.vy_mps, state.heading_rad])?;
        }
        Ok(())
    }
}

/// Refuses states beyond the model's history.
fn presence(present: u32, history_len: usize) -> Result<(), Rejected> {
    match present.checked_shr(history_len as u32) {
        None | Some(0) => Ok(()),
        Some(_) => Err(Rejected::Impossible { field: "presence", value: f64::from(present) }),
    }
}

impl AgentFeatures {
    /// The identity of a track, without its features.
    #[must_use]
    pub fn of(track: &Track) -> Self {
        let &Track { id, agent_type, forecastable, length_m, .. } = track;
        Self { id, agent_type, forecastable, length_m, ..Self::default() }
    }

    /// Whether the agent has a state at a history step.
    #[must_use]
    pub const fn is_present(&self, step: usize) -> bool {
        self.present >> step & 1 == 1
    }

    /// Refuses numbers that are not finite or impossible in a model with this history.
    ///
    /// # Errors
    /// [`Rejected`] names the field.
    pub fn check(&self, history_len: usize) -> Result<(), Rejected> {
        agent_type(self.agent_type)?;
        presence(self.present, history_len)?;
        finite("length_m", &[self.length_m])?;
        finite("state features", self.state.as_flattened())?;
        finite("node attributes", self.node.as_flattened())
    }
}

impl AgentEncoding {
    /// All columns of an agent's features except its node attributes. The summary is 0.
    #[must_use]
    pub fn of(features: &AgentFeatures) -> Self {
        let &AgentFeatures { id, agent_type, forecastable, present, length_m, state, turn, shed, .. } =
            features;
        Self { id, agent_type, forecastable, present, length_m, state, turn, shed, ..Self::default() }
    }

    /// Whether the agent has a state at a history step.
    #[must_use]
    pub const fn is_present(&self, step: usize) -> bool {
        self.present >> step & 1 == 1
    }

    /// Refuses numbers that are not finite or impossible in a model with this history.
    ///
    /// # Errors
    /// [`Rejected`] names the field.
    pub fn check(&self, history_len: usize) -> Result<(), Rejected> {
        agent_type(self.agent_type)?;
        presence(self.present, history_len)?;
        finite("length_m", &[self.length_m])?;
        finite("state features", self.state.as_flattened())?;
        finite("temporal summary", &self.temporal)
    }
}

impl AgentControls {
    /// The identity of an agent, without controls.
    #[must_use]
    pub fn of(encoding: &AgentEncoding) -> Self {
        Self { id: encoding.id, agent_type: encoding.agent_type, ..Self::default() }
    }

    /// Refuses numbers that are not finite or impossible.
    ///
    /// # Errors
    /// [`Rejected`] names the field.
    pub fn check(&self) -> Result<(), Rejected> {
        agent_type(self.agent_type)?;
        if self.modes_len == 0 {
            return Err(Rejected::Impossible { field: "modes_len", value: 0.0 });
        }
        at_most("modes_len", self.modes_len as usize, MODES_MAX)?;
        finite("mode probabilities", &self.probability)?;
        let numbers: &[f32] = bytemuck::cast_slice(self.modes.as_flattened());
        finite("controls", numbers)?;
        finite("best controls", bytemuck::cast_slice(&self.best))?;
        finite("base controls", self.base.as_flattened())?;
        finite("out of distribution", &[self.out_of_distribution])
    }
}

impl Forecast {
    /// The learned noise of position, heading and speed, in m, rad and m/s; 0 if it is unknown.
    #[must_use]
    pub const fn noise(&self) -> [f32; 3] {
        [self.noise_m, self.noise_heading_rad, self.noise_speed_mps]
    }

    /// Zeroes this forecast, then copies a track's identity, state, size, prior and noise.
    pub fn begin(&mut self, track: &Track) {
        // Zeroed in place, because a value would be written twice.
        bytemuck::write_zeroes(self);
        (self.id, self.source_id, self.agent_type) = (track.id, track.source_id, track.agent_type);
        (self.x_m, self.y_m, self.heading_rad) = (track.x_m, track.y_m, track.heading_rad);
        (self.vx_mps, self.vy_mps) = (track.vx_mps, track.vy_mps);
        (self.length_m, self.width_m) = (track.length_m, track.width_m);
        (self.prior, self.prior_age_ns) = (track.prior, track.prior_age_ns);
        [self.noise_m, self.noise_heading_rad, self.noise_speed_mps] = track.noise();
    }

    /// Refuses numbers that are not finite or impossible.
    ///
    /// # Errors
    /// [`Rejected`] names the field.
    pub fn check(&self) -> Result<(), Rejected> {
        agent_type(self.agent_type)?;
        noise(self.noise())?;
        position("forecast position", &[self.x_m, self.y_m])?;
        finite(
            "forecast",
            &[
                self.vx_mps,
                self.vy_mps,
                self.heading_rad,
                self.length_m,
                self.width_m,
                self.out_of_distribution,
            ],
        )?;
        at_most("conflicts_len", self.conflicts_len as usize, CONFLICTS_MAX)?;
        finite(
            "conflicts",
            self.conflicts.map(|of| [of.probability, of.if_nobody_reacts, of.in_s]).as_flattened(),
        )?;
        finite("expert weights", &self.expert_weights)?;
        finite("forecast modes", self.modes.as_flattened().as_flattened())?;
        finite("best forecast", self.best.as_flattened())?;
        finite("forecast mean", self.mean.as_flattened())?;
        finite("forecast covariance", self.covariance.as_flattened())?;
        finite("covariance of the modes", self.mode_covariance.as_flattened().as_flattened())?;
        self.check_controls()
    }

    /// The part of [`Self::check`] that is sufficient for a reader of the controls.
    ///
    /// # Errors
    /// [`Rejected`] names the field.
    pub fn check_controls(&self) -> Result<(), Rejected> {
        finite("heading of the controls", &[self.frame_heading_rad])?;
        finite("mode probabilities", &self.probability)?;
        finite("forecast controls", bytemuck::cast_slice(self.controls.as_flattened()))
    }
}
