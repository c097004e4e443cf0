use audit::{Clock, ClockSet, Finding, Found, LiveAudit, Noise, Stamped, StampedFrame};
use bytemuck::Zeroable;
use wire::{
    AGENT_TYPES, AGENTS_MAX, AgentType, Counts, DETECTIONS_MAX, Detection, Forecast, HISTORY_MAX, Header,
    InputCounts, Rejected, Track, flags,
};

use crate::estimate::{Birth, Estimate};
use crate::estimates::{Estimates, Scratch};
use crate::frozen::{Repetition, is_moving};
use crate::options::{InputModel, Prior, TrackerOptions};
use crate::predecessor::Predecessor;
use crate::publication::Publications;
use crate::replay::{Refusal, ReplayBuffer};
use crate::tally::{Tally, Warned};
use crate::tracked::Tracked;

/// An estimate that can be published.
#[derive(Clone, Copy, Debug)]
struct Publishable {
    /// Squared distance to the ego.
    distance_m2: f64,
    /// The track's identity.
    id: u64,
    /// Indices of estimate and publication.
    estimate: usize,
    publication: usize,
}

/// A multi-object tracker: builds tracks from detections, frame by frame.
#[derive(Debug)]
pub struct Tracker {
    options: TrackerOptions,
    estimates: Estimates,
    replay: ReplayBuffer,
    repetition: Repetition,
    publications: Publications,
    last: Tracked,
    tally: Tally,
    scratch: Scratch,
    types: Vec<AgentType>,
    /// The publishable estimates, from which the nearest are chosen.
    publishable: Vec<Publishable>,
    /// Identity, time since the last detection, and place of each published track that has an identity.
    identities: Vec<(u64, u64, usize)>,
    /// The previous tracker processed frames up to this stamp.
    predecessor_ns: Option<i64>,
    /// The clock of the stamps.
    clock: Clock,
    /// Number of the session's first frame. Forecasts of earlier ticks are no priors.
    session_seq: u64,
    audit: LiveAudit,
    /// The published noise.
    noise: Noise,
    /// Whether the frame of the last step can be audited.
    is_auditable: bool,
    /// The tracks of the process before, while this one waits for its turn.
    pub(crate) predecessor: Predecessor,
    /// Scratch: the tracks of the current step.
    tracks: Vec<Track>,
    warned: Warned,
}

impl Tracker {
    /// A tracker without tracks.
    ///
    /// # Panics
    /// If a [`Track`] cannot hold the window of the options, if the window has no spacing, or if a half-gain
    /// deviation is not above 0.
    #[must_use]
    pub fn new(options: TrackerOptions) -> Self {
        assert!((1..=HISTORY_MAX).contains(&options.history_len), "history_len within 1..={HISTORY_MAX}");
        assert!(options.step_ns > 0, "step_ns above 0");
        for trust in options.detector.trust.iter().chain(&options.smooth.trust) {
            let half_gain = [trust.half_gain_speed_mps, trust.half_gain_heading_rad];
            assert!(half_gain.iter().all(|&sigma| sigma > 0.0), "half-gain deviations above 0");
        }
        Self {
            options,
            estimates: Estimates::new(&options, options.tracks_max),
            replay: ReplayBuffer::new(&options),
            repetition: Repetition::new(),
            publications: Publications::with_capacity(options.tracks_max),
            last: Tracked::default(),
            tally: Tally::default(),
            scratch: Scratch::new(options.tracks_max),
            types: Vec::with_capacity(DETECTIONS_MAX),
            publishable: Vec::with_capacity(options.tracks_max),
            identities: Vec::with_capacity(AGENTS_MAX),
            predecessor_ns: None,
            clock: Clock::new(options.horizon_ns),
            session_seq: 0,
            audit: LiveAudit::default(),
            noise: Noise::default(),
            is_auditable: false,
            predecessor: Predecessor::default(),
            tracks: vec![Track::zeroed(); AGENTS_MAX],
            warned: Warned::default(),
        }
    }

    /// Lends scratch memory for the tracks of a tick; [`Tracker::return_room`] takes it back.
    pub(crate) fn take_room(&mut self) -> Vec<Track> {
        std::mem::take(&mut self.tracks)
    }

    pub(crate) fn return_room(&mut self, tracks: Vec<Track>) {
        self.tracks = tracks;
    }

    /// Logs the counts of what went wrong, when they have doubled.
    pub(crate) fn warn(&mut self) {
        self.warned.warn(self.tally);
    }

