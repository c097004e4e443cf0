mod identities;

use association::jpda::SIDE_MAX;
use filters::{OBSERVATIONS_MAX, Observation};
use wire::{DETECTIONS_MAX, Header, SENSORS_MAX, flags};

use crate::estimate::{Birth, Estimate, LONG_M, length_m};
use crate::forecasts::{Controls, Forecasts};
use crate::noise::{Noise, SensorWindows};
use crate::observation::{Found, observation};
use crate::occlusion::Occlusion;
use crate::options::{InputModel, Prior, TrackerOptions};
use crate::pairing::Pairing;
use crate::placeholders::Placeholders;
use crate::publication::Publications;
use crate::scan::Scan;
use crate::tracked::Tracked;
use crate::trials::Shown;

// A filter accepts all detections that an association may assign to a track.
const _: () = assert!(SIDE_MAX <= OBSERVATIONS_MAX);

/// The estimates of all agents at the stamp of a frame.
#[derive(Debug)]
pub struct Estimates {
    /// In the order of their births.
    all: Vec<Estimate>,
    started_count: u64,
    /// Results of the forecasts' trials, by type.
    shown: [Shown; 3],
    placeholders: Placeholders,
    noise: Noise,
    /// From which the noise of each sensor is learned.
    of_sensors: SensorWindows,
    /// What the noise shows of the current frame.
    input: InputModel,
}

/// Reusable memory.
#[derive(Debug)]
pub struct Scratch {
    pairing: Pairing,
    occlusion: Occlusion,
    /// Observations that may belong to the current agent, each with the probability that it does.
    possible: Vec<(f64, Observation)>,
    controls: Controls,
    /// The scan whose boxes are moved to the centres of whole vehicles.
    completed: Scan,
    /// Detections that do not fit the estimate of their identity.
    strays: Vec<Stray>,
    /// Estimates that continue the identity of another estimate.
    begun: Vec<Estimate>,
}

impl Scratch {
    /// Scratch memory for this number of estimates.
    #[must_use]
    pub fn new(estimate_count: usize) -> Self {
        Self {
            pairing: Pairing::with_capacity(estimate_count, DETECTIONS_MAX),
            occlusion: Occlusion::new(),
            possible: Vec::with_capacity(SIDE_MAX),
            controls: Controls::new(),
            completed: Scan {
                detections: Vec::with_capacity(DETECTIONS_MAX),
                types: Vec::with_capacity(DETECTIONS_MAX),
                ..Scan::new()
            },
            strays: Vec::with_capacity(estimate_count),
            begun: Vec::with_capacity(estimate_count),
        }
    }
}

impl Estimates {
    /// No estimates, with room for this number.
    #[must_use]
    pub fn new(options: &TrackerOptions, capacity: usize) -> Self {
        Self {
            all: Vec::with_capacity(capacity),
            started_count: 0,
            shown: [Shown::default(); 3],
            placeholders: Placeholders::default(),
            noise: Noise::new(options),
            of_sensors: SensorWindows::new(),
            input: options.detector,
        }
    }

    /// What tracks of each type publish of the noise: [`Noise::published`].
    #[must_use]
    pub fn published_noise(&self, header: &Header, options: &TrackerOptions) -> [[f32; 3]; 3] {
        self.noise.published(header, options)
    }

    /// The learned noise of each type and sensor: [`Noise::of_sensors_m`].
    #[must_use]
    pub fn noise_of_sensors_m(&self) -> [[f64; SENSORS_MAX + 1]; 3] {
        self.noise.of_sensors_m()
    }

    /// All estimates.
    #[must_use]
    pub fn all(&self) -> &[Estimate] {
        &self.all
    }

    /// Ends all estimates. What was learned about the detector and about forecasts remains.
    pub fn end_session(&mut self) {
        self.all.clear();
        self.of_sensors.clear();
    }

