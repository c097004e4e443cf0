use std::sync::Arc;

use evidence::{Evidence, Prior, Priors};
use kinematics::{DisplacementKind, MotionKind, MotionOptions, Normals, PARTICLES_MAX};
use lanes::LaneMap;
use retrieval::{ControlChanges, Key, Query, Retrieval, RetrievalMemory};
use scene::{AgentType, track_history};
use wire::{
    AGENTS_MAX, AgentControls, Cause, Forecast, HISTORY_MAX, HORIZON_MAX, Header, POSITION_MAX_M, Quality,
    Rejected, SPEED_MAX_MPS, Track, finite, flags,
};

use crate::experts::{Experts, Spread};
use crate::guidance::Guidance;
use crate::held::HeldForecasts;
use crate::journal::{Journal, Resumed, Storage};
use crate::learned::LearnedControls;
use crate::motion::{certain_motion, with_track_covariance};
use crate::{Level, Propagation, SamplerOptions, kinematic};

/// Makes a forecast for every track.
pub struct Sampler {
    options: SamplerOptions,
    held: HeldForecasts,
    /// None where nothing is to be retrieved, or no tick came yet.
    retrieval: Option<Retrieval>,
    /// What is expected of the experts before any forecast has matured.
    prior: Prior,
    /// None where evidence does not count, or no tick came yet.
    experts: Option<Experts>,
    /// None where no map of lanes is known.
    guidance: Option<Guidance>,
    /// When an agent had a learned forecast last or, before the first, the time of the first tick.
    newest_learned_ns: Option<i64>,
    resumed_ticks: u64,
    /// Scratch: the changes of the agent in hand.
    changes: ControlChanges,
}

/// The part of a header that the forecasts depend on.
#[derive(Clone, Copy)]
struct Tick {
    stamp_ns: i64,
    seq: u64,
    step_ns: u64,
}

impl Tick {
    fn dt_s(&self) -> f32 {
        (self.step_ns as f64 * 1e-9) as f32
    }
}

impl Sampler {
    /// A sampler that holds no forecasts yet.
    ///
    /// # Panics
    /// Where history, horizon or particles are more than the payloads can hold.
    #[must_use]
    pub fn new(options: SamplerOptions) -> Self {
        assert!((1..=HISTORY_MAX).contains(&options.history_len), "history of {} steps", options.history_len);
        assert!((1..=HORIZON_MAX).contains(&options.horizon_len), "horizon of {} steps", options.horizon_len);
        if let Propagation::MonteCarlo { particles } = options.propagation {
            assert!((1..=PARTICLES_MAX).contains(&particles), "{particles} particles");
        }
        let changes = ControlChanges::default();
        let prior = if options.evidence { Priors::shipped().mean(|_| true) } else { Prior::default() };
        Self {
            options,
            held: HeldForecasts::new(),
            retrieval: None,
            prior,
            experts: None,
            guidance: None,
            newest_learned_ns: None,
            resumed_ticks: 0,
            changes,
        }
    }

    /// Retrieves from now on from a memory of forecasts of the same model.
    pub fn warm_start(&mut self, memory: RetrievalMemory) {
        self.retrieval = Some(Retrieval::new(memory));
    }

    /// Takes the forecasts of vehicles along these lanes from now on.
    pub fn guide_along(&mut self, map: Arc<LaneMap>) {
        self.guidance = Some(Guidance::new(map));
    }

    /// Expects of the experts from the first tick on what `prior` says, not what is shipped.
    pub fn expect(&mut self, prior: Prior) {
        self.prior = prior;
    }

    /// Goes on with what an earlier sampler of the same model has learned of its experts, as after the end of
    /// its session.
    pub fn continue_from(&mut self, earlier: Self) {
        if self.options.evidence {
            self.experts = earlier.experts;
            self.experts.iter_mut().for_each(Experts::end_session);
        }
    }

