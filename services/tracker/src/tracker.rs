use config::Prior;
use wire::{
    AGENTS_MAX, AgentType, Counts, DETECTIONS_MAX, Detection, Forecast, HISTORY_MAX, Header, Rejected, Track,
    flags,
};

use crate::association::Association;
use crate::forecasts::{Controls, Forecasts};
use crate::options::TrackerOptions;
use crate::target::Target;

/// What a frame did to the tracks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tracked {
    /// Tracks written.
    pub tracks_len: usize,
    /// Tracks that found no place in the frame: the farthest from the ego.
    pub left_out_len: usize,
    /// Tracks held, the tentative and the left out included.
    pub held_len: usize,
    /// Tracks started.
    pub started_len: usize,
    /// Tracks ended.
    pub ended_len: usize,
    /// Detections that started no track because [`TrackerOptions::tracks_max`] are held.
    pub overflow_len: usize,
    /// Detections left aside because another one of the frame carries the same identity.
    pub duplicates_len: usize,
    /// Predictions and updates that failed; their tracks kept the state before.
    pub faults_len: usize,
    /// Forecasts that could not become a prior; their tracks went on by the one before, or without.
    pub refused_len: usize,
    /// Time between the newest forecasts at hand and this frame, if any have come.
    pub prior_age_ns: Option<u64>,
}

/// Makes tracks of detections: a belief per agent, kept over time.
#[derive(Clone, Debug)]
pub struct Tracker {
    options: TrackerOptions,
    /// In the order of their ids.
    targets: Vec<Target>,
    next_id: u64,
    last_ns: Option<i64>,
    /// Stamp of the newest forecasts at hand.
    prior_ns: Option<i64>,
    last: Tracked,
    association: Association,
    types: Vec<AgentType>,
    controls: Controls,
    /// (squared distance to the ego, target), for choosing the nearest.
    shown: Vec<(f64, u32)>,
}

impl Tracker {
    /// A tracker without tracks.
    ///
    /// # Panics
    /// If the options ask for a window that a [`Track`] can't hold, or without spacing.
    #[must_use]
    pub fn new(options: TrackerOptions) -> Self {
        assert!((1..=HISTORY_MAX).contains(&options.history_len), "history_len within 1..={HISTORY_MAX}");
        assert!(options.step_ns > 0, "step_ns above 0");
        Self {
            options,
            targets: Vec::with_capacity(options.tracks_max),
            next_id: 1,
            last_ns: None,
            prior_ns: None,
            last: Tracked::default(),
            association: Association::with_capacity(options.tracks_max, DETECTIONS_MAX),
            types: Vec::with_capacity(DETECTIONS_MAX),
            controls: Controls::new(),
            shown: Vec::with_capacity(options.tracks_max),
        }
    }

    /// Takes in the detections of a frame and writes the tracks at its stamp to `out`, in the order of their ids.
    ///
    /// Where [`flags::HAS_IDENTITIES`] is set, every detection has an id and the options do not ask otherwise, tracks
    /// follow the ids and are confirmed by their first detection. A track is published once it is confirmed and its
    /// velocity was observed: from the second detection on, or from the first that tells heading and speed.
    ///
    /// `prior` are the newest forecasts at hand, of this tracker's own tracks: with [`Prior::Learned`] they take part in the
    /// prediction, by their stamp. Frames without a tick (warm-up, end) change nothing.
    ///
    /// # Errors
    /// [`Rejected`] for a frame that is not newer than the last, too large, or holds an impossible number; the tracks
    /// are then as before.
    ///
    /// # Panics
    /// If `out` has fewer than [`AGENTS_MAX`] elements.
    pub fn step(
        &mut self,
        header: &Header,
        detections: &[Detection],
        prior: Option<(&Header, &[Forecast])>,
        out: &mut [Track],
    ) -> Result<Tracked, Rejected> {
        assert!(out.len() >= AGENTS_MAX, "room for {AGENTS_MAX} tracks");
        self.last = Tracked { held_len: self.targets.len(), ..Tracked::default() };
        if !header.is_tick() {
            return Ok(self.last);
        }
        self.check(header, detections)?;
        let now_ns = header.stamp_ns;
        self.last_ns = Some(now_ns);
        if let Some((forecast, _)) = prior.filter(|(forecast, _)| forecast.is_tick()) {
            self.prior_ns = self.prior_ns.max(Some(forecast.stamp_ns));
        }
        let mut tracked = Tracked {
            prior_age_ns: self.prior_ns.map(|ns| now_ns.saturating_sub(ns).max(0).unsigned_abs()),
            ..Tracked::default()
        };
        self.adopt(prior, header, &mut tracked);
        self.predict(now_ns, header, &mut tracked);
        self.update(header, detections, &mut tracked);
        self.start(header, detections, &mut tracked);
        self.end(header, &mut tracked);
        self.publish(header, out, &mut tracked);
        self.last = tracked;
        Ok(tracked)
    }

    /// The header of the tracks that the last frame gave, none if it was refused: that of its detections with our
    /// sizes and Δt.
    #[must_use]
    pub fn header(&self, detections: &Header) -> Header {
        Header {
            step_ns: self.options.step_ns,
            left_out_len: self.last.left_out_len as u32,
            counts: Counts {
                agents_len: self.last.tracks_len as u32,
                history_len: self.options.history_len as u32,
                ..Counts::default()
            },
            ..*detections
        }
    }