    /// Adds the estimate of a track that another tracker has published. Calls must follow the order of
    /// births.
    pub fn add(&mut self, of_track: impl FnOnce(u64) -> Estimate) {
        self.started_count += 1;
        self.all.push(of_track(self.started_count));
    }

    /// Copies `source` into the existing memory.
    pub fn copy(&mut self, source: &Self) {
        self.all.clone_from(&source.all);
        self.started_count = source.started_count;
        self.shown = source.shown;
        self.placeholders = source.placeholders;
        self.noise = source.noise;
        self.of_sensors.copy(&source.of_sensors);
        self.input = source.input;
    }

    /// Processes a scan that is newer than the estimates. Returns its effects.
    ///
    /// `publications` match forecasts with agents. If the scan reveals an older birth of an agent, its
    /// publication is transferred to this birth.
    pub fn process(
        &mut self,
        scan: &Scan,
        publications: &mut Publications,
        scratch: &mut Scratch,
        options: &TrackerOptions,
    ) -> Tracked {
        let mut tracked = Tracked { detection_count: scan.detections.len(), ..Tracked::default() };
        self.input = self.noise.input_model(&scan.header, options);
        self.adopt_forecasts(scan, publications, &mut scratch.controls, options, &mut tracked);
        self.begin_frame(&scan.header, options, &mut tracked);
        let mut completed = std::mem::take(&mut scratch.completed);
        let scan = if self.complete(scan, options, &mut completed) { &completed } else { scan };
        if options.trusts(&scan.header, &scan.detections) {
            self.follow_identities(scan, publications, scratch, options, &mut tracked);
        } else {
            self.predict(&scan.header, &mut tracked);
            self.update(scan, publications, scratch, options, &mut tracked);
        }
        self.start(scan, &scratch.pairing, options, &mut tracked);
        if scan.has_own_times() {
            self.end_twins();
        }
        scratch.completed = completed;
        self.end(options, &mut tracked);
        tracked
    }

    /// Adopts each estimate's forecast as the prior, if a forecast is due. A faulty forecast is refused, and
    /// its agent continues without it.
    fn adopt_forecasts(
        &mut self,
        scan: &Scan,
        publications: &mut Publications,
        controls: &mut Controls,
        options: &TrackerOptions,
        tracked: &mut Tracked,
    ) {
        let Some(of) = scan.prior.as_ref().filter(|_| options.prior == Prior::Learned) else { return };
        let mut forecasts = match Forecasts::new(of, &scan.forecasts) {
            Ok(Some(forecasts)) => forecasts,
            Ok(None) => return,
            Err(_) => {
                tracked.refused_count += scan.forecasts.len();
                return;
            }
        };
        let input = &self.input;
        for estimate in &mut self.all {
            let Some(publication) = publications.find(estimate.birth()) else { continue };
            let Some(forecast) = forecasts.find(publication.id) else { continue };
            let adopted = estimate.adopt((&forecasts, forecast), controls, input, &self.shown);
            tracked.refused_count += usize::from(!adopted);
        }
    }

    fn begin_frame(&mut self, header: &Header, options: &TrackerOptions, tracked: &mut Tracked) {
        let now_ns = header.stamp_ns;
        let before = self.all.len();
        self.all.retain(|estimate| estimate.unseen_ns(now_ns) <= options.horizon_ns);
        tracked.ended_count += before - self.all.len();
        self.all.iter_mut().for_each(|estimate| estimate.begin_frame(now_ns));
    }

