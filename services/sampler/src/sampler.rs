use std::io;
use std::sync::Arc;

use conflicts::Finder;
use evidence::{Evidence, Observed, Prior, Priors};
use kinematics::PARTICLES_MAX;
use lanes::LaneMap;
use nn::Workers;
use retrieval::RetrievalMemory;
use wire::{
    AGENTS_MAX, AgentControls, Cause, Forecast, HISTORY_MAX, HORIZON_MAX, Header, Rejected, SPEED_MAX_MPS,
    Track, flags,
};

use crate::experts::Experts;
use crate::fallback::Fallback;
use crate::guidance::Guidance;
use crate::journal::{Journal, Resumed, Storage};
use crate::tick::Tick;
use crate::turns::{Forecaster, Turns};
use crate::{Level, Propagation, SamplerOptions};

/// Makes a forecast for every track.
pub struct Sampler {
    options: SamplerOptions,
    fallback: Fallback,
    /// `None` if retrieval is off, or before the first tick.
    memory: Option<Box<RetrievalMemory>>,
    /// The experts' prior, used until forecasts have matured.
    prior: Prior,
    /// `None` if evidence is off, or before the first tick.
    experts: Option<Box<Experts>>,
    /// `None` if they are not asked for.
    conflicts: Option<Box<Finder>>,
    resumed_ticks: u64,
    /// Number and stamp of the newest tick.
    last: Option<(u64, i64)>,
    workers: Workers<Forecaster>,
    /// Scratch memory: the turn of each track, or why it has none.
    turns: Vec<Result<usize, Cause>>,
    /// Scratch memory: what is published of each track.
    levels: Vec<Level>,
    /// Where the learned state is committed after each tick; `None` if it does not outlive the sampler.
    journal: Option<Journal<Box<dyn Storage + Send>>>,
}

impl Sampler {
    /// A sampler that holds no forecasts yet, and works only on the caller's thread.
    ///
    /// # Panics
    /// If history, horizon or particles exceed the capacity of the payloads.
    #[must_use]
    pub fn new(options: SamplerOptions) -> Self {
        Self::with_workers(options, 1).expect("no thread is started")
    }

    /// Creates a sampler that shares the work of a tick over `workers` threads, including the caller's.
    /// Forecasts do not depend on their number.
    ///
    /// # Errors
    /// If the operating system refuses a thread.
    ///
    /// # Panics
    /// As [`Sampler::new`].
    pub fn with_workers(options: SamplerOptions, workers: usize) -> io::Result<Self> {
        assert!((1..=HISTORY_MAX).contains(&options.history_len), "history of {} steps", options.history_len);
        assert!((1..=HORIZON_MAX).contains(&options.horizon_len), "horizon of {} steps", options.horizon_len);
        if let Propagation::MonteCarlo { particles } = options.propagation {
            assert!((1..=PARTICLES_MAX).contains(&particles), "{particles} particles");
        }
        let forecasters = (0..workers.max(1)).map(|_| Forecaster::default());
        Ok(Self {
            options,
            fallback: Fallback::new(options),
            memory: None,
            prior: if options.evidence { Priors::shipped().all() } else { Prior::default() },
            experts: None,
            conflicts: options.conflicts.then(Box::default),
            resumed_ticks: 0,
            last: None,
            workers: Workers::new(Turns::new(options), forecasters)?,
            turns: Vec::with_capacity(AGENTS_MAX),
            levels: Vec::with_capacity(AGENTS_MAX),
            journal: None,
        })
    }

    /// Retrieves from now on from a memory with forecasts of the same model.
    pub fn warm_start(&mut self, memory: RetrievalMemory) {
        self.memory = Some(Box::new(memory));
    }

    /// Guides the forecasts of vehicles along these lanes from now on.
    pub fn guide_along(&mut self, map: &Arc<LaneMap>) {
        self.workers.each(|forecaster| forecaster.guidance = Some(Guidance::new(Arc::clone(map))));
    }

    /// Replaces the shipped prior of the experts by `prior`, from the first tick on.
    pub fn expect(&mut self, prior: Prior) {
        self.prior = prior;
    }

