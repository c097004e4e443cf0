//! Forecasts of agents without controls in this tick: the last learned forecast, or zero control.

use kinematics::{DisplacementKind, MotionKind, MotionOptions};
use scene::AgentType;
use wire::{Cause, Forecast, Quality, Rejected, Track};

use crate::held::HeldForecasts;
use crate::motion::{certain_motion, with_track_covariance};
use crate::published::{begin, is_within_the_world, limit_steps};
use crate::tick::Tick;
use crate::{Level, SamplerOptions, kinematic};

/// The newest learned forecasts, and the policy by which they are held.
pub(crate) struct Fallback {
    options: SamplerOptions,
    held: HeldForecasts,
    /// Time of the newest learned forecast of any agent; before the first forecast, the time of the first
    /// tick.
    newest_learned_ns: Option<i64>,
}

impl Fallback {
    pub(crate) fn new(options: SamplerOptions) -> Self {
        Self { options, held: HeldForecasts::new(), newest_learned_ns: None }
    }

    /// Starts the clock of the policy at the first tick.
    pub(crate) fn begin(&mut self, stamp_ns: i64) {
        self.newest_learned_ns.get_or_insert(stamp_ns);
    }

    /// Ends a session: no forecast is held, and the clock of the policy starts again.
    pub(crate) fn end_session(&mut self) {
        self.held.clear();
        self.newest_learned_ns = None;
    }

    /// Keeps a learned forecast.
    pub(crate) fn keep(&mut self, stamp_ns: i64, forecast: &Forecast) {
        self.held.keep(stamp_ns, forecast);
        self.newest_learned_ns = self.newest_learned_ns.max(Some(stamp_ns));
    }

    /// The level of a track without a learned forecast in this tick. `learned` states whether an earlier track
    /// of the tick has one.
    pub(crate) fn level(&self, tick: Tick, track: &Track, learned: bool) -> Level {
        let age_ns = self.held.find(track.id, tick.stamp_ns).map(|(_, age_ns)| age_ns);
        let newest_ns = if learned { Some(tick.stamp_ns) } else { None }.max(self.newest_learned_ns);
        let without_ns = tick.stamp_ns.saturating_sub(newest_ns.unwrap_or(tick.stamp_ns));
        self.options.degradation.level(age_ns, u64::try_from(without_ns).unwrap_or(0))
    }

    /// Writes a forecast of a level: held if the level is [`Level::Held`] and there is a forecast to hold, else
    /// kinematic.
    pub(crate) fn write(
        &self,
        tick: Tick,
        track: &Track,
        cause: Cause,
        level: Level,
        out: &mut Forecast,
    ) -> Result<(), Rejected> {
        let agent_type = track.agent_type()?;
        let cause = if track.forecastable == 0 { Cause::Young } else { cause };
        let held = self.held.find(track.id, tick.stamp_ns).filter(|_| level == Level::Held);
        let is_held = held.is_some_and(|(held, age_ns)| {
            begin(track, Quality::Held, cause, out);
            out.age_ns = age_ns;
            held.move_on((age_ns as f64 / tick.step_ns as f64) as f32, self.options.horizon_len, out);
            is_within_the_world(out)
        });
        if !is_held {
            begin(track, Quality::Kinematic, cause, out);
            self.write_kinematic(tick, track, agent_type, out);
        }
        limit_steps(out, self.options.horizon_len, self.options.step_max_m(agent_type, tick.dt_s()));
        Ok(())
    }

    fn write_kinematic(&self, tick: Tick, track: &Track, agent_type: AgentType, out: &mut Forecast) {
        let motion = MotionOptions { displacement: DisplacementKind::Residual, ..self.options.motion };
        let options = SamplerOptions { vehicle_motion: MotionKind::Bicycle, motion, ..self.options };
        // Recorded headings are courses. A learned forecast nevertheless starts at the recorded heading, as
        // in training: the network compensates for the slip.
        let model = certain_motion(track, agent_type, &options, tick.dt_s()).with_course_along_heading();
        let model = with_track_covariance(model, track);
        kinematic::forecast(model, agent_type, self.options.horizon_len, out);
    }
}