    /// Copies the scan if it has boxes that show a part of a vehicle, and moves these to the centres of the whole
    /// vehicles. Returns whether there are any.
    fn complete(&mut self, scan: &Scan, options: &TrackerOptions, completed: &mut Scan) -> bool {
        let trusted = options.trusts(&scan.header, &scan.detections);
        // Without long vehicles, no box moves.
        let least_m = if self.all.iter().any(Estimate::is_long) { f32::MIN_POSITIVE } else { LONG_M };
        let mut is_moved = false;
        let sized = scan.detections.iter().enumerate().filter(|(_, found)| length_m(found) >= least_m);
        for (d, detection) in sized {
            let own_ns = scan.header.stamp_ns.saturating_add(detection.offset_ns);
            let place_m = [detection.x_m, detection.y_m];
            let mut nearest: Option<(f64, [f32; 2], &mut Estimate)> = None;
            for estimate in &mut self.all {
                if trusted && estimate.source_id() != detection.id {
                    continue;
                }
                if let Some((centre_m, left_m)) = estimate.whole_centre(own_ns, detection)
                    && nearest.as_ref().is_none_or(|(least_m, ..)| left_m < *least_m)
                {
                    nearest = Some((left_m, centre_m, estimate));
                }
            }
            if let Some((_, centre_m, estimate)) = nearest.filter(|(_, centre_m, _)| *centre_m != place_m) {
                if !std::mem::replace(&mut is_moved, true) {
                    completed.fill(&scan.header, (&scan.detections, &scan.types), None);
                }
                estimate.move_box([centre_m[0] - place_m[0], centre_m[1] - place_m[1]]);
                [completed.detections[d].x_m, completed.detections[d].y_m] = centre_m;
            }
        }
        is_moved
    }

    fn predict(&mut self, header: &Header, tracked: &mut Tracked) {
        let input = &self.input;
        for estimate in &mut self.all {
            tracked.fault_count += usize::from(estimate.predict(header.stamp_ns, input).is_err());
        }
    }

    /// Associates the detections with the estimates and updates the estimates.
    fn update(
        &mut self,
        Scan { header, detections, types, .. }: &Scan,
        publications: &mut Publications,
        Scratch { pairing, occlusion, possible, .. }: &mut Scratch,
        options: &TrackerOptions,
        tracked: &mut Tracked,
    ) {
        let has_births = publications.has_births_at(header.stamp_ns);
        self.update_visibility(header, options, occlusion, |_, estimate| estimate.is_coasting());
        pairing.by_position(&self.all, detections, types, &self.input, options);
        let missed = |e: usize, estimate: &Estimate| !estimate.is_coasting() && pairing.paired(e).is_none();
        self.update_visibility(header, options, occlusion, missed);
        let input = &self.input;
        let found = |d: usize| Found::new(header.stamp_ns, &detections[d], types[d]);
        for (e, estimate) in self.all.iter_mut().enumerate() {
            if pairing.is_resent(e) {
                tracked.repeated_count += 1;
                estimate.hold_turn();
                continue;
            }
            if pairing.is_contradicted(e) {
                tracked.fault_count += usize::from(estimate.ignore_reports(input).is_err());
            }
            possible.clear();
            // A single detection updates the estimate at the detection's own time, several update it at the
            // frame's time.
            let single = pairing.paired(e).is_some() && pairing.shares(e).len() == 1;
            possible.extend(pairing.shares(e).iter().map(|share| {
                let found = found(share.detection as usize);
                let seen = if single {
                    observation(found.detection, found.agent_type, input)
                } else {
                    estimate.observe(&found, input)
                };
                (share.probability, seen)
            }));
            let mut outcome = Ok(());
            if let Some(detection) = pairing.paired(e) {
                let first = found(detection as usize);
                let of_type = &mut self.shown[estimate.class.current().index()];
                estimate.mature(&first).for_each(|shown| of_type.add_of_type(&shown));
                let at_stamp = Found { own_ns: header.stamp_ns, ..first };
                outcome = estimate.update(if single { &first } else { &at_stamp }, possible, input, options);
                estimate.teach_sensor(&first, (&mut self.noise, &mut self.of_sensors), options);
                if has_births {
                    publications.transfer(Birth { stamp_ns: header.stamp_ns, detection }, estimate.birth());
                }
                for found in pairing.more(e).map(found) {
                    let mut seen = [(1.0, observation(found.detection, found.agent_type, input))];
                    outcome = outcome.and(estimate.update(&found, &mut seen, input, options));
                    estimate.teach_sensor(&found, (&mut self.noise, &mut self.of_sensors), options);
                }
            } else if header.observed_types & estimate.class.current().bit() != 0 {
                outcome = estimate.miss(possible, input, options);
            }
            tracked.fault_count += usize::from(outcome.is_err());
        }
    }