    /// Continues with the evidence on the experts that an earlier sampler of the same model has learned, as
    /// after the end of its session.
    pub fn continue_from(&mut self, earlier: &mut Self) {
        if self.options.evidence {
            self.experts = earlier.experts.take();
            self.experts.iter_mut().for_each(|experts| experts.end_session());
        }
    }

    /// Keeps the forecasts from controls that the previous sampler has sent, so that this sampler can hold
    /// them as the previous one would. A spare process calls this for every frame while it waits, and
    /// computes nothing.
    pub fn follow(&mut self, header: &Header, forecasts: &[Forecast]) {
        if !header.is_tick() || header.has(flags::VOID) {
            return;
        }
        if self.begins_session(header) {
            self.fallback.end_session();
        }
        self.fallback.begin(header.stamp_ns);
        for forecast in forecasts.iter().filter(|forecast| forecast.is_served() && forecast.check().is_ok()) {
            self.fallback.keep(header.stamp_ns, forecast);
        }
    }

    /// The settings.
    pub const fn options(&self) -> &SamplerOptions {
        &self.options
    }

    /// Commits the learned state to this journal after each tick from now on.
    pub fn keep_in(&mut self, journal: Option<Journal<Box<dyn Storage + Send>>>) {
        self.journal = journal;
    }

    /// Takes the journal back, for the sampler that replaces this one.
    pub const fn take_journal(&mut self) -> Option<Journal<Box<dyn Storage + Send>>> {
        self.journal.take()
    }

    /// Resumes with the state after `ticks` ticks of an earlier sampler, as its journal has it, or with an empty
    /// state if 0. Returns whether that state is known.
    pub fn resume_after(&mut self, ticks: u32) -> bool {
        let Some(mut journal) = self.journal.take() else { return ticks == 0 };
        let resumed = match ticks {
            0 => None,
            _ => journal.resume(Some(ticks.into())).ok().flatten(),
        };
        let is_known = match resumed {
            Some(resumed) => self.resume(resumed).is_ok(),
            None => journal.clear().is_ok() && ticks == 0,
        };
        self.journal = Some(journal);
        is_known
    }

    /// Commits the state learned from the ticks before `ticks` to the sampler's own journal, if it has one.
    pub(crate) fn commit_own(&mut self, ticks: u64) {
        let Some(mut journal) = self.journal.take() else { return };
        match self.commit(ticks, &mut journal) {
            Ok(()) => self.journal = Some(journal),
            Err(why) => tracing::warn!("learned state is no longer saved: {why}"),
        }
    }

    /// Commits the state learned from the past ticks.
    ///
    /// # Errors
    /// As [`Journal::commit`].
    pub fn commit<S: Storage>(&mut self, ticks: u64, journal: &mut Journal<S>) -> Result<(), String> {
        let evidence = self.experts.as_mut().map(|experts| experts.evidence_mut());
        journal.commit(ticks, self.memory.as_deref(), evidence)
    }