    fn check(&mut self, header: &Header, detections: &[Detection]) -> Result<(), Rejected> {
        header.check()?;
        if let Some(last_ns) = self.last_ns.filter(|&last_ns| header.stamp_ns <= last_ns) {
            return Err(Rejected::NotNewer { stamp_ns: header.stamp_ns, last_ns });
        }
        if detections.len() > DETECTIONS_MAX {
            let (found, most) = (detections.len() as u64, DETECTIONS_MAX as u64);
            return Err(Rejected::TooMany { field: "detections", found, most });
        }
        self.types.clear();
        for detection in detections {
            detection.check()?;
            self.types.push(detection.agent_type()?);
        }
        Ok(())
    }

    /// Gives each target its forecast as the prior, where one is due. What is wrong with a forecast costs its target no
    /// more than that.
    fn adopt(&mut self, prior: Option<(&Header, &[Forecast])>, header: &Header, tracked: &mut Tracked) {
        let Some((of, forecasts)) = prior.filter(|_| self.options.prior == Prior::Learned) else { return };
        let forecasts = match Forecasts::new(of, forecasts) {
            Ok(forecasts) => forecasts,
            Err(_) => {
                tracked.refused_len += forecasts.len();
                None
            }
        };
        let Some(mut forecasts) = forecasts else { return };
        let input = self.options.input(header);
        for target in &mut self.targets {
            let adopted = target.adopt(&mut forecasts, &mut self.controls, input);
            tracked.refused_len += usize::from(adopted.is_err());
        }
    }

    fn predict(&mut self, now_ns: i64, header: &Header, tracked: &mut Tracked) {
        let input = self.options.input(header);
        let horizon_ns = self.options.horizon_ns;
        let before = self.targets.len();
        self.targets.retain(|target| target.unseen_ns(now_ns) <= horizon_ns);
        tracked.ended_len += before - self.targets.len();
        for target in &mut self.targets {
            tracked.faults_len += usize::from(target.predict(now_ns, input).is_err());
        }
    }

    fn update(&mut self, header: &Header, detections: &[Detection], tracked: &mut Tracked) {
        let Self { association, targets, types, options, .. } = self;
        let input = options.input(header);
        if options.trusts(header, detections) {
            tracked.duplicates_len = association.by_identity(targets, detections);
        } else {
            association.by_position(targets, detections, types, input, options);
        }
        for (target, paired) in targets.iter_mut().zip(association.paired()) {
            if let Some(d) = paired.map(|d| d as usize) {
                let done = target.update(&detections[d], types[d], input, options);
                tracked.faults_len += usize::from(done.is_err());
            } else if header.observed_types & target.class.current().bit() != 0 {
                target.miss(options);
            }
        }
    }

    fn start(&mut self, header: &Header, detections: &[Detection], tracked: &mut Tracked) {
        let input = self.options.input(header);
        let trusted = self.options.trusts(header, detections);
        for d in self.association.unpaired() {
            if self.targets.len() >= self.options.tracks_max {
                tracked.overflow_len += 1;
                continue;
            }
            let (detection, agent_type) = (&detections[d], self.types[d]);
            self.targets.push(Target::new(
                self.next_id,
                header.stamp_ns,
                detection,
                agent_type,
                input,
                trusted,
            ));
            self.next_id += 1;
            tracked.started_len += 1;
        }
    }

    fn end(&mut self, header: &Header, tracked: &mut Tracked) {
        let input = self.options.input(header);
        let before = self.targets.len();
        self.targets.retain(|target| !target.is_over(input, &self.options));
        tracked.ended_len += before - self.targets.len();
        tracked.held_len = self.targets.len();
    }

    fn publish(&mut self, header: &Header, out: &mut [Track], tracked: &mut Tracked) {
        let ego_m = header.ego_m.map(f64::from);
        self.shown.clear();
        for (target, t) in self.targets.iter_mut().zip(0..) {
            target.record();
            if target.is_ready() {
                let ([x, y], _) = target.belief.position();
                self.shown.push(((x - ego_m[0]).powi(2) + (y - ego_m[1]).powi(2), t));
            }
        }
        if self.shown.len() > AGENTS_MAX {
            tracked.left_out_len = self.shown.len() - AGENTS_MAX;
            self.shown.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            self.shown.truncate(AGENTS_MAX);
            self.shown.sort_unstable_by_key(|&(_, t)| t);
        }
        for (track, &(_, t)) in out.iter_mut().zip(&self.shown) {
            *track = self.targets[t as usize].publish(&self.options);
        }
        tracked.tracks_len = self.shown.len();
    }
}

impl TrackerOptions {
    fn input(&self, header: &Header) -> &crate::InputModel {
        if header.has(flags::HAS_IDENTITIES) { &self.recorded } else { &self.detector }
    }

    /// Whether the detections' identities take the place of an association.
    fn trusts(&self, header: &Header, detections: &[Detection]) -> bool {
        header.has(flags::HAS_IDENTITIES)
            && !self.associate
            && detections.iter().all(|d| d.has(wire::detection_flags::HAS_ID))
    }
}