    /// Keeps the learned forecasts that the sampler before has sent, to hold them as it would have. A process that
    /// waits for its turn does so with every frame, and computes nothing.
    pub fn follow(&mut self, header: &Header, forecasts: &[Forecast]) {
        if !header.is_tick() || header.has(flags::VOID) {
            return;
        }
        let stamp_ns = header.stamp_ns;
        self.newest_learned_ns.get_or_insert(stamp_ns);
        let learned = |forecast: &&Forecast| forecast.quality == Quality::Learned as u32;
        for forecast in forecasts.iter().filter(learned).filter(|forecast| forecast.check().is_ok()) {
            self.held.keep(stamp_ns, forecast);
            self.newest_learned_ns = self.newest_learned_ns.max(Some(stamp_ns));
        }
    }

    /// Its settings.
    #[must_use]
    pub const fn options(&self) -> &SamplerOptions {
        &self.options
    }

    /// Commits what was learned of the ticks that lie behind.
    ///
    /// # Errors
    /// As [`Journal::commit`].
    pub fn commit<S: Storage>(&mut self, ticks: u64, journal: &mut Journal<S>) -> Result<(), String> {
        let memory = self.retrieval.as_ref().map(Retrieval::memory);
        journal.commit(ticks, memory, self.experts.as_mut().map(Experts::evidence_mut))
    }