    /// Continues with the state that an earlier process of the run's sampler has learned. All agents count as
    /// new.
    ///
    /// # Errors
    /// The reason why the state is impossible; the sampler is then unchanged.
    pub fn resume(&mut self, resumed: Resumed) -> Result<(), &'static str> {
        if let Some(numbers) = resumed.evidence {
            let mut experts = Experts::new(self.options.horizon_len, resumed.step_ns, &self.prior);
            experts.evidence_mut().resume(&numbers)?;
            self.experts = Some(Box::new(experts));
        }
        if let Some(memory) = resumed.memory {
            self.memory = Some(Box::new(memory));
        }
        self.resumed_ticks = resumed.ticks;
        Ok(())
    }

    /// Starts with the state that the sampler of an earlier run has learned. Time restarts, and all agents are
    /// new.
    ///
    /// # Errors
    /// As [`Sampler::resume`].
    pub(crate) fn start_from(&mut self, resumed: Resumed) -> Result<(), &'static str> {
        self.resume(Resumed { ticks: 0, ..resumed })?;
        self.experts.iter_mut().for_each(|experts| experts.end_session());
        self.memory.iter_mut().for_each(|memory| memory.end_session());
        Ok(())
    }

    /// Number of ticks in the resumed state; 0 if none was resumed.
    pub fn resumed_ticks(&self) -> u32 {
        u32::try_from(self.resumed_ticks).unwrap_or(0)
    }

    /// The retrieval memory; `None` if retrieval is off, or before the first tick.
    pub fn memory(&self) -> Option<&RetrievalMemory> {
        self.memory.as_deref()
    }

    /// The evidence on the experts; `None` if evidence is off, or before the first tick.
    pub fn evidence(&self) -> Option<&Evidence> {
        self.experts.as_deref().map(Experts::evidence)
    }

    /// Writes a forecast per track, in the tracks' order, from the controls of the same tick or with the reason
    /// why there are none. Returns the number of forecasts: agents that the degradation policy silences are
    /// left out.
    ///
    /// A track gets a held or kinematic forecast with its cause if its controls are missing, refused or lead
    /// out of the world. Other tracks are not affected. [`Header::shed`] marks agents without controls that
    /// were left out to save time. Controls without a track are left out. A call with an older tick than
    /// before is allowed: its forecasts are held unless newer ones exist.
    ///
    /// # Errors
    /// [`Rejected`] if header or tracks are impossible; nothing was written or changed.
    ///
    /// # Panics
    /// If `out` does not have one place per track.
    pub fn step(
        &mut self,
        header: &Header,
        tracks: &[Track],
        controls: Result<&[AgentControls], Cause>,
        out: &mut [Forecast],
    ) -> Result<usize, Rejected> {
        assert_eq!(out.len(), tracks.len(), "a place per track");
        self.sample(header, tracks, controls, |count| Ok(&mut out[..count]))
    }

    /// As [`Sampler::step`]. `room` provides the memory for a number of forecasts.
    pub(crate) fn sample<'a>(
        &mut self,
        header: &Header,
        tracks: &[Track],
        controls: Result<&[AgentControls], Cause>,
        room: impl FnOnce(usize) -> Result<&'a mut [Forecast], Rejected>,
    ) -> Result<usize, Rejected> {
        let tick = check(header, tracks)?;
        if self.begins_session(header) {
            self.end_session();
        }
        self.observe(tick, tracks);
        match controls {
            Ok(controls) => self.take_turns(tick, header, tracks, controls),
            Err(cause) => {
                self.turns.clear();
                self.turns.resize(tracks.len(), Err(cause));
            }
        }
        let count = self.choose_levels(tick, tracks);
        let out = room(count)?;
        assert_eq!(out.len(), count, "a place per forecast");
        self.write(tick, tracks, out)?;
        if let Some(conflicts) = &mut self.conflicts {
            conflicts.write(out, self.options.horizon_len, tick.step_ns as f32 * 1e-9);
        }
        Ok(count)
    }

    /// Whether a tick begins a session. A tick that is sampled again, without its controls, begins none.
    fn begins_session(&mut self, header: &Header) -> bool {
        if self.last.is_some_and(|(seq, _)| header.seq <= seq) {
            return false;
        }
        let last = self.last.replace((header.seq, header.stamp_ns));
        last.is_some_and(|last| header.begins_session_after(last))
    }

    /// Ends a session: the stamps begin again, and all later agents are new. What was learned remains.
    fn end_session(&mut self) {
        self.fallback.end_session();
        self.memory.iter_mut().for_each(|memory| memory.end_session());
        self.experts.iter_mut().for_each(|experts| experts.end_session());
    }

    /// Chooses the level of each track. Returns the number of forecasts: all tracks that are not silent.
    ///
    /// [`Sampler::write`] follows these levels, so it writes exactly this number. It can't choose them itself:
    /// each forecast that it keeps may displace another one.
    fn choose_levels(&mut self, tick: Tick, tracks: &[Track]) -> usize {
        let mut turns = self.workers.input();
        let mut learned = false;
        self.levels.clear();
        self.levels.extend(tracks.iter().zip(&self.turns).map(|(track, turn)| {
            if turn.is_ok_and(|turn| turns.made(turn).is_possible) {
                learned = true;
                return Level::Learned;
            }
            self.fallback.level(tick, track, learned)
        }));
        self.levels.iter().filter(|level| **level != Level::Silent).count()
    }

    /// Writes the forecasts of a tick whose levels are chosen, in the tracks' order, and keeps what was
    /// learned from its turns.
    fn write(&mut self, tick: Tick, tracks: &[Track], out: &mut [Forecast]) -> Result<(), Rejected> {
        let mut turns = self.workers.input();
        let mut out = out.iter_mut();
        for ((track, turn), level) in tracks.iter().zip(&self.turns).zip(&self.levels) {
            let made = turn.ok().map(|turn| &*turns.made(turn));
            let unstored = made.and_then(|made| made.unstored.as_ref());
            if let Some((memory, unstored)) = self.memory.as_mut().zip(unstored) {
                memory.store(unstored);
            }
            if *level == Level::Silent {
                continue;
            }
            let out = out.next().expect("a place per forecast");
            match made.filter(|_| *level == Level::Learned) {
                Some(made) => {
                    if let Some((experts, blended)) = self.experts.as_mut().zip(made.blended.as_ref()) {
                        experts.store(tick.stamp_ns, blended, &made.forecast);
                    }
                    *out = made.forecast;
                    self.fallback.keep(tick.stamp_ns, &made.forecast);
                }
                None => {
                    let cause = turn.err().unwrap_or(Cause::Rejected);
                    self.fallback.write(tick, track, cause, *level, out)?;
                }
            }
        }
        Ok(())
    }

    /// Makes the forecasts of all tracks that have controls.
    fn take_turns(&mut self, tick: Tick, header: &Header, tracks: &[Track], controls: &[AgentControls]) {
        let Self { workers, memory, experts, turns, .. } = self;
        let mut input = workers.input();
        (input.memory, input.experts) = (memory.take(), experts.take());
        input.begin(tick, tracks);
        turns.clear();
        let mut next = 0;
        for (place, track) in tracks.iter().enumerate() {
            // Controls come in the order of the tracks, so the search mostly ends at its first step.
            let found = (next..controls.len())
                .chain(0..next.min(controls.len()))
                .find(|i| controls[*i].id == track.id);
            turns.push(match found {
                Some(found) => {
                    next = found + 1;
                    input.push(place, track, &controls[found])
                }
                None if header.is_shed(place) => Err(Cause::Shed),
                None => Err(Cause::Missing),
            });
        }
        let block_count = input.block_count();
        drop(input);
        workers.run(block_count);
        let mut input = workers.input();
        (*memory, *experts) = (input.memory.take(), input.experts.take());
    }

    /// Passes the positions of all agents that were detected in this tick to the retrieval memory and the
    /// evidence.
    fn observe(&mut self, tick: Tick, tracks: &[Track]) {
        self.fallback.begin(tick.stamp_ns);
        let detected = tracks.iter().filter(|track| track.unseen_ns == 0);
        let positions_m = detected.clone().map(|track| (track.id, [track.x_m, track.y_m]));
        if self.options.retrieval && tick.step_ns > 0 {
            let new = || Box::new(RetrievalMemory::new(self.options.horizon_len, tick.step_ns));
            self.memory.get_or_insert_with(new).observe(tick.stamp_ns, positions_m);
        }
        if self.options.evidence && tick.step_ns > 0 {
            let new = || Box::new(Experts::new(self.options.horizon_len, tick.step_ns, &self.prior));
            let observed = detected.map(|track| (track.id, observed(track)));
            self.experts.get_or_insert_with(new).observe(tick.stamp_ns, observed);
        }
    }
}

/// The position of a track, with its covariance.
fn observed(track: &Track) -> Observed {
    let row = track.state_len as usize;
    let [xx, xy, yy] = [0, 1, row + 1].map(|place| track.covariance.get(place).copied().unwrap_or_default());
    Observed { position_m: [track.x_m, track.y_m], covariance_m2: [xx, xy, yy] }
}

fn check(header: &Header, tracks: &[Track]) -> Result<Tick, Rejected> {
    header.check_agents(tracks.len())?;
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