    /// Computes the visibility of the selected estimates.
    fn update_visibility(
        &mut self,
        header: &Header,
        options: &TrackerOptions,
        occlusion: &mut Occlusion,
        is_wanted: impl Fn(usize, &Estimate) -> bool,
    ) {
        let is_wanted = |e: usize, estimate: &Estimate| estimate.is_ready() && is_wanted(e, estimate);
        let mut all = self.all.iter().enumerate();
        if !header.has(flags::SEEN_FROM_EGO) || !all.any(|(e, estimate)| is_wanted(e, estimate)) {
            return;
        }
        let opaque = self.all.iter().filter(|estimate| estimate.is_opaque());
        let view = options.fov.map(|view| (f64::from(header.ego_heading_rad), view));
        occlusion.update(header.ego_m.map(f64::from), view, opaque.map(Estimate::outline));
        for (e, estimate) in self.all.iter_mut().enumerate() {
            if is_wanted(e, estimate) {
                estimate.update_visibility(occlusion);
            }
        }
    }

    /// Starts estimates from the remaining detections. The first detection of an identity starts it.
    fn start(
        &mut self,
        Scan { header, detections, types, .. }: &Scan,
        pairing: &Pairing,
        options: &TrackerOptions,
        tracked: &mut Tracked,
    ) {
        let input = &self.input;
        let trusted = options.trusts(header, detections);
        for d in pairing.unpaired() {
            let found = Found::new(header.stamp_ns, &detections[d], types[d]);
            if self.placeholders.holds(found.place()) {
                tracked.placeholder_count += 1;
                continue;
            }
            let last = self.all.last_mut().filter(|last| {
                trusted && last.birth().stamp_ns == header.stamp_ns && last.source_id() == found.detection.id
            });
            if let Some(last) = last {
                let mut seen = [(1.0, observation(found.detection, found.agent_type, input))];
                let outcome = last.predict(found.own_ns, input);
                let outcome = outcome.and(last.update(&found, &mut seen, input, options));
                tracked.fault_count += usize::from(outcome.is_err());
                continue;
            }
            if self.all.len() >= options.tracks_max {
                tracked.overflow_count += 1;
                continue;
            }
            self.started_count += 1;
            tracked.started_count += 1;
            let birth = Birth { stamp_ns: header.stamp_ns, detection: d as u32 };
            self.all.push(Estimate::new((birth, self.started_count), &found, input, trusted));
        }
        for estimate in self.all.iter_mut().rev() {
            if estimate.birth().stamp_ns != header.stamp_ns {
                break;
            }
            tracked.fault_count += usize::from(estimate.predict_first(input).is_err());
        }
    }

    /// Ends tentative estimates of agents that have an older estimate.
    fn end_twins(&mut self) {
        for younger in 1..self.all.len() {
            let (older, rest) = self.all.split_at_mut(younger);
            if !rest[0].is_ready() && older.iter().any(|older| rest[0].is_twin_of(older)) {
                rest[0].replace();
            }
        }
    }

    fn end(&mut self, options: &TrackerOptions, tracked: &mut Tracked) {
        let input = &self.input;
        let before = self.all.len();
        for estimate in &mut self.all {
            estimate.end_frame(input, &options.speed_limits);
            estimate.teach(&mut self.noise, input);
        }
        self.all.retain(|estimate| !estimate.is_over(input, options));
        tracked.ended_count += before - self.all.len();
        tracked.held_count = self.all.len();
    }
}

/// A detection that may not belong to the estimate of its identity.
#[derive(Clone, Copy, Debug)]
pub struct Stray {
    estimate: usize,
    detection: usize,
    /// The place, among the strays, of the estimate with which it has exchanged its identity.
    exchanged: Option<usize>,
}