    /// The same tracker as the `incarnation`th successor of one that died. Its tracks get ids that no
    /// predecessor has used. Each incarnation has 2⁴⁰ ids, which a double can also represent exactly.
    #[must_use]
    pub const fn with_ids_of(mut self, incarnation: u32) -> Self {
        self.publications.set_next_id(((incarnation as u64) << 40) + 1);
        self
    }

    /// Continues with the tracks of the previous tracker, under their ids. Must be called before the first
    /// frame. Frames that are not newer than these tracks are then refused.
    pub fn begin_with(&mut self, predecessor: &Predecessor) {
        if predecessor.is_empty() {
            return;
        }
        let header = *predecessor.header();
        let input = InputModel::of_options(&header, &self.options);
        let trusts = header.has(flags::HAS_IDENTITIES) && !self.options.associate;
        let known = predecessor.tracks().filter_map(|(track, history)| {
            let agent_type = track.agent_type().ok()?;
            Some((track, history, agent_type))
        });
        for (nth, (track, history, agent_type)) in known.take(self.options.tracks_max).enumerate() {
            // The index of this detection in its frame is not published, so this is an index that no
            // detection has.
            let birth = Birth { stamp_ns: track.born_ns, detection: u32::MAX - nth as u32 };
            let trusted = trusts && track.source_id != 0;
            let of = (track, agent_type);
            self.estimates
                .add(|seed| Estimate::of_track((birth, seed), header.stamp_ns, of, &input, trusted));
            self.publications.resume(track, birth, header.stamp_ns, history);
        }
        self.replay.begin_with(&self.estimates);
        self.predecessor_ns = Some(header.stamp_ns);
        self.clock.restart(header.stamp_ns, header.interval_ns);
    }

    /// Begins a session if the clock of the stamps was set, or if the frame has the flag. Returns the difference
    /// to the expected stamp. Tracks end. What was learned about the detector remains.
    fn begin_session(&mut self, header: &Header, detections: &[Detection]) -> Option<i64> {
        let (stamp_ns, interval_ns) = (header.stamp_ns, header.interval_ns);
        let set_by_ns = if header.has(flags::NEW_SESSION) {
            self.clock.restart(stamp_ns, interval_ns)
        } else {
            let released_ns = Some(header.released_ns).filter(|_| !header.has(flags::LOCKSTEP));
            let is_repeated = self.replay.has(stamp_ns, detections);
            let frame = StampedFrame { stamp_ns, interval_ns, released_ns, is_repeated };
            let Stamped::Set { by_ns } = self.clock.add(frame) else { return None };
            by_ns
        };
        self.end_tracks();
        (self.predecessor_ns, self.session_seq) = (None, header.seq);
        self.tally.session_count += 1;
        Some(set_by_ns)
    }

    /// Ends all tracks. What was learned about the detector remains.
    fn end_tracks(&mut self) {
        self.estimates.end_session();
        self.replay.restart(&self.estimates);
        self.publications.end_session();
    }

