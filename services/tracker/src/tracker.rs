use wire::{
    AGENTS_MAX, AgentType, Counts, DETECTIONS_MAX, Detection, Forecast, HISTORY_MAX, Header, Rejected, Track,
};

use crate::estimates::{Estimates, Scratch};
use crate::options::{Prior, TrackerOptions};
use crate::publication::Publications;
use crate::scans::{Scans, Unplaced};
use crate::tally::Tally;

/// What a frame did to the tracks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tracked {
    /// Tracks written.
    pub tracks_len: usize,
    /// Newer frames that were taken in once more, after this one that came late; 0 for a frame that did not.
    pub replayed_len: usize,
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
}

/// An estimate that can be published.
#[derive(Clone, Copy, Debug)]
struct Shown {
    /// Squared distance to the ego.
    distance_m2: f64,
    /// The track's identity.
    id: u64,
    /// Places of estimate and publication.
    estimate: usize,
    publication: usize,
}

/// Makes tracks of detections: a belief per agent, kept over time.
#[derive(Debug)]
pub struct Tracker {
    options: TrackerOptions,
    estimates: Estimates,
    scans: Scans,
    publications: Publications,
    last: Tracked,
    tally: Tally,
    scratch: Scratch,
    types: Vec<AgentType>,
    /// What can be published, for choosing the nearest.
    shown: Vec<Shown>,
}

impl Tracker {
    /// A tracker without tracks.
    ///
    /// # Panics
    /// If the options ask for a window that a [`Track`] can't hold, or without spacing, or for controls of which half acts at
    /// no deviation.
    #[must_use]
    pub fn new(options: TrackerOptions) -> Self {
        assert!((1..=HISTORY_MAX).contains(&options.history_len), "history_len within 1..={HISTORY_MAX}");
        assert!(options.step_ns > 0, "step_ns above 0");
        for trust in [options.detector.trust, options.recorded.trust] {
            let even = [trust.even_speed_mps, trust.even_heading_rad];
            assert!(even.iter().all(|&even| even > 0.0), "even_speed_mps and even_heading_rad above 0");
        }
        Self {
            options,
            estimates: Estimates::with_capacity(options.tracks_max),
            scans: Scans::new(),
            publications: Publications::with_capacity(options.tracks_max),
            last: Tracked::default(),
            tally: Tally::default(),
            scratch: Scratch::new(options.tracks_max),
            types: Vec::with_capacity(DETECTIONS_MAX),
            shown: Vec::with_capacity(options.tracks_max),
        }
    }

    /// Takes in the detections of a frame and writes the tracks at its stamp to `out`, in the order of their ids.
    ///
    /// Where [`flags::HAS_IDENTITIES`](wire::flags::HAS_IDENTITIES) is set, every detection has an id and the options do
    /// not ask otherwise, tracks follow the ids and are confirmed by their first detection. A track is published once it
    /// is confirmed and its velocity was observed: from the second detection on, or from the first that tells heading and
    /// speed.
    ///
    /// `prior` are the newest forecasts at hand, of this tracker's own tracks: with [`Prior::Learned`] they take part in the
    /// prediction, by their stamp. Frames without a tick (warm-up, end) change nothing.
    ///
    /// A frame that comes late, of a stamp before that of at most eight others and before the newest by no more than
    /// [`TrackerOptions::horizon_ns`], is taken in where it belongs: the tracks go back to before it, and the newer frames
    /// are taken in once more, with the forecasts that came with them. No tracks are written then. What has been published
    /// stays as it is, histories and ids too; what the late frame told shows from the next one on. An agent whose first
    /// detection comes late keeps the id under which it was published.
    ///
    /// # Errors
    /// [`Rejected`] for a frame of a stamp that was taken in before, one that is too late, too large, or holds an impossible
    /// number; the tracks are then as before.
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
        self.last = Tracked { held_len: self.estimates.all().len(), ..Tracked::default() };
        if !header.is_tick() {
            return Ok(self.last);
        }
        self.check(header, detections)?;
        let place = self.place(header)?;
        let prior = prior.filter(|_| self.options.prior == Prior::Learned);
        let place = self.scans.insert(place, header, (detections, &self.types), prior);
        let mut tracked = self.take_in(place);
        if tracked.replayed_len == 0 {
            self.publish(header, out, &mut tracked);
        }
        self.tally.late_len += u64::from(tracked.replayed_len > 0);
        self.tally.faults_len += tracked.faults_len as u64;
        self.tally.refused_len += tracked.refused_len as u64;
        self.last = tracked;
        Ok(tracked)
    }

    /// The header of the tracks that the last frame gave, none if it was refused or late: that of its detections with our
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

    /// What was not as it should be so far.
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

    /// Where the frame belongs among the last ones.
    fn place(&mut self, header: &Header) -> Result<usize, Rejected> {
        let stamp_ns = header.stamp_ns;
        let last_ns = self.scans.kept().last().map_or(stamp_ns, |newest| newest.header.stamp_ns);
        self.scans.place(stamp_ns, self.options.horizon_ns).map_err(|why| {
            match why {
                Unplaced::Repeated => self.tally.repeated_len += 1,
                Unplaced::TooLate => self.tally.too_late_len += 1,
            }
            Rejected::NotNewer { stamp_ns, last_ns }
        })
    }

    /// Takes in the scan at that place, and all that are newer; tells what it did itself.
    fn take_in(&mut self, place: usize) -> Tracked {
        let Self { options, estimates, scans, publications, scratch, .. } = self;
        let newest = scans.kept().len() - 1;
        let first = if place < newest { scans.go_back(place, estimates) } else { place };
        let mut tracked = Tracked::default();
        for at in first..=newest {
            scans.keep(at, estimates);
            let done = estimates.take_in(&scans.kept()[at], publications, scratch, options);
            if at == place {
                tracked = done;
            }
        }
        Tracked { replayed_len: newest - place, held_len: estimates.all().len(), ..tracked }
    }

    fn publish(&mut self, header: &Header, out: &mut [Track], tracked: &mut Tracked) {
        let Self { options, estimates, publications, shown, scans, .. } = self;
        let ego_m = header.ego_m.map(f64::from);
        shown.clear();
        for (place, estimate) in estimates.all().iter().enumerate() {
            let publication = publications.record(estimate);
            if estimate.is_ready() {
                let [x, y] = estimate.motion().position_m;
                let distance_m2 = (x - ego_m[0]).powi(2) + (y - ego_m[1]).powi(2);
                let id = publications.at(publication).id;
                shown.push(Shown { distance_m2, id, estimate: place, publication });
            }
        }
        if shown.len() > AGENTS_MAX {
            tracked.left_out_len = shown.len() - AGENTS_MAX;
            shown.sort_unstable_by(|a, b| {
                a.distance_m2.total_cmp(&b.distance_m2).then(a.estimate.cmp(&b.estimate))
            });
            shown.truncate(AGENTS_MAX);
        }
        shown.sort_unstable_by_key(|shown| shown.id);
        for (track, shown) in out.iter_mut().zip(&*shown) {
            publications.at(shown.publication).write(&estimates.all()[shown.estimate], options, track);
        }
        tracked.tracks_len = shown.len();
        let oldest_ns = scans.kept().first().map_or(header.stamp_ns, |oldest| oldest.header.stamp_ns);
        publications.settle(header.stamp_ns, oldest_ns);
    }
}