    /// Goes on with what an earlier process of the run's sampler has learned, as if all agents were new.
    ///
    /// # Errors
    /// What is impossible in it; then nothing has changed.
    pub fn resume(&mut self, resumed: Resumed) -> Result<(), &'static str> {
        if let Some(numbers) = resumed.evidence {
            let mut experts = Experts::new(self.options.horizon_len, resumed.step_ns, &self.prior);
            experts.evidence_mut().resume(&numbers)?;
            self.experts = Some(experts);
        }
        if let Some(memory) = resumed.memory {
            self.retrieval = Some(Retrieval::new(memory));
        }
        self.resumed_ticks = resumed.ticks;
        Ok(())
    }

    /// Ticks that lay behind what it has resumed; 0 where it has not.
    #[must_use]
    pub fn resumed_ticks(&self) -> u32 {
        u32::try_from(self.resumed_ticks).unwrap_or(0)
    }

    /// The retrieval memory; none where nothing is to be retrieved, or no tick came yet.
    #[must_use]
    pub fn memory(&self) -> Option<&RetrievalMemory> {
        self.retrieval.as_ref().map(Retrieval::memory)
    }

    /// The evidence on the experts; none where it does not count, or no tick came yet.
    #[must_use]
    pub fn evidence(&self) -> Option<&Evidence> {
        self.experts.as_ref().map(Experts::evidence)
    }

    /// Writes a forecast per track, in the tracks' order, by the controls of the same tick, and returns how many:
    /// agents of which the policy of degradation says nothing are left out.
    ///
    /// A track without controls, or whose controls are refused or lead out of the world, gets a held or
    /// kinematic forecast with its cause, without effect on the other tracks; the header tells of whom there are
    /// none to save time ([`Header::shed`]). Controls without a track are
    /// left out. A call with an older tick than before is allowed: its forecasts are held where none newer
    /// is.
    ///
    /// # Errors
    /// [`Rejected`] where header or tracks are impossible; nothing was written or changed.
    ///
    /// # Panics
    /// Where `out` has not one place per track.
    pub fn learned(
        &mut self,
        header: &Header,
        tracks: &[Track],
        controls: &[AgentControls],
        out: &mut [Forecast],
    ) -> Result<usize, Rejected> {
        let tick = check(header, tracks, out)?;
        self.observe(tick, tracks);
        let (mut next, mut written) = (0, 0);
        for (place, track) in tracks.iter().enumerate() {
            let out = &mut out[written];
            // Controls come in the tracks' order: the search mostly ends where it begins.
            let found = (next..controls.len())
                .chain(0..next.min(controls.len()))
                .find(|i| controls[*i].id == track.id);
            let cause = match found {
                Some(found) => {
                    next = found + 1;
                    self.learned_one(tick, track, &controls[found], out).err()
                }
                None if header.is_shed(place) => Some(Cause::Shed),
                None => Some(Cause::Missing),
            };
            let is_written = match cause {
                Some(cause) => self.fall_back(tick, track, cause, out)?,
                None => true,
            };
            written += usize::from(is_written);
        }
        Ok(written)
    }

    /// Writes a forecast per track, in the tracks' order, without controls, and returns how many, as
    /// [`Sampler::learned`] does.
    ///
    /// # Errors
    /// [`Rejected`] where header or tracks are impossible; nothing was written or changed.
    ///
    /// # Panics
    /// Where `out` has not one place per track.
    pub fn fallback(
        &mut self,
        header: &Header,
        tracks: &[Track],
        cause: Cause,
        out: &mut [Forecast],
    ) -> Result<usize, Rejected> {
        let tick = check(header, tracks, out)?;
        self.observe(tick, tracks);
        let mut written = 0;
        for track in tracks {
            written += usize::from(self.fall_back(tick, track, cause, &mut out[written])?);
        }
        Ok(written)
    }

    /// Gives the retrieval memory the positions of all agents that were detected in this tick.
    fn observe(&mut self, tick: Tick, tracks: &[Track]) {
        self.newest_learned_ns.get_or_insert(tick.stamp_ns);
        if self.options.retrieval && tick.step_ns > 0 {
            let new = || Retrieval::new(RetrievalMemory::new(self.options.horizon_len, tick.step_ns));
            let detected = tracks.iter().filter(|track| track.unseen_ns == 0);
            let positions_m = detected.map(|track| (track.id, [track.x_m, track.y_m]));
            self.retrieval.get_or_insert_with(new).observe(tick.stamp_ns, positions_m);
        }
        if self.options.evidence && tick.step_ns > 0 {
            let new = || Experts::new(self.options.horizon_len, tick.step_ns, &self.prior);
            let detected = tracks.iter().filter(|track| track.unseen_ns == 0);
            let positions_m = detected.map(|track| (track.id, [track.x_m, track.y_m]));
            self.experts.get_or_insert_with(new).observe(tick.stamp_ns, positions_m);
        }
    }

    fn learned_one(
        &mut self,
        tick: Tick,
        track: &Track,
        controls: &AgentControls,
        out: &mut Forecast,
    ) -> Result<(), Cause> {
        let agent_type = track.agent_type().map_err(|_| Cause::Rejected)?;
        let controls =
            LearnedControls::new(controls, self.options.horizon_len).map_err(|_| Cause::Rejected)?;
        let mut model = certain_motion(track, agent_type, &self.options, tick.dt_s());
        let history = &track_history(track)[..self.options.history_len];
        let key = || Key::new(model.kind(), history, tick.dt_s());
        match self.retrieval.as_mut().and_then(|retrieval| Some((retrieval, key()?))) {
            Some((retrieval, key)) => {
                let query = Query { stamp_ns: tick.stamp_ns, agent: track.id, key };
                retrieval.adapt(&query, &model, &controls.as_decoded(), &mut self.changes);
            }
            None => self.changes.reset(controls.probability()),
        }
        if let Some(guidance) = &mut self.guidance {
            let decoded = controls.as_decoded();
            guidance.change((track, agent_type), &model, &decoded, tick.dt_s(), &mut self.changes);
        }
        let mut blended = self.experts.as_ref().map(|experts| {
            let decoded = controls.as_decoded();
            let network = self.changes.best(&decoded);
            experts.blend((track, agent_type), history, &model, (network, controls.base()), tick.dt_s())
        });
        if let Some((experts, blended)) = self.experts.as_ref().zip(blended.as_mut()) {
            let decoded = controls.as_decoded();
            experts.change(tick.stamp_ns, &model, &decoded, blended, &mut self.changes);
        }
        if self.options.initial_covariance {
            model = with_track_covariance(model, track);
        }
        let mut normals = Normals::new(self.options.seed, track.id, tick.seq);
        begin(track, Quality::Learned, Cause::None, out);
        out.out_of_distribution = controls.out_of_distribution();
        let spread = blended.as_ref().map_or_else(Spread::default, |blended| blended.spread);
        controls.forecast(&self.changes, &spread, &model, self.options.propagation, &mut normals, out);
        if let Some((experts, blended)) = self.experts.as_mut().zip(blended) {
            experts.publish(tick.stamp_ns, &blended, out);
        }
        if !is_within_the_world(out) {
            return Err(Cause::Rejected);
        }
        self.held.keep(tick.stamp_ns, out);
        self.newest_learned_ns = self.newest_learned_ns.max(Some(tick.stamp_ns));
        Ok(())
    }

    /// Held, kinematic or nothing, by the policy; whether something was written.
    fn fall_back(
        &self,
        tick: Tick,
        track: &Track,
        cause: Cause,
        out: &mut Forecast,
    ) -> Result<bool, Rejected> {
        let agent_type = track.agent_type()?;
        let cause = if track.forecastable == 0 { Cause::Young } else { cause };
        let found = self.held.find(track.id, tick.stamp_ns);
        let newest_ns = self.newest_learned_ns.unwrap_or(tick.stamp_ns);
        let without_ns = u64::try_from(tick.stamp_ns.saturating_sub(newest_ns)).unwrap_or(0);
        let level = self.options.degradation.level(found.as_ref().map(|(_, age_ns)| *age_ns), without_ns);
        if level == Level::Silent {
            return Ok(false);
        }
        if let Some((held, age_ns)) = found.filter(|_| level == Level::Held) {
            begin(track, Quality::Held, cause, out);
            out.age_ns = age_ns;
            held.move_on((age_ns as f64 / tick.step_ns as f64) as f32, self.options.horizon_len, out);
            if is_within_the_world(out) {
                return Ok(true);
            }
        }
        begin(track, Quality::Kinematic, cause, out);
        self.write_kinematic(tick, track, agent_type, out);
        Ok(true)
    }

    fn write_kinematic(&self, tick: Tick, track: &Track, agent_type: AgentType, out: &mut Forecast) {
        let motion = MotionOptions { displacement: DisplacementKind::Residual, ..self.options.motion };
        let options = SamplerOptions { vehicle_motion: MotionKind::Bicycle, motion, ..self.options };
        // Recorded headings are courses. A learned forecast begins at the recorded heading all the same, as
        // in training: the network compensates for the slip.
        let model = certain_motion(track, agent_type, &options, tick.dt_s()).with_course_along_heading();
        let model = with_track_covariance(model, track);
        kinematic::forecast(model, agent_type, self.options.horizon_len, out);
    }
}