    /// Processes the detections of a frame and writes the tracks at its stamp to `out`, in the order of their
    /// ids.
    ///
    /// Tracks follow the identities of detections if [`flags::HAS_IDENTITIES`](wire::flags::HAS_IDENTITIES)
    /// is set, every detection has an id, and the options do not disable this. If the audit finds that ids change while
    /// their agents continue, all tracks end, and later detections are associated. The first detection with an id
    /// confirms a track. A track is published once it is confirmed and its velocity was observed: from the
    /// second detection on, or from the first if that has heading and speed.
    ///
    /// `prior` contains the newest available forecasts of this tracker's own tracks. With [`Prior::Learned`]
    /// they become priors, by their stamp. Control frames (warm-up, end) change nothing.
    ///
    /// An out-of-sequence frame is processed by rollback and replay. At most eight other frames may have a
    /// later stamp, and the newest stamp may be later by at most [`TrackerOptions::horizon_ns`]. The
    /// estimates return to the state before the frame, and the newer frames are processed again with their
    /// forecasts. No tracks are written. Everything published stays unchanged, including histories and ids.
    /// The frame takes effect from the next frame on. An agent whose first detection arrives out of sequence
    /// keeps the id under which it was published.
    ///
    /// If stamps go back by more than late frames explain, or jump ahead beyond the horizon, a session begins:
    /// see [`Clock`].
    ///
    /// A source is frozen if its detections are the same for [`TrackerOptions::frozen_frames`] frames
    /// although some agent in them moves. The detections are then ignored, and the tracks are predicted.
    ///
    /// # Errors
    /// [`Rejected`] if the frame's stamp was processed before, or the frame is too late, too large or
    /// contains an impossible number. The tracks are then unchanged.
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
        self.last = Tracked { held_count: self.estimates.all().len(), ..Tracked::default() };
        self.is_auditable = false;
        if !header.is_tick() {
            return Ok(self.last);
        }
        self.check(header, detections)?;
        self.is_auditable = true;
        self.last.set_by_ns = self.begin_session(header, detections);
        if self.audit.ignores_identities() && !self.options.associate {
            self.options.associate = true;
            self.end_tracks();
        }
        let position = self.position(header)?;
        let is_prior = |of: &Header| self.options.prior == Prior::Learned && of.seq >= self.session_seq;
        let prior = prior.filter(|(of, _)| is_prior(of));
        let frozen_count = self.frozen_count(header, detections);
        let given_len = detections.len();
        // No type was observed, so no track is missed.
        let unseen = Header { observed_types: 0, ..*header };
        let (seen, detections) = if frozen_count > 0 {
            self.types.clear();
            (&unseen, &[][..])
        } else {
            (header, detections)
        };
        let position = self.replay.insert(position, seen, (detections, &self.types), prior);
        let mut tracked = Tracked { frozen_count, set_by_ns: self.last.set_by_ns, ..self.process(position) };
        if frozen_count > 0 {
            (tracked.detection_count, tracked.repeated_count) = (given_len, given_len);
        }
        if tracked.replayed_count == 0 {
            self.publish(header, out, &mut tracked);
        }
        self.tally.out_of_sequence_count += u64::from(tracked.replayed_count > 0);
        self.tally.add_input(&tracked);
        self.tally.fault_count += tracked.fault_count as u64;
        self.tally.refused_count += tracked.refused_count as u64;
        self.last = tracked;
        Ok(tracked)
    }

    /// Number of consecutive frames with the same detections; 0 while their source is not frozen.
    fn frozen_count(&mut self, header: &Header, detections: &[Detection]) -> u32 {
        if self.options.frozen_frames == 0 {
            return 0;
        }
        let mut speeds_mps = self.estimates.all().iter().map(|estimate| estimate.motion().speed_mps);
        let frames = self.repetition.look(header.stamp_ns, detections, || speeds_mps.any(is_moving));
        if frames >= self.options.frozen_frames.max(2) { frames } else { 0 }
    }

    /// The header of the last frame's tracks: the header of its detections with the sizes and Δt of the
    /// tracks. The frame has no tracks if it was refused or was out of sequence.
    #[must_use]
    pub fn header(&self, detections: &Header) -> Header {
        Header {
            flags: detections.flags
                | if self.last.frozen_count > 0 { flags::PREDICTED } else { 0 }
                | self.last.set_by_ns.map_or(0, |_| flags::NEW_SESSION),
            observed_types: if self.last.frozen_count > 0 { 0 } else { detections.observed_types },
            step_ns: self.options.step_ns,
            left_out_len: self.last.left_out_len as u32,
            input: InputCounts {
                unplayed: detections.input.unplayed,
                merged: detections.input.merged,
                doubts: detections.input.doubts | self.audit.doubts() | self.noise.doubts(),
                ..self.tally.input
            },
            counts: Counts {
                agents_len: self.last.track_count as u32,
                history_len: self.options.history_len as u32,
                ..Counts::default()
            },
            ..*detections
        }
    }

    /// Audits the frame of the last [step](Tracker::step). Call this after its tracks are published, so that
    /// no stage waits for the audit. The headers of later frames contain the doubts.
    pub fn audit(&mut self, header: &Header, detections: &[Detection]) {
        if std::mem::take(&mut self.is_auditable) {
            self.audit.frame(header, detections, self.session_begun());
        }
    }

    /// The clock's step, if the frame of the last [step](Tracker::step) began a session.
    pub(crate) fn session_begun(&self) -> Option<ClockSet> {
        Some(ClockSet::new(self.session_seq, self.last.set_by_ns?))
    }

    /// Number of the session's first frame.
    pub(crate) const fn session_seq(&self) -> u64 {
        self.session_seq
    }

    /// Doubts about the input that were found since the last call. Allocates only if there are any.
    pub fn new_doubts(&mut self) -> Vec<Finding> {
        self.audit.take_new()
    }

    /// The detector's noise, as published so far.
    #[must_use]
    pub const fn noise(&self) -> &Noise {
        &self.noise
    }

    /// The learned noise of positions by the sensor: type, number of the sensor, standard deviation in m. Empty
    /// while there is one sensor.
    pub fn noise_of_sensors(&self) -> impl Iterator<Item = (AgentType, u8, f64)> {
        let of_types = AGENT_TYPES.into_iter().zip(self.estimates.noise_of_sensors_m());
        of_types.flat_map(|(agent_type, of_sensors_m)| {
            let known = (0..).zip(of_sensors_m).filter(|(_, deviation_m)| *deviation_m > 0.0);
            known.map(move |(sensor, deviation_m)| (agent_type, sensor, deviation_m))
        })
    }

    /// Changes of the detector's noise since the last call.
    pub fn new_noise_changes(&mut self) -> impl Iterator<Item = Found> {
        self.noise.take_new()
    }

    /// Counts of faults so far.
    #[must_use]
    pub const fn tally(&self) -> Tally {
        self.tally
    }

    fn check(&mut self, header: &Header, detections: &[Detection]) -> Result<(), Rejected> {
        header.check()?;
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

    /// The position of the frame among the last frames.
    fn position(&mut self, header: &Header) -> Result<usize, Rejected> {
        let stamp_ns = header.stamp_ns;
        let last_ns = self.replay.scans().last().map_or(stamp_ns, |newest| newest.header.stamp_ns);
        if let Some(before_ns) = self.predecessor_ns.filter(|before_ns| stamp_ns <= *before_ns) {
            self.tally.too_late_count += 1;
            return Err(Rejected::NotNewer { stamp_ns, last_ns: before_ns.max(last_ns) });
        }
        self.replay.position(stamp_ns, self.options.horizon_ns).map_err(|why| {
            match why {
                Refusal::Repeated => self.tally.repeated_count += 1,
                Refusal::TooLate => self.tally.too_late_count += 1,
            }
            Rejected::NotNewer { stamp_ns, last_ns }
        })
    }

    /// Processes the scan at a position and replays all newer scans. If the scan is out of sequence, this
    /// begins with a rollback. Returns the effects of the scan itself.
    fn process(&mut self, position: usize) -> Tracked {
        let Self { options, estimates, replay, publications, scratch, .. } = self;
        let newest = replay.scans().len() - 1;
        let first = if position < newest { replay.roll_back(position, estimates) } else { position };
        let mut tracked = Tracked::default();
        for at in first..=newest {
            replay.checkpoint(at, estimates);
            let done = estimates.process(&replay.scans()[at], publications, scratch, options);
            if at == position {
                tracked = done;
            }
        }
        Tracked { replayed_count: newest - position, held_count: estimates.all().len(), ..tracked }
    }

    fn publish(&mut self, header: &Header, out: &mut [Track], tracked: &mut Tracked) {
        let Self { options, estimates, publications, publishable, identities, replay, .. } = self;
        let ego_m = header.ego_m.map(f64::from);
        publishable.clear();
        for (index, estimate) in estimates.all().iter().enumerate() {
            let publication = publications.record(estimate);
            if estimate.is_ready() {
                let [x, y] = estimate.motion().position_m;
                let distance_m2 = (x - ego_m[0]).powi(2) + (y - ego_m[1]).powi(2);
                let id = publications.at(publication).id;
                publishable.push(Publishable { distance_m2, id, estimate: index, publication });
            }
        }
        if publishable.len() > AGENTS_MAX {
            tracked.left_out_len = publishable.len() - AGENTS_MAX;
            publishable.sort_unstable_by(|a, b| {
                a.distance_m2.total_cmp(&b.distance_m2).then(a.estimate.cmp(&b.estimate))
            });
            publishable.truncate(AGENTS_MAX);
        }
        publishable.sort_unstable_by_key(|publishable| publishable.id);
        let noise = estimates.published_noise(header, options);
        for (track, chosen) in out.iter_mut().zip(&*publishable) {
            let estimate = &estimates.all()[chosen.estimate];
            publications.at(chosen.publication).write(estimate, options, track);
            [track.noise_m, track.noise_heading_rad, track.noise_speed_mps] =
                noise[estimate.class.current().index()];
        }
        tracked.track_count = publishable.len();
        let tracks = &mut out[..tracked.track_count];
        name_once(tracks, identities);
        self.noise.tick(header.stamp_ns, tracks.iter().map(|track| (track.agent_type, track.noise())));
        let oldest_ns = replay.scans().first().map_or(header.stamp_ns, |oldest| oldest.header.stamp_ns);
        publications.prune(header.stamp_ns, oldest_ns);
    }
}

/// Leaves a source's identity only to the track that was last detected with it.
fn name_once(tracks: &mut [Track], identities: &mut Vec<(u64, u64, usize)>) {
    identities.clear();
    let named = tracks.iter().enumerate().filter(|(_, track)| track.source_id != 0);
    identities.extend(named.map(|(place, track)| (track.source_id, track.unseen_ns, place)));
    identities.sort_unstable();
    for pair in identities.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
        tracks[pair[1].2].source_id = 0;
    }
}