/// Begins a forecast with what it contains of its track; all else is 0.
fn begin(track: &Track, quality: Quality, cause: Cause, out: &mut Forecast) {
    // In place: as a value it would be written twice.
    bytemuck::write_zeroes(out);
    (out.id, out.source_id, out.agent_type) = (track.id, track.source_id, track.agent_type);
    (out.quality, out.cause, out.causes) = (quality as u32, cause as u32, cause.bit());
    (out.x_m, out.y_m, out.heading_rad) = (track.x_m, track.y_m, track.heading_rad);
    (out.vx_mps, out.vy_mps) = (track.vx_mps, track.vy_mps);
    (out.length_m, out.width_m) = (track.length_m, track.width_m);
    (out.prior, out.prior_age_ns) = (track.prior, track.prior_age_ns);
}

fn is_within_the_world(forecast: &Forecast) -> bool {
    // Without an early end, so that it vectorises.
    let inside = |points: &[[f32; 2]]| {
        points.as_flattened().iter().fold(true, |inside, x| inside & (x.abs() <= POSITION_MAX_M))
    };
    let is_finite = |values: &[[f32; 3]]| finite("covariance", values.as_flattened()).is_ok();
    inside(forecast.modes.as_flattened())
        && inside(&forecast.best)
        && is_finite(&forecast.covariance)
        && is_finite(forecast.mode_covariance.as_flattened())
}

fn check(header: &Header, tracks: &[Track], out: &[Forecast]) -> Result<Tick, Rejected> {
    assert_eq!(out.len(), tracks.len(), "a place per track");
    header.check()?;
    if tracks.len() > AGENTS_MAX {
        let (found, most) = (tracks.len() as u64, AGENTS_MAX as u64);
        return Err(Rejected::TooMany { field: "tracks", found, most });
    }
    if header.step_ns == 0 && !tracks.is_empty() {
        return Err(Rejected::Impossible { field: "step_ns", value: 0.0 });
    }
    for track in tracks {
        track.check()?;
        let speed_mps = track.vx_mps.hypot(track.vy_mps);
        if speed_mps > SPEED_MAX_MPS {
            return Err(Rejected::Impossible { field: "track velocity", value: f64::from(speed_mps) });
        }
    }
    Ok(Tick { stamp_ns: header.stamp_ns, seq: header.seq, step_ns: header.step_ns })
}
